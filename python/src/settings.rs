//! What an environment is, as Python's keyword arguments say it.

use crate::argument::{chosen, real, text, whole};
use crate::error::value_error;
use crate::facts::called;
use proto::config::{CarriedGoal, Config, ConfigError};
use proto::episode::MAX_EPISODE_STEPS;
use proto::task::{ActionSpace, Channel, Composition, Field, Role, Spec};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Width and height of a frame that can be asked for, pixels.
const SIDE_LEAST: u64 = 8;
const SIDE_MOST: u64 = 1024;

/// How environments are made and what their steps are worth.
#[pyclass(frozen, module = "stillroom._stillroom")]
#[derive(Debug, Clone)]
pub struct Settings {
    /// The whole configuration, as a run has it.
    pub config: Arc<Config>,
    /// The reward that is composed.
    pub reward: Composition,
    /// Width and height of depth frames, pixels.
    pub frame_side: usize,
    /// Depth as float metres; otherwise as 16-bit millimetres.
    pub in_metres: bool,
}

#[pymethods]
impl Settings {
    /// The settings of `preset`, those overridden that are not None.
    #[new]
    #[pyo3(signature = (*, preset, reward, depth, frame_side, task=None, action_space=None, max_steps=None,
        start_distance_max_m=None, goal_distance_max_m=None, disturbance_weight=None, carried_goal=None))]
    // One for each keyword of the constructors in Python.
    #[allow(clippy::too_many_arguments)]
    fn new(
        preset: &Bound<'_, PyAny>,
        reward: &Bound<'_, PyAny>,
        depth: &Bound<'_, PyAny>,
        frame_side: &Bound<'_, PyAny>,
        task: Option<&Bound<'_, PyAny>>,
        action_space: Option<&Bound<'_, PyAny>>,
        max_steps: Option<&Bound<'_, PyAny>>,
        start_distance_max_m: Option<&Bound<'_, PyAny>>,
        goal_distance_max_m: Option<&Bound<'_, PyAny>>,
        disturbance_weight: Option<&Bound<'_, PyAny>>,
        carried_goal: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let in_metres = chosen("depth", depth, &[("uint16", false), ("float32", true)])?;
        let frame_side = whole("frame_side", frame_side, SIDE_MOST, SIDE_LEAST)? as usize;
        let tasks: Vec<(&str, &str)> = Spec::built_in().iter().map(|spec| (&*spec.name, &*spec.name)).collect();
        let task = task.map(|task| chosen("task", task, &tasks)).transpose()?.map(|task| format!("task = {task:?}"));
        let overlay = task.as_deref().map(|text| (text, "task"));
        let mut config = Config::resolve_with(&text("preset", preset)?, overlay).map_err(value_error)?;
        let spec = config.spec();
        let rewards: Vec<(&str, &str)> = spec.plain_rewards().map(|name| (name, name)).collect();
        let reward = chosen("reward", reward, &rewards)?;
        let Config { episode, network, reward: weights, .. } = &mut config;
        if let Some(space) = action_space {
            let spaces = ActionSpace::all().filter(|space| space.of(&spec.actions).is_some());
            let spaces: Vec<_> = spaces.map(|space| (space.name(), space)).collect();
            episode.action_space = chosen("action_space", space, &spaces)?;
        }
        if let Some(goal) = carried_goal {
            let goals = [("goal_to_object", CarriedGoal::GoalToObject), ("object_to_goal", CarriedGoal::ObjectToGoal)];
            network.carried_goal = chosen("carried_goal", goal, &goals)?;
        }
        if let Some(steps) = max_steps {
            episode.max_steps = whole("max_steps", steps, MAX_EPISODE_STEPS as u64, 1)? as u32;
        }
        for (name, value, place) in [
            ("start_distance_max_m", start_distance_max_m, &mut episode.start_distance_max_m),
            ("goal_distance_max_m", goal_distance_max_m, &mut episode.goal_distance_max_m),
        ] {
            if let Some(value) = value {
                *place = real(name, value)?;
            }
        }
        if let Some(weight) = disturbance_weight {
            weights.weights.insert("lambda_disturb".to_owned(), real("disturbance_weight", weight)?);
        }
        if disturbance_weight.is_some() && reward == "r" {
            return Err(PyValueError::new_err("disturbance_weight counts with reward=\"r_prime\" only"));
        }
        config.validate().map_err(|error| match error {
            ConfigError::OutOfRange { key: "reward", problem, .. } => {
                let value = config.reward.weights["lambda_disturb"];
                PyValueError::new_err(format!("disturbance_weight is {value}: it {problem}"))
            }
            ConfigError::OutOfRange { key, value, problem, .. } => {
                let name = key.rsplit('.').next().unwrap_or(key);
                PyValueError::new_err(format!("{name} is {value}: it {problem}"))
            }
            error => value_error(error),
        })?;
        Ok(Self { reward: config.reward(reward), config: Arc::new(config), frame_side, in_metres })
    }

    /// Names of the actions, in the order of their numbers.
    #[getter]
    fn actions(&self) -> Vec<&'static str> {
        let names = self.config.spec().actions.names();
        self.config.policy_actions().into_iter().map(|action| names[usize::from(action)].as_str()).collect()
    }

    /// Actions after which an episode ends at the latest.
    #[getter]
    fn max_steps(&self) -> u32 {
        self.config.episode.max_steps
    }

    #[getter]
    fn task(&self) -> &str {
        &self.config.task
    }

    /// Least and greatest number of each observation that is no image, by its name.
    #[getter]
    fn bounds(&self) -> BTreeMap<&'static str, [f64; 2]> {
        let vectors = self.vectors().filter_map(|(channel, _)| Some((channel.bare_name(), channel.range?)));
        vectors.collect()
    }

    /// What numbers in infos stand for, by their name.
    #[getter]
    fn meanings(&self) -> BTreeMap<&'static str, Vec<String>> {
        let channels = self.config.spec().channels.iter();
        let named = channels.filter(|channel| channel.role == Role::Outcome && !channel.names.is_empty());
        named.map(|channel| (called(channel), channel.names.clone())).collect()
    }
}

impl Settings {
    /// The actions in the order of their numbers.
    pub fn space(&self) -> Vec<u8> {
        self.config.policy_actions()
    }

    /// The observations that are no images.
    pub fn vectors(&self) -> impl Iterator<Item = (&'static Channel, Field)> {
        let spec = self.config.spec();
        let channels = spec.channels.iter().zip(spec.layout().fields.iter().copied());
        channels.filter(|(channel, _)| channel.role == Role::Observation && !channel.is_bulk())
    }
}
