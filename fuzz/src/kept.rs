//! The inputs that fuzzing has kept, for the ordinary tests.

use std::path::Path;

/// Takes each kept input of a target as the target does, and returns how many there are. The name of the one that
/// panics is the last that is printed.
pub fn each(target: &str, take: impl Fn(&[u8])) -> usize {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut above = own.ancestors().map(|folder| folder.join("fuzz/corpus").join(target));
    let folder = above.find(|folder| folder.is_dir()).expect("a target has a corpus");
    let entries = std::fs::read_dir(folder).expect("the corpus can be read");
    let files = entries.map(|entry| entry.expect("the corpus can be read").path());
    let mut files: Vec<_> = files.collect();
    files.sort();
    for file in &files {
        println!("{}", file.display());
        take(&std::fs::read(file).expect("an input can be read"));
    }
    files.len()
}
