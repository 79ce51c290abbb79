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
use rapier3d::math::Pose3;
use std::sync::LazyLock;

/// All movable categories, largest footprint first: placement goes down this list.
pub static CATEGORIES: LazyLock<Vec<Category>> = LazyLock::new(|| {
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
    let footprint_m2 = |category: &Category| {
        let extents = Solid::of(&category.shape()).aabb(&Pose3::identity()).extents();
        extents.x * extents.z
    };
    let mut sized: Vec<(f32, Category)> =
        families.into_iter().flatten().map(|&category| (footprint_m2(&category), category)).collect();
    // A stable sort: things of one size stay in the order of the tables.
    sized.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    sized.into_iter().map(|(_, category)| category).collect()
});

/// The category with this name.
pub fn category(name: &str) -> Option<&'static Category> {
    CATEGORIES.iter().find(|category| category.name == name)
}

#[cfg(test)]
mod tests;
