//! `actor replay`: proves that recorded episodes happen again, and draws them.
//!
//! Input and output are the lines of [`proto::replay`]. Nothing but the configuration and the actions of an episode
//! is needed to simulate it. All that was recorded of it is compared on the way: state hashes, the goal vector before
//! each action, outcomes, rewards, disturbance and distances.

pub(crate) mod film;
mod picture;

use crate::process::whereabouts;
use anyhow::{Context, Result, ensure};
use film::{Film, Played};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::record::End;
use proto::replay::{
    Aspect, Difference, RecordedEpisode, RecordedStep, ReplayImages, ReplaySetup, ReplayVerdict, STEP_ASPECTS,
    goal_digest, length_m, start_digest,
};
use proto::task::Composition;
use simulator::depth::DepthCamera;
use simulator::kitchen::Kitchen;
use simulator::robot::action::Action;
use simulator::source;
use simulator::tasks::Run;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::Transition;
use std::collections::BTreeMap;
use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::sync::Arc;

/// Widest and highest image that is drawn, pixels.
const SIDE_MAX: u32 = 4096;

/// Reads a setup and episodes from `input` until it ends, writes a verdict on each to `output`.
pub fn run(input: impl BufRead, mut output: impl Write) -> Result<()> {
    let mut lines = input.lines();
    let first = lines.next().context("the input is empty: its first line is the replay's setup")?;
    let setup: ReplaySetup =
        serde_json::from_str(&first.context("cannot read the setup")?).context("the first line is not a setup")?;
    let config = Config::from_toml(&setup.config, "the setup's configuration")?;
    if let Some(images) = &setup.images {
        ensure!((1..=SIDE_MAX).contains(&images.side), "images are 1 to {SIDE_MAX} pixels wide, not {}", images.side);
    }
    let folder = PathBuf::from(setup.folder.unwrap_or_default());
    let mut theatre = Theatre::new(&config, folder);
    for (number, line) in lines.enumerate() {
        let line = line.context("cannot read an episode")?;
        let episode: RecordedEpisode =
            serde_json::from_str(&line).with_context(|| format!("line {} is not an episode", number + 2))?;
        let verdict = perform(&mut theatre, setup.images.as_ref(), &config, &episode)?;
        serde_json::to_writer(&mut output, &verdict).context("cannot write a verdict")?;
        output.write_all(b"\n").and_then(|()| output.flush()).context("cannot write a verdict")?;
    }
    Ok(())
}

/// Kitchens as they are needed, and the environment that was used last: episodes of one environment come in a row.
pub(crate) struct Theatre {
    /// Under whose configuration the episodes were recorded.
    run: Arc<Run>,
    /// The run folder: scenes are named relative to it.
    folder: PathBuf,
    kitchens: BTreeMap<KitchenId, (Arc<Kitchen>, DepthCamera)>,
    stage: Option<(EnvironmentId, Environment)>,
}

/// An environment at the start of an episode.
pub(crate) struct Stage<'a> {
    pub environment: &'a mut Environment,
    /// A camera for its kitchen.
    pub camera: &'a mut DepthCamera,
    /// In an evaluation: number of the fixed episode, as in the table of episodes.
    pub fixed: Option<u32>,
}

impl Theatre {
    /// For episodes that were recorded under this configuration, in the run of this folder.
    pub fn new(config: &Config, folder: PathBuf) -> Self {
        Self { run: Run::of(config), folder, kitchens: BTreeMap::new(), stage: None }
    }

    /// The environment of an episode, at its start.
    pub fn open(&mut self, recorded: &RecordedEpisode) -> Result<Stage<'_>> {
        let id = recorded.environment;
        whereabouts::enter(id, recorded.episode);
        if !self.kitchens.contains_key(&id.kitchen) {
            // Episodes in one kitchen come in a row, and procedural kitchens are too many to keep.
            self.kitchens.retain(|kitchen, _| !kitchen.is_procedural());
            let kitchen = source::of_run(id.kitchen, &self.run.config, &self.folder)?;
            let camera = DepthCamera::new(kitchen.bodies());
            self.kitchens.insert(id.kitchen, (Arc::new(kitchen), camera));
        }
        let (kitchen, camera) = self.kitchens.get_mut(&id.kitchen).context("the kitchen was just put there")?;
        match &mut self.stage {
            Some((on_stage, environment)) if *on_stage == id => environment.start_episode(recorded.episode),
            stage => *stage = Some((id, Environment::open(&self.run, Arc::clone(kitchen), id, recorded.episode)?)),
        }
        let (_, environment) = self.stage.as_mut().context("the environment was just put there")?;
        Ok(Stage { environment, camera, fixed: self.run.dealt(id, recorded.episode) })
    }
}

