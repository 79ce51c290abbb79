//! Events to the orchestrator: one JSON object a line on standard output, flushed each.

use super::stop::OrchestratorGone;
use proto::event::LearnerEvent;
use std::io::Write;

#[derive(Debug)]
pub struct Control<W> {
    output: W,
    gone: OrchestratorGone,
}

impl<W: Write> Control<W> {
    /// Writes events to `output`; sets `gone` when the reader has closed it.
    pub fn new(output: W, gone: OrchestratorGone) -> Self {
        Self { output, gone }
    }

    /// Writes an event. If that fails, the orchestrator is gone; the learner still saves its work.
    pub fn tell(&mut self, event: &LearnerEvent) {
        let mut line = serde_json::to_vec(event).expect("events are plain data with string keys");
        line.push(b'\n');
        let told = self.output.write_all(&line).and_then(|()| self.output.flush());
        if let Err(cause) = told
            && !self.gone.is_set()
        {
            tracing::warn!("nobody reads the learner's events ({cause}): saving and exiting");
            self.gone.set();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_lines_and_a_broken_pipe_is_a_reason_to_leave() {
        let event = LearnerEvent::ActorsConnected { rank: 0 };
        let mut lines = vec![];
        Control::new(&mut lines, OrchestratorGone::new()).tell(&event);
        assert_eq!(lines.last(), Some(&b'\n'));
        assert_eq!(serde_json::from_slice::<LearnerEvent>(&lines).unwrap(), event);

        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let gone = OrchestratorGone::new();
        Control::new(writer, gone.clone()).tell(&event);
        assert!(gone.is_set());
    }
}
