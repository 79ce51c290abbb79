//! A settled kitchen as a binary glTF file (GLB): metres, y up.
//!
//! Nodes are named like bodies; equal shapes of one category share a mesh; a category is a material. A node's `extras`
//! hold `role` (`fixed` or `movable`), `category`, and for movable things `mass_kg` and `friction`. The ceiling is
//! nearly transparent, so that a viewer can look in from above. The robot is left out.

use crate::sheet::Subject;
use anyhow::{Context, Result};
use gltf::binary::{Glb, Header};
use gltf::json::accessor::{ComponentType, GenericComponentType, Type};
use gltf::json::buffer::Target;
use gltf::json::extras::RawValue;
use gltf::json::material::{AlphaMode, PbrBaseColorFactor, PbrMetallicRoughness, StrengthFactor};
use gltf::json::mesh::{Mode, Semantic};
use gltf::json::validation::{Checked, USize64};
use gltf::json::{Index, Root, scene::UnitQuaternion};
use picture::palette::{colour, linear};
use rapier3d::math::Vec3;
use simulator::gltf_file::mirror;
use simulator::kitchen::{BodyRole, Kitchen};
use simulator::mesh::triangles_of;
use simulator::scene_file::{Convex, NodeEntry, Role, SceneFile, tops};
use simulator::shape::{Part, Primitive, Shape};
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Faces that meet at less than this angle's cosine apart look like one round surface (35 degrees).
const SMOOTH_COSINE: f32 = 0.82;
const CEILING_ALPHA: f32 = 0.06;
const ROUGHNESS: f32 = 0.85;

/// The file's bytes. Panics if the kitchen does not fit into a GLB file's 4 GiB: it holds a few megabytes.
pub fn glb(kitchen: &Kitchen) -> Vec<u8> {
    let mut writer = Writer { kitchen: kitchen.id().number(), ..Writer::default() };
    let mut nodes = Vec::new();
    for (index, (body, pose)) in kitchen.bodies().iter().zip(kitchen.settled_poses()).enumerate() {
        let role = match body.role {
            BodyRole::Robot => continue,
            BodyRole::Static => "fixed",
            BodyRole::Movable => "movable",
        };
        let mut extras = serde_json::json!({ "role": role, "category": body.category });
        if let Some(matter) = kitchen.matter(index) {
            extras["mass_kg"] = decimal(matter.mass_kg);
            extras["friction"] = decimal(matter.friction);
        }
        let mesh = writer.mesh(&body.category, &body.shape);
        let pose = mirror::pose(*pose);
        let node = gltf::json::Node {
            name: Some(body.name.clone()),
            mesh: Some(mesh),
            translation: Some(pose.translation.to_array()),
            rotation: Some(UnitQuaternion(pose.rotation.normalize().to_array())),
            extras: raw(&extras),
            ..Default::default()
        };
        nodes.push(writer.root.push(node));
    }
    let scene = gltf::json::Scene {
        name: Some(format!("Kitchen {}", kitchen.id())),
        nodes,
        extensions: None,
        extras: raw(&serde_json::json!({ "kitchen": writer.kitchen })),
    };
    writer.root.scene = Some(writer.root.push(scene));
    writer.finish()
}

#[derive(Default)]
struct Writer {
    kitchen: u32,
    root: Root,
    materials: BTreeMap<String, Index<gltf::json::Material>>,
    meshes: Vec<(String, Shape, Index<gltf::json::Mesh>)>,
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    corners: Vec<u16>,
}

/// The buffer's three regions, as views.
const POSITIONS: u32 = 0;
const NORMALS: u32 = 1;
const CORNERS: u32 = 2;

impl Writer {
    /// The mesh of a shape in a category's colour; the same again where it was asked for before.
    fn mesh(&mut self, category: &str, shape: &Shape) -> Index<gltf::json::Mesh> {
        if let Some((_, _, mesh)) = self.meshes.iter().find(|(of, other, _)| of == category && other == shape) {
            return *mesh;
        }
        let material = self.material(category);
        let primitives = shape.parts.iter().map(|part| self.primitive(part, material)).collect();
        let mesh = gltf::json::Mesh {
            name: Some(category.to_owned()),
            primitives,
            weights: None,
            extensions: None,
            extras: None,
        };
        let mesh = self.root.push(mesh);
        self.meshes.push((category.to_owned(), shape.clone(), mesh));
        mesh
    }

    fn material(&mut self, category: &str) -> Index<gltf::json::Material> {
        if let Some(material) = self.materials.get(category) {
            return *material;
        }
        let [red, green, blue] = colour(category, self.kitchen).map(linear);
        let see_through = category == "Ceiling";
        let material = gltf::json::Material {
            name: Some(category.to_owned()),
            alpha_mode: Checked::Valid(if see_through { AlphaMode::Blend } else { AlphaMode::Opaque }),
            pbr_metallic_roughness: PbrMetallicRoughness {
                base_color_factor: PbrBaseColorFactor([
                    red,
                    green,
                    blue,
                    if see_through { CEILING_ALPHA } else { 1.0 },
                ]),
                metallic_factor: StrengthFactor(0.0),
                roughness_factor: StrengthFactor(ROUGHNESS),
                ..Default::default()
            },
            ..Default::default()
        };
        let material = self.root.push(material);
        self.materials.insert(category.to_owned(), material);
        material
    }

