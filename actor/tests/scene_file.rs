//! Scenes from files: a kitchen that goes out as glTF and comes back, and what is said of scenes that cannot be used.

// Helpers of tests are tests too, which clippy's own exception does not see.
#![allow(clippy::unwrap_used)]

use actor::environment::Environment;
use actor::gltf::export;
use actor::kitchen::scene_file::{self, Role, SceneFile};
use actor::kitchen::{BodyRole, Kitchen};
use actor::physics::geometry::Solid;
use actor::shape::Primitive;
use proto::action::Action;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::message::transition_flag;
use rapier3d::geometry::Aabb;
use std::path::Path;
use std::sync::Arc;

fn kitchen(number: u8) -> Kitchen {
    Kitchen::build(KitchenId::new(number).unwrap(), &Config::default().simulation).unwrap()
}

/// Writes a kitchen with its scene file, changed by `change`.
fn export(kitchen: &Kitchen, folder: &Path, change: impl Fn(&mut SceneFile)) -> std::path::PathBuf {
    std::fs::write(folder.join("kitchen.glb"), export::glb(kitchen)).unwrap();
    let mut file = export::scene_file(kitchen, "kitchen.glb");
    change(&mut file);
    let path = folder.join("scene.toml");
    std::fs::write(&path, toml::to_string(&file).unwrap()).unwrap();
    path
}

fn load(path: &Path) -> Result<Kitchen, String> {
    let id = KitchenId::scene(0).unwrap();
    scene_file::load(path, id, &Config::default().simulation).map_err(|error| error.to_string())
}

fn aabbs(kitchen: &Kitchen) -> Vec<(String, Aabb)> {
    let bodies = kitchen.bodies().iter().zip(kitchen.settled_poses());
    let present = bodies.filter(|(body, _)| body.role != BodyRole::Robot);
    present.map(|(body, pose)| (body.name.clone(), Solid::of(&body.shape).aabb(pose))).collect()
}

fn difference_m(a: &Aabb, b: &Aabb) -> f32 {
    (a.mins - b.mins).abs().max((a.maxs - b.maxs).abs()).max_element()
}

/// Takes every step of an episode in which the robot only looks around; nothing may move.
fn stand_still(kitchen: Kitchen) {
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let mut environment = Environment::new(Arc::new(kitchen), id, &Config::default()).unwrap();
    for step in 0..200 {
        let action = if step % 2 == 0 { Action::LookDown } else { Action::LookUp };
        let transition = environment.step(action);
        assert_eq!(transition.disturbance_m, 0.0, "something moves by itself at step {step}");
        assert_eq!(transition.flags & transition_flag::ENDED != 0, step == 199);
    }
}

#[test]
fn the_example_is_sound() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/studio/scene.toml");
    let kitchen = load(&path).unwrap();
    let targets: Vec<&str> = kitchen.training_targets().iter().map(|target| target.name()).collect();
    assert_eq!(targets, ["Apple", "Bread", "Tomato", "Pot", "Mug"]);
    // Round things and boxes were recognised: hulls are the fruits' and the turned ones only.
    let hulls: Vec<&str> = kitchen
        .bodies()
        .iter()
        .filter(|body| body.shape.parts.iter().any(|part| matches!(part.primitive, Primitive::Hull { .. })))
        .map(|body| body.category.as_str())
        .collect();
    assert_eq!(hulls, ["GarbageCan", "Apple", "Tomato", "Plate", "Kettle", "Vase"]);
    // Counter, table, three boards.
    assert_eq!(kitchen.surfaces().len(), 5);
    stand_still(kitchen);
}

