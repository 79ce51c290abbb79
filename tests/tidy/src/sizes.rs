//! Lengths of files.

use crate::tree::ending;
use crate::{Finding, Rule, Tree};

/// The most lines of a source file.
const FILE_LINES: usize = 600;
/// Endings of sources that are written by hand.
const SOURCES: [&str; 7] = ["rs", "py", "cpp", "cu", "h", "c", "proto"];

/// Files that are too long.
pub(crate) fn findings(tree: &Tree) -> Vec<Finding> {
    let sources = tree.files.iter().filter(|(path, _)| SOURCES.contains(&ending(path)));
    let long = sources.filter(|(_, text)| text.lines().count() > FILE_LINES);
    long.map(|(path, _)| Finding {
        path: path.clone(),
        line: 1,
        rule: Rule::LongFile,
        what: format!("file of more than {FILE_LINES} lines"),
        detail: String::new(),
    })
    .collect()
}
