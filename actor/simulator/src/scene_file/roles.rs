//! Which node is what: entries and nodes brought together.

use super::file::{NodeEntry, Role, SceneFile};
use super::problem::Problem;
use crate::gltf_file::document::Document;
use crate::kitchen::catalogue::CATEGORIES;
use proto::kitchen::TargetCategory;
use proto::likeness::{likeness, nearest};
use std::collections::BTreeMap;
use wildmatch::WildMatch;

/// A category that is this much like a target's was probably meant to be one.
const NEARLY: f64 = 0.88;

#[derive(Debug)]
pub struct Body<'a> {
    pub entry: &'a NodeEntry,
    pub node: usize,
    /// That node and those below it that belong to it.
    pub members: Vec<usize>,
    pub category: String,
}

/// Brings entries and nodes together, in the order of the nodes.
pub fn assign<'a>(file: &'a SceneFile, document: &Document, problems: &mut Vec<Problem>) -> Vec<Body<'a>> {
    let patterns: Vec<WildMatch> = file.nodes.iter().map(|entry| WildMatch::new(&entry.name)).collect();
    let mut used = vec![false; patterns.len()];
    let mut bodies: Vec<Body<'a>> = Vec::new();
    // The body that each node belongs to, if any. Parents come first.
    let mut belongs: Vec<Option<usize>> = Vec::with_capacity(document.nodes.len());
    let mut nameless: Vec<&str> = Vec::new();
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
            None if document.has_surface(index) => nameless.push(node.name.as_str()),
            None => {}
        }
        belongs.push(body);
    }
    let names = || document.nodes.iter().map(|node| node.name.as_str());
    // An entry that fits a node and is not used comes too late.
    let takes = |name: &str| patterns.iter().position(|pattern| pattern.matches(name));
    let mut lost: Vec<&str> = Vec::new();
    let mut shadowed: BTreeMap<usize, (&str, Vec<String>)> = BTreeMap::new();
    for (index, (entry, pattern)) in file.nodes.iter().zip(&patterns).enumerate().filter(|(index, _)| !used[*index]) {
        let fits = names().find(|&name| pattern.matches(name));
        if let Some((node, by)) = fits.and_then(|node| Some((node, takes(node).filter(|&first| first < index)?))) {
            shadowed.entry(by).or_insert_with(|| (node, Vec::new())).1.push(entry.name.clone());
        } else {
            lost.push(&entry.name);
            problems.push(Problem::NoNode { pattern: entry.name.clone(), nearest: nearest(&entry.name, names()) });
        }
    }
    problems.extend(shadowed.into_iter().map(|(by, (node, patterns))| Problem::Shadowed {
        patterns,
        node: node.to_owned(),
        by: file.nodes[by].name.clone(),
    }));
    problems.extend(
        nameless
            .into_iter()
            .map(|node| Problem::NoRole { node: node.to_owned(), nearest: nearest(node, lost.iter().copied()) }),
    );
    bodies
}

/// Each target category at most once, and one at least. Where an entry for a target fits no node, that is the problem,
/// and it was said.
pub fn check_targets(file: &SceneFile, bodies: &[Body<'_>], document: &Document, problems: &mut Vec<Problem>) {
    let movable = || bodies.iter().filter(|body| body.entry.role == Role::Movable);
    let node = |body: &Body<'_>| document.nodes[body.node].name.clone();
    let mut any = false;
    for category in TargetCategory::ALL {
        let nodes: Vec<String> = movable().filter(|body| body.category == category.name()).map(node).collect();
        any |= !nodes.is_empty();
        if nodes.len() > 1 {
            problems.push(Problem::TwoTargets { category, nodes });
        }
    }
    let is_target = |name: &str| TargetCategory::ALL.iter().any(|target| target.name() == name);
    let meant = |entry: &NodeEntry| {
        let category = entry.category.as_deref().unwrap_or_else(|| without_number(&entry.name));
        entry.role == Role::Movable && is_target(category)
    };
    if any || file.nodes.iter().any(meant) {
        return;
    }
    let near = |body: &Body<'_>| {
        let scores = TargetCategory::ALL.map(|target| (likeness(&body.category, target.name()), target.name()));
        let best = scores.into_iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 > NEARLY).then(|| (best.0, node(body), best.1))
    };
    let nearest = movable().filter_map(near).max_by(|a, b| a.0.total_cmp(&b.0));
    let nearest = nearest.map(|(_, node, target)| (node, target));
    problems.push(Problem::NoTarget { nearest });
}

/// One floor, and one surface at least. Where an entry has the role and no node came of it, that is the problem, and it
/// was said.
pub fn check_floor_and_surfaces(file: &SceneFile, bodies: &[Body<'_>], problems: &mut Vec<Problem>) {
    let is_said = |role: Role| file.nodes.iter().any(|entry| entry.role == role);
    let floors = bodies.iter().filter(|body| body.entry.role == Role::Floor).count();
    if !is_said(Role::Floor) {
        problems.push(Problem::NoFloor);
    } else if floors > 1 {
        problems.push(Problem::SeveralFloors { floors });
    }
    if !is_said(Role::Surface) {
        problems.push(Problem::NoSurface);
    }
}

/// What is wrong with an entry as far as the entry alone can tell.
fn judge(entry: &NodeEntry, node: &str, problems: &mut Vec<Problem>) {
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
