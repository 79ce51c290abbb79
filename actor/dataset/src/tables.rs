//! Two Parquet tables: `steps.parquet`, a row an action, and `episodes.parquet`, a row an episode.

use crate::column::{Column, Values};
use crate::episode::{Episode, Frames};
use crate::error::DatasetError;
use crate::fields::FIELDS;
use crate::source::Source;
use crate::table::Table;
use parquet::data_type::ByteArray;
use proto::reward::UNDISTURBED_THRESHOLD_M;
use proto::step::transition_flag;
use std::path::{Path, PathBuf};

/// Names of a goal vector's coordinates.
const GOAL: [&str; 3] = ["goal_x_m", "goal_y_m", "goal_z_m"];

/// Tables that are written.
pub struct Tables {
    folder: PathBuf,
    facts: [(&'static str, String); 1],
    steps: Option<Table>,
    episodes: Option<Table>,
    episode_count: i64,
    step_count: i64,
}

impl Tables {
    /// In this folder.
    pub fn new(folder: &Path, source: &Source) -> Self {
        let actions = serde_json::to_string(&source.actions).unwrap_or_default();
        let facts = [("actions", actions)];
        let folder = folder.to_path_buf();
        Self { folder, facts, steps: None, episodes: None, episode_count: 0, step_count: 0 }
    }

    /// Adds an episode.
    pub fn add(&mut self, episode: &Episode) -> Result<(), DatasetError> {
        let rows = episode.steps.len();
        let steps = self.steps_of(episode);
        let row = self.row_of(episode);
        let (folder, facts) = (&self.folder, &self.facts);
        let table = |name: &str, columns: &[Column]| Table::create(&folder.join(name), columns, facts);
        let (steps_table, episodes_table) = match (&mut self.steps, &mut self.episodes) {
            (Some(steps), Some(episodes)) => (steps, episodes),
            (no_steps, no_episodes) => {
                (no_steps.insert(table("steps.parquet", &steps)?), no_episodes.insert(table("episodes.parquet", &row)?))
            }
        };
        steps_table.add(steps, rows)?;
        episodes_table.add(row, 1)?;
        self.episode_count += 1;
        self.step_count += rows as i64;
        Ok(())
    }

    /// Writes the rest.
    pub fn finish(&mut self) -> Result<(), DatasetError> {
        [self.steps.take(), self.episodes.take()].into_iter().flatten().try_for_each(Table::finish)
    }

    fn steps_of(&self, episode: &Episode) -> Vec<Column> {
        let rows = episode.steps.len();
        let about = &episode.about;
        let mut columns = vec![
            Column::same("episode_index", self.episode_count, rows),
            Column::new("step", Values::Int((0..rows as i64).collect())),
            Column::same("kitchen", i64::from(about.kitchen), rows),
            Column::same("environment", i64::from(about.environment), rows),
            Column::same("episode", i64::from(about.number), rows),
            Column::text("target", std::iter::repeat_n(about.target, rows)),
        ];
        columns.extend(episode.cameras.iter().map(|frames| pngs(frames.name, "", &frames.frames[..rows])));
        for (axis, name) in GOAL.into_iter().enumerate() {
            let values = episode.seen[..rows].iter().map(|seen| seen.goal_m[axis]).collect();
            columns.push(Column::new(name, Values::Real(values)));
        }
        columns.extend(FIELDS.iter().map(|field| Column::new(field.name, field.values(episode))));
        columns
    }

    /// The episode's row: with what was seen after its last action, which belongs to no step.
    fn row_of(&self, episode: &Episode) -> Vec<Column> {
        let about = &episode.about;
        let rows = episode.steps.len() as i64;
        let int = |name: &str, number: i64| Column::same(name, number, 1);
        let real = |name: &str, number: f32| Column::new(name, Values::Real(vec![number]));
        let last = episode.steps.last().map(|step| step.transition).unwrap_or_default();
        let success = last.flags & transition_flag::SUCCESS != 0;
        let undisturbed = success && last.disturbance_m < UNDISTURBED_THRESHOLD_M;
        let sum = |which: usize| episode.steps.iter().map(|step| f64::from(step.rewards[which])).sum::<f64>();
        let mut columns = vec![
            int("episode_index", self.episode_count),
            int("first_row", self.step_count),
            int("steps", rows),
            int("kitchen", i64::from(about.kitchen)),
            int("environment", i64::from(about.environment)),
            int("episode", i64::from(about.number)),
            int("fixed_episode", about.fixed.map_or(-1, i64::from)),
            Column::text("target", [about.target]),
            Column::text("outcome", [about.outcome]),
            Column::new("success", Values::Bool(vec![success])),
            Column::new("success_without_disturbance", Values::Bool(vec![undisturbed])),
            Column::new("return_r", Values::Double(vec![sum(0)])),
            Column::new("return_r_prime", Values::Double(vec![sum(1)])),
            real("disturbance_m", last.disturbance_m),
            real("peak_disturbance_m", last.peak_disturbance_m),
            int("disturbed_objects", i64::from(last.disturbed_objects)),
            int("ever_disturbed_objects", i64::from(last.ever_disturbed_objects)),
            Column::new("seed", Values::Hash(vec![about.seed as i64])),
        ];
        let at = episode.steps.len();
        let frames = |frames: &Frames| pngs(frames.name, "last_", &frames.frames[at..=at]);
        columns.extend(episode.cameras.iter().map(frames));
        let goal_m = episode.seen[at].goal_m;
        columns.extend(GOAL.iter().zip(goal_m).map(|(name, value)| real(&format!("last_{name}"), value)));
        columns
    }
}

fn pngs(camera: &str, prefix: &str, frames: &[Vec<u8>]) -> Column {
    let values: Vec<ByteArray> = frames.iter().map(|png| png.clone().into()).collect();
    Column::new(&format!("{prefix}{camera}_png"), Values::Bytes(values))
}
