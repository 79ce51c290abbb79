//! `actor export-peers`: kitchens as other programs read them, so that these can be measured on the same triangles,
//! bodies and motions.
//!
//! ```text
//! index.json                    conventions, and for each kitchen its bodies and policies
//! kitchen-07/kitchen.xml        the kitchen as MJCF
//! kitchen-07/triangles.npy      [triangle, corner, xyz]: finest meshes, each in its body's frame
//! kitchen-07/random/            one episode under a policy:
//!     start.npy                 [thing, pose]: where movable things stand at the start
//!     end.npy                   [thing, pose]: and at the end
//!     robot.npy                 [sub-step, part, pose]: the robot's way
//!     held_index.npy            [sub-step]: the movable thing on the magnet, or −1
//!     held.npy                  [sub-step, pose]: where that goes
//!     substeps_until.npy        [action]: sub-steps taken when it was over
//!     camera.npy                [action, pose]: the camera's pose then
//!     frame_bodies.npy          [frame, body, pose]: what was drawn,
//!     frame_camera.npy          [frame, pose]: from where,
//!     frame_depth_mm.npy        [frame, row, column]: and what came out
//! ```
//!
//! A pose is seven numbers: translation (metres), then the rotation's quaternion x, y, z, w.

mod trace;

use crate::bench::action_source::PolicyKind;
use anyhow::{Context, Result};
use bytemuck::NoUninit;
use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::kitchen::KitchenChoice;
use rapier3d::math::Pose3;
use serde_json::{Value, json};
use simulator::depth::{NEAR_M, TAN_HALF_FIELD_OF_VIEW};
use simulator::kitchen::{BodyRole, Kitchen};
use simulator::mesh::triangles_of;
use simulator::mjcf;
use simulator::robot::links::PART_COUNT;
use simulator::shape::Shape;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use trace::{Trace, record};

const POSE: usize = 7;

/// What to write.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Kitchens: `all`, or numbers with commas between.
    #[arg(long, default_value = "all", value_name = "all|1,2,...")]
    kitchens: KitchenChoice,
    /// Who chooses the actions, in an episode each.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = PolicyKind::ALL, value_name = "POLICY,...")]
    policies: Vec<PolicyKind>,
    /// Depth frames of each episode.
    #[arg(long, default_value_t = 16, value_name = "N")]
    frames: usize,
    /// The folder to write.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let config = Config::default();
    let mut kitchens = Vec::new();
    for &id in &arguments.kitchens.0 {
        let kitchen = Arc::new(Kitchen::build(id, &config.simulation)?);
        let name = format!("kitchen-{:02}", id.number());
        let folder = arguments.out.join(&name);
        let description = export(&kitchen, &config, arguments, &folder)
            .with_context(|| format!("cannot export kitchen {id} to {}", folder.display()))?;
        kitchens.push(json!({ "number": id.number(), "folder": name, "bodies": description }));
    }
    let index = json!({
        "timestep_s": config.simulation.timestep_s,
        "substeps": config.simulation.substeps,
        "frame_side": FRAME_SIDE,
        "tan_half_field_of_view": TAN_HALF_FIELD_OF_VIEW,
        "near_m": NEAR_M,
        "robot_body": mjcf::ROBOT_BODY,
        "policies": arguments.policies.iter().map(|policy| policy.name()).collect::<Vec<_>>(),
        "kitchens": kitchens,
    });
    let path = arguments.out.join("index.json");
    fs::write(&path, format!("{index:#}\n")).with_context(|| format!("cannot write {}", path.display()))
}

