use crate::environment;
use crate::output::events;
use crate::output::format::{self, counted};
use crate::output::terminal;
use crate::preflight::all::demand_all;
use crate::preflight::programs::Tools;
use crate::run::checkpoints::{newest_whole, read_manifest};
use crate::run::identity::{Identity, host_name, is_evaluation};
use crate::run::lock::{RunLock, wait_for_learners};
use crate::run::process_state::stopped;
use crate::run::remains;
use crate::run::signal::wake_learner;
use crate::suite;
use crate::supervisor::deadlines::Deadlines;
use crate::supervisor::event::SessionEnd;
use crate::training::budget::Budget;
use crate::training::events::ended;
use crate::training::next_steps;
use crate::training::run::{Started, TrainingRun, write_config};
use crate::training::summary::{Missing, Summary};
use crate::training::validation::Validation;
use crate::wrong::{judged, reject};
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use proto::task::Described;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

const ACTORS_LEAVE: Duration = Duration::from_secs(5);

/// Go on with a run that was stopped, or whose machine or orchestrator died
///
/// Continues from the last good checkpoint with the configuration in the run folder. The result is the same,
/// bit for bit, as that of a run that was never interrupted: on the CPU, and on GPUs of the same kind and number with
/// `learner.deterministic`. A run that is complete only prints its summary, unless `--frames` asks for more, or something
/// is missing that can be made up, such as a validation that failed.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  orchestrator resume runs/20261121-020423-demo-1
  # trains on: 720,000 frames in all
  orchestrator resume runs/20261121-020423-demo-1 --frames 720000
  # with another number of actors
  orchestrator resume runs/20261121-020423-demo-1 --actors 8

With --actors, environments keep what they are: those of the actors that remain go on as before, those of actors \
that are no more rest as they are until such an actor is there again, and new ones begin their first episode. \
`orchestrator scale` does the same while a run goes on. With --learners, floating-point sums have another order from \
there on, unless learner.shards is set.

With --frames, stages that have ended keep their frames, and those that have not share the rest in proportion; of a \
complete run the last stage goes on, with its optimiser and episodes. Before the first stage has ended, the stages \
are those of `up --frames`. The result is not that of a run that had this budget from its beginning: learning rate, \
entropy bonus and clip fall over the length of a stage (unless their `_end` in [ppo] is 1), and what is trained was \
trained under the old length; and the last rollout of a complete run is shorter, to end on the old budget.")]
pub struct ResumeArgs {
    /// Run folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Another budget: frames of the whole run, those included that are trained. It is written into the run's
    /// configuration
    #[arg(long, value_name = "F", value_parser = super::overrides::frames)]
    frames: Option<u64>,
    /// Another number of actors, from here on. It is written into the run's configuration
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=512))]
    actors: Option<u32>,
    /// Another number of learners, from here on. It is written into the run's configuration
    #[arg(long, value_name = "R", value_parser = clap::value_parser!(u32).range(1..=512))]
    learners: Option<u32>,
    /// Print events for scripts, a JSON object a line, and nothing else on standard output (docs/terminal.md)
    #[arg(long)]
    json: bool,
}

