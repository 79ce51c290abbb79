use super::action_source::PolicyKind;
use proto::kitchen::KitchenId;
use serde::Serialize;
use serde_json::{Value, json};
use std::io::{self, Write};

/// What was measured in one kitchen under one policy with so many environments.
#[derive(Debug, Clone, Serialize)]
pub struct Measurement {
    pub kitchen: KitchenId,
    pub policy: PolicyKind,
    pub environments: u32,
    /// Processor time of a step without a frame, seconds.
    pub physics_s: f64,
    /// Processor time of a frame that is drawn whole, seconds.
    pub depth_s: f64,
    /// Processor time of a step and its frame as a rollout takes them, seconds.
    pub whole_step_s: f64,
    /// Finest triangles of the bodies in the view volume, mean over frames.
    pub view_set_triangles: f64,
}

/// The median and the worst of a figure over kitchens, where more is worse.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Spread {
    median: f64,
    worst: f64,
}

impl Spread {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(f64::total_cmp);
        assert!(!sorted.is_empty(), "a table has at least one kitchen");
        let half = sorted.len() / 2;
        let median = if sorted.len() % 2 == 1 { sorted[half] } else { f64::midpoint(sorted[half - 1], sorted[half]) };
        Self { median, worst: sorted[sorted.len() - 1] }
    }
}

pub fn table(out: &mut impl Write, rows: &[Measurement]) -> io::Result<()> {
    writeln!(
        out,
        "{:>7} {:>4}  {:>26}  {:>28}  {:>26}  {:>15}",
        "policy", "envs", "physics /s", "depth, full redraw /s", "whole step /s", "triangles"
    )?;
    let mut shown = Vec::new();
    for row in rows {
        let key = (row.policy, row.environments);
        if shown.contains(&key) {
            continue;
        }
        shown.push(key);
        let alike = || rows.iter().filter(|other| (other.policy, other.environments) == key);
        let cell = |figure: fn(&Measurement) -> f64| {
            let spread = Spread::of(alike().map(figure));
            format!("{:.0} (slowest {:.0})", 1.0 / spread.median, 1.0 / spread.worst)
        };
        // Fewest triangles are the worst case for a claim about many.
        let triangles = Spread::of(alike().map(|row| -row.view_set_triangles));
        writeln!(
            out,
            "{:>7} {:>4}  {:>26}  {:>28}  {:>26}  {:>15}",
            row.policy.name(),
            row.environments,
            cell(|row| row.physics_s),
            cell(|row| row.depth_s),
            cell(|row| row.whole_step_s),
            format!("{:.0} (≥ {:.0})", -triangles.median, -triangles.worst),
        )?;
    }
    Ok(())
}

pub fn json(rows: &[Measurement]) -> Value {
    json!({ "measurements": rows })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_and_worst() {
        assert_eq!(Spread::of([3.0, 1.0, 2.0].into_iter()), Spread { median: 2.0, worst: 3.0 });
        assert_eq!(Spread::of([4.0, 1.0].into_iter()), Spread { median: 2.5, worst: 4.0 });
    }
}
