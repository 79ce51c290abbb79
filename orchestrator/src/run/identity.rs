use super::damaged;
use super::unfinished::is_cut_off;
use crate::output::format::{self, counted};
use crate::wrong::{demand, reject};
use anyhow::{Context, Result, bail};
use proto::SCHEMA_VERSION;
use proto::config::Config;
use proto::likeness::nearest;
use proto::run_folder::{RunFolder, write_atomically};
use proto::run_state::Ending;
use proto::shell::quoted;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use wire::{WireAddress, is_run_id};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    pub schema_version: u32,
    /// 12 hex digits; part of every name in shared memory.
    pub id: String,
    pub created_by: String,
    pub created_unix_s: u64,
    /// The number of actors that the command asks for which started it, where it has another one since (`scale`,
    /// `resume --actors`): the same command, given again, does not undo that.
    pub commanded_actors: Option<u32>,
    #[serde(default)]
    pub incarnations: Vec<Incarnation>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Incarnation {
    pub number: u32,
    pub wire: String,
    pub host: String,
    pub pid: u32,
    pub started_unix_s: u64,
    /// When it began, by a clock that nobody sets. None in runs of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub started: Option<Moment>,
    /// When it was last known to live, seconds since 1970: noted by the next start, if it left no word.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen_unix_s: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen_wall_s: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shape: Option<ProcessCounts>,
    /// How it ended; absent while it runs and after a crash.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended: Option<Ended>,
}

impl Incarnation {
    pub fn begin(number: u32, address: &WireAddress) -> Self {
        Self {
            number,
            wire: address.to_string(),
            host: host_name(),
            pid: std::process::id(),
            started_unix_s: unix_now(),
            started: Some(Moment::now()),
            seen_unix_s: None,
            seen_wall_s: None,
            shape: None,
            ended: None,
        }
    }
}

/// The processes of an incarnation. Actors and learners are those of all hosts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessCounts {
    pub hosts: u32,
    pub learners: u32,
    pub actors: u32,
    pub rollout: u64,
    pub frames: u64,
}

impl ProcessCounts {
    fn processes(self) -> [u32; 3] {
        [self.hosts, self.learners, self.actors]
    }

