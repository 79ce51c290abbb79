//! Where a learner goes on: the newest good checkpoint, or the start.
//!
//! Learners of one host each read it. Of several hosts only rank 0 does, and the others get its state through the group:
//! they need not see its files.

use super::{changed, weights};
use crate::agent::{Agent, AgentState, BELIEFS};
use crate::checkpoint::{Loaded, Part, Snapshot, Store, decode, encode};
use crate::collector::Boundary;
use anyhow::{Context, Result, bail, ensure};
use proto::checkpoint::Manifest;
use proto::config::{CarriedGoal, Config, FromConfig};
use proto::hosts::Hosts;
use proto::trained::History;
use serde::{Deserialize, Serialize};
use std::path::Path;
use tch::Tensor;

pub struct Resumed {
    pub rollout: u64,
    pub frames: u64,
    pub boundary: Boundary,
    /// Columns of actors that the run does not have at present.
    pub resting: Option<Part>,
    pub figures: History,
    pub checkpoint: Option<String>,
}

/// A state to begin with, of all columns.
struct Found {
    snapshot: Snapshot,
    /// Figures of all rollouts before it: rank 0's alone.
    figures: History,
    /// The checkpoint that it came from; none for another run's weights.
    checkpoint: Option<String>,
}

/// Loads the newest good checkpoint into the agent. Without one the run starts, with another run's weights if the
/// configuration has `[from]`. `file`: the text of the configuration.
pub fn resume(
    store: &Store,
    agent: &mut Agent,
    config: &Config,
    file: &str,
    (rank, hosts): (u32, Hosts),
) -> Result<Resumed> {
    let columns = agent.columns();
    let shared = hosts.count() > 1;
    let mut found = if rank == 0 || !shared { find(store, agent, config, file)? } else { None };
    if shared {
        if rank == 0 && found.is_none() && config.from.is_some() {
            found = Some(as_found(agent, config)?);
        }
        let bytes = found.as_ref().map(pack).transpose()?.unwrap_or_default();
        let bytes = agent.peers().broadcast(bytes)?;
        if rank > 0 {
            found = if bytes.is_empty() { None } else { Some(unpack(&bytes)?) };
        }
    }
    let Some(Found { mut snapshot, figures, checkpoint }) = found else {
        let (boundary, figures) = (Boundary::start(columns.len()), History::default());
        return Ok(Resumed { rollout: 0, frames: 0, boundary, resting: None, figures, checkpoint: None });
    };
    let path = checkpoint.as_deref().unwrap_or("of another run");
    snapshot.widen(config.environments());
    let resting = snapshot.resting(config.environments());
    snapshot.keep(columns);
    agent.load_state(&snapshot.agent).with_context(|| format!("cannot use checkpoint {path}"))?;
    let (loaded, saved) = (agent.weights_digest(), &snapshot.weights);
    if loaded != *saved {
        bail!("the weights loaded from checkpoint {path} have digest {loaded}, saved were {saved}");
    }
    let Snapshot { rollout, frames, boundary, .. } = snapshot;
    if rank == 0 && checkpoint.is_some() {
        // Whoever wrote it may have died before this, and it may be the run's last.
        store.prune(rollout);
    }
    Ok(Resumed { rollout, frames, boundary, resting, figures, checkpoint })
}

/// The newest good checkpoint on the disk. Without one the agent takes the weights of `[from]`, if there is that.
fn find(store: &Store, agent: &mut Agent, config: &Config, file: &str) -> Result<Option<Found>> {
    let Some(loaded) = store.load()? else {
        if let Some(from) = &config.from {
            begin_from(agent, from)?;
        }
        return Ok(None);
    };
    let Loaded { snapshot, manifest, path, rejected, figures } = loaded;
    for rejected in &rejected {
        tracing::warn!("checkpoint passed over: {rejected}");
    }
    let figures = figures.unwrap_or_else(|reason| {
        tracing::warn!("{reason}: the figures of the rollouts before it are those in metrics.jsonl");
        store.figures_of_file(snapshot.rollout)
    });
    let held = snapshot.boundary.environments.len();
    let then = with_actors_of(&manifest, config, held).with_context(|| format!("cannot use checkpoint {path}"))?;
    if then.actors.count != config.actors.count {
        tracing::info!(
            "{} actors instead of {} from rollout {} on: {}",
            config.actors.count,
            then.actors.count,
            snapshot.rollout,
            change_of_columns(held, config)
        );
    }
    if let Some(changes) = changed::since(&manifest, &then, file) {
        tracing::warn!(
            "the configuration has changed since checkpoint {path}: {changes}. The run goes on under the new one"
        );
    }
    let differences = store.machine().differences(&manifest.machine);
    if !differences.is_empty() {
        tracing::warn!(
            "results will not be bit-identical to a run without this resume: {} (checkpoint {path})",
            differences.join(", ")
        );
    }
    Ok(Some(Found { snapshot, figures, checkpoint: Some(path) }))
}

/// The configuration with the number of actors that a checkpoint of `held` columns was written with, which may be
/// another one; with shards also with the number of learners. Another number of environments in each actor would make
/// other environments of the same columns.
fn with_actors_of(manifest: &Manifest, config: &Config, held: usize) -> Result<Config> {
    let wanted = config.environments();
    let Ok(then) = Config::from_toml(&manifest.config, "its configuration") else {
        // An older version wrote it.
        ensure!(held == wanted, "it holds {held} environments, the configuration asks for {wanted}");
        return Ok(config.clone());
    };
    let [was, is] = [&then, config].map(|config| config.actors.environments_per_actor);
    ensure!(
        was == is && held.is_multiple_of(is as usize),
        "it holds {held} environments, {was} in each actor, and the configuration asks for {is} in each: the number of \
         actors may change, that of their environments may not"
    );
    let mut as_then = config.clone();
    as_then.actors.count = then.actors.count;
    if config.learner.shards > 0 {
        // With shards this is no change of what is computed.
        as_then.learner.count = then.learner.count;
    }
    Ok(as_then)
}

