//! Tasks of images: `learner probe` against the PPO of `CleanRL` for Atari games (`make_images.py`), and what must be
//! the same again.

use crate::repetition::saved_and_loaded;
use crate::shared::{Probed, assert_close, assert_probes, doubles, fixture, noise_tensor, probe, weight_values};
use crate::world::{numbers_config, weights_of};
use learner::agent::Agent;
use proto::config::{Config, Memory, Shuffle};
use proto::task::Spec;
use tch::{Device, Kind, Tensor};

const TASK: &str = include_str!("../support/images.toml");
const STEPS: i64 = 16;
const COLUMNS: i64 = 4;

/// What the script is given.
fn batch() -> Vec<(&'static str, Tensor)> {
    let size = [STEPS, COLUMNS];
    let table = |name: &str| noise_tensor(&format!("images.{name}"), &size);
    let image = |name: &str, shape: &[i64]| noise_tensor(&format!("images.{name}"), &[&size, shape].concat());
    let ended = table("ended").gt(0.7);
    let first = Tensor::from_slice(&[true; COLUMNS as usize]).view([1, COLUMNS]);
    let actions = (0..STEPS).flat_map(|t| (0..COLUMNS).map(move |n| (3 * t + 5 * n) % 3)).collect::<Vec<i64>>();
    // The safetensors of libtorch have no 16 bits without a sign.
    let depth = ((image("depth", &[1, 41, 36]) + 1.0) * 32767.0).to_kind(Kind::Int).to_kind(Kind::Int16);
    vec![
        ("images.depth", depth),
        ("images.heat", image("heat", &[2, 45, 36])),
        ("images.screen", ((image("screen", &[36, 40, 3]) + 1.0) * 127.0).to_kind(Kind::Uint8)),
        ("numbers", image("numbers", &[4]) * 2.0),
        ("previous_action", ended.zeros_like().to_kind(Kind::Int64)),
        ("episode_start", Tensor::cat(&[first, ended.narrow(0, 0, STEPS - 1)], 0)),
        ("action", Tensor::from_slice(&actions).view(size)),
        ("log_prob", table("log_prob") * 0.25 - 1.25),
        ("value", table("value")),
        ("reward", table("reward")),
        ("time_limit", ended.zeros_like()),
        ("disturbed", ended.zeros_like()),
        ("ended", ended),
        ("bootstrap", noise_tensor("images.bootstrap", &[COLUMNS])),
    ]
}

fn images_config(memory: Memory) -> Config {
    Spec::declare(TASK).expect("a sound task");
    let mut config = numbers_config(memory);
    (config.task, config.network.mlp) = ("images".to_owned(), vec![8]);
    config.validate().expect("a run can have this");
    config
}

/// Outputs, losses and gradients to 1e-5 of the largest number.
#[test]
fn a_probe_finds_what_cleanrl_computes_of_images() {
    let agent = Agent::new(&images_config(Memory::None), Device::Cpu).expect("a fresh agent");
    let first = weights_of(&agent).remove("images.screen.0.weight").expect("a convolution").view([32, -1]);
    let gain = Tensor::eye(32, (Kind::Float, Device::Cpu)) * 2.0;
    assert_close("orthogonal rows", &first.matmul(&first.tr()), &gain, 1e-5);
    let value = |(name, weight): (String, Tensor)| (name.clone(), weight_values(&name, &weight.size()));
    let weights: Vec<(String, Tensor)> = weights_of(&agent).into_iter().map(value).collect();
    let settings = "ppo.clip = 0.1\nppo.entropy_coefficient = 0.01\nppo.normalize_advantages = true\n";
    let probe = |batch: &[(&str, Tensor)]| probe(&weights, batch, settings, Some(TASK));
    let Probed { good, said, found, .. } = probe(&batch());
    assert!(good, "{said}");
    let mut expected = fixture("images");
    let probes = expected.remove("gradients").expect("the script wrote it");
    for (name, theirs) in &expected {
        assert_close(name, &found[name].view(theirs.size().as_slice()), theirs, 1e-5);
    }
    let gradient =
        |(name, tensor): (&String, &Tensor)| Some((name.strip_prefix("gradient.")?.to_owned(), tensor.shallow_clone()));
    assert_probes(&found.iter().filter_map(gradient).collect(), &probes, 1e-5);

    let mut other = batch();
    other[2].1 = other[2].1.to_kind(Kind::Int16);
    let refused = probe(&other);
    assert!(!refused.good && refused.said.contains("images.screen"), "{}", refused.said);
}

/// Acting, training, saving: the bytes that came are what is trained on, whichever thread updates.
#[test]
fn images_give_the_same_bits_again_also_through_a_saved_state() {
    for (memory, shuffle, shards, overlap) in [
        (Memory::None, Shuffle::Rows, 0, false),
        (Memory::None, Shuffle::Rows, 2, true),
        (Memory::Gru, Shuffle::Environments, 2, false),
    ] {
        let mut config = images_config(memory);
        (config.ppo.shuffle, config.ppo.minibatches, config.learner.shards) = (shuffle, 2, shards);
        config.validate().expect("a run can have this");
        let (mut second, mut world) = saved_and_loaded(&config, config.seed, overlap);
        world.collect(&mut second, 3, 4).expect("finite");
        let dumped = second.rollout_tensors();
        let depth = &dumped["rollout.images.depth"];
        assert_eq!((depth.size(), depth.kind()), (vec![6, 4, 1, 41, 36], Kind::Int16));
        let heat = noise_tensor("heat.23.3", &[2, 45, 36]);
        assert_eq!(doubles(&dumped["rollout.images.heat"].get(5).get(3)), doubles(&heat));
    }
}
