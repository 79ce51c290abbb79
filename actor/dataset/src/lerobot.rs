//! A `LeRobotDataset` v3: data and episodes in Parquet files of at most 100 MB, facts in JSON. Frames are PNGs inside
//! the data: depth of 16 bits, in millimetres, which a video would not keep exactly.

use crate::column::{Column, Shape, Values};
use crate::episode::{Episode, Frames};
use crate::error::{DatasetError, write};
use crate::fields::FIELDS;
use crate::source::Source;
use crate::stats::Stats;
use crate::table::{Series, Table, bytes_of};
use serde_json::{Value as Json, json};
use std::path::{Path, PathBuf};

const VERSION: &str = "v3.0";
/// Steps a second. An action has no duration; films show as many.
const FPS: u32 = 5;
const FILE_MB: usize = 100;
const FILES_EACH: usize = 1000;
const GOAL: &str = "observation.state";
const GOAL_NAMES: [&str; 3] = ["goal_x_m", "goal_y_m", "goal_z_m"];
/// What tells where a step was recorded.
const PLACES: [&str; 3] = ["kitchen", "environment", "episode_number"];
/// What `LeRobot` demands of every data set, after all others: timestamp, and these.
const INDICES: [&str; 4] = ["frame_index", "episode_index", "index", "task_index"];

/// A data set that is written.
pub struct LeRobot {
    folder: PathBuf,
    data: Series,
    episodes: Series,
    tasks: Vec<String>,
    features: serde_json::Map<String, Json>,
    stats: Vec<(String, Stats)>,
    episode_count: u64,
    step_count: u64,
}

impl LeRobot {
    /// In this folder.
    pub fn new(folder: &Path) -> Self {
        let series = |name: &str| Series::new(folder.join(name), FILE_MB << 20, FILES_EACH);
        Self {
            folder: folder.to_path_buf(),
            data: series("data"),
            episodes: series("meta/episodes"),
            tasks: Vec::new(),
            features: serde_json::Map::new(),
            stats: Vec::new(),
            episode_count: 0,
            step_count: 0,
        }
    }

    /// Adds an episode.
    pub fn add(&mut self, episode: &Episode) -> Result<(), DatasetError> {
        let task = task(episode.about.target);
        let task_index = self.tasks.iter().position(|known| *known == task).unwrap_or(self.tasks.len());
        if task_index == self.tasks.len() {
            self.tasks.push(task.clone());
        }
        if self.features.is_empty() {
            self.features = features(episode);
        }
        let columns = self.columns(episode, task_index as i64);
        let stats = stats_of(episode, &columns);
        self.data.make_room(bytes_of(&columns))?;
        self.data.add(columns, episode.steps.len())?;
        self.episode_row(episode, &task, &stats)?;
        if self.stats.is_empty() {
            self.stats = stats;
        } else {
            self.stats.iter_mut().zip(&stats).for_each(|((_, all), (_, stats))| all.merge(stats));
        }
        self.episode_count += 1;
        self.step_count += episode.steps.len() as u64;
        Ok(())
    }

    /// Writes the rest.
    pub fn finish(&mut self, source: &Source) -> Result<(), DatasetError> {
        self.data.finish()?;
        self.episodes.finish()?;
        let rows = self.tasks.len();
        let columns = vec![
            Column::new("task_index", Values::Int((0..rows as i64).collect())),
            Column::text("task", self.tasks.iter().map(String::as_str)),
        ];
        let facts = [("pandas", index_of_pandas())];
        let mut table = Table::create(&self.folder.join("meta/tasks.parquet"), &columns, &facts)?;
        table.add(columns, rows)?;
        table.finish()?;
        let info = json!({
            "codebase_version": VERSION,
            "robot_type": "stillroom",
            "total_episodes": self.episode_count,
            "total_frames": self.step_count,
            "total_tasks": rows,
            "chunks_size": FILES_EACH,
            "data_files_size_in_mb": FILE_MB,
            "video_files_size_in_mb": 2 * FILE_MB,
            "fps": FPS,
            "splits": {"train": format!("0:{}", self.episode_count)},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": self.features,
            "actions": source.actions,
        });
        let stats: serde_json::Map<String, Json> =
            self.stats.iter().map(|(name, stats)| (name.clone(), stats.json())).collect();
        for (name, content) in [("meta/info.json", info), ("meta/stats.json", Json::Object(stats))] {
            write(&self.folder.join(name), format!("{content:#}\n").as_bytes())?;
        }
        Ok(())
    }

    /// The rows of an episode's steps.
    fn columns(&self, episode: &Episode, task_index: i64) -> Vec<Column> {
        let rows = episode.steps.len();
        let mut columns: Vec<Column> = episode.cameras.iter().map(|frames| picture(frames, rows)).collect();
        let goals = episode.seen[..rows].iter().flat_map(|seen| seen.goal_m).collect();
        columns.push(Column { name: GOAL.to_owned(), shape: Shape::Lists(1), values: Values::Real(goals) });
        for field in &FIELDS {
            if let Some(name) = field.lerobot {
                columns.push(Column::new(name, field.values(episode)));
            }
        }
        let about = &episode.about;
        for (name, number) in PLACES.into_iter().zip([about.kitchen, about.environment, about.number]) {
            columns.push(Column::same(name, i64::from(number), rows));
        }
        let times = (0..rows).map(|step| (step as f64 / f64::from(FPS)) as f32).collect();
        columns.push(Column::new("timestamp", Values::Real(times)));
        let [frame, number, index, task] = INDICES;
        let first = self.step_count as i64;
        columns.push(Column::new(frame, Values::Int((0..rows as i64).collect())));
        columns.push(Column::same(number, self.episode_count as i64, rows));
        columns.push(Column::new(index, Values::Int((first..first + rows as i64).collect())));
        columns.push(Column::same(task, task_index, rows));
        columns
    }

