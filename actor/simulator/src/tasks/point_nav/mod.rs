//! `PointNav` (Wijmans et al. 2020, DD-PPO): drive to a point of the room, with `ArmPointNav`'s robot in its kitchens.
//!
//! The robot drives 0.2 m and turns by 45 degrees. Lengths of ways are those on the free floor, in which each step goes
//! along an axis or diagonally, as the robot does: on an open floor a robot that wastes nothing has an SPL of 1.

use crate::environment::{Base, Environment};
use crate::kitchen::Kitchen;
use crate::kitchen::floor::{Floor, Ways};
use crate::kitchen::spots::Stand;
use crate::physics::geometry::rotation_y;
use crate::robot::action::Action;
use crate::robot::configuration::Configuration;
use crate::simulation::Start;
use crate::tasks::run::{OpenError, Run};
use proto::config::EpisodeConfig;
use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose, Random};
use rapier3d::math::Vec3;
use std::sync::Arc;

include!(concat!(env!("OUT_DIR"), "/point_nav.rs"));

/// Stop succeeds where the shortest way to the goal is shorter than this, metres (DD-PPO).
const SUCCESS_M: f32 = 0.2;
const WAY_LEAST_M: f32 = 0.5;
/// Seed of an evaluation's episodes. No run's seed: two policies are compared on the same ones.
const EVALUATION_SEED: u64 = 0x4556_414c;
/// What the robot does on each action; the first, Stop, ends the episode.
const MOTIONS: [Option<Action>; 4] =
    [None, Some(Action::MoveAheadContinuous), Some(Action::RotateLeftContinuous), Some(Action::RotateRightContinuous)];

#[derive(Debug, Clone)]
struct Episode {
    stand: Stand,
    /// World x and z, metres.
    goal: (f32, f32),
    ways: Ways,
    way_m: f32,
}

impl Episode {
    /// One that `random` draws: any goal at which a robot could start, and any start from which the way is neither too
    /// short nor, if `config` sets a limit, too long; the nearest to that where there is none.
    fn draw(kitchen: &Kitchen, floor: &Floor, config: &EpisodeConfig, random: &mut Random) -> Self {
        let stands = kitchen.robot_stands();
        let goal = stands[random.below(stands.len() as u32) as usize];
        let goal = (goal.x_m, goal.z_m);
        let ways = floor.ways_to(goal);
        let most_m = if config.goal_distance_max_m > 0.0 { config.goal_distance_max_m } else { f32::INFINITY };
        let (mut near, mut nearest) = (Vec::new(), (f32::INFINITY, stands[0], 0.0));
        for &stand in stands {
            let way_m = floor.way_m(&ways, (stand.x_m, stand.z_m));
            let outside_m = (WAY_LEAST_M - way_m).max(way_m - most_m);
            if outside_m <= 0.0 && way_m.is_finite() {
                near.push((stand, way_m));
            } else if outside_m < nearest.0 {
                nearest = (outside_m, stand, way_m);
            }
        }
        let (stand, way_m) = match near.len() {
            0 => (nearest.1, nearest.2),
            count => near[random.below(count as u32) as usize],
        };
        Self { stand, goal, ways, way_m }
    }
}

/// One environment: the kitchen during an episode, the way to go, and the way that the robot went.
#[derive(Clone)]
struct PointNav {
    base: Base,
    run: Arc<Run>,
    id: EnvironmentId,
    floor: Floor,
    episode: Episode,
    goal_distance_m: f32,
    path_m: f32,
}

/// An environment of a run, at the start of its episode with this number.
pub(super) fn open(
    run: &Arc<Run>,
    kitchen: &Arc<Kitchen>,
    id: EnvironmentId,
    number: u32,
) -> Result<Box<dyn Environment>, OpenError> {
    let environment = PointNav::of(run, kitchen, id, number);
    if environment.episode.way_m < WAY_LEAST_M {
        let problem = format!("kitchen {} has no room for the robot to drive {WAY_LEAST_M} m", id.kitchen);
        return Err(OpenError::NoEpisodes(problem));
    }
    Ok(Box::new(environment))
}

