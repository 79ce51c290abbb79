//! What came of one episode, and the table of all of them.

use super::asked::ObjectSet;
use super::confusion::Confusion;
use super::distribution::Distribution;
use crate::kitchen::{KitchenId, TargetCategory};
use crate::reward::UNDISTURBED_THRESHOLD_M;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// How an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeEnd {
    /// The policy declared Done.
    Done,
    /// At the step limit.
    TimeLimit,
}

/// What came of one episode. "At the end" is after its last action. Displacements are of everything movable but
/// the target, from where it stood at step 0, looked at after each action.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    /// Kitchen.
    pub kitchen: KitchenId,
    /// Its number within the kitchen.
    pub episode: u32,
    /// Target.
    pub category: TargetCategory,
    /// How it ended.
    pub end: EpisodeEnd,
    /// Done was declared with the target at its goal.
    pub success: bool,
    /// The target was picked up.
    pub picked_up: bool,
    /// Actions taken.
    pub length: u32,
    /// Actions that failed.
    pub failed_actions: u32,
    /// Undiscounted return under r.
    pub return_r: f64,
    /// Undiscounted return under r′, with the run's `λ_disturb`.
    pub return_r_prime: f64,
    /// `d_T`: total displacement at the end, metres.
    pub disturbance_m: f32,
    /// Largest total displacement after any action, metres.
    pub peak_disturbance_m: f32,
    /// Objects more than 0.01 m from their place on some axis at the end.
    pub disturbed_objects: u32,
    /// Objects that were so after some action.
    pub ever_disturbed_objects: u32,
    /// Displacement of the object that is farthest from its place at the end, metres.
    pub farthest_m: f32,
    /// Largest displacement of any one object after any action, metres.
    pub peak_farthest_m: f32,
    /// Distance of wrist and target at the end, metres.
    pub wrist_object_m: f32,
    /// Distance of target and goal at the end, metres.
    pub object_goal_m: f32,
    /// What the auxiliary head said of the actions taken; none where the policy has no such head.
    pub disturb_prediction: Option<Confusion>,
    /// Hash of the simulator's state at the end.
    pub state_hash: u64,
}

impl EpisodeRecord {
    /// Successful with `d_T` below this threshold, metres.
    pub fn succeeded_within(&self, threshold_m: f32) -> bool {
        self.success && self.disturbance_m < threshold_m
    }

    /// Successful with no object disturbed at the end: moved more than 0.01 m on some axis.
    pub fn succeeded_undisturbed_per_axis(&self) -> bool {
        self.success && self.disturbed_objects == 0
    }

    /// Some object was away from its place during the episode and is back at its end.
    pub(super) fn displaced_temporarily(&self) -> bool {
        self.ever_disturbed_objects > self.disturbed_objects
    }

    /// Novel or seen.
    pub(super) fn object_set(&self) -> ObjectSet {
        if ObjectSet::Novel.contains(self.category) { ObjectSet::Novel } else { ObjectSet::Seen }
    }
}

/// Columns of the table, in order.
const COLUMNS: [&str; 25] = [
    "kitchen",
    "episode",
    "category",
    "objects",
    "end",
    "success",
    "success_without_disturbance",
    "picked_up",
    "length",
    "failed_actions",
    "return_r",
    "return_r_prime",
    "disturbance_m",
    "peak_disturbance_m",
    "disturbed_objects",
    "ever_disturbed_objects",
    "farthest_m",
    "peak_farthest_m",
    "wrist_object_m",
    "object_goal_m",
    "disturb_hits",
    "disturb_misses",
    "disturb_false_alarms",
    "disturb_quiet",
    "state_hash",
];

/// Column that only tables of drawn episodes have, after all others: those of fixed ones stay as they were.
const DISTRIBUTION: &str = "distribution";

