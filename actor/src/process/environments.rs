//! The environments of one actor: stepping them, rebuilding them, and showing what they see. Whatever the task, and
//! wherever they are.

use super::prefetcher::KitchenPrefetcher;
use super::scenes::Scenes;
use super::whereabouts;
use anyhow::{Result, bail, ensure};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use proto::record::{HOLD, RecordHeader};
use proto::task::Layout;
use simulator::environment::Environment;
use std::collections::VecDeque;
use std::ops::Range;
use wire::message::EnvironmentState;

/// All environments of an actor.
pub struct Environments {
    running: Vec<Running>,
    scenes: Scenes,
    engine: Engine,
    /// Environments whose next episode's start may be prepared further, first to last.
    unprepared: VecDeque<usize>,
}

/// What holds for all of them.
struct Engine {
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
    environment: Box<dyn Environment>,
    /// What the last exchange did, and which episode and state it led to.
    header: RecordHeader,
    /// The last action, 0 if none was taken; and that before what is seen now, 0 at an episode's start.
    actions: [u8; 2],
    /// What the last action did: parts and outcomes, as in a record.
    done: Vec<u8>,
}

impl Engine {
    /// Whether the frames of an episode are recorded.
    fn records(&self, id: EnvironmentId, episode: u32) -> bool {
        let key = Key::episode(self.seed, Purpose::Recording, id.kitchen, id.number, episode);
        key.stream().uniform_open() < self.recorded
    }

    /// Notes that an environment is at the start of an episode.
    fn begin(&self, running: &mut Running, episode: u32) {
        let records = self.records(running.id, episode);
        running.header.begin(episode, running.environment.base().state_hash(), records);
        running.actions[1] = 0;
    }

    /// Begins an episode, in another scene where it is there.
    fn start(&self, running: &mut Running, scenes: &mut Scenes, episode: u32) -> Result<()> {
        let place = scenes.place(running.home, episode);
        whereabouts::enter(place, episode);
        let moves = place != running.id;
        if moves {
            let index = running.header.environment as usize;
            (running.id, running.environment) = scenes.enter(index, running.home, episode)?;
        } else {
            running.environment.begin(episode);
        }
        scenes.look_ahead(running.home, episode, moves);
        self.begin(running, episode);
        Ok(())
    }

    /// Takes an action; after the last one of an episode the environment stands at the start of the next. False if the
    /// task has no such action.
    fn act(&self, running: &mut Running, scenes: &mut Scenes, action: u8) -> Result<bool> {
        if usize::from(action) >= self.actions {
            return Ok(false);
        }
        whereabouts::enter(running.id, running.header.episode);
        running.environment.act(&[action], &mut running.done);
        let base = running.environment.base();
        let end = base.end();
        running.actions = [action; 2];
        running.header.act(base.state_hash(), end);
        if end.is_some() {
            let next = running.next_episode().expect("four billion episodes outlast any run");
            self.start(running, scenes, next)?;
        }
        Ok(true)
    }
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

    /// Does a piece of the next episode's start. Returns whether there is more to do. One in another scene, of which there
    /// is one in every `kitchens.episodes_each`, is not prepared.
    fn prepare(&mut self, scenes: &Scenes) -> bool {
        let Some(next) = self.next_episode() else { return false };
        let place = scenes.place(self.home, next);
        whereabouts::enter(place, next);
        if place != self.id {
            self.environment.base_mut().forget_past();
            return false;
        }
        self.environment.prepare(next)
    }
}

impl Environments {
    /// The environments of actor `actor`, each in its episode 0; with `kitchen` all in that one instead of their own.
    pub fn new(prefetcher: KitchenPrefetcher, kitchen: Option<KitchenId>, actor: u32, config: &Config) -> Result<Self> {
        let count = config.actors.environments_per_actor;
        let homes: Vec<EnvironmentId> = (0..count)
            .map(|index| {
                let home = EnvironmentId::among(config.kitchens(), actor, index, count);
                EnvironmentId { kitchen: kitchen.unwrap_or(home.kitchen), ..home }
            })
            .collect();
        let mut scenes = Scenes::of(prefetcher, config)?;
        scenes.order(homes.iter().map(|&home| scenes.place(home, 0)));
        let spec = config.spec();
        let engine = Engine {
            layout: spec.layout(),
            actions: spec.actions.names().len(),
            seed: config.seed,
            recorded: if config.recording.enabled { config.recording.depth_share } else { 0.0 },
        };
        let mut running = Vec::new();
        for (index, home) in homes.into_iter().enumerate() {
            let (id, environment) = scenes.enter(index, home, 0)?;
            scenes.look_ahead(home, 0, true);
            let header = RecordHeader { environment: index as u32, ..RecordHeader::default() };
            let done = vec![0; engine.layout.of_action.len()];
            let mut one = Running { home, id, environment, header, actions: [0; 2], done };
            engine.begin(&mut one, 0);
            running.push(one);
        }
        ensure!(!running.is_empty(), "an actor has environments");
        Ok(Self { unprepared: (0..running.len()).collect(), running, scenes, engine })
    }

