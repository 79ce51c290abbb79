//! Circles between the files of a crate.
//!
//! A file is tied to each file whose items its code names; re-exports are followed to the definition, so a `mod.rs`
//! that only declares and re-exports is tied to nothing. Tests may use anything: their paths are no ties.

use crate::modules::{Place, Target};
use crate::paths::Reach;
use crate::{Finding, Rule};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// From file to file, with the line of the first tie.
type Ties<'a> = BTreeMap<&'a str, BTreeMap<&'a str, usize>>;

/// One finding for each group of files that use each other in a circle.
pub(crate) fn findings(targets: &[Target]) -> Vec<Finding> {
    targets.iter().flat_map(of_crate).collect()
}

fn of_crate(target: &Target) -> Vec<Finding> {
    let ties = ties(target);
    let reached: BTreeMap<&str, BTreeSet<&str>> = ties.keys().map(|&file| (file, reachable(&ties, file))).collect();
    let mut found = vec![];
    let mut done = BTreeSet::new();
    for &file in ties.keys() {
        if !reached[file].contains(file) || !done.insert(file) {
            continue;
        }
        let mutual = |other: &&str| reached.get(other).is_some_and(|back| back.contains(file));
        let members: Vec<&str> = reached[file].iter().copied().filter(mutual).collect();
        done.extend(&members);
        let way = shortest(&ties, file, &members);
        let line = ties[file][way[1]];
        let shown = way.iter().map(|step| short(step, file)).collect::<Vec<_>>().join(" -> ");
        let more = if members.len() + 1 == way.len() {
            String::new()
        } else {
            format!(", in a knot of {} files", members.len())
        };
        let inner = |from: &&str| {
            ties[from].iter().filter(|(to, _)| members.contains(to)).map(|(to, line)| (*to, *line)).collect()
        };
        let tied = members.iter().map(|from| (*from, inner(from)));
        let detail = tied.flat_map(|(from, to): (&str, Vec<(&str, usize)>)| {
            to.into_iter().map(move |(to, line)| format!("\n    {from}:{line} uses {to}"))
        });
        found.push(Finding {
            path: file.to_owned(),
            line,
            rule: Rule::Circle,
            what: format!("circle of modules {shown}{more}"),
            detail: detail.collect(),
        });
    }
    found
}

fn ties(target: &Target) -> Ties<'_> {
    let mut ties = Ties::new();
    for (index, module) in target.modules.iter().enumerate().filter(|(_, module)| !module.test) {
        let imports = module.uses.iter().filter(|used| used.reach == Reach::Module && !used.glob && !used.test);
        let imports = imports.map(|used| (&used.path, used.line));
        let mentions = module.mentions.iter().filter(|mention| !mention.test);
        for (path, line) in imports.chain(mentions.map(|mention| (&mention.path, mention.line))) {
            let Some(Place::Item(owner)) = target.resolve(index, path) else { continue };
            let owner = &target.modules[owner];
            if owner.file != module.file && !owner.test {
                let first = ties.entry(&module.file).or_default().entry(&owner.file).or_insert(line);
                *first = line.min(*first);
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

/// The shortest way from a file back to itself.
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
