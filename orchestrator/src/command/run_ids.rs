//! Ids of runs, which every output prints, in the place of their folders.

use crate::viewer::RunReaders;
use proto::run_folder::RunFolder;
use std::ffi::OsString;
use std::path::Path;
use view::data::Runs;

/// Hex digits.
const LENGTH: usize = 12;

/// A command line in which the id of one run or evaluation below `runs` stands for its folder.
pub fn with_folders(words: impl Iterator<Item = OsString>, runs: &Path) -> Vec<OsString> {
    let folder_of = |id: &str| {
        let folders = RunReaders::once(vec![runs.to_owned()]).list().into_iter().map(|card| card.folder);
        let mut found = folders.filter(|folder| RunFolder::new(folder).id().as_deref() == Some(id));
        // Of a run and its copy nobody can say which is meant.
        found.next().filter(|_| found.next().is_none())
    };
    let known = |word: OsString| {
        let id = word.to_str().filter(|id| id.len() == LENGTH && id.bytes().all(|digit| digit.is_ascii_hexdigit()));
        id.filter(|id| !Path::new(id).exists()).and_then(folder_of).map_or(word.clone(), OsString::from)
    };
    words.map(known).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::identity::Identity;
    use proto::config::Config;

    #[test]
    fn an_id_stands_for_the_folder_of_its_run_where_there_is_one() {
        let temporary = tempfile::tempdir().unwrap();
        let identity = Identity { id: "1e4cc6a0d333".to_owned(), ..Identity::new().unwrap() };
        let begin = |name: &str| {
            let run = RunFolder::new(temporary.path().join(name));
            std::fs::create_dir(run.root()).unwrap();
            std::fs::write(run.config(), Config::resolve("demo", None).unwrap().to_toml()).unwrap();
            identity.write(&run).unwrap();
            run.root().as_os_str().to_owned()
        };
        let of = |id: &str| with_folders([id.into()].into_iter(), temporary.path()).remove(0);
        let first = begin("first");
        assert_eq!(
            [of("1e4cc6a0d333"), of("1e4cc6a0d334"), of("status")],
            [first, "1e4cc6a0d334".into(), "status".into()]
        );
        begin("copy");
        assert_eq!(of("1e4cc6a0d333"), "1e4cc6a0d333");
    }
}
