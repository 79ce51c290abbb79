//! What an environment is, as Python's keyword arguments say it.

use crate::error::value_error;
use proto::action::{Action, ActionSpace};
use proto::config::{CarriedGoal, Config};
use proto::reward::RewardKind;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::Arc;

/// Width and height of a frame that can be asked for, pixels.
const SIDES: std::ops::RangeInclusive<usize> = 8..=1024;

/// How environments are made and what their steps are worth.
#[pyclass(frozen, module = "stillroom._stillroom")]
#[derive(Debug, Clone)]
pub struct Settings {
    /// The whole configuration, as a run has it.
    pub config: Arc<Config>,
    /// The reward that is composed.
    pub reward: RewardKind,
    /// Width and height of depth frames, pixels.
    pub frame_side: usize,
    /// Depth as float metres; otherwise as 16-bit millimetres.
    pub in_metres: bool,
}

#[pymethods]
impl Settings {
    /// The settings of `preset`, those overridden that are not None.
    #[new]
    #[pyo3(signature = (*, preset, reward, frame_side, in_metres, action_space=None, max_steps=None,
        start_distance_max_m=None, goal_distance_max_m=None, disturbance_weight=None, carried_goal=None))]
    // One for each keyword of the constructors in Python.
    #[allow(clippy::too_many_arguments)]
    fn new(
        preset: &str,
        reward: &str,
        frame_side: usize,
        in_metres: bool,
        action_space: Option<&str>,
        max_steps: Option<u32>,
        start_distance_max_m: Option<f32>,
        goal_distance_max_m: Option<f32>,
        disturbance_weight: Option<f32>,
        carried_goal: Option<&str>,
    ) -> PyResult<Self> {
        let reward = match reward {
            "r" => RewardKind::Task,
            "r_prime" => RewardKind::DisturbanceFree,
            _ => return Err(PyValueError::new_err(format!("reward `{reward}` is none of \"r\", \"r_prime\""))),
        };
        if !SIDES.contains(&frame_side) {
            let (least, most) = (SIDES.start(), SIDES.end());
            return Err(PyValueError::new_err(format!("frame_side is {frame_side}, not {least} to {most} pixels")));
        }
        let mut config = Config::resolve(preset, None).map_err(value_error)?;
        match action_space {
            None => {}
            Some("large") => config.episode.action_space = ActionSpace::Large,
            Some("small") => config.episode.action_space = ActionSpace::Small,
            Some(other) => {
                return Err(PyValueError::new_err(format!("action_space `{other}` is none of \"large\", \"small\"")));
            }
        }
        match carried_goal {
            None => {}
            Some("goal_to_object") => config.network.carried_goal = CarriedGoal::GoalToObject,
            Some("object_to_goal") => config.network.carried_goal = CarriedGoal::ObjectToGoal,
            Some(other) => {
                return Err(PyValueError::new_err(format!(
                    "carried_goal `{other}` is none of \"goal_to_object\", \"object_to_goal\""
                )));
            }
        }
        let set = |place: &mut f32, value: Option<f32>| value.into_iter().for_each(|value| *place = value);
        set(&mut config.episode.start_distance_max_m, start_distance_max_m);
        set(&mut config.episode.goal_distance_max_m, goal_distance_max_m);
        set(&mut config.reward.lambda_disturb, disturbance_weight);
        config.episode.max_steps = max_steps.unwrap_or(config.episode.max_steps);
        config.validate().map_err(value_error)?;
        Ok(Self { config: Arc::new(config), reward, frame_side, in_metres })
    }

    /// Names of the actions, in the order of their numbers.
    #[getter]
    fn actions(&self) -> Vec<&'static str> {
        self.space().iter().map(|action| action.name()).collect()
    }

    /// Actions after which an episode ends at the latest.
    #[getter]
    fn max_steps(&self) -> u32 {
        self.config.episode.max_steps
    }
}

impl Settings {
    /// The actions in the order of their numbers.
    pub fn space(&self) -> &'static [Action] {
        self.config.episode.action_space.actions()
    }

    /// What the goal vector points at while the target is held.
    pub fn carried_goal(&self) -> CarriedGoal {
        self.config.network.carried_goal
    }
}