    /// Triangles that the camera has to choose from, in the first environment's scene.
    pub fn triangles(&mut self) -> usize {
        self.scenes.triangles()
    }

    /// Bodies of the first environment's scene.
    pub fn bodies(&self) -> usize {
        self.running[0].environment.base().kitchen().bodies().len()
    }

    /// Prepares episodes that come next, by a piece of work of about a quarter of a millisecond: for whoever has nothing
    /// to do but wait. Returns whether there was anything to prepare. To start an episode takes as long as ten steps, and
    /// while one environment does, everybody else waits for its actor.
    pub fn prepare(&mut self) -> bool {
        let Some(&index) = self.unprepared.front() else { return false };
        if !self.running[index].prepare(&self.scenes) {
            self.unprepared.pop_front();
        }
        true
    }

    /// Puts every environment into the state that its actions lead to. Nothing is rendered on the way, and what was
    /// simulated before does not matter.
    pub fn rebuild(&mut self, states: &[EnvironmentState]) -> Result<()> {
        let Self { running, scenes, engine, unprepared } = self;
        assert_eq!(states.len(), running.len(), "a restore holds one state an environment");
        *unprepared = (0..states.len()).collect();
        let places = running.iter().zip(states).map(|(running, state)| {
            let place = scenes.place(running.home, state.episode);
            (place != running.id).then_some(place)
        });
        scenes.order(places.flatten());
        for (running, state) in running.iter_mut().zip(states) {
            running.hold();
            engine.start(running, scenes, state.episode)?;
            let actions = state.actions();
            for (step, &action) in actions.iter().enumerate() {
                let here = running.id;
                if !engine.act(running, scenes, action)? {
                    bail!("a restore names action {action} at step {step} of {}: there is none", place(running));
                }
                let ended = running.header.end().is_some();
                ensure!(
                    !ended || step + 1 == actions.len(),
                    "a restore has {} actions for episode {} of kitchen {}, environment {}, which ends after {}: \
                     was the run recorded with another version of the simulator?",
                    actions.len(),
                    state.episode,
                    here.kitchen,
                    here.number,
                    step + 1
                );
            }
        }
        Ok(())
    }

    /// Applies one action to each environment of `range`. HOLD leaves an environment as it is.
    pub fn act(&mut self, range: Range<usize>, actions: &[u8]) -> Result<()> {
        assert_eq!(range.len(), actions.len(), "one action an environment");
        for (index, &action) in range.zip(actions) {
            let running = &mut self.running[index];
            let episode = running.header.episode;
            if action == HOLD {
                running.hold();
            } else if !self.engine.act(running, &mut self.scenes, action)? {
                bail!("the learner sent action {action} to {}: there is none", place(running));
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
    pub fn observe(&mut self, index: usize, record: &mut [u8]) {
        let Self { running, scenes, engine: Engine { layout, .. }, .. } = self;
        let running = &mut running[index];
        whereabouts::enter(running.id, running.header.episode);
        record[..layout.small_bytes].fill(0);
        for (field, action) in [layout.action, layout.previous_action].into_iter().zip(running.actions) {
            record[field.offset] = action;
        }
        record[layout.of_action.clone()].copy_from_slice(&running.done);
        running.environment.observe(&mut record[layout.seen.clone()]);
        let mut header = running.header;
        scenes.look(index, running.environment.base_mut(), &mut header, record);
        *RecordHeader::of_mut(record) = header;
    }
}

fn place(running: &Running) -> whereabouts::Whereabouts {
    whereabouts::Whereabouts { environment: running.id, episode: running.header.episode }
}

#[cfg(test)]
mod tests;