    fn primitive(&mut self, part: &Part, material: Index<gltf::json::Material>) -> gltf::json::mesh::Primitive {
        let triangles: Vec<[Vec3; 3]> = triangles_of(&Shape { parts: vec![part.clone()] })
            .into_iter()
            .map(|[a, b, c]| [a, c, b].map(|corner| mirror::vector(Vec3::from(corner))))
            .collect();
        let (first_vertex, first_corner) = (self.positions.len(), self.corners.len());
        let (mut low, mut high) = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
        let mut known: HashMap<[u32; 6], u16> = HashMap::new();
        for (corner, normal) in smooth(&triangles) {
            let key = [corner.x, corner.y, corner.z, normal.x, normal.y, normal.z].map(f32::to_bits);
            let next = self.positions.len() - first_vertex;
            let index = *known.entry(key).or_insert_with(|| {
                self.positions.push(corner.to_array());
                self.normals.push(normal.to_array());
                (low, high) = (low.min(corner), high.max(corner));
                u16::try_from(next).expect("a part has a few thousand vertices at its finest")
            });
            self.corners.push(index);
        }
        let count = self.positions.len() - first_vertex;
        let float = |view: u32, bounds: Option<(Vec3, Vec3)>| gltf::json::Accessor {
            buffer_view: Some(Index::new(view)),
            byte_offset: Some(USize64::from(first_vertex * 12)),
            count: USize64::from(count),
            component_type: Checked::Valid(GenericComponentType(ComponentType::F32)),
            type_: Checked::Valid(Type::Vec3),
            min: bounds.map(|(low, _)| serde_json::json!(low.to_array())),
            max: bounds.map(|(_, high)| serde_json::json!(high.to_array())),
            normalized: false,
            sparse: None,
            name: None,
            extensions: None,
            extras: None,
        };
        let positions = self.root.push(float(POSITIONS, Some((low, high))));
        let normals = self.root.push(float(NORMALS, None));
        let corners = self.root.push(gltf::json::Accessor {
            byte_offset: Some(USize64::from(first_corner * 2)),
            count: USize64::from(self.corners.len() - first_corner),
            component_type: Checked::Valid(GenericComponentType(ComponentType::U16)),
            type_: Checked::Valid(Type::Scalar),
            ..float(CORNERS, None)
        });
        gltf::json::mesh::Primitive {
            attributes: BTreeMap::from([
                (Checked::Valid(Semantic::Positions), positions),
                (Checked::Valid(Semantic::Normals), normals),
            ]),
            indices: Some(corners),
            material: Some(material),
            mode: Checked::Valid(Mode::Triangles),
            targets: None,
            extensions: None,
            extras: solid_extras(part),
        }
    }

    /// Puts buffer and JSON together.
    fn finish(mut self) -> Vec<u8> {
        let mut buffer: Vec<u8> = Vec::new();
        let regions: [(Vec<u8>, Option<usize>, Target); 3] = [
            (little_endian(&self.positions), Some(12), Target::ArrayBuffer),
            (little_endian(&self.normals), Some(12), Target::ArrayBuffer),
            (self.corners.iter().flat_map(|corner| corner.to_le_bytes()).collect(), None, Target::ElementArrayBuffer),
        ];
        for (bytes, stride, target) in regions {
            let view = gltf::json::buffer::View {
                buffer: Index::new(0),
                byte_offset: Some(USize64::from(buffer.len())),
                byte_length: USize64::from(bytes.len()),
                byte_stride: stride.map(gltf::json::buffer::Stride),
                target: Some(Checked::Valid(target)),
                name: None,
                extensions: None,
                extras: None,
            };
            self.root.push(view);
            buffer.extend(bytes);
            buffer.resize(buffer.len().next_multiple_of(4), 0);
        }
        self.root.push(gltf::json::Buffer {
            byte_length: USize64::from(buffer.len()),
            uri: None,
            name: None,
            extensions: None,
            extras: None,
        });
        self.root.asset.generator = Some(concat!("Stillroom ", env!("CARGO_PKG_VERSION")).to_owned());
        let json = self.root.to_vec().expect("plain numbers, strings and lists always serialise");
        let glb = Glb {
            // Lengths are filled in as it is written.
            header: Header { magic: *b"glTF", version: 2, length: 0 },
            json: Cow::Owned(json),
            bin: Some(Cow::Owned(buffer)),
        };
        glb.to_vec().expect("a kitchen is a few megabytes, a GLB file may have 4 GiB")
    }
}

