//! Ranges of every setting: an invalid configuration is refused before any process starts.

use super::{Config, ConfigError, INPUT_POOLS, ValidationConfig};
use crate::episode::MAX_EPISODE_STEPS;
use crate::evaluation::{Distribution, EvaluationConfig};
use crate::kitchen::{KitchenId, Split};
use std::fmt::Display;

/// Environments of one actor at most.
const MAX_ENVIRONMENTS_PER_ACTOR: u32 = 256;

/// Actor processes of one machine at most.
const MAX_ACTORS: u32 = 512;

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_environments()?;
        self.validate_learning()?;
        self.validate_processes()?;
        self.validate_evaluation()
    }

    /// Settings of the simulation.
    fn validate_environments(&self) -> Result<(), ConfigError> {
        let Self { actors, simulation, episode, .. } = self;
        check("actors.count", actors.count, (1..=MAX_ACTORS).contains(&actors.count), "must be 1 to 512")?;
        check(
            "actors.environments_per_actor",
            actors.environments_per_actor,
            (1..=MAX_ENVIRONMENTS_PER_ACTOR).contains(&actors.environments_per_actor),
            "must be 1 to 256",
        )?;
        check(
            "simulation.timestep_s",
            simulation.timestep_s,
            (1e-4..=0.05).contains(&simulation.timestep_s),
            "must be 0.0001 to 0.05 seconds",
        )?;
        check(
            "simulation.substeps",
            simulation.substeps,
            (1..=100).contains(&simulation.substeps),
            "must be 1 to 100",
        )?;
        check(
            "episode.max_steps",
            episode.max_steps,
            (1..=MAX_EPISODE_STEPS as u32).contains(&episode.max_steps),
            "must be 1 to 512",
        )?;
        for (key, value) in [
            ("episode.start_distance_max_m", episode.start_distance_max_m),
            ("episode.goal_distance_max_m", episode.goal_distance_max_m),
        ] {
            check(
                key,
                value,
                value == 0.0 || (0.6..=100.0).contains(&value),
                "must be 0 (anywhere) or 0.6 to 100 metres",
            )?;
        }
        check("scenes", self.scenes.len(), self.scenes.len() <= KitchenId::SCENES_MAX, "a run has at most 128 scenes")
    }

    /// Network, algorithm, curriculum.
    fn validate_learning(&self) -> Result<(), ConfigError> {
        let Self { network, ppo, reward, auxiliary, .. } = self;
        check(
            "network.input_pool",
            network.input_pool,
            INPUT_POOLS.contains(&network.input_pool),
            "must be 1, 2 or 4",
        )?;
        check("network.hidden", network.hidden, (8..=4096).contains(&network.hidden), "must be 8 to 4096")?;
        check("ppo.rollout_steps", ppo.rollout_steps, (1..=4096).contains(&ppo.rollout_steps), "must be 1 to 4096")?;
        check("ppo.epochs", ppo.epochs, (1..=64).contains(&ppo.epochs), "must be 1 to 64")?;
        for (key, value) in [
            ("ppo.gamma", ppo.gamma),
            ("ppo.gae_lambda", ppo.gae_lambda),
            ("ppo.preemption_share", ppo.preemption_share),
        ] {
            check(key, value, (0.0..=1.0).contains(&value), "must be 0 to 1")?;
        }
        check(
            "ppo.overlap",
            ppo.overlap,
            !ppo.overlap || ppo.preemption_share == 0.0,
            "must be false where ppo.preemption_share is above 0: learners cannot watch for stragglers while they update",
        )?;
        for (key, value) in [
            ("ppo.clip", ppo.clip),
            ("ppo.learning_rate", ppo.learning_rate),
            ("ppo.max_gradient_norm", ppo.max_gradient_norm),
        ] {
            check(key, value, value.is_finite() && value > 0.0, "must be greater than 0")?;
        }
        for (key, value) in [
            ("ppo.value_coefficient", ppo.value_coefficient),
            ("ppo.entropy_coefficient", ppo.entropy_coefficient),
            ("ppo.learning_rate_end", ppo.learning_rate_end),
            ("auxiliary.weight", auxiliary.weight),
            ("auxiliary.focal_gamma", auxiliary.focal_gamma),
            ("reward.lambda_disturb", f64::from(reward.lambda_disturb)),
            ("reward.lagrangian.initial", reward.lagrangian.initial),
            ("reward.lagrangian.learning_rate", reward.lagrangian.learning_rate),
        ] {
            check(key, value, value.is_finite() && value >= 0.0, "must be 0 or greater")?;
        }
        check(
            "auxiliary.subsample",
            auxiliary.subsample,
            auxiliary.subsample > 0.0 && auxiliary.subsample <= 1.0,
            "must be above 0 and at most 1",
        )?;
        check("stages", self.stages.len(), !self.stages.is_empty(), "there must be at least one stage")?;
        for stage in &self.stages {
            check("stages.frames", stage.frames, stage.frames > 0, "every stage needs at least one frame")?;
        }
        Ok(())
    }

    /// Settings of the processes.
    fn validate_processes(&self) -> Result<(), ConfigError> {
        let Self { learner, checkpoint, recording, .. } = self;
        let (deadline_s, interval_s) = (learner.actor_deadline_s, checkpoint.interval_s);
        let valid = deadline_s.is_finite() && deadline_s > 0.0;
        check("learner.actor_deadline_s", deadline_s, valid, "must be greater than 0")?;
        let valid = interval_s.is_finite() && interval_s >= 0.0;
        check("checkpoint.interval_s", interval_s, valid, "must be 0 or greater")?;
        check(
            "learner.count",
            learner.count,
            (1..=self.actors.count).contains(&learner.count),
            "must be 1 to actors.count: every learner has actors of its own",
        )?;
        check(
            "learner.count",
            learner.count,
            learner.count == 1 || self.evaluation.is_none(),
            "must be 1: an evaluation has one learner",
        )?;
        check("learner.threads", learner.threads, (1..=256).contains(&learner.threads), "must be 1 to 256")?;
        check("checkpoint.keep", checkpoint.keep, (1..=1000).contains(&checkpoint.keep), "must be 1 to 1000")?;
        check(
            "recording.depth_share",
            recording.depth_share,
            (0.0..=1.0).contains(&recording.depth_share),
            "must be 0 to 1",
        )?;
        check(
            "recording.failures_only",
            recording.failures_only,
            !recording.failures_only || recording.depth_share == 0.0,
            "needs recording.depth_share = 0: frames are not held back (`orchestrator replay` draws them)",
        )?;
        check(
            "recording.segment_bytes",
            recording.segment_bytes,
            recording.segment_bytes >= 1 << 20,
            "must be at least 1048576",
        )?;
        let ValidationConfig { episodes, actors, .. } = self.validation;
        check("validation.episodes", episodes, episodes <= 360, "a kitchen has 360 episodes of each object set")?;
        check(
            "validation.actors",
            actors,
            (5..=512).contains(&actors) && actors.is_multiple_of(5),
            "must be a multiple of the five validation kitchens, at most 512",
        )
    }

    /// Settings of an evaluation. It simulates scenes or the built-in kitchens of a split.
    fn validate_evaluation(&self) -> Result<(), ConfigError> {
        let Some(EvaluationConfig { split, distribution, scene_targets, .. }) = &self.evaluation else { return Ok(()) };
        let (scenes, lists) = (self.scenes.len(), scene_targets.len());
        check("evaluation.scene_targets", lists, lists == scenes, "must be one list of targets for each of `scenes`")?;
        let valid = scenes == 0 || *split == Split::Train;
        check(
            "evaluation.split",
            format!("{split:?}").to_lowercase(),
            valid,
            "must be \"train\": scenes are of no split",
        )?;
        check(
            "evaluation.distribution",
            "\"fixed\"",
            *distribution == Distribution::Run || *split != Split::Train,
            "must be \"run\": only validation and test kitchens have fixed episodes",
        )?;
        let (count, kitchens) = (self.actors.count, self.kitchens().count() as u32);
        check("actors.count", count, count >= kitchens, "an evaluation needs an actor for each of its kitchens")
    }
}