/// What a change of the number of actors means for the columns, of which a checkpoint holds so many.
fn change_of_columns(held: usize, config: &Config) -> String {
    let wanted = config.environments();
    match held.checked_sub(wanted) {
        Some(0) => "all environments that the run has had are in use".to_owned(),
        Some(resting) => format!("{resting} environments rest"),
        None => format!("{} environments begin their first episode", wanted - held),
    }
}

/// Takes the weights of another run's checkpoint.
fn begin_from(agent: &mut Agent, from: &FromConfig) -> Result<()> {
    let manifest = weights::load(agent, Path::new(&from.checkpoint))
        .with_context(|| format!("cannot begin from {}", from.checkpoint))?;
    if manifest.weights != from.weights {
        bail!("{} holds weights {} now; the run was to begin from {}", from.checkpoint, manifest.weights, from.weights);
    }
    tracing::info!("begins with the weights of {} ({} frames)", from.checkpoint, from.frames);
    Ok(())
}

/// The start of a run with the agent's weights, for all columns.
fn as_found(agent: &Agent, config: &Config) -> Result<Found> {
    let mut state = agent.state();
    let own = state.tensors.get(BELIEFS).context("an agent's state has beliefs")?;
    let all = Tensor::zeros([config.environments() as i64, own.size()[1]], (own.kind(), own.device()));
    state.tensors.insert(BELIEFS.into(), all);
    let (boundary, weights) = (Boundary::start(config.environments()), agent.weights_digest());
    let snapshot = Snapshot { rollout: 0, frames: 0, agent: state, boundary, weights };
    Ok(Found { snapshot, figures: History::default(), checkpoint: None })
}

/// What of a [`Found`] is no tensor.
#[derive(Serialize, Deserialize)]
struct Head {
    rollout: u64,
    frames: u64,
    exchange: u64,
    adam_steps: u64,
    multiplier: f64,
    carried_goal: CarriedGoal,
    weights: String,
    checkpoint: Option<String>,
}

/// As bytes: the length of the head, the head, the tensors. Figures are rank 0's alone.
fn pack(found: &Found) -> Result<Vec<u8>> {
    let Found { snapshot: Snapshot { rollout, frames, agent, boundary, weights }, figures: _, checkpoint } = found;
    let head = serde_json::to_vec(&Head {
        rollout: *rollout,
        frames: *frames,
        exchange: boundary.exchange,
        adam_steps: agent.adam_steps,
        multiplier: agent.multiplier,
        carried_goal: agent.carried_goal,
        weights: weights.clone(),
        checkpoint: checkpoint.clone(),
    })?;
    let mut bytes = (head.len() as u64).to_le_bytes().to_vec();
    bytes.extend(head);
    bytes.extend(encode(&agent.tensors, boundary)?);
    Ok(bytes)
}

fn unpack(bytes: &[u8]) -> Result<Found> {
    let (length, rest) = bytes.split_first_chunk().context("the first learner's state is cut off")?;
    let (head, tensors) =
        rest.split_at_checked(u64::from_le_bytes(*length) as usize).context("the first learner's state is cut off")?;
    let Head { rollout, frames, exchange, adam_steps, multiplier, carried_goal, weights, checkpoint } =
        serde_json::from_slice(head).context("the first learner's state")?;
    let (tensors, boundary) = decode(tensors, exchange).context("the first learner's state")?;
    let agent = AgentState { tensors, adam_steps, multiplier, carried_goal };
    let snapshot = Snapshot { rollout, frames, agent, boundary, weights };
    Ok(Found { snapshot, figures: History::default(), checkpoint })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use tch::{Device, Kind};

    #[test]
    fn what_crosses_to_other_hosts_arrives_whole_and_a_cut_one_is_refused() {
        let beliefs = Tensor::ones([3, 2], (Kind::Float, Device::Cpu));
        let tensors = BTreeMap::from([(BELIEFS.to_owned(), beliefs)]);
        let agent = AgentState { tensors, adam_steps: 5, multiplier: 0.25, carried_goal: CarriedGoal::ObjectToGoal };
        let boundary = Boundary { exchange: 40, ..Boundary::start(3) };
        let snapshot = Snapshot { rollout: 4, frames: 48, agent, boundary, weights: "w".into() };
        let figures = History::default();
        let bytes = pack(&Found { snapshot, figures, checkpoint: Some("checkpoints/c.json".into()) }).unwrap();
        let Found { snapshot, checkpoint, .. } = unpack(&bytes).unwrap();
        assert_eq!((snapshot.rollout, snapshot.frames, checkpoint.as_deref()), (4, 48, Some("checkpoints/c.json")));
        assert_eq!((snapshot.agent.adam_steps, snapshot.agent.multiplier, &*snapshot.weights), (5, 0.25, "w"));
        assert_eq!((snapshot.boundary.exchange, snapshot.boundary.environments.len()), (40, 3));
        assert_eq!(snapshot.agent.tensors[BELIEFS].size(), [3, 2]);
        for cut in [0, 7, 20, bytes.len() - 1] {
            assert!(unpack(&bytes[..cut]).is_err(), "{cut}");
        }
    }
}