impl Stage<'_> {
    /// Takes the recorded actions, and compares all that was recorded on the way. `watch` is called at the start, and
    /// after each action with what it did.
    pub fn play(
        &mut self,
        recorded: &RecordedEpisode,
        config: &Config,
        mut watch: impl FnMut(&mut Environment, &mut DepthCamera, Option<Transition>) -> Result<()>,
    ) -> Result<ReplayVerdict> {
        check_lengths(recorded)?;
        let Self { environment, camera, .. } = self;
        let (environment, camera) = (&mut **environment, &mut **camera);
        let mut verdict = ReplayVerdict {
            environment: recorded.environment,
            episode: recorded.episode,
            compared: 0,
            first_difference: None,
            images: 0,
        };
        if let Some(hash) = recorded.start_hash {
            compare(&mut verdict, 0, hash, environment.state_hash());
        }
        if recorded.start.is_some_and(|start| start != start_of(environment)) {
            differ(&mut verdict, 0, Aspect::Start);
        }
        watch(environment, camera, None)?;
        let rewards = Rewards::of(config);
        for (step, (&index, &hash)) in recorded.actions.iter().zip(&recorded.hashes).enumerate() {
            let action =
                Action::from_index(index).with_context(|| format!("step {step}: there is no action {index}"))?;
            if recorded.goals.get(step).is_some_and(|&goal| goal != 0 && goal != goal_of(environment)) {
                differ(&mut verdict, step as u64, Aspect::Goal);
            }
            let transition = environment.step(action);
            let taken = step as u64 + 1;
            compare(&mut verdict, taken, hash, environment.state_hash());
            if let Some(digests) = recorded.steps.get(step) {
                let simulated = digests_of(environment, &transition, &rewards);
                let aspects = STEP_ASPECTS.into_iter().zip(digests.iter().zip(&simulated));
                for (aspect, _) in aspects.filter(|(_, (recorded, simulated))| recorded != simulated) {
                    differ(&mut verdict, taken, aspect);
                }
            }
            watch(environment, camera, Some(transition))?;
            if environment.ended() && step + 1 < recorded.actions.len() {
                // The recorded episode went on: whatever comes now differs.
                differ(&mut verdict, taken + 1, Aspect::Length);
                break;
            }
        }
        Ok(verdict)
    }
}

/// Simulates an episode, and draws it if that is asked for.
fn perform(
    theatre: &mut Theatre,
    images: Option<&ReplayImages>,
    config: &Config,
    recorded: &RecordedEpisode,
) -> Result<ReplayVerdict> {
    let mut stage = theatre.open(recorded)?;
    let played = Played { environment: recorded.environment, episode: recorded.episode, fixed: stage.fixed };
    let mut film = images.map(|_| Film::new(played));
    let mut verdict = stage.play(recorded, config, |environment, _, transition| {
        if let Some(film) = &mut film {
            film.keep(environment, transition);
        }
        Ok(())
    })?;
    if let (Some(film), Some(images)) = (film, images) {
        verdict.images = film.develop(images, stage.environment, stage.camera)?;
    }
    Ok(verdict)
}

/// Digest of what the goal sensor reads now.
fn goal_of(environment: &Environment) -> u32 {
    let current = environment.current();
    goal_digest(current.holds(), if current.holds() { current.object_to_goal_m } else { current.wrist_to_object_m })
}

/// Digest of the episode's beginning.
fn start_of(environment: &Environment) -> u32 {
    let current = environment.current();
    start_digest(current.current_target, length_m(current.wrist_to_object_m), length_m(current.object_to_goal_m))
}

/// Digests of the step that was just taken, as a recorder would have recorded it.
fn digests_of(environment: &Environment, transition: &Transition, rewards: &Rewards) -> [u32; STEP_ASPECTS.len()] {
    let end = environment.end();
    let ends = [end == Some(End::Terminated), end == Some(End::Truncated), end.is_some()];
    let parts = transition.reward;
    let step = RecordedStep {
        failed: transition.failed(),
        picked_up: transition.picked_up(),
        success: transition.succeeded(),
        holding: transition.holds(),
        ends,
        target: transition.target,
        progress_m: [parts.wrist_object_progress_m, parts.object_goal_progress_m, parts.disturbance_progress_m],
        rewards: rewards.of_step(transition),
        disturbance_m: [transition.disturbance_m, transition.peak_disturbance_m],
        disturbed_objects: transition.disturbed_objects,
        distances_m: [transition.wrist_object_m, transition.object_goal_m],
    };
    step.digests()
}

/// r and r′, as a configuration weighs them.
pub(crate) struct Rewards([Composition; 2]);

impl Rewards {
    /// Those of a run.
    pub fn of(config: &Config) -> Self {
        Self(["r", "r_prime"].map(|name| config.reward(name)))
    }

    /// Of a step.
    pub(crate) fn of_step(&self, transition: &Transition) -> [f32; 2] {
        self.0.each_ref().map(|reward| reward.of(|index| transition.reward.part(index), 0.0))
    }
}

/// Everything of an episode is of its length, or not there.
fn check_lengths(recorded: &RecordedEpisode) -> Result<()> {
    let RecordedEpisode { actions, hashes, goals, steps, .. } = recorded;
    let count = actions.len();
    ensure!(hashes.len() == count, "{count} actions but {} hashes were recorded", hashes.len());
    for (what, length) in [("goals", goals.len()), ("steps", steps.len())] {
        ensure!(length == 0 || length == count, "{count} actions but {length} {what} were recorded");
    }
    Ok(())
}

fn compare(verdict: &mut ReplayVerdict, step: u64, recorded: u64, simulated: u64) {
    verdict.compared += 1;
    if recorded != simulated {
        differ(verdict, step, Aspect::State);
    }
}

/// The first difference stands.
fn differ(verdict: &mut ReplayVerdict, step: u64, aspect: Aspect) {
    verdict.first_difference.get_or_insert(Difference { step, aspect });
}

#[cfg(test)]
mod tests;
