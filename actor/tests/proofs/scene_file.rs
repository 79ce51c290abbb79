//! Scenes from files: a kitchen that goes out as glTF and comes back, and what is said of scenes that cannot be used.

use actor::kitchen_export;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use rapier3d::geometry::Aabb;
use serde_json::{Value, json};
use simulator::kitchen::{BodyRole, Kitchen};
use simulator::physics::geometry::Solid;
use simulator::robot::action::Action;
use simulator::scene_file::{self, Role, SceneFile};
use simulator::shape::Primitive;
use simulator::tasks::arm_point_nav::Environment;
use std::path::Path;
use std::sync::Arc;

fn kitchen(number: u32) -> Kitchen {
    Kitchen::build(KitchenId::new(number).unwrap(), &Config::default().simulation).unwrap()
}

/// Writes a kitchen with its scene file, changed by `change`.
fn export(kitchen: &Kitchen, folder: &Path, change: impl Fn(&mut SceneFile)) -> std::path::PathBuf {
    std::fs::write(folder.join("kitchen.glb"), kitchen_export::glb(kitchen)).unwrap();
    let mut file = kitchen_export::scene_file(kitchen, "kitchen.glb");
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
        assert_eq!(environment.ended(), step == 199);
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

/// The example with its scene file changed, in a folder of its own, and what is said of it.
fn studio(change: impl Fn(&str) -> String) -> Result<Kitchen, String> {
    let folder = tempfile::tempdir().unwrap();
    let studio = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/studio");
    std::fs::copy(studio.join("studio.glb"), folder.path().join("studio.glb")).unwrap();
    let text = std::fs::read_to_string(studio.join("scene.toml")).unwrap();
    let changed = change(&text);
    assert_ne!(changed, text);
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, changed).unwrap();
    load(&path)
}

#[test]
fn the_true_reason_is_given_and_what_was_probably_meant() {
    type Case<'a> = (&'a [(&'a str, &'a str)], &'a [&'a str], &'a [&'a str]);
    let surfaces = [("role = \"surface\"", "role = \"fixed\"")];
    let cases: [Case<'_>; 10] = [
        // Once: no entry has the role `surface`.
        (
            &[("\"CounterTop\"", "\"Countertop\""), ("\"Table\"", "\"Tabel\""), ("\"Shelves\"", "\"Shelf\"")],
            &["no node is called `Countertop` (did you mean `CounterTop`?)", "is the entry `Tabel` meant for it?"],
            &["no entry has the role"],
        ),
        // Once: no node is called `Table` (did you mean `Table`?), no entry has the role `floor`.
        (
            &[("[[node]]\nname = \"Floor\"", "[[node]]\nname = \"*\"\nrole = \"fixed\"\n\n[[node]]\nname = \"Floor\"")],
            &["never used: `Floor`, `Wall-*`", "take the entry `*`, which stands before; put `*` last"],
            &["did you mean", "no entry has the role", "nothing in it can be a target"],
        ),
        (&surfaces, &["no entry has the role `surface`"], &[]),
        (
            &[("\"Mug\"", "\"Mugg\""), ("\"Apple\"", "\"Aple\"")],
            &["no node is called `Mugg` (did you mean `Mug`?)"],
            &["nothing in it"],
        ),
        (
            &[("\"Window\"\nrole = \"fixed\"", "\"Window\"\nrole = \"surface\"")],
            &["widest level top is 0.02 m wide"],
            &[],
        ),
        (&[("role = \"floor\"", "role = \"flor\"")], &["line 9", "(did you mean `floor`?)"], &[]),
        (&[("mass_kg = 0.35", "mass = 0.35")], &["unknown field `mass`", "(did you mean `mass_kg`?)"], &[]),
        (&[("mass_kg = 0.35", "convex = \"decompos\"")], &["(did you mean `decompose`?)"], &[]),
        (&[("mass_kg = 0.35", "mass_kg = \"0.35\"")], &["expected a number"], &[]),
        (&[("[[node]]\nname = \"Floor\"", "[node]\nname = \"Floor\"")], &["begins with [[node]]"], &[]),
    ];
    for (changes, said, not_said) in &cases {
        let change = |text: &str| changes.iter().fold(text.to_owned(), |text, (from, to)| text.replace(from, to));
        let message = studio(change).unwrap_err();
        for expected in *said {
            assert!(message.contains(expected), "`{expected}` is not in:\n{message}");
        }
        for wrong in *not_said {
            assert!(!message.contains(wrong), "`{wrong}` is in:\n{message}");
        }
    }
}