#[test]
fn a_kitchen_that_goes_out_comes_back() {
    for number in [1, 13, 26] {
        let folder = tempfile::tempdir().unwrap();
        let original = kitchen(number);
        let path = export(&original, folder.path(), |_| {});
        // As it was read, before physics has its say again.
        let room = scene_file::read(&path).unwrap().room;
        let fixtures = room.fixtures.iter().map(|fixture| Solid::of(&fixture.shape).aabb(&fixture.pose));
        let things = room.things.iter().map(|thing| thing.solid.aabb(&thing.pose));
        let expected = aabbs(&original);
        assert_eq!(expected.len(), room.fixtures.len() + room.things.len());
        for ((name, before), after) in expected.iter().zip(fixtures.chain(things)) {
            let difference = difference_m(before, &after);
            assert!(difference < 1e-4, "kitchen {number}: {name} differs by {difference} m");
        }
        let again = load(&path).unwrap();
        for ((name, before), (other, after)) in expected.iter().zip(&aabbs(&again)) {
            assert_eq!(name, other);
            let difference = difference_m(before, after);
            assert!(difference < 1e-3, "kitchen {number}: {name} moved by {difference} m");
        }
        for index in 0..original.bodies().len() {
            assert_eq!(original.matter(index), again.matter(index));
            let parts = |kitchen: &Kitchen| kitchen.bodies()[index].shape.parts.len();
            assert_eq!(parts(&original), parts(&again));
        }
        for category in again.training_targets() {
            let (before, after) = (original.target_spots(category).len(), again.target_spots(category).len());
            assert!(after * 10 >= before * 9, "{category:?}: {after} spots of {before}");
        }
        stand_still(again);
    }
}

#[test]
fn everything_that_is_wrong_is_said_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let kitchen = kitchen(3);
    let path = export(&kitchen, folder.path(), |file| {
        file.nodes.retain(|entry| entry.name != "Toaster");
        let find = |name: &str| file.nodes.iter().position(|entry| entry.name == name).unwrap();
        let (mug, pan, apple, floor, fridge) = (find("Mug"), find("Pan"), find("Apple"), find("Floor"), find("Fridge"));
        file.nodes[mug].mass_kg = None;
        file.nodes[pan].mass_kg = Some(12.0);
        file.nodes[apple].category = Some("Aple".into());
        file.nodes[floor].role = Role::Fixed;
        file.nodes[fridge].mass_kg = Some(60.0);
        let mut lost = file.nodes[fridge].clone();
        lost.name = "Frige*".into();
        file.nodes.push(lost);
    });
    let message = load(&path).unwrap_err();
    for expected in [
        "scene.toml: 7 things are wrong",
        "node Toaster: no entry says what it is",
        "node Mug: is movable and has no mass",
        "node Pan: mass_kg = 12",
        "node Apple: there is no category `Aple` (did you mean `Apple`?)",
        "no entry has the role `floor`",
        "node Fridge: mass_kg and friction are for role `movable` only",
        "no node is called `Frige*` (did you mean `Fridge`?)",
    ] {
        assert!(message.contains(expected), "`{expected}` is not in:\n{message}");
    }
}

#[test]
fn a_thing_that_hangs_in_the_air_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let kitchen = kitchen(3);
    // What carried it is gone.
    let path = export(&kitchen, folder.path(), |file| {
        let tops: Vec<usize> = (0..file.nodes.len()).filter(|&i| file.nodes[i].role == Role::Surface).collect();
        for &top in &tops[1..] {
            file.nodes[top].role = Role::Ignore;
        }
    });
    let message = load(&path).unwrap_err();
    assert!(message.contains("while coming to rest: it hangs in the air"), "{message}");
}

#[test]
fn files_that_are_not_there_or_not_sound_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    assert!(load(&path).unwrap_err().contains("scene.toml: cannot be read"));
    for (text, expected) in [
        ("gltf = 'a.glb'\nnode = []\nmass = 3", "scene.toml: line 3: unknown field `mass`"),
        ("gltf = '../a.glb'\nnode = []", "outside of this file's folder"),
        ("gltf = 'a.glb'\nnode = []", "a.glb: cannot be read"),
        ("gltf = 'b.glb'\nnode = []", "b.glb: is not sound glTF 2.0"),
    ] {
        std::fs::write(&path, text).unwrap();
        std::fs::write(folder.path().join("b.glb"), "no glTF").unwrap();
        let message = load(&path).unwrap_err();
        assert!(message.contains(expected), "`{expected}` is not in: {message}");
    }
}
