//! The environments of one actor: stepping them, rebuilding them, and showing what they see.

use super::larder::{Larder, Opened, Order};
use super::whereabouts;
use anyhow::{Context, Result, bail, ensure};
use proto::action::{Action, HOLD};
use proto::camera::{FRAME_SIDE, SUMS_PIXELS, WINDOW};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use proto::record::{RecordHeader, flag};
use proto::rota::Rota;
use proto::task::Layout;
use simulator::depth::{DepthCamera, Scenery};
use simulator::environment::Environment;
use simulator::episodes::Programme;
use simulator::kitchen::Body;
use simulator::tasks::arm_point_nav::{self, Transition};
use std::collections::VecDeque;
use std::ops::Range;
use wire::message::EnvironmentState;

/// The kitchen that an environment goes to next is opened when so many episodes before that one are left: early enough
/// that they take longer than opening it, late enough that few such kitchens wait.
const OPENED_AHEAD: u32 = 3;

/// Bits of [`RecordHeader::bulk`]: the frame, and its sums.
const WHOLE: u32 = 1;
const SUMS: u32 = 1 << 1;

/// All environments of an actor.
pub struct Environments {
    running: Vec<Running>,
    /// The camera that they share. It holds the kitchen that all are in; or none of theirs, while each environment has
    /// its own scenery for it.
    camera: DepthCamera,
    sceneries: Vec<Scenery>,
    /// Where everything lies in a record.
    layout: &'static Layout,
    /// Whether frames are sent as their sums: where the network averages its input over such windows.
    sums: bool,
    course: Course,
    /// Environments whose next episode's start may be prepared further, first to last.
    unprepared: VecDeque<usize>,
}

/// Where environments play what.
struct Course {
    config: Config,
    rota: Rota,
    programme: Programme,
    larder: Larder,
}

/// One environment in its current episode.
struct Running {
    /// What it is called where its kitchen does not matter.
    home: EnvironmentId,
    /// The same with the kitchen that it is in.
    id: EnvironmentId,
    environment: Environment,
    /// What the last exchange did, and which episode and state it led to.
    header: RecordHeader,
    /// The last action, 0 if none was taken; and that before what is seen now, 0 at an episode's start.
    actions: [u8; 2],
    transition: Transition,
}

impl Course {
    /// An environment in the kitchen of this episode, at its start; and what the camera shows of that kitchen, if each
    /// environment has its own.
    fn enter(&self, home: EnvironmentId, episode: u32) -> Result<(EnvironmentId, Environment, Option<Scenery>)> {
        let id = self.rota.place(home, episode);
        let Opened { kitchen, scenery } = self.larder.take(home.number, id.kitchen)?;
        let environment = self
            .programme
            .environment(&kitchen, id, episode, &self.config)
            .with_context(|| format!("cannot set up environment {} of kitchen {}", id.number, id.kitchen))?;
        let scenery = self.rota.moves().then(|| scenery.unwrap_or_else(|| Scenery::of(kitchen.bodies())));
        Ok((id, environment, scenery))
    }

    /// Whether the frames of an episode are recorded.
    fn records(&self, id: EnvironmentId, episode: u32) -> bool {
        let Config { seed, recording, .. } = &self.config;
        let key = Key::episode(*seed, Purpose::Recording, id.kitchen, id.number, episode);
        recording.enabled && key.stream().uniform_open() < recording.depth_share
    }

    /// Has the kitchen that the environment goes to after this episode made as soon as that is known, and opened when it
    /// is near.
    fn look_ahead(&self, home: EnvironmentId, episode: u32, just_entered: bool) {
        let Some((then, next)) = self.rota.next_move(home, episode) else { return };
        let open = then - episode <= OPENED_AHEAD;
        if open || just_entered {
            self.larder.order(Order { environment: home.number, kitchen: next.kitchen, open });
        }
    }
}

impl Running {
    /// Begins an episode; its scenery is another one where that is in another kitchen.
    fn start(&mut self, course: &Course, scenery: Option<&mut Scenery>, episode: u32) -> Result<()> {
        let place = course.rota.place(self.home, episode);
        whereabouts::enter(place, episode);
        let moves = place.kitchen != self.id.kitchen;
        if moves {
            let (id, environment, entered) = course.enter(self.home, episode)?;
            (self.id, self.environment) = (id, environment);
            if let Some((scenery, entered)) = scenery.zip(entered) {
                *scenery = entered;
            }
        } else {
            course.programme.start(&mut self.environment, self.id, episode);
        }
        course.look_ahead(self.home, episode, moves);
        self.header.begin(episode, self.environment.state_hash(), course.records(self.id, episode));
        self.actions[1] = 0;
        Ok(())
    }

