//! The actor's side of the protocol as a pure state machine: messages and time in, what to do next out.
//!
//! It contains no shared memory, physics or clocks. The shell ([`crate::run`]) passes it every restore and every action
//! batch that arrives, and executes [`Protocol::next`], one step at a time:
//!
//! ```text
//!       restore adopted, recorder met         actions for this step
//!  Hello ──────────────────▶ half: Sending ◀───────────────────────── half: Awaiting
//!  every 200 ms                   │                                        ▲
//!  until then                     └──────── sent and received ─────────────┘
//! ```
//!
//! An actor takes part only after the recorder has received one of its HELLOs. Before that the recorder may not know
//! this publisher, and a sample for it is dropped as soon as its queue is full. Afterwards the publisher waits for the
//! recorder, and no sample is lost.
//!
//! Everything is idempotent because every message names its exchange: a duplicate, a batch of another learner
//! incarnation or one for another step changes nothing.

use std::time::Duration;
use wire::message::{ActionHeader, Halves, ObservationHeader, RestoreHeader, can_follow, observation_kind};

/// Time between two HELLOs until a restore arrives.
const HELLO_INTERVAL: Duration = Duration::from_millis(200);
/// Time until an undelivered observation is sent again.
const RESEND_INTERVAL: Duration = Duration::from_millis(50);
/// Time between two looks whether the recorder has met this actor; the recorder rings no bell of an actor.
const MEETING_INTERVAL: Duration = Duration::from_millis(10);
/// Longest single wait for a message. Every message rings, but its sender can be killed before it does.
const WAIT_MAX: Duration = Duration::from_millis(250);

/// What the shell does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Todo {
    /// Send a HELLO, then report [`Protocol::hello_sent`].
    Hello,
    /// Apply the actions of this half that were last accepted, then report [`Protocol::acted`].
    Act { half: u32 },
    /// Render and send this half's observations, then report [`Protocol::sent`].
    Send { half: u32 },
    /// Wait for a message, at most this long.
    Wait(Duration),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    Accepted,
    Ignored(&'static str),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// The observation is out; its actions have not come yet.
    Awaiting,
    /// Actions were accepted and are to be applied.
    Acting,
    /// An observation is to be sent, not before this time.
    Sending { not_before: Duration },
}

#[derive(Debug, Clone, Copy)]
struct HalfState {
    /// Exchange number of the observation that was or will be sent.
    step: u64,
    stage_version: u64,
    phase: Phase,
}

/// The state of the conversation with the learner. Times are measured from any fixed moment.
#[derive(Debug, Clone)]
pub struct Protocol {
    actor: u32,
    incarnation: u32,
    halves: Halves,
    environments: usize,
    /// The learner whose restore is in force; none before the first one.
    learner_incarnation: Option<u32>,
    /// The recorder has received something of this incarnation, or there is none.
    met: bool,
    half: [HalfState; 2],
    /// The half that was served last: the other one has precedence.
    served_last: u32,
    hello_due: Duration,
}

impl Protocol {
    /// An actor that has just started: it sends HELLO until a restore arrives and the recorder, if there is one, has
    /// met it.
    pub fn new(actor: u32, incarnation: u32, environments: u32, recorder: bool) -> Self {
        let idle = HalfState { step: 0, stage_version: 0, phase: Phase::Awaiting };
        Self {
            actor,
            incarnation,
            halves: Halves::of(environments),
            environments: environments as usize,
            learner_incarnation: None,
            met: !recorder,
            half: [idle; 2],
            served_last: 1,
            hello_due: Duration::ZERO,
        }
    }

    pub fn halves(&self) -> Halves {
        self.halves
    }

    /// The newest incarnation of this actor that the recorder has heard.
    pub fn on_met(&mut self, incarnation: u32) {
        self.met |= incarnation == self.incarnation;
    }

    /// Whether the recorder's word is still to come.
    pub fn is_strange(&self) -> bool {
        !self.met
    }

