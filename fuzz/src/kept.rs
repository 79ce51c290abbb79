//! The inputs that fuzzing has kept, for the ordinary tests.

use std::path::{Path, PathBuf};

/// Takes each kept input of a target as the target does: those of its folder `accepted` are, those of `refused` are
/// not. The name of the one that panics is the last that is printed.
pub fn each(target: &str, take: impl Fn(&[u8]) -> bool) {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut above = own.ancestors().map(|folder| folder.join("fuzz/corpus").join(target));
    let folder = above.find(|folder| folder.is_dir()).expect("a target has a corpus");
    let mut otherwise = Vec::new();
    for (kind, accepted) in [("accepted", true), ("refused", false)] {
        let inputs = files(&folder.join(kind));
        assert!(!inputs.is_empty(), "{target} keeps no input that is {kind}");
        for input in inputs {
            println!("{}", input.display());
            if take(&std::fs::read(&input).expect("an input can be read")) != accepted {
                otherwise.push(format!("not {kind}: {}", input.display()));
            }
        }
    }
    assert!(otherwise.is_empty(), "{otherwise:#?}");
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("the corpus can be read");
    let mut files: Vec<_> = entries.map(|entry| entry.expect("the corpus can be read").path()).collect();
    files.sort();
    files
}
