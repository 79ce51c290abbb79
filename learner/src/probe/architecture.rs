//! Which network a set of weights is of, read off their names and shapes.

use crate::auxiliary::TASKS;
use crate::checkpoint::TensorsError;
use crate::network::{ENCODERS, has_normalizer};
use proto::camera::FRAME_SIDE;
use proto::config::{AuxiliaryTask, Config, INPUT_POOLS, Memory};
use proto::task::{ActionHead, ActionSpace};
use std::collections::BTreeMap;
use tch::Tensor;

/// The weight that shows which unit the belief has, and how wide it is.
const BELIEF: &str = "belief.weight_hh_l0";

/// Sets encoder, pooling or layers, memory, previous action, normalisation, width, action space and auxiliary task to
/// what the weights are of.
pub fn fit(config: &mut Config, weights: &BTreeMap<String, Tensor>) -> Result<(), TensorsError> {
    let side = |name: &str, dimension| side(weights, name, dimension);
    let actor = if config.spec().inputs().is_ok_and(|inputs| inputs.frame.is_none()) {
        fit_numbers(config, weights)
    } else {
        fit_frames(config, weights)?;
        "actor.weight".to_owned()
    };
    let actions = side(&actor, 0)?;
    let spaces: Vec<(usize, ActionSpace)> = ActionSpace::all()
        .filter_map(|space| Some((ActionHead::of(space, &config.spec().actions)?.outputs(), space)))
        .collect();
    let found = spaces.iter().find(|(count, _)| *count as i64 == actions);
    let counts: Vec<String> = spaces.iter().map(|(count, _)| count.to_string()).collect();
    let none = || wrong(&actor, format!("has {actions} actions; there are spaces of {}", counts.join(" and ")));
    config.episode.action_space = found.ok_or_else(none)?.1;
    config.network.memory = memory(weights)?;
    if config.network.memory != Memory::None {
        let width = side(BELIEF, 1)?;
        config.network.hidden = u32::try_from(width).map_err(|_| wrong(BELIEF, format!("is {width} wide")))?;
    }
    config.normalize.observations = has_normalizer(weights.keys());
    config.network.previous_action = weights.contains_key("previous_action_embedder.weight");
    let has_task = |name: &str| weights.keys().any(|weight| weight.starts_with(&format!("auxiliary.{name}.")));
    let task = TASKS.into_iter().find(|entry| has_task(entry.name));
    config.auxiliary.task = task.map_or(AuxiliaryTask::None, |entry| entry.task);
    Ok(())
}

/// The belief's unit, by its gates.
fn memory(weights: &BTreeMap<String, Tensor>) -> Result<Memory, TensorsError> {
    if !weights.contains_key(BELIEF) {
        return Ok(Memory::None);
    }
    let [rows, width] = [side(weights, BELIEF, 0)?, side(weights, BELIEF, 1)?];
    let found = [Memory::Gru, Memory::Lstm].into_iter().find(|memory| rows == i64::from(memory.gates()) * width);
    found.ok_or_else(|| wrong(BELIEF, format!("is {rows} by {width}: a GRU has 3 gates, an LSTM 4")))
}

fn fit_frames(config: &mut Config, weights: &BTreeMap<String, Tensor>) -> Result<(), TensorsError> {
    let found = ENCODERS.iter().find(|entry| weights.contains_key(&last_layer(entry.linear)));
    let encoder = found.ok_or_else(|| {
        let [first, others @ ..] = ENCODERS.map(|entry| last_layer(entry.linear));
        wrong(&first, format!("is missing, and so is {}: neither encoder's weights are there", others.join(", and ")))
    })?;
    config.network.encoder = encoder.encoder;
    let linear = last_layer(encoder.linear);
    let features = side(weights, &linear, 1)?;
    config.network.input_pool = INPUT_POOLS
        .into_iter()
        .find(|&pool| (encoder.features)(FRAME_SIDE as i64 / i64::from(pool)) == features)
        .ok_or_else(|| wrong(&linear, format!("takes {features} numbers, which no input pooling (1, 2, 4) leaves")))?;
    Ok(())
}

