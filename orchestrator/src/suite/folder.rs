//! The folder of a suite, and what is left to do in it, read from the run folders themselves.
//!
//! ```text
//! SUITE/
//!   suite.toml        the file as it was at the last call
//!   suite.json        the state of every run
//!   suite.lock        held (flock) by whoever works on it
//!   configs/NAME.toml what `orchestrator up --config` is given
//!   logs/NAME.log     what its processes print
//!   runs/NAME/        ordinary run folders, their evaluations inside
//!   report/           the report
//! ```

use super::file::{Asked, AskedCheckpoint, Suite, SuiteEntry};
use super::in_words::some_of;
use crate::report_builder::files::PAGE;
use crate::run::cut_off::remove_evaluation;
use crate::run::identity::is_evaluation;
use crate::run::lock::{LockState, holder, wait_for_lock};
use crate::run::scenes;
use crate::run::unfinished::is_cut_off;
use crate::training::summary::Summary;
use crate::wrong::reject;
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::evaluation::RESULT_FILE;
use proto::plain_file::open_plain;
use proto::run_folder::{RunFolder, unlike_a_flag, write_atomically};
use proto::shell::quoted;
use report::study::differences_between;
use std::ffi::OsStr;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;
use wire::fault;

const LOCK: &str = "suite.lock";
const FILE: &str = "suite.toml";
const PID_BYTES: u64 = 20;
const STATE: &str = "suite.json";
const LOOKED_AT: Duration = Duration::from_millis(500);

/// A file of this name alone may be a user's own, beside `runs/`: the lock is there before ours, and a copy has the state.
pub fn is_suite(folder: &Path) -> bool {
    let is_ours = || [LOCK, STATE].iter().any(|name| folder.join(name).exists());
    folder.join(FILE).exists() && is_ours() && !RunFolder::new(folder).identity().exists()
}

/// Refuses the folder of a suite where a run's is wanted, and names its runs.
pub fn refuse(folder: &Path) -> Result<()> {
    if !is_suite(folder) {
        return Ok(());
    }
    let runs = std::fs::read_dir(folder.join("runs")).into_iter().flatten().flatten().map(|run| run.path());
    let first = runs.min().map_or_else(|| "none yet".to_owned(), |run| format!("such as {}", quoted(run)));
    let (root, quoted) = (folder.display(), quoted(folder));
    reject!(
        "{root} is the folder of a suite: give one of its runs ({first}; `orchestrator status {quoted}` lists them)"
    )
}

