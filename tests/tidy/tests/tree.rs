//! The sources of this workspace keep to the rules.

use std::collections::BTreeSet;
use std::path::Path;

/// Findings that the tree still has, one key a line.
const KNOWN: &str = include_str!("known.txt");

#[test]
fn the_sources_of_the_workspace_are_tidy() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let tree = tidy::Tree::tracked(&root).expect("the workspace is a Git checkout");
    let findings = tidy::findings(&tree);
    if let Some(path) = std::env::var_os("TIDY_LIST") {
        let text: String = findings.iter().map(|finding| format!("{finding}\n")).collect();
        std::fs::write(path, text).expect("a writable list");
    }
    let known: BTreeSet<&str> = KNOWN.lines().filter(|line| !line.is_empty()).collect();
    let found: BTreeSet<String> = findings.iter().map(tidy::Finding::key).collect();
    let new = findings.iter().filter(|finding| !known.contains(finding.key().as_str()));
    let gone = known.iter().filter(|key| !found.contains(**key));
    let mut wrong: Vec<String> = new.map(ToString::to_string).collect();
    wrong.extend(gone.map(|key| format!("mended, so take it out of the list of known findings: {key}")));
    assert!(wrong.is_empty(), "{} findings:\n{}", wrong.len(), wrong.join("\n"));
}
