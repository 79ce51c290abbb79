//! Episodes as they are looked at: requests from `orchestrator view` on the standard input of `actor show`, one JSON
//! object a line, and answers on its standard output.
//!
//! Every answer is a line, too. [`ShowAnswer::Picture`] says how many bytes of PNG follow its line.

use crate::config::Config;
use crate::replay::{Difference, RecordedEpisode, ReplaySetup};
use crate::task::{Channel, Metric, Reward};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

pub const SHOWN_SIDE_MAX: u32 = 2048;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShowRequest {
    /// Simulate an episode and keep it under this name; an older one of the name is dropped.
    Open {
        /// Name in later requests.
        name: String,
        /// Configuration and run folder; `images` is not used.
        setup: ReplaySetup,
        episode: Box<RecordedEpisode>,
    },
    /// Draw one moment of a kept episode.
    Draw {
        name: String,
        /// Actions taken until then.
        step: u32,
        view: ShowView,
        width: u32,
        height: u32,
        /// With soft light from all over; without it a picture takes a fraction of the time.
        fine: bool,
        /// Where there is no room, the picture is dark, as the page around it.
        dark: bool,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShowView {
    /// The room from outside of a ball that is seen whole; what stands between it and the camera is cut away.
    Orbit(ShowOrbit),
    /// What the robot's depth camera sees, square.
    Depth,
    /// The floor plan at the episode's start, square, without the robot.
    Plan,
}

/// Where a free camera is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ShowOrbit {
    /// Middle of the ball, metres.
    pub centre_m: [f32; 3],
    pub radius_m: f32,
    /// Direction of the look, radians about the vertical.
    pub yaw_rad: f32,
    /// How far it looks down, radians.
    pub pitch_rad: f32,
}

/// What comes back, in the order of the requests.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ShowAnswer {
    Opened(Box<ShownEpisode>),
    /// A picture follows: so many bytes of PNG.
    Picture {
        bytes: u64,
    },
    /// No episode of this name is kept: open it again.
    NotOpen,
    Failed {
        problem: String,
    },
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownEpisode {
    pub task: ShownTask,
    /// Name of its `target`, if the task has such a channel.
    pub target: Option<String>,
    /// How it ended: [`crate::task::Spec::outcome`].
    pub outcome: String,
    /// The task's metrics over the steps that are shown, by name.
    pub figures: BTreeMap<String, f64>,
    /// How near to `goal_position_m` is enough on each axis, metres.
    pub goal_tolerance_m: f32,
    /// The camera from which the way is seen best.
    pub orbit: ShowOrbit,
    /// Middle of the floor plan (x, z), metres.
    pub plan_centre_m: [f32; 2],
    /// Half of the floor's extent along x and z, metres. The plan's picture is as wide and as high as the greater of them.
    pub plan_half_m: [f32; 2],
    /// What is as far away is black in the robot's view, metres.
    pub black_m: f32,
    /// The start, and what was there after each action.
    pub moments: Vec<ShownMoment>,
    /// Things that any moment names as moved.
    pub things: Vec<ShownThing>,
    /// States compared with the recording.
    pub compared: u64,
    /// The first thing that is not as recorded, if any.
    pub first_difference: Option<Difference>,
}

/// What of a task's declaration is shown.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownTask {
    /// All but images.
    pub channels: Vec<Channel>,
    pub rewards: Vec<Reward>,
    /// Of rewards, as the run has set them.
    pub weights: BTreeMap<String, f32>,
    pub metrics: Vec<Metric>,
    pub successes: Vec<String>,
}

impl ShownTask {
    pub fn of(config: &Config) -> Self {
        let spec = config.spec();
        Self {
            channels: spec.channels.iter().filter(|channel| !channel.is_bulk()).cloned().collect(),
            rewards: [&spec.rewards[..], &config.rewards].concat(),
            weights: config.reward.weights.clone(),
            metrics: spec.metrics.clone(),
            successes: spec.good_outcomes().collect(),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ShownMoment {
    /// Name of the action that led here; none at the start.
    pub action: Option<String>,
    /// Numbers of the task's channels but images: what is seen now, and after an action what that did.
    pub channels: BTreeMap<String, Vec<f32>>,
    /// The rewards of that action, the task's and the configuration's; none at the start.
    pub rewards: BTreeMap<String, f32>,
    /// What is not where it stood: number in [`ShownEpisode::things`], how far (metres), and where it is now.
    pub moved: Vec<(u32, f32, [f32; 3])>,
    /// Of what is displaced too little for that, what is displaced most: its category and how far, metres.
    pub nearly: Option<(String, f32)>,
}

impl ShownMoment {
    /// Numbers of a channel, if there are as many.
    pub fn numbers<const N: usize>(&self, channel: &str) -> Option<[f32; N]> {
        self.channels.get(channel)?.as_slice().try_into().ok()
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownThing {
    pub category: String,
    /// Where it stood (x, z), metres.
    pub stood_m: [f32; 2],
}
