//! The simulator as a whole: kitchens at rest, and the task itself.

use super::support::{environment, kitchen, random_action, reward, run, sound_step};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenId, TargetCategory};
use proto::record::End;
use rapier3d::math::Vec3;
use simulator::kitchen::BodyRole;
use simulator::kitchen::spots::Stand;
use simulator::robot::action::Action;
use simulator::simulation::{CONTACT_TOLERANCE_M, OTHERS_DRIFT_M};
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::Transition;
use simulator::tasks::arm_point_nav::episode::{Episode, GOAL_TOLERANCE_M};
use std::f32::consts::FRAC_PI_4;
use std::sync::Arc;

fn config() -> Config {
    Config::default()
}

/// `actor/tests/proofs/kitchens.rs` has how they are furnished, and that nothing moves by itself.
#[test]
fn an_episode_begins_at_rest_in_every_kitchen() {
    for id in KitchenId::all() {
        let kitchen = kitchen(id.number());
        let mut environment = environment(&kitchen, 0);
        let settled = &kitchen.settled_poses()[kitchen.static_bodies().end..];
        for episode in 6..26 {
            environment.start_episode(episode);
            let simulation = environment.simulation();
            assert!(simulation.began_at_rest(), "kitchen {id} episode {episode}: stopped, not at rest");
            // What the target was taken from, or set down beside, stays where it stood.
            let name = environment.episode().category.name();
            for (movable, body) in kitchen.movable_bodies().enumerate() {
                let moved_m = (simulation.movable_pose(movable).translation - settled[movable].translation).length();
                let body = &kitchen.bodies()[body];
                assert!(
                    body.category == name || moved_m < OTHERS_DRIFT_M,
                    "kitchen {id} episode {episode}: {} moved by {moved_m} m before the first step",
                    body.name
                );
            }
        }
    }
}

#[test]
fn kitchens_differ_and_are_the_same_each_time() {
    let (one, again, other) = (kitchen(7), kitchen(7), kitchen(8));
    assert_eq!(one.settled_poses(), again.settled_poses());
    assert_ne!(one.settled_poses(), other.settled_poses());
    let id = EnvironmentId { kitchen: one.id(), number: 0 };
    let refused = Environment::new(Arc::clone(&other), id, &config()).err().map(|error| error.to_string());
    assert_eq!(refused.as_deref(), Some("environment of kitchen 7 was given kitchen 8"));
    let roles: Vec<u8> = one
        .bodies()
        .iter()
        .map(|body| match body.role {
            BodyRole::Static => 0,
            BodyRole::Movable => 1,
            BodyRole::Robot => 2,
        })
        .collect();
    assert!(roles.is_sorted() && one.static_bodies() == (0..roles.partition_point(|&role| role == 0)));
    let mut names: Vec<&str> = one.bodies().iter().map(|body| body.name.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), one.bodies().len(), "names are unique");
}

#[test]
fn reward_parts_telescope() {
    let kitchen = kitchen(3);
    let mut environment = environment(&kitchen, 2);
    let transitions: Vec<Transition> = run(&mut environment, 2, 0, 200).into_iter().map(|(done, _)| done).collect();
    let (first, last) = (transitions[0], transitions[199]);
    assert_eq!(first.wrist_object_progress_m, 0.0);
    let sum = |part: fn(&Transition) -> f32| transitions.iter().map(|t| f64::from(part(t))).sum::<f64>();
    let wrist = sum(|t| t.wrist_object_progress_m);
    assert!((wrist - f64::from(first.wrist_object_m - last.wrist_object_m)).abs() < 1e-4);
    let disturbance = sum(|t| t.disturbance_progress_m);
    assert!((disturbance + f64::from(last.disturbance_m)).abs() < 1e-4);
    assert_eq!(environment.end(), Some(End::Truncated));
    assert!(transitions.iter().all(|t| t.peak_disturbance_m >= t.disturbance_m));
}

/// The action that brings the wrist nearest to `wanted` (world), arm and body considered one step ahead.
fn greedy(environment: &Environment, wanted: Vec3) -> Option<Action> {
    let distance =
        |environment: &Environment| (Vec3::from_array(environment.current().wrist_position_m) - wanted).length();
    Action::ALL[..8]
        .iter()
        .map(|&action| {
            let mut trial = environment.clone();
            let outcome = trial.step(action);
            (action, distance(&trial) + outcome.disturbance_m)
        })
        .filter(|(_, after)| *after < distance(environment) - 1e-4)
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(action, _)| action)
}

