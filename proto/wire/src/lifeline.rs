//! The lifeline of a process that the orchestrator starts: standard input is a pipe that the orchestrator never writes
//! to; when it closes, the orchestrator is gone, however it ended.

use crate::ffi;
use std::io::{ErrorKind, Read};

/// Watches standard input on a thread of its own and calls `gone` when it ends, whatever the main thread is doing, also
/// if it is blocked in shared memory for good.
///
/// Makes Ctrl-C pass this process by: the terminal sends it to every process in the foreground, and only the
/// orchestrator acts on it.
pub fn hold(gone: impl FnOnce() + Send + 'static) -> std::io::Result<()> {
    ffi::ignore_interrupt();
    watch(std::io::stdin(), gone)
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
}
