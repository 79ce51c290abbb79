//! Holds the sources of the workspace to rules that neither rustc nor clippy has. (Clippy measures functions: clippy.toml.)
//!
//! [`findings`] takes a [`Tree`] of sources and returns what breaks a rule: one [`Finding`] each, with its place and
//! what to do. It does no I/O; [`Tree::tracked`] is the shell that reads a checkout.
//!
//! ```
//! let mut tree = tidy::Tree::default();
//! tree.add("Cargo.toml", "[package]\nname = \"small\"\n");
//! tree.add("src/lib.rs", "//! Small.\npub fn broken( {}\n");
//! let found = tidy::findings(&tree);
//! assert_eq!(found[0].rule, tidy::Rule::Unreadable);
//! ```

mod circles;
mod finding;
mod modules;
mod openings;
mod paths;
mod syntax;
mod tree;

pub use finding::{Finding, Rule};
pub use tree::Tree;

/// All findings in a tree, in the order of their places.
pub fn findings(tree: &Tree) -> Vec<Finding> {
    let (sources, mut found) = syntax::parse(tree);
    let targets: Vec<_> = tree.targets().iter().map(|target| modules::Target::load(target, &sources)).collect();
    found.extend(circles::findings(&targets));
    found.extend(openings::findings(&targets));
    found.sort();
    found.dedup();
    found
}
