//! Categories of movable things as data: dimensions, masses, materials, and how often iTHOR's kitchens have them.
//!
//! Dimensions are those of common household things, metres; masses kilograms. Each family of things has a file: a
//! table and the shapes that only it needs; [`forms`] holds what they share. Shapes stand upright on y = 0 as they are
//! written there and are then centred. Round things have a flat underside: rapier has no rolling friction, so a
//! sphere on a counter would never come to rest.

mod appliances;
mod cookware;
mod cutlery;
mod food;
mod forms;
mod furniture;
mod household;
pub mod list;
mod pantry;
mod tableware;
mod utensils;

use crate::physics::geometry::{Solid, centred};
use crate::shape::Shape;
use rapier3d::math::Pose3;
use std::sync::LazyLock;

/// Where things of a category stand. A kitchen that lacks the named place puts them on any [`Place::Surface`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// On a counter, table or shelf.
    Surface,
    /// On a counter: appliances and what is used beside sink and stove.
    Counter,
    /// On the dining table or another table.
    Table,
    /// On an open shelf.
    Shelf,
    /// In or beside the sink.
    Sink,
    /// On the stove top or beside it.
    Stove,
    /// On the floor by the dining table (anywhere on the floor if there is none).
    Seat,
    /// On the floor.
    Floor,
}

/// What the surface of a thing is made of: decides its friction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Material {
    /// Steel, cast iron, aluminium, tin plate.
    Metal,
    /// Glass.
    Glass,
    /// Glazed stoneware and porcelain.
    Ceramic,
    /// Wood, bamboo, cork, wicker.
    Wood,
    /// Hard plastics.
    Plastic,
    /// Rubber and silicone, and things that stand on rubber feet.
    Rubber,
    /// Paper and cardboard.
    Paper,
    /// Cloth, sponge, bristles.
    Cloth,
    /// Fruit, vegetables, bread.
    Food,
}

impl Material {
    /// Coulomb friction coefficient, dry, against a wooden or laminate top: the middle of the ranges that engineering
    /// handbooks give for the pair (metal on wood 0.2 to 0.6, wood on wood 0.25 to 0.5, rubber on solids 0.7 to 1.0),
    /// rounded to 0.05. The physics averages it with the coefficient of what the thing stands on.
    pub const fn friction(self) -> f32 {
        match self {
            Self::Metal | Self::Glass | Self::Plastic => 0.4,
            Self::Ceramic | Self::Wood => 0.45,
            Self::Paper => 0.5,
            Self::Food => 0.55,
            Self::Cloth => 0.6,
            Self::Rubber => 0.85,
        }
    }
}

/// How often kitchens have things of a category.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Presence {
    /// One in every kitchen.
    Every,
    /// In some kitchens, as iTHOR's statistics have it.
    Share {
        /// Share of the kitchens that have it.
        share: f32,
        /// Mean count in a kitchen that has it.
        per_kitchen: f32,
    },
    /// Not among iTHOR's categories: a kitchen draws a few such categories for variety, one thing of each.
    Extra,
}

/// One category of movable things.
#[derive(Debug, Clone, Copy)]
pub struct Category {
    /// Its name; iTHOR's where iTHOR has the category.
    pub name: &'static str,
    /// Mass, kilograms.
    pub mass_kg: f32,
    /// What its surface is made of.
    pub material: Material,
    /// Colour in pictures and exports, 8-bit sRGB.
    pub colour: [u8; 3],
    /// Where it stands.
    pub place: Place,
    /// How often kitchens have it.
    pub presence: Presence,
    shape: fn() -> Shape,
}

impl Category {
    /// Its shape, origin at the centre of the bounding box.
    pub fn shape(&self) -> Shape {
        centred((self.shape)())
    }

    /// Coulomb friction coefficient of its surface.
    pub const fn friction(&self) -> f32 {
        self.material.friction()
    }

    /// Share of the kitchens that have it; 0 for an [`Presence::Extra`], which is drawn in another way.
    pub const fn share(&self) -> f32 {
        match self.presence {
            Presence::Every => 1.0,
            Presence::Share { share, .. } => share,
            Presence::Extra => 0.0,
        }
    }

    /// Most of them in one kitchen: a count drawn uniformly from 1 to this has the reference's mean, as nearly as a
    /// whole number allows.
    pub fn most(&self) -> u32 {
        match self.presence {
            Presence::Share { per_kitchen, .. } => (2.0 * per_kitchen - 0.5) as u32,
            Presence::Every | Presence::Extra => 1,
        }
    }

    const fn every(self) -> Self {
        Self { presence: Presence::Every, ..self }
    }

    /// In this many of iTHOR's 30 kitchens, with this mean count where there is any.
    const fn some(self, kitchens: u8, per_kitchen: f32) -> Self {
        Self { presence: Presence::Share { share: kitchens as f32 / 30.0, per_kitchen }, ..self }
    }
}

/// A category of the variety; [`Category::every`] and [`Category::some`] change how often it is there.
const fn thing(
    name: &'static str,
    mass_kg: f32,
    material: Material,
    colour: [u8; 3],
    place: Place,
    shape: fn() -> Shape,
) -> Category {
    Category { name, mass_kg, material, colour, place, presence: Presence::Extra, shape }
}

/// Colours that many categories share, 8-bit sRGB.
mod colour {
    pub const STEEL: [u8; 3] = [186, 190, 195];
    pub const IRON: [u8; 3] = [58, 58, 62];
    pub const COPPER: [u8; 3] = [184, 115, 72];
    pub const GLASS: [u8; 3] = [190, 215, 215];
    pub const GREEN_GLASS: [u8; 3] = [52, 86, 58];
    pub const AMBER_GLASS: [u8; 3] = [122, 76, 36];
    pub const WHITE: [u8; 3] = [238, 236, 230];
    pub const CREAM: [u8; 3] = [232, 220, 192];
    pub const BLACK: [u8; 3] = [40, 40, 44];
    pub const GREY: [u8; 3] = [128, 130, 134];
    pub const WOOD: [u8; 3] = [176, 130, 84];
    pub const DARK_WOOD: [u8; 3] = [112, 74, 46];
    pub const WICKER: [u8; 3] = [190, 154, 102];
    pub const RED: [u8; 3] = [190, 52, 46];
    pub const ORANGE: [u8; 3] = [232, 138, 44];
    pub const YELLOW: [u8; 3] = [236, 202, 68];
    pub const GREEN: [u8; 3] = [96, 150, 66];
    pub const DARK_GREEN: [u8; 3] = [52, 98, 50];
    pub const BLUE: [u8; 3] = [70, 112, 172];
    pub const PURPLE: [u8; 3] = [88, 52, 88];
    pub const BROWN: [u8; 3] = [136, 90, 52];
    pub const KRAFT: [u8; 3] = [188, 152, 108];
    pub const TERRACOTTA: [u8; 3] = [188, 98, 66];
    pub const PINK: [u8; 3] = [222, 150, 150];
}

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
