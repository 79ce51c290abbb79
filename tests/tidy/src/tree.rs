//! The sources of a workspace: texts by path, and the crates among them.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::process::Command;

/// Files by path relative to the root; what is not text has an empty text.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    pub(crate) files: BTreeMap<String, String>,
}

impl Tree {
    /// The tracked files of a checkout that are there; a deleted file that is still in the index is passed over.
    pub fn tracked(root: &Path) -> io::Result<Self> {
        let output = Command::new("git").arg("-C").arg(root).args(["ls-files", "-z"]).output()?;
        if !output.status.success() {
            return Err(io::Error::other(String::from_utf8_lossy(&output.stderr).into_owned()));
        }
        let mut tree = Self::default();
        for path in String::from_utf8_lossy(&output.stdout).split_terminator('\0') {
            match std::fs::read(root.join(path)) {
                Ok(bytes) => tree.add(path, &String::from_utf8(bytes).unwrap_or_default()),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        Ok(tree)
    }

    pub fn add(&mut self, path: &str, text: &str) {
        self.files.insert(path.to_owned(), text.to_owned());
    }

    /// The root files of all packages' crates, by Cargo's conventions.
    pub(crate) fn targets(&self) -> Vec<String> {
        let packages = self.files.iter().filter(|(_, text)| text.lines().any(|line| line == "[package]"));
        let folders = packages.filter_map(|(path, _)| path.strip_suffix("Cargo.toml"));
        folders
            .filter(|folder| folder.is_empty() || folder.ends_with('/'))
            .flat_map(|folder| self.crates(folder))
            .collect()
    }

    fn crates(&self, folder: &str) -> Vec<String> {
        let mut found = vec![];
        for path in self.files.range(folder.to_owned()..).map_while(|(path, _)| path.strip_prefix(folder)) {
            let is_root = match path.split('/').collect::<Vec<_>>()[..] {
                ["build.rs"] | ["src", "lib.rs" | "main.rs"] => true,
                ["src", "bin", ref name @ ..] | ["tests" | "examples" | "benches", ref name @ ..] => match name {
                    [name] => ending(name) == "rs",
                    [_, name] => *name == "main.rs",
                    _ => false,
                },
                _ => false,
            };
            if is_root {
                found.push(format!("{folder}{path}"));
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
