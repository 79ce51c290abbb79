//! The page that says what is in a folder: names, units, and how to read it.

use proto::task::Spec;
use std::fmt::Write;

#[derive(Debug, Clone)]
pub struct Source {
    pub spec: &'static Spec,
    /// Names of the run's actions, in the order of their numbers; none where actions are numbers themselves.
    pub actions: Vec<String>,
    /// For each of the task's actions its number among the run's.
    pub numbers: Vec<Option<u32>>,
    pub rewards: Vec<String>,
    pub configs: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Size {
    pub episodes: u64,
    pub steps: u64,
    pub bytes: u64,
}

const READING: &str = "\
An archive an episode: `numpy.load(\"episode-000000.npz\")`. Frames, and what below is *seen*, have a row before each action \
and one after the last; all else has a row an action, of the moment after it. Without rows: `kitchen`, `environment`, \
`episode`, `fixed_episode` (-1 outside of evaluations), `outcome`, `seed`, `task`, a `metric_NAME` for each metric of the \
task, and lists of names: `action_names`, `observation_names`, and `NAME_names` of a number that stands for one of them. \
`python -m stillroom.dataset lerobot|parquet THIS_FOLDER OUT` makes a LeRobotDataset or Parquet tables of it.\n";

pub fn page(source: &Source, size: Size, cameras: &[String]) -> String {
    let Size { episodes, steps, .. } = size;
    let mut page = format!(
        "# Episodes of Stillroom\n\n{episodes} episodes, {steps} steps. They were simulated again from recorded \
         actions, and every state was the recorded one. `config.toml` is the configuration of the run.\n\n{READING}\n\
         | name | what |\n|---|---|\n"
    );
    for camera in cameras {
        let (unit, what) = match camera.as_str() {
            "robot" => ("rgb", "what the robot's camera would see in colour"),
            "outside" => ("rgb", "the room from outside"),
            _ => ("mm", "depth along the robot's camera's axis, uint16, millimetres, 0: nothing seen"),
        };
        let _ = writeln!(page, "| {camera}_{unit} | {what} |");
    }
    for column in source.columns() {
        let seen = if column.is_seen { "seen: " } else { "" };
        let _ = writeln!(page, "| {} | {seen}{} |", column.name, column.about);
    }
    for metric in &source.spec.metrics {
        let _ = writeln!(page, "| metric_{} | {} |", metric.name, metric.doc);
    }
    let names: Vec<String> =
        source.actions.iter().enumerate().map(|(number, name)| format!("{number} {name}")).collect();
    if !names.is_empty() {
        let _ = write!(page, "\nActions: {}.\n", names.join(", "));
    }
    page
}
