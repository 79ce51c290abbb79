//! What a complete run leaves, as far as it must be the same whatever happened: no times, no counts of starts.

use crate::board::{self, Curves};
use crate::recording::Recording;
use crate::{Run, Undisturbed};
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Of a run that trained.
#[derive(Debug)]
pub struct Evidence {
    /// `summary.json`.
    summary: Value,
    /// `metrics.jsonl`: what counts of it, by rollout.
    metrics: BTreeMap<u64, Value>,
    /// `validation.jsonl`, by rollout.
    validation: BTreeMap<u64, Vec<Value>>,
    /// The rollout that `best` names.
    best: Option<u64>,
    tables: BTreeMap<String, String>,
    /// What TensorBoard shows of stages and of validations, but times.
    curves: [Curves; 2],
    /// Files, but those whose number depends on the number of starts.
    files: BTreeSet<String>,
    /// Checkpoints that the run could not write, and said so: they may be missing.
    pub unwritten: BTreeSet<String>,
    pub recording: Recording,
}

/// The lines of a file, without some of their fields; an error for a line that is none.
fn lines(path: &Path, without: &[&str]) -> Result<Vec<Value>> {
    let bytes = std::fs::read(path).unwrap_or_default();
    let whole = bytes.split(|&byte| byte == b'\n').filter(|line| !line.is_empty());
    let value = |line| serde_json::from_slice::<Value>(line).with_context(|| format!("a line of {}", path.display()));
    whole.map(|line| Ok(stripped(value(line)?, without))).collect()
}

fn stripped(mut value: Value, without: &[&str]) -> Value {
    if let Some(object) = value.as_object_mut() {
        object.retain(|key, _| !without.contains(&key.as_str()));
    }
    value
}

/// An evaluation's result file without what depends on time and place.
pub fn result(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let mut value: Value = serde_json::from_str(&text)?;
    if let Some(cost) = value["cost"].as_object_mut() {
        cost.retain(|key, _| key == "steps");
    }
    if let Some(subject) = value["subject"].as_object_mut() {
        subject.retain(|key, _| !["run", "run_id", "checkpoint"].contains(&key.as_str()));
    }
    Ok(value)
}

impl Run {
    /// Asserts that it left what an undisturbed one left.
    pub fn assert_same(&self, undisturbed: &Undisturbed, what: &str) {
        let [ours, theirs] = [self, &undisturbed.run].map(|run| Evidence::read(run).expect("a complete run"));
        assert_eq!(ours.differences(&theirs), Vec::<String>::new(), "{what}");
    }
}

impl Evidence {
    /// Of a complete run.
    pub fn read(run: &Run) -> Result<Self> {
        let folder = &run.folder;
        let text = std::fs::read_to_string(folder.summary()).context("summary.json")?;
        let summary: Value = serde_json::from_str(&text).context("summary.json")?;
        let varying = ["id", "training_s", "frames_per_s", "wall", "incarnations", "recordings"];
        let mut metrics: BTreeMap<u64, Value> = BTreeMap::new();
        for line in lines(&folder.metrics(), &["at_unix_s", "incarnation", "wall_s", "timing"])? {
            let rollout = line["rollout"].as_u64().context("a line of metrics.jsonl names its rollout")?;
            let in_order = metrics.last_key_value().is_none_or(|(last, _)| *last < rollout);
            ensure!(in_order, "metrics.jsonl: rollout {rollout} again, or out of order");
            metrics.insert(rollout, line);
        }
        let mut validation: BTreeMap<u64, Vec<Value>> = BTreeMap::new();
        for line in lines(&folder.validation_log(), &["at_unix_s", "wall_s"])? {
            let rollout = line["rollout"].as_u64().context("a line of validation.jsonl names its rollout")?;
            validation.entry(rollout).or_default().push(line);
        }
        let mut files = BTreeSet::new();
        collect(folder.root(), folder.root(), &mut files)?;
        let tables = files.iter().filter(|path| path.ends_with("episodes.csv"));
        let tables = tables.map(|path| Ok((path.clone(), std::fs::read_to_string(folder.root().join(path))?)));
        let best = folder.best_rollout();
        let curves = [true, false].map(|of_stages| without_times(board::curves(folder, of_stages)));
        Ok(Self {
            summary: stripped(summary, &varying),
            metrics,
            validation,
            best,
            tables: tables.collect::<Result<_>>()?,
            curves,
            recording: Recording::read(run)?,
            files,
            unwritten: BTreeSet::new(),
        })
    }

