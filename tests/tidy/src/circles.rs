//! Circles between the files of a crate, and between its rooms.
//!
//! A file is tied to each file whose items its code names; re-exports are followed to the definition, so a `mod.rs`
//! that only declares and re-exports is tied to nothing. Tests may use anything: their paths are no ties.
//!
//! A room is a folder or a file beside the crate's root. Rooms can use each other both ways without a circle between
//! their files, so they are looked at by themselves. A circle of rooms that comes from one of files is not reported
//! again.

use crate::modules::{Place, Target};
use crate::{Finding, Rule};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// One use of a file by another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Tie<'a> {
    from: &'a str,
    line: usize,
    to: &'a str,
}

/// From file to file or from room to room, with the first tie.
type Ties<'a> = BTreeMap<&'a str, BTreeMap<&'a str, Tie<'a>>>;

/// One finding for each group of files, and for each group of rooms, that use each other in a circle.
pub(crate) fn findings(targets: &[Target]) -> Vec<Finding> {
    targets.iter().flat_map(of_crate).collect()
}

fn of_crate(target: &Target) -> Vec<Finding> {
    let files = ties(target);
    let mut found = circles(&files, Rule::Circle, "modules");
    found.extend(circles(&rooms(target, &files), Rule::RoomCircle, "rooms"));
    found
}

fn circles(ties: &Ties<'_>, rule: Rule, of: &str) -> Vec<Finding> {
    let reached: BTreeMap<&str, BTreeSet<&str>> = ties.keys().map(|&node| (node, reachable(ties, node))).collect();
    let mut found = vec![];
    let mut done = BTreeSet::new();
    for &node in ties.keys() {
        if !reached[node].contains(node) || !done.insert(node) {
            continue;
        }
        let mutual = |other: &&str| reached.get(other).is_some_and(|back| back.contains(node));
        let members: Vec<&str> = reached[node].iter().copied().filter(mutual).collect();
        done.extend(&members);
        let way = shortest(ties, node, &members);
        let first = ties[node][way[1]];
        let shown = way.iter().map(|step| short(step, node)).collect::<Vec<_>>().join(" -> ");
        let more =
            if members.len() + 1 == way.len() { String::new() } else { format!(", in a knot of {}", members.len()) };
        let tied = members.iter().flat_map(|from| ties[from].iter().filter(|(to, _)| members.contains(to)));
        let detail = tied.map(|(_, Tie { from, line, to })| format!("\n    {from}:{line} uses {to}"));
        found.push(Finding {
            path: first.from.to_owned(),
            line: first.line,
            rule,
            what: format!("circle of {of} {shown}{more}"),
            detail: detail.collect(),
        });
    }
    found
}

/// The ties between rooms, without those between files that are in a circle themselves.
fn rooms<'a>(target: &'a Target, files: &Ties<'a>) -> Ties<'a> {
    let folder = target.modules[0].file.rfind('/').map_or(0, |at| at + 1);
    let room = |file: &'a str| {
        let end = file[folder..].find('/').map_or(file.len() - ".rs".len(), |at| folder + at);
        &file[..end]
    };
    let mut rooms = Ties::new();
    for tie in files.values().flat_map(BTreeMap::values) {
        if room(tie.from) != room(tie.to) && !reachable(files, tie.to).contains(tie.from) {
            let first = rooms.entry(room(tie.from)).or_default().entry(room(tie.to)).or_insert(*tie);
            *first = (*first).min(*tie);
        }
    }
    rooms
}

fn ties(target: &Target) -> Ties<'_> {
    let mut ties = Ties::new();
    for (index, module) in target.modules.iter().enumerate().filter(|(_, module)| !module.test) {
        let imports = module.uses.iter().filter(|used| !used.passed_on && !used.glob && !used.test);
        let imports = imports.map(|used| (&used.path, used.line));
        let mentions = module.mentions.iter().filter(|mention| !mention.test);
        for (path, line) in imports.chain(mentions.map(|mention| (&mention.path, mention.line))) {
            let Some(Place::Item(owner)) = target.resolve(index, path) else { continue };
            let owner = &target.modules[owner];
            if owner.file != module.file && !owner.test {
                let tie = Tie { from: &module.file, line, to: &owner.file };
                let first = ties.entry(tie.from).or_default().entry(tie.to).or_insert(tie);
                *first = tie.min(*first);
            }
        }
    }
    ties
}

fn reachable<'a>(ties: &Ties<'a>, from: &str) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::new();
    let mut open: Vec<&str> = vec![from];
    while let Some(file) = open.pop() {
        for &next in ties.get(file).into_iter().flat_map(BTreeMap::keys) {
            if found.insert(next) {
                open.push(next);
            }
        }
    }
    found
}

/// The shortest way from a file or room back to itself.
fn shortest<'a>(ties: &Ties<'a>, from: &'a str, members: &[&'a str]) -> Vec<&'a str> {
    let mut came_from: BTreeMap<&str, &str> = BTreeMap::new();
    let mut open = VecDeque::from([from]);
    while let Some(file) = open.pop_front() {
        for &next in ties.get(file).into_iter().flat_map(BTreeMap::keys) {
            if next == from {
                let mut way = vec![from, file];
                while way.last() != Some(&from) {
                    way.push(came_from[way[way.len() - 1]]);
                }
                way.reverse();
                return way;
            }
            if members.contains(&next) && !came_from.contains_key(next) {
                came_from.insert(next, file);
                open.push_back(next);
            }
        }
    }
    vec![from, from]
}

/// A path without the folder that it has in common with another.
fn short<'a>(path: &'a str, beside: &str) -> &'a str {
    let common = path.bytes().zip(beside.bytes()).take_while(|(left, right)| left == right).count();
    let folder = path[..common].rfind("src/").map_or(0, |at| at + "src/".len());
    &path[folder..]
}