fn check(key: &'static str, value: impl Display, valid: bool, problem: &'static str) -> Result<(), ConfigError> {
    if valid { Ok(()) } else { Err(ConfigError::OutOfRange { key, value: value.to_string(), problem }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::ObjectSet;
    use crate::kitchen::TargetCategory;

    #[test]
    fn an_evaluation_has_episodes_and_an_actor_for_every_kitchen() {
        let problem = |split, distribution, actors, scenes: usize| {
            let mut config = Config::default();
            config.actors.count = actors;
            config.scenes = vec!["scenes/000/scene.toml".to_owned(); scenes];
            config.evaluation = Some(EvaluationConfig {
                distribution,
                scene_targets: vec![TargetCategory::SEEN.to_vec(); scenes],
                ..EvaluationConfig::fixed(split, ObjectSet::Novel, 1)
            });
            let read = Config::from_toml(&config.to_toml(), "an evaluation");
            read.map(|read| assert_eq!(read, config)).map_err(|error| error.to_string())
        };
        for distribution in [Distribution::Fixed, Distribution::Run] {
            for split in [Split::Validation, Split::Test] {
                assert_eq!(problem(split, distribution, 5, 0), Ok(()));
                assert_eq!(problem(split, distribution, 7, 0), Ok(()));
                assert!(problem(split, distribution, 4, 0).unwrap_err().contains("actors.count = 4"));
            }
        }
        assert_eq!(problem(Split::Train, Distribution::Run, 19, 0), Ok(()));
        assert!(problem(Split::Train, Distribution::Run, 18, 0).unwrap_err().contains("actors.count = 18"));
        for scenes in [0, 2] {
            let fixed = problem(Split::Train, Distribution::Fixed, 19, scenes).unwrap_err();
            assert!(fixed.contains("evaluation.distribution = \"fixed\""), "{fixed}");
        }
        assert_eq!(problem(Split::Train, Distribution::Run, 2, 2), Ok(()));
        assert!(problem(Split::Train, Distribution::Run, 1, 2).unwrap_err().contains("actors.count = 1"));
        assert!(problem(Split::Test, Distribution::Run, 5, 2).unwrap_err().contains("evaluation.split = test"));
    }

    #[test]
    fn an_evaluation_of_an_older_version_is_of_fixed_episodes() {
        let text = "split = \"test\"\nobjects = \"novel\"\nepisodes = 0\ndeterministic = false\n";
        let older = Config::from_toml(&format!("actors.count = 5\n[evaluation]\n{text}"), "config.toml").unwrap();
        assert_eq!(older.evaluation.unwrap().distribution, Distribution::Fixed);
    }
}
