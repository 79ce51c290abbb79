//! The sources of this workspace keep to the rules.
//!
//! `known.txt` holds what they still break, one key a line: neither more nor less. `TIDY_ACCEPT=1` writes it anew.

use std::collections::BTreeSet;
use std::path::Path;

/// Findings that the tree still has.
const KNOWN: &str = include_str!("known.txt");

#[test]
fn the_sources_of_the_workspace_are_tidy() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let tree = tidy::Tree::tracked(&package.join("../..")).expect("the workspace is a Git checkout");
    let findings = tidy::findings(&tree);
    let found: BTreeSet<String> = findings.iter().map(tidy::Finding::key).collect();
    if std::env::var_os("TIDY_ACCEPT").is_some() {
        let text = found.into_iter().map(|key| key + "\n").collect::<String>();
        std::fs::write(package.join("tests/known.txt"), text).expect("a writable checkout");
        return;
    }
    let known: BTreeSet<&str> = KNOWN.lines().collect();
    let new = findings.iter().filter(|finding| !known.contains(finding.key().as_str()));
    let gone = known.iter().filter(|key| !found.contains(**key));
    let mut wrong: Vec<String> = new.map(ToString::to_string).collect();
    wrong.extend(gone.map(|key| format!("mended, so take it out of the list of known findings: {key}")));
    assert!(wrong.is_empty(), "{} findings:\n{}", wrong.len(), wrong.join("\n"));
}
