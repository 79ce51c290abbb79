//! Two updates from first to last.

use crate::shared::{assert_close, assert_probes, doubles, fixture, weight_values};
use crate::world::{World, small_config, weights_of};
use learner::agent::{Agent, StepOutput};
use learner::ppo::metrics::SCALARS;
use proto::metric;
use tch::{Device, Tensor};

/// Acting, advantages, losses, auxiliary task, passes, clipping, Adam and schedule together, over two rollouts.
#[test]
fn two_updates_are_those_of_the_reference() {
    let config = small_config();
    let mut agent = Agent::new(&config, Device::Cpu).expect("a fresh agent");
    let mut state = agent.state();
    for (name, tensor) in &mut state.tensors {
        if let Some(name) = name.strip_prefix("model.") {
            let scale = if name == "actor.weight" { 0.2 } else { 1.0 };
            *tensor = weight_values(name, &tensor.size()) * scale;
        }
    }
    agent.load_state(&state).expect("the state fits");

    let mut world = World::new(&config);
    let expected = fixture("run");
    for (rollout, (progress, last)) in [(0.0, 3), (0.5, 4)].into_iter().enumerate() {
        let outputs = world.collect(&mut agent, rollout, last).expect("finite");
        let metrics = agent.update(progress, rollout as u64).expect("finite");
        // Adam's first steps divide small gradients by themselves, which makes rounding a hundredth of a step: what
        // comes after them agrees to fewer digits.
        let tolerance = if rollout == 0 { 1e-5 } else { 1e-4 };
        let expected = |name: &str| &expected[&format!("{rollout}.{name}")];
        let join = |of: fn(&StepOutput) -> Vec<f32>| {
            Tensor::from_slice(&outputs.iter().flat_map(of).collect::<Vec<f32>>()).view([6, 4])
        };
        let actions = join(|output| output.actions.iter().map(|&action| f32::from(action)).collect());
        assert_close("actions", &actions, expected("actions"), 0.0);
        assert_close("log_probs", &join(|output| output.log_probs.clone()), expected("log_probs"), tolerance);
        assert_close("values", &join(|output| output.values.clone()), expected("values"), tolerance);
        let figures = SCALARS.into_iter().chain([metric::GRADIENT_NORM]);
        for (name, theirs) in figures.zip(doubles(expected("figures"))) {
            let ours = metrics[name];
            // The policy loss and the divergence are differences of nearly equal numbers.
            assert!((ours - theirs).abs() < tolerance * theirs.abs().max(0.1), "{name}: {ours} is not {theirs}");
        }
        assert_probes(&weights_of(&agent), expected("weights"), 1e-4);
    }
}