/// Only the first was said.
#[test]
fn all_errors_of_the_text_are_said_at_once() {
    let changes = [
        ("role = \"floor\"", "role = \"flor\""),
        ("mass_kg = 0.35", "mass = 0.35\ncolour = \"red\""),
        ("\"Window\"\nrole = \"fixed\"", "\"Window\""),
    ];
    let message = studio(|text| changes.iter().fold(text.to_owned(), |text, (from, to)| text.replacen(from, to, 1)));
    let message = message.unwrap_err();
    for expected in
        ["4 things are wrong", "`floor`?)", "unknown field `mass`", "field `colour`", "missing field `role`"]
    {
        assert!(message.contains(expected), "`{expected}` is not in:\n{message}");
    }
}

#[test]
fn targets_that_are_nearly_called_so_are_named() {
    let others = ["Apple", "Bread", "Pot", "Tomato"];
    let with = |mug: &str| {
        let mug = format!("\"Mug\"\ncategory = \"{mug}\"");
        let other = |text: String, name: &&str| {
            text.replace(&format!("\"{name}\""), &format!("\"{name}\"\ncategory = \"Vase\""))
        };
        studio(|text| others.iter().fold(text.replace("\"Mug\"", &mug), other)).unwrap_err()
    };
    let message = with("TravelMug");
    assert!(message.contains("nothing in it can be a target") && !message.contains("did you mean"), "{message}");
    let message = with("Teapot");
    assert!(!message.contains("SoapBottle`"), "{message}");
}

