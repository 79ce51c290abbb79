//! The environments of one actor: stepping them, rebuilding them, and showing what they see. Whatever simulates them.

use crate::error::EngineError;
use crate::simulator::Simulator;
use crate::whereabouts::{self, Whereabouts};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose};
use proto::record::{End, HOLD, RecordHeader};
use proto::task::{Layout, Restore};
use std::collections::VecDeque;
use std::ops::Range;
use wire::message::{EnvironmentState, Snapshot};

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
    restore: Restore,
    max_steps: u32,
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
    /// It cannot be brought back to where the learner has it: its next action ends the episode, as a truncation without a
    /// reward. Until then it shows another episode's start.
    is_lost: bool,
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
            restore: spec.restore,
            max_steps: config.episode.max_steps,
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

    /// Puts an environment where it was before the last action of an episode.
    fn restore<S: Simulator>(
        &self,
        running: &mut Running,
        simulator: &mut S,
        state: &EnvironmentState,
        snapshot: &Snapshot,
    ) -> Result<u32, EngineError> {
        let (episode, step) = (state.episode, state.action_count() - 1);
        running.id = simulator.place(running.home, episode);
        whereabouts::enter(running.id, episode);
        let index = running.header.environment as usize;
        simulator.restore(index, running.home, episode, step, snapshot).map_err(failed::<S>)?;
        running.header.begin(episode, snapshot.state_hash, self.records(running.id, episode));
        running.header.step = step;
        Ok(step)
    }

    /// Lets an environment that cannot be brought back stand as if an episode's last action had led nowhere.
    fn lose<S: Simulator>(
        &self,
        running: &mut Running,
        simulator: &mut S,
        state: &EnvironmentState,
        step: u32,
        last: u8,
    ) -> Result<(), EngineError> {
        let ended = state.has_ended() || state.action_count() >= self.max_steps;
        self.begin(running, simulator, state.episode)?;
        running.header.step = step;
        running.header.act(running.header.state_hash, ended.then_some(End::Truncated));
        running.actions = [last; 2];
        running.is_lost = !ended;
        if ended {
            let next = running.next_episode().expect("four billion episodes outlast any run");
            self.begin(running, simulator, next)?;
        }
        Ok(())
    }

    /// Takes an action; after the last one of an episode the environment stands at the start of the next. False if the
    /// task has no such action.
    fn act<S: Simulator>(&self, running: &mut Running, simulator: &mut S, action: u8) -> Result<bool, EngineError> {
        if usize::from(action) >= self.actions {
            return Ok(false);
        }
        whereabouts::enter(running.id, running.header.episode);
        let index = running.header.environment as usize;
        let (state_hash, end) = if running.is_lost {
            running.is_lost = false;
            running.done.fill(0);
            (0, Some(End::Truncated))
        } else {
            simulator.act(index, &[action], &mut running.done).map_err(failed::<S>)?
        };
        running.actions = [action; 2];
        running.header.act(state_hash, end);
        if end.is_some() {
            let next = running.next_episode().expect("four billion episodes outlast any run");
            self.begin(running, simulator, next)?;
        }
        Ok(true)
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
            let mut one = Running { home, id: home, header, actions: [0; 2], done, is_lost: false };
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
    /// simulated before does not matter.
    pub fn rebuild(&mut self, states: &[EnvironmentState]) -> Result<(), EngineError> {
        let Self { running, simulator, rules, unprepared } = self;
        assert_eq!(states.len(), running.len(), "a restore holds one state an environment");
        *unprepared = (0..states.len()).collect();
        let places = running.iter().zip(states).map(|(running, state)| {
            let place = simulator.place(running.home, state.episode);
            (place != running.id).then_some(place)
        });
        simulator.announce(places.collect::<Vec<_>>().into_iter().flatten());
        for (running, state) in running.iter_mut().zip(states) {
            running.hold();
            running.is_lost = false;
            let actions = state.actions();
            let taken = match (rules.restore, state.snapshot(), actions) {
                (Restore::None, _, [before @ .., last]) => {
                    rules.lose(running, simulator, state, before.len() as u32, *last)?;
                    continue;
                }
                (_, Some(snapshot), _) => rules.restore(running, simulator, state, snapshot)?,
                _ => {
                    rules.begin(running, simulator, state.episode)?;
                    0
                }
            };
            let place = running.place();
            for (step, &action) in actions.iter().enumerate().skip(taken as usize) {
                if !rules.act(running, simulator, action)? {
                    return Err(EngineError::NoSuchActionBefore { action, step, place });
                }
                let ended = running.header.end().is_some();
                if ended && step + 1 < actions.len() {
                    return Err(EngineError::EndsEarlier { actions: actions.len(), place, ended: step + 1 });
                }
            }
        }
        Ok(())
    }

    /// Applies one action to each environment of `range`. HOLD leaves an environment as it is.
    pub fn act(&mut self, range: Range<usize>, actions: &[u8]) -> Result<(), EngineError> {
        assert_eq!(range.len(), actions.len(), "one action an environment");
        for (index, &action) in range.zip(actions) {
            let running = &mut self.running[index];
            let episode = running.header.episode;
            if action == HOLD {
                running.hold();
            } else if !self.rules.act(running, &mut self.simulator, action)? {
                return Err(EngineError::NoSuchAction { action, place: running.place() });
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