    /// A restore has arrived with `states` environment states. If accepted, the shell rebuilds the environments
    /// before it asks for anything else.
    pub fn on_restore(&mut self, header: &RestoreHeader, states: usize, now: Duration) -> Verdict {
        if header.actor_incarnation != 0 && header.actor_incarnation != self.incarnation {
            return Verdict::Ignored("it is for another incarnation of this actor");
        }
        if states != self.environments {
            return Verdict::Ignored("it holds another number of environments");
        }
        if !can_follow(self.learner_incarnation.unwrap_or(0), header.learner_incarnation) {
            return Verdict::Ignored("no learner was started so often");
        }
        if let Some(current) = self.learner_incarnation {
            // The learner answers each HELLO, and a later answer may be older than what has come since: this actor has
            // accepted actions that the learner sends only once. Going back would wait for them for ever. One restore
            // a learner is enough: from there on both sides count the same exchanges.
            if header.learner_incarnation <= current {
                return Verdict::Ignored("it comes from the learner already followed, or one that was replaced");
            }
        }
        self.learner_incarnation = Some(header.learner_incarnation);
        for (half, state) in self.half.iter_mut().enumerate() {
            *state = HalfState {
                step: header.step[half],
                stage_version: header.stage_version,
                phase: if (half as u32) < self.halves.count() {
                    Phase::Sending { not_before: now }
                } else {
                    Phase::Awaiting
                },
            };
        }
        self.served_last = 1;
        Verdict::Accepted
    }

    /// An action batch has arrived with `actions` actions. If accepted, the shell keeps them until [`Todo::Act`].
    pub fn on_actions(&mut self, header: &ActionHeader, actions: usize) -> Verdict {
        if self.learner_incarnation != Some(header.learner_incarnation) {
            return Verdict::Ignored("they come from another learner incarnation");
        }
        if header.half >= self.halves.count() {
            return Verdict::Ignored("there is no such half");
        }
        if actions != self.halves.range(header.half).len() {
            return Verdict::Ignored("they are for another number of environments");
        }
        let state = &mut self.half[header.half as usize];
        if header.step != state.step {
            return Verdict::Ignored("they answer another exchange");
        }
        if state.phase == Phase::Acting {
            return Verdict::Ignored("this exchange has its actions already");
        }
        // Actions for an observation that seems unsent are its receipt: the learner has it, and it answers only what
        // the recorder has, too.
        state.phase = Phase::Acting;
        state.stage_version = header.stage_version;
        Verdict::Accepted
    }

    pub fn next(&self, now: Duration) -> Todo {
        if self.learner_incarnation.is_none() || !self.met {
            let left = self.hello_due.saturating_sub(now);
            let longest = if self.met { WAIT_MAX } else { MEETING_INTERVAL };
            return if left.is_zero() { Todo::Hello } else { Todo::Wait(left.min(longest)) };
        }
        let mut wait = WAIT_MAX;
        for offset in 1..=self.halves.count() {
            let half = (self.served_last + offset) % self.halves.count();
            match self.half[half as usize].phase {
                Phase::Acting => return Todo::Act { half },
                Phase::Sending { not_before } if not_before <= now => return Todo::Send { half },
                Phase::Sending { not_before } => wait = wait.min(not_before.saturating_sub(now)),
                Phase::Awaiting => {}
            }
        }
        Todo::Wait(wait)
    }

    pub fn hello_sent(&mut self, now: Duration) {
        self.hello_due = now + HELLO_INTERVAL;
    }

    /// The accepted actions of a half have been applied: its next observation is due. Panics if the half had none.
    pub fn acted(&mut self, half: u32, now: Duration) {
        let state = &mut self.half[half as usize];
        assert_eq!(state.phase, Phase::Acting, "actions are applied when there are some");
        state.step += 1;
        state.phase = Phase::Sending { not_before: now };
        // The half keeps its turn: what was simulated is sent before the other half is simulated.
        self.served_last = (half + self.halves.count() - 1) % self.halves.count();
    }

    /// A half's observations were sent. If not every subscriber got them, they are due again later.
    pub fn sent(&mut self, half: u32, everyone: bool, now: Duration) {
        self.half[half as usize].phase =
            if everyone { Phase::Awaiting } else { Phase::Sending { not_before: now + RESEND_INTERVAL } };
        self.served_last = half;
    }

