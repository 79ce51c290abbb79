//! Ranges of every setting: an invalid configuration is refused before any process starts.

use super::{Config, ConfigError, EnvironmentConfig, INPUT_POOLS, KitchenSource, KitchensConfig, ValidationConfig};
use crate::episode::MAX_EPISODE_STEPS;
use crate::evaluation::{Distribution, EPISODES_OF_SET, EvaluationConfig, SEEDED_EPISODES_MOST};
use crate::kitchen::{KitchenId, Split};
use std::fmt::Display;
use std::ops::RangeInclusive;

const MAX_ENVIRONMENTS_PER_ACTOR: u32 = 256;
const MAX_ACTORS: u32 = 512;
const MAX_KITCHENS: u32 = 1_000_000;
const MAX_EVALUATED: u32 = 1000;

/// Stages of a run, and frames of a stage, at most: their sum fits into 63 bits, and a double holds each exactly.
const STAGES_MOST: usize = 1000;
const STAGE_FRAMES_MOST: u64 = 1_000_000_000_000_000;
/// Letters of a stage's name at most: it stands in every table.
const STAGE_NAME_MOST: usize = 64;

impl Config {
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_task()?;
        self.validate_environments()?;
        self.validate_learning()?;
        self.validate_processes()?;
        self.validate_evaluation()
    }

    fn validate_environments(&self) -> Result<(), ConfigError> {
        let Self { actors, simulation, episode, .. } = self;
        within("actors.count", actors.count, 1..=MAX_ACTORS, "must be 1 to 512")?;
        within(
            "actors.environments_per_actor",
            actors.environments_per_actor,
            1..=MAX_ENVIRONMENTS_PER_ACTOR,
            "must be 1 to 256",
        )?;
        within("simulation.timestep_s", simulation.timestep_s, 1e-4..=0.05, "must be 0.0001 to 0.05 seconds")?;
        within("simulation.substeps", simulation.substeps, 1..=100, "must be 1 to 100")?;
        within("episode.max_steps", episode.max_steps, 1..=MAX_EPISODE_STEPS as u32, "must be 1 to 100000")?;
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
        self.validate_environment()?;
        check("scenes", self.scenes.len(), self.scenes.len() <= KitchenId::SCENES_MAX, "must be at most 128 files")?;
        self.validate_kitchens()
    }

    /// Environments that are not built in are in no kitchen.
    fn validate_environment(&self) -> Result<(), ConfigError> {
        let Some(EnvironmentConfig { command, .. }) = &self.environment else { return Ok(()) };
        check("environment.command", "[]", !command.is_empty(), "must name a program")?;
        let built_in = self.kitchens.source == KitchenSource::BuiltIn;
        check("kitchens.source", "\"procedural\"", built_in, "cannot be set beside `environment`: it has no kitchens")?;
        let scenes = self.scenes.len();
        check("scenes", scenes, scenes == 0, "cannot be set beside `environment`: it has no kitchens")?;
        Ok(())
    }

    fn validate_kitchens(&self) -> Result<(), ConfigError> {
        let KitchensConfig { source, count, episodes_each, seed } = self.kitchens;
        within("kitchens.count", count, 1..=MAX_KITCHENS, "must be 1 to 1000000")?;
        within("kitchens.episodes_each", episodes_each, 1..=1_000_000, "must be 1 to 1000000 episodes")?;
        // TOML has no larger whole numbers.
        check("kitchens.seed", seed, i64::try_from(seed).is_ok(), "must be below 2^63")?;
        check(
            "kitchens.source",
            "\"procedural\"",
            source == KitchenSource::BuiltIn || self.scenes.is_empty(),
            "cannot be set beside `scenes`: a run trains in one or the other",
        )
    }

    fn validate_learning(&self) -> Result<(), ConfigError> {
        let Self { network, ppo, normalize, reward, auxiliary, .. } = self;
        check(
            "network.input_pool",
            network.input_pool,
            INPUT_POOLS.contains(&network.input_pool),
            "must be 1, 2 or 4",
        )?;
        let layers = || network.mlp.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
        let fits = (1..=8).contains(&network.mlp.len()) && network.mlp.iter().all(|width| (1..=4096).contains(width));
        check("network.mlp", format!("[{}]", layers()), fits, "must be 1 to 8 widths of 1 to 4096, such as [64, 64]")?;
        within("network.hidden", network.hidden, 8..=4096, "must be 8 to 4096")?;
        within("network.log_std", network.log_std, -10.0..=2.0, "must be -10 to 2")?;
        within("ppo.rollout_steps", ppo.rollout_steps, 1..=4096, "must be 1 to 4096")?;
        within("ppo.epochs", ppo.epochs, 1..=64, "must be 1 to 64")?;
        within("ppo.minibatches", ppo.minibatches, 1..=64, "must be 1 to 64")?;
        for (key, value) in [
            ("ppo.gamma", ppo.gamma),
            ("ppo.gae_lambda", ppo.gae_lambda),
            ("ppo.preemption_share", ppo.preemption_share),
        ] {
            within(key, value, 0.0..=1.0, "must be 0 to 1")?;
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
            ("ppo.adam_epsilon", ppo.adam_epsilon),
            ("ppo.max_gradient_norm", ppo.max_gradient_norm),
            ("normalize.observation_clip", normalize.observation_clip),
            ("normalize.reward_clip", normalize.reward_clip),
        ] {
            check(key, value, value.is_finite() && value > 0.0, "must be greater than 0")?;
        }
        for (key, value) in [
            ("ppo.value_coefficient", ppo.value_coefficient),
            ("ppo.entropy_coefficient", ppo.entropy_coefficient),
            ("ppo.entropy_coefficient_end", ppo.entropy_coefficient_end),
            ("ppo.clip_end", ppo.clip_end),
            ("ppo.learning_rate_end", ppo.learning_rate_end),
            ("ppo.target_kl", ppo.target_kl),
            ("auxiliary.weight", auxiliary.weight),
            ("auxiliary.focal_gamma", auxiliary.focal_gamma),
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
        let stages = self.stages.len();
        within("number of stages", stages, 1..=STAGES_MOST, "there must be 1 to 1000 stages")?;
        for stage in &self.stages {
            let length = stage.name.chars().count();
            check("stages.name", length, length <= STAGE_NAME_MOST, "a name has at most 64 letters")?;
            within(
                "stages.frames",
                stage.frames,
                1..=STAGE_FRAMES_MOST,
                "must be at least 1 and at most 1000000000000000",
            )?;
        }
        Ok(())
    }

    fn validate_processes(&self) -> Result<(), ConfigError> {
        let Self { learner, checkpoint, recording, .. } = self;
        let (deadline_s, interval_s) = (learner.actor_deadline_s, checkpoint.interval_s);
        let valid = deadline_s.is_finite() && deadline_s > 0.0;
        check("learner.actor_deadline_s", deadline_s, valid, "must be greater than 0")?;
        let progress_s = learner.progress_deadline_s;
        let valid = progress_s.is_finite() && progress_s >= 1.0;
        check("learner.progress_deadline_s", progress_s, valid, "must be 1 or greater")?;
        let valid = interval_s.is_finite() && interval_s >= 0.0;
        check("checkpoint.interval_s", interval_s, valid, "must be 0 or greater")?;
        within(
            "learner.count",
            learner.count,
            1..=self.actors.count,
            "must be 1 to actors.count: every learner has actors of its own",
        )?;
        check(
            "learner.count",
            learner.count,
            learner.count == 1 || self.evaluation.is_none(),
            "must be 1: an evaluation has one learner",
        )?;
        self.validate_shards()?;
        within("learner.threads", learner.threads, 1..=256, "must be 1 to 256")?;
        within("checkpoint.keep", checkpoint.keep, 1..=1000, "must be 1 to 1000")?;
        within("recording.depth_share", recording.depth_share, 0.0..=1.0, "must be 0 to 1")?;
        check(
            "recording.failures_only",
            recording.failures_only,
            !recording.failures_only || recording.depth_share == 0.0,
            "must be false unless recording.depth_share is 0: frames are not held back (`replay` draws them)",
        )?;
        check(
            "recording.segment_bytes",
            recording.segment_bytes,
            recording.segment_bytes >= 1 << 20,
            "must be at least 1048576",
        )?;
        let ValidationConfig { episodes, actors, .. } = self.validation;
        if self.environment.is_some() {
            let few = episodes <= SEEDED_EPISODES_MOST;
            check("validation.episodes", episodes, few, "must be at most 100000")?;
            return within("validation.actors", actors, 1..=512, "must be 1 to 512");
        }
        check(
            "validation.episodes",
            episodes,
            episodes <= EPISODES_OF_SET,
            "must be at most 360: a kitchen has as many episodes of each object set",
        )?;
        check(
            "validation.actors",
            actors,
            (5..=512).contains(&actors) && actors.is_multiple_of(5),
            "must be a multiple of 5, at most 512: each of the five validation kitchens has as many",
        )
    }

    fn validate_shards(&self) -> Result<(), ConfigError> {
        let (shards, learners) = (self.learner.shards, self.learner.count);
        if shards == 0 {
            return Ok(());
        }
        check(
            "learner.shards",
            shards,
            shards.is_power_of_two() && shards <= self.actors.count,
            "must be 0, or a power of two up to actors.count: every shard has actors of its own",
        )?;
        check(
            "learner.count",
            learners,
            learners.is_power_of_two() && learners <= shards,
            "must be a power of two up to learner.shards: every learner has as many shards as the others. Choose such a \
             number, or learner.shards = 0",
        )?;
        check(
            "ppo.preemption_share",
            self.ppo.preemption_share,
            self.ppo.preemption_share == 0.0,
            "must be 0 where learner.shards is not: a rollout that ends early depends on timing and on the number of \
             learners",
        )?;
        check(
            "learner.deterministic",
            self.learner.deterministic,
            self.learner.deterministic,
            "must be true where learner.shards is not 0: weights that are the same whatever the number of learners",
        )?;
        check("learner.shards", shards, self.evaluation.is_none(), "must be 0: an evaluation does not train")
    }

    /// Settings of an evaluation. It simulates scenes or the built-in kitchens of a split.
    fn validate_evaluation(&self) -> Result<(), ConfigError> {
        let Some(asked) = &self.evaluation else { return Ok(()) };
        let EvaluationConfig { split, procedural, kitchen, distribution, scene_targets, steps_per_s, .. } = asked;
        if let Some(steps) = steps_per_s {
            check("evaluation.steps_per_s", steps, (1..=1000).contains(steps), "must be 1 to 1000")?;
        }
        let (elsewhere, seeds) = (self.environment.is_some(), *distribution == Distribution::Seeds);
        check(
            "evaluation.distribution",
            serde_json::json!(distribution),
            elsewhere == seeds,
            "must be \"seeds\" beside `environment`, and only there",
        )?;
        if seeds {
            let (episodes, split) = (asked.episodes, serde_json::json!(split));
            check("evaluation.episodes", episodes, episodes <= SEEDED_EPISODES_MOST, "must be at most 100000")?;
            return check("evaluation.split", split, asked.split != Split::Train, "must be \"test\" or \"validation\"");
        }
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
        if let Some(kitchen) = kitchen {
            let valid = scenes == 0 && procedural.is_none() && kitchen.is_built_in() && kitchen.split() == *split;
            check("evaluation.kitchen", kitchen, valid, "must be a kitchen of the split, without others beside it")?;
        }
        if let Some(range) = procedural {
            let valid = scenes == 0 && *split == Split::Train;
            check("evaluation.procedural", range, valid, "must stand beside split = \"train\", without scenes")?;
            let few = range.count() <= MAX_EVALUATED;
            return check("evaluation.procedural", range, few, "must be at most 1000 kitchens");
        }
        let (count, kitchens) = (self.actors.count, self.kitchens().count() as u32);
        check("actors.count", count, count >= kitchens, "an evaluation needs an actor for each of its kitchens")
    }
}

