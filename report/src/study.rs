//! What a report is made from: runs as their folders tell of them, put together in groups that differ in the seed only.

use proto::config::Config;
use proto::evaluation::{Conditions, Distribution, EpisodeRecord, Evaluation, ObjectSet};
use proto::kitchen::Split;
use std::collections::BTreeMap;
use std::path::Path;
use toml::{Table, Value};

/// One run, or weights that were evaluated without one.
#[derive(Debug, Clone)]
pub struct Run {
    /// Its folder, as the user named it.
    pub name: String,
    /// `complete`, `running`, `stopped`, ...; [`UNTRAINED`] of weights that no run has trained, [`NOT_GIVEN`] of weights
    /// whose run is not in the study, [`UNKNOWN`] of weights whose run cannot be found.
    pub state: String,
    /// Its configuration.
    pub config: Config,
    /// What was trained, in order.
    pub rollouts: Vec<Rollout>,
    /// Its evaluations.
    pub evaluations: Vec<Evaluated>,
    /// Evaluations during training, in order of frames.
    pub validation: Vec<Validated>,
}

/// One trained rollout.
#[derive(Debug, Clone, PartialEq)]
pub struct Rollout {
    /// Frames trained on, this rollout included.
    pub frames: u64,
    /// Figures: see [`proto::metric`]; and [`FRAMES_PER_S`] and [`ELAPSED_S`].
    pub metrics: BTreeMap<String, f64>,
}

/// Metric of a rollout: frames trained on a second, simulation, inference and update together.
pub const FRAMES_PER_S: &str = "time/frames_per_second";
/// Metric of a rollout: seconds trained until its end.
pub const ELAPSED_S: &str = "time/elapsed_s";

/// One evaluation.
#[derive(Debug, Clone)]
pub struct Evaluated {
    /// Its folder, as far as it is not the run's.
    pub name: String,
    /// Its result file.
    pub result: Evaluation,
    /// Its table.
    pub episodes: Vec<EpisodeRecord>,
}

/// One evaluation during training.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Validated {
    /// Frames trained on.
    pub frames: u64,
    /// Fixed episodes, or drawn as the run draws its own.
    pub distribution: Distribution,
    /// SR.
    pub success: f64,
    /// `SRwoD`.
    pub success_without_disturbance: f64,
}

/// Which kind of episodes. Only the fixed ones are the paper's kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// The fixed ones of validation and test kitchens.
    Fixed,
    /// Drawn within the run's distances, in the kitchens of a split.
    Drawn,
    /// Drawn within the run's distances, in scenes of the run's own.
    Scenes,
}

impl Source {
    fn of(conditions: &Conditions) -> Self {
        match conditions.distribution {
            _ if !conditions.scenes.is_empty() => Self::Scenes,
            Distribution::Fixed => Self::Fixed,
            Distribution::Run => Self::Drawn,
        }
    }
}

/// Which episodes a table is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Kitchens.
    pub split: Split,
    /// Targets: novel or seen.
    pub objects: ObjectSet,
    /// Fixed or drawn.
    pub source: Source,
}

impl Field {
    /// All that can be evaluated, the paper's first table first.
    pub const ALL: [Self; 12] = [
        Self::new(Split::Test, ObjectSet::Novel, Source::Fixed),
        Self::new(Split::Test, ObjectSet::Seen, Source::Fixed),
        Self::new(Split::Validation, ObjectSet::Novel, Source::Fixed),
        Self::new(Split::Validation, ObjectSet::Seen, Source::Fixed),
        Self::new(Split::Test, ObjectSet::Novel, Source::Drawn),
        Self::new(Split::Test, ObjectSet::Seen, Source::Drawn),
        Self::new(Split::Validation, ObjectSet::Novel, Source::Drawn),
        Self::new(Split::Validation, ObjectSet::Seen, Source::Drawn),
        Self::new(Split::Train, ObjectSet::Novel, Source::Drawn),
        Self::new(Split::Train, ObjectSet::Seen, Source::Drawn),
        Self::new(Split::Train, ObjectSet::Novel, Source::Scenes),
        Self::new(Split::Train, ObjectSet::Seen, Source::Scenes),
    ];

    /// These episodes.
    pub const fn new(split: Split, objects: ObjectSet, source: Source) -> Self {
        Self { split, objects, source }
    }

    /// `test, novel objects`, or `test, novel objects, drawn episodes`
    pub fn name(self) -> String {
        let drawn = if self.source == Source::Fixed { "" } else { ", drawn episodes" };
        format!("{}, {} objects{drawn}", self.place(), self.objects.name())
    }

    /// `test-novel`, or `test-novel-drawn`, for file names.
    pub fn key(self) -> String {
        let drawn = if self.source == Source::Drawn { "-drawn" } else { "" };
        format!("{}-{}{drawn}", self.place(), self.objects.name())
    }

