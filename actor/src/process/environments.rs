//! The environments of one actor: stepping them, rebuilding them, and showing what they see.

use super::larder::Larder;
use super::{shm, whereabouts};
use anyhow::{Context, Result, bail, ensure};
use proto::action::{Action, HOLD};
use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::rota::Rota;
use proto::step::{Transition, transition_flag};
use simulator::depth::{DepthCamera, Scenery};
use simulator::environment::Environment;
use simulator::episodes::Programme;
use simulator::kitchen::{Body, Kitchen};
use std::collections::BTreeMap;
use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::{Arc, Weak};
use wire::message::{EnvironmentState, Observation};

/// All environments of an actor.
pub struct Environments {
    running: Vec<Running>,
    /// The camera that they share. It holds the kitchen that all are in; or none of theirs, while each environment has
    /// its own scenery for it.
    camera: DepthCamera,
    sceneries: Vec<Scenery>,
    course: Course,
}

/// Where environments play what.
struct Course {
    config: Config,
    rota: Rota,
    programme: Programme,
    larder: Larder,
    /// Kitchens that environments of this actor are in: two that meet in one share it.
    in_use: BTreeMap<KitchenId, Weak<Kitchen>>,
}

/// One environment in its current episode.
struct Running {
    /// What it is called where its kitchen does not matter.
    home: EnvironmentId,
    /// The same with the kitchen that it is in.
    id: EnvironmentId,
    environment: Environment,
    episode: u32,
    /// What the last exchange did.
    transition: Transition,
}

impl Course {
    /// The kitchen of this episode. Also orders the one that the environment goes to next.
    fn kitchen(&mut self, home: EnvironmentId, episode: u32) -> Result<Arc<Kitchen>> {
        let id = self.rota.place(home, episode).kitchen;
        let kitchen = if let Some(kitchen) = self.in_use.get(&id).and_then(Weak::upgrade) {
            kitchen
        } else {
            let kitchen = Arc::new(self.larder.take(id)?);
            self.in_use.retain(|_, kitchen| kitchen.strong_count() > 0);
            self.in_use.insert(id, Arc::downgrade(&kitchen));
            kitchen
        };
        if let Some(next) = self.rota.next_place(home, episode) {
            self.larder.order(next.kitchen);
        }
        Ok(kitchen)
    }

    fn environment(&mut self, home: EnvironmentId, episode: u32) -> Result<(EnvironmentId, Environment)> {
        let kitchen = self.kitchen(home, episode)?;
        let id = self.rota.place(home, episode);
        let environment = self
            .programme
            .environment(&kitchen, id, &self.config)
            .with_context(|| format!("cannot set up environment {} of kitchen {}", id.number, id.kitchen))?;
        Ok((id, environment))
    }
}

impl Running {
    /// Begins an episode; its scenery is made anew where that is in another kitchen.
    fn start(&mut self, course: &mut Course, scenery: Option<&mut Scenery>, episode: u32) -> Result<()> {
        let place = course.rota.place(self.home, episode);
        whereabouts::enter(place, episode);
        if place.kitchen != self.id.kitchen {
            (self.id, self.environment) = course.environment(self.home, episode)?;
            if let Some(scenery) = scenery {
                *scenery = Scenery::of(self.environment.kitchen().bodies());
            }
        }
        course.programme.start(&mut self.environment, self.id, episode);
        self.episode = episode;
        Ok(())
    }

    /// Takes an action; after the last one of an episode the environment stands at the start of the next.
    fn act(&mut self, course: &mut Course, scenery: Option<&mut Scenery>, action: Action) -> Result<()> {
        whereabouts::enter(self.id, self.episode);
        self.transition = self.environment.step(action);
        if self.transition.flags & transition_flag::ENDED != 0 {
            let next = self.episode.checked_add(1).expect("four billion episodes outlast any run");
            self.start(course, scenery, next)?;
        }
        Ok(())
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
        // The larder's thread begins at the other end, if there is a processor for it.
        if rota.moves() {
            homes.iter().rev().for_each(|&home| larder.order(rota.place(home, 0).kitchen));
        }
        let first = rota.place(*homes.first().context("an actor has environments")?, 0).kitchen;
        let first = Arc::new(larder.take(first)?);
        let mut course = Course {
            programme: Programme::of(config, &first)?,
            config: config.clone(),
            in_use: BTreeMap::from([(first.id(), Arc::downgrade(&first))]),
            rota,
            larder,
        };
        let mut running = Vec::new();
        for home in homes {
            let (id, environment) = course.environment(home, 0)?;
            running.push(Running { home, id, environment, episode: 0, transition: Transition::default() });
        }
        let own = if course.rota.moves() { running.len() } else { 0 };
        let scenery = |running: &Running| Scenery::of(running.environment.kitchen().bodies());
        let sceneries = running[..own].iter().map(scenery).collect();
        let shared: &[Body] = if own == 0 { first.bodies() } else { &[] };
        Ok(Self { camera: DepthCamera::new(shared), sceneries, running, course })
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

    /// Puts every environment into the state that its actions lead to. Nothing is rendered on the way, and what was
    /// simulated before does not matter.
    pub fn rebuild(&mut self, states: &[EnvironmentState]) -> Result<()> {
        assert_eq!(states.len(), self.running.len(), "a restore holds one state an environment");
        for (index, (running, state)) in self.running.iter_mut().zip(states).enumerate() {
            running.transition = Transition::default();
            let mut scenery = self.sceneries.get_mut(index);
            running.start(&mut self.course, scenery.as_deref_mut(), state.episode)?;
            let actions = state
                .actions
                .get(..state.action_count as usize)
                .with_context(|| format!("a restore claims {} actions in one episode", state.action_count))?;
            for (step, &action) in actions.iter().enumerate() {
                let action = Action::from_index(action).with_context(|| {
                    format!("a restore names action {action} at step {step} of {}: there is none", place(running))
                })?;
                let here = running.id;
                running.act(&mut self.course, scenery.as_deref_mut(), action)?;
                let ended = running.transition.flags & transition_flag::ENDED != 0;
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
            let scenery = self.sceneries.get_mut(index);
            match Action::from_index(action) {
                Some(action) => running.act(&mut self.course, scenery, action)?,
                None if action == HOLD => running.transition = Transition::default(),
                None => bail!("the learner sent action {action} to {}: there is none", place(running)),
            }
        }
        Ok(())
    }

    /// Writes the observation of environment `index`; its frame is rendered in place.
    pub fn observe<'a>(&mut self, index: usize, slot: &'a mut MaybeUninit<Observation>) -> &'a Observation {
        let Self { running, camera, sceneries, .. } = self;
        let (running, mut own) = (&mut running[index], sceneries.get_mut(index));
        whereabouts::enter(running.id, running.episode);
        if let Some(scenery) = own.as_deref_mut() {
            camera.exchange(scenery);
        }
        let current = running.environment.current();
        let observation = shm::write_observation(slot, index as u32, running.transition, current, |frame| {
            running.environment.look_into(camera, FRAME_SIDE, frame)
        });
        if let Some(scenery) = own {
            camera.exchange(scenery);
        }
        observation
    }
}

fn place(running: &Running) -> whereabouts::Whereabouts {
    whereabouts::Whereabouts { environment: running.id, episode: running.episode }
}
