//! Which runs there are, and what they are called in addresses.

use proto::evaluation::RESULT_FILE;
use proto::run_folder::RunFolder;
use std::path::{Path, PathBuf};
use view::data::Card;

/// Depth of the search for runs below a given folder.
const DEPTH: usize = 3;
/// More runs than this are not listed.
const RUNS_MAX: usize = 2000;
/// Nor are more folders looked at.
const FOLDERS_MAX: usize = 20_000;

/// A run or an evaluation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// In addresses: letters, digits, `-`, `_` and `.`; never a path.
    pub id: String,
    /// Its folder, as the user called it.
    pub folder: RunFolder,
}

impl Entry {
    /// All that is known of it without reading it.
    pub fn card(&self) -> Card {
        Card { id: self.id.clone(), folder: self.folder.root().display().to_string(), ..Card::default() }
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
        let mut left = FOLDERS_MAX;
        for path in &self.paths {
            look(&RunFolder::new(path), DEPTH, &mut found, &mut left);
        }
        found.truncate(RUNS_MAX);
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

/// Runs and evaluations at or below a folder; of a run's folder only its evaluations are searched. No link is followed.
/// `left`: folders that may still be looked at.
fn look(folder: &RunFolder, depth: usize, found: &mut Vec<RunFolder>, left: &mut usize) {
    if found.len() >= RUNS_MAX || *left == 0 {
        return;
    }
    *left -= 1;
    let items = folder.list(folder.root()).unwrap_or_default();
    let marks = [folder.identity(), folder.root().join(RESULT_FILE)];
    let is_run = items.iter().any(|item| !item.is_folder && marks.contains(&item.path));
    if is_run {
        found.push(folder.clone());
    }
    let searched = if is_run { folder.within("evaluations") } else { folder.clone() };
    let below = if is_run { searched.list(searched.root()).unwrap_or_default() } else { items };
    for name in below.iter().filter(|item| item.is_folder && depth > 0).filter_map(|item| item.path.file_name()) {
        look(&searched.within(name), depth - 1, found, left);
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