    fn place(self) -> &'static str {
        match self.split {
            _ if self.source == Source::Scenes => "scenes",
            Split::Train => "training",
            Split::Validation => "validation",
            Split::Test => "test",
        }
    }
}

impl Evaluated {
    /// Its episodes in a field.
    pub fn episodes_in(&self, field: Field) -> impl Iterator<Item = &EpisodeRecord> {
        let conditions = &self.result.conditions;
        let in_field = conditions.split == field.split && Source::of(conditions) == field.source;
        self.episodes.iter().filter(move |record| in_field && field.objects.contains(record.category))
    }
}

impl Run {
    /// The evaluation that stands for this run in a field: of the newest checkpoint that was evaluated there, by frames;
    /// of that with sampled actions before the most probable ones, then the one with the most episodes, then the newest.
    pub fn evaluation_in(&self, field: Field) -> Option<&Evaluated> {
        let rank = |evaluated: &&Evaluated| {
            let sampled = !evaluated.result.conditions.deterministic;
            let frames = evaluated.result.subject.frames;
            (frames, sampled, evaluated.episodes_in(field).count(), evaluated.result.cost.at_unix_s)
        };
        self.evaluations_in(field).max_by_key(rank)
    }

    /// Evaluations in a field of older checkpoints than the one that counts.
    pub fn older_in(&self, field: Field) -> impl Iterator<Item = &Evaluated> {
        let newest = self.evaluation_in(field).map_or(0, |evaluated| evaluated.result.subject.frames);
        self.evaluations_in(field).filter(move |evaluated| evaluated.result.subject.frames < newest)
    }

    fn evaluations_in(&self, field: Field) -> impl Iterator<Item = &Evaluated> {
        self.evaluations.iter().filter(move |evaluated| evaluated.episodes_in(field).next().is_some())
    }
}

/// Runs of one configuration with different seeds.
#[derive(Debug, Clone)]
pub struct Group<'a> {
    /// Its name in tables and figures: the preset's, with a star where it has other settings than the preset. Where that is
    /// not enough to tell groups apart: what their folders are called, or else a letter.
    pub label: String,
    /// Preset.
    pub preset: String,
    /// Settings that are not the preset's.
    pub differences: Vec<String>,
    /// Runs, by seed.
    pub runs: Vec<&'a Run>,
    /// What the runs have in common.
    pub settings: Table,
}

/// Runs that make no study.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StudyError {
    /// Nothing given.
    #[error("no runs to report on")]
    Nothing,
    /// One experiment twice: its seed would count for two.
    #[error(
        "{first} and {second} are the same experiment with the same seed {seed} ({preset}): a second run of a seed says \
         nothing about other seeds. Name only one of them"
    )]
    SameSeed {
        /// A run.
        first: String,
        /// Another.
        second: String,
        /// Their seed.
        seed: u64,
        /// Their preset.
        preset: String,
    },
}

/// Settings that say what a run is called, where and how it computes and what it keeps, not what it learns.
const INCIDENTAL: [&str; 7] = ["preset", "seed", "learner", "checkpoint", "recording", "validation", "evaluation"];

