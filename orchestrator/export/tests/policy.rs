//! Checkpoints on disk: what is taken out of them, and what is refused. That a model computes what the learner does is
//! tested with onnxruntime, in `python/tests/test_export.py`.

// Helpers of tests are tests too, which clippy's own exception does not see.
#![allow(clippy::unwrap_used)]

use export::{Policy, PolicyError, Precision, guide, onnx, open, save};
use proto::checkpoint::Manifest;
use proto::config::{CarriedGoal, Config, Encoder, GoalCoordinates, Memory};
use proto::digest::sha256;
use proto::run_folder::{RolloutName, RunFolder};
use proto::task::Spec;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const HIDDEN: usize = 8;

/// Bytes of a tensor of a checkpoint, by name.
type Tensors = BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>;

fn config() -> Config {
    let mut config = Config::resolve("demo", None).unwrap();
    config.network.encoder = Encoder::Cnn;
    config.network.input_pool = 4;
    config.network.goal = GoalCoordinates::Polar;
    config.network.hidden = HIDDEN as u32;
    config.network.previous_action = true;
    config
}

fn tensors(config: &Config) -> Tensors {
    let actions = config.policy_actions().len();
    let mut tensors = Tensors::new();
    let mut add = |name: &str, shape: &[usize]| {
        let count: usize = shape.iter().product();
        let seed = tensors.len() as f32;
        let bytes = (0..count).flat_map(|index| (seed + index as f32 / 1000.0).to_le_bytes()).collect();
        tensors.insert(name.to_owned(), (Dtype::F32, shape.to_vec(), bytes));
    };
    for (index, shape) in [(0, [32, 1, 8, 8]), (2, [64, 32, 4, 4]), (4, [32, 64, 3, 3])] {
        add(&format!("model.visual_encoder.cnn.{index}.weight"), &shape);
        add(&format!("model.visual_encoder.cnn.{index}.bias"), &shape[..1]);
    }
    // 56 pixels become 13, 5 and 3.
    add("model.visual_encoder.cnn.6.weight", &[512, 32 * 9]);
    add("model.visual_encoder.cnn.6.bias", &[512]);
    for (name, shape) in [("goal_embedder.0", [100, 3]), ("goal_embedder.2", [32, 100])] {
        add(&format!("model.{name}.weight"), &shape);
        add(&format!("model.{name}.bias"), &shape[..1]);
    }
    add("model.previous_action_embedder.weight", &[actions + 1, 16]);
    add("model.belief.weight_ih_l0", &[3 * HIDDEN, 560]);
    add("model.belief.weight_hh_l0", &[3 * HIDDEN, HIDDEN]);
    for name in ["bias_ih_l0", "bias_hh_l0"] {
        add(&format!("model.belief.{name}"), &[3 * HIDDEN]);
    }
    for (name, outputs) in [("actor", actions), ("critic", 1)] {
        add(&format!("model.{name}.weight"), &[outputs, HIDDEN]);
        add(&format!("model.{name}.bias"), &[outputs]);
    }
    // What a checkpoint has besides, and a policy has not.
    add("model.disturbance_head.weight", &[1, HIDDEN]);
    add("adam.first", &[7]);
    tensors
}

/// Writes a checkpoint and gives its manifest's path.
fn write(folder: &Path, tensors: &Tensors) -> PathBuf {
    let views = tensors
        .iter()
        .map(|(name, (dtype, shape, bytes))| (name, TensorView::new(*dtype, shape.clone(), bytes).unwrap()));
    let bytes = safetensors::serialize(views, None).unwrap();
    let manifest = Manifest {
        schema_version: proto::SCHEMA_VERSION,
        run: "0123".into(),
        rollout: 12,
        frames: 4000,
        carried_goal: CarriedGoal::ObjectToGoal,
        tensors: RolloutName::Tensors.of(12),
        tensors_bytes: bytes.len() as u64,
        tensors_sha256: sha256(&bytes),
        weights: "abcd".into(),
        ..Manifest::default()
    };
    std::fs::write(folder.join(RolloutName::Tensors.of(12)), bytes).unwrap();
    let path = folder.join(RolloutName::Manifest.of(12));
    std::fs::write(&path, manifest.seal()).unwrap();
    path
}

fn read(tensors: &Tensors) -> Result<Policy, PolicyError> {
    let folder = tempfile::tempdir().unwrap();
    Policy::read(&RunFolder::new(folder.path()), &write(folder.path(), tensors), config())
}