    /// What differs from an undisturbed run's.
    pub fn differences(&self, reference: &Self) -> Vec<String> {
        let mut found = vec![];
        if self.summary != reference.summary {
            found.push(format!("summary.json: {}", first_difference("", &self.summary, &reference.summary)));
        }
        by_rollout("metrics.jsonl", &self.metrics, &reference.metrics, &mut found);
        by_rollout("validation.jsonl", &self.validation, &reference.validation, &mut found);
        if self.best != reference.best {
            found.push(format!("best: {:?} instead of {:?}", self.best, reference.best));
        }
        if self.tables != reference.tables {
            found.push("tables of the validations differ".to_owned());
        }
        for (what, ours, theirs) in
            [("stages", &self.curves[0], &reference.curves[0]), ("validations", &self.curves[1], &reference.curves[1])]
        {
            by_step(what, ours, theirs, &mut found);
        }
        let may_be_missing =
            |path: &str| self.unwritten.iter().any(|name| path.starts_with(&format!("checkpoints/{name}.")));
        let besides: Vec<_> = self.files.difference(&reference.files).collect();
        let missing = reference.files.difference(&self.files).filter(|path| !may_be_missing(path));
        let missing: Vec<_> = missing.collect();
        if !besides.is_empty() || !missing.is_empty() {
            found.push(format!("files: besides {besides:?}, missing {missing:?}"));
        }
        found.extend(self.recording.differences(&reference.recording));
        found
    }

    /// What is wrong if there are no curves to compare: two runs without any are equal.
    pub fn without_curves(&self) -> Option<String> {
        self.curves[0].is_empty().then(|| "there are no event files of stages".to_owned())
    }

    /// What must hold of a run whose results depend on timing.
    pub fn violations(&self, frames: u64) -> Vec<String> {
        let mut found = vec![];
        if self.summary["frames"].as_u64() != Some(frames) || self.summary["complete"] != Value::Bool(true) {
            found.push(format!("summary.json: {} frames of {frames}", self.summary["frames"]));
        }
        let last = self.metrics.values().next_back().and_then(|line| line["frames"].as_u64());
        if last != Some(frames) {
            found.push(format!("metrics.jsonl: {last:?} frames of {frames}"));
        }
        let rollouts: Vec<u64> = self.metrics.keys().copied().collect();
        if rollouts != (0..rollouts.len() as u64).collect::<Vec<_>>() {
            found.push("metrics.jsonl: rollouts are missing".to_owned());
        }
        let recorded = self.recording.steps_that_count();
        if recorded != frames {
            found.push(format!("recorded steps: {recorded} of {frames}"));
        }
        let partial: Vec<_> = self.files.iter().filter(|path| path.ends_with(".partial")).collect();
        if !partial.is_empty() {
            found.push(format!("files: {partial:?}"));
        }
        found
    }
}

fn collect(root: &Path, folder: &Path, files: &mut BTreeSet<String>) -> Result<()> {
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        let relative = path.strip_prefix(root)?.display().to_string();
        // One recording and one event file for each start, and a log for each that wrote one.
        if relative.starts_with("recordings/")
            || relative.starts_with("tensorboard/")
            || relative.starts_with("logs/")
            || Path::new(&relative).extension().is_some_and(|extension| extension == "log")
        {
            continue;
        }
        if path.is_dir() && !path.is_symlink() {
            collect(root, &path, files)?;
        } else {
            files.insert(relative);
        }
    }
    Ok(())
}

fn without_times(mut curves: Curves) -> Curves {
    for figures in curves.values_mut() {
        figures.retain(|tag, _| !tag.starts_with("time/") && tag != "charts/SPS");
    }
    curves
}

/// Figures are compared as bits: one that is no number is one.
fn by_step(what: &str, ours: &Curves, theirs: &Curves, found: &mut Vec<String>) {
    if ours.keys().ne(theirs.keys()) {
        found.push(format!("event files of {what}: other steps ({} and {})", ours.len(), theirs.len()));
        return;
    }
    for ((step, ours), theirs) in ours.iter().zip(theirs.values()) {
        let bits = |figures: &BTreeMap<String, f32>| -> Vec<(String, u32)> {
            figures.iter().map(|(tag, figure)| (tag.clone(), figure.to_bits())).collect()
        };
        if bits(ours) != bits(theirs) {
            found.push(format!("event files of {what}: step {step}"));
            return;
        }
    }
}

