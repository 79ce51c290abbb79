use super::camera::{Camera, Projection};
use super::canvas::{Canvas, Rgb};
use super::model::Model;
use super::shade::Exposure;
use super::sky::{self, Lit};
use super::visible::{NOTHING, Visible};
use rapier3d::math::{Pose3, Vec3};
use simulator::depth::{NEAR_M, TAN_HALF_FIELD_OF_VIEW};
use simulator::kitchen::Kitchen;
use simulator::physics::geometry::rotation_x;
use simulator::robot::configuration::Configuration;
use simulator::robot::links::{part_poses, world_from_camera};
use std::f32::consts::FRAC_PI_2;

/// Height at which the floor plan is cut, metres: above the counters, below the wall cabinets.
const SECTION_M: f32 = 1.4;
/// Looks down (30 degrees each) in the robot's view: level, half of the picture would be wall.
const LOOK_TICKS: i32 = 1;
const ARM_HEIGHT_TICKS: i32 = 6;
const TRIALS: usize = 40;
const TRIAL_SIDE: usize = 96;
const SEEN_PIXELS: usize = 4;
const TOO_NEAR_M: f32 = 0.6;

pub struct Views {
    pub plan: Canvas,
    pub robot: Canvas,
}

impl Views {
    pub fn of(kitchen: &Kitchen, side: usize, paper: Rgb) -> Option<Self> {
        let furnished = Model::of(kitchen);
        let configuration = best_look(kitchen, &furnished)?;
        let poses = part_poses(&configuration.posture()).ok()?;
        let (mut whole, mut seen) = (furnished.clone(), furnished);
        whole.add_robot(&poses, true, false);
        seen.add_robot(&poses, false, false);
        let plan = Exposure::take(&whole, &PlanFrame::of(&whole).camera(), side, side, paper);
        let robot = Exposure::take(&seen, &robot_camera(pose_of(&configuration)), side, side, paper);
        let waiting: Vec<Lit> = plan.waiting().chain(robot.waiting()).collect();
        let mut light = sky::light(&seen, &waiting).into_iter();
        Some(Self { plan: plan.develop(&mut light), robot: robot.develop(&mut light) })
    }
}

#[derive(Debug, Clone, Copy)]
pub struct PlanFrame {
    /// Its middle on the highest thing, metres.
    pub centre: Vec3,
    /// Half of its extent along x and z, with a margin, metres.
    pub half_m: [f32; 2],
}

impl PlanFrame {
    pub fn of(model: &Model) -> Self {
        let (low, high) = model.bounds();
        let middle = 0.5 * (low + high);
        let margin_m = 0.01 * (high - low).x.max((high - low).z);
        let half_m = [(high - low).x, (high - low).z].map(|extent_m| 0.5 * extent_m + margin_m);
        Self { centre: Vec3::new(middle.x, high.y, middle.z), half_m }
    }

    pub fn camera(&self) -> Camera {
        let height_m = self.centre.y + 1.0;
        let pose = Pose3::from_parts(Vec3::new(self.centre.x, height_m, self.centre.z), rotation_x(FRAC_PI_2));
        let half_width_m = self.half_m[0].max(self.half_m[1]);
        Camera::new(pose, Projection::Parallel { half_width_m }, height_m - SECTION_M)
    }
}

fn pose_of(configuration: &Configuration) -> Pose3 {
    world_from_camera(&configuration.posture(), configuration.camera_pitch_rad())
}

pub fn robot_camera(world_from_camera: Pose3) -> Camera {
    Camera::new(world_from_camera, Projection::Central { tan_half_width: TAN_HALF_FIELD_OF_VIEW }, NEAR_M)
}

/// Among start poses spread over the kitchen, the one from which the robot sees the most things.
fn best_look(kitchen: &Kitchen, model: &Model) -> Option<Configuration> {
    let stands = kitchen.robot_stands();
    let step = (stands.len() / TRIALS).max(1);
    let mut best: Option<(f32, Configuration)> = None;
    for stand in stands.iter().step_by(step) {
        let mut configuration = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
        configuration.look_ticks = LOOK_TICKS;
        configuration.height_ticks = ARM_HEIGHT_TICKS;
        let camera = robot_camera(pose_of(&configuration));
        let visible = Visible::draw(&camera, TRIAL_SIDE, TRIAL_SIDE, (0..).zip(model.corners()));
        let mut pixels = vec![0usize; model.colours.len()];
        let mut too_near = 0usize;
        for (&number, &nearness) in visible.triangle.iter().zip(&visible.nearness) {
            if number != NOTHING {
                pixels[model.triangles[number as usize].body as usize] += 1;
                too_near += usize::from(nearness > 1.0 / TOO_NEAR_M);
            }
        }
        let seen = |movable: bool| {
            let counts = pixels.iter().zip(&model.movable);
            counts.filter(|&(&count, &is)| is == movable && count >= SEEN_PIXELS).count() as f32
        };
        let score = seen(true) + 0.5 * seen(false) - 40.0 * too_near as f32 / visible.triangle.len() as f32;
        if best.is_none_or(|(highest, _)| score > highest) {
            best = Some((score, configuration));
        }
    }
    Some(best?.1)
}
