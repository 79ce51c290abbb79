//! All services of one session, with the settings of the real ones (`proto/wire/src/services.rs`).

use crate::service::{Full, Service, Settings, TaskId};
use proto::shares::Shares;
use std::rc::Rc;
use wire::message::{ActionHeader, EnvironmentState, Line, ObservationHeader, RestoreHeader, StageAnnouncement};

/// An observation sample: header, and the records of one half's environments without their frames.
pub type Observations = (ObservationHeader, Rc<Vec<Vec<Line>>>);
pub type Restore = (RestoreHeader, Rc<Vec<EnvironmentState>>);
pub type Actions = (ActionHeader, Rc<Vec<u8>>);

/// Ports that a restarted process may need while its dead predecessor's are not swept yet.
const RESTART_MARGIN: usize = 2;

#[derive(Debug)]
pub struct Wire {
    /// By rank.
    pub observations: Vec<Service<Observations>>,
    /// By actor.
    pub restores: Vec<Service<Restore>>,
    /// By actor.
    pub actions: Vec<Service<Actions>>,
    pub stage: Service<StageAnnouncement>,
}

impl Wire {
    /// The services of a run with these processes.
    pub fn new(shares: Shares) -> Self {
        let one = Settings {
            buffer: 1,
            borrowed: 1,
            full: Full::Replace,
            history: false,
            publishers: RESTART_MARGIN,
            subscribers: RESTART_MARGIN,
        };
        let observations = |rank| {
            let publishers = shares.actors_of(rank).len() * RESTART_MARGIN;
            Service::new(Settings {
                buffer: 2,
                borrowed: 2,
                full: Full::Block,
                history: false,
                publishers,
                subscribers: 3,
            })
        };
        let subscribers = shares.learners() as usize * RESTART_MARGIN;
        Self {
            observations: (0..shares.learners()).map(observations).collect(),
            restores: (0..shares.actors()).map(|_| Service::new(one)).collect(),
            actions: (0..shares.actors())
                .map(|_| Service::new(Settings { buffer: 4, full: Full::Discard, ..one }))
                .collect(),
            stage: Service::new(Settings { history: true, publishers: 1, subscribers, ..one }),
        }
    }

    /// A task is dead; from `at` on that can be known.
    pub fn died(&mut self, task: TaskId, at: u64) {
        self.observations.iter_mut().for_each(|service| service.died(task, at));
        self.restores.iter_mut().for_each(|service| service.died(task, at));
        self.actions.iter_mut().for_each(|service| service.died(task, at));
        self.stage.died(task, at);
    }

    /// Removes the ports of those who are known to be dead; the tasks that may go on.
    pub fn sweep(&mut self, now: u64) -> Vec<TaskId> {
        let mut awake = self.stage.sweep(now);
        awake.extend(self.observations.iter_mut().flat_map(|service| service.sweep(now)));
        awake.extend(self.restores.iter_mut().flat_map(|service| service.sweep(now)));
        awake.extend(self.actions.iter_mut().flat_map(|service| service.sweep(now)));
        awake
    }
}
