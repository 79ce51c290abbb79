//! Weights from elsewhere.

use crate::shared::{assert_close, depth_mm, fixture, goal_m, noise_tensor, weight_values};
use learner::agent::Agent;
use learner::auxiliary::{Disturb, Sizes};
use learner::import::import;
use learner::network::{ActorCriticOutput, Kept, Network, Observations, Staging, goal_coordinates};
use proto::camera::DepthFrame;
use proto::config::{AuxiliaryTask, Config, Encoder, GoalCoordinates};
use proto::task::ActionSpace;
use std::collections::BTreeMap;
use std::path::Path;
use tch::{Device, Kind, Tensor};

/// A state dict of the script's `AllenAct`: names and shapes from its file, values from `set_weights`.
fn allenact(name: &str) -> BTreeMap<String, Tensor> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/reference/import_{name}.json"));
    let text = std::fs::read_to_string(path).expect("the list of names is committed");
    let shapes: BTreeMap<String, Vec<i64>> = serde_json::from_str(&text).expect("names and shapes");
    shapes.into_iter().map(|(name, shape)| (name.clone(), weight_values(&name, &shape))).collect()
}

fn configuration_of(name: &str) -> Config {
    let mut config = Config::default();
    config.actors.count = 1;
    config.network.hidden = 40;
    if name == "original" {
        config.network.hidden = 24;
        config.network.encoder = Encoder::Cnn;
        config.network.input_pool = 1;
        config.network.goal = GoalCoordinates::Cartesian;
        config.network.previous_action = false;
        config.episode.action_space = ActionSpace::named("small").expect("the task has it");
        config.auxiliary.task = AuxiliaryTask::None;
    }
    config
}

/// A module under AllenAct's names, written in PyTorch, says the same as ours with its weights imported.
#[test]
fn an_imported_network_says_what_allenacts_says() {
    let expected = fixture("import");
    for name in ["disturb_free", "original"] {
        let config = configuration_of(name);
        let hidden = i64::from(config.network.hidden);
        let mut state = Agent::new(&config, Device::Cpu).expect("a fresh agent").state();
        let imported = import(&allenact(name), &mut state).expect("it is a state dict of this network");
        assert_eq!(imported.fresh, Vec::<String>::new());
        let tasks = |prefix: &str| imported.left_out.iter().filter(|name| name.starts_with(prefix)).count();
        let left_out = (tasks("auxiliary.inverse_dynamics."), tasks("auxiliary.cpca16."), imported.left_out.len());
        assert_eq!(left_out, if name == "original" { (0, 0, 0) } else { (2, 9, 11) });

        let (network, head) = Network::new(&config, Device::Cpu, |layout, hidden| {
            let actions = config.policy_actions().len() as i64;
            (name != "original").then(|| Disturb::new(layout, Sizes { hidden, actions }, 2.0))
        });
        tch::no_grad(|| {
            for (name, mut weight) in network.parameters.named() {
                weight.copy_(&state.tensors[&format!("model.{name}")]);
            }
        });
        let mut belief = noise_tensor("import.belief", &[2, hidden]);
        for t in 0..2i64 {
            let frames = [depth_mm(t as usize, 0), depth_mm(t as usize, 1)];
            let goals: Vec<f32> =
                (0..2).flat_map(|n| goal_coordinates(config.network.goal, goal_m(t as usize, n))).collect();
            let seen = [0, 1].map(|n| DepthFrame::Whole(&frames[n]));
            let observations = Observations {
                kept: Kept::of_frames(network.preparation.keep(&seen, &mut Staging::default())),
                numbers: Tensor::from_slice(&goals).view([2, 3]),
                // In the second column an episode begins: nothing came before.
                previous_actions: Tensor::from_slice(&[1 + 3 + t, 0]),
            };
            let before = belief * Tensor::from_slice(&[1f32, 0.0]).unsqueeze(1);
            belief = network.belief.step(&network.parameters, &network.embed(&observations), &before);
            let ActorCriticOutput { policy, values } = network.actor_critic(&belief, None, None);
            assert_close(name, &policy.rows(), &expected[&format!("{name}.log_probs")].get(t), 1e-5);
            assert_close(name, &values, &expected[&format!("{name}.values")].get(t), 1e-5);
        }
        if let Some(head) = head {
            assert_close("risk", &head.logits(&network.parameters, &belief), &expected["disturb_free.risk"], 1e-5);
        }
    }
}