/// Writes one kitchen's folder; returns its bodies for the index.
fn export(kitchen: &Arc<Kitchen>, config: &Config, arguments: &Arguments, folder: &Path) -> Result<Value> {
    fs::create_dir_all(folder)?;
    fs::write(folder.join("kitchen.xml"), mjcf::mjcf(kitchen, config.simulation.timestep_s))?;
    let mut corners: Vec<f32> = Vec::new();
    let mut bodies = Vec::new();
    let mut movables = kitchen.movables().iter();
    for body in kitchen.bodies() {
        let first_triangle = corners.len() / 9;
        let mut part_triangles = Vec::new();
        for part in &body.shape.parts {
            let triangles = triangles_of(&Shape { parts: vec![part.clone()] });
            part_triangles.push(triangles.len());
            corners.extend(triangles.iter().flatten().flatten());
        }
        let mass_kg = match body.role {
            BodyRole::Movable => movables.next().map(|&handle| kitchen.world().body(handle).mass()),
            BodyRole::Static | BodyRole::Robot => None,
        };
        bodies.push(json!({
            "name": body.name,
            "role": match body.role {
                BodyRole::Static => "static",
                BodyRole::Movable => "movable",
                BodyRole::Robot => "robot",
            },
            "mass_kg": mass_kg,
            "first_triangle": first_triangle,
            "part_triangles": part_triangles,
        }));
    }
    write_array(&folder.join("triangles.npy"), "<f4", &corners, &[3, 3])?;
    for &policy in &arguments.policies {
        let trace = record(kitchen, config, policy, arguments.frames)?;
        write_trace(&trace, kitchen.bodies().len(), &folder.join(policy.name()))?;
    }
    Ok(Value::Array(bodies))
}

fn write_trace(trace: &Trace, body_count: usize, folder: &Path) -> Result<()> {
    fs::create_dir_all(folder)?;
    let substeps = &trace.substeps;
    let write_poses = |name: &str, poses: &mut dyn Iterator<Item = &Pose3>, row: &[usize]| {
        let numbers: Vec<f32> = poses.flat_map(numbers).collect();
        write_array(&folder.join(name), "<f4", &numbers, row)
    };
    write_poses("start.npy", &mut trace.world_from_movables.iter(), &[POSE])?;
    write_poses("end.npy", &mut trace.world_from_movables_at_end.iter(), &[POSE])?;
    write_poses("robot.npy", &mut substeps.iter().flat_map(|substep| &substep.parts), &[PART_COUNT, POSE])?;
    let nowhere = Pose3::identity();
    let mut held = substeps.iter().map(|substep| substep.held.as_ref().map_or(&nowhere, |(_, pose)| pose));
    write_poses("held.npy", &mut held, &[POSE])?;
    let held_index = |held: Option<(usize, Pose3)>| held.map_or(-1, |(movable, _)| movable as i32);
    let held_indices: Vec<i32> = substeps.iter().map(|substep| held_index(substep.held)).collect();
    write_array(&folder.join("held_index.npy"), "<i4", &held_indices, &[])?;
    write_array(&folder.join("substeps_until.npy"), "<u4", &trace.substeps_until, &[])?;
    write_poses("camera.npy", &mut trace.world_from_camera.iter(), &[POSE])?;
    let mut drawn = trace.frames.iter().flat_map(|frame| &frame.world_from_bodies);
    write_poses("frame_bodies.npy", &mut drawn, &[body_count, POSE])?;
    write_poses("frame_camera.npy", &mut trace.frames.iter().map(|frame| &frame.world_from_camera), &[POSE])?;
    let depth_mm: Vec<u16> = trace.frames.iter().flat_map(|frame| &frame.depth_mm).copied().collect();
    write_array(&folder.join("frame_depth_mm.npy"), "<u2", &depth_mm, &[FRAME_SIDE, FRAME_SIDE])?;
    Ok(())
}

fn numbers(pose: &Pose3) -> [f32; POSE] {
    let (t, r) = (pose.translation, pose.rotation);
    [t.x, t.y, t.z, r.x, r.y, r.z, r.w]
}

/// Writes an NPY file of this kind: rows of this shape.
fn write_array<T: NoUninit>(path: &Path, kind: &str, elements: &[T], row: &[usize]) -> io::Result<()> {
    let shape = [&[elements.len() / row.iter().product::<usize>()], row].concat();
    fs::write(path, [&dataset::npy_header(kind, &shape), bytemuck::cast_slice(elements)].concat())
}
