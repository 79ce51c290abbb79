//! `metrics.jsonl`: one JSON object a trained rollout, each rollout once, in order.
//!
//! The orchestrator appends what it hears. It may miss something: a learner whose orchestrator was killed finishes its
//! update and saves before it exits, and the file can be damaged. A checkpoint holds the figures of all rollouts before
//! it, so whenever a learner begins, the file is made to say what its checkpoint says: missing lines are added, and
//! those behind it removed, because these rollouts are trained again.

use crate::output::format::counted;
use crate::run::checkpoints::newest_readable;
use crate::run::json_lines::{Writer, is_content};
use anyhow::{Context, Result};
use proto::bounded::FIGURES_BYTES_MOST;
use proto::checkpoint::Manifest;
use proto::disk::LocalDisk;
use proto::run_folder::{RunFolder, write_pieces_atomically_on};
use proto::trained::{History, Trained};
use std::io::ErrorKind;
use std::ops::RangeInclusive;
use std::path::Path;

fn read_file(folder: &RunFolder) -> std::io::Result<Option<(History, usize)>> {
    match folder.reader(&folder.metrics(), FIGURES_BYTES_MOST).and_then(History::read) {
        Ok(read) => Ok(Some(read)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// The rollouts in the file, whatever the checkpoints say: for a look at a run that goes on.
pub fn read_history(folder: &RunFolder) -> Result<History> {
    let read = read_file(folder).with_context(|| folder.metrics().display().to_string())?;
    Ok(read.map(|(history, _)| history).unwrap_or_default())
}

pub struct Figures {
    pub history: History,
    pub notes: Vec<String>,
}

impl Figures {
    /// Reads a run's folder. `at_rest`: nobody works on the run, so the file should have all that the checkpoint has. A
    /// file that cannot be read is left out, and named.
    pub fn read(folder: &RunFolder, at_rest: bool) -> Self {
        let mut unreadable = None;
        let file = read_file(folder).unwrap_or_else(|error| {
            unreadable = Some(left_out("metrics.jsonl", &error));
            Some((History::default(), 0))
        });
        let is_missing = file.is_none();
        let (history, damaged) = file.unwrap_or_default();
        let mut figures = Self { history, notes: Vec::new() };
        figures.complete(folder, at_rest, is_missing, damaged);
        figures.notes.extend(unreadable);
        figures
    }

    /// Adds what only the newest checkpoint has to what was read of the file, whether that is missing and how many damaged
    /// lines it has.
    pub fn complete(&mut self, folder: &RunFolder, at_rest: bool, is_missing: bool, damaged: usize) {
        let Self { history, notes } = self;
        let (newest, unreadable) = newest_readable(folder).unwrap_or_else(|error| (None, vec![error]));
        notes.extend(unreadable.first().map(|error| format!("{error:#}")));
        let trained = newest.as_ref().map_or(0, |manifest| manifest.rollout);
        let is_missing = is_missing && trained > 0;
        if is_missing {
            notes.push("metrics.jsonl is missing".to_owned());
        }
        if damaged > 0 {
            notes.push(format!("metrics.jsonl has {}", counted(damaged as u64, "damaged line")));
        }
        let read = |path: &Path, most: u64| folder.read(path, most);
        let of_checkpoint = newest.map_or(Ok(None), |manifest| manifest.figures(folder, read));
        let added = match of_checkpoint {
            Ok(figures) => figures.map_or(0, |figures| history.fill(&figures)),
            Err(error) => {
                notes.push(error.to_string());
                0
            }
        };
        if added > 0 && (at_rest || is_missing || damaged > 0) {
            let rollouts = counted(added as u64, "rollout");
            notes.push(format!("the figures of {rollouts} are not in metrics.jsonl and are taken from the checkpoint"));
        }
        let end = history.iter().next_back().map_or(0, |last| last.rollout + 1);
        let gaps = history.gaps(if at_rest { end.max(trained) } else { end });
        notes.extend(lost(&gaps));
    }
}

pub fn left_out(name: &str, error: &std::io::Error) -> String {
    format!("{name} is left out: {error}")
}

fn lost(gaps: &[RangeInclusive<u64>]) -> Option<String> {
    let named = |gap: &RangeInclusive<u64>| match (gap.start(), gap.end()) {
        (first, last) if first == last => first.to_string(),
        (first, last) => format!("{first} to {last}"),
    };
    let named: Vec<String> = gaps.iter().map(named).collect();
    let are = "are lost: neither metrics.jsonl nor the checkpoint has them, and all means are without them";
    (!named.is_empty()).then(|| format!("the figures of rollouts {} {are}", named.join(", ")))
}

pub struct Journal {
    folder: RunFolder,
    writer: Writer,
    pub history: History,
}

impl Journal {
    pub fn open(folder: &RunFolder) -> Result<Self> {
        let read = read_file(folder).with_context(|| folder.metrics().display().to_string())?;
        let (history, damaged) = read.unwrap_or_default();
        if damaged > 0 {
            tracing::warn!("metrics.jsonl has {}", counted(damaged as u64, "damaged line"));
        }
        Ok(Self { folder: folder.clone(), writer: Writer::open(&folder.metrics())?, history })
    }

    pub fn begin(&mut self, rollout: u64, checkpoint: Option<&str>) -> Result<()> {
        self.history.rewind_to(rollout);
        if let Some(path) = checkpoint {
            let manifest = Manifest::read_in(&self.folder, &self.folder.root().join(path));
            match manifest
                .map_err(anyhow::Error::from)
                .and_then(|manifest| Ok(manifest.figures(&self.folder, |path, most| self.folder.read(path, most))?))
            {
                Ok(figures) => {
                    let added = figures.map_or(0, |figures| self.history.correct(&figures));
                    if added > 0 {
                        let rollouts = counted(added as u64, "rollout");
                        tracing::info!("metrics.jsonl lacked the figures of {rollouts}: they are taken from {path}");
                    }
                }
                Err(error) => tracing::warn!("the figures of checkpoint {path} cannot be used: {error:#}"),
            }
        }
        if let Some(lost) = lost(&self.history.gaps(rollout)) {
            tracing::warn!("{lost}");
        }
        self.mend().map(drop)
    }

    pub fn append(&mut self, trained: Trained) -> Result<()> {
        let is_there = self.writer.is_of(&self.folder.metrics());
        if is_there {
            self.writer.append(&trained)?;
        }
        self.history.insert(trained);
        if !is_there {
            tracing::warn!("metrics.jsonl was removed or replaced while the run went on: it is written anew");
            self.mend()?;
        }
        Ok(())
    }

    pub fn close(&mut self) -> Result<()> {
        if self.mend()? {
            tracing::warn!("metrics.jsonl was changed while the run went on: it is written anew");
        }
        Ok(())
    }

    fn mend(&mut self) -> Result<bool> {
        let path = self.folder.metrics();
        let line = |trained: &Trained| {
            let mut line = Vec::new();
            trained.encode(&mut line);
            line
        };
        let differs = !is_content(&path, self.history.iter().map(line));
        if differs {
            write_pieces_atomically_on(&LocalDisk, &path, self.history.pieces())
                .with_context(|| format!("cannot write {}", path.display()))?;
            self.writer = Writer::open(&path)?;
        }
        Ok(differs)
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::run::checkpoints::tests::manifest;
    use crate::training::means::tests::history;
    use proto::digest::sha256;

    /// A run whose newest checkpoint stands before rollout 6, with the figures of all before, and whose file has seven.
    pub fn run() -> (tempfile::TempDir, RunFolder) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        std::fs::create_dir_all(folder.checkpoints()).unwrap();
        let figures = history(6).encode();
        std::fs::write(folder.checkpoint_figures(6), &figures).unwrap();
        let mut six = Manifest::open(&manifest(6, 300)).unwrap();
        six.figures_sha256 = sha256(&figures);
        std::fs::write(folder.checkpoint_manifest(6), six.seal()).unwrap();
        std::fs::write(folder.checkpoint_manifest(3), manifest(3, 150)).unwrap();
        std::fs::write(folder.metrics(), history(7).encode()).unwrap();
        (temporary, folder)
    }

    fn text(folder: &RunFolder) -> String {
        std::fs::read_to_string(folder.metrics()).unwrap()
    }

    /// The file of [`run`] without these lines, and with garbage in their place.
    fn damage(folder: &RunFolder, lines: &[usize]) {
        let text = text(folder);
        let line = |(number, line)| if lines.contains(&number) { "{\"rollout\": garbage" } else { line };
        let lines: Vec<&str> = text.lines().enumerate().map(line).collect();
        std::fs::write(folder.metrics(), lines.join("\n") + "\n").unwrap();
    }

    #[test]
    fn a_checkpoint_of_an_older_version_changes_nothing() {
        let (_temporary, folder) = run();
        damage(&folder, &[1]);
        let mut journal = Journal::open(&folder).unwrap();
        journal.begin(3, Some("checkpoints/rollout-00000003.json")).unwrap();
        let kept: Vec<u64> = journal.history.iter().map(|trained| trained.rollout).collect();
        assert_eq!(kept, [0, 2]);
        assert_eq!(History::decode(text(&folder).as_bytes()), (journal.history.clone(), 0));
    }
}
