//! Which runs there are, and what they are called in addresses.

use proto::evaluation::RESULT_FILE;
use proto::run_folder::RunFolder;
use std::path::{Path, PathBuf};
use view::data::Card;

/// Depth of the search for runs below a given folder.
const DEPTH: usize = 3;
/// More runs than this are not listed.
const RUNS_MAX: usize = 2000;

/// A run or an evaluation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// In addresses: letters, digits, `-`, `_` and `.`; never a path.
    pub id: String,
    /// Its folder, as the user called it.
    pub folder: PathBuf,
}

impl Entry {
    /// All that is known of it without reading it.
    pub fn card(&self) -> Card {
        Card { id: self.id.clone(), folder: self.folder.display().to_string(), ..Card::default() }
    }
}

/// The runs of some paths. A run keeps its name as long as the program runs.
#[derive(Debug)]
pub struct Roster {
    paths: Vec<PathBuf>,
    /// With their real paths.
    named: Vec<(PathBuf, Entry)>,
}

impl Roster {
    /// Of these run folders, or folders that hold runs.
    pub fn of(paths: Vec<PathBuf>) -> Self {
        Self { paths, named: Vec::new() }
    }

    /// Those that are there now.
    pub fn look(&mut self) -> Vec<Entry> {
        let mut found = Vec::new();
        for path in &self.paths {
            look(path, DEPTH, &mut found);
        }
        found.truncate(RUNS_MAX);
        let mut entries: Vec<Entry> = Vec::new();
        for folder in found {
            let Ok(place) = std::fs::canonicalize(&folder) else { continue };
            let entry = self.name(place, folder);
            if entries.iter().all(|known| known.id != entry.id) {
                entries.push(entry);
            }
        }
        entries
    }

    fn name(&mut self, place: PathBuf, folder: PathBuf) -> Entry {
        if let Some((_, known)) = self.named.iter().find(|(known, _)| *known == place) {
            return known.clone();
        }
        let name = address_of(&place);
        let is_free = |id: &str| self.named.iter().all(|(_, known)| known.id != id);
        let numbered = (2..).map(|number| format!("{name}-{number}"));
        let id = std::iter::once(name.clone()).chain(numbered).find(|id| is_free(id)).unwrap_or_default();
        let entry = Entry { id, folder };
        self.named.push((place, entry.clone()));
        entry
    }
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

/// Runs and evaluations at or below a folder; of a run's folder only its evaluations are searched.
fn look(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) {
    if found.len() >= RUNS_MAX {
        return;
    }
    let run = RunFolder::new(folder);
    if run.identity().is_file() || folder.join(RESULT_FILE).is_file() {
        found.push(folder.to_path_buf());
        let evaluations = folder.join("evaluations");
        if evaluations.is_dir() && depth > 0 {
            below(&evaluations, depth - 1, found);
        }
    } else if depth > 0 {
        below(folder, depth - 1, found);
    }
}

fn below(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    // A link could lead round in a circle.
    let folders = entries.filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()));
    let mut folders: Vec<PathBuf> = folders.map(|entry| entry.path()).collect();
    folders.sort();
    for folder in folders {
        look(&folder, depth, found);
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

    #[test]
    fn runs_are_found_and_keep_their_names() {
        let root = tempfile::tempdir().unwrap();
        for path in ["a/x", "b/x", "b/x/evaluations/e", "b/strange name?", "deep/er/and/deeper/still"] {
            run(root.path(), path);
        }
        let mut roster = Roster::of(vec![root.path().to_path_buf(), root.path().join("a")]);
        let names = |roster: &mut Roster| roster.look().into_iter().map(|entry| entry.id).collect::<Vec<_>>();
        assert_eq!(names(&mut roster), ["x", "strange-name-", "x-2", "x.e"], "each once, four levels down");
        std::fs::remove_dir_all(root.path().join("a")).unwrap();
        assert_eq!(names(&mut roster), ["strange-name-", "x-2", "x.e"], "names do not move on");
    }

    #[test]
    fn a_name_is_never_a_way_out() {
        for path in ["/a/..", "/", "/a/\u{2025}/b c/<script>"] {
            let name = address_of(Path::new(path));
            assert!(!name.is_empty() && !name.contains(['/', '<', ' ']) && name != "..", "{name}");
        }
    }
}
