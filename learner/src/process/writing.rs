//! What a learner waits for of its host's recorder: the receipts of observations, and the writing of a rollout.
//!
//! A recorder that stands still (its disk hangs, or the orchestrator is stopped) keeps actors from answering, too. While
//! it does nobody is late, and the learner reports what it waits for.

use super::conversation::Conversation;
use super::stop::Stop;
use anyhow::Result;
use proto::event::LearnerEvent;
use std::io::Write;
use std::time::{Duration, Instant};
use wire::Standstill;

/// Longest wait until a collected rollout is written by a recorder that does not stand still.
const WRITING_DEADLINE: Duration = Duration::from_mins(1);
/// The same once a stop is announced: the recorder may have died without a word.
const WRITING_PATIENCE: Duration = Duration::from_secs(5);
/// How often a learner says that it waits for a recorder that stands still. Each time is a sign of its own life.
const TELLING_INTERVAL: Duration = Duration::from_secs(1);

/// The recording does not get on. After a standstill nothing is saved: the disk that hangs would have to see the
/// recording first, and the last checkpoint stands.
#[derive(Debug, thiserror::Error)]
pub enum Unrecorded {
    #[error(
        "the recording has not got on for {} s: its disk hangs, or the orchestrator is stopped. When it works again, \
         `orchestrator resume` goes on with a run; an evaluation begins anew", .0.as_secs()
    )]
    Standstill(Duration),
    #[error(
        "rollout {rollout} was not recorded within {} s, though the recorder gets on: the orchestrator's log says why",
        WRITING_DEADLINE.as_secs()
    )]
    Late { rollout: u64 },
}

impl<W: Write> Conversation<'_, W> {
    /// Whether the recorder stands still, which is told now and then.
    pub(super) fn recorder_stands_still(&mut self) -> Result<bool, Unrecorded> {
        let Some(still) = self.recorder_standstill() else {
            self.told_of_recorder = Duration::ZERO;
            return Ok(false);
        };
        if still >= Standstill::DEADLINE {
            return Err(Unrecorded::Standstill(still));
        }
        if still >= self.told_of_recorder + TELLING_INTERVAL {
            self.told_of_recorder = still;
            self.tell(&LearnerEvent::WaitingForRecorder { rank: self.rank, waited_s: still.as_secs_f64() });
        }
        Ok(true)
    }

    /// Waits until the recording of this rollout is written. Returns a reason to stop, if there is one before that.
    pub(super) fn await_written(&mut self, rollout: u64) -> Result<Option<Stop>> {
        let mut began = Instant::now();
        loop {
            self.receive_all()?;
            // First the reason to stop, then the recording: once the recorder is gone, it writes nothing more.
            let stop = self.stop_asked()?;
            if self.is_written(rollout + 1) {
                return Ok(None);
            }
            let waited = began.elapsed();
            match stop {
                Some(Stop::OrchestratorGone) => return Ok(stop),
                Some(Stop::Announced) if self.recording_failed() || waited >= WRITING_PATIENCE => return Ok(stop),
                None if self.recorder_stands_still()? => began = Instant::now(),
                None if waited >= WRITING_DEADLINE => return Err(Unrecorded::Late { rollout }.into()),
                Some(Stop::Announced) | None => {}
            }
            self.wait(WRITING_PATIENCE);
        }
    }
}
