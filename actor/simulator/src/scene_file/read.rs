//! Reads a scene: its files as a furnished room, and the room as a kitchen.

use super::file::{Role, SceneFile};
use super::problem::{BODIES_MOST, Problem, SceneError, Size};
use super::roles::{self, Body};
use super::tops;
use crate::gltf_file::document::Document;
use crate::gltf_file::piece::Piece;
use crate::gltf_file::solid::{Convex, part_of};
use crate::gltf_file::uri;
use crate::kitchen::room::{Fixture, MOVABLE_MASS_MAX_KG, Room, Surface, Thing};
use crate::kitchen::{Demands, Flaw, Kitchen};
use crate::physics::geometry::Solid;
use crate::shape::{Part, Primitive, Shape};
use proto::config::SimulationConfig;
use proto::kitchen::KitchenId;
use proto::likeness::nearest;
use rapier3d::math::{Pose3, Vec3};
use std::path::{Path, PathBuf};

/// What a scene must offer for episodes to take place in it: less than a generated kitchen does.
const DEMANDS: Demands = Demands { every_target: false, spots: 8, stands: 8 };
/// Friction of things whose entry says nothing: common household materials on each other.
const FRICTION: f32 = 0.6;
/// A floor that is longer than this was not made in metres, ...
const FLOOR_MOST_M: f32 = 50.0;
/// ... and one that is narrower was not, or stands upright.
const FLOOR_LEAST_M: f32 = 0.5;

/// A scene that was read: a furnished room, and the files it came from.
#[derive(Debug)]
pub struct Scene {
    pub room: Room,
    /// Names of the nodes that the room's things came from.
    pub nodes: Vec<String>,
    pub surfaces: Vec<String>,
    /// The TOML file, the glTF file and its buffers, relative to the TOML file's folder.
    pub files: Vec<PathBuf>,
}

/// Reads a scene and lets it come to rest. The error holds everything that was found wrong.
pub fn load(path: &Path, id: KitchenId, simulation: &SimulationConfig) -> Result<Kitchen, SceneError> {
    let Scene { room, nodes, surfaces, .. } = read(path)?;
    let size_m = Size::of(room.floor.0, room.floor.1);
    let of = |flaw| match flaw {
        Flaw::Fell { thing, moved_m } => Problem::Fell { node: nodes[thing].clone(), moved_m },
        Flaw::Awake { thing } => Problem::Awake { node: nodes[thing].clone() },
        Flaw::Stands { stands } => Problem::NoFreeFloor { stands, size_m },
        Flaw::Unreachable => Problem::Unreachable { nodes: surfaces.clone() },
        Flaw::Spots { category, spots } => Problem::FewSpots { category, spots },
        Flaw::Target { category } => Problem::NoSuchTarget { category },
    };
    Kitchen::assemble(id, simulation.timestep_s, room, &DEMANDS)
        .map_err(|flaws| SceneError::new(path, flaws.into_iter().map(of).collect()))
}

/// What a scene is called: as its file, or as the folder of one that is just called `scene.toml`.
pub fn name_of(path: &Path) -> String {
    let text = |name: Option<&std::ffi::OsStr>| name.map(|name| name.to_string_lossy().into_owned());
    let stem = text(path.file_stem()).unwrap_or_default();
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let folder = || text(whole.parent().and_then(Path::file_name));
    if stem == "scene" { folder().unwrap_or(stem) } else { stem }
}

/// Reads a scene's files. The error holds everything that was found wrong.
pub fn read(path: &Path) -> Result<Scene, SceneError> {
    let alone = |problem| SceneError::new(path, vec![problem]);
    let file = SceneFile::open(path).map_err(|problems| SceneError::new(path, problems))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let gltf = uri::find(folder, &file.gltf_path().map_err(alone)?);
    if !folder.join(&gltf).exists() {
        return Err(alone(Problem::NoGltf { gltf: file.gltf.clone(), nearest: nearest_gltf(folder, &file.gltf) }));
    }
    if !uri::is_inside(folder, &folder.join(&gltf)).unwrap_or(false) {
        return Err(alone(Problem::Elsewhere { gltf: file.gltf }));
    }
    let mut document = Document::open(&folder.join(&gltf)).map_err(|error| alone(error.into()))?;
    let mut problems = Vec::new();
    let bodies = roles::assign(&file, &document, &mut problems);
    roles::check_targets(&file, &bodies, &document, &mut problems);
    roles::check_floor_and_surfaces(&file, &bodies, &mut problems);
    if bodies.len() > BODIES_MOST {
        return Err(alone(Problem::TooManyBodies { bodies: bodies.len() }));
    }
    let mut draft = Draft::default();
    for body in &bodies {
        draft.add(body, &mut document, &mut problems);
    }
    let nodes = draft.nodes.clone();
    let surfaces = draft.tops.iter().map(|(node, _)| node.clone()).collect();
    let room = draft.finish(&mut problems);
    let mut files = vec![path.file_name().map(PathBuf::from).unwrap_or_default()];
    let beside = gltf.parent().unwrap_or(Path::new(""));
    files.extend(document.files.iter().map(|file| beside.join(file)));
    // Nothing else that was measured means anything then.
    if let Some(unit) = problems.iter().position(|problem| matches!(problem, Problem::FloorSize { .. })) {
        return Err(alone(problems.swap_remove(unit)));
    }
    match room {
        Some(room) if problems.is_empty() => Ok(Scene { room, nodes, surfaces, files }),
        _ => Err(SceneError::new(path, problems)),
    }
}

