//! Categories of movable things as data: dimensions, masses, materials, and how often iTHOR's kitchens have them.
//!
//! Dimensions are those of common household things, metres; masses kilograms; colours 8-bit sRGB. Each family of things
//! has a table, whose rows `category::Row` reads, and their parts `forms::Piece`. Shapes stand upright on y = 0 as
//! they are written there and are then centred. Round things have a flat underside: rapier has no rolling friction, so a
//! sphere on a counter would never come to rest. A turned body stands on a low round foot: a hull's underside is several
//! triangles to the contact solver, which then rocks on one of them.

mod category;
mod forms;

pub use category::{Category, Material, Place, Presence};

use crate::physics::geometry::Solid;
use category::Row;
use rapier3d::math::Pose3;
use serde::Deserialize;
use std::sync::LazyLock;

/// All movable categories, largest footprint first: placement goes down this list.
pub static CATEGORIES: LazyLock<Vec<Category>> =
    LazyLock::new(|| PATTERNS.iter().map(|pattern| pattern.category).collect());

/// What things of a category are made from. Kitchens share the collision geometry: hulls take long to find.
#[derive(Debug)]
pub(crate) struct Pattern {
    pub category: Category,
    pub solid: Solid,
}

static PATTERNS: LazyLock<Vec<Pattern>> = LazyLock::new(|| {
    #[derive(Deserialize)]
    struct Family {
        things: Vec<Row>,
    }
    let families = [
        include_str!("furniture.toml"),
        include_str!("appliances.toml"),
        include_str!("cookware.toml"),
        include_str!("tableware.toml"),
        include_str!("cutlery.toml"),
        include_str!("utensils.toml"),
        include_str!("pantry.toml"),
        include_str!("food.toml"),
        include_str!("household.toml"),
    ];
    let rows = families.into_iter().flat_map(|family| {
        toml::from_str::<Family>(family).expect("the tables are part of the program, and a test reads them").things
    });
    let pattern = |row: Row| {
        let category = row.category();
        Pattern { category, solid: Solid::of(category.shape) }
    };
    let mut patterns: Vec<Pattern> = rows.map(pattern).collect();
    let footprint_m2 = |pattern: &Pattern| {
        let extents = pattern.solid.aabb(&Pose3::identity()).extents();
        extents.x * extents.z
    };
    // A stable sort: things of one size stay in the order of the tables.
    patterns.sort_by(|a, b| footprint_m2(b).total_cmp(&footprint_m2(a)));
    patterns
});

/// What things of a category are made from, by its place among [`CATEGORIES`].
pub(crate) fn pattern(index: usize) -> Option<&'static Pattern> {
    PATTERNS.get(index)
}

pub fn category(name: &str) -> Option<&'static Category> {
    CATEGORIES.iter().find(|category| category.name == name)
}

#[cfg(test)]
mod tests;