fn little_endian(vectors: &[[f32; 3]]) -> Vec<u8> {
    vectors.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Corner after corner with its normal: the mean over the faces that meet there without an edge.
fn smooth(triangles: &[[Vec3; 3]]) -> Vec<(Vec3, Vec3)> {
    let areas: Vec<Vec3> = triangles.iter().map(|[a, b, c]| (*b - *a).cross(*c - *a)).collect();
    let mut around: HashMap<[u32; 3], Vec<usize>> = HashMap::new();
    for (index, triangle) in triangles.iter().enumerate() {
        for corner in triangle {
            around.entry(corner.to_array().map(f32::to_bits)).or_default().push(index);
        }
    }
    let mut corners = Vec::with_capacity(3 * triangles.len());
    for (triangle, area) in triangles.iter().zip(&areas) {
        let own = area.normalize_or_zero();
        if own == Vec3::ZERO {
            continue;
        }
        for corner in triangle {
            let neighbours = &around[&corner.to_array().map(f32::to_bits)];
            let meeting = neighbours.iter().filter(|&&other| areas[other].normalize_or_zero().dot(own) > SMOOTH_COSINE);
            let normal = meeting.fold(Vec3::ZERO, |sum, &other| sum + areas[other]).normalize_or(own);
            corners.push((*corner, normal));
        }
    }
    corners
}

/// What a round part is, in the file's axes: read back by `gltf_file/convex.rs` of the simulator.
fn solid_extras(part: &Part) -> Option<Box<RawValue>> {
    let mut extras = match part.primitive {
        Primitive::Cylinder { radius_m, half_height_m } => {
            serde_json::json!({ "solid": "cylinder", "radius_m": radius_m, "half_height_m": half_height_m })
        }
        Primitive::Capsule { radius_m, half_height_m } => {
            serde_json::json!({ "solid": "capsule", "radius_m": radius_m, "half_height_m": half_height_m })
        }
        Primitive::Sphere { radius_m } => serde_json::json!({ "solid": "sphere", "radius_m": radius_m }),
        Primitive::Cuboid { half_extents_m } => {
            serde_json::json!({ "solid": "box", "half_extents_m": half_extents_m.to_array() })
        }
        Primitive::Hull { .. } | Primitive::Concave(_) => return None,
    };
    let pose = mirror::pose(part.body_from_part);
    extras["translation"] = serde_json::json!(pose.translation.to_array());
    extras["rotation"] = serde_json::json!(pose.rotation.to_array());
    raw(&extras)
}

/// A number as it is written in decimals, without the digits that single precision lacks.
fn decimal(value: f32) -> serde_json::Value {
    value.to_string().parse::<f64>().map_or(serde_json::Value::Null, Into::into)
}

fn raw(value: &serde_json::Value) -> Option<Box<RawValue>> {
    RawValue::from_string(value.to_string()).ok()
}

/// The scene file with which the exported kitchen can be loaded again: what users begin with.
pub fn scene_file(kitchen: &Kitchen, gltf: &str) -> SceneFile {
    let mut nodes = Vec::new();
    for (index, (body, pose)) in kitchen.bodies().iter().zip(kitchen.settled_poses()).enumerate() {
        let carries =
            || tops::of(&body.shape, pose).iter().any(|top| kitchen.surfaces().iter().any(|s| s.same_as(top)));
        let role = match body.role {
            BodyRole::Robot => continue,
            BodyRole::Movable => Role::Movable,
            BodyRole::Static if body.category == "Floor" => Role::Floor,
            BodyRole::Static if carries() => Role::Surface,
            BodyRole::Static => Role::Fixed,
        };
        let matter = kitchen.matter(index);
        nodes.push(NodeEntry {
            name: body.name.clone(),
            role,
            mass_kg: matter.map(|matter| matter.mass_kg),
            friction: matter.map(|matter| matter.friction),
            category: None,
            convex: body.shape.is_dented().then_some(Convex::Decompose),
        });
    }
    SceneFile { gltf: gltf.to_owned(), nodes }
}

/// Builds a kitchen or reads a scene, writes it, and its scene file if that is asked for, and says so on standard
/// output.
pub fn write(subject: &Subject, out: &Path, scene: Option<&Path>) -> Result<()> {
    let kitchen = subject.load()?;
    let bytes = glb(&kitchen);
    std::fs::write(out, &bytes).with_context(|| format!("cannot write {}", out.display()))?;
    let things = kitchen.bodies().iter().filter(|body| body.role != BodyRole::Robot).count();
    println!("{}: {subject}, {things} bodies, {} kB", out.display(), bytes.len().div_ceil(1000));
    if let Some(path) = scene {
        let name = out.file_name().and_then(|name| name.to_str()).context("the file's name is not text")?;
        let text = toml::to_string(&scene_file(&kitchen, name)).context("the scene file")?;
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
        println!("{}: what each node is; load it with `actor check --scene {}`", path.display(), path.display());
    }
    Ok(())
}