/// Groups of `runs`, in the order in which their first runs are given.
pub fn groups(runs: &[Run]) -> Result<Vec<Group<'_>>, StudyError> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for run in runs {
        let mut settings = settings_of(&run.config);
        // A policy that nobody has trained is no run of its preset; nor is one that was trained who knows how.
        let trained = [UNTRAINED, UNKNOWN].into_iter().find(|state| run.state == *state).unwrap_or("trained");
        settings.insert(TRAINED.into(), Value::String(trained.into()));
        match groups.iter_mut().find(|group| group.settings == settings) {
            Some(group) => group.runs.push(run),
            None => groups.push(Group {
                label: String::new(),
                preset: run.config.preset.clone(),
                differences: differences(run),
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
    /// Its runs began with another run's weights.
    pub fn continued(&self) -> bool {
        self.runs.iter().any(|run| run.config.from.is_some())
    }

    /// Its weights are fresh: no run has trained them.
    pub fn untrained(&self) -> bool {
        self.runs.iter().all(|run| run.state == UNTRAINED)
    }

    /// How its weights were trained is not known: their run cannot be found.
    pub fn unknown(&self) -> bool {
        self.runs.iter().all(|run| run.state == UNKNOWN)
    }

    /// A label with this name.
    fn named(&self, name: &str) -> String {
        let star = if self.differences.is_empty() { "" } else { "*" };
        let trained = match (self.untrained(), self.unknown()) {
            (true, _) => ", untrained",
            (_, true) => ", run unknown",
            _ => "",
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

/// Key of the one thing in a group's settings that is no setting.
const TRAINED: &str = "trained";
/// State of weights that no run has trained.
pub const UNTRAINED: &str = "untrained";
/// State of weights whose run is not in the study: its configuration is known, and nothing of its training.
pub const NOT_GIVEN: &str = "its run was not given";
/// State of weights whose run cannot be found.
pub const UNKNOWN: &str = "its run cannot be found";

fn label(groups: &mut [Group<'_>]) {
    let names: Vec<String> = groups.iter().map(|group| group.named(&group.preset)).collect();
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

/// What must be equal in all runs of a group. One experiment may go by the names of two presets.
fn settings_of(config: &Config) -> Table {
    let mut table = table_of(config);
    for key in INCIDENTAL {
        table.remove(key);
    }
    // Each seed begins with weights of its own; how long those were trained is what seeds have in common.
    if let Some(from) = table.get_mut("from").and_then(Value::as_table_mut) {
        from.retain(|key, _| key == "frames");
    }
    table
}

fn table_of(config: &Config) -> Table {
    Table::try_from(config).expect("a configuration is plain numbers, strings and tables")
}

/// Settings of a run that its preset does not have, as `key = value`.
fn differences(run: &Run) -> Vec<String> {
    match Config::resolve(&run.config.preset, None) {
        Ok(preset) => differences_between(&preset, &run.config),
        Err(_) => vec!["the preset is unknown to this version".into()],
    }
}

/// What the second configuration has learn otherwise than the first, as `key = value` of the second.
pub fn differences_between(first: &Config, second: &Config) -> Vec<String> {
    let mut found = Vec::new();
    compare("", &settings_of(first), &settings_of(second), &mut found);
    found
}

fn compare(path: &str, preset: &Table, run: &Table, found: &mut Vec<String>) {
    for (key, value) in run {
        let key_path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        match (preset.get(key), value) {
            (Some(before), value) if before == value => {}
            (Some(Value::Table(before)), Value::Table(value)) => compare(&key_path, before, value, found),
            (_, value) if key_path == "from" => {
                let frames = value.get("frames").and_then(Value::as_integer).unwrap_or(0).unsigned_abs();
                found.push(format!("begun with weights after {} frames", crate::format::count(frames)));
            }
            (_, Value::Array(stages)) if key_path == "stages" => found.push(stages_text(stages)),
            (_, value) => found.push(format!("{key_path} = {value}")),
        }
    }
    for key in preset.keys().filter(|key| !run.contains_key(*key)) {
        found.push(format!("{path}{}{key} unset", if path.is_empty() { "" } else { "." }));
    }
}

/// `stages: r 5 000 000, r_prime 5 000 000`
fn stages_text(stages: &[Value]) -> String {
    let text = |stage: &Value| {
        let reward = stage.get("reward").and_then(Value::as_str).unwrap_or("?");
        let frames = stage.get("frames").and_then(Value::as_integer).unwrap_or(0);
        format!("{reward} {}", crate::format::count(frames.unsigned_abs()))
    };
    format!("stages: {} frames", stages.iter().map(text).collect::<Vec<_>>().join(", then "))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proto::config::FromConfig;

    pub fn run(name: &str, preset: &str, seed: u64) -> Run {
        let config = Config { seed, ..Config::resolve(preset, None).unwrap() };
        Run {
            name: name.into(),
            state: "complete".into(),
            config,
            rollouts: Vec::new(),
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
        let with_state = |name: &str, state: &str| Run { state: state.into(), ..run(name, "demo", 1) };
        let runs = [
            run("a", "demo", 2),
            run("b", "demo", 1),
            threads,
            short,
            shorter,
            with_state("e", UNTRAINED),
            with_state("g", UNKNOWN),
            run("f", "paper", 1),
        ];
        let groups = groups(&runs).unwrap();
        let labels: Vec<&str> = groups.iter().map(|group| group.label.as_str()).collect();
        assert_eq!(labels, ["demo", "demo* (a)", "demo* (b)", "demo, untrained", "demo, run unknown", "paper"]);
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
            run.config.from = Some(FromConfig { checkpoint, frames: 9000, weights: weights.into() });
        }
        let groups = groups(&runs).unwrap();
        assert_eq!(groups.iter().map(|group| group.runs.len()).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(groups[1].differences, ["begun with weights after 9 000 frames"]);
        assert!(groups[1].continued() && !groups[0].continued());
    }

    #[test]
    fn what_differs_from_the_preset_is_named() {
        let mut changed = run("a", "disturb-two-stage", 1);
        changed.config.ppo.clip = 0.2;
        changed.config.actors.count = 5;
        let runs = [changed];
        assert_eq!(groups(&runs).unwrap()[0].differences, ["actors.count = 5", "ppo.clip = 0.2"]);
    }
}
