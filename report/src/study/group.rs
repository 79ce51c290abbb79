use super::run::{Origin, Run};
use super::settings::{differences, settings_of};
use std::path::Path;
use toml::Table;

#[derive(Debug, Clone)]
pub struct Group<'a> {
    /// Its name in tables and figures: its runs' folders', where they have one; else the preset's, with a star where it
    /// has other settings than the preset. Where that does not distinguish groups, the folder that their runs are in comes
    /// before it, that of a suite; else a letter follows.
    pub label: String,
    pub preset: String,
    pub differences: Vec<String>,
    pub runs: Vec<&'a Run>,
    pub settings: Table,
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StudyError {
    #[error("no runs to report on")]
    Nothing,
    #[error(
        "{first} and {second} are the same experiment with the same seed {seed} ({preset}): a second run of a seed says \
         nothing about other seeds. Name only one of them"
    )]
    SameSeed { first: String, second: String, seed: u64, preset: String },
}

/// What two runs have in common that are the same experiment with the same seed.
pub fn experiment(run: &Run) -> impl PartialEq + use<> {
    (settings_of(&run.config), run.origin.trained(), run.config.seed)
}

pub fn groups(runs: &[Run]) -> Result<Vec<Group<'_>>, StudyError> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for run in runs {
        let settings = settings_of(&run.config);
        // An untrained policy is not a run of its preset, nor is one whose training is unknown.
        let alike =
            |group: &Group<'_>| group.settings == settings && group.runs[0].origin.trained() == run.origin.trained();
        match groups.iter_mut().find(|group| alike(group)) {
            Some(group) => group.runs.push(run),
            None => groups.push(Group {
                label: String::new(),
                preset: run.config.preset.clone(),
                differences: differences(&run.config),
                runs: vec![run],
                settings,
            }),
        }
    }
    if groups.is_empty() {
        return Err(StudyError::Nothing);
    }
    for group in &mut groups {
        group.runs.sort_by_key(|run| run.config.seed);
        if let Some([first, second]) =
            group.runs.array_windows().find(|[first, second]| first.config.seed == second.config.seed)
        {
            let (preset, other) = (&first.config.preset, &second.config.preset);
            return Err(StudyError::SameSeed {
                first: first.name.clone(),
                second: second.name.clone(),
                seed: first.config.seed,
                preset: if preset == other { preset.clone() } else { format!("{preset}, which is also {other}") },
            });
        }
    }
    label(&mut groups);
    Ok(groups)
}

impl Group<'_> {
    /// Its runs began with weights whose training is not known: an older version did not note it.
    pub(crate) fn begun_with_unknown(&self) -> bool {
        self.runs.iter().any(|run| run.config.from.as_ref().is_some_and(|from| from.stages.is_empty()))
    }

    pub(crate) fn untrained(&self) -> bool {
        self.runs.iter().all(|run| run.origin == Origin::Untrained)
    }

    pub(crate) fn unknown(&self) -> bool {
        self.runs.iter().all(|run| run.origin.trained().is_none())
    }

    fn named(&self) -> String {
        let config = &self.runs[0].config;
        // All environments of others have one preset.
        let preset = config.environment.as_ref().map_or(&self.preset, |_| &config.task);
        let star = if self.differences.is_empty() { "" } else { "*" };
        let name = self.called().unwrap_or_else(|| format!("{preset}{star}"));
        let trained = match &self.runs[0].origin {
            Origin::Policy(file) if self.runs.len() == 1 => format!(", {file}"),
            Origin::Policy(_) => ", policy files".to_owned(),
            Origin::Unknown => ", run not found".to_owned(),
            Origin::Untrained => ", untrained".to_owned(),
            Origin::Run(_) | Origin::NotGiven => String::new(),
        };
        format!("{name}{trained}")
    }

    /// What its run's folder is called, and of several what all are without their seeds; none where they differ.
    fn called(&self) -> Option<String> {
        let mut names = self.runs.iter().map(|run| {
            // The others' folders are those of evaluations.
            let Origin::Run(_) = run.origin else { return None };
            let folder = Path::new(&run.name).file_name()?.to_str()?;
            let seed = format!("-{}", run.config.seed);
            folder.strip_suffix(&seed).filter(|name| self.runs.len() > 1 && !name.is_empty()).or(Some(folder))
        });
        let first = names.next()??;
        names.all(|name| name == Some(first)).then(|| first.to_owned())
    }

    /// The name behind that of the folder that all its runs are in; `SUITE/runs` is called `SUITE`.
    fn named_within(&self, name: &str) -> Option<String> {
        let mut places = self.runs.iter().map(|run| {
            let Origin::Run(_) = run.origin else { return None };
            let place = Path::new(&run.name).parent()?;
            let suite = place.parent().filter(|_| place.ends_with("runs")).and_then(Path::file_name);
            suite.or(place.file_name())?.to_str()
        });
        let first = places.next()??;
        places.all(|place| place == Some(first)).then(|| format!("{first}/{name}"))
    }
}

