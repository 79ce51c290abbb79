//! One episode under a policy, as another engine needs it: where everything begins, and the robot's way.

use crate::bench::action_source::{PolicyKind, script};
use proto::camera::{FRAME_PIXELS, FRAME_SIDE};
use proto::config::Config;
use proto::episode::EnvironmentId;
use rapier3d::math::Pose3;
use simulator::depth::DepthCamera;
use simulator::kitchen::Kitchen;
use simulator::simulation::Substep;
use simulator::tasks::OpenError;
use simulator::tasks::arm_point_nav::Environment;
use std::sync::Arc;

#[derive(Debug, Default)]
pub struct Trace {
    pub world_from_movables: Vec<Pose3>,
    pub world_from_movables_at_end: Vec<Pose3>,
    pub substeps: Vec<Substep>,
    /// Sub-steps that had been taken when each action was over.
    pub substeps_until: Vec<u32>,
    pub world_from_camera: Vec<Pose3>,
    /// What the camera saw, each from another pose.
    pub frames: Vec<Frame>,
}

#[derive(Debug)]
pub struct Frame {
    pub world_from_bodies: Vec<Pose3>,
    pub world_from_camera: Pose3,
    /// The image: millimetres, row-major from the top left.
    pub depth_mm: Vec<u16>,
}

/// Plays the first episode of the kitchen's first environment.
///
/// An action takes `config.simulation.substeps` sub-steps at least: where the robot needed fewer, it stands still in
/// the rest. Of all frames from a new camera pose `frame_limit` are kept, evenly spread over the episode.
pub fn record(
    kitchen: &Arc<Kitchen>,
    config: &Config,
    kind: PolicyKind,
    frame_limit: usize,
) -> Result<Trace, OpenError> {
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let mut environment = Environment::new(Arc::clone(kitchen), id, config)?;
    let mut trace = Trace { world_from_movables: movable_poses(&environment), ..Trace::default() };
    environment.take_substeps();
    let mut camera = DepthCamera::new(kitchen.bodies());
    for action in script(kind, &environment, id, 0) {
        let before = environment.world_from_camera();
        environment.step(action);
        let first = trace.substeps.len();
        trace.substeps.extend(environment.take_substeps());
        let least = first + config.simulation.substeps as usize;
        while trace.substeps.len() < least {
            trace.substeps.push(environment.simulation().substep());
        }
        trace.substeps_until.push(trace.substeps.len() as u32);
        trace.world_from_camera.push(environment.world_from_camera());
        if environment.world_from_camera() != before {
            trace.frames.push(frame(&environment, &mut camera));
        }
    }
    thin(&mut trace.frames, frame_limit);
    trace.world_from_movables_at_end = movable_poses(&environment);
    Ok(trace)
}

fn movable_poses(environment: &Environment) -> Vec<Pose3> {
    let simulation = environment.simulation();
    (0..simulation.movable_count()).map(|index| *simulation.movable_pose(index)).collect()
}

fn frame(environment: &Environment, camera: &mut DepthCamera) -> Frame {
    let mut world_from_bodies = Vec::new();
    environment.world_from_bodies(&mut world_from_bodies);
    let world_from_camera = environment.world_from_camera();
    let mut depth_mm = vec![0; FRAME_PIXELS];
    camera.render(&world_from_bodies, world_from_camera, FRAME_SIDE, &mut depth_mm);
    Frame { world_from_bodies, world_from_camera, depth_mm }
}

/// Keeps at most `limit` elements, evenly spread.
fn thin<T>(elements: &mut Vec<T>, limit: usize) {
    let count = elements.len();
    if count > limit {
        let mut index = 0;
        elements.retain(|_| {
            let kept = index * limit / count != (index + 1) * limit / count;
            index += 1;
            kept
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::kitchen::KitchenId;

    #[test]
    fn thinning_keeps_the_limit_evenly() {
        let mut numbers: Vec<u32> = (0..10).collect();
        thin(&mut numbers, 3);
        assert_eq!(numbers, [3, 6, 9]);
        thin(&mut numbers, 3);
        assert_eq!(numbers.len(), 3);
    }

    #[test]
    fn the_robots_way_has_no_jumps_and_ends_where_the_robot_does() {
        let config = Config::default();
        let kitchen = Arc::new(Kitchen::build(KitchenId::new(1).unwrap(), &config.simulation).unwrap());
        let trace = record(&kitchen, &config, PolicyKind::Random, 3).unwrap();
        assert_eq!(trace.substeps_until.len(), config.episode.max_steps as usize);
        assert_eq!(trace.substeps_until.last().copied(), Some(trace.substeps.len() as u32));
        let least = config.simulation.substeps;
        assert!(trace.substeps_until.windows(2).all(|pair| pair[1] - pair[0] >= least), "each action takes its time");
        for pair in trace.substeps.windows(2) {
            for (before, after) in pair[0].parts.iter().zip(&pair[1].parts) {
                let moved_m = (after.translation - before.translation).length();
                assert!(moved_m < 0.05, "a part of the robot moved {moved_m} m in one sub-step");
            }
        }
        let travelled = trace.substeps.windows(2).filter(|pair| pair[0].parts != pair[1].parts).count();
        assert!(travelled > trace.substeps.len() / 4, "the robot moved in {travelled} sub-steps only");
        assert_eq!(trace.frames.len(), 3);
        assert!(trace.frames.iter().all(|frame| frame.depth_mm.iter().filter(|&&depth| depth > 0).count() > 10_000));
        let [.., last] = &trace.frames[..] else { panic!("there are frames") };
        assert!(trace.world_from_camera.contains(&last.world_from_camera));
    }
}
