//! How a suite stands, from its folder alone: for a look from another process.

use super::file::Suite;
use super::folder::SuiteFolder;
use super::state::{RunStatus, State, Status};
use crate::output::format::counted;
use crate::training::next_steps::program;
use anyhow::{Context, Result};
use proto::run_folder::RunFolder;
use proto::shell::quoted;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

const CUT_OFF: &str = "cut off";

/// The folder of a run, what it is at, and the reason of a failure.
pub type At<'a> = (PathBuf, &'static str, Option<&'a str>);

/// The folders of a suite's runs that have begun.
pub fn begun(root: &Path) -> Result<Vec<PathBuf>> {
    let standing = Standing::read(root)?;
    let runs = standing.each().into_iter().map(|(run, ..)| run);
    Ok(runs.filter(|run| RunFolder::new(run).identity().exists()).collect())
}

pub struct Standing {
    folder: RunFolder,
    name: String,
    runs: BTreeMap<String, RunStatus>,
    /// Whether an `orchestrator suite` works on it: what it was at when it was killed still stands in the file.
    is_held: bool,
}

impl Standing {
    pub fn read(root: &Path) -> Result<Self> {
        let folder = RunFolder::new(root);
        let suite = SuiteFolder::new(root);
        let named = || suite.state().display().to_string();
        let text = folder.read_text(&suite.state()).with_context(named)?;
        let State { runs, .. } = serde_json::from_str(&text).with_context(named)?;
        let is_held = suite.worker()?.is_some();
        let place = std::fs::canonicalize(root).with_context(named)?;
        let name = place.file_name().unwrap_or(place.as_os_str()).to_string_lossy().into_owned();
        Ok(Self { folder, name, runs, is_held })
    }

    fn is_cut_off(&self, status: &Status) -> bool {
        !self.is_held && matches!(status, Status::Training | Status::Evaluating { .. })
    }

