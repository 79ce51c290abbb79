//! An episode as data sets take it: what was seen before each action, what the action did, and pictures.

use proto::record::End;
use simulator::tasks::arm_point_nav::Transition;

/// Which episode it is, and what became of it.
#[derive(Debug, Clone)]
pub struct About {
    pub kitchen: u32,
    /// Number of the environment within the kitchen.
    pub environment: u32,
    /// Number of the episode within the environment.
    pub number: u32,
    /// In an evaluation: its number in the table of episodes.
    pub fixed: Option<u32>,
    /// Category of the target.
    pub target: &'static str,
    /// How it ended, in the words of an evaluation's table.
    pub outcome: &'static str,
    pub seed: u64,
}

/// What the policy is given beside the frame.
#[derive(Debug, Clone, Copy)]
pub struct Seen {
    /// Goal vector, robot's frame, metres.
    pub goal_m: [f32; 3],
    /// Number of the action before; the number of actions at the start.
    pub previous_action: u32,
    pub state_hash: u64,
}

/// What an action did.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Number of the action among those of the run.
    pub action: u32,
    /// What it did.
    pub transition: Transition,
    /// How it ended the episode, if it did.
    pub end: Option<End>,
    /// r and r′.
    pub rewards: [f32; 2],
}

/// Frames of one camera over an episode, one for each moment.
#[derive(Debug, Clone)]
pub struct Frames {
    /// Name of the camera: `depth`, `robot` or `outside`.
    pub name: &'static str,
    /// Width and height, pixels.
    pub side: usize,
    /// 16-bit millimetres; otherwise 8-bit RGB.
    pub is_depth: bool,
    /// Pixels in rows from the top, depth in little-endian order.
    pub frames: Vec<Vec<u8>>,
}

/// An episode. There is one moment more than there are actions: the last one is what the last action led to.
#[derive(Debug, Clone)]
pub struct Episode {
    pub about: About,
    /// What was seen, one more than there are steps.
    pub seen: Vec<Seen>,
    /// What was done.
    pub steps: Vec<Step>,
    /// The robot's depth frames, then pictures.
    pub cameras: Vec<Frames>,
}