impl PointNav {
    /// A kitchen is only built with free floor for the robot.
    fn of(run: &Arc<Run>, kitchen: &Arc<Kitchen>, id: EnvironmentId, number: u32) -> Self {
        let floor = kitchen.free_floor();
        let episode = episode(run, kitchen, &floor, id, number);
        let base = Base::new(Arc::clone(kitchen), &run.config, run.hashed_number(id, number), start(&episode));
        let (run, goal_distance_m) = (Arc::clone(run), episode.way_m);
        Self { base, run, id, floor, episode, goal_distance_m, path_m: 0.0 }
    }

    fn step(&mut self, action: u8) -> Transition {
        assert!(!self.base.ended(), "the episode has ended: start the next one before the next action");
        let motion = MOTIONS[usize::from(action)];
        let from = *self.base.robot();
        let to = motion.and_then(|motion| from.after(motion));
        let moved = to.is_some_and(|to| self.base.simulation.perform(to));
        if to.is_none() {
            self.base.simulation.idle();
        }
        let robot = *self.base.robot();
        let (x_m, z_m) = (robot.x_m - from.x_m, robot.z_m - from.z_m);
        self.path_m += f32::sqrt(x_m * x_m + z_m * z_m);
        let way_m = self.floor.way_m(&self.episode.ways, (robot.x_m, robot.z_m));
        let success = motion.is_none() && way_m < SUCCESS_M;
        let [before, displacement] = self.base.count(motion.is_none());
        let one_if = |condition: bool| f32::from(u8::from(condition));
        Transition {
            goal_progress_m: std::mem::replace(&mut self.goal_distance_m, way_m) - way_m,
            disturbance_progress_m: (before.total_m - displacement.total_m) as f32,
            failed_action: one_if(!moved && !success),
            goal_success: one_if(success),
            disturbance_m: displacement.total_m as f32,
            goal_distance_m: way_m,
            path_m: self.path_m,
            spl: one_if(success) * self.episode.way_m / self.episode.way_m.max(self.path_m).max(SUCCESS_M),
        }
    }

    fn current(&self) -> Current {
        let (robot, (goal_x_m, goal_z_m)) = (self.base.robot(), self.episode.goal);
        let (x_m, z_m, yaw_rad) = (robot.x_m, robot.z_m, robot.yaw_rad());
        let goal = rotation_y(-yaw_rad) * Vec3::new(goal_x_m - x_m, 0.0, goal_z_m - z_m);
        Current {
            goal_m: [goal.x, 0.0, goal.z],
            base_position_m: [x_m, z_m],
            base_yaw_rad: yaw_rad,
            camera_pitch_rad: robot.camera_pitch_rad(),
            goal_position_m: [goal_x_m, 0.0, goal_z_m],
        }
    }
}

/// An environment's episode of this number, a pure function of what is given; in an evaluation of its number there alone.
fn episode(run: &Run, kitchen: &Kitchen, floor: &Floor, id: EnvironmentId, number: u32) -> Episode {
    let key = match run.dealt(id, number) {
        Some(dealt) => Key::episode(EVALUATION_SEED, Purpose::EvaluationEpisode, id.kitchen, 0, dealt),
        None => Key::episode(run.config.seed, Purpose::Episode, id.kitchen, id.number, number),
    };
    Episode::draw(kitchen, floor, &run.config.episode, &mut key.stream())
}

fn start(episode: &Episode) -> Start {
    let Stand { x_m, z_m, yaw_ticks } = episode.stand;
    Start { robot: Configuration::start(x_m, z_m, yaw_ticks), set_down: None }
}

impl Environment for PointNav {
    fn begin(&mut self, number: u32) {
        self.episode = episode(&self.run, self.base.kitchen(), &self.floor, self.id, number);
        self.base.begin(self.run.hashed_number(self.id, number), start(&self.episode));
        (self.goal_distance_m, self.path_m) = (self.episode.way_m, 0.0);
    }

    fn prepare(&mut self, number: u32) -> bool {
        let Self { base, run, id, floor, .. } = self;
        base.prepare(run.hashed_number(*id, number), |kitchen| start(&episode(run, kitchen, floor, *id, number)))
    }

