//! Waiting for the end of a process: the kernel wakes us (pidfd), we do not ask again and again.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::process::{Child, ExitStatus};
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

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
