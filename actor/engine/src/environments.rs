//! The environments of one actor: stepping them, rebuilding them, and showing what they see. Whatever simulates them.

use crate::error::EngineError;
use crate::simulator::Simulator;
use crate::whereabouts::{self, Whereabouts};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose};
use proto::record::{HOLD, RecordHeader};
use proto::task::Layout;
use std::collections::VecDeque;
use std::ops::Range;
use wire::message::EnvironmentState;

/// All environments of an actor.
pub struct Environments<S> {
    running: Vec<Running>,
    simulator: S,
    rules: Rules,
    /// Environments whose next episode's start may be prepared further, first to last.
    unprepared: VecDeque<usize>,
}

/// What holds for all of them.
struct Rules {
    /// Where everything lies in a record.
    layout: &'static Layout,
    /// How many actions the task has.
    actions: usize,
    seed: u64,
    /// Share of the episodes whose frames are recorded.
    recorded: f64,
}

/// One environment in its current episode.
struct Running {
    /// What it is called wherever it is.
    home: EnvironmentId,
    /// The same with the scene that it is in.
    id: EnvironmentId,
    /// What the last exchange did, and which episode and state it led to.
    header: RecordHeader,
    /// The last action, 0 if none was taken; and that before what is seen now, 0 at an episode's start.
    actions: [u8; 2],
    /// What the last action did: parts and outcomes, as in a record.
    done: Vec<u8>,
}

impl Rules {
    /// Those of a run.
    fn of(config: &Config) -> Self {
        let spec = config.spec();
        Self {
            layout: spec.layout(),
            actions: spec.actions.names().len(),
            seed: config.seed,
            recorded: if config.recording.enabled { config.recording.depth_share } else { 0.0 },
        }
    }

    /// Whether the frames of an episode are recorded.
    fn records(&self, id: EnvironmentId, episode: u32) -> bool {
        let key = Key::episode(self.seed, Purpose::Recording, id.kitchen, id.number, episode);
        key.stream().uniform_open() < self.recorded
    }

    /// Begins an episode.
    fn begin<S: Simulator>(&self, running: &mut Running, simulator: &mut S, episode: u32) -> Result<(), EngineError> {
        running.id = simulator.place(running.home, episode);
        whereabouts::enter(running.id, episode);
        let index = running.header.environment as usize;
        let state_hash = simulator.begin(index, running.home, episode).map_err(failed::<S>)?;
        running.header.begin(episode, state_hash, self.records(running.id, episode));
        running.actions[1] = 0;
        Ok(())
    }

    /// Takes an action that the task has; after the last one of an episode the environment stands at the start of the
    /// next.
    fn act<S: Simulator>(&self, running: &mut Running, simulator: &mut S, action: u8) -> Result<(), EngineError> {
        whereabouts::enter(running.id, running.header.episode);
        let index = running.header.environment as usize;
        let (state_hash, end) = simulator.act(index, &[action], &mut running.done).map_err(failed::<S>)?;
        running.actions = [action; 2];
        running.header.act(state_hash, end);
        if end.is_some() {
            let next = running.next_episode().expect("four billion episodes outlast any run");
            self.begin(running, simulator, next)?;
        }
        Ok(())
    }

    /// Whether the task has an action.
    fn has(&self, action: u8) -> bool {
        usize::from(action) < self.actions
    }
}

/// An environment's failure.
fn failed<S: Simulator>(cause: S::Error) -> EngineError {
    EngineError::Simulator(cause.into())
}

impl Running {
    /// Nothing was done.
    fn hold(&mut self) {
        self.header.hold();
        self.actions[0] = 0;
        self.done.fill(0);
    }

    fn next_episode(&self) -> Option<u32> {
        self.header.episode.checked_add(1)
    }

    fn place(&self) -> Whereabouts {
        Whereabouts { environment: self.id, episode: self.header.episode }
    }
}

impl<S: Simulator> Environments<S> {
    /// Environments of these names, each in its episode 0.
    pub fn new(mut simulator: S, homes: &[EnvironmentId], config: &Config) -> Result<Self, EngineError> {
        if homes.is_empty() {
            return Err(EngineError::NoEnvironments);
        }
        let rules = Rules::of(config);
        simulator.announce(homes.iter().map(|&home| simulator.place(home, 0)));
        let mut running = Vec::new();
        for (index, &home) in (0..).zip(homes) {
            let header = RecordHeader { environment: index, ..RecordHeader::default() };
            let done = vec![0; rules.layout.of_action.len()];
            let mut one = Running { home, id: home, header, actions: [0; 2], done };
            rules.begin(&mut one, &mut simulator, 0)?;
            running.push(one);
        }
        Ok(Self { unprepared: (0..running.len()).collect(), running, simulator, rules })
    }

