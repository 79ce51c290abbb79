//! Everything that can be wrong with a scene, in words that say what to do.

use super::tops::NoTop;
use crate::gltf_file::document::DocumentError;
use crate::gltf_file::no_solid::NoSolid;
use crate::kitchen::room::MOVABLE_MASS_MAX_KG;
use proto::kitchen::TargetCategory;
use proto::likeness::suggestion;
use rapier3d::math::Vec3;
use std::fmt;
use std::path::{Path, PathBuf};

#[derive(Debug)]
pub struct SceneError {
    /// The scene's TOML file.
    pub file: PathBuf,
    /// What is wrong; never empty.
    pub problems: Vec<Problem>,
}

impl SceneError {
    pub fn new(file: &Path, problems: Vec<Problem>) -> Self {
        Self { file: file.to_path_buf(), problems }
    }
}

pub(super) const ENTRIES_MOST: usize = 2000;
/// Bodies of a scene at most: physics and camera look at each.
pub(super) const BODIES_MOST: usize = 2000;
/// Problems that are shown, and errors that are looked for in a file's text.
pub(super) const PROBLEMS_MOST: usize = 50;

impl fmt::Display for SceneError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let file = self.file.display();
        if let [problem] = self.problems.as_slice() {
            return write!(f, "{file}: {problem}");
        }
        write!(f, "{file}: {} things are wrong", self.problems.len())?;
        for problem in self.problems.iter().take(PROBLEMS_MOST) {
            write!(f, "\n  {problem}")?;
        }
        let more = self.problems.len().saturating_sub(PROBLEMS_MOST);
        if more > 0 { write!(f, "\n  and {more} more") } else { Ok(()) }
    }
}

impl std::error::Error for SceneError {}