#[derive(Debug, Clone)]
pub struct SuiteFolder {
    root: PathBuf,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Step {
    Begin,
    Resume,
    Evaluate(usize),
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Next {
    Step(Step),
    /// Nothing yet: a process of an earlier call still holds this folder.
    HeldBy(String),
    /// Nothing yet: the run with this number, whose weights it begins with, is not trained.
    After(usize),
    Done,
}

impl SuiteFolder {
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: unlike_a_flag(root) }
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The suite's file as it was at the last call: where it is, the folder is a suite's.
    pub fn file(&self) -> PathBuf {
        self.root.join(FILE)
    }

    pub fn lock(&self) -> PathBuf {
        self.root.join(LOCK)
    }

    /// The process that works on the suite, 0 before it has signed; none if nobody does.
    pub fn worker(&self) -> Result<Option<u32>> {
        let Ok(lock) = RunFolder::new(&self.root).open(&self.lock()) else { return Ok(None) };
        if !matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock)) {
            return Ok(None);
        }
        let mut signed = String::new();
        lock.take(PID_BYTES).read_to_string(&mut signed).with_context(|| self.lock().display().to_string())?;
        Ok(Some(signed.parse().unwrap_or(0)))
    }

    pub fn state(&self) -> PathBuf {
        self.root.join(STATE)
    }

    pub fn report(&self) -> PathBuf {
        self.root.join("report")
    }

    pub fn page(&self) -> PathBuf {
        self.report().join(PAGE)
    }

    pub fn run(&self, entry: &SuiteEntry) -> RunFolder {
        RunFolder::new(self.root.join("runs").join(&entry.name))
    }

    pub fn evaluation(&self, entry: &SuiteEntry, asked: &Asked) -> PathBuf {
        self.run(entry).root().join("evaluations").join(asked.folder())
    }

    pub fn subject(&self, entry: &SuiteEntry, asked: &Asked) -> PathBuf {
        let run = self.run(entry);
        match asked.checkpoint {
            AskedCheckpoint::Newest => run.root().to_path_buf(),
            AskedCheckpoint::Best => run.best(),
        }
    }

    pub fn config(&self, entry: &SuiteEntry) -> PathBuf {
        self.root.join("configs").join(format!("{}.toml", entry.name))
    }

    pub fn log(&self, entry: &SuiteEntry) -> PathBuf {
        self.root.join("logs").join(format!("{}.log", entry.name))
    }

    /// Refuses a folder that is no suite's, runs that were begun with another configuration, and folders in the places of
    /// runs and evaluations that are not known for such.
    pub fn check(&self, suite: &Suite) -> Result<()> {
        let root = self.root.display();
        let mut foreign = false;
        match std::fs::read_dir(&self.root) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            entries => {
                for entry in entries.with_context(|| format!("suite folder {root}"))? {
                    // A call that was killed before it had written its file leaves these.
                    foreign |= ![LOCK, "suite.toml.partial"].map(OsStr::new).contains(&&*entry?.file_name());
                }
            }
        }
        if foreign && !self.file().exists() {
            bail!(
                "{root} is not empty, and what it holds is no suite: choose another folder, as in `--out {}`",
                quoted(self.root.with_extension("suite"))
            );
        }
        for entry in &suite.entries {
            let run = self.run(entry);
            refuse_unknown(&run)?;
            for asked in &suite.evaluations {
                let evaluation = self.evaluation(entry, asked);
                if !evaluation.join(RESULT_FILE).exists() {
                    refuse_unknown(&RunFolder::new(evaluation))?;
                }
            }
            if !run.config().exists() {
                continue;
            }
            let begun = Config::of_run(&run)?;
            // What `up` writes of its own is compared by itself.
            let written = |config: &Config| Config { scenes: Vec::new(), from: None, ..config.clone() };
            let mut changed = differences_between(&written(&entry.config), &written(&begun));
            changed.extend(self.other_source(suite, entry, &begun));
            changed.extend(scenes::changes(&entry.config, &begun, &run)?);
            if !changed.is_empty() || begun.seed != entry.config.seed {
                bail!(
                    "{} was begun with another configuration ({}): give it another `name`, or the suite another --out",
                    self.run(entry).root().display(),
                    some_of(changed)
                );
            }
        }
        Ok(())
    }

    /// Whose weights a run was begun with, if not with those that the suite's file names.
    fn other_source(&self, suite: &Suite, entry: &SuiteEntry, begun: &Config) -> Option<String> {
        let checkpoint = begun.from.as_ref().map(|from| Path::new(&from.checkpoint));
        let same = match (entry.from, checkpoint) {
            (None, None) => true,
            // By name: the suite's folder may have been moved since.
            (Some(from), Some(checkpoint)) => {
                checkpoint.ancestors().nth(2).and_then(Path::file_name)
                    == self.run(&suite.entries[from]).root().file_name()
            }
            _ => false,
        };
        let begun = checkpoint.map_or_else(|| "from scratch".to_owned(), |path| format!("from {}", path.display()));
        (!same).then_some(begun)
    }

    pub fn open(&self, suite: &Suite, text: &str) -> Result<File> {
        let root = self.root.display();
        std::fs::create_dir_all(&self.root).with_context(|| format!("cannot create {root}"))?;
        let path = self.lock();
        let lock = open_plain(&path, OpenOptions::new().create(true).truncate(false).write(true));
        let lock = lock.with_context(|| format!("cannot open {}", path.display()))?;
        // `status` holds it shared for microseconds.
        if !wait_for_lock(&lock, LOOKED_AT).with_context(|| path.display().to_string())? {
            bail!("{root} is already in use: another `orchestrator suite` works on it")
        }
        let signed = lock.set_len(0).and_then(|()| (&lock).write_all(std::process::id().to_string().as_bytes()));
        signed.with_context(|| format!("cannot write {}", path.display()))?;
        fault::reach("suite.before_file");
        // The file first: by it the folder is known for a suite's.
        let write = |path: &Path, text: &str| {
            write_atomically(path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
        };
        write(&self.file(), text)?;
        for folder in ["configs", "logs", "runs"] {
            let path = self.root.join(folder);
            std::fs::create_dir_all(&path).with_context(|| format!("cannot create {}", path.display()))?;
        }
        suite.entries.iter().try_for_each(|entry| write(&self.config(entry), &entry.overrides))?;
        Ok(lock)
    }

    pub fn next(&self, suite: &Suite, entry: &SuiteEntry) -> Result<Next> {
        let folder = self.run(entry);
        if let Some(held) = held(&folder)? {
            return Ok(Next::HeldBy(held));
        }
        let summary = Summary::read(&folder).ok().flatten();
        if !folder.summary().exists()
            || summary.is_some_and(|summary| summary.missing.iter().any(|it| it.can_be_made(&folder)))
        {
            if folder.identity().exists() {
                return Ok(Next::Step(Step::Resume));
            }
            return Ok(match entry.from {
                Some(from) if !self.run(&suite.entries[from]).summary().exists() => Next::After(from),
                _ => Next::Step(Step::Begin),
            });
        }
        for (index, asked) in suite.evaluations.iter().enumerate() {
            let folder = RunFolder::new(self.evaluation(entry, asked));
            if folder.root().join(RESULT_FILE).exists() {
                continue;
            }
            if let Some(held) = held(&folder)? {
                return Ok(Next::HeldBy(held));
            }
            return Ok(Next::Step(Step::Evaluate(index)));
        }
        Ok(Next::Done)
    }

    /// Removes an evaluation that an earlier try left half made: nobody could go on with it. Folders without a `run.toml`
    /// stay. `up` and `eval` themselves take those that they were cut off in, and refuse all others.
    pub fn clear(&self, suite: &Suite, entry: &SuiteEntry, step: &Step) -> Result<()> {
        let Step::Evaluate(index) = step else { return Ok(()) };
        let folder = RunFolder::new(self.evaluation(entry, &suite.evaluations[*index]));
        let ours = folder.identity().exists() && is_evaluation(&folder);
        if ours { remove_evaluation(folder.root()) } else { Ok(()) }
    }
}

