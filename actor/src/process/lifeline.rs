//! The lifeline: standard input is a pipe whose other end the orchestrator holds, so it closes however the
//! orchestrator ends.

use std::io::{ErrorKind, Read};

/// Exits this process with code 0 as soon as standard input ends, whatever the main thread is doing, also if it is
/// blocked in shared memory for good. Also makes Ctrl-C the orchestrator's business.
///
/// Leaves no clean-up undone: what a process holds in shared memory is swept by the next orchestrator.
pub fn hold() -> std::io::Result<()> {
    super::ffi::ignore_interrupt();
    std::thread::Builder::new().name("lifeline".into()).spawn(|| {
        let mut input = std::io::stdin().lock();
        let mut ignored = [0; 64];
        loop {
            match input.read(&mut ignored) {
                Ok(0) => std::process::exit(0),
                Err(error) if error.kind() != ErrorKind::Interrupted => std::process::exit(0),
                Ok(_) | Err(_) => {}
            }
        }
    })?;
    Ok(())
}
