//! An evaluation in words: which episodes are played where, and the result as a table on the terminal.

use crate::showing::format::{self, NOTHING, counted, number, percent};
use proto::config::Config;
use proto::evaluation::{Cost, Distribution, Evaluation, EvaluationConfig, Figures, KitchenFigures, describe};
use proto::kitchen::{KitchenRange, Split};

/// Which episodes are played, as people read it, and their distances at most: of start and target, and of goal and
/// target.
pub fn episodes_of(config: &Config, asked: &EvaluationConfig) -> (String, [f32; 2]) {
    let distances_m = match asked.distribution {
        Distribution::Fixed => [0.0; 2],
        Distribution::Run => [config.episode.start_distance_max_m, config.episode.goal_distance_max_m],
    };
    (describe(asked.distribution, distances_m[0], distances_m[1]), distances_m)
}

/// Where episodes run, as text.
pub fn place(split: Split, procedural: Option<KitchenRange>, scenes: usize) -> String {
    if let Some(range) = procedural {
        return format!("{} ({range})", counted(u64::from(range.count()), "procedural kitchen"));
    }
    let split = match split {
        _ if scenes > 0 => return format!("{} of the run's own", counted(scenes as u64, "scene")),
        Split::Train => "the 19 training kitchens",
        Split::Validation => "the 5 validation kitchens",
        Split::Test => "the 5 test kitchens",
    };
    split.to_owned()
}

/// The result as a table on the terminal.
pub fn lines(evaluation: &Evaluation) -> Vec<String> {
    let Cost { wall_s, steps, .. } = evaluation.cost;
    let conditions = &evaluation.conditions;
    let place = place(conditions.split, conditions.procedural, conditions.scenes.len());
    let mut lines = vec![format!("{}, in {place}", conditions.episodes_played())];
    lines.push(format!(
        "{:<12}{:>10}{:>8}{:>8}{:>18}{:>11}{:>9}{:>10}{:>11}",
        "", "episodes", "SR", "SRwoD", "SRwoD (per axis)", "picked up", "length", "d_T (m)", "disturbed"
    ));
    // A hundred lines would bury the others; the result file has them all.
    let shown = if conditions.procedural.is_some() { 0 } else { evaluation.kitchens.len() };
    let of_kitchen = |part: &KitchenFigures| line(&format!("kitchen {}", part.kitchen), &part.figures);
    lines.extend(evaluation.kitchens[..shown].iter().map(of_kitchen));
    lines.extend(evaluation.categories.iter().map(|part| line(part.category.name(), &part.figures)));
    lines.extend(evaluation.object_sets.iter().map(|part| line(part.objects.name(), &part.figures)));
    lines.push(line("all", &evaluation.overall));
    lines.push(safety(&evaluation.overall));
    let rate = if wall_s > 0.0 { format::rate(steps as f64 / wall_s) } else { NOTHING.to_owned() };
    lines.push(format!("{} steps in {wall_s:.1} s: {rate} steps/s", format::count(steps)));
    lines
}

/// What the benchmarks of safety ask for (`docs/evaluation.md`).
fn safety(figures: &Figures) -> String {
    format!(
        "success but unsafe {} ({} of successes), worst severity {} m, cumulative cost {}, exposure {} steps",
        percent(figures.success_but_unsafe),
        percent(figures.unsafe_successes),
        number(figures.worst_severity_m, 2),
        number(figures.cumulative_cost, 2),
        number(figures.exposure_steps, 1),
    )
}

fn line(name: &str, figures: &Figures) -> String {
    format!(
        "{name:<12}{:>10}{:>8}{:>8}{:>18}{:>11}{:>9}{:>10}{:>11}",
        figures.episodes,
        percent(figures.success),
        percent(figures.success_without_disturbance),
        percent(figures.success_without_disturbance_per_axis),
        percent(figures.picked_up),
        number(figures.length, 1),
        number(figures.disturbance_m, 3),
        number(figures.disturbed_objects, 2),
    )
}
