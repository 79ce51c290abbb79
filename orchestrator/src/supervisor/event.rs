use super::stage_machine::StageSwitch;
use proto::event::LearnerEvent;
use proto::kitchen::Kitchens;
use proto::run_state::Ending;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use wire::message::StageAnnouncement;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Process {
    Learner(u32),
    Actor(u32),
}

impl Display for Process {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Learner(rank) => write!(f, "learner-{rank}"),
            Self::Actor(actor) => write!(f, "actor-{actor:02}"),
        }
    }
}

impl Process {
    pub fn describe(self, kitchens: Kitchens) -> String {
        match self {
            Self::Learner(_) => self.to_string(),
            Self::Actor(actor) => match kitchens.of_actor(actor) {
                Some(kitchen) => format!("{self} (kitchen {kitchen})"),
                None => self.to_string(),
            },
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Exit {
    Code(i32),
    Signal(i32),
    /// The orchestrator killed it, and has said why.
    Killed,
    NotStarted(String),
}

impl Display for Exit {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Code(code) => write!(f, "exit status {code}"),
            Self::Signal(signal) => match signal_name(*signal) {
                Some(name) => write!(f, "signal {signal} ({name})"),
                None => write!(f, "signal {signal}"),
            },
            Self::Killed => f.write_str("killed by the orchestrator"),
            Self::NotStarted(cause) => write!(f, "it could not be started: {cause}"),
        }
    }
}

fn signal_name(signal: i32) -> Option<&'static str> {
    Some(match signal {
        2 => "SIGINT",
        4 => "SIGILL: an instruction this processor does not have",
        6 => "SIGABRT",
        7 => "SIGBUS: shared memory or the disk behind a mapped file is full",
        8 => "SIGFPE",
        9 => "SIGKILL: killed, perhaps by the kernel for want of memory",
        11 => "SIGSEGV",
        15 => "SIGTERM",
        _ => return None,
    })
}

#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    Exited {
        process: Process,
        incarnation: u32,
        exit: Exit,
        last_words: Vec<String>,
    },
    Learner {
        incarnation: u32,
        event: LearnerEvent,
    },
    Tick,
    /// Request for an orderly stop (`orchestrator stop`, SIGTERM, SIGHUP). Asking twice changes nothing.
    Stop,
    /// The number of actors is to change (`orchestrator scale`): the learners are to save before a rollout.
    Scale {
        /// Which; none: the next one that has not been announced.
        before: Option<u64>,
    },
    /// Ctrl-C: the first is an orderly stop, the second ends everything at once.
    Interrupt,
    /// The recording or the figures of the run cannot be written any more: a run that can no longer be observed is
    /// ended.
    CannotWrite(String),
    HostLost {
        processes: Vec<Process>,
        reason: String,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    Info,
    Warning,
    Error,
}

#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    Spawn { process: Process, incarnation: u32 },
    CloseLifeline(Process),
    Kill(Process),
    Announce(StageAnnouncement),
    SwitchStage(StageSwitch),
    Report(Level, String),
    Finish(Outcome),
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    pub end: SessionEnd,
    /// State that the learners saved before they exited; none if they did not report any.
    pub saved: Option<Saved>,
}

/// How a session ended, with the reason of a failure; [`Ending`] is the word for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SessionEnd {
    Complete,
    Stopped,
    /// The same, by a scheduler that starts the run again.
    Requeued,
    /// The run goes on at once, with so many actors.
    Scaled(u32),
    Interrupted,
    Failed(String),
    HostLost(String),
}

impl SessionEnd {
    pub fn ending(&self) -> Ending {
        match self {
            Self::Complete => Ending::Complete,
            Self::Stopped | Self::Requeued | Self::Scaled(_) => Ending::Stopped,
            Self::Interrupted => Ending::Interrupted,
            Self::Failed(_) | Self::HostLost(_) => Ending::Failed,
        }
    }

    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Failed(reason) | Self::HostLost(reason) => Some(reason),
            Self::Complete | Self::Stopped | Self::Requeued | Self::Scaled(_) | Self::Interrupted => None,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    pub frames: u64,
    pub weights: String,
}
