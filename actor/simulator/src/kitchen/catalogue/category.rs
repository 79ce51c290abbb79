//! What a category is: mass, material, colour, shape, where its things stand and how often kitchens have them.

use super::forms::{Piece, shape_of};
use crate::physics::geometry::centred;
use crate::shape::Shape;
use serde::Deserialize;

/// Where things of a category stand. A kitchen that lacks the named place puts them on any [`Place::Surface`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Place {
    Surface,
    /// On a counter: appliances and what is used beside sink and stove.
    Counter,
    Table,
    Shelf,
    /// In or beside the sink.
    Sink,
    /// On the stove top or beside it.
    Stove,
    /// On the floor by the dining table (anywhere on the floor if there is none).
    Seat,
    Floor,
}

/// What the surface of a thing is made of: decides its friction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Material {
    /// Steel, cast iron, aluminium, tin plate.
    Metal,
    Glass,
    /// Glazed stoneware and porcelain.
    Ceramic,
    /// Wood, bamboo, cork, wicker.
    Wood,
    Plastic,
    /// Rubber and silicone, and things that stand on rubber feet.
    Rubber,
    Paper,
    /// Cloth, sponge, bristles.
    Cloth,
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

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Presence {
    Every,
    /// In some kitchens, as iTHOR's statistics have it.
    Share {
        share: f32,
        /// Mean count in a kitchen that has it.
        per_kitchen: f32,
    },
    /// Not among iTHOR's categories: a kitchen draws a few such categories for variety, one thing of each.
    Extra,
}

#[derive(Debug, Clone, Copy)]
pub struct Category {
    /// Its name; iTHOR's where iTHOR has the category.
    pub name: &'static str,
    pub mass_kg: f32,
    pub material: Material,
    /// Colour in pictures and exports, 8-bit sRGB.
    pub colour: [u8; 3],
    pub place: Place,
    pub presence: Presence,
    /// Origin at the centre of the bounding box.
    pub shape: &'static Shape,
}

impl Category {
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
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Row {
    name: String,
    mass_kg: f32,
    material: Material,
    colour: [u8; 3],
    place: Place,
    /// How many of iTHOR's 30 kitchens have it.
    kitchens: Option<u8>,
    per_kitchen: Option<f32>,
    parts: Vec<Piece>,
}

impl Row {
    /// Its category, for as long as the process lives.
    pub fn category(self) -> Category {
        let Self { name, mass_kg, material, colour, place, kitchens, per_kitchen, parts } = self;
        let presence = match kitchens {
            Some(30) => Presence::Every,
            Some(some) => Presence::Share { share: f32::from(some) / 30.0, per_kitchen: per_kitchen.unwrap_or(1.0) },
            None => Presence::Extra,
        };
        let shape = Box::leak(Box::new(centred(shape_of(&parts))));
        Category { name: name.leak(), mass_kg, material, colour, place, presence, shape }
    }
}
