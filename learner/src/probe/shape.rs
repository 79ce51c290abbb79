//! Which network a set of weights is of, read off their names and shapes.

use crate::checkpoint::TensorsError;
use proto::action::ActionSpace;
use proto::config::{AuxiliaryTask, Config, Encoder};
use std::collections::BTreeMap;
use tch::Tensor;

/// Numbers that the encoder's convolutions leave of a frame: input width of its linear layer.
const FEATURES: [(Encoder, u32, i64); 6] = [
    (Encoder::Resnet, 1, 128 * 7 * 7),
    (Encoder::Resnet, 2, 128 * 4 * 4),
    (Encoder::Resnet, 4, 128 * 2 * 2),
    (Encoder::Cnn, 1, 32 * 24 * 24),
    (Encoder::Cnn, 2, 32 * 10 * 10),
    (Encoder::Cnn, 4, 32 * 3 * 3),
];

/// Each encoder's linear layer.
const LINEAR: [(Encoder, &str); 2] =
    [(Encoder::Resnet, "visual_encoder.fc.1.weight"), (Encoder::Cnn, "visual_encoder.cnn.6.weight")];

/// A weight that only this auxiliary task has.
const TASKS: [(AuxiliaryTask, &str); 3] = [
    (AuxiliaryTask::Disturb, "auxiliary.disturb.0.weight"),
    (AuxiliaryTask::InverseDynamics, "auxiliary.inverse_dynamics.weight"),
    (AuxiliaryTask::Cpca16, "auxiliary.cpca16.context_model.weight_ih_l0"),
];

/// Sets encoder, pooling, previous action, width, action space and auxiliary task to what the weights are of.
pub fn fit(config: &mut Config, weights: &BTreeMap<String, Tensor>) -> Result<(), TensorsError> {
    let wrong = |name: &str, problem: String| TensorsError::Tensor { name: name.to_owned(), problem };
    let side = |name: &str, dimension: usize| {
        let weight = weights.get(name).ok_or_else(|| wrong(name, "is missing".to_owned()))?;
        let size = weight.size();
        size.get(dimension).copied().ok_or_else(|| wrong(name, format!("is {size:?}, which is no matrix")))
    };
    let has = |name: &&str| weights.contains_key(*name);

    let (encoder, linear) = LINEAR.into_iter().find(|(_, name)| has(name)).ok_or_else(|| {
        wrong(LINEAR[0].1, format!("is missing, and so is {}: neither encoder's weights are there", LINEAR[1].1))
    })?;
    config.network.encoder = encoder;
    let features = side(linear, 1)?;
    config.network.input_pool = FEATURES
        .into_iter()
        .find(|&(known, _, width)| (known, width) == (encoder, features))
        .map(|(_, pool, _)| pool)
        .ok_or_else(|| wrong(linear, format!("takes {features} numbers, which no input pooling (1, 2, 4) leaves")))?;

    let actor = "actor.weight";
    let (actions, hidden) = (side(actor, 0)?, side(actor, 1)?);
    config.episode.action_space = [ActionSpace::Large, ActionSpace::Small]
        .into_iter()
        .find(|space| space.actions().len() as i64 == actions)
        .ok_or_else(|| wrong(actor, format!("has {actions} actions; there are spaces of 21 and 13")))?;
    config.network.hidden = u32::try_from(hidden).map_err(|_| wrong(actor, format!("is {hidden} wide")))?;
    config.network.previous_action = has(&"previous_action_embedder.weight");
    config.auxiliary.task = TASKS.into_iter().find(|(_, name)| has(name)).map_or(AuxiliaryTask::None, |(task, _)| task);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::auxiliary::Auxiliary;
    use crate::network::Network;
    use tch::Device;

    /// Whatever network is built, its weights tell which it is.
    #[test]
    fn every_network_is_known_by_its_weights() {
        let tasks =
            [AuxiliaryTask::None, AuxiliaryTask::Disturb, AuxiliaryTask::InverseDynamics, AuxiliaryTask::Cpca16];
        for (index, (encoder, input_pool, _)) in FEATURES.into_iter().enumerate() {
            let mut config = Config::default();
            config.network.encoder = encoder;
            config.network.input_pool = input_pool;
            config.network.hidden = 16;
            config.network.previous_action = index % 2 == 0;
            config.episode.action_space = if index < 3 { ActionSpace::Small } else { ActionSpace::Large };
            config.auxiliary.task = tasks[index % tasks.len()];
            let actions = config.episode.action_space.actions().len() as i64;
            let (network, _) = Network::new(&config, Device::Cpu, |layout, hidden| {
                Auxiliary::new(&config.auxiliary, layout, hidden, actions)
            });
            let weights = network.parameters.named().map(|(name, weight)| (name.to_owned(), weight)).collect();
            let mut found = Config::default();
            found.auxiliary.task = AuxiliaryTask::Cpca16;
            fit(&mut found, &weights).unwrap();
            assert_eq!((found.network, found.auxiliary), (config.network, config.auxiliary));
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