    fn text(self) -> String {
        let [hosts, learners, actors] = self.processes().map(u64::from);
        format!("{}, {}, {}", counted(hosts, "host"), counted(learners, "learner"), counted(actors, "actor"))
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ended {
    pub how: Ending,
    pub at_unix_s: u64,
    /// How long it took, seconds by a clock that nobody sets. None in runs of older versions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_s: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
}

impl Identity {
    pub fn new() -> Result<Self> {
        let mut bytes = [0u8; 6];
        File::open("/dev/urandom").and_then(|mut source| source.read_exact(&mut bytes)).context("/dev/urandom")?;
        Ok(Self {
            schema_version: SCHEMA_VERSION,
            id: format!("{:012x}", bytes.iter().fold(0u64, |id, &byte| id << 8 | u64::from(byte))),
            created_by: env!("CARGO_PKG_VERSION").to_owned(),
            created_unix_s: unix_now(),
            commanded_actors: None,
            incarnations: Vec::new(),
        })
    }

    pub fn read(folder: &RunFolder) -> Result<Self> {
        let path = folder.identity();
        let root = folder.root().display();
        let text = match folder.read_text(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                if is_cut_off(folder).unwrap_or(false) {
                    bail!(
                        "{root} is not a run yet: `orchestrator` was cut off while it made the folder. Nothing is \
                         trained there: the same command takes the folder again (`orchestrator up --run {}`)",
                        quoted(folder.root())
                    );
                }
                if !folder.root().exists() {
                    reject!("{root} does not exist: no run began there{}", perhaps(folder.root()));
                }
                demand!(
                    !holds_runs(folder.root()),
                    "{root} is not a run folder: it holds runs, which `orchestrator list {}` shows",
                    quoted(folder.root())
                );
                reject!(
                    "{root} is not a run folder: it has no run.toml; `orchestrator list` shows the runs that there are"
                );
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotADirectory => {
                reject!("{}", no_folder(folder.root()));
            }
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        let lost = || {
            let [run, config] = [folder.root().to_owned(), folder.config()].map(quoted);
            damaged(
                &path,
                &if is_evaluation(folder) {
                    "delete its folder, and evaluate again".to_owned()
                } else {
                    format!(
                        "`orchestrator up --config {config} --from {run}` begins another run like it with its weights"
                    )
                },
            )
        };
        let identity: Self = toml::from_str(&text).with_context(lost)?;
        if identity.schema_version != SCHEMA_VERSION {
            bail!(
                "{root} was written by version {} with schema {}; this program reads schema {SCHEMA_VERSION}",
                identity.created_by,
                identity.schema_version
            );
        }
        if !is_run_id(&identity.id) {
            bail!("{}: an id has letters and digits only, not `{}`", lost(), identity.id);
        }
        Ok(identity)
    }

    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        let text = toml::to_string(self).context("run.toml")?;
        write_atomically(&folder.identity(), text.as_bytes())
            .with_context(|| format!("cannot write {}", folder.identity().display()))
    }

    pub fn begin_incarnation(&mut self) -> (u32, WireAddress) {
        let number = self.incarnations.last().map_or(0, |last| last.number) + 1;
        let address = WireAddress::new(&self.id, number);
        self.incarnations.push(Incarnation::begin(number, &address));
        (number, address)
    }

    pub fn note_shape(&mut self, shape: ProcessCounts) {
        if let Some(last) = self.incarnations.last_mut() {
            last.shape = Some(shape);
        }
    }

    /// Notes that the number of actors is another one than the command asks for which started the run. `before`: the
    /// number until now.
    pub fn note_scale(&mut self, before: u32) {
        self.commanded_actors.get_or_insert(before);
    }

    /// The number of actors with which a run goes on that has `held`, when a command asks for `asked`. The command that
    /// started the run leaves it what it has been scaled to since; another number counts.
    pub fn actors_for(&self, asked: u32, held: u32) -> u32 {
        if self.commanded_actors == Some(asked) { held } else { asked }
    }

    /// Of its newest start.
    pub fn hosts(&self) -> u32 {
        self.incarnations.last().and_then(|start| start.shape).map_or(1, |shape| shape.hosts)
    }

    pub fn changes_of_shape(&self) -> Vec<String> {
        let shapes: Vec<ProcessCounts> = self.incarnations.iter().filter_map(|start| start.shape).collect();
        let changed = shapes.windows(2).filter(|pair| pair[0].processes() != pair[1].processes());
        changed
            .map(|pair| {
                format!(
                    "from rollout {} on ({} frames): {} instead of {}",
                    pair[1].rollout,
                    format::count(pair[1].frames),
                    pair[1].text(),
                    pair[0].text()
                )
            })
            .collect()
    }

    /// Address of one of its incarnations. What is left there is deleted after a crash. So it is made from the id and
    /// the number, whatever `wire` holds: a run folder can come from anybody.
    pub fn address(&self, incarnation: &Incarnation) -> WireAddress {
        WireAddress::new(&self.id, incarnation.number)
    }

    pub fn note_signs_of_life(&mut self, seen: &BTreeMap<u32, Sign>) {
        for incarnation in self.incarnations.iter_mut().filter(|incarnation| incarnation.ended.is_none()) {
            if let Some(sign) = seen.get(&incarnation.number) {
                incarnation.seen_unix_s = incarnation.seen_unix_s.max(Some(sign.at_unix_s));
                incarnation.seen_wall_s = sign.wall_s.or(incarnation.seen_wall_s);
            }
        }
    }

    pub fn end_incarnation(&mut self, ended: Ended) {
        if let Some(last) = self.incarnations.last_mut() {
            let wall_s = last.started.as_ref().and_then(Moment::elapsed_s);
            last.ended = Some(Ended { wall_s, ..ended });
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sign {
    pub at_unix_s: u64,
    pub wall_s: Option<f64>,
}

/// A moment by the machine's monotonic clock, which counts from its boot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Moment {
    /// Which boot of which machine: the kernel's `boot_id`.
    boot: String,
    monotonic_s: f64,
}

impl Moment {
    pub fn now() -> Self {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        // Where it cannot be read, times of one boot are taken for those of another, and the clock of the day counts.
        let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
        Self { boot: boot.trim().to_owned(), monotonic_s: now.tv_sec as f64 + now.tv_nsec as f64 / 1e9 }
    }

    /// The time since then, seconds; none where the machine was started anew, or is another one.
    pub fn elapsed_s(&self) -> Option<f64> {
        let now = Self::now();
        let same = self.boot == now.boot && !now.boot.is_empty();
        let elapsed_s = ((now.monotonic_s - self.monotonic_s) * 1e3).round() / 1e3;
        (same && elapsed_s >= 0.0).then_some(elapsed_s)
    }
}

pub fn is_evaluation(folder: &RunFolder) -> bool {
    Config::of_run(folder).is_ok_and(|config| config.evaluation.is_some())
}

fn holds_runs(folder: &Path) -> bool {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.into_iter().any(|entry| RunFolder::new(entry.path()).identity().is_file())
}

/// What is said of a file where a folder is needed: also which command takes such a file.
pub fn no_folder(path: &Path) -> String {
    let file = quoted(path);
    let taken = match path.extension().and_then(OsStr::to_str) {
        Some("safetensors") => {
            format!(". `orchestrator eval {file}` evaluates a policy file, `orchestrator play {file}` shows it at work")
        }
        Some("onnx") => ". An ONNX model is for other programs: give the run that it was exported from".to_owned(),
        Some("py") => format!(". `orchestrator up --env {file}:make_env` trains in an environment of a Python file"),
        Some("mcap") => format!(". `orchestrator replay {file}` takes a recording"),
        Some("toml") => format!(
            ". `orchestrator up --config {file}` takes a configuration, `orchestrator suite {file}` the file of a suite"
        ),
        _ => String::new(),
    };
    format!("{} is a file: give the folder of a run or an evaluation{taken}", path.display())
}

/// Which run is probably meant by a path that is not there: one of that name, or of nearly that name, where runs are.
pub fn perhaps(path: &Path) -> String {
    match likest(Path::new("runs"), path) {
        Some(there) => format!(" (did you mean {}?)", quoted(&there)),
        None => "; `orchestrator list` shows the runs that there are".to_owned(),
    }
}

/// What is meant by a path among the folders of the path's own folder, and of that of the runs.
fn likest(runs: &Path, path: &Path) -> Option<PathBuf> {
    let is_inside = path.is_relative() && path.components().all(|part| matches!(part, Component::Normal(_)));
    let same = runs.join(path);
    if is_inside && same.is_dir() {
        return Some(same);
    }
    let name = path.file_name()?.to_str()?;
    // A run's own folder has folders that are no runs.
    let own = path.parent().filter(|folder| folder.as_os_str() != "" && *folder != runs && holds_runs(folder));
    own.into_iter().chain((is_inside || path.parent() == Some(runs)).then_some(runs)).find_map(|folder| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        // A suite has its runs in a folder of its own.
        let is_run = |entry: &std::fs::DirEntry| {
            RunFolder::new(entry.path()).identity().is_file() || holds_runs(&entry.path().join("runs"))
        };
        let names: Vec<String> =
            entries.filter(is_run).filter_map(|entry| entry.file_name().into_string().ok()).collect();
        nearest(name, names.iter().map(String::as_str)).map(|meant| folder.join(meant))
    })
}

pub fn unix_now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}

pub fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

#[cfg(test)]
pub mod tests {
    use super::*;

    pub fn ended(how: Ending, at_unix_s: u64) -> Ended {
        Ended { how, at_unix_s, wall_s: None, frames: None, weights: None, reason: None }
    }

    pub fn folder() -> (tempfile::TempDir, RunFolder) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        (temporary, folder)
    }

    #[test]
    fn incarnations_count_up_and_never_share_an_address() {
        let (_temporary, folder) = folder();
        let mut identity = Identity::new().unwrap();
        assert_eq!(identity.id.len(), 12);
        let (first, first_address) = identity.begin_incarnation();
        identity.write(&folder).unwrap();
        let mut again = Identity::read(&folder).unwrap();
        assert_eq!(again, identity);
        let (second, second_address) = again.begin_incarnation();
        assert_eq!((first, second), (1, 2));
        assert_ne!(first_address, second_address);
        again.end_incarnation(Ended { frames: Some(7), ..ended(Ending::Stopped, 5) });
        again.write(&folder).unwrap();
        let text = std::fs::read_to_string(folder.identity()).unwrap();
        assert!(text.contains("how = \"stopped\""), "{text}");
        assert_eq!(Identity::read(&folder).unwrap(), again);
    }

    #[test]
    fn what_is_no_run_folder_or_of_another_schema_is_refused() {
        let (_temporary, folder) = folder();
        let said = Identity::read(&folder).unwrap_err().to_string();
        assert!(said.contains("not a run folder: it has no run.toml; `orchestrator list` shows"), "{said}");
        let holds = tempfile::tempdir().unwrap();
        std::fs::create_dir(holds.path().join("a")).unwrap();
        std::fs::write(holds.path().join("a/run.toml"), "").unwrap();
        let told = Identity::read(&RunFolder::new(holds.path())).unwrap_err().to_string();
        assert!(told.contains("it holds runs, which `orchestrator list "), "{told}");
        std::fs::write(holds.path().join("policy.onnx"), "").unwrap();
        let told = Identity::read(&RunFolder::new(holds.path().join("policy.onnx"))).unwrap_err().to_string();
        assert!(told.contains("policy.onnx is a file: give the folder of a run"), "{told}");
        for (name, taken) in [
            ("a b.safetensors", "`orchestrator eval 'a b.safetensors'` evaluates"),
            ("env.py", "`orchestrator up --env env.py:make_env`"),
            ("x.mcap", "`orchestrator replay x.mcap`"),
            ("x.toml", "`orchestrator suite x.toml`"),
            ("x.csv", "the folder of a run or an evaluation"),
        ] {
            assert!(no_folder(Path::new(name)).contains(taken), "{name}");
        }
        let identity = Identity { schema_version: SCHEMA_VERSION + 1, ..Identity::new().unwrap() };
        identity.write(&folder).unwrap();
        assert!(Identity::read(&folder).unwrap_err().to_string().contains("schema"));
        let identity = Identity { id: "../../home/me".into(), ..Identity::new().unwrap() };
        identity.write(&folder).unwrap();
        assert!(Identity::read(&folder).unwrap_err().to_string().contains("letters and digits"));
    }

    #[test]
    fn the_likest_run_is_meant_by_a_path_that_is_not_there() {
        let temporary = tempfile::tempdir().unwrap();
        let runs = temporary.path().join("runs");
        for name in ["a", "20261201-demo-1"] {
            std::fs::create_dir_all(runs.join(name)).unwrap();
            std::fs::write(runs.join(name).join("run.toml"), "").unwrap();
        }
        let meant = |path: &Path| likest(&runs, path).and_then(|run| run.file_name()?.to_str().map(str::to_owned));
        let [first, second] = ["a", "20261201-demo-1"].map(|name| Some(name.to_owned()));
        for (path, expected) in [("a", &first), ("run/a", &first), ("20261201-demo-2", &second), ("run/b", &None)] {
            assert_eq!(meant(Path::new(path)), *expected, "{path}");
        }
        assert_eq!(meant(&runs.join("20261201-demo")), second);
        assert_eq!(meant(Path::new("/elsewhere/a")), None);
    }

    #[test]
    fn a_change_of_shape_is_on_record_and_the_command_of_before_does_not_undo_it() {
        let (_temporary, folder) = folder();
        let mut identity = Identity::new().unwrap();
        assert_eq!(identity.actors_for(5, 4), 5, "another command's number counts");
        for (actors, rollout) in [(4, 0), (4, 3), (3, 7)] {
            identity.begin_incarnation();
            identity.note_shape(ProcessCounts { hosts: 1, learners: 2, actors, rollout, frames: 1200 * rollout });
        }
        identity.note_scale(4);
        identity.note_scale(3);
        identity.write(&folder).unwrap();
        let read = Identity::read(&folder).unwrap();
        assert_eq!(read, identity);
        let lines = read.changes_of_shape();
        assert_eq!(
            lines,
            ["from rollout 7 on (8,400 frames): 1 host, 2 learners, 3 actors instead of 1 host, 2 learners, 4 actors"]
        );
        assert_eq!([read.actors_for(4, 3), read.actors_for(6, 3)], [3, 6]);
    }
}