    /// What simulates them.
    pub fn simulator(&mut self) -> &mut S {
        &mut self.simulator
    }

    /// How many there are.
    pub fn count(&self) -> u32 {
        self.running.len() as u32
    }

    /// Prepares episodes that come next, by a piece of work of about a quarter of a millisecond: for whoever has nothing
    /// to do but wait. Returns whether there was anything to prepare. To start an episode takes as long as ten steps, and
    /// while one environment does, everybody else waits for its actor.
    pub fn prepare(&mut self) -> bool {
        let Some(&index) = self.unprepared.front() else { return false };
        let running = &self.running[index];
        let more = running.next_episode().is_some_and(|next| {
            whereabouts::enter(self.simulator.place(running.home, next), next);
            self.simulator.prepare(index, running.home, next)
        });
        if !more {
            self.unprepared.pop_front();
        }
        true
    }

    /// Puts every environment into the state that its actions lead to. Nothing is rendered on the way, and what was
    /// simulated before does not matter. All take their last actions at the same moment, so that environments which step
    /// together do so here, too.
    pub fn rebuild(&mut self, states: &[EnvironmentState]) -> Result<(), EngineError> {
        let Self { running, simulator, rules, unprepared } = self;
        assert_eq!(states.len(), running.len(), "a restore holds one state an environment");
        *unprepared = (0..states.len()).collect();
        let counts: Vec<usize> = states.iter().map(|state| state.actions().len()).collect();
        let moments = counts.iter().copied().max().unwrap_or_default();
        let mut order: Vec<usize> = (0..states.len()).collect();
        order.sort_by_key(|&index| moments - counts[index]);
        let places = order.iter().map(|&index| {
            let place = simulator.place(running[index].home, states[index].episode);
            (place != running[index].id).then_some(place)
        });
        simulator.announce(places.collect::<Vec<_>>().into_iter().flatten());
        let mut actions = vec![HOLD; states.len()];
        for moment in 0..=moments {
            let begun = |index: &usize| counts[*index] + moment >= moments;
            for &index in order.iter().filter(|&&index| counts[index] + moment == moments) {
                running[index].hold();
                rules.begin(&mut running[index], simulator, states[index].episode)?;
            }
            if moment == moments {
                break;
            }
            for index in order.iter().copied().filter(begun) {
                let step = counts[index] + moment - moments;
                let (action, place) = (states[index].actions()[step], running[index].place());
                if !rules.has(action) {
                    return Err(EngineError::NoSuchActionBefore { action, step, place });
                }
                actions[index] = action;
            }
            simulator.act_together(0, &actions).map_err(failed::<S>)?;
            for index in order.iter().copied().filter(begun) {
                let place = running[index].place();
                rules.act(&mut running[index], simulator, actions[index])?;
                let (taken, all) = (counts[index] + moment - moments + 1, counts[index]);
                if running[index].header.end().is_some() && taken < all {
                    return Err(EngineError::EndsEarlier { actions: all, place, ended: taken });
                }
            }
        }
        Ok(())
    }

    /// Applies one action to each environment of `range`. HOLD leaves an environment as it is.
    pub fn act(&mut self, range: Range<usize>, actions: &[u8]) -> Result<(), EngineError> {
        assert_eq!(range.len(), actions.len(), "one action an environment");
        for (index, &action) in range.clone().zip(actions) {
            if action != HOLD && !self.rules.has(action) {
                return Err(EngineError::NoSuchAction { action, place: self.running[index].place() });
            }
        }
        self.simulator.act_together(range.start, actions).map_err(failed::<S>)?;
        for (index, &action) in range.zip(actions) {
            let running = &mut self.running[index];
            let episode = running.header.episode;
            if action == HOLD {
                running.hold();
            } else {
                self.rules.act(running, &mut self.simulator, action)?;
            }
            if running.header.episode != episode && !self.unprepared.contains(&index) {
                self.unprepared.push_back(index);
            }
        }
        Ok(())
    }

    /// Writes the record of environment `index`, its images in place.
    ///
    /// # Panics
    /// If the record has not the task's size.
    pub fn observe(&mut self, index: usize, record: &mut [u8]) -> Result<(), EngineError> {
        let Self { running, simulator, rules: Rules { layout, .. }, .. } = self;
        let running = &running[index];
        whereabouts::enter(running.id, running.header.episode);
        record[..layout.small_bytes].fill(0);
        for (field, action) in [layout.action, layout.previous_action].into_iter().zip(running.actions) {
            record[field.offset] = action;
        }
        record[layout.of_action.clone()].copy_from_slice(&running.done);
        let mut header = running.header;
        simulator.observe(index, &mut header, record).map_err(failed::<S>)?;
        *RecordHeader::of_mut(record) = header;
        Ok(())
    }
}
