use crate::suite::is_suite;
use proto::evaluation::RESULT_FILE;
use proto::run_folder::{Item, RunFolder};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use view::data::Card;

/// A suite's folder, its runs, one of them, its evaluations.
const DEPTH: usize = 4;
const RUNS_MAX: usize = 2000;
const FOLDERS_MAX: usize = 20_000;
const PROBLEMS_MAX: usize = 10;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// In addresses: letters, digits, `-`, `_` and `.`; never a path.
    pub id: String,
    pub folder: RunFolder,
    /// Folder of the suite that it is of.
    pub suite: Option<PathBuf>,
}

impl Entry {
    pub fn card(&self) -> Card {
        let name = self.suite.as_ref().and_then(|suite| suite.file_name());
        let suite = name.map(|name| name.to_string_lossy().into_owned());
        Card { id: self.id.clone(), suite, folder: self.folder.root().display().to_string(), ..Card::default() }
    }
}

pub struct Roster {
    paths: Vec<PathBuf>,
    named: Vec<(PathBuf, Entry)>,
    pub left_out: Vec<Card>,
}

#[derive(Default)]
struct Look {
    found: Vec<RunFolder>,
    folders: usize,
    left_out: Vec<Card>,
}

impl Roster {
    pub fn of(paths: Vec<PathBuf>) -> Self {
        Self { paths, named: Vec::new(), left_out: Vec::new() }
    }

    pub fn look(&mut self) -> Vec<Entry> {
        let mut look = Look::default();
        for path in &self.paths {
            look.at(&RunFolder::new(path), DEPTH);
        }
        let Look { found, left_out, .. } = look;
        self.left_out = left_out;
        let mut entries: Vec<Entry> = Vec::new();
        for folder in found {
            let Ok(place) = std::fs::canonicalize(folder.root()) else { continue };
            let entry = self.name(place, folder);
            if entries.iter().all(|known| known.id != entry.id) {
                entries.push(entry);
            }
        }
        entries
    }

    fn name(&mut self, place: PathBuf, folder: RunFolder) -> Entry {
        if let Some((_, known)) = self.named.iter().find(|(known, _)| *known == place) {
            return known.clone();
        }
        let name = address_of(&place);
        let is_free = |id: &str| self.named.iter().all(|(_, known)| known.id != id);
        let numbered = (2..).map(|number| format!("{name}-{number}"));
        let id = std::iter::once(name.clone()).chain(numbered).find(|id| is_free(id)).unwrap_or_default();
        let entry = Entry { id, folder, suite: suite_of(&place) };
        self.named.push((place, entry.clone()));
        entry
    }
}

/// The suite of a run or of a run's evaluation.
fn suite_of(place: &Path) -> Option<PathBuf> {
    [2, 4].into_iter().filter_map(|up| place.ancestors().nth(up)).find(|root| is_suite(root)).map(Path::to_owned)
}

/// A folder's name with nothing in it that means something in an address. An evaluation in a run's folder is called
/// after both.
fn address_of(place: &Path) -> String {
    let part = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let own = part(place);
    let name = match place.parent() {
        Some(parent) if part(parent) == "evaluations" => {
            format!("{}.{own}", parent.parent().map(part).unwrap_or_default())
        }
        _ => own,
    };
    let allowed = |letter: char| letter.is_ascii_alphanumeric() || matches!(letter, '-' | '_' | '.');
    let name: String = name.chars().map(|letter| if allowed(letter) { letter } else { '-' }).collect();
    // Dots alone would be folders.
    if name.trim_matches('.').is_empty() { "run".to_owned() } else { name }
}

impl Look {
    /// Finds runs and evaluations at or below a folder; of a run's folder only its evaluations are searched. No link is
    /// followed.
    fn at(&mut self, folder: &RunFolder, depth: usize) {
        if self.found.len() == RUNS_MAX || self.folders == FOLDERS_MAX {
            let said =
                format!("{RUNS_MAX} runs were found, or {FOLDERS_MAX} folders looked at: the others are left out");
            if self.left_out.iter().all(|card| card.problem.as_ref() != Some(&said)) {
                self.leave_out(folder, said);
            }
            return;
        }
        self.folders += 1;
        let items = self.items_of(folder);
        let marks = [folder.identity(), folder.root().join(RESULT_FILE)];
        let is_run = items.iter().any(|item| !item.is_folder && marks.contains(&item.path));
        if is_run {
            self.found.push(folder.clone());
        }
        let searched = if is_run { folder.within("evaluations") } else { folder.clone() };
        let below = if is_run { self.items_of(&searched) } else { items };
        for name in below.iter().filter(|item| item.is_folder && depth > 0).filter_map(|item| item.path.file_name()) {
            self.at(&searched.within(name), depth - 1);
        }
    }

    fn items_of(&mut self, folder: &RunFolder) -> Vec<Item> {
        folder.list(folder.root()).unwrap_or_else(|error| {
            if error.kind() == ErrorKind::FileTooLarge && self.left_out.len() < PROBLEMS_MAX {
                self.leave_out(folder, error.to_string());
            }
            Vec::new()
        })
    }

    fn leave_out(&mut self, folder: &RunFolder, problem: String) {
        let folder = folder.root().display().to_string();
        self.left_out.push(Card { id: folder.clone(), folder, problem: Some(problem), ..Card::default() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(root: &Path, path: &str) {
        let folder = root.join(path);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("run.toml"), "").unwrap();
    }

    /// The others were left out in silence.
    #[test]
    fn of_more_runs_than_are_listed_a_row_says_so() {
        let root = tempfile::tempdir().unwrap();
        (0..=RUNS_MAX).for_each(|number| run(root.path(), &number.to_string()));
        let mut roster = Roster::of(vec![root.path().to_path_buf()]);
        assert_eq!(roster.look().len(), RUNS_MAX);
        let said: Vec<&str> = roster.left_out.iter().filter_map(|card| card.problem.as_deref()).collect();
        assert_eq!(said, ["2000 runs were found, or 20000 folders looked at: the others are left out"]);
        std::fs::remove_dir_all(root.path().join("7")).unwrap();
        assert_eq!((roster.look().len(), roster.left_out.len()), (RUNS_MAX, 0));
    }

    #[test]
    fn runs_of_a_suite_and_their_evaluations_are_found_with_its_name() {
        let root = tempfile::tempdir().unwrap();
        for path in ["alone", "mini/runs/a", "mini/runs/a/evaluations/b", "own/runs/c"] {
            run(root.path(), path);
        }
        // The file of a suite that a user keeps beside `runs/` makes no suite of the folder.
        for path in ["mini/suite.toml", "mini/suite.json", "own/suite.toml"] {
            std::fs::write(root.path().join(path), "").unwrap();
        }
        let cards = Roster::of(vec![root.path().to_path_buf()]).look().iter().map(Entry::card).collect::<Vec<_>>();
        let mut found: Vec<_> = cards.iter().map(|card| (card.id.as_str(), card.suite.as_deref())).collect();
        found.sort_unstable();
        assert_eq!(found, [("a", Some("mini")), ("a.b", Some("mini")), ("alone", None), ("c", None)]);
    }

    #[test]
    fn a_name_is_never_a_way_out() {
        for path in ["/a/..", "/", "/a/\u{2025}/b c/<script>"] {
            let name = address_of(Path::new(path));
            assert!(!name.is_empty() && !name.contains(['/', '<', ' ']) && name != "..", "{name}");
        }
    }
}