    fn act(&mut self, action: &[u8], done: &mut [u8]) {
        self.step(action[0]).write(done);
    }

    fn observe(&self, seen: &mut [u8]) {
        self.current().write(seen);
    }

    fn before_first(&self, done: &mut [u8]) {
        Transition { goal_distance_m: self.goal_distance_m, ..Transition::default() }.write(done);
    }

    fn base(&self) -> &Base {
        &self.base
    }

    fn base_mut(&mut self) -> &mut Base {
        &mut self.base
    }

    fn boxed(&self) -> Box<dyn Environment> {
        Box::new(self.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::Config;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::{KitchenId, Split};
    use std::cmp::Reverse;
    use std::collections::{BTreeSet, BinaryHeap};

    const STOP: u8 = 0;
    const AHEAD: u8 = 1;
    const LEFT: u8 = 2;
    const RIGHT: u8 = 3;

    fn config(goal_distance_max_m: f32) -> Config {
        let mut config = Config { task: "point_nav".to_owned(), ..Config::default() };
        config.episode.goal_distance_max_m = goal_distance_max_m;
        config
    }

    fn kitchen(number: u32) -> Arc<Kitchen> {
        Arc::new(Kitchen::build(KitchenId::new(number).unwrap(), &Config::default().simulation).unwrap())
    }

    fn environment(kitchen: &Arc<Kitchen>, config: &Config, number: u32) -> PointNav {
        PointNav::of(&Run::of(config), kitchen, EnvironmentId { kitchen: kitchen.id(), number: 0 }, number)
    }

    /// Where the robot stands, to the centimetre, and which way it faces.
    fn pose(robot: &Configuration) -> (i32, i32, i32) {
        ((robot.x_m * 1e2).round() as i32, (robot.z_m * 1e2).round() as i32, robot.yaw_ticks)
    }

    /// The first of the fewest actions to the goal, none of which has failed there before; Stop where there are none.
    fn advise(environment: &PointNav, failed: &BTreeSet<((i32, i32, i32), u8)>) -> u8 {
        let way_m = |at: &Configuration| environment.floor.way_m(&environment.episode.ways, (at.x_m, at.z_m));
        let mut open = BinaryHeap::from([Reverse((0, 0, STOP, 0))]);
        let (mut nodes, mut seen) = (vec![*environment.base.robot()], BTreeSet::new());
        while let Some(Reverse((_, cost, first, node))) = open.pop().filter(|_| nodes.len() < 30_000) {
            let at = nodes[node];
            if way_m(&at) < SUCCESS_M {
                return first;
            }
            if !seen.insert(pose(&at)) {
                continue;
            }
            for action in [AHEAD, LEFT, RIGHT] {
                let Some(to) = at.after(MOTIONS[usize::from(action)].unwrap()) else { continue };
                if !failed.contains(&(pose(&at), action)) {
                    let total = cost + 1 + (way_m(&to) / 0.2) as u32;
                    let first = if cost == 0 { action } else { first };
                    open.push(Reverse((total, cost + 1, first, nodes.len())));
                    nodes.push(to);
                }
            }
        }
        STOP
    }

    /// Drives along the shortest way, around what was found to be in it, and stops at the goal. Returns all that it did.
    fn drive(environment: &mut PointNav) -> Vec<Transition> {
        let (mut failed, mut done) = (BTreeSet::new(), Vec::new());
        while !environment.base.ended() {
            let at = pose(environment.base.robot());
            let action = advise(environment, &failed);
            done.push(environment.step(action));
            if done.last().is_some_and(|done| done.failed_action != 0.0) {
                failed.insert((at, action));
            }
        }
        done
    }

    #[test]
    fn who_drives_along_the_shortest_way_gets_there() {
        let (mut successes, mut spl, mut episodes) = (0.0, 0.0, 0.0);
        for kitchen in [1, 7, 22].map(kitchen) {
            let mut environment = environment(&kitchen, &config(2.0), 0);
            for number in 0..30 {
                environment.begin(number);
                let way_m = environment.episode.way_m;
                assert!((0.5..=2.0).contains(&way_m), "{way_m} m");
                let done = drive(&mut environment);
                let last = done.last().unwrap();
                assert!(
                    (done.iter().map(|done| done.goal_progress_m).sum::<f32>() - (way_m - last.goal_distance_m)).abs()
                        < 1e-3
                );
                // 0.2 m each time that it drove.
                let path_m = 0.2 * done.windows(2).filter(|pair| pair[1].path_m > pair[0].path_m).count() as f32
                    + done[0].path_m;
                assert!(
                    (last.path_m - path_m).abs() < 1e-3
                        && last.goal_success >= last.spl
                        && (last.spl > 0.0) == (last.goal_success > 0.0)
                );
                if last.goal_success > 0.0 {
                    assert!((last.spl - way_m / way_m.max(path_m)).abs() < 1e-3);
                }
                (successes, spl, episodes) = (successes + last.goal_success, spl + last.spl, episodes + 1.0);
            }
        }
        assert!(successes / episodes > 0.95 && spl / episodes > 0.9, "{successes} and {spl} of {episodes}");
    }

    #[test]
    fn the_goal_is_seen_from_the_robot() {
        let kitchen = kitchen(7);
        let mut environment = environment(&kitchen, &config(0.0), 3);
        for action in [LEFT, AHEAD, RIGHT, RIGHT, AHEAD, AHEAD] {
            let Current { goal_m: [x, y, z], base_position_m: [base_x, base_z], base_yaw_rad, .. } =
                environment.current();
            let [goal_x, goal_y, goal_z] = environment.current().goal_position_m;
            assert_eq!((y, goal_y, environment.current().camera_pitch_rad), (0.0, 0.0, 0.0));
            let (sin, cos) = base_yaw_rad.sin_cos();
            assert!((base_x + x * cos + z * sin - goal_x).abs() < 1e-4, "x");
            assert!((base_z - x * sin + z * cos - goal_z).abs() < 1e-4, "z");
            environment.step(action);
        }
        let last = environment.step(STOP);
        assert!(
            environment.base.ended() && last.goal_success == 0.0 && last.failed_action == 1.0,
            "that is not the goal"
        );
    }

    #[test]
    fn an_episode_is_the_same_whether_it_was_prepared_and_whoever_played_before() {
        let kitchen = kitchen(7);
        let mut one = environment(&kitchen, &config(0.0), 0);
        let mut other = environment(&kitchen, &config(0.0), 5);
        drive(&mut one);
        while one.prepare(5) {}
        one.begin(5);
        for action in [AHEAD, AHEAD, LEFT, AHEAD, RIGHT, AHEAD, STOP] {
            assert_eq!(one.base.state_hash(), other.base.state_hash());
            assert_eq!(one.step(action), other.step(action));
        }
        let mut third = environment(&kitchen, &config(0.0), 6);
        assert_ne!(third.base.state_hash(), other.base.state_hash());
        third.begin(5);
        assert_eq!(third.episode.goal, other.episode.goal);
    }

    #[test]
    fn an_evaluations_episodes_depend_on_their_number_alone() {
        let kitchen = kitchen(2);
        let played = |seed, actors: u32| {
            let mut config = Config { seed, ..config(0.0) };
            config.actors.count = 5 * actors;
            config.actors.environments_per_actor = 1;
            config.evaluation = Some(EvaluationConfig::fixed(Split::Test, ObjectSet::All, 4));
            let (run, dealt) = (Run::of(&config), 4 / actors);
            let of = |number| {
                let id = EnvironmentId { kitchen: kitchen.id(), number: number % actors };
                let environment = PointNav::of(&run, &kitchen, id, number / actors);
                (run.dealt(id, number / actors).unwrap(), environment.base.state_hash(), environment.episode.goal)
            };
            assert_eq!(run.dealt(EnvironmentId { kitchen: kitchen.id(), number: 0 }, dealt * 3), None);
            (0..4).map(of).collect::<Vec<_>>()
        };
        assert_eq!(played(1, 1), played(2, 2));
    }
}