/// By `DataParallel`, by `torch.compile`, by both, around parts, and by whatever a training script calls its network.
#[test]
fn names_that_are_wrapped_are_those_of_the_same_weights() {
    let config = configuration_of("disturb_free");
    let agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let imported = |state_dict: &BTreeMap<String, Tensor>| {
        let mut state = agent.state();
        let imported = import(state_dict, &mut state).expect("it is a state dict of this network");
        (imported, state.tensors)
    };
    let plain = allenact("disturb_free");
    let (first, expected) = imported(&plain);
    assert_eq!(first.taken_off, Vec::<String>::new());
    let model =
        |(name, tensor): (&String, &Tensor)| Some((name.strip_prefix("model.")?.to_owned(), tensor.shallow_clone()));
    let ours: BTreeMap<String, Tensor> = expected.iter().filter_map(model).collect();
    for state_dict in [&plain, &ours] {
        for prefix in
            ["module.", "_orig_mod.", "module._orig_mod.", "actor_critic.", "state_dict.module.", "policy.net."]
        {
            let wrapped = state_dict.iter().map(|(name, tensor)| (format!("{prefix}{name}"), tensor.shallow_clone()));
            let (again, tensors) = imported(&wrapped.collect());
            assert_eq!(again.taken_off, [prefix]);
            assert_eq!(again.taken, if state_dict.len() == ours.len() { ours.len() } else { first.taken });
            assert!(tensors.iter().all(|(name, tensor)| tensor.equal(&expected[name])), "{prefix}");
        }
        let inside = |name: &String| name.replace("visual_encoder.", "visual_encoder._orig_mod.");
        let wrapped = state_dict.iter().map(|(name, tensor)| (inside(name), tensor.shallow_clone()));
        let (again, tensors) = imported(&wrapped.collect());
        assert_eq!(again.taken_off, ["_orig_mod."]);
        assert!(tensors.iter().all(|(name, tensor)| tensor.equal(&expected[name])));
    }
    // With fewer bits, or more, they are the same numbers, as far as these hold them.
    for kind in [Kind::Half, Kind::BFloat16, Kind::Double] {
        let kept = plain.iter().map(|(name, tensor)| (name.clone(), tensor.to_kind(kind))).collect();
        let bias = imported(&kept).1["model.critic.bias"].shallow_clone();
        assert!(bias.equal(&plain["critic.fc.bias"].to_kind(kind).to_kind(Kind::Float)), "{kind:?}");
    }
}

/// Why the project's state dict is refused once it is changed so.
fn refused(change: &dyn Fn(&mut BTreeMap<String, Tensor>)) -> String {
    let mut config = configuration_of("disturb_free");
    config.auxiliary.task = AuxiliaryTask::Cpca16;
    let mut state = Agent::new(&config, Device::Cpu).expect("a fresh agent").state();
    let mut state_dict = allenact("disturb_free");
    change(&mut state_dict);
    import(&state_dict, &mut state).expect_err("it does not fit").to_string()
}

fn zeros(size: &[i64]) -> Tensor {
    Tensor::zeros(size, (Kind::Float, Device::Cpu))
}

#[test]
fn names_are_judged_before_shapes_and_shapes_before_values() {
    let spoil = |dict: &mut BTreeMap<String, Tensor>| {
        dict.insert("actor.linear.bias".into(), zeros(&[21]) / 0.0);
        dict.insert("critic.fc.weight".into(), zeros(&[40]));
    };
    let text = refused(&|dict| {
        spoil(dict);
        dict.remove("visual_encoder.head.1.bias");
    });
    assert!(text.contains("nothing is there for `visual_encoder.fc.1.bias`"), "{text}");
    let text = refused(&spoil);
    assert!(text.contains("`critic.fc.weight` (here `critic.weight`) is Float [40]"), "{text}");
    let text = refused(&|dict| drop(dict.insert("actor.linear.bias".into(), zeros(&[21]) / 0.0)));
    assert!(text.starts_with("`actor.linear.bias` (here `actor.bias`)") && text.contains("not finite"), "{text}");
    let text = refused(&|dict| {
        let wrapped = dict.iter().map(|(name, tensor)| (format!("module.{name}"), tensor.shallow_clone()));
        *dict = wrapped.filter(|(name, _)| name != "module.critic.fc.bias").collect();
    });
    assert!(text.ends_with("the file has no `module.critic.fc.bias`"), "{text}");
    // Those of the other encoder.
    let other = allenact("original");
    let text = refused(&|dict| {
        dict.retain(|name, _| !name.starts_with("visual_encoder."));
        let cnn = other.iter().filter(|(name, _)| name.starts_with("visual_encoder."));
        dict.extend(cnn.map(|(name, tensor)| (name.clone(), tensor.shallow_clone())));
    });
    assert!(text.ends_with("These weights are of another encoder (network.encoder)"), "{text}");
}

