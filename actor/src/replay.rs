//! `actor replay`: proves that recorded episodes happen again, and draws them.
//!
//! Input and output are the lines of [`proto::replay`]. Nothing but the configuration and the actions of an episode
//! is needed to simulate it. All that was recorded of it is compared on the way ([`proto::replay::play`]).

pub(crate) mod film;
mod picture;

use anyhow::{Context, Result, ensure};
use engine::whereabouts;
use film::{Film, Played};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::replay::{Performance, RecordedEpisode, ReplayImages, ReplayLine, ReplaySetup, ReplayVerdict, Rules, play};
use simulator::depth::DepthCamera;
use simulator::environment::Environment;
use simulator::kitchen::Kitchen;
use simulator::{source, tasks};
use std::collections::BTreeMap;
use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::sync::Arc;

const SIDE_MAX: u32 = 4096;

/// Reads a setup and episodes from `input` until it ends, writes to `output` a verdict on each, and how much is drawn.
pub fn run(input: impl BufRead, mut output: impl Write) -> Result<()> {
    let mut lines = input.lines();
    // The process that wanted the replay has ended before it said what.
    let Some(first) = lines.next() else { return Ok(()) };
    let setup: ReplaySetup =
        serde_json::from_str(&first.context("cannot read the setup")?).context("the first line is not a setup")?;
    let config = Config::from_toml(&setup.config, "the setup's configuration")?;
    if let Some(images) = &setup.images {
        ensure!((1..=SIDE_MAX).contains(&images.side), "images are 1 to {SIDE_MAX} pixels wide, not {}", images.side);
    }
    let folder = PathBuf::from(setup.folder.unwrap_or_default());
    let rules = Rules::of(&config)?;
    let mut player = Player::new(config, folder);
    for (number, line) in lines.enumerate() {
        let line = line.context("cannot read an episode")?;
        let episode: RecordedEpisode =
            serde_json::from_str(&line).with_context(|| format!("line {} is not an episode", number + 2))?;
        let mut write = |line: &ReplayLine| {
            serde_json::to_writer(&mut output, line).context("cannot write a verdict")?;
            output.write_all(b"\n").and_then(|()| output.flush()).context("cannot write a verdict")
        };
        let drawn = || write(&ReplayLine::Drawn { drawn: 1 });
        let verdict = perform(&mut player, setup.images.as_ref(), &rules, &episode, drawn)?;
        write(&ReplayLine::Verdict(Box::new(verdict)))?;
    }
    Ok(())
}

/// Kitchens as they are needed, and the environment that was used last: episodes of one environment come in a row.
pub(crate) struct Player {
    config: Config,
    /// The run folder: scenes are named relative to it.
    folder: PathBuf,
    run: Arc<tasks::Run>,
    kitchens: BTreeMap<KitchenId, (Arc<Kitchen>, DepthCamera)>,
    environment_in_use: Option<(EnvironmentId, Box<dyn Environment>)>,
}

/// An environment at the start of an episode.
pub(crate) struct Started<'a> {
    pub environment: &'a mut dyn Environment,
    pub camera: &'a mut DepthCamera,
    /// In an evaluation: number of the fixed episode, as in the table of episodes.
    pub fixed: Option<u32>,
}

impl Player {
    /// For episodes that were recorded under this configuration, in the run of this folder.
    pub fn new(config: Config, folder: PathBuf) -> Self {
        Self { run: tasks::Run::of(&config), config, folder, kitchens: BTreeMap::new(), environment_in_use: None }
    }

    pub fn open(&mut self, recorded: &RecordedEpisode) -> Result<Started<'_>> {
        let id = recorded.environment;
        whereabouts::enter(id, recorded.episode);
        if !self.kitchens.contains_key(&id.kitchen) {
            // Episodes in one kitchen come in a row, and procedural kitchens are too many to keep.
            self.kitchens.retain(|kitchen, _| !kitchen.is_procedural());
            let kitchen = source::of_run(id.kitchen, &self.config, &self.folder)?;
            let camera = DepthCamera::new(kitchen.bodies());
            self.kitchens.insert(id.kitchen, (Arc::new(kitchen), camera));
        }
        let (kitchen, camera) = self.kitchens.get_mut(&id.kitchen).context("the kitchen was just put there")?;
        match &mut self.environment_in_use {
            Some((in_use, environment)) if *in_use == id => environment.begin(recorded.episode),
            environment_in_use => {
                *environment_in_use = Some((id, tasks::open(&self.run, kitchen, id, recorded.episode)?));
            }
        }
        let (_, environment) = self.environment_in_use.as_mut().context("the environment was just put there")?;
        Ok(Started { environment: &mut **environment, camera, fixed: self.run.dealt(id, recorded.episode) })
    }
}

/// Simulates an episode, and draws it if that is asked for.
fn perform(
    player: &mut Player,
    images: Option<&ReplayImages>,
    rules: &Rules,
    recorded: &RecordedEpisode,
    drawn: impl FnMut() -> Result<()>,
) -> Result<ReplayVerdict> {
    let Started { environment, camera, fixed } = player.open(recorded)?;
    let played = Played { environment: recorded.environment, episode: recorded.episode, fixed };
    let mut film = images.map(|_| Film::new(played));
    let Performance { mut verdict, outcome, .. } = play(rules, environment, recorded, |environment, moment| {
        if let Some(film) = &mut film {
            film.keep(rules, environment.base(), moment);
        }
        anyhow::Ok(())
    })?;
    if let (Some(film), Some(images)) = (film, images) {
        (verdict.images, verdict.film) = film.develop(images, rules, &outcome, environment.base(), camera, drawn)?;
    }
    Ok(verdict)
}

#[cfg(test)]
mod tests;