pub fn run(args: &ResumeArgs) -> Result<ExitCode> {
    if args.json {
        events::begin();
    }
    let folder = RunFolder::new(&args.run);
    if let Some(go_on) = suite::Standing::read(folder.root()).ok().and_then(|standing| standing.go_on()) {
        reject!("{} is the folder of a suite: `{go_on}` goes on with it", folder.root().display());
    }
    suite::refuse(folder.root())?;
    // Refuses what is no run before a lock file is made in it.
    Identity::read(&folder)?;
    if is_evaluation(&folder) {
        reject!(
            "{} is an evaluation: one that was cut off is made anew, by `orchestrator eval` with another folder",
            folder.root().display()
        );
    }
    let lock = RunLock::acquire(&folder)?;
    // Only now nobody else writes it.
    let mut identity = Identity::read(&folder)?;
    let summary = Summary::read(&folder)?;
    if let (None, Some(summary)) = (args.frames, &summary) {
        if args.actors.is_some() || args.learners.is_some() {
            bail!(
                "this run is complete: it has no rollout for another number of processes. Give it frames by --frames, too"
            );
        }
        if let Some(status) = finished(summary, &folder)? {
            return Ok(status);
        }
    }
    let mut config = Config::of_run(&folder)?;
    config.check_task(&folder)?;
    environment::attempt(&config, folder.root())?;
    let tools = Tools::find()?;
    let patience = Deadlines::of(&config).silence;
    settle(&folder, &identity, config.learner.count.max(args.learners.unwrap_or(0)), patience)?;
    // Only now nobody trains any more.
    let trained = frames_of_checkpoint(&folder)?;
    let reshaped = reshape(&mut config, &mut identity, [args.actors, args.learners])?;
    let budget = args.frames.map(|frames| judged(Budget::of(&config, trained, frames))).transpose()?;
    let budget = budget.filter(|budget| !budget.is_old());
    if let (None, Some(summary)) = (&budget, &summary) {
        if reshaped {
            bail!(
                "this run is complete: it has no rollout for another number of processes. Give it more --frames, too"
            );
        }
        if let Some(status) = finished(summary, &folder)? {
            return Ok(status);
        }
    }
    if let Some(budget) = budget {
        let new = budget.lay_over(&config);
        demand_all(&new, &folder, &tools)?;
        budget.announce(&config);
        budget.write(&folder, &config)?;
        config = new;
    } else {
        demand_all(&config, &folder, &tools)?;
        if reshaped {
            // First: a launcher's command must not undo it, whatever happens in between.
            identity.write(&folder)?;
            write_config(&folder, &config)?;
        }
    }
    for path in [folder.logs(), folder.checkpoints(), folder.recordings()] {
        std::fs::create_dir_all(&path).with_context(|| format!("cannot create {}", path.display()))?;
    }
    TrainingRun { folder, config, identity, lock, tools, started: Started::default(), is_tested: false }.run()
}

/// The frames of the checkpoint that the run goes on from, its newest that is whole; 0 where it begins. Refuses a run that
/// has trained and has none: it would begin anew, over its own figures, or have a learner fail. A run saves before its first
/// rollout, so there was one.
fn frames_of_checkpoint(folder: &RunFolder) -> Result<u64> {
    let has_trained = std::fs::metadata(folder.metrics()).is_ok_and(|metrics| metrics.len() > 0);
    match newest_whole(folder, &folder.checkpoints()) {
        Err(error) if has_trained => bail!(
            "this run has trained, but {error:#}, and without one all that it has learned is gone: put that folder back \
             from a copy, or begin anew with `orchestrator up --config {}` and another folder",
            quoted(folder.config())
        ),
        Err(_) => Ok(0),
        Ok((manifest, _)) => Ok(read_manifest(folder, &manifest)?.frames),
    }
}

/// Gives a run these numbers of actors and learners, where they are asked for; whether one is another than before.
fn reshape(config: &mut Config, identity: &mut Identity, asked: [Option<u32>; 2]) -> Result<bool> {
    let before = [config.actors.count, config.learner.count];
    let [actors, learners] = [asked[0].unwrap_or(before[0]), asked[1].unwrap_or(before[1])];
    (config.actors.count, config.learner.count) = (actors, learners);
    config.validate().with_context(|| {
        format!("the run cannot have {} and {}", counted(actors.into(), "actor"), counted(learners.into(), "learner"))
    })?;
    if actors != before[0] {
        identity.note_scale(before[0]);
        terminal::note(&format!("{} instead of {} from here on", counted(actors.into(), "actor"), before[0]));
    }
    if learners != before[1] {
        tell_of_sums(config, before[1]);
    }
    Ok([actors, learners] != before)
}

fn tell_of_sums(config: &Config, before: u32) {
    let learners = config.learner.count;
    if config.learner.shards > 0 {
        terminal::note(&format!("{} instead of {before} from here on", counted(learners.into(), "learner")));
        return;
    }
    tracing::warn!(
        "the run goes on with {} instead of {before}: floating-point sums have another order from here on, so its weights \
         will not be those of a run that keeps the number",
        counted(learners.into(), "learner")
    );
}