#[test]
fn weights_alone_are_those_that_act() {
    let folder = tempfile::tempdir().unwrap();
    let all = tensors(&config());
    let policy = read(&all).unwrap();
    let file = folder.path().join("weights.safetensors");
    save(&policy, &file, Precision::Single).unwrap();
    let bytes = std::fs::read(&file).unwrap();
    let saved = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let names: BTreeSet<&str> = saved.names().into_iter().collect();
    let expected: BTreeSet<&str> = all
        .keys()
        .filter_map(|name| name.strip_prefix("model."))
        .filter(|name| !name.starts_with("disturbance"))
        .collect();
    assert_eq!(names, expected);
    for name in names {
        let (_, shape, bytes) = &all[&format!("model.{name}")];
        let view = saved.tensor(name).unwrap();
        assert_eq!((view.shape(), view.data()), (shape.as_slice(), bytes.as_slice()), "{name}");
    }
    let count: usize = all.iter().filter(|(name, _)| expected.contains(&name[6..])).map(|(_, t)| t.2.len() / 4).sum();
    assert_eq!(policy.count(), count);
    // The same weights give the same file.
    save(&policy, &folder.path().join("again.safetensors"), Precision::Single).unwrap();
    assert_eq!(std::fs::read(folder.path().join("again.safetensors")).unwrap(), bytes);
}

#[test]
fn what_is_damaged_or_does_not_fit_is_named() {
    let whole = tensors(&config());
    let problem = |change: &dyn Fn(&mut Tensors)| {
        let mut tensors = whole.clone();
        change(&mut tensors);
        match read(&tensors).and_then(|policy| onnx(&policy)) {
            Ok(_) => String::new(),
            Err(error) => error.to_string(),
        }
    };
    assert_eq!(problem(&|_| {}), "");
    let missing = problem(&|tensors| drop(tensors.remove("model.critic.bias")));
    assert!(missing.ends_with("critic.bias is missing"), "{missing}");
    let shape = problem(&|tensors| tensors.get_mut("model.goal_embedder.0.weight").unwrap().1 = vec![3, 100]);
    assert!(shape.ends_with("goal_embedder.0.weight has shape [3, 100], not [100, 3]"), "{shape}");
    let kind = problem(&|tensors| tensors.get_mut("model.actor.bias").unwrap().0 = Dtype::I32);
    assert!(kind.ends_with("actor.bias is neither float32 nor float16"), "{kind}");
    let nan = problem(&|tensors| {
        tensors.get_mut("model.actor.bias").unwrap().2[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    });
    assert!(nan.ends_with("actor.bias holds a number that is not finite"), "{nan}");

    let folder = tempfile::tempdir().unwrap();
    let manifest = write(folder.path(), &whole);
    let file = folder.path().join(RolloutName::Tensors.of(12));
    let mut bytes = std::fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let damaged = Policy::read(&RunFolder::new(folder.path()), &manifest, config()).unwrap_err().to_string();
    assert!(damaged.contains("rollout-00000012.safetensors is damaged"), "{damaged}");
    std::fs::remove_file(&file).unwrap();
    let gone = Policy::read(&RunFolder::new(folder.path()), &manifest, config()).unwrap_err().to_string();
    assert!(gone.contains("rollout-00000012.safetensors cannot be read"), "{gone}");
    std::fs::write(&manifest, "{}").unwrap();
    let torn = Policy::read(&RunFolder::new(folder.path()), &manifest, config()).unwrap_err().to_string();
    assert!(torn.contains("rollout-00000012.json is not a manifest"), "{torn}");
}

#[test]
fn a_policy_file_is_enough_to_build_the_policy_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut other = config();
    other.network.carried_goal = CarriedGoal::GoalToObject;
    let policy = Policy::read(&RunFolder::new(folder.path()), &write(folder.path(), &tensors(&other)), other).unwrap();
    let file = |name: &str| folder.path().join(name);
    save(&policy, &file("single.safetensors"), Precision::Single).unwrap();
    save(&policy, &file("half.safetensors"), Precision::Half).unwrap();
    let size = |name: &str| std::fs::metadata(file(name)).unwrap().len();
    let saved = size("single.safetensors") - size("half.safetensors");
    assert!(saved.abs_diff(2 * policy.count() as u64) < 16, "half the bytes: {saved}");

    let single = open(&file("single.safetensors")).unwrap();
    assert_eq!((&single.origin, single.origin.frames), (&policy.origin, 4000));
    assert_eq!((single.config.network.hidden, single.config.network.encoder), (HIDDEN as u32, Encoder::Cnn));
    // The sign is that of the checkpoint.
    assert_eq!(single.config.network.carried_goal, CarriedGoal::ObjectToGoal);
    let exact = onnx(&policy).unwrap();
    assert_eq!(onnx(&single).unwrap(), exact);

    // Widened again, 16 bits are the nearest of 16 bits: saved once more they are the same file.
    let half = open(&file("half.safetensors")).unwrap();
    assert_ne!(onnx(&half).unwrap(), exact);
    save(&half, &file("again.safetensors"), Precision::Half).unwrap();
    let bytes = |name: &str| std::fs::read(file(name)).unwrap();
    assert_eq!(bytes("again.safetensors"), bytes("half.safetensors"));
}

