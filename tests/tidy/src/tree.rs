//! The sources of a workspace: texts by path, and the crates among them.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// Why a checkout cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TreeError {
    /// Git cannot be started.
    #[error("`git ls-files` in {root}: {source}")]
    Git {
        /// The checkout.
        root: String,
        /// Why.
        source: std::io::Error,
    },
    /// Git refuses.
    #[error("`git ls-files` in {root}: {message}")]
    NotTracked {
        /// The checkout.
        root: String,
        /// What Git printed.
        message: String,
    },
    /// A tracked file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
}

/// Files by path relative to the root; what is not text has an empty text.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    pub(crate) files: BTreeMap<String, String>,
}

/// What a crate is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A library.
    Library,
    /// A program.
    Binary,
    /// A test, an example, a benchmark or a build script.
    Other,
}

/// One crate of a package.
#[derive(Clone, Debug)]
pub(crate) struct CrateRoot {
    /// The name by which other crates import it.
    pub name: String,
    /// What it is for.
    pub kind: Kind,
    /// Its root file.
    pub path: String,
}

impl Tree {
    /// The tracked files of a checkout that are there; a deleted file that is still in the index is passed over.
    pub fn tracked(root: &Path) -> Result<Self, TreeError> {
        let name = || root.display().to_string();
        let output = Command::new("git")
            .arg("-C")
            .arg(root)
            .args(["ls-files", "-z"])
            .output()
            .map_err(|source| TreeError::Git { root: name(), source })?;
        if !output.status.success() {
            let message = String::from_utf8_lossy(&output.stderr).trim().to_owned();
            return Err(TreeError::NotTracked { root: name(), message });
        }
        let mut tree = Self::default();
        for path in String::from_utf8_lossy(&output.stdout).split_terminator('\0') {
            let bytes = match std::fs::read(root.join(path)) {
                Ok(bytes) => bytes,
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => continue,
                Err(source) => return Err(TreeError::Read { path: path.to_owned(), source }),
            };
            tree.add(path, &String::from_utf8(bytes).unwrap_or_default());
        }
        Ok(tree)
    }

    /// Adds a file.
    pub fn add(&mut self, path: &str, text: &str) {
        self.files.insert(path.to_owned(), text.to_owned());
    }

    /// The crates of all packages, by Cargo's conventions and the paths that a manifest names.
    pub(crate) fn targets(&self) -> Vec<CrateRoot> {
        let manifests = self.files.iter().filter(|(path, _)| path.rsplit('/').next() == Some("Cargo.toml"));
        manifests.flat_map(|(path, text)| self.package(path, text)).collect()
    }

    fn package(&self, manifest: &str, text: &str) -> Vec<CrateRoot> {
        let table: toml::Table = text.parse().unwrap_or_default();
        let Some(package) = table.get("package").and_then(|package| package.get("name")?.as_str()) else {
            return vec![];
        };
        let folder = manifest.strip_suffix("Cargo.toml").unwrap_or_default();
        let library = table.get("lib").and_then(|library| library.get("name")?.as_str()).unwrap_or(package);
        let mut found: Vec<CrateRoot> = vec![];
        for path in self.files.range(folder.to_owned()..).map_while(|(path, _)| path.strip_prefix(folder)) {
            let parts: Vec<&str> = path.split('/').collect();
            let (name, kind) = match parts[..] {
                ["src", "lib.rs"] => (library, Kind::Library),
                ["src", "main.rs"] => (package, Kind::Binary),
                ["src", "bin", name] | ["src", "bin", name, "main.rs"] => (name, Kind::Binary),
                ["build.rs"] => ("build", Kind::Other),
                ["tests" | "examples" | "benches", name] | ["tests" | "examples" | "benches", name, "main.rs"] => {
                    (name, Kind::Other)
                }
                _ => continue,
            };
            if ending(path) == "rs" {
                let name = name.trim_end_matches(".rs").replace('-', "_");
                found.push(CrateRoot { name, kind, path: format!("{folder}{path}") });
            }
        }
        found
    }
}

/// The ending of a file's name, without the dot.
pub(crate) fn ending(path: &str) -> &str {
    let name = path.rsplit('/').next().unwrap_or_default();
    name.rsplit_once('.').map_or("", |(_, ending)| ending)
}
