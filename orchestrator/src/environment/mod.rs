//! Environments that are not built in: a command of the user's simulates them.

pub mod consent;
pub mod describe;
mod trial;

use anyhow::{Context, Result};
use proto::actor_notes::Noted;
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

/// Refuses a run or recording whose environments are simulated by a command that is not allowed, or of another build.
pub fn demand(config: &Config, folder: &Path) -> Result<()> {
    consent::demand(config, folder)?;
    config.environment.as_ref().map_or(Ok(()), describe::demand_build)
}

/// The same before anything is made for a run, and tries the environment: without it actors would be started again and
/// again.
pub fn attempt(config: &Config, folder: &Path) -> Result<()> {
    demand(config, folder)?;
    let Some(environment) = &config.environment else { return Ok(()) };
    let tried = describe::describe(environment, &environment.declaration, deadline(config));
    tried.map(drop).with_context(|| format!("the environment of {} cannot be started", folder.display()))
}

/// How long a call of an environment's method may take.
pub fn deadline(config: &Config) -> Duration {
    Duration::try_from_secs_f64(config.learner.actor_deadline_s).unwrap_or(Duration::MAX)
}

/// A sentence for each actor of a run whose memory grows without an end in sight, by the actor's name.
pub fn growing(folder: &RunFolder, config: &Config) -> BTreeMap<String, String> {
    let actors = 0..if config.environment.is_some() { config.actors.count } else { 0 };
    // Actors of other hosts note in these hosts' folders.
    let folders: Vec<RunFolder> = [folder.clone()].into_iter().chain(folder.host_folders()).collect();
    let sentence = |actor: u32| Some(folders.iter().find_map(|one| Noted::read(one, actor)?.growth)?.to_string());
    actors.filter_map(|actor| Some((format!("actor-{actor:02}"), sentence(actor)?))).collect()
}
