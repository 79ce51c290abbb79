//! What the recorder reads in a record: places of channels, looked up by name once.

use crate::recording::recorder::camera::Places;
use crate::recording::schema::stillroom::RobotVector;
use crate::recording::schema::stillroom::step::Goal;
use proto::task::{Field, LINE_BYTES, Layout, Spec};

/// The channels of a recording.
#[derive(Debug)]
pub struct Channels {
    pub layout: &'static Layout,
    pub wrist_object_progress_m: Field,
    pub object_goal_progress_m: Field,
    pub disturbance_progress_m: Field,
    pub failed_action: Field,
    pub picked_up: Field,
    pub goal_success: Field,
    pub disturbance_m: Field,
    pub peak_disturbance_m: Field,
    pub wrist_object_m: Field,
    pub object_goal_m: Field,
    pub disturbed_objects: Field,
    pub held: Field,
    pub target: Field,
    pub wrist_to_object_m: Field,
    pub object_to_goal_m: Field,
    pub holding: Field,
    pub current_target: Field,
    base_position_m: Field,
    base_yaw_rad: Field,
    camera_pitch_rad: Field,
    wrist_position_m: Field,
    target_position_m: Field,
    goal_position_m: Field,
    pub depth_mm: Field,
}

impl Channels {
    /// Those of a task.
    ///
    /// # Panics
    /// If it lacks one.
    pub fn of(task: &'static Spec) -> Self {
        let named =
            |name: &str| task.channel(name).unwrap_or_else(|| panic!("task `{}` has no channel `{name}`", task.name)).1;
        Self {
            layout: task.layout(),
            wrist_object_progress_m: named("wrist_object_progress_m"),
            object_goal_progress_m: named("object_goal_progress_m"),
            disturbance_progress_m: named("disturbance_progress_m"),
            failed_action: named("failed_action"),
            picked_up: named("picked_up"),
            goal_success: named("goal_success"),
            disturbance_m: named("disturbance_m"),
            peak_disturbance_m: named("peak_disturbance_m"),
            wrist_object_m: named("wrist_object_m"),
            object_goal_m: named("object_goal_m"),
            disturbed_objects: named("disturbed_objects"),
            held: named("held"),
            target: named("target"),
            wrist_to_object_m: named("wrist_to_object_m"),
            object_to_goal_m: named("object_to_goal_m"),
            holding: named("holding"),
            current_target: named("current_target"),
            base_position_m: named("base_position_m"),
            base_yaw_rad: named("base_yaw_rad"),
            camera_pitch_rad: named("camera_pitch_rad"),
            wrist_position_m: named("wrist_position_m"),
            target_position_m: named("target_position_m"),
            goal_position_m: named("goal_position_m"),
            depth_mm: named("depth_mm"),
        }
    }

    /// Cache lines of a record, and of its beginning: all but images.
    pub fn lines(&self) -> [usize; 2] {
        [self.layout.bytes, self.layout.small_bytes].map(|bytes| bytes / LINE_BYTES)
    }

    /// Whether a record whose header has these bits holds the frame.
    pub fn has_frame(&self, bulk: u32) -> bool {
        let place = self.layout.images.iter().position(|&image| image == self.depth_mm);
        place.is_some_and(|place| bulk & 1 << place != 0)
    }

    /// What the goal sensor reads, and which of its two readings that is.
    pub fn goal(&self, record: &[u8]) -> Goal {
        let vector = |field: Field| {
            let [x, y, z] = vector(field, record);
            RobotVector { x, y, z }
        };
        if is(self.holding, record) {
            Goal::ObjectToGoalM(vector(self.object_to_goal_m))
        } else {
            Goal::WristToObjectM(vector(self.wrist_to_object_m))
        }
    }

    /// Where robot, camera, wrist, target and goal are.
    pub fn places(&self, record: &[u8]) -> Places {
        Places {
            base_position_m: vector(self.base_position_m, record),
            base_yaw_rad: self.base_yaw_rad.f32(record),
            camera_pitch_rad: self.camera_pitch_rad.f32(record),
            wrist_position_m: vector(self.wrist_position_m, record),
            target_position_m: vector(self.target_position_m, record),
            goal_position_m: vector(self.goal_position_m, record),
        }
    }
}

/// Numbers of a channel.
pub fn vector<const N: usize>(field: Field, record: &[u8]) -> [f32; N] {
    field.of(record).try_into().expect("as long as it is declared")
}

/// Whether a channel's number is not 0.
pub fn is(field: Field, record: &[u8]) -> bool {
    field.number(record) != 0.0
}

/// A channel's number, a whole one.
pub fn whole(field: Field, record: &[u8]) -> u32 {
    field.number(record) as u32
}
