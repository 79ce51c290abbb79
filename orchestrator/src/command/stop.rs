//! `orchestrator stop`: an orderly stop of a run that another process runs. While it waits it shows what the
//! orchestrator says.

use crate::output::log_line::LogLine;
use crate::output::terminal;
use crate::run::identity::{Identity, is_evaluation};
use crate::run::lock::{Holder, LockState, holder};
use crate::run::process_state::stopped;
use crate::run::signal::ask_to_stop;
use crate::suite::{self, SuiteFolder};
use crate::viewer::tail::Tail;
use anyhow::{Result, bail};
use proto::run_folder::RunFolder;
use proto::run_state::Ending;
use proto::shell::quoted;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tracing::Level;

const LOOK: Duration = Duration::from_millis(50);

/// How long an orchestrator may be stopped by a signal, before nobody waits for it any more.
const ASLEEP: Duration = Duration::from_secs(3);

const THERE: &str =
    "give this command, or Ctrl-C, where it was started (`docker exec` or `nsenter` leads into a container)";

/// Save and stop a run from another terminal
///
/// Does what Ctrl-C in its terminal does, shows the run's log meanwhile, and waits until it is done. A learner that hangs
/// is given ten times what its last rollouts or updates took (at least `learner.progress_deadline_s`) and time to save;
/// then the run ends with its last checkpoint. `orchestrator resume RUN` goes on with it. Of a suite the run in progress
/// and the suite after it are stopped.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example:
  orchestrator stop runs/20261121-020423-demo-1")]
pub struct StopArgs {
    /// Run folder, or that of a suite
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Give up waiting after this many seconds; the run goes on stopping
    #[arg(long, value_name = "SECONDS", default_value_t = 3600)]
    timeout: u64,
}

pub fn run(args: &StopArgs) -> Result<()> {
    let folder = RunFolder::new(&args.run);
    if suite::is_suite(folder.root()) {
        return stop_suite(folder.root(), args.timeout);
    }
    Identity::read(&folder)?;
    let (what, asked_to) = if is_evaluation(&folder) { ("evaluation", "stop") } else { ("run", "save and stop") };
    let root = folder.root().display();
    let begin = Instant::now();
    let mut asked = None;
    let mut asleep = None;
    let mut log = Log::at_end(&folder);
    loop {
        log.show();
        match holder(&folder)? {
            LockState::Free => break,
            LockState::By(holder) if !holder.is_here() => bail!("nobody was asked: {root} is run by {holder}; {THERE}"),
            // The start that follows a scale is the same process's: it is asked, too.
            LockState::By(signed) if asked != Some((signed.pid, signed.incarnation)) => {
                match ask_to_stop(signed.pid, &folder.orchestrator_lock()) {
                    Ok(true) => {
                        tracing::info!("asked pid {} to {asked_to}", signed.pid);
                        asked = Some((signed.pid, signed.incarnation));
                    }
                    not_asked => {
                        // A holder that is just ending, or just starting, looks like a stranger for a moment.
                        std::thread::sleep(LOOK);
                        if holder(&folder)? == LockState::By(signed.clone()) {
                            not_asked?;
                            bail!(
                                "nobody was asked: {root} is run by {signed}, and no process here has that number; {THERE}"
                            );
                        }
                    }
                }
            }
            LockState::By(Holder { pid, .. }) if stopped(pid).iter().any(|process| process.pid == pid) => {
                if asleep.get_or_insert_with(Instant::now).elapsed() > ASLEEP {
                    bail!(
                        "the orchestrator of {root} (pid {pid}) is itself stopped by a signal, so it cannot {asked_to}: \
                         `kill -CONT {pid}` lets it go on, and it then does as asked"
                    );
                }
            }
            // It is just starting, or has been asked.
            LockState::Unsigned | LockState::By(_) => asleep = None,
        }
        if begin.elapsed() > Duration::from_secs(args.timeout) {
            bail!("{root} has not stopped within {} s; it still may", args.timeout);
        }
        // A released lock shows that it is over, and a lock wakes nobody who waits with a deadline.
        std::thread::sleep(LOOK);
    }
    log.show();
    if asked.is_none() {
        terminal::note(&format!("{root} does not run"));
    }
    let identity = Identity::read(&folder)?;
    let run = quoted(folder.root());
    let Some(last) = identity.incarnations.last() else {
        bail!("{root} has not been started yet: `orchestrator resume {run}` does that");
    };
    let Some(ended) = &last.ended else {
        if is_evaluation(&folder) {
            bail!("{root} was cut off: the evaluation has no result");
        }
        bail!("{root} was cut off; `orchestrator resume {run}` goes on from its last checkpoint");
    };
    if ended.how == Ending::Failed {
        bail!("{what} {} failed: {}", identity.id, ended.reason.as_deref().unwrap_or("no reason is recorded"));
    }
    terminal::out(&format!("{what} {} {}", identity.id, ended.how));
    if let Some(weights) = &ended.weights {
        terminal::out(&format!("weights: {weights}"));
    }
    if let Some(frames) = ended.frames {
        terminal::out(&format!("frames: {frames}"));
    }
    Ok(())
}

