//! Users' own scenes: a glTF file for the geometry, and a small TOML file for what glTF does not say.
//!
//! ```text
//! file      what stands in `scene.toml`
//! roles     which node is what: entries and nodes brought together
//! tops      where things can stand on a surface
//! inspect   the check of a whole scene
//! problem   everything that can be wrong, in words that say what to do
//! ```
//!
//! ```toml
//! gltf = "studio.glb"          # beside this file or below it
//!
//! [[node]]                     # a node takes the first entry that fits its name
//! name = "Floor"               # `*` and `?` stand for anything
//! role = "floor"               # its extent is where the robot drives; its top becomes height 0
//!
//! [[node]]
//! name = "Table"
//! role = "surface"             # fixed, and its level tops are where targets can stand
//!
//! [[node]]
//! name = "Mug"
//! role = "movable"
//! mass_kg = 0.35
//! friction = 0.6               # Coulomb coefficient; 0.6 if left out
//! category = "Mug"             # left out: the node's name without its number
//! convex = "hull"              # take the hull of meshes that are not convex
//!
//! [[node]]
//! name = "Wall*"
//! role = "fixed"
//!
//! [[node]]
//! name = "Lamp"
//! role = "ignore"
//! ```
//!
//! A node that an entry names is one body, together with the nodes below it that no entry names. Each primitive of its
//! meshes is one convex part ([`crate::gltf::solid`]). Metres, y up; the axes are glTF's ([`crate::gltf`]).

mod file;
pub mod inspect;
mod problem;
mod roles;
pub mod tops;

pub use file::{Convex, Entry, Role, SceneFile};
pub use problem::{Problem, SceneError};

use super::room::{Fixture, MOVABLE_MASS_MAX_KG, Room, Surface, Thing};
use super::{Demands, Flaw, Kitchen};
use crate::gltf::document::{Document, Node};
use crate::gltf::solid::part_of;
use crate::physics::geometry::Solid;
use crate::shape::{Part, Shape};
use proto::config::SimulationConfig;
use proto::kitchen::{KitchenId, TargetCategory};
use rapier3d::math::{Pose3, Vec3};
use roles::Body;
use std::path::{Path, PathBuf};

/// What a scene must offer for episodes to take place in it: less than a generated kitchen does.
const DEMANDS: Demands = Demands { every_target: false, spots: 8, stands: 8 };
/// Friction of things whose entry says nothing: common household materials on each other.
const FRICTION: f32 = 0.6;

/// A scene that was read: a furnished room, and the files it came from.
#[derive(Debug)]
pub struct Scene {
    /// The room.
    pub room: Room,
    /// Names of the nodes that the room's things came from.
    pub nodes: Vec<String>,
    /// The TOML file, the glTF file and its buffers, relative to the TOML file's folder.
    pub files: Vec<PathBuf>,
}

/// Reads a scene and lets it come to rest. The error holds everything that was found wrong.
pub fn load(path: &Path, id: KitchenId, simulation: &SimulationConfig) -> Result<Kitchen, SceneError> {
    let Scene { room, nodes, .. } = read(path)?;
    let of = |flaw| match flaw {
        Flaw::Fell { thing, moved_m } => Problem::Fell { node: nodes[thing].clone(), moved_m },
        Flaw::Awake { thing } => Problem::Awake { node: nodes[thing].clone() },
        Flaw::Stands { stands } => Problem::NoFreeFloor { stands },
        Flaw::Spots { category, spots } => Problem::FewSpots { category, spots },
        Flaw::Target { category } => Problem::NoSuchTarget { category },
    };
    Kitchen::assemble(id, simulation.timestep_s, room, &DEMANDS)
        .map_err(|flaws| SceneError::new(path, flaws.into_iter().map(of).collect()))
}

/// Reads a scene's files. The error holds everything that was found wrong.
pub fn read(path: &Path) -> Result<Scene, SceneError> {
    let alone = |problem| SceneError::new(path, vec![problem]);
    let file = SceneFile::open(path).map_err(alone)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let gltf = file.gltf_path().map_err(alone)?;
    let document = Document::open(&folder.join(&gltf)).map_err(|error| alone(error.into()))?;
    let mut problems = Vec::new();
    let bodies = roles::assign(&file, &document, &mut problems);
    let mut draft = Draft::default();
    for body in &bodies {
        draft.add(body, &document, &mut problems);
    }
    let (room, nodes) = draft.finish(&mut problems);
    let mut files = vec![path.file_name().map(PathBuf::from).unwrap_or_default()];
    let beside = gltf.parent().unwrap_or(Path::new(""));
    files.extend(document.files.iter().map(|file| beside.join(file)));
    match room {
        Some(room) if problems.is_empty() => Ok(Scene { room, nodes, files }),
        _ => Err(SceneError::new(path, problems)),
    }
}

/// A room in the making.
#[derive(Default)]
struct Draft {
    fixtures: Vec<Fixture>,
    things: Vec<Thing>,
    nodes: Vec<String>,
    floors: Vec<(Vec3, Vec3)>,
    /// Nodes that things can stand on, with the rectangles on top of them.
    tops: Vec<(String, Vec<Surface>)>,
}

