//! Weights of another run's checkpoint, or of a policy file.

use crate::agent::Agent;
use crate::checkpoint::{self, decode_tensors};
use crate::import;
use anyhow::{Context, Result, anyhow, bail, ensure};
use proto::checkpoint::Manifest;
use proto::policy_file::{BYTES_MOST, PolicyFacts, PolicyFileError};
use safetensors::SafeTensors;
use std::path::Path;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Trained {
    /// The first rollout that they were not trained on.
    pub rollout: u64,
    pub frames: u64,
}

/// Loads the weights of a checkpoint, by its manifest, or of a policy file.
pub fn load_any(agent: &mut Agent, from: &Path) -> Result<Trained> {
    if from.extension().is_some_and(|kind| kind == "safetensors") {
        return load_policy(agent, from).with_context(|| from.display().to_string());
    }
    let Manifest { rollout, frames, .. } = load(agent, from)?;
    Ok(Trained { rollout, frames })
}

/// Loads the weights of the checkpoint with this manifest, and nothing else of it.
pub fn load(agent: &mut Agent, manifest: &Path) -> Result<Manifest> {
    let (snapshot, manifest) = checkpoint::read(manifest).map_err(|rejected| anyhow!("checkpoint {rejected}"))?;
    agent.load_weights(&snapshot.agent).context("the checkpoint is of another network")?;
    let weights = agent.weights_digest();
    if weights != manifest.weights {
        bail!("the weights loaded have digest {weights}, saved were {}", manifest.weights);
    }
    Ok(manifest)
}

/// What a policy file says of its weights, which are those that were written; nothing where these are weights alone.
pub fn facts_of(bytes: &[u8]) -> Result<Option<PolicyFacts>> {
    let of_file = |problem: PolicyFileError| anyhow!("the policy file {problem}");
    let (_, header) = SafeTensors::read_metadata(bytes)?;
    let metadata = header.metadata().as_ref().map(|entries| entries.clone().into_iter().collect());
    let facts = match PolicyFacts::read(metadata.as_ref(), "its configuration") {
        Err(PolicyFileError::Nameless) => return Ok(None),
        facts => facts.map_err(of_file)?,
    };
    let mut tensors = SafeTensors::deserialize(bytes)?.tensors();
    tensors.sort_unstable_by(|(a, _), (b, _)| a.cmp(b));
    facts.verify(tensors.iter().map(|(name, view)| (name.as_str(), view.data()))).map_err(of_file)?;
    Ok(Some(facts))
}

/// Its weights have 16 or 32 bits; the network computes with 32.
fn load_policy(agent: &mut Agent, file: &Path) -> Result<Trained> {
    let bytes = proto::bounded::read(file, BYTES_MOST)?;
    let facts = facts_of(&bytes)?.ok_or(PolicyFileError::Nameless)?;
    let mut state = agent.state();
    state.carried_goal = facts.origin.carried_goal;
    let imported = import::import(&decode_tensors(&bytes)?, &mut state)?;
    let fresh = imported.fresh.join(", ");
    ensure!(imported.fresh.is_empty(), "it has nothing for {fresh}, which this configuration asks for");
    agent.load_weights(&state).context("it is of another network")?;
    Ok(Trained { rollout: facts.origin.rollout, frames: facts.origin.frames })
}