#[test]
fn a_scene_in_other_units_is_one_problem() {
    let folder = tempfile::tempdir().unwrap();
    let kitchen = kitchen(3);
    let path = export(&kitchen, folder.path(), |_| {});
    let bytes = std::fs::read(folder.path().join("kitchen.glb")).unwrap();
    for (mut world, size) in [
        (json!({ "scale": [100, 100, 100] }), "which no kitchen has"),
        (json!({ "scale": [0.01, 0.01, 0.01] }), "glTF counts in metres"),
        (json!({ "rotation": [0.70710677, 0, 0, 0.70710677] }), "y axis points up"),
    ] {
        let changed = changed(&bytes, |root, _| {
            world["children"] = root["scenes"][0]["nodes"].clone();
            let nodes = root["nodes"].as_array_mut().unwrap();
            nodes.push(world);
            root["scenes"][0]["nodes"] = json!([nodes.len() - 1]);
        });
        std::fs::write(folder.path().join("kitchen.glb"), changed).unwrap();
        let message = load(&path).unwrap_err();
        assert!(message.contains("node Floor: is a floor of") && message.contains(size), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

/// A binary glTF file of which this changes the JSON and the binary chunk.
fn changed(glb: &[u8], change: impl FnOnce(&mut Value, &mut Vec<u8>)) -> Vec<u8> {
    let glb = gltf::binary::Glb::from_slice(glb).unwrap();
    let mut root: Value = serde_json::from_slice(&glb.json).unwrap();
    let mut bin = glb.bin.unwrap().into_owned();
    change(&mut root, &mut bin);
    let json = serde_json::to_vec(&root).unwrap().into();
    gltf::binary::Glb { header: glb.header, json, bin: Some(bin.into()) }.to_vec().unwrap()
}

/// Moves the studio's apple.
fn move_apple(root: &mut Value, to: [f32; 3]) {
    let nodes = root["nodes"].as_array_mut().unwrap();
    nodes.iter_mut().find(|node| node["name"] == "Apple").unwrap()["translation"] = json!(to);
}

/// Adds a node `Crate` with a mesh of these triangles.
fn add_crate(root: &mut Value, bin: &mut Vec<u8>, triangles: &[[[f32; 3]; 3]]) {
    let first = bin.len();
    bin.extend(triangles.as_flattened().as_flattened().iter().flat_map(|number| number.to_le_bytes()));
    root["buffers"][0]["byteLength"] = bin.len().into();
    let mut push = |list: &str, value: Value| {
        let list = root[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    };
    let length = bin.len() - first;
    let view = push("bufferViews", json!({ "buffer": 0, "byteOffset": first, "byteLength": length }));
    let positions = json!({
        "bufferView": view, "componentType": 5126, "count": 3 * triangles.len(), "type": "VEC3",
        "min": [-1, -1, -1], "max": [1, 1, 1]
    });
    let accessor = push("accessors", positions);
    let mesh = push("meshes", json!({ "primitives": [{ "attributes": { "POSITION": accessor } }] }));
    let node = push("nodes", json!({ "name": "Crate", "mesh": mesh }));
    root["scenes"][0]["nodes"].as_array_mut().unwrap().push(node.into());
}

#[test]
fn an_apple_lies_in_a_decomposed_crate_and_not_in_its_hull() {
    // A U, open at the top: 0.3 m wide, 0.2 m high, walls and floor of 0.05 m, drawn out along z.
    let outline =
        [(0.0, 0.0), (0.3, 0.0), (0.3, 0.2), (0.25, 0.2), (0.25, 0.05), (0.05, 0.05), (0.05, 0.2), (0.0, 0.2)];
    let at = |i: usize| {
        let (x, y) = outline[i % 8];
        [x - 0.15, y, if i < 8 { 0.1 } else { -0.1 }]
    };
    let caps = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [0, 4, 5], [0, 5, 7], [5, 6, 7]];
    let walls = (0..8).flat_map(|i| [[i, i + 8, (i + 1) % 8], [(i + 1) % 8, i + 8, (i + 1) % 8 + 8]]);
    let far = caps.map(|[a, b, c]| [a + 8, c + 8, b + 8]);
    let triangles: Vec<[[f32; 3]; 3]> = caps.into_iter().chain(far).chain(walls).map(|t| t.map(at)).collect();

    let folder = tempfile::tempdir().unwrap();
    let studio = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/studio");
    let glb = std::fs::read(studio.join("studio.glb")).unwrap();
    let glb = changed(&glb, |root, bin| {
        add_crate(root, bin, &triangles);
        move_apple(root, [0.0, 0.0505, 0.0]);
    });
    std::fs::write(folder.path().join("studio.glb"), glb).unwrap();
    let text = std::fs::read_to_string(studio.join("scene.toml")).unwrap();
    let path = folder.path().join("scene.toml");
    let loaded = |convex: &str| {
        let entry = format!(
            "\n[[node]]\nname = \"Crate\"\nrole = \"movable\"\nmass_kg = 1.5\ncategory = \"VegetableCrate\"\n{convex}"
        );
        std::fs::write(&path, format!("{text}{entry}")).unwrap();
        load(&path)
    };
    let refused = loaded("").unwrap_err();
    assert!(refused.contains("node Crate: primitive 0 of its mesh is not convex"), "{refused}");
    assert!(refused.contains("convex = \"decompose\""), "{refused}");
    let filled = loaded("convex = \"hull\"").unwrap_err();
    assert!(filled.contains("overlaps something"), "{filled}");

    let kitchen = loaded("convex = \"decompose\"").unwrap();
    let find = |category: &str| kitchen.bodies().iter().position(|body| body.category == category).unwrap();
    let place = |category: &str| kitchen.settled_poses()[find(category)].translation;
    assert!((place("VegetableCrate").y - 0.1).abs() < 0.002, "{}", place("VegetableCrate"));
    let apple = place("Apple");
    assert!(apple.x.abs() < 0.05 && apple.z.abs() < 0.05 && (0.06..0.12).contains(&apple.y), "{apple}");
    // It is seen as it was drawn, and goes out and comes back as such.
    let is_u = |kitchen: &Kitchen| {
        let shape = &kitchen.bodies()[find("VegetableCrate")].shape;
        let [part] = shape.parts.as_slice() else { panic!("{shape:?}") };
        let Primitive::Concave(concave) = &part.primitive else { panic!("{part:?}") };
        (concave.vertices.len(), concave.triangles.len())
    };
    assert_eq!(is_u(&kitchen), (16, 28));
    let again = load(&export(&kitchen, folder.path(), |_| {})).unwrap();
    assert_eq!(is_u(&again), (16, 28));
    stand_still(again);
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
fn a_thing_outside_of_the_room_is_named_with_the_rooms_bounds() {
    let folder = tempfile::tempdir().unwrap();
    let studio = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes/studio");
    std::fs::copy(studio.join("scene.toml"), folder.path().join("scene.toml")).unwrap();
    let bytes = std::fs::read(studio.join("studio.glb")).unwrap();
    let changed = changed(&bytes, |root, _| move_apple(root, [9.0, 0.05, 0.0]));
    std::fs::write(folder.path().join("studio.glb"), changed).unwrap();
    let message = load(&folder.path().join("scene.toml")).unwrap_err();
    let expected = "node Apple: its middle is at x 9.00 m, z 0.00 m, outside of the room: its floor reaches from x -";
    assert!(message.contains(expected) && message.contains("scene.toml: "), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
}

#[test]
fn files_that_are_not_there_or_not_sound_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.toml");
    assert!(load(&path).unwrap_err().contains("scene.toml: there is no such file"));
    for (text, expected) in [
        ("gltf = 'a.glb'\nnode = []\nmass = 3", "scene.toml: line 3: unknown field `mass`"),
        ("gltf = '../a.glb'\nnode = []", "outside of this file's folder"),
        (
            "gltf = 'b.gltf'\nnode = []",
            "gltf = \"b.gltf\": there is no such file beside this one (did you mean `b.glb`?)",
        ),
        ("gltf = 'b.glb'\nnode = []", "b.glb: is not sound glTF 2.0"),
    ] {
        std::fs::write(&path, text).unwrap();
        std::fs::write(folder.path().join("b.glb"), "no glTF").unwrap();
        let message = load(&path).unwrap_err();
        assert!(message.contains(expected), "`{expected}` is not in: {message}");
    }
}
