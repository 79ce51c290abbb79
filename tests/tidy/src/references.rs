//! References to files in comments and documents.
//!
//! Looked at are code spans and links, and words that end in `.rs` or `.md`. A path may begin at the root or at any
//! folder below it. Where a path can only be in a run folder or in another project, its first folder is in
//! [`ELSEWHERE`].

use crate::modules::join;
use crate::tree::ending;
use crate::{Finding, Rule, Tree};
use std::collections::BTreeSet;

/// First folders of paths that are not in the repository: run folders, what Git ignores, the sources of other projects.
const ELSEWHERE: [&str; 18] = [
    "ATen",
    "RUN",
    "allenact",
    "allenact_plugins",
    "build",
    "checkpoints",
    "cleanrl",
    "evaluations",
    "gloo",
    "logs",
    "manipulathor_baselines",
    "projects",
    "recordings",
    "runs",
    "target",
    "torch",
    "utils",
    "validation",
];
/// Endings that only sources and documents have: a name with one of these is a file of ours.
const OURS: [&str; 7] = ["rs", "md", "py", "cpp", "cu", "h", "proto"];
/// Endings that files of a run have, too: a reference to ours begins with a folder of the root.
const SHARED: [&str; 7] = ["toml", "json", "png", "bin", "safetensors", "txt", "csv"];
/// Tells what was, of which not all is still there.
const HISTORY: &str = "CHANGELOG.md";

/// References to what is not there.
pub(crate) fn findings(tree: &Tree) -> Vec<Finding> {
    let places = Places::of(tree);
    let mut found = vec![];
    for (path, text) in tree.files.iter().filter(|(path, _)| *path != HISTORY) {
        for (line, comment) in comments(path, text) {
            let what = places.dead(path, &comment).into_iter().map(|name| format!("`{name}` is not there"));
            found.extend(what.map(|what| Finding {
                path: path.clone(),
                line,
                rule: Rule::DeadReference,
                what,
                detail: String::new(),
            }));
        }
    }
    found
}

struct Places<'a> {
    tree: &'a Tree,
    folders: BTreeSet<&'a str>,
    roots: BTreeSet<&'a str>,
}

impl<'a> Places<'a> {
    fn of(tree: &'a Tree) -> Self {
        let mut folders = BTreeSet::new();
        for path in tree.files.keys() {
            let ends = path.match_indices('/').map(|(at, _)| at);
            folders.extend(ends.map(|at| &path[..at]));
        }
        let roots = folders.iter().copied().filter(|folder| !folder.contains('/')).collect();
        Self { tree, folders, roots }
    }

    /// The dead references in a comment of `document`.
    fn dead(&self, document: &str, comment: &str) -> Vec<String> {
        let mut found = vec![];
        let mut plain = String::new();
        for (number, span) in comment.split('`').enumerate() {
            if number % 2 == 1 {
                if self.is_path(span) && !self.is_there(span) {
                    found.push(span.to_owned());
                }
                plain.push(' ');
            } else {
                plain.push_str(span);
            }
        }
        for target in plain.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if ending(document) == "md" && !target.contains("://") && !self.link_works(document, target) {
                found.push(target.to_owned());
            }
        }
        for word in plain.split_whitespace().filter(|word| !word.contains("](")) {
            let word = word.trim_matches(|c: char| !c.is_ascii_alphanumeric() && c != '_');
            let named = matches!(ending(word), "rs" | "md");
            if named && !word.contains("://") && self.is_path(word) && !self.is_there(word) {
                found.push(word.to_owned());
            }
        }
        found
    }

    /// Whether a code span names a file or folder of the repository, be it there or not.
    fn is_path(&self, text: &str) -> bool {
        let text = without_line(text);
        let letters = |c: char| c.is_ascii_alphanumeric() || "_./*-".contains(c);
        let first = text.split('/').next().unwrap_or_default();
        let placeholder = |part: &str| part.len() > 1 && part.bytes().all(|letter| letter.is_ascii_uppercase());
        if !text.chars().all(letters) || text.contains("..") || first.is_empty() || text.split('/').any(placeholder) {
            return false;
        }
        if ELSEWHERE.contains(&first) || (first.starts_with('.') && !self.roots.contains(first)) {
            return false;
        }
        if text.ends_with('/') {
            return true;
        }
        let name = text.rsplit('/').next().unwrap_or_default();
        let Some((stem, ending)) = name.rsplit_once('.') else { return false };
        !stem.is_empty()
            && (OURS.contains(&ending) || SHARED.contains(&ending) && text.contains('/') && self.roots.contains(first))
    }

    /// Whether a path leads somewhere, from the root or from any folder.
    fn is_there(&self, text: &str) -> bool {
        let wanted: Vec<&str> = without_line(text).trim_end_matches('/').split('/').collect();
        let files = self.tree.files.keys().map(String::as_str);
        files.chain(self.folders.iter().copied()).any(|path| {
            let parts: Vec<&str> = path.split('/').collect();
            parts.len() >= wanted.len()
                && parts[parts.len() - wanted.len()..].iter().zip(&wanted).all(|(part, wanted)| matches(part, wanted))
        })
    }

    /// Whether a link of a document leads to a file or folder. Its anchor is looked at where the book is made.
    fn link_works(&self, document: &str, target: &str) -> bool {
        let file = target.split('#').next().unwrap_or_default();
        let folder = document.rsplit_once('/').map_or("", |(folder, _)| folder);
        let path = join(folder, file);
        file.is_empty() || self.folders.contains(path.as_str()) || self.tree.files.contains_key(&path)
    }
}

/// Without the line number behind a colon.
fn without_line(text: &str) -> &str {
    match text.rsplit_once(':') {
        Some((path, line)) if !line.is_empty() && line.bytes().all(|c| c.is_ascii_digit() || c == b'-') => path,
        _ => text,
    }
}

/// A component of a path against one that may hold a `*`.
fn matches(part: &str, wanted: &str) -> bool {
    match wanted.split_once('*') {
        Some((before, after)) => {
            part.len() >= before.len() + after.len() && part.starts_with(before) && part.ends_with(after)
        }
        None => part == wanted,
    }
}

/// The lines of comments or prose in a file, with their numbers.
fn comments(path: &str, text: &str) -> Vec<(usize, String)> {
    let mark = match ending(path) {
        "md" => return prose(text),
        "rs" | "cpp" | "cu" | "h" | "c" | "proto" => "//",
        "py" | "toml" | "sh" => "#",
        "" if !text.is_empty() => "#",
        _ => return vec![],
    };
    let numbered = text.lines().enumerate();
    numbered.filter_map(|(number, line)| Some((number + 1, after_mark(line, mark)?.to_owned()))).collect()
}

/// What follows the mark, where it begins the line or stands after a space.
fn after_mark<'a>(line: &'a str, mark: &str) -> Option<&'a str> {
    let begins = |&(at, _): &(usize, &str)| line[..at].chars().next_back().is_none_or(char::is_whitespace);
    let (at, _) = line.match_indices(mark).find(begins)?;
    Some(&line[at + mark.len()..])
}

/// The lines of a document without its blocks of code.
fn prose(text: &str) -> Vec<(usize, String)> {
    let mut found = vec![];
    let mut code = false;
    for (number, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            code = !code;
        } else if !code {
            found.push((number + 1, line.to_owned()));
        }
    }
    found
}