/// Sets the widths of the layers that see numbers; returns the weight of the actor's last layer.
fn fit_numbers(config: &mut Config, weights: &BTreeMap<String, Tensor>) -> String {
    // Every second entry of PyTorch's Sequential has weights.
    let widths = |path: &str| -> Vec<u32> {
        let names = (0..).map(|index| format!("{path}.{}.weight", 2 * index));
        let layers = names.map_while(|name| weights.get(&name)?.size().first().copied());
        layers.map(|width| u32::try_from(width).unwrap_or(0)).collect()
    };
    let shared = widths("mlp");
    if !shared.is_empty() {
        config.network.mlp = shared;
        return "actor.weight".to_owned();
    }
    let mut own = widths("actor");
    // The actor's last layer has as many outputs as there are actions.
    own.pop();
    if own.is_empty() {
        // Behind images alone there are no layers.
        return "actor.weight".to_owned();
    }
    let last = format!("actor.{}.weight", 2 * own.len());
    config.network.mlp = own;
    last
}

fn wrong(name: &str, problem: String) -> TensorsError {
    TensorsError::Tensor { name: name.to_owned(), problem }
}

/// Length of a weight along a dimension.
fn side(weights: &BTreeMap<String, Tensor>, name: &str, dimension: usize) -> Result<i64, TensorsError> {
    let weight = weights.get(name).ok_or_else(|| wrong(name, "is missing".to_owned()))?;
    let size = weight.size();
    size.get(dimension).copied().ok_or_else(|| wrong(name, format!("is {size:?}, which is no matrix")))
}

fn last_layer(linear: &str) -> String {
    format!("{linear}.weight")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auxiliary::{Auxiliary, Sizes};
    use crate::network::Network;
    use tch::Device;

    /// The weights of any network identify it.
    #[test]
    fn every_network_is_known_by_its_weights() {
        let tasks =
            [AuxiliaryTask::None, AuxiliaryTask::Disturb, AuxiliaryTask::InverseDynamics, AuxiliaryTask::Cpca16];
        let shapes = ENCODERS.iter().flat_map(|entry| INPUT_POOLS.map(|pool| (entry.encoder, pool)));
        for (index, (encoder, input_pool)) in shapes.enumerate() {
            let mut config = Config::default();
            config.network.encoder = encoder;
            config.network.input_pool = input_pool;
            config.network.hidden = 16;
            config.network.memory = [Memory::Gru, Memory::Lstm, Memory::None][index / 2];
            config.network.previous_action = index % 2 == 0;
            config.normalize.observations = index % 2 == 1;
            config.episode.action_space =
                if index < 3 { ActionSpace::named("small").unwrap() } else { ActionSpace::default() };
            config.auxiliary.task = tasks[index % tasks.len()];
            let actions = config.policy_actions().len() as i64;
            let (network, _) = Network::new(&config, Device::Cpu, |layout, hidden| {
                Auxiliary::new(&config.auxiliary, layout, Sizes { hidden, actions })
            });
            let weights = network.parameters.named().map(|(name, weight)| (name.to_owned(), weight)).collect();
            let mut found = Config::default();
            found.auxiliary.task = AuxiliaryTask::Cpca16;
            found.network.hidden = 16;
            fit(&mut found, &weights).unwrap();
            assert_eq!((found.network, found.auxiliary), (config.network, config.auxiliary));
            assert_eq!(found.normalize, config.normalize);
            assert_eq!(found.episode.action_space, config.episode.action_space);
        }
    }

    #[test]
    fn weights_of_no_network_of_ours_are_refused() {
        let zeros = |size: &[i64]| Tensor::zeros(size, (tch::Kind::Float, Device::Cpu));
        let mut weights = BTreeMap::from([("actor.weight".to_owned(), zeros(&[20, 8]))]);
        let refused =
            |weights: &BTreeMap<String, Tensor>| fit(&mut Config::default(), weights).unwrap_err().to_string();
        assert!(refused(&weights).contains("neither encoder's weights are there"));
        weights.insert("visual_encoder.cnn.6.weight".to_owned(), zeros(&[512, 289]));
        assert!(refused(&weights).contains("takes 289 numbers"));
        weights.insert("visual_encoder.cnn.6.weight".to_owned(), zeros(&[512, 288]));
        assert!(refused(&weights).contains("has 20 actions"));
    }
}