fn refuse_unknown(folder: &RunFolder) -> Result<()> {
    let root = folder.root().display();
    let holds = match std::fs::read_dir(folder.root()) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => false,
        entries => entries.with_context(|| format!("cannot read {root}"))?.next().is_some(),
    };
    if holds && !folder.identity().exists() && !is_cut_off(folder).with_context(|| format!("cannot read {root}"))? {
        bail!(
            "{root} holds files, but no run.toml, by which a run is known. Nothing of it is removed: put that file back, \
             or move the folder away"
        );
    }
    Ok(())
}

fn held(folder: &RunFolder) -> Result<Option<String>> {
    Ok(match holder(folder)? {
        LockState::Free => None,
        LockState::Unsigned => Some("a process that has just begun".into()),
        LockState::By(holder) => Some(holder.to_string()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::create::{check_free, create};
    use crate::run::identity::Identity;
    use crate::run::lock::RunLock;
    use proto::config::FromConfig;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::Split;
    use std::os::unix::process::ExitStatusExt;
    use std::process::Command;

    const TEXT: &str = "seeds = [1]\n[[evaluations]]\nsplit = \"test\"\nobjects = \"novel\"\n\
                        [[evaluations]]\nsplit = \"validation\"\nobjects = \"novel\"\n[[runs]]\npreset = \"demo\"\n";

    #[test]
    fn what_is_next_is_read_from_the_folders() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = SuiteFolder::new(temporary.path().join("suite"));
        let suite = Suite::parse(TEXT).unwrap();
        folder.check(&suite).unwrap();
        refuse(&folder.root).unwrap();
        assert_eq!(folder.worker().unwrap(), None);
        let lock = folder.open(&suite, TEXT).unwrap();
        assert_eq!(folder.worker().unwrap(), Some(std::process::id()));
        let refused = refuse(&folder.root).unwrap_err().to_string();
        let root = folder.root.display();
        assert!(
            refused.starts_with(&format!("{root} is the folder of a suite: give one of its runs (none yet; ")),
            "{refused}"
        );
        assert!(refused.contains(&format!("`orchestrator status {root}`")), "{refused}");
        assert!(folder.open(&suite, TEXT).unwrap_err().to_string().contains("already in use"));
        drop(lock);
        assert_eq!(folder.worker().unwrap(), None);
        let entry = &suite.entries[0];
        let next = || folder.next(&suite, entry).unwrap();
        assert_eq!(next(), Next::Step(Step::Begin));

        // Killed before it had an identity: nothing to go on with.
        let run = folder.run(entry);
        std::fs::create_dir_all(run.checkpoints()).unwrap();
        assert_eq!(next(), Next::Step(Step::Begin));
        folder.check(&suite).unwrap();
        folder.clear(&suite, entry, &Step::Begin).unwrap();
        assert!(run.root().exists(), "`up` takes it");

        refuse(run.root()).unwrap();
        Identity::new().unwrap().write(&run).unwrap();
        std::fs::write(run.config(), entry.config.to_toml()).unwrap();
        assert_eq!(next(), Next::Step(Step::Resume));
        let lock = RunLock::acquire(&run).unwrap();
        assert!(matches!(next(), Next::HeldBy(_)));
        drop(lock);

        std::fs::write(run.summary(), "{}").unwrap();
        assert_eq!(next(), Next::Step(Step::Evaluate(0)));
        let first = folder.evaluation(entry, &suite.evaluations[0]);
        std::fs::create_dir_all(first.join("logs")).unwrap();
        assert_eq!(next(), Next::Step(Step::Evaluate(0)), "one that was cut off is done again");
        folder.check(&suite).unwrap();
        for (index, expected) in [Next::Step(Step::Evaluate(1)), Next::Done].into_iter().enumerate() {
            let done = folder.evaluation(entry, &suite.evaluations[index]);
            std::fs::create_dir_all(&done).unwrap();
            std::fs::write(done.join(RESULT_FILE), "{}").unwrap();
            assert_eq!(next(), expected);
        }

        // What begins with its weights can begin; before, it could not.
        let after = format!("{TEXT}[[runs]]\npreset = \"demo\"\nname = \"after\"\nfrom = \"demo\"\n");
        let both = Suite::parse(&after).unwrap();
        let follower = &both.entries[1];
        assert_eq!(folder.next(&both, follower).unwrap(), Next::Step(Step::Begin));
        std::fs::rename(run.summary(), run.root().join("kept")).unwrap();
        assert_eq!(folder.next(&both, follower).unwrap(), Next::After(0));
        std::fs::rename(run.root().join("kept"), run.summary()).unwrap();
        // Begun from scratch, it is not what the file asks for.
        let begun = folder.run(follower);
        std::fs::create_dir_all(begun.root()).unwrap();
        Identity::new().unwrap().write(&begun).unwrap();
        std::fs::write(begun.config(), follower.config.to_toml()).unwrap();
        let problem = folder.check(&both).unwrap_err().to_string();
        assert!(problem.contains("another configuration (from scratch)"), "{problem}");
        let checkpoint = "/elsewhere/runs/demo-1/checkpoints/rollout-00000001.json".to_owned();
        let from = Some(FromConfig { checkpoint, frames: 9, weights: "0".repeat(64), stages: vec![] });
        std::fs::write(begun.config(), Config { from, ..follower.config.clone() }.to_toml()).unwrap();
        folder.check(&both).unwrap();

        // The same file goes on; another configuration under the same name does not.
        folder.check(&suite).unwrap();
        let changed = Suite::parse(&TEXT.replace("[[runs]]", "[config.ppo]\nepochs = 1\n[[runs]]")).unwrap();
        let problem = folder.check(&changed).unwrap_err().to_string();
        assert!(problem.contains("another configuration (ppo.epochs = 2)"), "{problem}");
        let foreign = SuiteFolder::new(temporary.path());
        assert!(foreign.check(&suite).unwrap_err().to_string().contains("no suite"));
    }

    /// A kill while an evaluation was cleared could leave its logs without its run.toml: a folder that the suite refused
    /// from then on. The test starts itself as the process that is killed, after one entry, two, and so on.
    #[test]
    fn a_kill_while_an_evaluation_is_cleared_stops_no_suite() {
        const CHILD: &str = "STILLROOM_CLEAR_TEST";
        let suite = Suite::parse(TEXT).unwrap();
        let entry = &suite.entries[0];
        let step = Step::Evaluate(0);
        if let Some(root) = std::env::var_os(CHILD) {
            return SuiteFolder::new(root).clear(&suite, entry, &step).unwrap();
        }
        let temporary = tempfile::tempdir().unwrap();
        let folder = SuiteFolder::new(temporary.path().join("suite"));
        let _lock = folder.open(&suite, TEXT).unwrap();
        std::fs::create_dir_all(folder.run(entry).root()).unwrap();
        Identity::new().unwrap().write(&folder.run(entry)).unwrap();
        std::fs::write(folder.run(entry).summary(), "{}").unwrap();
        let evaluation = RunFolder::new(folder.evaluation(entry, &suite.evaluations[0]));
        let (_, module) = module_path!().split_once("::").unwrap();
        let name = format!("{module}::a_kill_while_an_evaluation_is_cleared_stops_no_suite");
        for kill in 1.. {
            let asked = EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 1);
            let mut config = Config { evaluation: Some(asked), ..entry.config.clone() };
            drop(create(&evaluation, &mut config, &[evaluation.checkpoints()]).unwrap());
            for name in ["a.log", "learner-0.lock", "z.jsonl", "logs/actor.log"] {
                std::fs::write(evaluation.root().join(name), "of the evaluation").unwrap();
            }
            let mut child = Command::new(std::env::current_exe().unwrap());
            child.args(["--exact", &name]).env(CHILD, &folder.root);
            child.env(fault::VARIABLE, format!("cut_off.after_entry:{kill}"));
            let ended = child.output().unwrap().status;

            folder.check(&suite).unwrap();
            assert_eq!(folder.next(&suite, entry).unwrap(), Next::Step(step.clone()), "after {kill}");
            folder.clear(&suite, entry, &step).unwrap();
            check_free(&evaluation).unwrap();
            if ended.success() {
                assert!(!evaluation.root().exists() && kill > 8, "every entry had its kill: {kill}");
                return;
            }
            assert_eq!(ended.signal(), Some(9));
        }
    }

    /// A run whose run.toml was lost was deleted, and begun anew.
    #[test]
    fn a_folder_that_is_not_known_for_a_run_is_refused_and_never_removed() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = SuiteFolder::new(temporary.path().join("suite"));
        let suite = Suite::parse(TEXT).unwrap();
        let _lock = folder.open(&suite, TEXT).unwrap();
        let entry = &suite.entries[0];
        let (run, evaluation) = (folder.run(entry), folder.evaluation(entry, &suite.evaluations[0]));
        for precious in [run.checkpoint_manifest(7), evaluation.join("figures.txt")] {
            std::fs::create_dir_all(precious.parent().unwrap()).unwrap();
            std::fs::write(&precious, "precious").unwrap();
            let problem = folder.check(&suite).unwrap_err().to_string();
            assert!(problem.contains("holds files, but no run.toml"), "{problem}");
            for step in [Step::Begin, Step::Evaluate(0)] {
                folder.clear(&suite, entry, &step).unwrap();
            }
            assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
            // A run again: what is below it is looked at, too.
            Identity::new().unwrap().write(&run).unwrap();
        }
    }

    #[test]
    fn scenes_that_changed_since_a_run_began_are_another_configuration() {
        let temporary = tempfile::tempdir().unwrap();
        let studio = temporary.path().join("studio");
        std::fs::create_dir_all(studio.join("parts")).unwrap();
        let parts = studio.join("parts/a.glb");
        std::fs::write(studio.join("scene.toml"), "gltf = \"parts/a.glb\"").unwrap();
        std::fs::write(&parts, "a room").unwrap();
        let text = format!("{TEXT}config.scenes = [\"{}\"]\n", studio.join("scene.toml").display());
        let suite = Suite::parse(&text).unwrap();
        let folder = SuiteFolder::new(temporary.path().join("suite"));
        let _lock = folder.open(&suite, &text).unwrap();
        let run = folder.run(&suite.entries[0]);
        std::fs::create_dir_all(run.scene(0).join("parts")).unwrap();
        for name in ["scene.toml", "parts/a.glb"] {
            std::fs::copy(studio.join(name), run.scene(0).join(name)).unwrap();
        }
        let begun = Config { scenes: vec!["scenes/000/scene.toml".into()], ..suite.entries[0].config.clone() };
        std::fs::write(run.config(), begun.to_toml()).unwrap();
        Identity::new().unwrap().write(&run).unwrap();
        folder.check(&suite).unwrap();
        std::fs::write(&parts, "a hall").unwrap();
        let problem = folder.check(&suite).unwrap_err().to_string();
        assert!(problem.contains(&format!("another configuration (another {})", parts.display())), "{problem}");
        // A run does not need the originals.
        std::fs::remove_dir_all(&studio).unwrap();
        folder.check(&suite).unwrap();
        let without = Suite::parse(TEXT).unwrap();
        assert!(folder.check(&without).unwrap_err().to_string().contains("another configuration (1 scene)"));
    }

    #[test]
    fn an_evaluation_is_of_the_newest_checkpoint_or_of_the_best() {
        let folder = SuiteFolder::new("suite");
        let text = format!("{TEXT}config.validation.every_frames = 9\n");
        let suite = Suite::parse(&text.replacen("novel\"", "novel\"\ncheckpoint = \"best\"", 1)).unwrap();
        let subjects = suite.evaluations.iter().map(|asked| folder.subject(&suite.entries[0], asked));
        let expected = ["suite/runs/demo-1/best", "suite/runs/demo-1"];
        assert!(subjects.eq(expected.map(PathBuf::from)));
    }
}