/// Goes on with a run that the same command began: a launcher has started it again. `asked`: what the command asks for.
/// `patience`: for an orchestrator of before that is about to end.
pub fn go_on(folder: RunFolder, asked: Config, started: Started, patience: Duration) -> Result<ExitCode> {
    let lock = RunLock::acquire_within(&folder, patience)?;
    let mut identity = Identity::read(&folder)?;
    let mut config = Config::of_run(&folder)?;
    config.check_task(&folder)?;
    let Counts { actors: asked_actors, learners } = same_run(&config, asked)
        .with_context(|| format!("{} holds a run that this command did not begin", folder.root().display()))?;
    if let Some(summary) = Summary::read(&folder)?
        && let Some(status) = finished(&summary, &folder)?
    {
        if let Some(rendezvous) = &started.rendezvous {
            rendezvous.turn_away(0, "this run is complete");
        }
        return Ok(status);
    }
    let tools = Tools::find()?;
    settle(&folder, &identity, config.learner.count.max(learners), Deadlines::of(&config).silence)?;
    // Only now nobody trains any more.
    frames_of_checkpoint(&folder)?;
    let actors = identity.actors_for(asked_actors, config.actors.count);
    if actors != asked_actors {
        terminal::note(&format!(
            "the run has been scaled to {actors} actors, which it keeps: `scale` or another --actors changes it"
        ));
    }
    if reshape(&mut config, &mut identity, [Some(actors), Some(learners)])? {
        identity.write(&folder)?;
        write_config(&folder, &config)?;
    }
    if actors == asked_actors {
        identity.commanded_actors = None;
    }
    demand_all(&started.part(&config), &folder, &tools)?;
    terminal::note(&format!("goes on with run {} in {}", identity.id, folder.root().display()));
    TrainingRun { folder, config, identity, lock, tools, started, is_tested: false }.run()
}

#[derive(Debug, PartialEq, Eq)]
struct Counts {
    actors: u32,
    learners: u32,
}

/// Whether a command asks for the run that is there: how many actors and learners it asks for, which may be other numbers.
fn same_run(run: &Config, mut asked: Config) -> Result<Counts> {
    let learners = std::mem::replace(&mut asked.learner.count, run.learner.count);
    let actors = std::mem::replace(&mut asked.actors.count, run.actors.count);
    // The run names its own copies, and the checkpoint that it began from, whatever has become of the originals.
    if asked.scenes.len() == run.scenes.len() {
        asked.scenes.clone_from(&run.scenes);
    }
    asked.from.clone_from(&run.from);
    let changes = asked.changes_since(run);
    if !changes.is_empty() {
        bail!("it would have {}: give another --run, or the run's own settings", changes.join(", "));
    }
    Ok(Counts { actors, learners })
}

/// Shows a complete run, after what can be mended in its files alone; none of one that lacks what a start makes up.
fn finished(summary: &Summary, folder: &RunFolder) -> Result<Option<ExitCode>> {
    let config = Config::of_run(folder).ok();
    let metrics = config.as_ref().map_or_else(Vec::new, |config| config.spec().shown());
    let validation = config.as_ref().map(|config| Validation::open(folder, config)).transpose()?.flatten();
    let config = config.unwrap_or_default();
    if validation.as_ref().is_some_and(Validation::is_busy) || summary.missing.contains(&Missing::TensorBoard) {
        terminal::note("this run has reached its budget, and lacks what is made up now");
        return Ok(None);
    }
    let missing = validation.as_ref().map_or_else(Vec::new, Validation::missing);
    if missing != summary.missing {
        let mended = Summary { missing, ..summary.clone() };
        mended.write(folder)?;
        return Ok(Some(show(&mended, &metrics, &config, folder)));
    }
    Ok(Some(show(summary, &metrics, &config, folder)))
}