#[derive(Debug, thiserror::Error)]
pub enum Problem {
    #[error("there is no such file")]
    Missing,
    #[error("cannot be read: {cause}")]
    Unreadable { cause: String },
    #[error(
        "is geometry alone: give the scene's TOML file, which names it and says which node is floor (docs/scenes.md)"
    )]
    Geometry,
    #[error("is a folder: name the scene's file in it, such as scene.toml")]
    Folder,
    #[error("line {line}: {problem}")]
    Toml { line: usize, problem: String },
    #[error("has {entries} [[node]] entries, more than {ENTRIES_MOST}: use patterns, `*` stands for any characters")]
    TooManyEntries { entries: usize },
    #[error("makes {bodies} bodies, more than {BODIES_MOST}: join what is one thing under one node, or ignore it")]
    TooManyBodies { bodies: usize },
    #[error("gltf = \"{gltf}\" lies outside of this file's folder: put it beside it, a scene's files travel together")]
    Elsewhere { gltf: String },
    #[error("gltf = \"{gltf}\": there is no such file beside this one{}", suggestion(.nearest.as_deref()))]
    NoGltf { gltf: String, nearest: Option<String> },
    #[error(transparent)]
    Gltf(#[from] DocumentError),
    #[error("no node is called `{pattern}`{}: correct the entry or take it out", suggestion(.nearest.as_deref()))]
    NoNode { pattern: String, nearest: Option<String> },
    #[error(
        "node {node}: no entry says what it is{}; add one with its role (`ignore` if it should not be there)",
        .nearest.as_deref().map_or_else(String::new, |entry| format!(" (is the entry `{entry}` meant for it?)"))
    )]
    NoRole {
        node: String,
        /// The closest name of an entry that fits no node.
        nearest: Option<String>,
    },
    #[error(
        "never used: {}, because node {node} and the like take the entry `{by}`, which stands before; put `{by}` last",
        .patterns.iter().map(|pattern| format!("`{pattern}`")).collect::<Vec<_>>().join(", ")
    )]
    Shadowed {
        patterns: Vec<String>,
        node: String,
        /// The entry that the nodes take.
        by: String,
    },
    #[error("node {node}: has no mesh; name the node that has it, or its parent")]
    NoMesh { node: String },
    #[error("node {node}: {problem}")]
    Mesh { node: String, problem: &'static str },
    #[error("node {node}: primitive {primitive} of its mesh {cause}")]
    NoSolid { node: String, primitive: usize, cause: NoSolid },
    #[error("node {node}: is movable and has no mass; add mass_kg to its entry")]
    NoMass { node: String },
    #[error(
        "node {node}: mass_kg = {mass_kg} is not between 0 and {MOVABLE_MASS_MAX_KG}; what is heavier does not move: its \
         role is `fixed`"
    )]
    Mass { node: String, mass_kg: f32 },
    #[error("node {node}: friction = {friction} is not between 0 and 4")]
    Friction { node: String, friction: f32 },
    #[error("node {node}: mass_kg and friction are for role `movable` only; take them out")]
    NotMovable { node: String },
    #[error(
        "node {node}: there is no category `{category}`{}; `actor kitchens categories` lists them; leave it out to \
         use the node's own name",
        suggestion(.nearest.as_deref())
    )]
    UnknownCategory { node: String, category: String, nearest: Option<String> },
    #[error(
        "nothing in it can be a target: one movable node at least must have the category {}{}",
        targets(),
        .nearest.as_ref().map_or_else(String::new, |(node, target)| format!(
            "; node {node} has not, did you mean `{target}`? Add category = \"{target}\" to its entry"
        ))
    )]
    NoTarget {
        /// A movable node that is nearly called like a target, and the target.
        nearest: Option<(String, &'static str)>,
    },
    #[error("nodes {} are all {category:?}: an episode must know which it means; give one its own category", .nodes.join(", "))]
    TwoTargets { category: TargetCategory, nodes: Vec<String> },
    #[error("no entry has the role `floor`: the robot needs one to drive on")]
    NoFloor,
    #[error("{floors} nodes have the role `floor`: one is the floor, others are `fixed`")]
    SeveralFloors { floors: usize },
    #[error("no entry has the role `surface`: targets need one to stand on")]
    NoSurface,
    #[error("node {node}: is a `surface`, but targets cannot stand on it: {cause}")]
    NoTop { node: String, cause: NoTop },
    #[error(
        "targets have nothing to stand on: something fixed lies on each `surface`, or hangs less than 0.05 m above it ({}); \
         give the role `surface` to what lies on top",
        .nodes.join(", ")
    )]
    Covered { nodes: Vec<String> },
    #[error(
        "node {node}: is a floor of {size_m}, which no kitchen has: glTF counts in metres, and its y axis points up; scale \
         or turn the scene, or export it anew"
    )]
    FloorSize { node: String, size_m: Size },
    #[error(
        "node {node}: its middle is at x {:.2} m, z {:.2} m, outside of the room: its floor reaches from x {:.2} to {:.2} m and \
         from z {:.2} to {:.2} m",
        .at.x, .at.z, .floor.0.x, .floor.1.x, .floor.0.z, .floor.1.z
    )]
    Outside { node: String, at: Vec3, floor: (Vec3, Vec3) },
    /// What else `actor check` finds.
    #[error("{0}")]
    Unfit(String),
    #[error(
        "node {node}: moved {moved_m:.3} m while coming to rest: it hangs in the air, stands tilted or overlaps something; \
         put it down where it stays"
    )]
    Fell { node: String, moved_m: f32 },
    #[error("node {node}: does not come to rest; give it a flat underside (a thin cylinder or box as a foot)")]
    Awake { node: String },
    #[error(
        "the robot can stand in {stands} poses only on a floor of {size_m}: leave it more free floor (the robot is 0.4 m wide \
         and reaches ahead)"
    )]
    NoFreeFloor { stands: usize, size_m: Size },
    #[error(
        "the arm comes to no place on any `surface` ({}): a top must be at most 0.75 m from where the robot can stand, no \
         higher than the arm reaches, and have room above it",
        .nodes.join(", ")
    )]
    Unreachable { nodes: Vec<String> },
    #[error(
        "{category:?} can stand in {spots} places only within the robot's reach: make surfaces larger or emptier, at most \
         0.75 m from where the robot can stand"
    )]
    FewSpots { category: TargetCategory, spots: usize },
    #[error("there is no {category:?}")]
    NoSuchTarget { category: TargetCategory },
}

/// How far something reaches along the floor's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    x_m: f32,
    z_m: f32,
}

impl Size {
    pub fn of(low: Vec3, high: Vec3) -> Self {
        Self { x_m: high.x - low.x, z_m: high.z - low.z }
    }

    /// The shorter and the longer of the two, metres.
    pub(crate) fn sides_m(self) -> [f32; 2] {
        [self.x_m.min(self.z_m), self.x_m.max(self.z_m)]
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} m × {:.2} m", self.x_m, self.z_m)
    }
}

fn targets() -> String {
    TargetCategory::ALL.map(TargetCategory::name).join(", ")
}
