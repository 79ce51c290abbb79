//! Fault points: named places in the protocol at which a test can kill the process, or hold it.
//!
//! `STILLROOM_FAULT=POINT` or `STILLROOM_FAULT=POINT:N` makes the process kill itself with SIGKILL, without unwinding
//! or flushing, when it reaches the point for the N-th time (default: the first). Crash tests set the variable for one
//! child; without it [`reach`] is one load and one branch. Points are named `CRATE.MOMENT`, for example
//! `actor.before_send`; `grep 'fault::reach'` lists them, and `grep 'fault::fails'` those that can fail. Several
//! programs pass the points `file.MOMENT`, and children inherit the variable: `POINT:N@PROGRAM` arms only the program
//! of that name. Commas divide several points.
//!
//! `STILLROOM_FAULT=hold=POINT` stops the process there (SIGSTOP) until it gets SIGCONT: a test then does something to
//! the others at a moment that it has chosen. `stall=SECONDS=POINT` holds only the thread that comes there, as a disk
//! does that hangs. `fail=POINT` makes something fail that fails by itself on no machine of ours: [`fails`] asks for it.

use rustix::process::{Signal, getpid, kill_process};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

pub const VARIABLE: &str = "STILLROOM_FAULT";

#[derive(Debug)]
struct Armed {
    point: String,
    then: Fault,
    countdown: AtomicU64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    Signal(Signal),
    Stall(Duration),
    /// Whoever asks is told to fail.
    Fail,
}

static ARMED: OnceLock<Vec<Armed>> = OnceLock::new();

/// Marks a fault point: kills or holds this process, or stalls the thread, if [`VARIABLE`] names the point.
pub fn reach(point: &str) {
    for fault in due(point) {
        match fault {
            // A crash, not an exit: no destructor may run, as when the kernel kills the process.
            Fault::Signal(signal) => drop(kill_process(getpid(), signal)),
            Fault::Stall(long) => std::thread::sleep(long),
            Fault::Fail => {}
        }
    }
}

/// Whether what is done at this point is to fail now, because [`VARIABLE`] says so (`fail=POINT:N`, the N-th time).
pub fn fails(point: &str) -> bool {
    // All of them: each counts for itself.
    due(point).filter(|fault| *fault == Fault::Fail).count() > 0
}

/// What is armed for this passing of a point. To be taken to its end, as each entry is counted when it is looked at.
fn due(point: &str) -> impl Iterator<Item = Fault> {
    let armed = ARMED.get_or_init(armed_here).iter().filter(move |armed| armed.point == point);
    armed.filter(|armed| armed.countdown.fetch_sub(1, Ordering::Relaxed) == 1).map(|armed| armed.then)
}

fn armed_here() -> Vec<Armed> {
    let Ok(text) = std::env::var(VARIABLE) else { return vec![] };
    let program = std::env::args_os().next().map(PathBuf::from);
    let name = program.as_deref().and_then(Path::file_name).and_then(OsStr::to_str);
    text.split(',').filter_map(|point| parse(point, name.unwrap_or_default())).collect()
}

