//! The task of a run, and the rewards that its stages name.

use super::validate::check;
use super::{AuxiliaryTask, Config, ConfigError, EnvironmentConfig, GoalCoordinates};
use crate::likeness::among;
use crate::run_folder::RunFolder;
use crate::task::{ActionHead, Composition, Condition, MULTIPLIER, NEGATIVE_MULTIPLIER, Spec, SpecError};

impl Config {
    /// The task's declaration. Panics if the configuration was not validated.
    pub fn spec(&self) -> &'static Spec {
        self.find_spec().expect("a validated configuration names a task that there is")
    }

    /// Refuses to go on with a run whose task was declared otherwise.
    pub fn check_task(&self, run: &RunFolder) -> Result<(), ConfigError> {
        let path = run.task();
        let text = match run.read_text(&path) {
            Ok(text) => text,
            // A run of an older version.
            Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return Ok(()),
            Err(cause) => return Err(ConfigError::Unreadable { path, cause }),
        };
        if self.spec().continues(&text) {
            return Ok(());
        }
        Err(ConfigError::OtherTask { path, name: self.task.clone() })
    }

    /// Declares the task of a run, if it is not known: the declaration lies in the run's folder.
    pub(super) fn declare_task_of(&self, run: &RunFolder) -> Result<(), ConfigError> {
        if self.environment.is_some() || Spec::named(&self.task).is_some() {
            return Ok(());
        }
        // A folder without one is of a task that was built in once.
        let Ok(text) = run.read_text(&run.task()) else { return Ok(()) };
        let wrong = |cause| ConfigError::Task { key: run.task().display().to_string(), cause };
        Spec::declare(&text).map(drop).map_err(wrong)
    }

    /// The same of a configuration that was not validated.
    pub fn find_spec(&self) -> Result<&'static Spec, ConfigError> {
        if let Some(EnvironmentConfig { declaration, .. }) = &self.environment {
            let wrong = |cause| ConfigError::Task { key: "environment.declaration".to_owned(), cause };
            let spec = Spec::kept(declaration).map_err(wrong)?;
            check("task", &self.task, self.task == spec.name, "must be the name in environment.declaration")?;
            return Ok(spec);
        }
        Spec::named(&self.task).ok_or_else(|| ConfigError::UnknownTask {
            name: self.task.clone(),
            known: among(&self.task, "tasks", Spec::built_in().iter().map(|task| task.name.as_str())),
        })
    }

    /// A reward of the task's or of this configuration's, resolved. Panics if there is none of this name: stages of a
    /// validated configuration name rewards that there are.
    pub fn reward(&self, name: &str) -> Composition {
        self.find_reward(name).expect("a validated configuration names rewards that there are")
    }

    /// How the policy chooses an action. Panics as [`Self::policy_actions`] does.
    pub fn action_head(&self) -> ActionHead {
        let head = ActionHead::of(self.episode.action_space, &self.spec().actions);
        head.expect("a validated configuration names a subset that there is")
    }

    /// The actions that the policy chooses from, in the order of its head; none where they have no names. Panics if the
    /// configuration was not validated.
    pub fn policy_actions(&self) -> Vec<u8> {
        let actions = self.episode.action_space.of(&self.spec().actions);
        actions.expect("a validated configuration names a subset that there is")
    }

    /// The same, of any name.
    fn find_reward(&self, name: &str) -> Result<Composition, SpecError> {
        self.spec().composition(name, &self.rewards, &self.reward.weights)
    }

    /// This configuration's own rewards, but those that training weighs as it goes.
    pub fn own_rewards(&self) -> Result<Vec<(String, Composition)>, SpecError> {
        let named = self.rewards.iter().map(|reward| Ok((reward.name.clone(), self.find_reward(&reward.name)?)));
        let mut rewards = named.collect::<Result<Vec<_>, SpecError>>()?;
        rewards.retain(|(_, composition)| !composition.has_multiplier());
        Ok(rewards)
    }

    /// What the auxiliary task predicts.
    pub fn label(&self) -> Option<Condition> {
        self.spec().label()
    }

    /// Writes down the weights that the task gives and that nobody has set.
    pub(super) fn complete_weights(&mut self) {
        // An unknown task is refused when the configuration is validated.
        let Ok(spec) = self.find_spec() else { return };
        for (name, weight) in &spec.weights {
            self.reward.weights.entry(name.clone()).or_insert(*weight);
        }
    }

    /// The task is there, and has what the configuration names.
    pub(super) fn validate_task(&self) -> Result<(), ConfigError> {
        let spec = self.find_spec()?;
        let wrong = |key: &str, cause: SpecError| ConfigError::Task { key: key.to_owned(), cause };
        for (name, &weight) in &self.reward.weights {
            check(
                "reward",
                format!("{{ {name} = {weight} }}"),
                weight.is_finite() && weight >= 0.0,
                "must be 0 or greater",
            )?;
            if !spec.weights.contains_key(name) {
                let names: Vec<_> = spec.weights.keys().cloned().collect();
                let problem = format!("task `{}` has no such weight; it has: {}", spec.name, names.join(", "));
                return Err(wrong(&format!("reward.{name}"), SpecError::Reward { name: name.clone(), problem }));
            }
        }
        let inputs = spec.inputs().map_err(|cause| wrong("task", cause))?;
        check(
            "network.goal",
            serde_json::json!(self.network.goal),
            self.network.goal == GoalCoordinates::Plain || inputs.frame.is_some() && inputs.are_coordinates(),
            "must be \"plain\" in this task: three numbers beside a frame, a vector in space, must come first",
        )?;
        check(
            "auxiliary.task",
            serde_json::json!(self.auxiliary.task),
            self.auxiliary.task == AuxiliaryTask::None || inputs.frame.is_some() && !spec.actions.names().is_empty(),
            "must be \"none\" in a task without a frame, or whose actions have no names",
        )?;
        let is_named = !spec.actions.names().is_empty();
        check(
            "network.previous_action",
            self.network.previous_action,
            is_named || !self.network.previous_action,
            "must be false in this task: only actions with names have an embedding",
        )?;
        if self.episode.action_space.of(&spec.actions).is_none() {
            let problem = format!("task `{}` has no subset `{}`", spec.name, self.episode.action_space);
            return Err(wrong("episode.action_space", SpecError::Actions { problem }));
        }
        spec.check_rewards(&self.rewards).map_err(|cause| wrong("rewards", cause))?;
        for reward in &self.rewards {
            self.find_reward(&reward.name).map_err(|cause| wrong("rewards", cause))?;
        }
        for stage in &self.stages {
            let composition = self.find_reward(&stage.reward).map_err(|cause| wrong("stages.reward", cause))?;
            let problem = match spec.cost() {
                None if composition.has_multiplier() => {
                    format!("it has PPO-Lagrangian's multiplier, but task `{}` names no cost", spec.name)
                }
                Some(cost) if composition.pays_cost(cost) => {
                    let weight = if cost.1 > 0.0 { NEGATIVE_MULTIPLIER } else { MULTIPLIER };
                    format!("PPO-Lagrangian's multiplier would pay for the cost: the part's weight is \"{weight}\"")
                }
                _ => continue,
            };
            let cause = SpecError::Reward { name: stage.reward.clone(), problem };
            return Err(wrong("stages.reward", cause));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Setting, Shuffle};
    use super::*;
    use std::collections::BTreeMap;

    fn config(text: &str) -> Result<Config, String> {
        Config::resolve_with("demo", Some((text, "mine.toml"))).map_err(|error| error.to_string())
    }

    const WITHOUT_A_FRAME: &str = r#"
    name = "without_a_frame"
    actions = { kind = "discrete", names = ["left", "right"] }
    channels = [
        { name = "gain", role = "part", dtype = "f32", range = [0, 1], doc = "" },
        { name = "place", role = "observation", dtype = "f32", shape = [3], range = [-1, 1], doc = "" },
    ]
    rewards = [{ name = "r", terms = [["gain", 1.0]] }]
    "#;

    #[test]
    fn settings_that_a_task_without_a_frame_cannot_have_are_refused() {
        Spec::declare(WITHOUT_A_FRAME).unwrap();
        assert!(Spec::declare(WITHOUT_A_FRAME).is_ok(), "the same again");
        let other = Spec::declare(&WITHOUT_A_FRAME.replace("[3]", "[4]")).unwrap_err().to_string();
        assert_eq!(other, "task `without_a_frame` is known already, and declared otherwise");
        let problem = |text: &str| {
            let text = format!("task = \"without_a_frame\"\n{text}");
            Config::resolve_with("gym", Some((&text, "mine.toml"))).map(drop).map_err(|error| error.to_string())
        };
        assert_eq!(problem(""), Ok(()));
        assert_eq!(problem("network.memory = \"gru\"\nepisode.max_steps = 100000"), Ok(()));
        let shuffle = |setting: &str| {
            let text = format!("task = \"without_a_frame\"\n{setting}");
            Config::resolve_with("gym", Some((&text, "mine.toml"))).unwrap().shuffle()
        };
        let of = ["network.memory = \"none\"", "network.memory = \"gru\"", "ppo.minibatches = 1"].map(shuffle);
        assert_eq!(of, [Shuffle::Rows, Shuffle::Environments, Shuffle::Environments]);
        for (text, expected) in [
            ("network.goal = \"polar\"", "network.goal = \"polar\": must be \"plain\" in this task"),
            ("auxiliary.task = \"disturb\"", "auxiliary.task = \"disturb\": must be \"none\""),
            ("network.mlp = []", "network.mlp = []: must be 1 to 8 widths of 1 to 4096"),
            ("network.mlp = [64, 0]", "network.mlp = [64, 0]"),
            ("ppo.adam_epsilon = 0.0", "ppo.adam_epsilon = 0: must be greater than 0"),
            ("normalize.reward_clip = 0.0", "normalize.reward_clip = 0: must be greater than 0"),
            ("ppo.entropy_coefficient_end = -1.0", "ppo.entropy_coefficient_end = -1: must be 0 or greater"),
            ("ppo.target_kl = -1.0", "ppo.target_kl = -1: must be 0 or greater"),
            ("ppo.clip_end = -1.0", "ppo.clip_end = -1: must be 0 or greater"),
            ("network.log_std = 3.0", "network.log_std = 3: must be -10 to 2"),
            ("episode.max_steps = 100001", "episode.max_steps = 100001: must be 1 to 100000"),
        ] {
            let found = problem(text).unwrap_err();
            assert!(found.contains(expected), "{found}");
        }
        let numbers = WITHOUT_A_FRAME.replace("without_a_frame", "of_numbers");
        let discrete = "{ kind = \"discrete\", names = [\"left\", \"right\"] }";
        Spec::declare(&numbers.replace(discrete, "{ kind = \"box\", bounds = [[-1, 1]] }")).unwrap();
        let with = |text: &str| {
            let text = format!("task = \"of_numbers\"\n{text}");
            Config::resolve_with("gym", Some((&text, "mine.toml"))).map_err(|error| error.to_string())
        };
        let config = with("").unwrap();
        assert_eq!((config.action_head().outputs(), config.policy_actions()), (1, vec![]));
        let found = with("network.previous_action = true").unwrap_err();
        assert!(found.contains("network.previous_action = true: must be false in this task"), "{found}");
        let found = with("episode.action_space = \"small\"").unwrap_err();
        assert!(found.contains("task `of_numbers` has no subset `small`"), "{found}");
    }

    /// The other sign trained a policy to cost as much as it could, and nothing said so.
    #[test]
    fn a_multiplier_that_would_pay_for_the_cost_is_refused() {
        for (cost, weight, expected) in [
            (1.0, "-multiplier", None),
            (-1.0, "multiplier", None),
            (1.0, "multiplier", Some("the part's weight is \"-multiplier\"")),
            (-1.0, "-multiplier", Some("the part's weight is \"multiplier\"")),
        ] {
            let name = format!("costs_{}_{}", cost > 0.0, weight.len());
            let constrained = format!("[\"gain\", 1.0]] }}, {{ name = \"c\", terms = [[\"gain\", \"{weight}\"]]");
            let text = WITHOUT_A_FRAME.replace("without_a_frame", &name).replace("[\"gain\", 1.0]]", &constrained);
            Spec::declare(&format!("{text}\ncost = {{ part = \"gain\", weight = {cost:.1} }}")).unwrap();
            let stage = format!("task = \"{name}\"\nstages = [{{ name = \"I\", reward = \"c\", frames = 9 }}]");
            let found = Config::resolve_with("gym", Some((&stage, "mine.toml"))).map_err(|error| error.to_string());
            match expected {
                None => {
                    let config = found.unwrap();
                    let reward = config.find_reward("c").unwrap().of(|_| 0.5, 3.0);
                    assert_eq!(f64::from(reward), -1.5 * cost, "it falls as the cost rises");
                }
                Some(expected) => assert!(found.unwrap_err().contains(expected), "{name}"),
            }
        }
    }

    #[test]
    fn images_that_no_encoder_can_see_are_refused() {
        let place = WITHOUT_A_FRAME.lines().find(|line| line.contains("\"place\"")).unwrap();
        let with = |name: &str, shape: &str| {
            let image =
                format!(r#"{{ name = "screen", role = "observation", dtype = "u8", shape = {shape}, doc = "" }},"#);
            let declaration = WITHOUT_A_FRAME.replace("without_a_frame", name).replace(place, &image);
            Spec::declare(&declaration).unwrap();
            let text = format!("task = \"{name}\"\n");
            Config::resolve_with("gym", Some((&text, "mine.toml"))).map_err(|error| error.to_string())
        };
        assert_eq!(with("of_images", "[84, 84, 4]").unwrap().spec().inputs().unwrap().images.len(), 1);
        for (name, shape, expected) in [
            ("of_small_images", "[84, 35]", "cannot take its image `screen` of the shape [84, 35]: an image has 36 to"),
            ("of_many_channels", "[84, 84, 13]", "cannot take its image `screen` of the shape [84, 84, 13]"),
        ] {
            let found = with(name, shape).unwrap_err();
            assert!(found.contains(expected) && found.lines().count() == 1, "{found}");
        }
    }

    #[test]
    fn a_run_brings_the_declaration_of_its_task() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::new(folder.path());
        let declaration = WITHOUT_A_FRAME.replace("without_a_frame", "of_a_run");
        std::fs::write(
            run.config(),
            "task = \"of_a_run\"\nauxiliary.task = \"none\"\nnetwork.goal = \"plain\"\n\
            network.carried_goal = \"goal_to_object\"\nstages = [{ name = \"I\", reward = \"r\", frames = 9 }]\n",
        )
        .unwrap();
        let unknown = Config::of_run(&run).unwrap_err().to_string();
        assert!(unknown.contains("there is no task `of_a_run`"), "{unknown}");
        std::fs::write(run.task(), "name = 3").unwrap();
        assert!(Config::of_run(&run).unwrap_err().to_string().contains("task.toml: it is no task"));
        std::fs::write(run.task(), declaration).unwrap();
        let config = Config::of_run(&run).unwrap();
        assert_eq!(config.spec().name, "of_a_run");
        assert!(config.check_task(&run).is_ok());
    }

    /// The example of docs/own-parts.md: a reward in the configuration, no code.
    #[test]
    fn a_reward_by_count_takes_its_price_once_whatever_the_distance() {
        let text = r#"
        # ANCHOR: count
        stages = [{ name = "I", reward = "r_count", frames = 260_000 }]
        [[rewards]]
        name = "r_count"
        base = "r"
        terms = [{ part = "disturbance_progress_m", at_most = -0.001, weight = -0.5 }]
        # ANCHOR_END: count
        "#;
        let config = config(text).unwrap();
        let spec = config.spec();
        let after = |progress_m: f32| {
            let part =
                |index: usize| if spec.channels[index].name == "disturbance_progress_m" { progress_m } else { 0.0 };
            config.reward(&config.stages[0].reward).of(part, 0.0)
        };
        let undisturbed = after(0.0);
        assert_eq!([after(-0.002), after(-3.0)], [undisturbed - 0.5; 2]);
        // Putting something back earns nothing, and a tremble below the threshold costs nothing.
        assert_eq!([after(3.0), after(-0.0005)], [undisturbed; 2]);
        assert_eq!(Config::from_toml(&config.to_toml(), "round trip").unwrap(), config);
    }

    #[test]
    fn a_weight_is_the_tasks_until_it_is_set() {
        let default = config("").unwrap();
        assert_eq!(default.reward.weights, BTreeMap::from([("lambda_disturb".to_owned(), 15.0)]));
        let set: Setting = "reward.lambda_disturb=5".parse().unwrap();
        let set = Config::resolve_set("demo", None, &[set]).unwrap();
        assert_eq!(set.reward.weights["lambda_disturb"], 5.0);
        for (own, expected) in [
            ("[reward]\nlambda_distrub = 5", "no such weight; it has: lambda_disturb"),
            ("[reward]\nlambda_disturb = \"five\"", "mine.toml:2: reward.lambda_disturb: expected a number"),
            ("task = \"arm_point_nab\"", "did you mean `arm_point_nav`?"),
            ("[[rewards]]\nname = \"r\"", "configuration: rewards: there are two of the name `r`"),
            ("[[rewards]]\nname = \"R\"", "configuration: rewards: name `R`"),
            (
                "[[rewards]]\nname = \"mine\"\nconstant = inf",
                "configuration: rewards: reward `mine`: its constant is not a finite number",
            ),
            ("task = \"point_nav\"\nepisode.action_space = \"small\"", "task `point_nav` has no subset `small`"),
            ("episode.action_space = \"tiny\"", "no action space `tiny`; there are large, small"),
            ("stages = [{ name = \"I\", reward = \"s\", frames = 9 }]", "has no reward `s`"),
        ] {
            let problem = config(own).unwrap_err();
            assert!(problem.contains(expected), "{problem}");
        }
        let small = config("episode.action_space = \"small\"").unwrap().policy_actions();
        assert_eq!(small, [0, 1, 2, 3, 4, 5, 6, 7, 16, 17, 18, 19, 20]);
        assert_eq!(config("").unwrap().policy_actions(), (0..21).collect::<Vec<u8>>());
    }

    #[test]
    fn a_run_goes_on_under_its_own_task_alone() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::new(folder.path());
        let config = config("").unwrap();
        config.check_task(&run).unwrap();
        let text = config.spec().text();
        for (from, to, is_same) in [
            ("", "", true),
            ("Total displacement at the end", "Displacement at the end", true),
            ("below = 0.01", "below = 0.02", false),
            ("[cost]", "[costs]", false),
        ] {
            assert!(text.contains(from));
            std::fs::write(run.task(), text.replacen(from, to, 1)).unwrap();
            let checked = config.check_task(&run).map_err(|error| error.to_string());
            assert_eq!(checked.is_ok(), is_same, "{to}");
            assert!(is_same || checked.unwrap_err().contains("declared otherwise"));
        }
    }

    /// A run's folder may be anybody's: 60,000 rewards, each the base of the next, once overflowed the stack.
    #[test]
    fn what_is_declared_has_a_bound() {
        let chain = |count: usize| -> String {
            let link = |at: usize| format!("[[rewards]]\nname = \"mine_{at}\"\nbase = \"mine_{}\"\n", at + 1);
            (0..count).map(link).collect::<String>() + &format!("[[rewards]]\nname = \"mine_{count}\"\n")
        };
        assert!(config(&chain(90)).is_ok());
        let problem = config(&chain(60_000)).unwrap_err();
        assert!(problem.contains("rewards: at most 100 can be declared"), "{problem}");
        let terms = "[\"failed_action\", 1.0],".repeat(1001);
        let problem = config(&format!("[[rewards]]\nname = \"mine\"\nterms = [{terms}]")).unwrap_err();
        assert!(problem.contains("there are 1001 terms in a reward"), "{problem}");
        let stage = |name: &str| format!("stages = [{{ name = \"{name}\", reward = \"r\", frames = 1000 }}]");
        let problem = config(&stage(&"I".repeat(1_000_000))).unwrap_err();
        assert!(problem.contains("a name has at most 64 letters"), "{problem}");
        assert!(config(&stage(&"ü".repeat(64))).is_ok());
    }
}