/// The table as CSV: a line of names, then a line an episode. Numbers are the shortest that read back the same.
pub fn write_table(records: &[EpisodeRecord], distribution: Distribution) -> String {
    let drawn = distribution == Distribution::Run;
    let mut text = COLUMNS.join(",");
    if drawn {
        text.push(',');
        text.push_str(DISTRIBUTION);
    }
    text.push('\n');
    for record in records {
        let flag = |set: bool| u8::from(set).to_string();
        let confusion = match &record.disturb_prediction {
            Some(Confusion { hits, misses, false_alarms, quiet }) => {
                [hits, misses, false_alarms, quiet].map(ToString::to_string)
            }
            None => Default::default(),
        };
        let end = match record.end {
            EpisodeEnd::Done => "done",
            EpisodeEnd::TimeLimit => "time_limit",
        };
        let mut cells = vec![
            record.kitchen.to_string(),
            record.episode.to_string(),
            record.category.name().to_owned(),
            record.object_set().name().to_owned(),
            end.to_owned(),
            flag(record.success),
            flag(record.succeeded_within(UNDISTURBED_THRESHOLD_M)),
            flag(record.picked_up),
            record.length.to_string(),
            record.failed_actions.to_string(),
            record.return_r.to_string(),
            record.return_r_prime.to_string(),
            record.disturbance_m.to_string(),
            record.peak_disturbance_m.to_string(),
            record.disturbed_objects.to_string(),
            record.ever_disturbed_objects.to_string(),
            record.farthest_m.to_string(),
            record.peak_farthest_m.to_string(),
            record.wrist_object_m.to_string(),
            record.object_goal_m.to_string(),
        ];
        cells.extend(confusion);
        cells.push(format!("{:016x}", record.state_hash));
        if drawn {
            cells.push(distribution.name().to_owned());
        }
        text.push_str(&cells.join(","));
        text.push('\n');
    }
    text
}

/// A table that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct TableError {
    /// Line in the file, from 1.
    pub line: usize,
    /// What is wrong.
    pub problem: String,
}

/// Reads what [`write_table`] wrote. Columns are found by name; further ones are passed over.
pub fn read_table(text: &str) -> Result<Vec<EpisodeRecord>, TableError> {
    let mut lines = text.lines().enumerate();
    let header: Vec<&str> = lines.next().map(|(_, line)| line.split(',').collect()).unwrap_or_default();
    lines
        .map(|(index, line)| {
            let cells: Vec<&str> = line.split(',').collect();
            Row { header: &header, cells: &cells }.record().map_err(|problem| TableError { line: index + 1, problem })
        })
        .collect()
}

struct Row<'a> {
    header: &'a [&'a str],
    cells: &'a [&'a str],
}