    pub fn hello_header(&self) -> ObservationHeader {
        ObservationHeader {
            kind: observation_kind::HELLO,
            actor: self.actor,
            actor_incarnation: self.incarnation,
            ..Default::default()
        }
    }

    /// Header of a half's observations. Panics if no restore has been accepted yet.
    pub fn observation_header(&self, half: u32) -> ObservationHeader {
        let state = self.half[half as usize];
        ObservationHeader {
            step: state.step,
            stage_version: state.stage_version,
            kind: observation_kind::OBSERVATIONS,
            actor: self.actor,
            actor_incarnation: self.incarnation,
            learner_incarnation: self.learner_incarnation.expect("observations follow a restore"),
            half,
            reserved: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const T0: Duration = Duration::ZERO;

    fn restore(learner_incarnation: u32, actor_incarnation: u32, step: [u64; 2]) -> RestoreHeader {
        RestoreHeader { step, stage_version: 1, learner_incarnation, actor_incarnation }
    }

    fn actions(learner_incarnation: u32, half: u32, step: u64) -> ActionHeader {
        ActionHeader { step, stage_version: 2, learner_incarnation, half }
    }

    /// An actor of `environments` with both halves' observations of step 10 out.
    fn talking(environments: u32) -> Protocol {
        let mut protocol = Protocol::new(3, 7, environments, false);
        assert_eq!(protocol.on_restore(&restore(1, 0, [10, 10]), environments as usize, T0), Verdict::Accepted);
        for half in 0..protocol.halves().count() {
            assert_eq!(protocol.next(T0), Todo::Send { half });
            protocol.sent(half, true, T0);
        }
        protocol
    }

    fn ignored(verdict: Verdict) -> bool {
        matches!(verdict, Verdict::Ignored(_))
    }

    #[test]
    fn a_half_is_simulated_and_sent_before_the_other_is_simulated() {
        let mut protocol = talking(4);
        protocol.on_actions(&actions(1, 1, 10), 2);
        protocol.on_actions(&actions(1, 0, 10), 2);
        let mut order = vec![];
        loop {
            let todo = protocol.next(T0);
            order.push(todo);
            match todo {
                Todo::Act { half } => protocol.acted(half, T0),
                Todo::Send { half } => protocol.sent(half, true, T0),
                _ => break,
            }
        }
        let turns = [Todo::Act { half: 0 }, Todo::Send { half: 0 }, Todo::Act { half: 1 }, Todo::Send { half: 1 }];
        assert_eq!(order[..4], turns);
    }

    #[test]
    fn a_late_answer_to_a_hello_does_not_rewind() {
        let mut protocol = talking(3);
        protocol.on_actions(&actions(1, 0, 10), 2);
        protocol.acted(0, T0);
        protocol.sent(0, true, T0);
        assert!(ignored(protocol.on_restore(&restore(1, 7, [10, 10]), 3, T0)));
        assert!(ignored(protocol.on_restore(&restore(1, 7, [10, 11]), 3, T0)));
        assert_eq!(protocol.on_actions(&actions(1, 0, 11), 2), Verdict::Accepted);
        assert!(ignored(protocol.on_restore(&restore(1, 7, [12, 11]), 3, T0)), "the learner cannot be ahead either");
        assert_eq!(protocol.next(T0), Todo::Act { half: 0 });
        assert_eq!(protocol.observation_header(0).step, 11);
    }

    #[test]
    fn a_late_answer_to_a_hello_does_not_erase_accepted_actions() {
        let mut protocol = talking(3);
        assert_eq!(protocol.on_actions(&actions(1, 1, 10), 1), Verdict::Accepted);
        assert!(ignored(protocol.on_restore(&restore(1, 7, [10, 10]), 3, T0)));
        assert_eq!(protocol.next(T0), Todo::Act { half: 1 }, "the learner will not send them again");
        protocol.acted(1, T0);
        assert_eq!(protocol.observation_header(1).step, 11);
    }
}