#[test]
fn what_is_imported_and_what_is_refused() {
    let mut config = configuration_of("disturb_free");
    let state_dict = || allenact("disturb_free");

    // Another task's head.
    config.auxiliary.task = AuxiliaryTask::Cpca16;
    let agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut state = agent.state();
    import(&state_dict(), &mut state).expect("its head is there, too");
    let theirs = &state_dict()["aux_models.CPCA_16.action_embedder.fc.weight"];
    let ours = &state.tensors["model.auxiliary.cpca16.action_embedder.weight"];
    assert!(ours.equal(&theirs.narrow(0, 0, 21)) && theirs.size() == [22, 16]);
    let table = &state.tensors["model.previous_action_embedder.weight"];
    assert!(table.get(0).equal(&table.get(21)), "nothing before is as after Done");

    // A head that the file lacks starts as it would without it; a run of ours is taken as it is.
    let mut without = state_dict();
    without.retain(|name, _| !name.starts_with("aux_models."));
    let mut fresh = agent.state();
    let imported = import(&without, &mut fresh).expect("a head may be missing");
    assert_eq!(imported.fresh.len(), 9);
    let head = "model.auxiliary.cpca16.classifier.0.weight";
    assert!(fresh.tensors[head].equal(&agent.state().tensors[head]));
    let mut copy = agent.state();
    let imported = import(&state.tensors, &mut copy).expect("our own names");
    assert_eq!((imported.fresh.len(), imported.left_out.len()), (0, 0));
    assert!(state.tensors.iter().filter(|(name, _)| name.starts_with("model.")).all(|(n, w)| copy.tensors[n].equal(w)));

    let text = refused(&|dict| drop(dict.remove("critic.fc.bias")));
    assert!(text.contains("nothing is there for `critic.bias`: the file has no `critic.fc.bias`"), "{text}");
    let text = refused(&|dict| dict.retain(|name, _| !name.contains(".single_belief.rnn.bias_ih")));
    let names = "`state_encoders.single_belief.rnn.bias_ih_l0` or `state_encoder.rnn.bias_ih_l0`";
    assert!(text.ends_with(names), "{text}");
    let text = refused(&|dict| drop(dict.remove("prev_action_embedder.fc.weight")));
    assert!(text.contains("network.previous_action = false"), "{text}");
    assert!(text.contains("has no `prev_action_embedder.fc.weight`."), "{text}");
    let text = refused(&|dict| drop(dict.insert("rgb_encoder.weight".into(), zeros(&[1]))));
    assert!(text.contains("`rgb_encoder.weight` is no weight of a network of ours"), "{text}");
    let text = refused(&|dict| drop(dict.insert("state_encoder.rnn.bias_hh_l0".into(), zeros(&[120]))));
    let twice = "`state_encoder.rnn.bias_hh_l0` (here `belief.bias_hh_l0`) is there twice: also as \
                 `state_encoders.single_belief.rnn.bias_hh_l0`";
    assert_eq!(text, twice);
    let text = refused(&|dict| drop(dict.insert("goal_embedder.0.0.weight".into(), zeros(&[100, 7]))));
    assert_eq!(
        text,
        "`goal_embedder.0.0.weight` (here `goal_embedder.0.weight`) is Float [100, 7], not Float [100, 3]"
    );
    let text = refused(&|dict| drop(dict.insert("visual_encoder.depth_cnn.fc.bias".into(), zeros(&[512]))));
    let place = "no place for `visual_encoder.depth_cnn.fc.bias` (here `visual_encoder.cnn.6.bias`)";
    assert!(text.contains(place), "{text}");
    let text = refused(&|dict| drop(dict.insert("goal_embedder.0.0.weight".into(), zeros(&[3, 100]))));
    assert!(text.ends_with("is Float [3, 100], not Float [100, 3]: it is transposed"), "{text}");
    let counts = Tensor::zeros([1], (Kind::Int64, Device::Cpu));
    let text = refused(&|dict| drop(dict.insert("critic.fc.bias".into(), counts.shallow_clone())));
    assert!(text.contains("`critic.fc.bias` (here `critic.bias`) does not hold floating-point"), "{text}");
}