    /// The episode's row among the episodes.
    fn episode_row(&mut self, episode: &Episode, task: &str, stats: &[(String, Stats)]) -> Result<(), DatasetError> {
        let one = |name: &str, number: u64| Column::same(name, number as i64, 1);
        let (length, number) = (episode.steps.len() as u64, self.episode_count);
        let tasks = Values::Text(vec![task.as_bytes().to_vec().into()]);
        let mut columns = vec![
            one("episode_index", number),
            Column { name: "tasks".to_owned(), shape: Shape::Lists(1), values: tasks },
            one("length", length),
            one("data/chunk_index", self.data.at.0 as u64),
            one("data/file_index", self.data.at.1 as u64),
            one("dataset_from_index", self.step_count),
            one("dataset_to_index", self.step_count + length),
            Column::text("outcome", [episode.about.outcome]),
        ];
        for (feature, stats) in stats {
            let named = stats.named().into_iter().map(|(name, values)| (name, stats.depth, Values::Double(values)));
            let count = ("count", 1, Values::Int(vec![stats.count as i64]));
            for (name, depth, values) in named.chain([count]) {
                columns.push(Column { name: format!("stats/{feature}/{name}"), shape: Shape::Lists(depth), values });
            }
        }
        self.episodes.make_room(bytes_of(&columns))?;
        columns.push(one("meta/episodes/chunk_index", self.episodes.at.0 as u64));
        columns.push(one("meta/episodes/file_index", self.episodes.at.1 as u64));
        self.episodes.add(columns, 1)
    }
}

/// What is to be done, in words.
fn task(target: &str) -> String {
    format!("Pick up the {target}, bring it to its goal, and move nothing else.")
}

/// Frames before each action, as a column of pictures.
fn picture(frames: &Frames, rows: usize) -> Column {
    let values = frames.frames[..rows].iter().map(|png| png.clone().into()).collect();
    Column { name: feature(frames.name), shape: Shape::Picture, values: Values::Bytes(values) }
}

fn feature(camera: &str) -> String {
    format!("observation.images.{camera}")
}

/// What `info.json` says of every column.
fn features(episode: &Episode) -> serde_json::Map<String, Json> {
    let mut features = serde_json::Map::new();
    for frames in &episode.cameras {
        let info = if frames.is_depth {
            json!({"unit": "millimetre", "bits": 16, "is_depth_map": true})
        } else {
            json!({"is_depth_map": false})
        };
        let (side, channels) = (frames.side, frames.channels());
        let names = ["height", "width", "channels"];
        let picture = json!({"dtype": "image", "shape": [side, side, channels], "names": names, "info": info});
        features.insert(feature(frames.name), picture);
    }
    features.insert(GOAL.to_owned(), json!({"dtype": "float32", "shape": [3], "names": GOAL_NAMES}));
    let scalar = |kind: &str| json!({"dtype": kind, "shape": [1], "names": null});
    for field in &FIELDS {
        if let Some(name) = field.lerobot {
            features.insert(name.to_owned(), scalar(field.kind(episode)));
        }
    }
    features.extend(PLACES.map(|name| (name.to_owned(), scalar("int64"))));
    features.insert("timestamp".to_owned(), scalar("float32"));
    features.extend(INDICES.map(|name| (name.to_owned(), scalar("int64"))));
    features
}

/// Statistics of an episode's columns.
fn stats_of(episode: &Episode, columns: &[Column]) -> Vec<(String, Stats)> {
    let rows = episode.steps.len();
    let mut stats = Vec::new();
    for column in columns {
        let numbers: Vec<f64> = match &column.values {
            Values::Bool(values) => values.iter().map(|value| f64::from(u8::from(*value))).collect(),
            Values::Int(values) => values.iter().map(|value| *value as f64).collect(),
            Values::Real(values) => values.iter().map(|value| f64::from(*value)).collect(),
            Values::Bytes(_) | Values::Text(_) | Values::Hash(_) | Values::Double(_) => continue,
        };
        stats.push((column.name.clone(), Stats::of(&numbers, numbers.len() / rows)));
    }
    for frames in &episode.cameras {
        stats.push((feature(frames.name), Stats::of_frames(frames, rows)));
    }
    stats
}

/// What makes pandas take the tasks as the table's index, which `LeRobot` looks them up in.
fn index_of_pandas() -> String {
    let column = |name: &str, kind: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": null});
    let names = json!({
        "name": null, "field_name": null, "pandas_type": "unicode", "numpy_type": "object",
        "metadata": {"encoding": "UTF-8"},
    });
    json!({
        "index_columns": ["task"],
        "column_indexes": [names],
        "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
        "creator": {"library": "stillroom", "version": env!("CARGO_PKG_VERSION")},
        "pandas_version": "2.0.0",
    })
    .to_string()
}
