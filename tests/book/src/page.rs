//! The pages of the book, in the order of its summary.

use crate::{Block, BookError, read};
use std::path::Path;

#[derive(Debug, Clone)]
pub struct Page {
    /// Its path below `docs/`.
    pub path: String,
    /// Its title in the summary.
    pub title: String,
    /// Its text, or that of the document of the root that it stands for.
    pub text: String,
}

impl Page {
    pub fn blocks(&self) -> Vec<Block> {
        Block::of(&self.text)
    }
}

/// The pages that `docs/SUMMARY.md` names.
pub fn pages(root: &Path) -> Result<Vec<Page>, BookError> {
    let summary = read(&root.join("docs/SUMMARY.md"))?;
    links(&summary)
        .into_iter()
        .map(|(title, path)| {
            let text = whole(root, read(&root.join("docs").join(&path))?)?;
            Ok(Page { path, title, text })
        })
        .collect()
}

/// Title and target of all links of a text.
pub fn links(text: &str) -> Vec<(String, String)> {
    let mut found = vec![];
    for (at, _) in text.match_indices("](") {
        let title = text[..at].rsplit('[').next().unwrap_or_default();
        let target = text[at + 2..].split(')').next().unwrap_or_default();
        found.push((title.to_owned(), target.to_owned()));
    }
    found
}

/// A page's text; of a page that is one line with a link to a document of the root, that document.
fn whole(root: &Path, text: String) -> Result<String, BookError> {
    let mut targets = links(&text).into_iter().map(|(_, target)| target);
    match (text.trim_end().lines().count(), targets.next()) {
        (1, Some(target)) => read(&root.join("docs").join(target)),
        _ => Ok(text),
    }
}

/// The source that a block is a copy of: a file, or what stands between `ANCHOR: name` and `ANCHOR_END: name` in it, as
/// far to the left as it goes. `target`: path from the root, and `:name`.
pub fn source(root: &Path, page: &str, target: &str) -> Result<String, BookError> {
    let (path, anchor) = target.split_once(':').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
    let text = read(&root.join(path))?;
    let Some(anchor) = anchor else { return Ok(text) };
    let missing = || BookError::NoAnchor { page: page.to_owned(), target: path.to_owned(), anchor: anchor.to_owned() };
    let is = |mark: &str, line: &str| {
        line.split(mark).nth(1).is_some_and(|rest| rest.split_whitespace().next() == Some(anchor))
    };
    let mut lines = text.lines();
    lines.find(|line| is("ANCHOR:", line)).ok_or_else(missing)?;
    let rest: Vec<&str> = lines.collect();
    let end = rest.iter().position(|line| is("ANCHOR_END:", line)).filter(|&end| end > 0).ok_or_else(missing)?;
    let indented = |line: &&str| line.len() - line.trim_start().len();
    let margin = rest[..end].iter().filter(|line| !line.is_empty()).map(indented).min().unwrap_or(0);
    let cut: Vec<&str> = rest[..end].iter().map(|line| line.get(margin..).unwrap_or_default()).collect();
    Ok(cut.join("\n") + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_anchor_that_is_not_there_is_an_error() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        assert!(source(&root, "a.md", "README.md").unwrap().contains("Stillroom"));
        let missing = source(&root, "a.md", "README.md:nowhere").unwrap_err().to_string();
        assert!(missing.contains("no anchor `nowhere`"), "{missing}");
        assert!(source(&root, "a.md", "nothing.md").is_err());
    }
}
