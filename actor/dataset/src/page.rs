//! The page that says what is in a folder: names, units, and how to read it.

use crate::fields::FIELDS;
use std::fmt::Write;

/// What a data set is of.
#[derive(Debug, Clone)]
pub struct Source {
    /// Names of the actions, in the order of their numbers.
    pub actions: Vec<&'static str>,
    /// Configurations of the run, TOML.
    pub configs: Vec<String>,
}

/// How large a data set is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Size {
    pub episodes: u64,
    pub steps: u64,
    /// Bytes of all files.
    pub bytes: u64,
}

const READING: &str = "\
An archive an episode: `numpy.load(\"episode-000000.npz\")`. Frames, `goal_m`, `previous_action` and `state_hash` have a row \
before each action and one after the last; all else has a row an action, of the moment after it. Without rows: `kitchen`, \
`environment`, `episode`, `fixed_episode` (-1 outside of evaluations), `target`, `outcome`, `seed`, and `action_names`. \
`python -m stillroom.dataset lerobot|parquet THIS_FOLDER OUT` makes a LeRobotDataset or Parquet tables of it.\n";

/// `README.md`.
pub fn page(source: &Source, size: Size, cameras: &[String]) -> String {
    let Size { episodes, steps, .. } = size;
    let mut page = format!(
        "# Episodes of Stillroom\n\n{episodes} episodes, {steps} steps. They were simulated again from recorded \
         actions, and every state was the recorded one. `config.toml` is the configuration of the run.\n\n{READING}\n\
         | name | what |\n|---|---|\n"
    );
    for camera in cameras {
        let (unit, what) = match camera.as_str() {
            "depth" => ("mm", "depth along the robot's camera's axis, uint16, millimetres, 0: nothing seen"),
            "robot" => ("rgb", "what the robot's camera would see in colour"),
            _ => ("rgb", "the room from outside"),
        };
        let _ = writeln!(page, "| {camera}_{unit} | {what} |");
    }
    let _ = writeln!(
        page,
        "| goal_m | goal vector, robot's frame (x right, y up, z ahead), metres: wrist to target, and while it is held \
         between target and goal, with the sign of `network.carried_goal` |"
    );
    page += "| previous_action | number of the action before, or how many actions there are |\n\
             | state_hash | hash of the simulator's state |\n";
    for field in &FIELDS {
        let _ = writeln!(page, "| {} | {} |", field.name, field.about);
    }
    let names: Vec<String> =
        source.actions.iter().enumerate().map(|(number, name)| format!("{number} {name}")).collect();
    let _ = write!(page, "\nActions: {}.\n", names.join(", "));
    page
}
