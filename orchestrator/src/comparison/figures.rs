use super::row::{Format, Row};
use crate::evaluation::text::{place, seeds_of};
use crate::output::format::{self, NOTHING};
use crate::output::terminal;
use crate::run::identity::Identity;
use crate::run::lock::{LockState, holder, state_of};
use crate::training::means::{StageMeans, by_stage, frames_per_s};
use crate::training::metrics::Figures;
use crate::training::scores::{Scores, best, evaluations_below, read_result};
use crate::training::summary::Summary;
use crate::training::wall::{Wall, signs_of_life};
use anyhow::Result;
use proto::config::Config;
use proto::evaluation::{Distribution, Evaluation, ObjectSet, RESULT_FILE};
use proto::run_folder::RunFolder;
use proto::stage::total_frames;
use proto::task::{Described, Spec};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// What a figure is of, in the order in which a comparison shows them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    #[default]
    Run,
    Stage,
    Validation,
    Evaluation,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    part: Part,
    /// What it is of, where that is a part of its own.
    of: String,
    name: String,
    value: Value,
    shown: String,
    format: Format,
}

const DIGITS: usize = 12;

#[derive(Debug, Default)]
struct List {
    part: Part,
    of: String,
    figures: Vec<Figure>,
}

impl List {
    fn begin(&mut self, part: Part, of: impl Into<String>) {
        (self.part, self.of) = (part, of.into());
    }

    fn text(&mut self, name: &str, value: &str, shown: String) {
        self.put(name, json!(value), shown, Format::Text);
    }

    fn put(&mut self, name: impl Into<String>, value: Value, shown: String, format: Format) {
        self.figures.push(Figure { part: self.part, of: self.of.clone(), name: name.into(), value, shown, format });
    }

    fn number(&mut self, name: impl Into<String>, value: Option<f64>, format: Format) {
        let shown = value.map_or_else(|| NOTHING.to_owned(), |value| format.shown(value));
        self.put(name, json!(value), shown, format);
    }

    fn count(&mut self, name: impl Into<String>, value: u64) {
        self.put(name, json!(value), format::count(value), Format::Count);
    }

    fn metric(&mut self, one: &Described, value: Option<f64>) {
        self.number(with_unit(&one.label, &one.unit), value, Format::Metric(one.clone()));
    }

    fn metrics(&mut self, task: &Spec, figures: &BTreeMap<String, f64>) {
        for metric in task.shown() {
            self.metric(&metric, metric.mean(figures));
        }
    }
}

fn with_unit(label: &str, unit: &str) -> String {
    if unit.is_empty() { label.to_owned() } else { format!("{label} ({unit})") }
}

pub fn of(folder: &RunFolder, config: &Config, identity: &Identity) -> Result<Vec<Figure>> {
    let mut list = List::default();
    let held = holder(folder)?;
    let is_evaluation = config.evaluation.is_some();
    let summary = if is_evaluation { Ok(None) } else { Summary::read(folder) };
    let summary = summary.unwrap_or_else(|error| {
        tell(folder, [format!("{error:#}")].iter());
        None
    });
    let is_complete = summary.is_some() || is_evaluation && folder.has(&folder.root().join(RESULT_FILE));
    let state = state_of(identity, &held, is_complete).to_string();
    list.text("state", &state, state.clone());
    if let Some(summary) = summary {
        list.text("weights", &summary.weights, summary.weights.chars().take(DIGITS).collect());
    }
    if !is_evaluation {
        training(&mut list, folder, config, identity, &held);
    }
    evaluations(&mut list, folder);
    Ok(list.figures)
}

fn training(list: &mut List, folder: &RunFolder, config: &Config, identity: &Identity, held: &LockState) {
    let at_rest = *held == LockState::Free;
    let Figures { history, notes } = Figures::read(folder, at_rest);
    let Scores { scores, notes: more } = Scores::read(folder, config.spec(), at_rest);
    tell(folder, notes.iter().chain(&more));
    list.count("frames", history.frames());
    list.count("budget", total_frames(&config.stages));
    list.number("frames/s, mean", frames_per_s(&history), Format::Rate);
    let wall_s = Wall::of(identity, &signs_of_life(&history), !at_rest).all_starts_s;
    list.number("wall time", Some(wall_s), Format::Seconds);
    for stage in by_stage(&config.stages, &history) {
        of_stage(list, config.spec(), &stage);
    }
    if let Some(best) = best(&scores, config.spec()) {
        list.begin(Part::Validation, "best validation");
        list.metrics(config.spec(), &best.figures);
        list.count("at frame", best.frames);
    }
}

fn tell<'a>(folder: &RunFolder, notes: impl Iterator<Item = &'a String>) {
    notes.for_each(|note| terminal::note(&format!("{}: {note}", folder.root().display())));
}

fn of_stage(list: &mut List, task: &Spec, stage: &StageMeans) {
    let late = &stage.last_tenth;
    list.begin(Part::Stage, format!("stage {}", stage.name));
    list.count("episodes", stage.whole.episodes);
    list.number("return", late.mean_return, Format::Decimals(2));
    list.metrics(task, &late.figures);
    if let Some(multiplier) = stage.multiplier {
        list.number("multiplier", Some(multiplier), Format::Decimals(4));
    }
}

