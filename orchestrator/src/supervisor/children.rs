//! The processes of a run: which of them run, and when those that died are to be started again. Pure.

use super::event::Process;
use std::collections::BTreeMap;
use std::time::Duration;

struct Child {
    incarnation: u32,
    state: ChildState,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ChildState {
    /// Not running; to be started at the given time, if any. [`super::learner_group`] holds the start time of learners.
    Down {
        restart_at: Option<Duration>,
    },
    Up {
        since: Duration,
        killed: Option<Duration>,
    },
}

pub struct Children {
    children: BTreeMap<Process, Child>,
}

impl Children {
    pub fn new(learners: u32, actors: u32) -> Self {
        let child = || Child { incarnation: 0, state: ChildState::Down { restart_at: None } };
        let processes = (0..learners).map(Process::Learner).chain((0..actors).map(Process::Actor));
        Self { children: processes.map(|process| (process, child())).collect() }
    }

    fn child(&mut self, process: Process) -> &mut Child {
        self.children.get_mut(&process).expect("all processes are in the map from the start")
    }

    // What happens to them

    pub fn start(&mut self, process: Process, now: Duration) -> u32 {
        let child = self.child(process);
        assert!(matches!(child.state, ChildState::Down { .. }), "{process} is never started twice");
        child.incarnation += 1;
        child.state = ChildState::Up { since: now, killed: None };
        child.incarnation
    }

    /// One is to be killed; false if it does not run, or has been killed already.
    pub fn kill(&mut self, process: Process, now: Duration) -> bool {
        match &mut self.child(process).state {
            ChildState::Up { killed, .. } if killed.is_none() => {
                *killed = Some(now);
                true
            }
            ChildState::Up { .. } | ChildState::Down { .. } => false,
        }
    }

    /// One ended; false if it is none of these, or not the incarnation that runs.
    pub fn end(&mut self, process: Process, incarnation: u32) -> bool {
        let runs = self.runs(process, incarnation);
        if runs {
            self.child(process).state = ChildState::Down { restart_at: None };
        }
        runs
    }

    pub fn lose(&mut self, process: Process) {
        self.child(process).state = ChildState::Down { restart_at: None };
    }

    pub fn restart(&mut self, process: Process, at: Duration) {
        self.child(process).state = ChildState::Down { restart_at: Some(at) };
    }

    pub fn stay_down(&mut self) {
        for child in self.children.values_mut() {
            if let ChildState::Down { restart_at } = &mut child.state {
                *restart_at = None;
            }
        }
    }

    // How they stand

    pub fn is_killed(&self, process: Process) -> bool {
        let child = self.children.get(&process);
        child.is_some_and(|child| matches!(child.state, ChildState::Up { killed: Some(_), .. }))
    }

    pub fn runs(&self, process: Process, incarnation: u32) -> bool {
        let child = self.children.get(&process);
        child.is_some_and(|child| child.incarnation == incarnation && matches!(child.state, ChildState::Up { .. }))
    }

    pub fn alive_since(&self, process: Process) -> Option<Duration> {
        match self.children.get(&process)?.state {
            ChildState::Up { since, killed: None } => Some(since),
            ChildState::Up { .. } | ChildState::Down { .. } => None,
        }
    }

    pub fn is_down(&self, process: Process) -> bool {
        matches!(self.children[&process].state, ChildState::Down { .. })
    }

    pub fn incarnation(&self, process: Process) -> u32 {
        self.children[&process].incarnation
    }

    pub fn due(&self, now: Duration) -> Vec<Process> {
        let due = |child: &Child| matches!(child.state, ChildState::Down { restart_at: Some(at) } if at <= now);
        self.children.iter().filter(|(_, child)| due(child)).map(|(process, _)| *process).collect()
    }

    pub fn up(&self) -> Vec<(Process, Option<Duration>)> {
        let up = |(process, child): (&Process, &Child)| match child.state {
            ChildState::Up { killed, .. } => Some((*process, killed)),
            ChildState::Down { .. } => None,
        };
        self.children.iter().filter_map(up).collect()
    }
}
