//! Which node is what: entries and nodes brought together.

use super::file::{Entry, Role, SceneFile};
use super::problem::Problem;
use crate::gltf::document::Document;
use crate::kitchen::catalogue::CATEGORIES;
use proto::kitchen::TargetCategory;
use wildmatch::WildMatch;

/// A body of the scene.
#[derive(Debug)]
pub struct Body<'a> {
    /// What it is.
    pub entry: &'a Entry,
    /// The node that the entry names.
    pub node: usize,
    /// That node and those below it that belong to it.
    pub members: Vec<usize>,
    /// Its category.
    pub category: String,
}

/// Brings entries and nodes together, in the order of the nodes.
pub fn assign<'a>(file: &'a SceneFile, document: &Document, problems: &mut Vec<Problem>) -> Vec<Body<'a>> {
    let patterns: Vec<WildMatch> = file.nodes.iter().map(|entry| WildMatch::new(&entry.name)).collect();
    let mut used = vec![false; patterns.len()];
    let mut bodies: Vec<Body<'a>> = Vec::new();
    // The body that each node belongs to, if any. Parents come first.
    let mut belongs: Vec<Option<usize>> = Vec::with_capacity(document.nodes.len());
    for (index, node) in document.nodes.iter().enumerate() {
        let mut fitting = (0..patterns.len()).filter(|&entry| patterns[entry].matches(&node.name));
        let body = if let Some(entry) = fitting.next() {
            used[entry] = true;
            let entry = &file.nodes[entry];
            let category = entry.category.clone().unwrap_or_else(|| without_number(&node.name).to_owned());
            judge(entry, &node.name, problems);
            bodies.push(Body { entry, node: index, members: Vec::new(), category });
            Some(bodies.len() - 1)
        } else {
            node.parent.and_then(|parent| belongs[parent])
        };
        match body {
            Some(body) => bodies[body].members.push(index),
            None if !node.pieces.is_empty() => problems.push(Problem::NoRole { node: node.name.clone() }),
            None => {}
        }
        belongs.push(body);
    }
    for (entry, used) in file.nodes.iter().zip(used) {
        if !used {
            let names = document.nodes.iter().map(|node| node.name.as_str());
            problems.push(Problem::NoNode { pattern: entry.name.clone(), nearest: nearest(&entry.name, names) });
        }
    }
    bodies
}

/// What is wrong with an entry as far as the entry alone can tell.
fn judge(entry: &Entry, node: &str, problems: &mut Vec<Problem>) {
    if entry.role != Role::Movable && (entry.mass_kg.is_some() || entry.friction.is_some()) {
        problems.push(Problem::NotMovable { node: node.to_owned() });
    }
    if let Some(category) = &entry.category
        && entry.role == Role::Movable
    {
        let known = || {
            let targets = TargetCategory::ALL.iter().map(|target| target.name());
            CATEGORIES.iter().map(|category| category.name).chain(targets)
        };
        if !known().any(|name| name == category) {
            let nearest = nearest(category, known());
            problems.push(Problem::UnknownCategory { node: node.to_owned(), category: category.clone(), nearest });
        }
    }
}

/// `Mug` of `Mug-2`, `Mug.001` and `Mug_3`.
fn without_number(name: &str) -> &str {
    let letters = name.trim_end_matches(|letter: char| letter.is_ascii_digit());
    if letters.len() == name.len() {
        return name;
    }
    let stem = letters.strip_suffix(['-', '.', '_']).unwrap_or(letters);
    if stem.is_empty() { name } else { stem }
}

/// The candidate closest to `word`, if any is close.
fn nearest<'a>(word: &str, candidates: impl Iterator<Item = &'a str>) -> Option<String> {
    candidates
        .map(|candidate| (strsim::jaro_winkler(word, candidate), candidate))
        .filter(|(score, _)| *score > 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_not_part_of_a_category() {
        for (name, category) in
            [("Mug", "Mug"), ("Mug-2", "Mug"), ("Mug.001", "Mug"), ("Mug_3", "Mug"), ("Mug4", "Mug"), ("7", "7")]
        {
            assert_eq!(without_number(name), category);
        }
    }
}