#[test]
fn the_target_can_be_picked_up_and_brought_to_its_goal() {
    // A greedy arm with perfect foresight of one step, from stands that face the target: it need not solve every
    // episode, but an apple beside another place on the same counter it must bring over.
    let kitchen = kitchen(1);
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let spots = kitchen.target_spots(TargetCategory::Apple);
    let mut solved = 0;
    let mut tried = 0;
    for &start in spots.iter().step_by(17) {
        let stand = kitchen.robot_stands().iter().find(|stand| {
            let (x, z) = (start.x - stand.x_m, start.z - stand.z_m);
            let (sin, cos) = (stand.yaw_ticks as f32 * FRAC_PI_4).sin_cos();
            let (ahead, aside) = (x * sin + z * cos, x * cos - z * sin);
            x.hypot(z) < 0.7 && ahead > 0.0 && aside.abs() < 0.25 * ahead
        });
        let goal = spots.iter().find(|spot| {
            let way = (**spot - start).length();
            (0.2..0.3).contains(&way) && (spot.y - start.y).abs() < 0.01
        });
        let (Some(&stand), Some(&goal)) = (stand, goal) else { continue };
        tried += 1;
        if tried > 12 || solved == 2 {
            break;
        }
        let episode = Episode { category: TargetCategory::Apple, start, goal, stand };
        let mut environment = Environment::with_episode(Arc::clone(&kitchen), id, &config(), 0, episode);
        let early = environment.clone().step(Action::PickUpMidLevel);
        assert_eq!(early.failed_action, 1.0, "the start pose holds nothing");
        // From above: reach a point over the target first, then go down to it.
        let target = Vec3::from_array(environment.current().target_position_m);
        let mut steps = 0;
        for wanted in [target + Vec3::new(0.0, 0.25, 0.0), target + Vec3::new(0.0, 0.05, 0.0)] {
            while steps < 90
                && let Some(action) = greedy(&environment, wanted)
            {
                sound_step(&mut environment, action);
                steps += 1;
            }
        }
        let picked = sound_step(&mut environment, Action::PickUpMidLevel);
        if !picked.picked_up() {
            assert_eq!(picked.failed_action, 1.0);
            continue;
        }
        assert_eq!(picked.picked_up, 1.0);
        assert!(reward(&picked) > 4.9);
        let hold = |environment: &Environment| {
            let current = environment.current();
            Vec3::from_array(current.wrist_position_m) - Vec3::from_array(current.target_position_m)
        };
        sound_step(&mut environment, Action::MoveArmHeightP);
        for wanted in [goal + Vec3::new(0.0, 0.15, 0.0), goal + Vec3::new(0.0, 0.03, 0.0)] {
            while steps < 180
                && let Some(action) = greedy(&environment, wanted + hold(&environment))
            {
                let transition = sound_step(&mut environment, action);
                assert!(transition.holds());
                steps += 1;
            }
        }
        let away = Vec3::from_array(environment.current().target_position_m) - goal;
        let done = sound_step(&mut environment, Action::DoneMidLevel);
        assert_eq!(environment.end(), Some(End::Terminated));
        let there = away.abs().max_element() <= GOAL_TOLERANCE_M;
        assert_eq!(done.succeeded(), there);
        if there {
            assert!(reward(&done) > 9.9);
            solved += 1;
        }
    }
    assert!(solved >= 2, "{solved} of {tried} episodes solved");
}

#[test]
fn a_failed_motion_ends_where_it_began() {
    let kitchen = kitchen(5);
    let mut environment = environment(&kitchen, 0);
    let mut failures = 0;
    for episode in 0..3 {
        environment.start_episode(episode);
        for step in 0..200 {
            let before = *environment.robot();
            let wrist = environment.current().wrist_position_m;
            let transition = sound_step(&mut environment, random_action(kitchen.id(), 9, episode, step));
            if transition.failed() {
                failures += 1;
                assert_eq!(before, *environment.robot());
                assert_eq!(wrist, environment.current().wrist_position_m);
            }
        }
    }
    assert!(failures > 20, "walls and joint limits stop a random robot often, here {failures} times");
}

