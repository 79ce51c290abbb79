//! Weights of another run's checkpoint.

use crate::agent::Agent;
use crate::checkpoint;
use anyhow::{Context, Result, bail};
use proto::checkpoint::Manifest;
use std::path::Path;

/// Loads the weights of the checkpoint with this manifest, and nothing else of it.
pub fn load(agent: &mut Agent, manifest: &Path) -> Result<Manifest> {
    let (snapshot, manifest) =
        checkpoint::read(manifest).map_err(|rejected| anyhow::anyhow!("checkpoint {rejected}"))?;
    agent.load_weights(&snapshot.agent).context("the checkpoint is of another network")?;
    let weights = agent.weights_digest();
    if weights != manifest.weights {
        bail!("the weights loaded have digest {weights}, saved were {}", manifest.weights);
    }
    Ok(manifest)
}
