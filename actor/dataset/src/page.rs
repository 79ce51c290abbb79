//! The page that says what is in a folder: names, units, and how to read it.

use crate::fields::FIELDS;
use crate::source::{Size, Source};
use proto::dataset::DatasetFormat;
use std::fmt::Write;

/// `README.md`.
pub fn page(format: DatasetFormat, source: &Source, size: Size, cameras: &[String]) -> String {
    let Size { episodes, steps, .. } = size;
    let mut page = String::new();
    if format == DatasetFormat::LeRobot {
        page.push_str("---\ntags:\n- LeRobot\n- robotics\nconfigs:\n- config_name: default\n");
        page.push_str("  data_files: data/*/*.parquet\n---\n\n");
    }
    let _ = write!(
        page,
        "# Episodes of Stillroom\n\n{episodes} episodes, {steps} steps. They were simulated again from recorded \
         actions, and every state was the recorded one. `config.toml` is the configuration of the run.\n\n{}\n",
        reading(format)
    );
    page.push_str("| name | what |\n|---|---|\n");
    let (goal, cell): (&str, fn(&str) -> String) = match format {
        DatasetFormat::LeRobot => ("observation.state", |name| format!("observation.images.{name}")),
        DatasetFormat::Parquet => ("goal_x_m, goal_y_m, goal_z_m", |name| format!("{name}_png")),
        DatasetFormat::Npz => ("goal_m", |name| format!("{name}_{}", if name == "depth" { "mm" } else { "rgb" })),
    };
    for camera in cameras {
        let what = match camera.as_str() {
            "depth" => "depth along the robot's camera's axis before the action, 16 bits, millimetres, 0: nothing seen",
            "robot" => "what the robot's camera would see in colour before the action",
            _ => "the room from outside before the action",
        };
        let _ = writeln!(page, "| {} | {what} |", cell(camera));
    }
    let _ = writeln!(
        page,
        "| {goal} | goal vector before the action, robot's frame (x right, y up, z ahead), metres: wrist to target, \
         and while it is held between target and goal, with the sign of `network.carried_goal` |"
    );
    for field in &FIELDS {
        let name = if format == DatasetFormat::LeRobot { field.lerobot } else { Some(field.name) };
        if let Some(name) = name {
            let _ = writeln!(page, "| {name} | {} |", field.about);
        }
    }
    let names: Vec<String> =
        source.actions.iter().enumerate().map(|(number, name)| format!("{number} {name}")).collect();
    let _ = write!(page, "\nActions: {}.\n", names.join(", "));
    page
}

fn reading(format: DatasetFormat) -> &'static str {
    match format {
        DatasetFormat::LeRobot => {
            "A LeRobotDataset v3: `LeRobotDataset(\"local/stillroom\", root=\"this folder\")`. Frames are PNGs in the data, \
             depth of 16 bits: its reader returns it as integers of millimetres, and its statistics are in millimetres, \
             too. `timestamp` counts five steps a second; an action has no duration. All that begins with `next.` is of \
             the moment after the action; `next.reward` is r′.\n"
        }
        DatasetFormat::Parquet => {
            "`steps.parquet` has a row an action, `episodes.parquet` a row an episode, in the same order: its steps begin \
             at row `first_row`. Frames are PNGs: `PIL.Image.open(io.BytesIO(png))`. What was seen after the last action \
             is in `episodes.parquet`, in the columns that begin with `last_`; `fixed_episode` is -1 outside of \
             evaluations. All else is of the moment after the action. Its metadata name the actions.\n"
        }
        DatasetFormat::Npz => {
            "An archive an episode: `numpy.load(\"episode-000000.npz\")`. Frames, `goal_m`, `previous_action` and \
             `state_hash` have a row before each action and one after the last; all else has a row an action, of the \
             moment after it. Without rows: `kitchen`, `environment`, `episode`, `fixed_episode` (-1 outside of \
             evaluations), `target`, `outcome`, `seed`.\n"
        }
    }
}
