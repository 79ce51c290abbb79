//! The lifeline of a process that the orchestrator starts: standard input is a pipe that the orchestrator never writes
//! to; when it closes, the orchestrator is gone, however it ended. Where standard input has work to do, the pipe that it
//! reads answers from is the lifeline.

use crate::ffi;
use rustix::event::{PollFd, PollFlags, poll};
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::os::fd::AsFd;

/// Watches standard input on a thread of its own and calls `gone` when it ends, whatever the main thread is doing, also
/// if it is blocked in shared memory for good.
///
/// Makes Ctrl-C and requests to end pass this process by: a terminal sends them to every process in the foreground, Slurm
/// to every process of a job that it preempts, and only the orchestrator acts on them. It still needs this process to
/// save.
pub fn hold(gone: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    ffi::ignore_requests();
    watch(std::io::stdin(), gone)
}

/// The same for a process that runs the code of others, as the leader of its group. The pipe is moved away from standard
/// input, where nothing is read from then on, and standard output goes where standard error goes. When the orchestrator is
/// gone, the whole group is killed: this process, and all that it has started.
pub fn hold_apart() -> std::io::Result<()> {
    ffi::ignore_requests();
    let pipe = rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdin(), 3)?;
    rustix::stdio::dup2_stdin(File::open("/dev/null")?)?;
    rustix::stdio::dup2_stdout(rustix::stdio::stderr())?;
    watch(File::from(pipe), || {
        if rustix::process::getpgrp() == rustix::process::getpid() {
            let _ = rustix::process::kill_current_process_group(rustix::process::Signal::KILL);
        }
        std::process::exit(0);
    })
}

/// Watches standard output on a thread of its own and calls `gone` when it is a pipe that nobody can read any more: what
/// this process works at, nobody waits for.
pub fn hold_output(gone: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    watch_output(std::io::stdout(), gone)
}

fn watch_output(output: impl AsFd + Send + 'static, gone: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    let watch = move || {
        loop {
            // Asks for nothing, and is told all the same when the reader has gone. A file or a terminal never does that.
            let mut watched = [PollFd::new(&output, PollFlags::empty())];
            match poll(&mut watched, None) {
                Ok(_) if watched[0].revents().intersects(PollFlags::ERR | PollFlags::HUP) => break,
                Ok(_) | Err(rustix::io::Errno::INTR) => {}
                Err(_) => return,
            }
        }
        gone();
    };
    std::thread::Builder::new().name("lifeline".into()).spawn(watch).map(|_| ())
}

/// Calls `gone` when `input` ends. Bytes that arrive mean nothing.
fn watch(mut input: impl Read + Send + 'static, gone: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    let watch = move || {
        let mut ignored = [0; 64];
        loop {
            match input.read(&mut ignored) {
                Ok(0) => break,
                Err(error) if error.kind() != ErrorKind::Interrupted => break,
                Ok(_) | Err(_) => {}
            }
        }
        gone();
    };
    std::thread::Builder::new().name("lifeline".into()).spawn(watch).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::Duration;

    #[test]
    fn only_the_end_of_input_is_the_end() {
        let (reader, mut writer) = std::io::pipe().unwrap();
        let (gone, told) = channel();
        watch(reader, move || gone.send(()).unwrap()).unwrap();
        writer.write_all(b"noise").unwrap();
        assert_eq!(told.recv_timeout(Duration::from_millis(50)), Err(RecvTimeoutError::Timeout));
        drop(writer);
        assert_eq!(told.recv_timeout(Duration::from_secs(10)), Ok(()));
    }

    #[test]
    fn output_that_nobody_can_read_is_the_end() {
        let (mut reader, mut writer) = std::io::pipe().unwrap();
        let (gone, told) = channel();
        watch_output(writer.try_clone().unwrap(), move || gone.send(()).unwrap()).unwrap();
        writer.write_all(b"answer").unwrap();
        let mut answer = [0; 6];
        reader.read_exact(&mut answer).unwrap();
        assert_eq!(&answer, b"answer");
        assert_eq!(told.recv_timeout(Duration::from_millis(50)), Err(RecvTimeoutError::Timeout));
        drop(reader);
        assert_eq!(told.recv_timeout(Duration::from_secs(10)), Ok(()));
    }
}
