use super::*;
use crate::physics::world::World;
use crate::shape::{Primitive, Shape};
use proto::kitchen::TargetCategory;
use rapier3d::math::Vec3;

/// Height from which things are set down, metres.
const DROP_M: f32 = 0.001;
const TIMESTEP_S: f32 = 1.0 / 60.0;

fn extents_m(category: &Category) -> Vec3 {
    Solid::of(category.shape).aabb(&Pose3::identity()).extents()
}

#[test]
fn every_target_is_in_every_kitchen_and_can_be_moved() {
    for target in TargetCategory::ALL {
        let category = category(target.name()).unwrap();
        assert!(category.presence == Presence::Every && category.most() == 1);
    }
    assert!(CATEGORIES.iter().all(|category| category.mass_kg > 0.0 && category.mass_kg <= 10.0));
}

/// Presence and mean counts follow the statistics of iTHOR's 30 kitchens.
#[test]
fn things_are_as_frequent_as_in_ithor() {
    assert_eq!(CATEGORIES.iter().filter(|category| category.presence == Presence::Every).count(), 24);
    let expected: f32 = CATEGORIES.iter().map(|category| category.share() * 0.5 * (1 + category.most()) as f32).sum();
    // Sum over the movable categories of kitchens / 30 x mean count.
    let reference = (24.0 * 30.0
        + [15.0, 14.0 * 1.36, 12.0 * 1.67, 10.0 * 1.1, 10.0, 10.0, 10.0 * 1.1, 7.0, 6.0 * 2.67, 4.0 * 1.25]
            .iter()
            .sum::<f32>()
        + [4.0, 3.0, 3.0, 2.0, 2.0, 2.0, 2.0, 3.0].iter().sum::<f32>())
        / 30.0;
    assert!((expected - reference).abs() < 0.2, "{expected} {reference}");
}

#[test]
fn shapes_are_centred_and_of_household_size() {
    for category in CATEGORIES.iter() {
        let aabb = Solid::of(category.shape).aabb(&Pose3::identity());
        assert!(aabb.center().length() < 1e-5, "{}", category.name);
        let extents = aabb.extents();
        assert!(extents.min_element() > 0.004 && extents.max_element() < 1.0, "{} {extents}", category.name);
    }
}

/// The bounding box is the largest volume that a thing can have, its parts together (overlaps counted twice) nearly
/// the smallest, and household materials lie between sponge and steel.
#[test]
fn densities_are_those_of_household_materials() {
    for category in CATEGORIES.iter() {
        let extents = extents_m(category);
        let box_density = category.mass_kg / (extents.x * extents.y * extents.z);
        let part_density = category.mass_kg / Solid::of(category.shape).volumes_m3().iter().sum::<f32>();
        assert!(box_density > 15.0, "{}: {box_density} kg/m3 of its box", category.name);
        assert!(part_density < 8000.0, "{}: {part_density} kg/m3 of its parts", category.name);
    }
}

/// Set down on a floor one millimetre above it, everything comes to rest where it stands, upright, and stays asleep.
#[test]
fn everything_comes_to_rest_upright() {
    let mut restless = Vec::new();
    for category in CATEGORIES.iter() {
        let solid = Solid::of(category.shape);
        let mut world = World::new(TIMESTEP_S);
        let floor = Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(2.0, 0.05, 2.0) });
        world.add_fixed(&Solid::of(&floor), Pose3::translation(0.0, -0.05, 0.0));
        let start = Vec3::new(0.0, 0.5 * extents_m(category).y + DROP_M, 0.0);
        let handle = world.add_movable(&solid, Pose3::from_translation(start), category.mass_kg, category.friction());
        let rested = world.settle(&[handle], (2.0 / TIMESTEP_S) as u32);
        let settled = *world.body(handle).position();
        let drift_m = (settled.translation - start).length();
        let tilt_degrees = (settled.rotation * Vec3::Y).dot(Vec3::Y).clamp(-1.0, 1.0).acos().to_degrees();
        for _ in 0..120 {
            world.step();
        }
        let still = world.body(handle).is_sleeping() && *world.body(handle).position() == settled;
        if !(rested && still && drift_m < 0.003 && tilt_degrees < 2.0) {
            restless.push(format!(
                "{}: rested {rested}, still {still}, drift {drift_m} m, tilt {tilt_degrees} degrees",
                category.name
            ));
        }
    }
    assert!(restless.is_empty(), "{restless:#?}");
}

/// The magnet is a ball of 0.06 m about the wrist that must come down on the target without meeting what it stands
/// on: so something of the target must be within 0.06 m of a point that is 0.06 m above the counter or higher.
#[test]
fn the_magnet_reaches_every_target_from_above() {
    const MAGNET_RADIUS_M: f32 = 0.06;
    for target in TargetCategory::ALL {
        let category = category(target.name()).unwrap();
        let solid = Solid::of(category.shape);
        let height_m = extents_m(category).y;
        // The wrist above the middle of the thing, lowered until it would be nearer to the counter than its radius.
        let lowest_m = MAGNET_RADIUS_M.max(height_m + 0.01);
        let wrist = Vec3::new(0.0, lowest_m - 0.5 * height_m, 0.0);
        let distance_m = solid.distance_to_point_m(&Pose3::identity(), wrist);
        assert!(distance_m < MAGNET_RADIUS_M, "{}: {distance_m} m", category.name);
    }
}