fn evaluations(list: &mut List, folder: &RunFolder) {
    let mut notes = Vec::new();
    let below = evaluations_below(folder, &mut notes).unwrap_or_else(|error| {
        notes.push(format!("{error:#}"));
        Vec::new()
    });
    tell(folder, notes.iter());
    let places = std::iter::once(folder.clone()).chain(below);
    let mut newest: BTreeMap<String, Evaluation> = BTreeMap::new();
    // One that was cut off, or is damaged, has no figures to compare.
    for evaluation in places.filter_map(|place| read_result(&place).ok()) {
        let kind = kind_of(&evaluation);
        if newest.get(&kind).is_none_or(|known| known.cost.at_unix_s <= evaluation.cost.at_unix_s) {
            newest.insert(kind, evaluation);
        }
    }
    for (kind, Evaluation { overall, subject, described, .. }) in newest {
        list.begin(Part::Evaluation, kind);
        list.count("episodes", overall.episodes);
        list.count("trained frames", subject.frames);
        for one in described.iter().filter(|one| !one.label.is_empty()) {
            list.metric(one, overall.get(&one.name));
        }
    }
}

/// What has to be the same for two evaluations to be compared.
fn kind_of(evaluation: &Evaluation) -> String {
    let conditions = &evaluation.conditions;
    let place = place(conditions.split, conditions.procedural, conditions.scenes.len(), None);
    let seeds = seeds_of(conditions.distribution, conditions.split, conditions.episodes);
    let mut kind = seeds.unwrap_or_else(|| place.trim_start_matches("the ").to_owned());
    if conditions.objects != ObjectSet::NoTargets {
        kind = format!("{kind}, {} objects", conditions.objects.name());
    }
    if conditions.distribution == Distribution::Run {
        kind.push_str(", drawn episodes");
    }
    if conditions.deterministic {
        kind.push_str(", deterministic");
    }
    kind
}

/// Has the figures of folders that are one evaluation each stand beside each other, whatever they are of: the
/// configuration names what differs.
pub fn side_by_side(evaluations: &mut [Vec<Figure>]) {
    let kinds: BTreeSet<&str> =
        evaluations.iter().flatten().map(|figure| &*figure.of).filter(|of| !of.is_empty()).collect();
    if kinds.len() > 1 {
        for figure in evaluations.iter_mut().flatten().filter(|figure| figure.part == Part::Evaluation) {
            "evaluation".clone_into(&mut figure.of);
        }
    }
}

pub fn rows(runs: &[Vec<Figure>]) -> Vec<Row> {
    let key = |figure: &Figure| match figure.of.as_str() {
        "" => figure.name.clone(),
        of => format!("{of}: {}", figure.name),
    };
    let mut names: Vec<(Part, String)> = Vec::new();
    for run in runs {
        let mut place = 0;
        for figure in run {
            place = names.iter().position(|(_, name)| *name == key(figure)).unwrap_or_else(|| {
                names.insert(place, (figure.part, key(figure)));
                place
            }) + 1;
        }
    }
    let row = |(_, name): (Part, String)| {
        let found: Vec<_> = runs.iter().map(|run| run.iter().find(|figure| key(figure) == name)).collect();
        let format = found.iter().flatten().next().map_or(Format::Text, |figure| figure.format.clone());
        let of = |figure: Option<&Figure>| {
            figure.map_or((Value::Null, String::new()), |figure| (figure.value.clone(), figure.shown.clone()))
        };
        let (values, shown) = found.into_iter().map(of).unzip();
        Row { name, values, shown, format }
    };
    names.sort_by_key(|(part, _)| *part);
    names.into_iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_that_only_some_have_stand_where_those_have_them() {
        let run = |names: &[&str]| {
            let mut list = List::default();
            for (number, name) in names.iter().enumerate() {
                list.count(*name, number as u64);
            }
            list.figures
        };
        let rows = rows(&[run(&["state", "I", "weights"]), run(&["state", "I", "II", "weights", "test"])]);
        let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names, ["state", "I", "II", "weights", "test"]);
        assert_eq!(rows[2].values, [Value::Null, json!(2)]);
        assert_eq!(rows[3].shown, ["2", "3"]);
    }

    #[test]
    fn evaluations_stand_behind_all_stages() {
        let run = |names: &[(Part, &str)]| {
            let mut list = List::default();
            for (part, name) in names {
                let (of, name) = name.split_once(": ").expect("a part of its own");
                list.begin(*part, of);
                list.count(name, 1);
            }
            list.figures
        };
        let (kitchens, seeds) = ((Part::Evaluation, "kitchens: SR"), (Part::Evaluation, "seeds: score"));
        let two = run(&[(Part::Stage, "I: return"), (Part::Stage, "I: SR"), (Part::Stage, "II: SR"), kitchens]);
        let one = run(&[(Part::Stage, "I: return"), (Part::Stage, "I: score"), seeds]);
        let names = |runs: &[Vec<Figure>]| rows(runs).into_iter().map(|row| row.name).collect::<Vec<_>>();
        let stages = ["I: return", "I: score", "I: SR", "II: SR"];
        let seeds_first = [&stages[..], &["seeds: score", "kitchens: SR"]].concat();
        assert_eq!(names(&[two.clone(), one.clone()]), seeds_first);
        assert_eq!(names(&[one, two])[4..], ["kitchens: SR", "seeds: score"]);
        let alone = [kitchens, (Part::Evaluation, "seeds: SR")].map(|one| run(&[one]));
        assert_eq!(names(&alone), ["seeds: SR", "kitchens: SR"]);
        let mut evaluations = alone;
        side_by_side(&mut evaluations);
        assert_eq!(rows(&evaluations)[0].shown, ["1", "1"]);
        assert_eq!(names(&evaluations), ["evaluation: SR"]);
    }
}