/// Stops a suite as Ctrl-C there does, the run in progress first.
fn stop_suite(root: &Path, timeout_s: u64) -> Result<()> {
    let (suite, begin) = (SuiteFolder::new(root), Instant::now());
    let named = root.display();
    let mut asked = None;
    while let Some(pid) = suite.worker()? {
        if pid > 0 && asked != Some(pid) {
            let is_asked = ask_to_stop(pid, &suite.lock())?;
            std::thread::sleep(LOOK);
            if !is_asked && suite.worker()? == Some(pid) {
                bail!("nobody was asked: pid {pid} works on {named}, and no process here has that number; {THERE}");
            }
            tracing::info!("asked pid {pid} to stop");
            asked = Some(pid);
        }
        if begin.elapsed() > Duration::from_secs(timeout_s) {
            bail!("{named} has not stopped within {timeout_s} s; it still may");
        }
        std::thread::sleep(LOOK);
    }
    if asked.is_none() {
        terminal::note(&format!("{named} does not run"));
    }
    terminal::out(&suite::Standing::read(root)?.summary());
    Ok(())
}

pub(super) struct Log(Tail);

/// Pieces of a log that are read at once.
const READS_MOST: usize = 16;

impl Log {
    pub(super) fn at_end(folder: &RunFolder) -> Self {
        let path = folder.log("orchestrator");
        let length = std::fs::metadata(&path).map_or(0, |file| file.len());
        // From the end of its last line.
        Self(Tail::of(folder.clone(), path, length.saturating_sub(1)))
    }

    pub(super) fn show(&mut self) {
        self.new_lines().iter().for_each(|line| terminal::note(line));
    }

    fn new_lines(&mut self) -> Vec<String> {
        // A log that cannot be read is no reason not to stop, and one without end does not hold it up.
        let mut lines = vec![];
        for _ in 0..READS_MOST {
            match self.0.read().unwrap_or_default().lines {
                none if none.is_empty() => break,
                more => lines.extend(more),
            }
        }
        let told = lines.iter().filter_map(|line| {
            let line = String::from_utf8_lossy(line);
            let LogLine { level, text, .. } = LogLine::parse(&line);
            (!matches!(level, Some(Level::DEBUG | Level::TRACE))).then(|| text.to_owned())
        });
        told.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::identity::host_name;
    use std::fs::File;
    use std::io::Write;
    use std::process::Command;

    #[test]
    fn what_is_logged_from_now_on_is_shown_line_by_line() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        let path = folder.log("orchestrator");
        let mut log = Log::at_end(&folder);
        assert!(log.new_lines().is_empty(), "there is no log yet");
        std::fs::create_dir(folder.logs()).unwrap();
        let write = |text: &str| {
            let mut file = File::options().append(true).create(true).open(&path).unwrap();
            file.write_all(text.as_bytes()).unwrap();
        };
        write("2026-11-21T02:04:23.1Z  INFO before\n");
        let mut log = Log::at_end(&folder);
        write("2026-11-21T02:04:24.1Z  INFO stopping: the learner saves\n2026-11-21T02:04:24.2Z DEBUG x\n2026-");
        assert_eq!(log.new_lines(), ["stopping: the learner saves"]);
        write("11-21T02:04:25.1Z  WARN the stop waits\n  for learner-0\n");
        assert_eq!(log.new_lines(), ["the stop waits", "  for learner-0"]);
        assert!(log.new_lines().is_empty());
    }

    #[test]
    fn a_process_that_a_lock_names_falsely_is_not_signalled() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        let mut identity = Identity::new().unwrap();
        identity.write(&folder).unwrap();
        let args = StopArgs { run: temporary.path().to_path_buf(), timeout: 5 };
        assert!(run(&args).unwrap_err().to_string().contains("has not been started yet"));
        identity.begin_incarnation();
        identity.write(&folder).unwrap();
        let mut victim = Command::new("sleep").arg("60").spawn().unwrap();
        let sign =
            |holder: &Holder| std::fs::write(folder.orchestrator_lock(), toml::to_string(holder).unwrap()).unwrap();
        let planted = Holder { pid: victim.id(), host: host_name(), incarnation: 1, pid_namespace: None };
        sign(&planted);
        // Free, the lock names nobody.
        assert!(run(&args).unwrap_err().to_string().contains("cut off"));
        let held = std::fs::File::open(folder.orchestrator_lock()).unwrap();
        held.try_lock().unwrap();
        let message = format!("{:#}", run(&args).unwrap_err());
        assert!(message.contains("no orchestrator"), "{message}");
        assert!(victim.try_wait().unwrap().is_none(), "it was left alone");
        victim.kill().unwrap();
        victim.wait().unwrap();
        // It said that it had asked that number, and waited for an hour.
        for (pid_namespace, why) in
            [(None, "no process here has that number"), (Some(1), "in another container or PID")]
        {
            sign(&Holder { pid_namespace, ..planted.clone() });
            let message = format!("{:#}", run(&args).unwrap_err());
            assert!(message.starts_with("nobody was asked: ") && message.contains(why), "{message}");
        }
    }
}
