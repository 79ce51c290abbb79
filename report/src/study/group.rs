use super::run::{Origin, Run};
use super::settings::{differences, settings_of};
use std::path::Path;
use toml::Table;

#[derive(Debug, Clone)]
pub struct Group<'a> {
    /// Its name in tables and figures: the preset's, with a star where it has other settings than the preset. Where
    /// that does not distinguish groups, also their folders' names, or else a letter.
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

    fn named(&self, name: &str) -> String {
        let star = if self.differences.is_empty() { "" } else { "*" };
        let trained = match &self.runs[0].origin {
            Origin::Policy(file) if self.runs.len() == 1 => format!(", {file}"),
            Origin::Policy(_) => ", policy files".to_owned(),
            Origin::Unknown => ", run not found".to_owned(),
            Origin::Untrained => ", untrained".to_owned(),
            Origin::Run(_) | Origin::NotGiven => String::new(),
        };
        format!("{name}{star}{trained}")
    }

    /// What all its folders are called, without their seeds; none where they differ, or only a clock named them.
    fn called(&self) -> Option<String> {
        let mut names = self.runs.iter().map(|run| {
            let folder = Path::new(&run.name).file_name()?.to_str()?;
            let name = folder.strip_suffix(&format!("-{}", run.config.seed)).unwrap_or(folder);
            let time = name.strip_suffix(&run.config.preset).unwrap_or(name);
            (!name.is_empty() && time.contains(|letter: char| !letter.is_ascii_digit() && letter != '-'))
                .then_some(name)
        });
        let first = names.next()??;
        names.all(|name| name == Some(first)).then(|| first.to_owned())
    }
}

fn label(groups: &mut [Group<'_>]) {
    // All environments of others have one preset.
    let name = |group: &Group<'_>| {
        let config = &group.runs[0].config;
        group.named(config.environment.as_ref().map_or(&group.preset, |_| &config.task))
    };
    let names: Vec<String> = groups.iter().map(name).collect();
    let labels: Vec<String> = groups
        .iter()
        .zip(&names)
        .enumerate()
        .map(|(index, (group, name))| {
            let alike = |other: &usize| names[*other] == *name;
            let before = (0..index).filter(alike).count();
            let folders: Vec<Option<String>> =
                (0..groups.len()).filter(alike).map(|other| groups[other].called()).collect();
            let told_apart =
                folders.iter().enumerate().all(|(n, folder)| folder.is_some() && !folders[..n].contains(folder));
            match &folders[before] {
                _ if folders.len() == 1 => name.clone(),
                Some(folder) if told_apart => group.named(folder),
                _ if before < 26 => format!("{name} ({})", char::from(b'a' + before as u8)),
                _ => format!("{name} ({})", before + 1),
            }
        })
        .collect();
    for (group, label) in groups.iter_mut().zip(labels) {
        group.label = label;
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proto::config::{Config, EnvironmentConfig, FromConfig};
    use proto::run_state::{Ending, RunState};
    use std::collections::BTreeMap;

    pub fn run(name: &str, preset: &str, seed: u64) -> Run {
        let config = Config { seed, ..Config::resolve(preset, None).unwrap() };
        Run {
            name: name.into(),
            origin: Origin::Run(RunState::Ended(Ending::Complete)),
            config,
            rollouts: Vec::new(),
            newest_tenth: BTreeMap::new(),
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
        assert_eq!(labels, ["demo", "demo* (a)", "demo* (b)", "demo, untrained", "demo, run not found", "paper"]);
        let policy = [with_origin("h", Origin::Policy("fetch.safetensors".to_owned()))];
        assert_eq!(super::groups(&policy).unwrap()[0].label, "demo, fetch.safetensors");
        let names: Vec<&str> = groups[0].runs.iter().map(|run| run.name.as_str()).collect();
        assert_eq!(names, ["b", "a", "c"], "by seed");
        assert!(groups[0].differences.is_empty(), "{:?}", groups[0].differences);
        assert_eq!(groups[1].differences, ["stages: r 5 000, then r_prime 180 000 frames"]);
    }

    #[test]
    fn groups_of_one_preset_are_told_apart_by_what_their_folders_are_called() {
        let with = |name: &str, seed: u64, clip: f64| {
            let mut run = run(name, "demo", seed);
            run.config.ppo.clip = clip;
            run
        };
        let labels = |runs: &[Run]| groups(runs).unwrap().into_iter().map(|group| group.label).collect::<Vec<_>>();
        let suite = [with("s/wide-1", 1, 0.3), with("s/narrow-1", 1, 0.05), with("s/wide-2", 2, 0.3)];
        assert_eq!(labels(&suite), ["wide*", "narrow*"]);
        assert_eq!(labels(&suite[..1]), ["demo*"], "nothing to tell apart");
        let differ = [with("s/wide-1", 1, 0.3), with("s/broad-2", 2, 0.3), with("s/narrow-1", 1, 0.05)];
        assert_eq!(labels(&differ), ["demo* (a)", "demo* (b)"]);
        let clock = [with("runs/20261121-145536-demo-1", 1, 0.3), with("runs/20261121-145537-demo-1", 1, 0.05)];
        assert_eq!(labels(&clock), ["demo* (a)", "demo* (b)"]);
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
        assert_eq!(groups[1].differences, ["begun with weights after 9 000 frames"]);
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
        assert_eq!(groups[0].label, "cart_pole*");
    }
}