    /// Takes an action; after the last one of an episode the environment stands at the start of the next.
    fn act(&mut self, course: &Course, scenery: Option<&mut Scenery>, action: Action) -> Result<()> {
        whereabouts::enter(self.id, self.header.episode);
        self.transition = self.environment.step(action);
        let end = self.environment.end();
        self.actions = [action.index(); 2];
        self.header.act(self.environment.state_hash(), end);
        if end.is_some() {
            let next = self.next_episode().expect("four billion episodes outlast any run");
            self.start(course, scenery, next)?;
        }
        Ok(())
    }

    /// Nothing was done.
    fn hold(&mut self) {
        self.header.hold();
        self.actions[0] = 0;
        self.transition = Transition::default();
    }

    fn next_episode(&self) -> Option<u32> {
        self.header.episode.checked_add(1)
    }

    /// Does a piece of the next episode's start. Returns whether there is more to do. One in another kitchen, of which
    /// there is one in every `kitchens.episodes_each`, is not prepared.
    fn prepare(&mut self, course: &Course) -> bool {
        let Some(next) = self.next_episode() else { return false };
        let place = course.rota.place(self.home, next);
        whereabouts::enter(place, next);
        if place.kitchen != self.id.kitchen {
            self.environment.forget_past();
            return false;
        }
        course.programme.prepare(&mut self.environment, place, next)
    }
}

impl Environments {
    /// The environments of actor `actor`, each in its episode 0; with `kitchen` all in that one instead of their own.
    pub fn new(larder: Larder, kitchen: Option<KitchenId>, actor: u32, config: &Config) -> Result<Self> {
        let count = config.actors.environments_per_actor;
        let rota = config.rota();
        let homes: Vec<EnvironmentId> = (0..count)
            .map(|index| {
                let home = EnvironmentId::among(config.kitchens(), actor, index, count);
                EnvironmentId { kitchen: kitchen.unwrap_or(home.kitchen), ..home }
            })
            .collect();
        if rota.moves() {
            order_all(&larder, homes.iter().map(|&home| rota.place(home, 0)).collect());
        }
        let home = *homes.first().context("an actor has environments")?;
        let first = larder.take(home.number, rota.place(home, 0).kitchen)?;
        let programme = Programme::of(config, &first.kitchen)?;
        let course = Course { programme, config: config.clone(), rota, larder };
        let (mut running, mut sceneries) = (Vec::new(), Vec::new());
        for home in homes {
            let (id, environment, scenery) = course.enter(home, 0)?;
            course.look_ahead(home, 0, true);
            let mut header = RecordHeader { environment: running.len() as u32, ..RecordHeader::default() };
            header.begin(0, environment.state_hash(), course.records(id, 0));
            running.push(Running { home, id, environment, header, actions: [0; 2], transition: Transition::default() });
            sceneries.extend(scenery);
        }
        let shared: &[Body] = if sceneries.is_empty() { first.kitchen.bodies() } else { &[] };
        let (unprepared, sums) = ((0..running.len()).collect(), config.network.input_pool as usize == WINDOW);
        let layout = course.config.spec().layout();
        Ok(Self { camera: DepthCamera::new(shared), sceneries, layout, sums, running, course, unprepared })
    }

    /// Triangles that the camera has to choose from, in the first environment's kitchen.
    pub fn triangles(&mut self) -> usize {
        let Some(scenery) = self.sceneries.first_mut() else { return self.camera.triangles() };
        self.camera.exchange(scenery);
        let triangles = self.camera.triangles();
        self.camera.exchange(scenery);
        triangles
    }

    /// Bodies of the first environment's kitchen.
    pub fn bodies(&self) -> usize {
        self.running[0].environment.kitchen().bodies().len()
    }