/// What `text` arms in the program of this name.
fn parse(text: &str, program: &str) -> Option<Armed> {
    let (text, wanted) = text.split_once('@').unwrap_or((text, program));
    if wanted != program {
        return None;
    }
    let number = |digits: &str| -> u64 {
        // A test tool: a mistake in it must not pass for a test.
        digits.parse().unwrap_or_else(|_| panic!("{VARIABLE}={text}: `{digits}` is not a count"))
    };
    let (text, then) = if let Some(held) = text.strip_prefix("hold=") {
        (held, Fault::Signal(Signal::STOP))
    } else if let Some(stalled) = text.strip_prefix("stall=") {
        let (seconds, point) = stalled.split_once('=').unwrap_or((stalled, ""));
        (point, Fault::Stall(Duration::from_secs(number(seconds))))
    } else if let Some(failing) = text.strip_prefix("fail=") {
        (failing, Fault::Fail)
    } else {
        (text, Fault::Signal(Signal::KILL))
    };
    let (point, count) = text.rsplit_once(':').unwrap_or((text, "1"));
    Some(Armed { point: point.to_owned(), then, countdown: AtomicU64::new(number(count).max(1)) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::process::ExitStatusExt;
    use std::process::Command;

    #[test]
    fn a_point_is_a_name_and_a_count() {
        let count = |text| {
            let armed = parse(text, "actor").unwrap();
            (armed.point.clone(), armed.countdown.load(Ordering::Relaxed))
        };
        assert_eq!(count("actor.before_send"), ("actor.before_send".into(), 1));
        assert_eq!(count("actor.before_send:7"), ("actor.before_send".into(), 7));
        assert_eq!(count("actor.before_send:0"), ("actor.before_send".into(), 1));
        assert_eq!(count("file.before_rename:2@actor"), ("file.before_rename".into(), 2));
        assert!(parse("file.before_rename:2@learner", "actor").is_none(), "another program's");
        let held = parse("hold=learner.mid_rollout:3@learner", "learner").unwrap();
        assert_eq!((held.point.as_str(), held.then), ("learner.mid_rollout", Fault::Signal(Signal::STOP)));
        assert_eq!(parse("learner.mid_rollout", "learner").unwrap().then, Fault::Signal(Signal::KILL));
        let stalled = parse("stall=8=recorder.after_receive:40", "orchestrator").unwrap();
        assert_eq!(
            (stalled.point.as_str(), stalled.then),
            ("recorder.after_receive", Fault::Stall(Duration::from_secs(8)))
        );
        assert_eq!(stalled.countdown.load(Ordering::Relaxed), 40);
        let failing = parse("fail=learner.recording:2@learner", "learner").unwrap();
        assert_eq!((failing.point.as_str(), failing.then), ("learner.recording", Fault::Fail));
        assert!(
            std::panic::catch_unwind(|| parse("stall=recorder.after_receive", "orchestrator")).is_err(),
            "how long?"
        );
    }

    /// The test starts itself as a child that passes one point twice, and asks four times whether to fail at another.
    #[test]
    fn a_point_kills_where_it_is_armed_and_does_nothing_elsewhere() {
        const CHILD: &str = "STILLROOM_FAULT_TEST";
        if let Some(expected) = std::env::var_os(CHILD) {
            reach("proto.test");
            reach("proto.test");
            let failed: String = (0..4).map(|_| if fails("proto.failing") { 'x' } else { '.' }).collect();
            assert_eq!(failed.as_str(), expected);
            return;
        }
        let (_, module) = module_path!().split_once("::").unwrap();
        let name = format!("{module}::a_point_kills_where_it_is_armed_and_does_nothing_elsewhere");
        let end_of = |fault: Option<&str>, failed: &str| {
            let mut child = Command::new(std::env::current_exe().unwrap());
            child
                .args(["--exact", &name])
                .env(CHILD, failed)
                .env_remove(VARIABLE)
                .envs(fault.map(|fault| (VARIABLE, fault)));
            let output = child.output().unwrap();
            let ran = String::from_utf8_lossy(&output.stdout).contains("running 1 test");
            (ran, output.status.success(), output.status.signal())
        };
        let end = |fault| end_of(fault, "....");
        let [passed, killed] = [(true, true, None), (true, false, Some(9))];
        assert_eq!(end(None), passed);
        assert_eq!(end(Some("proto.other")), passed);
        assert_eq!(end(Some("proto.test:3")), passed);
        assert_eq!(end(Some("proto.test:2")), killed);
        assert_eq!(end(Some("proto.test")), killed);
        assert_eq!(end(Some("proto.test:3,proto.other")), passed);
        assert_eq!(end(Some("proto.other,proto.test:2")), killed);
        assert_eq!(end(Some("fail=proto.test")), passed, "nobody asks there");
        assert_eq!(end(Some("proto.failing")), passed, "it is not reached, but asked for");
        assert_eq!(end_of(Some("fail=proto.failing,fail=proto.failing:3"), "x.x."), passed);
        assert_eq!(end_of(Some("fail=proto.failing"), "...."), (true, false, None), "the child compares");
    }
}