fn show(summary: &Summary, metrics: &[Described], config: &Config, folder: &RunFolder) -> ExitCode {
    terminal::note("this run is complete");
    ended(folder, &summary.id, &SessionEnd::Complete, Some(summary));
    if !events::are_told() {
        for line in summary.lines(metrics, folder, &SessionEnd::Complete) {
            terminal::out(&line);
        }
    }
    let recorded = !summary.recordings.is_empty();
    for line in next_steps::complete(&next_steps::program(), folder, config, recorded) {
        terminal::note(&line);
    }
    if summary.is_whole() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Waits until nothing of an earlier incarnation runs any more, and removes what it left. Learners that outlived their
/// orchestrator finish their update before they save and leave, so they are given `patience`: as long as the supervisor
/// gives an update.
fn settle(folder: &RunFolder, identity: &Identity, learners: u32, patience: Duration) -> Result<()> {
    let tell = |rank| {
        let who = if learners == 1 { "the learner".to_owned() } else { format!("learner-{rank}") };
        terminal::note(&format!(
            "{who} of the last start still runs; waiting up to {} for it to finish its update, save and leave",
            format::duration(patience)
        ));
    };
    wake_stopped_learners(folder);
    if let Some(rank) = wait_for_learners(folder, 0..learners, patience, tell)? {
        bail!(
            "the learner of the last start still holds {} after {}; if it hangs, end it (`orchestrator clean` names \
             and ends what has outlived its orchestrator) and resume again",
            folder.learner_lock(rank).display(),
            format::duration(patience)
        );
    }
    for incarnation in identity.incarnations.iter().filter(|incarnation| incarnation.ended.is_none()) {
        if incarnation.host != host_name() {
            continue;
        }
        let swept = remains::sweep(&identity.address(incarnation), ACTORS_LEAVE)?;
        tracing::debug!("start {} was cut off; {} names of it removed", incarnation.number, swept.names);
    }
    Ok(())
}

/// Has learners of the last start go on that are stopped by a signal: they save and leave.
fn wake_stopped_learners(folder: &RunFolder) {
    for rank in (0..).take_while(|&rank| folder.learner_lock(rank).exists()) {
        let lock = folder.learner_lock(rank);
        // An old lock names a process that is gone, or somebody else's: only its holder is woken.
        let Some(pid) = learner_in(folder, &lock).filter(|&pid| stopped(pid).iter().any(|process| process.pid == pid))
        else {
            continue;
        };
        if wake_learner(pid, &lock).is_ok_and(|there| there) {
            terminal::note(&format!(
                "learner-{rank} of the last start (pid {pid}) is stopped and is woken, so that it saves and leaves"
            ));
        }
    }
}

fn learner_in(folder: &RunFolder, lock: &Path) -> Option<u32> {
    let mut text = String::new();
    folder.open(lock).ok()?.take(32).read_to_string(&mut text).ok()?;
    text.trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_launcher_goes_on_with_the_run_of_its_command_and_no_other() {
        let run = Config { scenes: vec!["scenes/000/a.toml".into()], ..Config::resolve("demo", None).unwrap() };
        let mut asked = Config { scenes: vec!["mine/a.toml".into()], ..run.clone() };
        let counts = |actors, learners| Counts { actors, learners };
        assert_eq!(same_run(&run, asked.clone()).unwrap(), counts(run.actors.count, run.learner.count));
        (asked.actors.count, asked.learner.count) = (7, 2);
        assert_eq!(same_run(&run, asked.clone()).unwrap(), counts(7, 2), "the numbers may change");
        asked.seed = 9;
        let message = same_run(&run, asked).unwrap_err().to_string();
        assert!(message.contains("seed = 9 instead of 1") && !message.contains("learner.count"), "{message}");
    }

    #[test]
    fn a_run_file_names_no_folder_that_is_deleted() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path().join("run"));
        std::fs::create_dir(folder.root()).unwrap();
        let precious = temporary.path().join("precious");
        std::fs::create_dir(&precious).unwrap();
        let mut identity = Identity::new().unwrap();
        let (_, address) = identity.begin_incarnation();
        std::fs::create_dir(address.root()).unwrap();
        for wire in ["stillroom_@", &format!("{}@", address.prefix()), "x"] {
            identity.incarnations[0].wire = format!("{wire}{}", precious.display());
            identity.write(&folder).unwrap();
            settle(&folder, &Identity::read(&folder).unwrap(), 1, Duration::ZERO).unwrap();
            assert!(precious.is_dir(), "{wire}");
        }
        assert!(!address.root().exists(), "the run's own is removed");
    }
}