    /// Prepares episodes that come next, by a piece of work of about a quarter of a millisecond: for whoever has nothing
    /// to do but wait. Returns whether there was anything to prepare. To start an episode takes as long as ten steps, and
    /// while one environment does, everybody else waits for its actor.
    pub fn prepare(&mut self) -> bool {
        let Some(&index) = self.unprepared.front() else { return false };
        if !self.running[index].prepare(&self.course) {
            self.unprepared.pop_front();
        }
        true
    }

    /// Puts every environment into the state that its actions lead to. Nothing is rendered on the way, and what was
    /// simulated before does not matter.
    pub fn rebuild(&mut self, states: &[EnvironmentState]) -> Result<()> {
        assert_eq!(states.len(), self.running.len(), "a restore holds one state an environment");
        self.unprepared = (0..states.len()).collect();
        let (rota, larder) = (&self.course.rota, &self.course.larder);
        let places = self.running.iter().zip(states).map(|(running, state)| {
            let place = rota.place(running.home, state.episode);
            (place.kitchen != running.id.kitchen).then_some(place)
        });
        order_all(larder, places.flatten().collect());
        for (index, (running, state)) in self.running.iter_mut().zip(states).enumerate() {
            running.hold();
            let mut scenery = self.sceneries.get_mut(index);
            running.start(&self.course, scenery.as_deref_mut(), state.episode)?;
            let actions = state
                .actions
                .get(..state.action_count as usize)
                .with_context(|| format!("a restore claims {} actions in one episode", state.action_count))?;
            for (step, &action) in actions.iter().enumerate() {
                let action = Action::from_index(action).with_context(|| {
                    format!("a restore names action {action} at step {step} of {}: there is none", place(running))
                })?;
                let here = running.id;
                running.act(&self.course, scenery.as_deref_mut(), action)?;
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
            let (scenery, episode) = (self.sceneries.get_mut(index), running.header.episode);
            match Action::from_index(action) {
                Some(action) => running.act(&self.course, scenery, action)?,
                None if action == HOLD => running.hold(),
                None => bail!("the learner sent action {action} to {}: there is none", place(running)),
            }
            if running.header.episode != episode && !self.unprepared.contains(&index) {
                self.unprepared.push_back(index);
            }
        }
        Ok(())
    }

    /// Writes the record of environment `index`, its frame in place. Where the network averages over windows only their sums
    /// are written, and the whole frame as well if it is recorded; the whole frame alone where a sum exceeds 16 bits.
    ///
    /// # Panics
    /// If the record has not the task's size.
    pub fn observe(&mut self, index: usize, record: &mut [u8]) {
        let Self { running, camera, sceneries, layout, sums, .. } = self;
        let (running, mut own) = (&mut running[index], sceneries.get_mut(index));
        whereabouts::enter(running.id, running.header.episode);
        if let Some(scenery) = own.as_deref_mut() {
            camera.exchange(scenery);
        }
        let environment = &mut running.environment;
        record[..layout.small_bytes].fill(0);
        for (field, action) in [layout.action, layout.previous_action].into_iter().zip(running.actions) {
            record[field.offset] = action;
        }
        arm_point_nav::write(record, &running.transition, &environment.current());
        let mut header = running.header;
        let [whole, windows] = layout.images[..] else { panic!("the task has one image, which has sums") };
        let frame: &mut [u16; SUMS_PIXELS] = windows.of_mut(record).try_into().expect("the sums of a frame");
        if *sums && environment.look_for_sums(camera, frame) {
            header.bulk |= SUMS;
        }
        if header.bulk == 0 || header.has(flag::RECORD_BULK) {
            environment.look(camera, FRAME_SIDE, whole.of_mut(record));
            header.bulk |= WHOLE;
        }
        *RecordHeader::of_mut(record) = header;
        if let Some(scenery) = own {
            camera.exchange(scenery);
        }
    }
}

/// Has the kitchens that environments are about to enter opened: the larder's thread begins at the other end, if there
/// is a processor for it.
fn order_all(larder: &Larder, places: Vec<EnvironmentId>) {
    for place in places.into_iter().rev() {
        larder.order(Order { environment: place.number, kitchen: place.kitchen, open: true });
    }
}

fn place(running: &Running) -> whereabouts::Whereabouts {
    whereabouts::Whereabouts { environment: running.id, episode: running.header.episode }
}

#[cfg(test)]
mod tests;
