//! `actor kitchens categories`: every category of movable things, for whoever describes a scene of their own.

use anyhow::Result;
use proto::kitchen::TargetCategory;
use rapier3d::math::Pose3;
use serde::Serialize;
use simulator::kitchen::catalogue::{CATEGORIES, Category, Material, Place, Presence};
use simulator::physics::geometry::Solid;
use simulator::shape::{Primitive, Shape};
use std::io::Write;

#[derive(Debug, Clone, Serialize)]
pub struct Listed {
    pub name: &'static str,
    /// `box`, `cylinder`, ..., or how many parts it has.
    pub shape: String,
    /// Size of its bounding box as it stands: width, height, depth, metres.
    pub size_m: [f32; 3],
    pub mass_kg: f32,
    pub material: &'static str,
    pub friction: f32,
    /// Whether it can be an episode's target, which the robot picks up: `seen` or `novel`, none of what is only in the
    /// way.
    pub target: Option<&'static str>,
    pub place: &'static str,
    /// Share of the generated kitchens that are meant to have it; none of what is drawn for variety.
    pub share_of_kitchens: Option<f32>,
}

pub fn all() -> Vec<Listed> {
    let mut listed: Vec<Listed> = CATEGORIES.iter().map(Listed::of).collect();
    listed.sort_by_key(|category| category.name);
    listed
}

pub fn run(json: bool, mut out: impl Write) -> Result<()> {
    let all = all();
    if json {
        serde_json::to_writer_pretty(&mut out, &all)?;
        writeln!(out)?;
        return Ok(());
    }
    let name = all.iter().map(|category| category.name.len()).max().unwrap_or(0);
    writeln!(
        out,
        "{:name$}  {:9}  {:>20}  {:>6}  {:>8}  {:6}  stands on",
        "category", "shape", "w × h × d (cm)", "kg", "friction", "target"
    )?;
    for category in &all {
        let [width, height, depth] = category.size_m.map(|side| format!("{:.1}", 100.0 * side));
        writeln!(
            out,
            "{:name$}  {:9}  {:>20}  {:>6.2}  {:>8.2}  {:6}  {}",
            category.name,
            category.shape,
            format!("{width} × {height} × {depth}"),
            category.mass_kg,
            category.friction,
            category.target.unwrap_or("–"),
            category.place,
        )?;
    }
    let targets = all.iter().filter(|category| category.target.is_some()).count();
    writeln!(
        out,
        "{} categories. {targets} can be targets, which the robot picks up (seen: in training, too; novel: in evaluation \
         only); the others are in the way.",
        all.len()
    )?;
    Ok(())
}

impl Listed {
    fn of(category: &Category) -> Self {
        let shape = category.shape;
        let target = TargetCategory::ALL.into_iter().find(|target| target.name() == category.name);
        Self {
            name: category.name,
            size_m: Solid::of(shape).aabb(&Pose3::identity()).extents().to_array(),
            shape: kind(shape),
            mass_kg: category.mass_kg,
            material: material(category.material),
            friction: category.friction(),
            target: target.map(|target| if TargetCategory::SEEN.contains(&target) { "seen" } else { "novel" }),
            place: place(category.place),
            share_of_kitchens: match category.presence {
                Presence::Extra => None,
                Presence::Every | Presence::Share { .. } => Some(category.share()),
            },
        }
    }
}

fn kind(shape: &Shape) -> String {
    let [part] = shape.parts.as_slice() else { return format!("{} parts", shape.parts.len()) };
    match part.primitive {
        Primitive::Cuboid { .. } => "box",
        Primitive::Cylinder { .. } => "cylinder",
        Primitive::Capsule { .. } => "capsule",
        Primitive::Sphere { .. } => "sphere",
        Primitive::Hull { .. } => "hull",
        Primitive::Concave(_) => "mesh",
    }
    .to_owned()
}

fn place(place: Place) -> &'static str {
    match place {
        Place::Surface => "counter, table or shelf",
        Place::Counter => "counter",
        Place::Table => "table",
        Place::Shelf => "shelf",
        Place::Sink => "sink",
        Place::Stove => "stove",
        Place::Seat => "floor, at a table",
        Place::Floor => "floor",
    }
}

fn material(material: Material) -> &'static str {
    match material {
        Material::Metal => "metal",
        Material::Glass => "glass",
        Material::Ceramic => "ceramic",
        Material::Wood => "wood",
        Material::Plastic => "plastic",
        Material::Rubber => "rubber",
        Material::Paper => "paper",
        Material::Cloth => "cloth",
        Material::Food => "food",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_category_is_listed_once_with_its_own_figures() {
        let all = all();
        assert_eq!(all.len(), CATEGORIES.len());
        assert!(all.is_sorted_by(|a, b| a.name < b.name), "by name, none twice");
        let targets: Vec<&str> = all.iter().filter(|c| c.target == Some("novel")).map(|c| c.name).collect();
        assert_eq!(targets, ["Cup", "Egg", "Pan", "Potato", "SoapBottle", "Spatula"]);
        assert_eq!(all.iter().filter(|category| category.target == Some("seen")).count(), 6);
        let mug = all.iter().find(|category| category.name == "Mug").unwrap();
        assert_eq!((mug.mass_kg, mug.friction, mug.place), (0.35, 0.45, "counter, table or shelf"));
        assert!((mug.size_m[1] - 0.095).abs() < 1e-4, "{mug:?}");

        let mut json = Vec::new();
        run(true, &mut json).unwrap();
        let read: Vec<serde_json::Value> = serde_json::from_slice(&json).unwrap();
        assert_eq!((read.len(), &read[0]["name"]), (all.len(), &all[0].name.into()));
        let mut table = Vec::new();
        run(false, &mut table).unwrap();
        // A head, a line each, and what the words mean.
        assert_eq!(String::from_utf8(table).unwrap().lines().count(), all.len() + 2);
    }
}
