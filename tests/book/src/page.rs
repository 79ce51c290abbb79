//! The pages of the book, in the order of its summary.

use crate::{Block, BookError, read};
use std::path::Path;

/// A page.
#[derive(Debug, Clone)]
pub struct Page {
    /// Its path below `docs/`.
    pub path: String,
    /// Its title in the summary.
    pub title: String,
    /// Its text, with other documents that it includes.
    pub text: String,
}

impl Page {
    /// Its blocks of code.
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
            let text = whole(root, &path, &read(&root.join("docs").join(&path))?)?;
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

/// A page's text with the documents that it includes; of what else it includes, it is checked that it is there.
fn whole(root: &Path, page: &str, text: &str) -> Result<String, BookError> {
    let mut result = String::new();
    for line in text.lines() {
        let included = line.trim().strip_prefix("{{#include ").and_then(|rest| rest.strip_suffix("}}"));
        let document = match included {
            Some(target) => {
                let is_document = Path::new(target).extension().is_some_and(|ending| ending == "md");
                Some(part(root, page, target)?).filter(|_| is_document)
            }
            None => None,
        };
        result.push_str(document.as_deref().unwrap_or(line));
        result.push('\n');
    }
    Ok(result)
}

/// What `{{#include TARGET}}` puts into a page: a file, or what stands between `ANCHOR: name` and `ANCHOR_END: name`.
fn part(root: &Path, page: &str, target: &str) -> Result<String, BookError> {
    let (path, anchor) = target.split_once(':').map_or((target, None), |(path, anchor)| (path, Some(anchor)));
    let text = read(&root.join("docs").join(path))?;
    let Some(anchor) = anchor else { return Ok(text) };
    let missing = || BookError::NoAnchor { page: page.to_owned(), target: path.to_owned(), anchor: anchor.to_owned() };
    let is = |mark: &str, line: &str| {
        line.split(mark).nth(1).is_some_and(|rest| rest.split_whitespace().next() == Some(anchor))
    };
    let mut lines = text.lines();
    lines.find(|line| is("ANCHOR:", line)).ok_or_else(missing)?;
    let rest: Vec<&str> = lines.collect();
    let end = rest.iter().position(|line| is("ANCHOR_END:", line)).filter(|&end| end > 0).ok_or_else(missing)?;
    Ok(rest[..end].join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_title_and_target() {
        let found = links("# Summary\n\n- [One](one.md)\n  - [Two, three](two/three.md)\n");
        let expected = [("One", "one.md"), ("Two, three", "two/three.md")];
        assert_eq!(found, expected.map(|(title, path)| (title.to_owned(), path.to_owned())));
    }

    #[test]
    fn an_anchor_that_is_not_there_is_an_error() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        assert!(part(&root, "a.md", "../README.md").unwrap().contains("Stillroom"));
        let missing = part(&root, "a.md", "../README.md:nowhere").unwrap_err().to_string();
        assert!(missing.contains("no anchor `nowhere`"), "{missing}");
        assert!(part(&root, "a.md", "../nothing.md").is_err());
    }
}
