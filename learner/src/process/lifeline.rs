//! The lifeline: standard input is a pipe that the orchestrator never writes to; when it closes, the orchestrator is
//! gone, however it ended.

use super::stop::OrchestratorGone;
use std::io::Read;

/// Watches `input` on a thread of its own and sets `gone` when it ends. Bytes that arrive mean nothing.
pub fn watch(mut input: impl Read + Send + 'static, gone: OrchestratorGone) -> std::io::Result<()> {
    let watch = move || {
        let mut buffer = [0; 64];
        loop {
            match input.read(&mut buffer) {
                Ok(0) => break,
                Ok(_) => {}
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(_) => break,
            }
        }
        gone.set();
    };
    std::thread::Builder::new().name("lifeline".into()).spawn(watch).map(|_| ())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::time::{Duration, Instant};

    #[test]
    fn only_the_end_of_input_sets_the_flag() {
        let (reader, mut writer) = std::io::pipe().unwrap();
        let gone = OrchestratorGone::default();
        watch(reader, gone.clone()).unwrap();
        writer.write_all(b"noise").unwrap();
        std::thread::sleep(Duration::from_millis(50));
        assert!(!gone.is_set());
        drop(writer);
        let deadline = Instant::now() + Duration::from_secs(10);
        while !gone.is_set() {
            assert!(Instant::now() < deadline, "the end of the lifeline is noticed");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