#[test]
fn a_file_that_is_no_policy_is_named_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let policy = read(&tensors(&config())).unwrap();
    let path = folder.path().join("policy.safetensors");
    save(&policy, &path, Precision::Half).unwrap();
    let whole = std::fs::read(&path).unwrap();
    let problem = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        open(&path).map_or_else(|error| error.to_string(), |_| String::new())
    };
    assert_eq!(problem(&whole), "");
    let mut flipped = whole.clone();
    *flipped.last_mut().unwrap() ^= 1;
    assert!(problem(&flipped).contains("is damaged: the SHA-256"));
    assert!(problem(&whole[..whole.len() - 1]).contains("is no safetensors file"));
    assert!(problem(b"weights").contains("is no safetensors file"));
    let values = 1.0f32.to_le_bytes();
    let alone = TensorView::new(Dtype::F32, vec![1], &values).unwrap();
    let nameless = problem(&safetensors::serialize([("actor.bias", alone)], None).unwrap());
    assert!(nameless.contains("orchestrator import"), "{nameless}");
    // Of another network than it says.
    let hidden = problem(&{
        let mut policy = read(&tensors(&config())).unwrap();
        policy.config.network.hidden = 2 * HIDDEN as u32;
        save(&policy, &path, Precision::Half).unwrap();
        std::fs::read(&path).unwrap()
    });
    assert!(hidden.contains("do not fit the network") && hidden.contains("has shape"), "{hidden}");

    let mut large = tensors(&config());
    large.get_mut("model.actor.bias").unwrap().2[..4].copy_from_slice(&70_000.0f32.to_le_bytes());
    let large = read(&large).unwrap();
    let refused = save(&large, &path, Precision::Half).unwrap_err().to_string();
    assert!(refused.contains("actor.bias holds a number that is too large for 16 bits"), "{refused}");
    save(&large, &path, Precision::Single).unwrap();
}

#[test]
fn the_page_says_what_the_policy_wants() {
    let config = config();
    let page = guide(&read(&tensors(&config)).unwrap(), "fetch.onnx");
    let (actions, names) = (config.policy_actions(), config.spec().actions.names());
    for expected in [
        "# fetch.onnx",
        "after 4000 frames",
        "while the object is held goal - object",
        &format!("| belief | float32 | rows, {HIDDEN} |"),
        &format!("| log_probs | float32 | rows, {} |", actions.len()),
        &*names[usize::from(actions[0])],
        "carried_goal=\"object_to_goal\"",
        "InferenceSession(\"fetch.onnx\")",
    ] {
        assert!(page.contains(expected), "`{expected}` is missing in\n{page}");
    }
}

/// A task without a frame, and weights of its network.
fn numbers(memory: Memory) -> (Config, Tensors) {
    Spec::declare(include_str!("../../../learner/tests/support/numbers.toml")).unwrap();
    let mut config = Config::resolve_with("gym", Some(("task = \"numbers\"", "a test"))).unwrap();
    config.network.memory = memory;
    config.network.mlp = vec![12, 10];
    config.network.hidden = HIDDEN as u32;
    config.network.previous_action = memory != Memory::None;
    let mut tensors = Tensors::new();
    let mut add = |name: &str, shape: &[usize]| {
        let count: usize = shape.iter().product();
        let seed = 0.37 * tensors.len() as f32;
        let bytes = (0..count).flat_map(|index| ((seed + 1.7 * index as f32).sin() * 0.4).to_le_bytes()).collect();
        tensors.insert(format!("model.{name}"), (Dtype::F32, shape.to_vec(), bytes));
    };
    let mut layer = |name: &str, [outputs, inputs]: [usize; 2]| {
        add(&format!("{name}.weight"), &[outputs, inputs]);
        add(&format!("{name}.bias"), &[outputs]);
    };
    if memory == Memory::None {
        for (head, outputs) in [("actor", 3), ("critic", 1)] {
            layer(&format!("{head}.0"), [12, 9]);
            layer(&format!("{head}.2"), [10, 12]);
            layer(&format!("{head}.4"), [outputs, 10]);
        }
        return (config, tensors);
    }
    for (name, sizes) in [("mlp.0", [12, 9]), ("mlp.2", [10, 12]), ("actor", [3, HIDDEN]), ("critic", [1, HIDDEN])] {
        layer(name, sizes);
    }
    add("previous_action_embedder.weight", &[4, 16]);
    let gates = memory.gates() as usize * HIDDEN;
    add("belief.weight_ih_l0", &[gates, 26]);
    add("belief.weight_hh_l0", &[gates, HIDDEN]);
    for name in ["bias_ih_l0", "bias_hh_l0"] {
        add(&format!("belief.{name}"), &[gates]);
    }
    (config, tensors)
}