/// The glTF file in a folder whose name is closest to this one.
fn nearest_gltf(folder: &Path, name: &str) -> Option<String> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|name| Path::new(name).extension().is_some_and(|ending| ending == "glb" || ending == "gltf"))
        .collect();
    names.sort();
    nearest(name, names.iter().map(String::as_str))
}

#[derive(Default)]
struct Draft {
    fixtures: Vec<Fixture>,
    things: Vec<Thing>,
    nodes: Vec<String>,
    floors: Vec<(Vec3, Vec3)>,
    /// Nodes that things can stand on, with the rectangles on top of them.
    tops: Vec<(String, Vec<Surface>)>,
    /// Meshes that were decomposed: several nodes may share one, and it takes a while.
    decomposed: Vec<(Piece, Part)>,
}

impl Draft {
    /// Adds a body, or what is wrong with it.
    fn add(&mut self, body: &Body<'_>, document: &mut Document, problems: &mut Vec<Problem>) {
        let shape = match shape_of(body, document, &mut self.decomposed) {
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
                    let low = Vec3::new(aabb.mins.x, aabb.maxs.y, aabb.mins.z);
                    let size_m = Size::of(low, aabb.maxs);
                    let [shorter_m, longer_m] = size_m.sides_m();
                    if shorter_m < FLOOR_LEAST_M || longer_m > FLOOR_MOST_M {
                        problems.push(Problem::FloorSize { node: node.name.clone(), size_m });
                    }
                    self.floors.push((low, aabb.maxs));
                } else if body.entry.role == Role::Surface {
                    let found = tops::of(&shape, &node.pose);
                    if found.is_empty() {
                        let cause = tops::why_none(&shape, &node.pose);
                        problems.push(Problem::NoTop { node: node.name.clone(), cause });
                    }
                    self.tops.push((node.name.clone(), found));
                }
                self.fixtures.push(Fixture { category: body.category.clone(), shape, pose: node.pose });
            }
        }
    }

    /// The room with its floor at height 0; none where a problem was found before that left it without one floor.
    fn finish(mut self, problems: &mut Vec<Problem>) -> Option<Room> {
        let [floor] = *self.floors.as_slice() else { return None };
        for (thing, node) in self.things.iter().zip(&self.nodes) {
            let at = thing.pose.translation;
            let inside = |axis: fn(Vec3) -> f32| (axis(floor.0)..=axis(floor.1)).contains(&axis(at));
            if !inside(|point| point.x) || !inside(|point| point.z) {
                problems.push(Problem::Outside { node: node.clone(), at, floor });
            }
        }
        let down = Vec3::new(0.0, -floor.0.y, 0.0);
        for pose in self.fixtures.iter_mut().map(|f| &mut f.pose).chain(self.things.iter_mut().map(|t| &mut t.pose)) {
            pose.translation += down;
        }
        let (nodes, tops): (Vec<String>, Vec<Vec<Surface>>) = self.tops.into_iter().unzip();
        let mut surfaces: Vec<Surface> = tops.into_iter().flatten().collect();
        for surface in &mut surfaces {
            surface.low += down;
            surface.high += down;
        }
        let found = !surfaces.is_empty();
        tops::limit(&mut surfaces, &self.fixtures);
        if found && surfaces.is_empty() {
            problems.push(Problem::Covered { nodes });
        }
        Some(Room { fixtures: self.fixtures, things: self.things, surfaces, floor: (floor.0 + down, floor.1 + down) })
    }
}

/// The shape of a body in its node's frame: each primitive of its nodes is one part. What is `decomposed` already is
/// not decomposed again.
fn shape_of(
    body: &Body<'_>,
    document: &mut Document,
    decomposed: &mut Vec<(Piece, Part)>,
) -> Result<Shape, Vec<Problem>> {
    let mut shape = Shape::default();
    let mut problems = Vec::new();
    if body.entry.role == Role::Ignore {
        return Ok(shape);
    }
    for &index in &body.members {
        // What is wrong with a node without a mesh matters where the body stands by it.
        if index != body.node && !document.has_surface(index) {
            continue;
        }
        let pieces = document.pieces(index);
        let (own, node) = (&document.nodes[body.node], &document.nodes[index]);
        let own_from_node = own.pose.inverse() * node.pose;
        let pieces = match pieces {
            Ok(pieces) => pieces,
            Err(problem) => {
                problems.push(Problem::Mesh { node: node.name.clone(), problem });
                continue;
            }
        };
        for (number, piece) in pieces.iter().enumerate() {
            let known = || decomposed.iter().find(|(known, _)| known == piece).map(|(_, part)| part.clone());
            let known = if body.entry.convex == Some(Convex::Decompose) { known() } else { None };
            let is_new = known.is_none();
            match known.map_or_else(|| part_of(piece, body.entry.convex), Ok) {
                Ok(part) => {
                    if is_new && matches!(part.primitive, Primitive::Concave(_)) {
                        decomposed.push((piece.clone(), part.clone()));
                    }
                    shape.parts.push(Part { body_from_part: own_from_node * part.body_from_part, ..part });
                }
                Err(cause) => problems.push(Problem::NoSolid { node: node.name.clone(), primitive: number, cause }),
            }
        }
    }
    if shape.parts.is_empty() && problems.is_empty() {
        problems.push(Problem::NoMesh { node: document.nodes[body.node].name.clone() });
    }
    if problems.is_empty() { Ok(shape) } else { Err(problems) }
}