/// The arm that is told to go through a counter, a wall or a shelf stops at it.
#[test]
fn the_arm_does_not_enter_what_is_fixed() {
    const COUNTER_HEIGHT_M: f32 = 0.9;
    let kitchen = kitchen(4);
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let spots = kitchen.target_spots(TargetCategory::Apple);
    let on_counter = |spot: &Vec3| (COUNTER_HEIGHT_M..COUNTER_HEIGHT_M + 0.15).contains(&spot.y);
    let faces_counter = |stand: &Stand| {
        let (sin, cos) = (stand.yaw_ticks as f32 * FRAC_PI_4).sin_cos();
        spots.iter().filter(|spot| on_counter(spot)).any(|spot| {
            let (x, z) = (spot.x - stand.x_m, spot.z - stand.z_m);
            let (ahead, aside) = (x * sin + z * cos, x * cos - z * sin);
            (0.4..0.7).contains(&ahead) && aside.abs() < 0.1
        })
    };
    let stands: Vec<Stand> = kitchen.robot_stands().iter().filter(|stand| faces_counter(stand)).copied().collect();
    assert!(stands.len() >= 10, "{} stands face a counter", stands.len());
    let [start, goal] = [spots[0], spots[spots.len() - 1]];

    // Up, out over the counter, down into it; then out from below its edge; then against whatever is ahead.
    let script = [
        (Action::MoveArmHeightP, 12),
        (Action::MoveArmZP, 8),
        (Action::MoveArmHeightM, 20),
        (Action::MoveArmYM, 8),
        (Action::MoveArmZM, 8),
        (Action::MoveArmHeightM, 20),
        (Action::MoveArmZP, 12),
        (Action::MoveArmXP, 6),
        (Action::MoveAheadContinuous, 15),
    ];
    let mut stopped = [0; 3];
    for stand in stands.iter().step_by(stands.len() / 10).copied() {
        let episode = Episode { category: TargetCategory::Apple, start, goal, stand };
        let mut environment = Environment::with_episode(Arc::clone(&kitchen), id, &config(), 0, episode);
        let actions = script.iter().flat_map(|&(action, count)| std::iter::repeat_n(action, count));
        for (step, action) in actions.enumerate() {
            let within_range = environment.robot().after(action).is_some();
            let moved = sound_step(&mut environment, action);
            let depth_m = environment.simulation().depth_in_fixed_m();
            assert!(depth_m <= CONTACT_TOLERANCE_M, "{stand:?}, step {step}, {action:?}: {depth_m} m deep");
            if within_range && moved.failed() {
                match action {
                    Action::MoveArmHeightM => stopped[0] += 1,
                    Action::MoveArmZP => stopped[1] += 1,
                    Action::MoveAheadContinuous => stopped[2] += 1,
                    _ => {}
                }
            }
        }
    }
    println!("stopped downwards, outwards, ahead: {stopped:?}");
    assert!(stopped.iter().all(|&count| count >= 10), "stopped downwards, outwards, ahead: {stopped:?} times");
}

#[test]
fn out_of_a_jam_the_robot_can_leave() {
    // Once every motion failed, even the arm's, while a chair was wedged against the body.
    let mut jams = 0;
    for number in [4, 8, 13, 24] {
        let kitchen = kitchen(number);
        let mut config = config();
        config.episode.max_steps = 10_000;
        let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
        for stand in kitchen.robot_stands().iter().step_by(7) {
            let mut episode = Episode::sample(&kitchen, &config.episode, config.seed, id, 0);
            episode.stand = *stand;
            let mut environment = Environment::with_episode(Arc::clone(&kitchen), id, &config, 0, episode);
            let mut ahead = (0..30).map(|_| environment.step(Action::MoveAheadContinuous));
            let last = ahead.find(Transition::failed);
            let Some(last) = last else { continue };
            if last.disturbed_objects == 0 {
                continue;
            }
            jams += 1;
            let ways_out = Action::ALL[..19].iter().filter(|&&action| {
                let looks = matches!(action, Action::LookUp | Action::LookDown);
                !looks && !environment.clone().step(action).failed()
            });
            assert!(ways_out.count() > 3, "kitchen {number}: at {stand:?} the robot drove itself stuck");
        }
    }
    assert!(jams > 10, "only {jams} drives ended at something that had been pushed");
}