fn label(groups: &mut [Group<'_>]) {
    let names: Vec<String> = groups.iter().map(Group::named).collect();
    let within: Vec<_> = groups.iter().zip(&names).map(|(group, name)| group.named_within(name)).collect();
    let is_one = |place: &&String| within.iter().flatten().filter(|other| other == place).count() == 1;
    for (index, group) in groups.iter_mut().enumerate() {
        let name = &names[index];
        let before = names[..index].iter().filter(|other| *other == name).count();
        group.label = match (names.iter().filter(|other| *other == name).count(), within[index].as_ref().filter(is_one))
        {
            (1, _) => name.clone(),
            (_, Some(place)) => place.clone(),
            _ if before < 26 => format!("{name} ({})", char::from(b'a' + before as u8)),
            _ => format!("{name} ({})", before + 1),
        };
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proto::config::{Config, EnvironmentConfig, FromConfig};
    use proto::run_state::{Ending, RunState};

    pub fn run(name: &str, preset: &str, seed: u64) -> Run {
        let config = Config { seed, ..Config::resolve(preset, None).unwrap() };
        Run {
            name: name.into(),
            origin: Origin::Run(RunState::Ended(Ending::Complete)),
            config,
            rollouts: Vec::new(),
            stages: Vec::new(),
            evaluations: Vec::new(),
            validation: Vec::new(),
        }
    }

    #[test]
    fn seeds_of_one_configuration_are_one_group() {
        let mut threads = run("c", "demo", 3);
        threads.config.learner.threads = 1;
        let mut short = run("d", "demo", 1);
        short.config.stages[0].frames = 5000;
        let mut shorter = short.clone();
        shorter.config.stages[0].frames = 4000;
        let with_origin = |name: &str, origin: Origin| Run { origin, ..run(name, "demo", 1) };
        let runs = [
            run("a", "demo", 2),
            run("b", "demo", 1),
            threads,
            short,
            shorter,
            with_origin("e", Origin::Untrained),
            with_origin("g", Origin::Unknown),
            run("f", "paper", 1),
        ];
        let groups = groups(&runs).unwrap();
        let labels: Vec<&str> = groups.iter().map(|group| group.label.as_str()).collect();
        assert_eq!(labels, ["demo", "d (a)", "d (b)", "demo, untrained", "demo, run not found", "f"]);
        let policy = [with_origin("h", Origin::Policy("fetch.safetensors".to_owned()))];
        assert_eq!(super::groups(&policy).unwrap()[0].label, "demo, fetch.safetensors");
        let names: Vec<&str> = groups[0].runs.iter().map(|run| run.name.as_str()).collect();
        assert_eq!(names, ["b", "a", "c"], "by seed");
        assert!(groups[0].differences.is_empty(), "{:?}", groups[0].differences);
        assert_eq!(groups[1].differences, ["stages: r 5,000, then r′ 250,000 frames"]);
    }

    #[test]
    fn groups_are_called_as_their_folders() {
        let with = |name: &str, seed: u64, clip: f64| {
            let mut run = run(name, "demo", seed);
            run.config.ppo.clip = clip;
            run
        };
        let labels = |runs: &[Run]| groups(runs).unwrap().into_iter().map(|group| group.label).collect::<Vec<_>>();
        let suite = [with("s/wide-1", 1, 0.3), with("s/narrow-1", 1, 0.05), with("s/wide-2", 2, 0.3)];
        assert_eq!(labels(&suite), ["wide", "narrow-1"]);
        let differ = [with("s/wide-1", 1, 0.3), with("s/broad-2", 2, 0.3), with("s/narrow-1", 1, 0.05)];
        assert_eq!(labels(&differ), ["demo*", "narrow-1"]);
        // Two suites with the same names, and a run beside them.
        let suites = [with("tiny/runs/demo-1", 1, 0.3), with("two/runs/demo-1", 1, 0.2), with("demo-1", 1, 0.1)];
        assert_eq!(labels(&suites), ["tiny/demo-1", "two/demo-1", "demo-1 (c)"]);
        let both = [with("tiny/runs/demo-1", 1, 0.3), with("tiny/runs/demo-2", 2, 0.3), with("two/demo", 1, 0.2)];
        assert_eq!(labels(&both), ["tiny/demo", "two/demo"]);
    }

    #[test]
    fn a_seed_counts_once() {
        let runs = [run("a", "demo", 1), run("b", "demo", 2), run("c", "demo", 1)];
        let problem = groups(&runs).unwrap_err().to_string();
        assert!(problem.starts_with("a and c are the same experiment with the same seed 1 (demo)"), "{problem}");
        assert_eq!(groups(&[]).unwrap_err(), StudyError::Nothing);
        // One experiment under two names is one group.
        let runs = [run("a", "lambda-15", 1), run("b", "disturb-two-stage", 2), run("c", "disturb-two-stage", 1)];
        let both = groups(&runs[..2]).unwrap();
        assert_eq!((both.len(), both[0].label.as_str(), both[0].runs.len()), (1, "lambda-15", 2));
        let problem = groups(&runs).unwrap_err().to_string();
        assert!(problem.contains("same seed 1 (lambda-15, which is also disturb-two-stage)"), "{problem}");
    }

    #[test]
    fn runs_from_other_weights_are_a_group_of_their_own() {
        let mut runs = [run("a", "demo", 1), run("b", "demo", 2), run("c", "demo", 3)];
        for (run, weights) in runs[1..].iter_mut().zip(["aa", "bb"]) {
            let checkpoint = format!("/runs/{weights}/checkpoints/rollout-00000009.json");
            run.config.from = Some(FromConfig { checkpoint, frames: 9000, weights: weights.into(), stages: vec![] });
        }
        let groups = groups(&runs).unwrap();
        assert_eq!(groups.iter().map(|group| group.runs.len()).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(groups[1].differences, ["begun with weights after 9,000 frames"]);
        assert!(groups[1].begun_with_unknown() && !groups[0].begun_with_unknown());
    }

    #[test]
    fn what_differs_from_the_preset_is_named() {
        let mut changed = run("a", "disturb-two-stage", 1);
        changed.config.ppo.clip = 0.2;
        changed.config.actors.count = 5;
        let runs = [changed];
        assert_eq!(groups(&runs).unwrap()[0].differences, ["actors.count = 5", "ppo.clip = 0.2"]);
        // Of somebody's environment what is started, not the text of its declaration or what kitchens have.
        let mut theirs = run("b", "gym", 1);
        let command = ["python", "cart_pole.py"].map(str::to_owned).to_vec();
        theirs.config.environment = Some(EnvironmentConfig { command, declaration: "name = \"cart_pole\"".to_owned() });
        theirs.config.task = "cart_pole".to_owned();
        theirs.config.reward.weights.clear();
        let runs = [theirs];
        let groups = groups(&runs).unwrap();
        assert_eq!(groups[0].differences, ["environment: python cart_pole.py", "task = \"cart_pole\""]);
        assert_eq!(groups[0].label, "b");
    }
}
