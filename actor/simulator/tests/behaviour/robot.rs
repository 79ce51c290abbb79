//! The robot as a whole: the arm against an independent implementation of its published chain, and its links against
//! the robot's own body.

use proptest::prelude::*;
use rapier3d::math::{Pose3, Vec3};
use serde_json::Value;
use simulator::physics::gap::gap_m;
use simulator::physics::geometry::Solid;
use simulator::robot::action::Action;
use simulator::robot::arm::{self, Joints};
use simulator::robot::configuration::{Configuration, Posture};
use simulator::robot::dimensions::{FOREARM_LENGTH_M, SCALE, UPPER_ARM_LENGTH_M, WRIST_LENGTH_M};
use simulator::robot::links::{HAND, Motion, part_poses, part_shapes};

fn numbers<const N: usize>(value: &Value) -> [f32; N] {
    let numbers: Vec<f32> = value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap() as f32).collect();
    numbers.try_into().unwrap()
}

/// `tests/behaviour/reference/gen3_chain.py` wrote the fixture.
#[test]
fn forward_kinematics_is_that_of_the_published_chain() {
    let fixture: Value = serde_json::from_str(include_str!("reference/gen3_chain.json")).unwrap();
    assert!((fixture["scale"].as_f64().unwrap() - f64::from(SCALE)).abs() < 1e-6);
    let cases = fixture["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 64);
    for case in cases {
        let [base_roll_rad, shoulder_rad, upper_arm_roll_rad, elbow_rad, wrist_yaw_rad, wrist_pitch_rad] =
            numbers(&case["joints_rad"]);
        let joints =
            Joints { base_roll_rad, shoulder_rad, upper_arm_roll_rad, elbow_rad, wrist_yaw_rad, wrist_pitch_rad };
        assert!(arm::within_limits(&joints));
        let frames = arm::forward(&joints);
        let off = |found: Vec3, wanted: &Value| (found - Vec3::from_array(numbers(wanted))).length();
        assert!(off(frames.elbow, &case["elbow_m"]) < 1e-5, "{case}: {frames:?}");
        assert!(off(frames.wrist, &case["wrist_m"]) < 1e-5, "{case}: {frames:?}");
        for (axis, wanted) in [Vec3::X, Vec3::Y, Vec3::Z].into_iter().zip(case["hand_axes"].as_array().unwrap()) {
            assert!(off(frames.hand * axis, wanted) < 1e-5, "{case}: {frames:?}");
        }
    }
}

fn posture() -> impl Strategy<Value = Posture> {
    let place = (-3f32..3.0, -3f32..3.0, -3.1f32..3.1, 0.451f32..1.801);
    let wrist = (-0.6f32..0.6, -0.6f32..0.6, -0.3f32..0.6);
    let turns = (-7f32..7.0, -2f32..2.0, -2f32..2.0);
    (place, wrist, turns).prop_map(|((x_m, z_m, yaw_rad, arm_height_m), (x, y, z), turns)| Posture {
        x_m,
        z_m,
        yaw_rad,
        arm_height_m,
        wrist_m: Vec3::new(x, y, z),
        elbow_rad: turns.0,
        wrist_yaw_rad: turns.1,
        wrist_pitch_rad: turns.2,
    })
}

/// A point of a part's own frame, in the world.
fn at(pose: &Pose3, z: f32) -> Vec3 {
    *pose * Vec3::new(0.0, 0.0, z)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2000,
        max_global_rejects: 20_000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn links_hang_together_and_stay_out_of_the_body(posture in posture()) {
        let Ok(poses) = part_poses(&posture) else { return Err(TestCaseError::reject("out of reach")) };
        let solids = part_shapes().map(|shape| Solid::of(&shape));
        let [body, shoulder, upper_arm, forearm, wrist, hand] = &poses;
        prop_assert!((at(upper_arm, -UPPER_ARM_LENGTH_M) - shoulder.translation).length() < 1e-5);
        let forearm_length_m = FOREARM_LENGTH_M - WRIST_LENGTH_M;
        prop_assert!((at(forearm, -forearm_length_m) - upper_arm.translation).length() < 1e-5);
        prop_assert!((at(wrist, -WRIST_LENGTH_M) - forearm.translation).length() < 1e-5);
        prop_assert!((hand.translation - wrist.translation).length() < 1e-6);
        let (sin, cos) = posture.yaw_rad.sin_cos();
        let way = hand.translation - shoulder.translation;
        let in_robot = Vec3::new(way.x * cos - way.z * sin, way.y, way.x * sin + way.z * cos);
        prop_assert!((in_robot - posture.wrist_m).length() < 2e-5, "{in_robot}");
        // What is drawn and collides agrees with where the joints are.
        let (capsule, body_from_part) = &solids[2].parts[0];
        let aabb = capsule.compute_aabb(&(*upper_arm * *body_from_part));
        let middle = 0.5 * (upper_arm.translation + shoulder.translation);
        prop_assert!((aabb.center() - middle).length() < 1e-5);
        for (solid, pose) in solids.iter().zip(&poses).skip(2) {
            let (shape, body_from_part) = &solid.parts[0];
            let depth_m = -gap_m(&(*pose * *body_from_part), shape, body, &solids[0].parts[0].0);
            prop_assert!(depth_m < 1e-4, "{depth_m} m in the body");
        }
    }

    /// A motion that keeps the arm's form takes the short way, to the same bits.
    #[test]
    fn a_rigid_motion_gives_the_same_bits(posture in posture(), x in -1f32..1.0, yaw in -3f32..3.0, t in 0f32..1.0) {
        prop_assume!(posture.joints().is_ok());
        let to = Posture { x_m: posture.x_m + x, yaw_rad: yaw, arm_height_m: 1.0, ..posture };
        prop_assert!(posture.same_arm(&to));
        let motion = Motion::between(&posture, &to).unwrap();
        prop_assert_eq!(motion.at(t).unwrap(), part_poses(&posture.towards(&to, t)).unwrap());
    }
}

/// The origins of the links are their far ends: no point of a link travels further than the furthest of them.
#[test]
fn no_point_of_a_link_outruns_the_origins() {
    let mut compared = 0;
    for seed in 0..40 {
        let mut robot = Configuration::start(0.3, -0.2, 1);
        for step in 0..200_usize {
            let action = Action::ALL[(seed * 7 + step * (seed + 3) * 5 + step / 7) % 14];
            let Some(next) = robot.after(action) else { continue };
            let (Ok(before), Ok(after)) = (part_poses(&robot.posture()), part_poses(&next.posture())) else { continue };
            let travel = |part: usize, z: f32| (at(&after[part], z) - at(&before[part], z)).length();
            let furthest = (1..=HAND).map(|part| travel(part, 0.0)).fold(0.0, f32::max);
            for (part, length_m) in
                [(2, UPPER_ARM_LENGTH_M), (3, FOREARM_LENGTH_M - WRIST_LENGTH_M), (4, WRIST_LENGTH_M)]
            {
                for share in [0.25, 0.5, 0.75, 1.0] {
                    assert!(travel(part, -share * length_m) <= furthest + 1e-5);
                }
            }
            compared += 1;
            robot = next;
        }
    }
    assert!(compared > 2000, "{compared} motions");
}
