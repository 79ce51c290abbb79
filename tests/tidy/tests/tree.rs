//! The sources of this workspace keep to the rules.

use std::path::Path;

#[test]
fn the_sources_of_the_workspace_are_tidy() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let tree = tidy::Tree::tracked(&root).expect("the workspace is a Git checkout");
    let findings: Vec<String> = tidy::findings(&tree).iter().map(ToString::to_string).collect();
    assert!(findings.is_empty(), "{} findings:\n{}", findings.len(), findings.join("\n"));
}
