use super::settings::Row;
use crate::evaluation::text::{place, seeds_of};
use crate::output::format::{self, shown};
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
use proto::task::Spec;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

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
    name: String,
    value: Value,
    shown: String,
}

const DIGITS: usize = 12;

#[derive(Debug, Default)]
struct List {
    part: Part,
    figures: Vec<Figure>,
}

impl List {
    fn put(&mut self, name: impl Into<String>, value: impl Into<Value>, shown: String) {
        self.figures.push(Figure { part: self.part, name: name.into(), value: value.into(), shown });
    }

    fn count(&mut self, name: impl Into<String>, value: u64) {
        self.put(name, value, format::count(value));
    }

    fn number(&mut self, name: impl Into<String>, value: Option<f64>, decimals: usize) {
        self.put(name, json!(value), format::number(value, decimals));
    }

    fn metrics(&mut self, of: &str, task: &Spec, figures: &BTreeMap<String, f64>) {
        for metric in task.shown() {
            let value = metric.mean(figures);
            self.put(format!("{of}: {}", with_unit(&metric.label, &metric.unit)), json!(value), shown(&metric, value));
        }
    }
}

/// A mean of figures that are shown as this one.
pub fn as_shown(mean: f64, one: &str) -> String {
    let decimals = one.rsplit_once('.').map_or(0, |(_, decimals)| decimals.len());
    match one {
        _ if one.ends_with('%') => format::percent(Some(mean)),
        // Of figures a time alone has spaces.
        _ if one.contains(' ') => format::duration(Duration::try_from_secs_f64(mean).unwrap_or_default()),
        _ if decimals > 0 => format::number(Some(mean), decimals),
        _ => format::count(mean.round() as u64),
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
    list.put("state", state.clone(), state);
    if let Some(summary) = summary {
        list.put("weights", summary.weights.clone(), summary.weights.chars().take(DIGITS).collect());
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
    let rate = frames_per_s(&history);
    list.put("frames/s, mean", json!(rate), rate.map_or_else(String::new, format::rate));
    let wall_s = Wall::of(identity, &signs_of_life(&history), !at_rest).all_starts_s;
    let wall = Duration::try_from_secs_f64(wall_s).unwrap_or_default();
    list.put("wall time", wall_s, format::duration(wall));
    list.part = Part::Stage;
    for stage in by_stage(&config.stages, &history) {
        of_stage(list, config.spec(), &stage);
    }
    list.part = Part::Validation;
    if let Some(best) = best(&scores, config.spec()) {
        list.metrics("best validation", config.spec(), &best.figures);
        list.count("best validation: at frame", best.frames);
    }
}

fn tell<'a>(folder: &RunFolder, notes: impl Iterator<Item = &'a String>) {
    notes.for_each(|note| terminal::note(&format!("{}: {note}", folder.root().display())));
}

fn of_stage(list: &mut List, task: &Spec, stage: &StageMeans) {
    let (late, of) = (&stage.last_tenth, format!("stage {}", stage.name));
    let name = |what: &str| format!("{of}: {what}");
    list.count(name("episodes"), stage.whole.episodes);
    list.number(name("return"), late.mean_return, 2);
    list.metrics(&of, task, &late.figures);
    if let Some(multiplier) = stage.multiplier {
        list.number(name("multiplier"), Some(multiplier), 4);
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
    list.part = Part::Evaluation;
    for (kind, Evaluation { overall, subject, described, .. }) in newest {
        let name = |what: &str| format!("{kind}: {what}");
        list.count(name("episodes"), overall.episodes);
        list.count(name("trained frames"), subject.frames);
        for one in described.iter().filter(|one| !one.label.is_empty()) {
            let figure = overall.get(&one.name);
            list.put(name(&with_unit(&one.label, &one.unit)), json!(figure), shown(one, figure));
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

pub fn rows(runs: &[Vec<Figure>]) -> Vec<Row> {
    let mut names: Vec<(Part, &str)> = Vec::new();
    for run in runs {
        let mut place = 0;
        for figure in run {
            place = names.iter().position(|(_, name)| *name == figure.name).unwrap_or_else(|| {
                names.insert(place, (figure.part, &figure.name));
                place
            }) + 1;
        }
    }
    let row = |name: &str| {
        let of = |run: &'_ Vec<Figure>| run.iter().find(|figure| figure.name == name).cloned();
        let (values, shown) = runs
            .iter()
            .map(|run| of(run).map_or((Value::Null, String::new()), |figure| (figure.value, figure.shown)))
            .unzip();
        Row { name: name.to_owned(), values, shown }
    };
    names.sort_by_key(|(part, _)| *part);
    names.into_iter().map(|(_, name)| row(name)).collect()
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
                list.part = *part;
                list.count(*name, 1);
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
    }
}