fn by_rollout<T: PartialEq>(file: &str, ours: &BTreeMap<u64, T>, theirs: &BTreeMap<u64, T>, found: &mut Vec<String>) {
    let missing: Vec<_> = theirs.keys().filter(|rollout| !ours.contains_key(rollout)).collect();
    let besides: Vec<_> = ours.keys().filter(|rollout| !theirs.contains_key(rollout)).collect();
    let other: Vec<_> =
        ours.iter().filter(|(rollout, line)| theirs.get(rollout).is_some_and(|their| their != *line)).collect();
    let other: Vec<_> = other.into_iter().map(|(rollout, _)| rollout).collect();
    for (how, rollouts) in [("missing", missing), ("besides", besides), ("other", other)] {
        if !rollouts.is_empty() {
            found.push(format!("{file}: rollouts {how}: {rollouts:?}"));
        }
    }
}

/// The first place at which two values differ.
pub fn first_difference(place: &str, one: &Value, other: &Value) -> String {
    match (one, other) {
        (Value::Object(one), Value::Object(other)) => {
            let keys: BTreeSet<_> = one.keys().chain(other.keys()).collect();
            let differs = keys.into_iter().find(|key| one.get(*key) != other.get(*key));
            let null = &Value::Null;
            differs.map_or_else(String::new, |key| {
                let at = format!("{place}.{key}");
                first_difference(&at, one.get(key).unwrap_or(null), other.get(key).unwrap_or(null))
            })
        }
        (Value::Array(one), Value::Array(other)) if one.len() == other.len() => {
            let differs = one.iter().zip(other).enumerate().find(|(_, (one, other))| one != other);
            differs.map_or_else(String::new, |(index, (one, other))| {
                first_difference(&format!("{place}[{index}]"), one, other)
            })
        }
        _ => format!("{place}: {one} instead of {other}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::run_folder::RunFolder;
    use serde_json::json;

    fn run(folder: &Path, metrics: &[Value]) -> Result<Evidence> {
        let run = Run { folder: RunFolder::new(folder) };
        let folder = &run.folder;
        let summary = json!({ "frames": 10, "complete": true, "training_s": 1.0 });
        std::fs::write(folder.summary(), summary.to_string()).unwrap();
        let lines: Vec<String> = metrics.iter().map(|line| format!("{line}\n")).collect();
        std::fs::write(folder.metrics(), lines.concat()).unwrap();
        Evidence::read(&run)
    }

    #[test]
    fn metrics_are_compared_without_times_and_must_be_in_order() {
        let line = |rollout: u64, at: u64| json!({ "rollout": rollout, "frames": (rollout + 1) * 5, "at_unix_s": at });
        let [one, other, short, twice] = [(); 4].map(|()| tempfile::tempdir().unwrap());
        let reference = run(one.path(), &[line(0, 1), line(1, 2)]).unwrap();
        assert!(run(other.path(), &[line(0, 5), line(1, 6)]).unwrap().differences(&reference).is_empty());
        let error = run(twice.path(), &[line(0, 5), line(1, 6), line(0, 7)]).unwrap_err().to_string();
        assert_eq!(error, "metrics.jsonl: rollout 0 again, or out of order");
        let short = run(short.path(), &[line(0, 5)]).unwrap();
        assert_eq!(short.differences(&reference), ["metrics.jsonl: rollouts missing: [1]"]);
        assert!(short.violations(10).iter().any(|what| what.contains("Some(5) frames of 10")));
    }

    #[test]
    fn a_file_that_is_left_is_a_difference() {
        let [one, other] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let reference = run(one.path(), &[]).unwrap();
        std::fs::write(other.path().join("x.partial"), "").unwrap();
        let left = run(other.path(), &[]).unwrap();
        assert_eq!(left.differences(&reference), ["files: besides [\"x.partial\"], missing []"]);
        assert!(left.violations(10).iter().any(|what| what.contains("x.partial")));
    }

    #[test]
    fn only_a_checkpoint_that_could_not_be_written_may_be_missing() {
        let [one, other] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        std::fs::create_dir(one.path().join("checkpoints")).unwrap();
        for name in ["rollout-00000016.json", "rollout-00000017.json"] {
            std::fs::write(one.path().join("checkpoints").join(name), "").unwrap();
        }
        let reference = run(one.path(), &[]).unwrap();
        let mut ours = run(other.path(), &[]).unwrap();
        ours.unwritten.insert("rollout-00000016".to_owned());
        assert_eq!(
            ours.differences(&reference),
            ["files: besides [], missing [\"checkpoints/rollout-00000017.json\"]"]
        );
    }
}
