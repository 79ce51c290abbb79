//! Both networks, forward and backward.

use crate::shared::{assert_close, assert_probes, depth_mm, fixture, goal_m, noise_tensor, weight_values};
use learner::auxiliary::{Disturb, Sizes};
use learner::network::{ActorCriticOutput, Kept, Network, Observations, Packing, RawFrame, Staging, goal_coordinates};
use proto::camera::DepthFrame;
use proto::config::{Config, Encoder, GoalCoordinates};
use proto::task::ActionSpace;
use tch::{Device, Kind, Tensor};

fn network_matches(name: &str, config: &Config) {
    let actions = config.policy_actions().len() as i64;
    let hidden = i64::from(config.network.hidden);
    let (network, head) =
        Network::new(config, Device::Cpu, |layout, hidden| Disturb::new(layout, Sizes { hidden, actions }, 2.0));
    let parameters = &network.parameters;
    tch::no_grad(|| {
        for (name, mut weight) in parameters.named() {
            weight.copy_(&weight_values(name, &weight.size()));
        }
    });
    let starts = [[false, false, true], [false, true, false], [true, false, false]];
    let at_start = noise_tensor("belief", &[3, hidden]);
    let observe = |rows: &[(usize, usize)]| {
        let frames: Vec<Box<RawFrame>> = rows.iter().map(|&(t, n)| depth_mm(t, n)).collect();
        let frames: Vec<_> = frames.iter().map(|frame| DepthFrame::Whole(frame)).collect();
        let goals: Vec<f32> =
            rows.iter().flat_map(|&(t, n)| goal_coordinates(config.network.goal, goal_m(t, n))).collect();
        let previous: Vec<i64> = rows.iter().map(|&(t, n)| (5 * t + 3 * n) as i64 % (actions + 1)).collect();
        Observations {
            kept: Kept::of_frames(network.preparation.keep(&frames, &mut Staging::default())),
            numbers: Tensor::from_slice(&goals).view([-1, 3]),
            previous_actions: Tensor::from_slice(&previous),
        }
    };
    let expected = fixture(&format!("network_{name}"));

    // Acting: a step at a time.
    let mut belief = at_start.copy();
    for (t, start) in starts.iter().enumerate() {
        let carried = Tensor::from_slice(&start.map(|start| if start { 0f32 } else { 1.0 })).unsqueeze(1);
        let embedded = network.embed(&observe(&[0, 1, 2].map(|n| (t, n))));
        belief = network.belief.step(parameters, &embedded, &(belief * carried));
        let ActorCriticOutput { policy, values } = network.actor_critic(&belief, None, None);
        assert_close("acting log_probs", &policy.rows(), &expected["log_probs"].get(t as i64), 1e-5);
        assert_close("acting values", &values, &expected["values"].get(t as i64), 1e-5);
    }
    assert_close("acting beliefs", &belief, &expected["beliefs"], 1e-5);

    // Training: all at once, packed.
    let packing = Packing::new(0..3, |_| 3, |t, n| starts[t][n]);
    let embedded = network.embed(&observe(&packing.rows));
    let beliefs = network.belief.unroll(parameters, &embedded, &packing, &at_start);
    let ActorCriticOutput { policy, values } = network.actor_critic(&beliefs, None, None);
    let log_probs = policy.rows();
    let at = |table: &Tensor| {
        let rows: Vec<Tensor> = packing.rows.iter().map(|&(t, n)| table.get(t as i64).get(n as i64)).collect();
        Tensor::stack(&rows, 0)
    };
    assert_close("log_probs", &log_probs, &at(&expected["log_probs"]), 1e-5);
    assert_close("values", &values, &at(&expected["values"]), 1e-5);

    let pull = |name: &str, shape: &[i64]| {
        let steps: Vec<Tensor> = (0..3).map(|t| noise_tensor(&format!("pull.{name}.{t}"), shape)).collect();
        at(&Tensor::stack(&steps, 0))
    };
    let loss = (log_probs * pull("policy", &[3, actions])).sum(Kind::Float)
        + (values * pull("value", &[3])).sum(Kind::Float)
        + (head.logits(parameters, &beliefs) * pull("disturb", &[3, actions])).sum(Kind::Float);
    let gradient = parameters.gradient_of(&loss);
    let mut offset = 0;
    let gradients = parameters
        .named()
        .map(|(name, weight)| {
            let count = weight.numel() as i64;
            offset += count;
            (name.to_owned(), gradient.narrow(0, offset - count, count))
        })
        .collect();
    assert_probes(&gradients, &expected["gradients"], 1e-5);
}

#[test]
fn the_papers_network_is_pytorchs() {
    network_matches("resnet", &Config::default());
}

#[test]
fn the_baselines_network_is_pytorchs() {
    let mut config = Config::default();
    config.network.encoder = Encoder::Cnn;
    config.network.input_pool = 1;
    config.network.goal = GoalCoordinates::Cartesian;
    config.network.previous_action = false;
    config.network.hidden = 64;
    config.episode.action_space = ActionSpace::named("small").expect("the task has it");
    network_matches("cnn", &config);
}
