//! Categories of movable things as data: dimensions, masses, materials, and how often iTHOR's kitchens have them.
//!
//! Dimensions are those of common household things, metres; masses kilograms. Each family of things has a file: a
//! table and the shapes that only it needs; [`forms`] holds what they share. Shapes stand upright on y = 0 as they are
//! written there and are then centred. Round things have a flat underside: rapier has no rolling friction, so a
//! sphere on a counter would never come to rest.

mod appliances;
mod category;
mod colour;
mod cookware;
mod cutlery;
mod food;
mod forms;
mod furniture;
mod household;
mod pantry;
mod tableware;
mod utensils;

pub use category::{Category, Material, Place, Presence};

use crate::physics::geometry::Solid;
use crate::shape::Shape;
use rapier3d::math::Pose3;
use std::sync::LazyLock;

/// All movable categories, largest footprint first: placement goes down this list.
pub static CATEGORIES: LazyLock<Vec<Category>> =
    LazyLock::new(|| PATTERNS.iter().map(|pattern| pattern.category).collect());

/// What things of a category are made from. Kitchens share the collision geometry: hulls take long to find.
#[derive(Debug)]
pub(crate) struct Pattern {
    pub category: Category,
    pub shape: Shape,
    pub solid: Solid,
}

static PATTERNS: LazyLock<Vec<Pattern>> = LazyLock::new(|| {
    let families = [
        furniture::FURNITURE,
        appliances::APPLIANCES,
        cookware::COOKWARE,
        tableware::TABLEWARE,
        cutlery::CUTLERY,
        utensils::UTENSILS,
        pantry::PANTRY,
        food::FOOD,
        household::HOUSEHOLD,
    ];
    let pattern = |&category: &Category| {
        let shape = category.shape();
        Pattern { category, solid: Solid::of(&shape), shape }
    };
    let mut patterns: Vec<Pattern> = families.into_iter().flatten().map(pattern).collect();
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
