//! The rollout actor of kitchens: the engine, and what it runs here.
//!
//! ```text
//! kitchens      environments in kitchens, as the engine runs them
//! scenes        where they are, and what their cameras see there
//! prefetcher        procedural kitchens, made ahead
//! ```

pub mod kitchens;
pub mod prefetcher;
mod scenes;

use anyhow::{Context, Result};
use engine::{Environments, Link};
use kitchens::{Kitchens, homes};
use prefetcher::KitchenPrefetcher;
use proto::bounded;
use proto::config::Config;
use std::path::{Path, PathBuf};
use std::time::Instant;
use wire::WireAddress;

/// What a rollout actor is told on its command line.
#[derive(Debug, Clone)]
pub struct Settings {
    pub actor: u32,
    /// How often it has been started in this run incarnation, from 1.
    pub incarnation: u32,
    pub wire: WireAddress,
    pub config: PathBuf,
}

pub fn run(settings: &Settings) -> Result<std::convert::Infallible> {
    let path = settings.config.display().to_string();
    let text = bounded::read_text(&settings.config).with_context(|| format!("cannot read {path}"))?;
    let config = Config::from_toml(&text, &path)?;
    let _span = match config.kitchens().of_actor(settings.actor) {
        Some(kitchen) => tracing::info_span!("actor", number = settings.actor, kitchen = kitchen.number()).entered(),
        None => tracing::info_span!("actor", number = settings.actor).entered(),
    };

    let started = Instant::now();
    let folder = settings.config.parent().unwrap_or(Path::new(""));
    let kitchens = Kitchens::of(KitchenPrefetcher::of(&config, folder)?, &config)?;
    let mut environments = Environments::new(kitchens, &homes(settings.actor, &config), &config)?;
    let kitchen_ms = started.elapsed().as_millis() as u64;
    let link = Link::open(&settings.wire, settings.actor, &config)?;
    tracing::info!(
        bodies = environments.simulator().bodies(),
        triangles = environments.simulator().triangles(),
        environments = config.actors.environments_per_actor,
        kitchen_ms,
        total_ms = started.elapsed().as_millis() as u64,
        incarnation = settings.incarnation,
        "ready"
    );
    Ok(engine::run(&link, &mut environments, settings.incarnation)?)
}
