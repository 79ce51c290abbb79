//! Waiting for the end of a process: the kernel wakes us (pidfd), we do not ask again and again. Programs that answer a
//! question and end.

use anyhow::{Context, Result, bail};
use proto::exit::how;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::ffi::OsStr;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How often to look where there is no descriptor to wait with: kernels before 5.3, or no descriptor left.
const LOOK: Duration = Duration::from_millis(20);

/// Waits until a child has ended, at most for `patience`; none if it still runs then. A zero patience only looks.
pub fn wait_for_child(child: &mut Child, patience: Duration) -> std::io::Result<Option<ExitStatus>> {
    let began = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        let left = patience.saturating_sub(began.elapsed());
        if left.is_zero() {
            return Ok(None);
        }
        sleep_until_end(Pid::from_child(child), left);
    }
}

/// Sleeps until a process has ended, at most for `longest`; it may wake earlier. Of a process that is not our child the
/// number can have passed to another meanwhile: look again.
pub fn sleep_until_end(process: Pid, longest: Duration) {
    let Ok(descriptor) = pidfd_open(process, PidfdFlags::empty()) else {
        std::thread::sleep(longest.min(LOOK));
        return;
    };
    // A patience beyond what the kernel counts in is cut to a day: the caller comes again.
    let timeout = Timespec::try_from(longest.min(Duration::from_hours(24))).expect("a day fits");
    // Interrupted or not, the caller looks.
    let _ = poll(&mut [PollFd::new(&descriptor, PollFlags::IN)], Some(&timeout));
}

#[derive(Debug)]
pub struct Answer {
    pub status: ExitStatus,
    pub stdout: String,
    pub stderr: String,
}

/// Has a program answer; none if it has not within `patience`, when it is killed. One that a signal ends is asked once
/// more: the kernel kills, too, where memory is short for a moment.
pub fn ask(command: &mut Command, patience: Duration) -> Result<Option<Answer>> {
    let Some(first) = ask_once(command, patience)? else { return Ok(None) };
    if first.status.signal().is_none() {
        return Ok(Some(first));
    }
    let name = name_of(command);
    tracing::warn!("{name} {}, and is asked once more", how(first.status));
    let second = ask_once(command, patience)?;
    if let Some(Answer { status, stderr, .. }) = &second
        && status.signal().is_some()
    {
        let said = stderr.trim_end().lines().last().map_or_else(String::new, |line| format!("; it said: {line}"));
        bail!("{name} {} when it was asked once more, too. `dmesg` says whether memory is short{said}", how(*status));
    }
    Ok(second)
}

fn ask_once(command: &mut Command, patience: Duration) -> Result<Option<Answer>> {
    let piped = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = piped.spawn().with_context(|| format!("cannot start {}", command.get_program().display()))?;
    let [stdout, stderr] = [heard(child.stdout.take()), heard(child.stderr.take())];
    let Some(status) = wait_for_child(&mut child, patience)? else {
        child.kill()?;
        child.wait()?;
        return Ok(None);
    };
    let [stdout, stderr] = [stdout, stderr].map(|pipe| pipe.join().unwrap_or_default());
    Ok(Some(Answer { status, stdout, stderr }))
}

fn name_of(command: &Command) -> String {
    let program = Path::new(command.get_program()).file_name().unwrap_or_default();
    let words: Vec<_> =
        std::iter::once(program).chain(command.get_args().take(1)).map(OsStr::to_string_lossy).collect();
    format!("`{}`", words.join(" "))
}

/// Reads a pipe to its end, on a thread of its own. A longer answer than a mebibyte is cut, so that its writer ends.
fn heard(pipe: Option<impl Read + Send + 'static>) -> JoinHandle<String> {
    std::thread::spawn(move || {
        let mut bytes = vec![];
        if let Some(pipe) = pipe {
            // A cut answer is judged by what is there.
            let _ = pipe.take(1 << 20).read_to_end(&mut bytes);
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    /// `learner check`, killed once, was said to be a libtorch that does not work.
    #[test]
    fn what_a_signal_kills_is_asked_once_more_and_then_named_with_the_signal() {
        let folder = tempfile::tempdir().unwrap();
        let asked = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]).current_dir(folder.path());
            ask(&mut command, Duration::from_secs(20))
        };
        let once = asked("if mkdir asked; then kill -9 $$; fi; echo yes").unwrap().unwrap();
        assert!(once.status.success() && once.stdout == "yes\n", "{once:?}");
        let message = asked("echo out of luck >&2; kill -SEGV $$").unwrap_err().to_string();
        assert!(
            message.starts_with("`sh -c` was killed by signal 11 (SIGSEGV) when it was asked once more"),
            "{message}"
        );
        assert!(message.ends_with("it said: out of luck"), "{message}");
        assert!(asked("rmdir asked; exit 3").unwrap().unwrap().status.code() == Some(3));
        assert!(asked("mkdir asked && exit 4").unwrap().unwrap().status.code() == Some(4), "it is asked once");
    }

    #[test]
    fn an_end_wakes_and_patience_ends() {
        let mut child = Command::new("sleep").arg("20").spawn().unwrap();
        let began = Instant::now();
        let patience = Duration::from_millis(50);
        assert_eq!(wait_for_child(&mut child, patience).unwrap(), None);
        assert!(began.elapsed() >= patience);

        let pid = Pid::from_child(&child);
        let killer = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(50));
            rustix::process::kill_process(pid, rustix::process::Signal::KILL).unwrap();
        });
        let status = wait_for_child(&mut child, Duration::from_secs(15)).unwrap();
        assert!(status.is_some_and(|status| !status.success()));
        killer.join().unwrap();
        // Its number is nobody's any more.
        sleep_until_end(pid, Duration::from_secs(15));
        assert!(began.elapsed() < Duration::from_secs(15));
    }
}