    fn word(&self, status: &Status) -> &'static str {
        if self.is_cut_off(status) { CUT_OFF } else { status.word() }
    }

    fn text(&self, status: &Status) -> String {
        if self.is_cut_off(status) { CUT_OFF.to_owned() } else { status.text() }
    }

    /// How many runs it has, and how many of them are at what, e.g. `1 of 2 runs complete, 1 evaluating`.
    pub fn counts(&self) -> String {
        let words = ["training", "evaluating", "waiting", "stopped", CUT_OFF, "failed"];
        let count = |word: &str| self.runs.values().filter(|run| self.word(&run.status) == word).count();
        let mut parts = vec![format!("{} of {} complete", count("complete"), counted(self.runs.len() as u64, "run"))];
        parts.extend(
            words
                .iter()
                .map(|word| (count(word), word))
                .filter(|(count, _)| *count > 0)
                .map(|(count, word)| format!("{count} {word}")),
        );
        parts.join(", ")
    }

    /// The command that goes on with one that nobody works on and that is not complete. Its folder has the file as it was
    /// at the last call.
    pub fn go_on(&self) -> Option<String> {
        let is_complete = self.runs.values().all(|run| run.status == Status::Done);
        let folder = SuiteFolder::new(self.folder.root());
        let [file, root] = [quoted(folder.file()), quoted(folder.root())];
        (!self.is_held && !is_complete).then(|| format!("{} suite {file} --out {root}", program()))
    }

    pub fn summary(&self) -> String {
        format!("suite {}: {}", self.name, self.counts())
    }

    fn suite(&self) -> Option<Suite> {
        let file = SuiteFolder::new(self.folder.root()).file();
        Suite::parse(&self.folder.read_text(&file).ok()?).ok()
    }

    /// As [`Suite::apart`]; of a file that cannot be read nothing.
    pub fn apart(&self) -> Vec<String> {
        self.suite().map_or_else(Vec::new, |suite| suite.apart())
    }

    /// Names and states of all runs in the order of the suite's file; of a file that cannot be read in that of names.
    fn in_order(&self) -> Vec<(&String, &Status)> {
        let order = self.suite().map_or_else(Vec::new, |suite| suite.entries);
        let mut runs: Vec<_> = self.runs.iter().map(|(name, run)| (name, &run.status)).collect();
        runs.sort_by_key(|(name, _)| order.iter().position(|entry| entry.name == **name));
        runs
    }

    /// Each run in the order of the suite's file.
    pub fn each(&self) -> Vec<At<'_>> {
        let runs = self.folder.root().join("runs");
        let in_order = self.in_order().into_iter();
        in_order.map(|(name, status)| (runs.join(name), self.word(status), status.reason())).collect()
    }

    /// Where the run of this folder, or of this folder of an evaluation, stands in the order of the suite's file; and in a
    /// second line what each is at.
    pub fn around(&self, run: &Path) -> String {
        let runs = self.in_order();
        let of_run = || {
            let below = run.strip_prefix(self.folder.root().join("runs")).ok()?;
            let name = below.iter().next()?.to_str()?;
            let number = runs.iter().position(|(run, _)| *run == name)? + 1;
            let status = self.text(&self.runs.get(name)?.status);
            Some(format!("suite {}: run {number} of {}, {status}", self.name, self.runs.len()))
        };
        let each = runs.iter().map(|(name, status)| format!("{name} {}", self.text(status)));
        let each = each.collect::<Vec<_>>().join(", ");
        format!("{}\n{each}", of_run().unwrap_or_else(|| self.summary()))
    }

    /// Its report's page, where there is one.
    pub fn report(&self) -> Option<PathBuf> {
        let page = SuiteFolder::new(self.folder.root()).page();
        self.folder.has(&page).then_some(page)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "seeds = [2, 1]\n[[runs]]\npreset = \"demo\"\nname = \"tiny\"\n";

    #[test]
    fn runs_are_counted_and_stand_in_the_order_of_the_file() {
        let temporary = tempfile::tempdir().unwrap();
        let root = temporary.path().join("small");
        let folder = SuiteFolder::new(&root);
        let lock = folder.open(&Suite::parse(TEXT).unwrap(), TEXT).unwrap();
        assert!(Standing::read(&root).is_err(), "nothing is known yet");
        let evaluating = Status::Evaluating { evaluation: "suite-test-novel-2".to_owned() };
        let runs = [("tiny-2", Status::Done), ("tiny-1", evaluating)];
        let runs = runs.map(|(name, status)| (name.to_owned(), RunStatus { status, tries: 1 })).into();
        State { schema_version: 3, runs }.write(&folder.state()).unwrap();

        let standing = Standing::read(&root).unwrap();
        assert_eq!(standing.summary(), "suite small: 1 of 2 runs complete, 1 evaluating");
        let each = "tiny-2 complete, tiny-1 evaluating (suite-test-novel-2)";
        let runs = ["tiny-2", "tiny-1"].map(|name| root.join("runs").join(name));
        assert_eq!(standing.each(), [(runs[0].clone(), "complete", None), (runs[1].clone(), "evaluating", None)]);
        assert_eq!(begun(&root).unwrap(), [""; 0].map(PathBuf::from));
        std::fs::create_dir_all(&runs[1]).unwrap();
        std::fs::write(RunFolder::new(&runs[1]).identity(), "").unwrap();
        assert_eq!(begun(&root).unwrap(), runs[1..]);
        let at = |path: &str| {
            let lines = standing.around(&root.join(path));
            lines.strip_suffix(&format!("\n{each}")).map(str::to_owned).unwrap()
        };
        assert_eq!(at("runs/tiny-2"), "suite small: run 1 of 2, complete");
        let second = "suite small: run 2 of 2, evaluating (suite-test-novel-2)";
        assert_eq!(at("runs/tiny-1/evaluations/suite-test-novel-2"), second);
        assert_eq!(at("runs/other"), standing.summary());

        assert_eq!((standing.report(), standing.go_on()), (None, None));
        std::fs::create_dir(folder.report()).unwrap();
        std::fs::write(folder.page(), "").unwrap();
        assert_eq!(standing.report(), Some(folder.page()));
        // Its orchestrator was killed.
        drop(lock);
        let standing = Standing::read(&root).unwrap();
        assert_eq!(standing.summary(), "suite small: 1 of 2 runs complete, 1 cut off");
        let go_on = format!(" suite {0}/suite.toml --out {0}", root.display());
        assert!(standing.go_on().unwrap().ends_with(&go_on), "{:?}", standing.go_on());
    }
}
