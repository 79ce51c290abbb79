//! Episodes as they are looked at: requests from `orchestrator view` on the standard input of `actor show`, one JSON
//! object a line, and answers on its standard output.
//!
//! Every answer is a line, too. [`ShowAnswer::Picture`] says how many bytes of PNG follow its line.

use crate::replay::{Difference, RecordedEpisode, ReplaySetup};
use serde::{Deserialize, Serialize};

/// Widest and highest picture that is drawn, pixels.
pub const SHOWN_SIDE_MAX: u32 = 2048;

/// What is asked for.
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
        /// What to look at, and from where.
        view: ShowView,
        /// Pixels from left to right.
        width: u32,
        /// Pixels from top to bottom.
        height: u32,
        /// With soft light from all over; without it a picture takes a fraction of the time.
        fine: bool,
    },
    /// One moment of a kept episode for programs that draw it themselves.
    Solids {
        name: String,
        /// Actions taken until then.
        step: u32,
        /// With what never moves.
        fixed: bool,
    },
}

/// What to look at, and from where.
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
    /// Its radius, metres.
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
        /// Its size.
        bytes: u64,
    },
    Solids(Box<ShownSolids>),
    /// No episode of this name is kept: open it again.
    NotOpen,
    /// It cannot be done.
    Failed {
        /// Why, as a sentence without an end.
        problem: String,
    },
}

/// All that is told about an episode that was simulated again.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownEpisode {
    /// Category of the target.
    pub target: String,
    /// How it ended: the words of film names, e.g. `success-without-disturbance`.
    pub outcome: String,
    /// Where the target is to be brought, metres.
    pub goal_m: [f32; 3],
    /// How near to it is enough on each axis, metres.
    pub goal_tolerance_m: f32,
    /// The camera from which the way is seen best.
    pub orbit: ShowOrbit,
    /// Middle of the floor plan (x, z), metres.
    pub plan_centre_m: [f32; 2],
    /// Half of the floor plan's width, metres.
    pub plan_half_width_m: f32,
    /// The start, and what was there after each action.
    pub moments: Vec<ShownMoment>,
    /// Things that any moment names as moved.
    pub things: Vec<ShownThing>,
    /// States compared with the recording.
    pub compared: u64,
    /// The first state that is not as recorded, if any.
    pub first_difference: Option<Difference>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownMoment {
    /// Name of the action that led here; none at the start.
    pub action: Option<String>,
    pub failed: bool,
    /// It picked the target up.
    pub picked_up: bool,
    /// The target is held.
    pub holding: bool,
    /// Parts of its reward, as `proto::reward` adds them up.
    pub parts: ShownReward,
    /// Reward under r.
    pub reward_r: f32,
    /// Reward under r′.
    pub reward_r_prime: f32,
    /// Distance of wrist and target, metres.
    pub wrist_object_m: f32,
    /// Distance of target and goal, metres.
    pub object_goal_m: f32,
    /// Total displacement, metres.
    pub disturbance_m: f32,
    /// The robot's body (x, z), metres, and its yaw, radians.
    pub base: [f32; 3],
    /// The wrist, metres.
    pub wrist_m: [f32; 3],
    /// The target, metres.
    pub target_m: [f32; 3],
    /// What is not where it stood: number in [`ShownEpisode::things`], how far (metres), and where it is now (x, z).
    pub moved: Vec<(u32, f32, [f32; 2])>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownSolids {
    /// Bodies, with the robot's parts.
    pub solids: Vec<ShownSolid>,
    /// How far the head camera looks down, radians.
    pub camera_pitch_rad: f32,
    /// What it sees: a square of the observation's size, millimetres.
    pub depth_mm: Vec<u16>,
}

/// A body as triangles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownSolid {
    /// The same at every moment of an episode, e.g. `thing/12 Mug`.
    pub name: String,
    /// sRGB.
    pub colour: [u8; 3],
    /// It is not there any more: it stood there.
    pub ghost: bool,
    /// Three corners for each triangle, in the simulator's world, metres.
    pub corners_m: Vec<[f32; 3]>,
}

/// Parts of one step's reward.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ShownReward {
    /// Wrist nearer to the target, metres.
    pub wrist_object_progress_m: f32,
    /// Target nearer to the goal, metres.
    pub object_goal_progress_m: f32,
    /// Less displacement than before, metres.
    pub disturbance_progress_m: f32,
    /// 1 if the action failed.
    pub failed_action: f32,
    /// 1 if it picked the target up.
    pub picked_up: f32,
    /// 1 if it was a successful Done.
    pub goal_success: f32,
}

/// A thing that was moved.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShownThing {
    pub category: String,
    /// Where it stood (x, z), metres.
    pub stood_m: [f32; 2],
}