impl Draft {
    /// Adds a body, or what is wrong with it.
    fn add(&mut self, body: &Body<'_>, document: &Document, problems: &mut Vec<Problem>) {
        let shape = match shape_of(body, document) {
            Ok(shape) => shape,
            Err(found) => return problems.extend(found),
        };
        let node = &document.nodes[body.node];
        let solid = Solid::of(&shape);
        match body.entry.role {
            Role::Ignore => {}
            Role::Movable => {
                let aabb = solid.aabb(&Pose3::identity());
                let centre = aabb.center();
                let mut shape = shape;
                for part in &mut shape.parts {
                    part.body_from_part.translation -= centre;
                }
                let mass_kg = match body.entry.mass_kg {
                    None => return problems.push(Problem::NoMass { node: node.name.clone() }),
                    Some(mass_kg) if mass_kg.is_nan() || mass_kg <= 0.0 || mass_kg > MOVABLE_MASS_MAX_KG => {
                        return problems.push(Problem::Mass { node: node.name.clone(), mass_kg });
                    }
                    Some(mass_kg) => mass_kg,
                };
                let friction = body.entry.friction.unwrap_or(FRICTION);
                if !(0.0..=4.0).contains(&friction) {
                    return problems.push(Problem::Friction { node: node.name.clone(), friction });
                }
                self.nodes.push(node.name.clone());
                self.things.push(Thing {
                    category: body.category.clone(),
                    solid: Solid::of(&shape),
                    shape,
                    mass_kg,
                    friction,
                    pose: node.pose * Pose3::from_translation(centre),
                });
            }
            Role::Floor | Role::Fixed | Role::Surface => {
                let aabb = solid.aabb(&node.pose);
                if body.entry.role == Role::Floor {
                    self.floors.push((Vec3::new(aabb.mins.x, aabb.maxs.y, aabb.mins.z), aabb.maxs));
                } else if body.entry.role == Role::Surface {
                    self.tops.push((node.name.clone(), tops::of(&shape, &node.pose)));
                }
                self.fixtures.push(Fixture { category: body.category.clone(), shape, pose: node.pose });
            }
        }
    }

    /// The room with its floor at height 0, and the nodes of its things.
    fn finish(mut self, problems: &mut Vec<Problem>) -> (Option<Room>, Vec<String>) {
        let floor = match self.floors.as_slice() {
            [floor] => Some(*floor),
            [] => {
                problems.push(Problem::NoFloor);
                None
            }
            several => {
                problems.push(Problem::SeveralFloors { floors: several.len() });
                None
            }
        };
        for (node, tops) in &self.tops {
            if tops.is_empty() {
                problems.push(Problem::NoTop { node: node.clone() });
            }
        }
        if self.tops.is_empty() {
            problems.push(Problem::NoSurface);
        }
        self.check_targets(problems);
        let Some(floor) = floor else { return (None, self.nodes) };
        let down = Vec3::new(0.0, -floor.0.y, 0.0);
        for pose in self.fixtures.iter_mut().map(|f| &mut f.pose).chain(self.things.iter_mut().map(|t| &mut t.pose)) {
            pose.translation += down;
        }
        let mut surfaces: Vec<Surface> = self.tops.into_iter().flat_map(|(_, tops)| tops).collect();
        for surface in &mut surfaces {
            surface.low += down;
            surface.high += down;
        }
        tops::limit(&mut surfaces, &self.fixtures);
        let room =
            Room { fixtures: self.fixtures, things: self.things, surfaces, floor: (floor.0 + down, floor.1 + down) };
        (Some(room), self.nodes)
    }

    /// Each target category at most once, and one at least.
    fn check_targets(&self, problems: &mut Vec<Problem>) {
        let mut any = false;
        for category in TargetCategory::ALL {
            let named = self.things.iter().zip(&self.nodes).filter(|(thing, _)| thing.category == category.name());
            let nodes: Vec<String> = named.map(|(_, node)| node.clone()).collect();
            any |= !nodes.is_empty();
            if nodes.len() > 1 {
                problems.push(Problem::TwoTargets { category, nodes });
            }
        }
        if !any {
            problems.push(Problem::NoTarget);
        }
    }
}

/// The shape of a body in its node's frame: each primitive of its nodes is one convex part.
fn shape_of(body: &Body<'_>, document: &Document) -> Result<Shape, Vec<Problem>> {
    let own: &Node = &document.nodes[body.node];
    let mut shape = Shape::default();
    let mut problems = Vec::new();
    if body.entry.role == Role::Ignore {
        return Ok(shape);
    }
    for &index in &body.members {
        let node = &document.nodes[index];
        let own_from_node = own.pose.inverse() * node.pose;
        for (number, piece) in node.pieces.iter().enumerate() {
            match part_of(piece, body.entry.convex == Some(Convex::Hull)) {
                Ok(part) => {
                    shape.parts.push(Part { body_from_part: own_from_node * part.body_from_part, ..part });
                }
                Err(cause) => problems.push(Problem::NoSolid { node: node.name.clone(), primitive: number, cause }),
            }
        }
    }
    if shape.parts.is_empty() && problems.is_empty() {
        problems.push(Problem::NoMesh { node: own.name.clone() });
    }
    if problems.is_empty() { Ok(shape) } else { Err(problems) }
}
