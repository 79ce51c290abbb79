//! The environments of one actor: stepping them, rebuilding them, and showing what they see.

use super::{shm, whereabouts};
use anyhow::{Context, Result, bail, ensure};
use proto::action::{Action, HOLD};
use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::step::{Transition, transition_flag};
use simulator::depth::DepthCamera;
use simulator::environment::Environment;
use simulator::episodes::Programme;
use simulator::kitchen::Kitchen;
use std::mem::MaybeUninit;
use std::ops::Range;
use std::sync::Arc;
use wire::message::{EnvironmentState, Observation};

/// All environments of an actor and the camera they share.
pub struct Environments {
    running: Vec<Running>,
    programme: Programme,
    camera: DepthCamera,
}

/// One environment in its current episode.
struct Running {
    id: EnvironmentId,
    environment: Environment,
    episode: u32,
    /// What the last exchange did.
    transition: Transition,
}

impl Running {
    fn start(&mut self, programme: &Programme, episode: u32) {
        whereabouts::enter(self.id, episode);
        programme.start(&mut self.environment, self.id, episode);
        self.episode = episode;
    }

    /// Takes an action; after the last one of an episode the environment stands at the start of the next.
    fn act(&mut self, programme: &Programme, action: Action) {
        whereabouts::enter(self.id, self.episode);
        self.transition = self.environment.step(action);
        if self.transition.flags & transition_flag::ENDED != 0 {
            let next = self.episode.checked_add(1).expect("four billion episodes outlast any run");
            self.start(programme, next);
        }
    }
}

impl Environments {
    /// The environments of actor `actor` in `kitchen`, each in its episode 0.
    pub fn new(kitchen: &Arc<Kitchen>, kitchen_id: KitchenId, actor: u32, config: &Config) -> Result<Self> {
        let count = config.actors.environments_per_actor;
        let programme = Programme::of(config, kitchen)?;
        let running = (0..count)
            .map(|index| {
                let id = EnvironmentId {
                    kitchen: kitchen_id,
                    ..EnvironmentId::among(config.kitchens(), actor, index, count)
                };
                let environment = programme
                    .environment(kitchen, id, config)
                    .with_context(|| format!("cannot set up environment {} of kitchen {kitchen_id}", id.number))?;
                Ok(Running { id, environment, episode: 0, transition: Transition::default() })
            })
            .collect::<Result<_>>()?;
        Ok(Self { running, programme, camera: DepthCamera::new(kitchen.bodies()) })
    }

    /// Triangles that the camera has to choose from.
    pub fn triangles(&self) -> usize {
        self.camera.triangles()
    }

    /// Puts every environment into the state that its actions lead to. Nothing is rendered on the way, and what was
    /// simulated before does not matter.
    pub fn rebuild(&mut self, states: &[EnvironmentState]) -> Result<()> {
        assert_eq!(states.len(), self.running.len(), "a restore holds one state an environment");
        for (running, state) in self.running.iter_mut().zip(states) {
            running.transition = Transition::default();
            running.start(&self.programme, state.episode);
            let actions = state
                .actions
                .get(..state.action_count as usize)
                .with_context(|| format!("a restore claims {} actions in one episode", state.action_count))?;
            for (step, &index) in actions.iter().enumerate() {
                let action = Action::from_index(index).with_context(|| {
                    format!("a restore names action {index} at step {step} of {}: there is none", place(running))
                })?;
                running.act(&self.programme, action);
                let ended = running.transition.flags & transition_flag::ENDED != 0;
                ensure!(
                    !ended || step + 1 == actions.len(),
                    "a restore has {} actions for episode {} of kitchen {}, environment {}, which ends after {}: \
                     was the run recorded with another version of the simulator?",
                    actions.len(),
                    state.episode,
                    running.id.kitchen,
                    running.id.number,
                    step + 1
                );
            }
        }
        Ok(())
    }

    /// Applies one action to each environment of `range`. HOLD leaves an environment as it is.
    pub fn act(&mut self, range: Range<usize>, actions: &[u8]) -> Result<()> {
        assert_eq!(range.len(), actions.len(), "one action an environment");
        for (running, &index) in self.running[range].iter_mut().zip(actions) {
            match Action::from_index(index) {
                Some(action) => running.act(&self.programme, action),
                None if index == HOLD => running.transition = Transition::default(),
                None => bail!("the learner sent action {index} to {}: there is none", place(running)),
            }
        }
        Ok(())
    }

    /// Writes the observation of environment `index`; its frame is rendered in place.
    pub fn observe<'a>(&mut self, index: usize, slot: &'a mut MaybeUninit<Observation>) -> &'a Observation {
        let running = &mut self.running[index];
        whereabouts::enter(running.id, running.episode);
        let current = running.environment.current();
        shm::write_observation(slot, index as u32, running.transition, current, |frame| {
            running.environment.look_into(&mut self.camera, FRAME_SIDE, frame)
        })
    }
}

fn place(running: &Running) -> whereabouts::Whereabouts {
    whereabouts::Whereabouts { environment: running.id, episode: running.episode }
}