impl Row<'_> {
    fn record(&self) -> Result<EpisodeRecord, String> {
        let kitchen: u8 = self.number("kitchen")?;
        let name = self.cell("category")?;
        let category = TargetCategory::ALL.into_iter().find(|category| category.name() == name);
        let disturb_prediction = if self.cell("disturb_hits")?.is_empty() {
            None
        } else {
            Some(Confusion {
                hits: self.number("disturb_hits")?,
                misses: self.number("disturb_misses")?,
                false_alarms: self.number("disturb_false_alarms")?,
                quiet: self.number("disturb_quiet")?,
            })
        };
        Ok(EpisodeRecord {
            kitchen: KitchenId::new(kitchen).map_err(|error| error.to_string())?,
            episode: self.number("episode")?,
            category: category.ok_or_else(|| format!("there is no category `{name}`"))?,
            end: match self.cell("end")? {
                "done" => EpisodeEnd::Done,
                "time_limit" => EpisodeEnd::TimeLimit,
                other => return Err(format!("an episode does not end by `{other}`")),
            },
            success: self.flag("success")?,
            picked_up: self.flag("picked_up")?,
            length: self.number("length")?,
            failed_actions: self.number("failed_actions")?,
            return_r: self.number("return_r")?,
            return_r_prime: self.number("return_r_prime")?,
            disturbance_m: self.number("disturbance_m")?,
            peak_disturbance_m: self.number("peak_disturbance_m")?,
            disturbed_objects: self.number("disturbed_objects")?,
            ever_disturbed_objects: self.number("ever_disturbed_objects")?,
            farthest_m: self.number("farthest_m")?,
            peak_farthest_m: self.number("peak_farthest_m")?,
            wrist_object_m: self.number("wrist_object_m")?,
            object_goal_m: self.number("object_goal_m")?,
            disturb_prediction,
            state_hash: u64::from_str_radix(self.cell("state_hash")?, 16).map_err(|_| "state_hash is no hash")?,
        })
    }

    fn cell(&self, name: &str) -> Result<&str, String> {
        let column = self.header.iter().position(|column| *column == name);
        let cell = column.and_then(|column| self.cells.get(column)).copied();
        cell.ok_or_else(|| format!("there is no {name}"))
    }

    fn number<T: FromStr>(&self, name: &str) -> Result<T, String> {
        let cell = self.cell(name)?;
        cell.parse().map_err(|_| format!("{name} is `{cell}`"))
    }

    fn flag(&self, name: &str) -> Result<bool, String> {
        match self.cell(name)? {
            "1" => Ok(true),
            "0" => Ok(false),
            other => Err(format!("{name} is `{other}`, not 0 or 1")),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::strategy::ValueTree;

    /// Any record that an episode can leave behind.
    pub fn any_record() -> impl Strategy<Value = EpisodeRecord> {
        let metres = || 0.0f32..50.0;
        let task = (0..720u32, any::<bool>(), any::<bool>(), 1..=200u32, 0..200u32, any::<[bool; 2]>());
        let moved = (metres(), metres(), 0..90u32, 0..90u32, metres(), metres());
        let rest = (-100.0f64..100.0, -1e4f64..100.0, metres(), metres(), any::<u64>(), any::<[u16; 4]>());
        let test_kitchens = KitchenId::of_split(crate::kitchen::Split::Test);
        (prop::sample::select(test_kitchens), task, moved, rest).prop_map(|(kitchen, task, moved, rest)| {
            let (episode, done, success, length, failed_actions, [picked_up, head]) = task;
            let (disturbance_m, over_m, disturbed_objects, others, farthest_m, farther_m) = moved;
            let (return_r, return_r_prime, wrist_object_m, object_goal_m, state_hash, counts) = rest;
            let [hits, misses, false_alarms, quiet] = counts.map(u64::from);
            EpisodeRecord {
                kitchen,
                episode,
                category: super::super::category_of(episode),
                end: if done { EpisodeEnd::Done } else { EpisodeEnd::TimeLimit },
                success: done && success,
                picked_up: picked_up || (done && success),
                length,
                failed_actions,
                return_r,
                return_r_prime,
                disturbance_m,
                peak_disturbance_m: disturbance_m + over_m,
                disturbed_objects,
                ever_disturbed_objects: disturbed_objects + others,
                farthest_m,
                peak_farthest_m: farthest_m + farther_m,
                wrist_object_m,
                object_goal_m,
                disturb_prediction: head.then_some(Confusion { hits, misses, false_alarms, quiet }),
                state_hash,
            }
        })
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(records in prop::collection::vec(any_record(), 0..20)) {
            for distribution in [Distribution::Fixed, Distribution::Run] {
                let text = write_table(&records, distribution);
                let drawn = distribution == Distribution::Run;
                prop_assert_eq!(text.lines().count(), records.len() + 1);
                prop_assert!(text.lines().skip(1).all(|line| line.ends_with(",run") == drawn));
                prop_assert!(text.starts_with(&COLUMNS.join(",")) && text.contains(",distribution\n") == drawn);
                prop_assert_eq!(&read_table(&text).unwrap(), &records);
            }
        }
    }

    #[test]
    fn a_broken_table_names_line_and_column() {
        let error = read_table("kitchen,episode\n2,three\n").unwrap_err().to_string();
        assert_eq!(error, "line 2: there is no category");
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        let record = any_record().new_tree(&mut runner).unwrap().current();
        let text = write_table(&[record], Distribution::Fixed).replacen(&format!("\n{},", record.kitchen), "\n28,", 1);
        assert!(read_table(&text).unwrap_err().to_string().starts_with("line 2: "));
    }
}