fn within<T: PartialOrd + Display + Copy>(
    key: &'static str,
    value: T,
    range: RangeInclusive<T>,
    problem: &'static str,
) -> Result<(), ConfigError> {
    check(key, value, range.contains(&value), problem)
}

pub(super) fn check(
    key: &'static str,
    value: impl Display,
    valid: bool,
    problem: &'static str,
) -> Result<(), ConfigError> {
    if valid {
        return Ok(());
    }
    Err(ConfigError::OutOfRange { place: "configuration".to_owned(), key, value: value.to_string(), problem })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::ObjectSet;
    use crate::kitchen::{KitchenId, TargetCategory};

    /// A line of a configuration with another value, or another key.
    fn broken(lines: &[String], changes: &[(proptest::sample::Index, String)]) -> String {
        let mut lines = lines.to_vec();
        for (place, value) in changes {
            let place = place.index(lines.len());
            let line = &mut lines[place];
            *line = match line.split_once('=') {
                Some((key, _)) => format!("{key}= {value}"),
                None => value.clone(),
            };
        }
        lines.join("\n")
    }

    proptest::proptest! {
        #![proptest_config(proptest::prelude::ProptestConfig::with_cases(2000))]

        /// Whatever stands in a file: a configuration that can be used, or one error.
        #[test]
        fn any_text_is_a_configuration_or_an_error(
            changes in proptest::collection::vec(
                (
                    proptest::prelude::any::<proptest::sample::Index>(),
                    "-?[0-9]{1,20}|[0-9]e[0-9]{1,3}|nan|inf|-inf|\\[\\]|\\{\\}|\"[a-z]{0,4}\"|true|\\[[a-z]{1,5}\\]",
                ),
                1..4,
            ),
        ) {
            let whole = Config::resolve("demo", None).unwrap().to_toml();
            let lines: Vec<String> = whole.lines().map(str::to_owned).collect();
            let text = broken(&lines, &changes);
            for found in [Config::from_toml(&text, "a"), Config::resolve_with("demo", Some((&text, "a")))] {
                match found {
                    Ok(config) => {
                        let again = Config::from_toml(&config.to_toml(), "b").unwrap();
                        proptest::prop_assert_eq!(&again, &config);
                        proptest::prop_assert!(crate::stage::total_frames(&config.stages) > 0);
                        proptest::prop_assert!(crate::stage::position_at(&config.stages, u64::MAX).is_none());
                    }
                    Err(error) => proptest::prop_assert!(!error.to_string().is_empty()),
                }
            }
        }
    }

    #[test]
    fn the_frames_of_all_stages_can_be_added_up() {
        let with = |frames: &[u64]| {
            let stages: Vec<String> = frames
                .iter()
                .map(|frames| format!("[[stages]]\nname = \"a\"\nreward = \"r\"\nframes = {frames}\n"))
                .collect();
            Config::from_toml(&stages.concat(), "config.toml").map(|config| crate::stage::total_frames(&config.stages))
        };
        assert_eq!(with(&[1_000_000_000_000_000; 1000]).unwrap(), 1_000_000_000_000_000_000);
        // Each is a number, their sum is none.
        let message = with(&[i64::MAX as u64; 3]).unwrap_err().to_string();
        assert!(message.contains("stages.frames") && message.contains("at most 1000000000000000"), "{message}");
        assert!(with(&[1; 1001]).unwrap_err().to_string().contains("1 to 1000 stages"));
    }

    #[test]
    fn shards_and_learners_are_powers_of_two_that_divide_the_actors() {
        let problem = |actors, learners, shards, change: &dyn Fn(&mut Config)| {
            let mut config = Config::default();
            config.actors.count = actors;
            (config.learner.count, config.learner.shards) = (learners, shards);
            change(&mut config);
            config.validate().map(|()| config.shares().shards()).map_err(|error| error.to_string())
        };
        let as_it_is = |_: &mut Config| ();
        assert_eq!(problem(5, 3, 0, &as_it_is), Ok(3), "without shards any number of learners goes");
        for (actors, learners) in [(4, 1), (5, 2), (19, 4)] {
            assert_eq!(problem(actors, learners, 4, &as_it_is), Ok(4));
        }
        for (actors, learners, shards, expected) in [
            (4, 1, 3, "learner.shards = 3: must be 0, or a power of two up to actors.count"),
            (3, 1, 4, "learner.shards = 4"),
            (12, 3, 4, "learner.count = 3: must be a power of two up to learner.shards"),
            (12, 8, 4, "learner.count = 8"),
        ] {
            let found = problem(actors, learners, shards, &as_it_is).unwrap_err();
            assert!(found.contains(expected), "{found}");
        }
        let found = problem(4, 2, 4, &|config| config.learner.deterministic = false).unwrap_err();
        assert!(found.contains("learner.deterministic = false: must be true where learner.shards is not 0"), "{found}");
        let found = problem(4, 2, 4, &|config| config.ppo.preemption_share = 0.6).unwrap_err();
        assert!(found.contains("ppo.preemption_share = 0.6: must be 0 where learner.shards is not"), "{found}");
        let both = |config: &mut Config| (config.ppo.overlap, config.ppo.preemption_share) = (true, 0.6);
        let found = problem(4, 2, 0, &both).unwrap_err();
        assert!(found.contains("ppo.overlap = true: must be false where ppo.preemption_share is above 0"), "{found}");
    }

    #[test]
    fn an_evaluation_for_somebody_who_watches_is_in_one_kitchen_of_its_split() {
        let problem = |split, kitchen: u32, steps_per_s| {
            let mut config = Config::default();
            config.actors.count = 1;
            config.evaluation = Some(EvaluationConfig {
                kitchen: KitchenId::new(kitchen).ok(),
                steps_per_s: Some(steps_per_s),
                ..EvaluationConfig::fixed(split, ObjectSet::All, 0)
            });
            let read = Config::from_toml(&config.to_toml(), "an evaluation");
            read.map(|read| assert_eq!(read, config)).map_err(|error| error.to_string())
        };
        assert_eq!(problem(Split::Test, 8, 5), Ok(()));
        for wrong in [7, 1000, 128] {
            assert!(problem(Split::Test, wrong, 5).unwrap_err().contains("evaluation.kitchen"), "{wrong}");
        }
        assert!(problem(Split::Test, 8, 0).unwrap_err().contains("evaluation.steps_per_s"));
    }

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
    fn kitchens_without_end_have_bounds_and_no_scenes_beside_them() {
        let problem = |change: &dyn Fn(&mut Config)| {
            let mut config = Config::default();
            config.kitchens.source = KitchenSource::Procedural;
            change(&mut config);
            config.validate().map_err(|error| error.to_string())
        };
        assert_eq!(problem(&|_| ()), Ok(()));
        for (change, expected) in [
            (&(|config: &mut Config| config.kitchens.count = 0) as &dyn Fn(&mut Config), "kitchens.count = 0"),
            (&|config| config.kitchens.count = 1_000_001, "kitchens.count = 1000001"),
            (&|config| config.kitchens.episodes_each = 0, "kitchens.episodes_each = 0"),
            (&|config| config.kitchens.seed = u64::MAX, "kitchens.seed"),
            (&|config| config.scenes = vec!["a.toml".into()], "beside `scenes`"),
        ] {
            let found = problem(change).unwrap_err();
            assert!(found.contains(expected), "{found}");
        }
        let evaluated = |range: &str, split| {
            problem(&|config| {
                let asked = EvaluationConfig::fixed(split, ObjectSet::Novel, 1);
                let procedural = Some(range.parse().unwrap());
                config.evaluation = Some(EvaluationConfig { procedural, distribution: Distribution::Run, ..asked });
                config.actors.count = 1;
            })
        };
        assert_eq!(evaluated("5000..5100", Split::Train), Ok(()));
        assert!(evaluated("5000..5100", Split::Test).unwrap_err().contains("split = \"train\""));
        assert!(evaluated("5000..6001", Split::Train).unwrap_err().contains("at most 1000 kitchens"));
    }

    #[test]
    fn an_evaluation_of_an_older_version_is_of_fixed_episodes() {
        let text = "split = \"test\"\nobjects = \"novel\"\nepisodes = 0\ndeterministic = false\n";
        let older = Config::from_toml(&format!("actors.count = 5\n[evaluation]\n{text}"), "config.toml").unwrap();
        assert_eq!(older.evaluation.unwrap().distribution, Distribution::Fixed);
    }
}