/// An environment's only observation has a name of the engine's, and its only number an index.
#[test]
fn the_page_of_one_observation_and_one_number_has_neither_keys_nor_plurals() {
    let text = include_str!("../../../learner/tests/support/numbers.toml");
    let (before, after) = text.split_once("[[channels]]\nname = \"speed\"").unwrap();
    let rewards = &after[after.find("[[rewards]]").unwrap()..];
    let kind = "kind = \"discrete\"\nnames = [\"left\", \"stay\", \"right\"]";
    let channel =
        "[[channels]]\nname = \"observation\"\nrole = \"observation\"\ndtype = \"f32\"\nrange = [0, 1]\ndoc = \"\"\n";
    let text = format!("{before}{channel}{rewards}").replace(kind, "kind = \"box\"\nbounds = [[-1, 1]]");
    Spec::declare(&text.replace("name = \"numbers\"", "name = \"one_number\"")).unwrap();
    let config = Config::resolve_with("gym", Some(("task = \"one_number\"", "a test"))).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let manifest = write(folder.path(), &Tensors::new());
    let page = guide(&Policy::read(&RunFolder::new(folder.path()), &manifest, config).unwrap(), "one.onnx");
    for expected in ["| `numbers[0] = observation` |", "An action is one number, clipped to", "parts = [seen]\n"] {
        assert!(page.contains(expected), "`{expected}` is missing in\n{page}");
    }
}

/// That its numbers are those of the learner is tested with onnxruntime in `python/tests/test_numbers.py`.
#[test]
fn a_policy_without_frames_is_a_model_and_a_file_that_names_its_task() {
    for memory in [Memory::None, Memory::Gru, Memory::Lstm] {
        let (config, tensors) = numbers(memory);
        let folder = tempfile::tempdir().unwrap();
        let manifest = write(folder.path(), &tensors);
        let policy = Policy::read(&RunFolder::new(folder.path()), &manifest, config.clone()).unwrap();
        assert_eq!(policy.count(), tensors.values().map(|(_, _, bytes)| bytes.len() / 4).sum::<usize>());
        let file = folder.path().join("policy.safetensors");
        save(&policy, &file, Precision::Single).unwrap();
        let again = open(&file).unwrap();
        assert_eq!(onnx(&again).unwrap(), onnx(&policy).unwrap());
        let text = String::from_utf8_lossy(&std::fs::read(&file).unwrap()).into_owned();
        assert!(text.contains("How fast it moves."), "the task's declaration is in it");
        let places = br#"{"door":[4,7],"room":[7,9],"speed":[0,4]}"#;
        let model = onnx(&policy).unwrap();
        assert!(model.windows(places.len()).any(|window| window == places), "the model's metadata name the numbers");
        let page = guide(&policy, "numbers.onnx");
        for expected in [
            "| numbers | float32 | rows, 9 | `numbers[0:4] = speed`, `numbers[4:7] = door` (one-hot of -1 to 1), \
             `numbers[7:9] = room` (one-hot of 0 to 1) |\n",
            "InferenceSession(\"numbers.onnx\")",
            "    parts = [seen[\"speed\"], numpy.eye(3)[numpy.int64(seen[\"door\"]) - (-1)], \
             numpy.eye(2)[numpy.int64(seen[\"room\"])]]\n",
        ] {
            assert!(page.contains(expected), "`{expected}` is missing in\n{page}");
        }
        assert!(!page.contains("depth"), "{page}");
        let states = ["next_belief", "next_cell"].iter().filter(|name| page.contains(**name)).count();
        assert_eq!(states, memory.states() as usize, "{page}");
        assert_eq!(page.contains("states"), memory != Memory::None, "{page}");
        // Another network's weights.
        let mut wider = config;
        wider.network.mlp = vec![12, 11];
        let policy = Policy::read(&RunFolder::new(folder.path()), &manifest, wider).unwrap();
        assert!(onnx(&policy).unwrap_err().to_string().contains("has shape"));
    }
}
