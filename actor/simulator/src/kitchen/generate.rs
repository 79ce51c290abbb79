//! Generates a kitchen from its number: draws a room, lets it come to rest, and draws again while anything is wrong.

use super::assembly::{Demands, Flaw};
use super::draw::{ATTEMPTS_EACH, at_attempt, draw_fitted};
use super::kitchen_key::KitchenKey;
use super::layout::floor_plan::Rectangle;
use super::layout::{FittedRoom, Plan};
use super::overlap::overlaps;
use super::room::{Room, Thing};
use super::settled::Kitchen;
use super::{ithor, likeness, placement};
use crate::physics::fixed_scene::FixedScene;
use crate::physics::geometry::Solid;
use proto::config::SimulationConfig;
use proto::kitchen::{KitchenId, Split, TargetCategory};

/// A room in which something found no place, or fell, is drawn anew this many times.
const ATTEMPTS: u32 = 32;
/// A procedural kitchen takes so many places among its set in all: some of them hold more than fits.
pub(super) const EDITIONS: u32 = 64;
/// Fewest spots of a target category: in any room, ...
const SPOTS_LEAST_ANYWHERE: usize = 100;
/// ... and in a training kitchen; half as many in others.
pub const SPOTS_LEAST: usize = 400;
/// Least share of a generated kitchen's free floor that is connected.
pub const CONNECTED_LEAST: f32 = 0.95;
/// What a generated room must offer before it is looked at closely.
const DEMANDS: Demands = Demands { every_target: true, spots: SPOTS_LEAST_ANYWHERE, stands: 80 };

#[derive(Debug, thiserror::Error)]
pub enum KitchenError {
    #[error("kitchen {kitchen} is a scene of a run: no generator makes it")]
    NotBuiltIn { kitchen: KitchenId },
    #[error("kitchen {kitchen}: no good room in {attempts} attempts; the last one failed at {reason}")]
    NoRoom { kitchen: KitchenId, attempts: u32, reason: String },
    #[error("kitchen {kitchen}: what was kept of it does not fit this program: {problem}")]
    FoundKitchen { kitchen: KitchenId, problem: String },
}

#[derive(Debug, Clone)]
pub struct DrawnRoom {
    pub room: Room,
    pub plan: Plan,
    /// Floor that is to stay free of fixtures: before fronts and the door.
    pub kept_clear: Vec<Rectangle>,
}

/// Draws a kitchen's room, for the `attempt`th time from 0, and furnishes it; the error is what found no place.
pub fn draw_room(kitchen: impl Into<KitchenKey>, attempt: u32) -> Result<DrawnRoom, String> {
    let kitchen_key = kitchen.into();
    let (fitted, mut random) = draw_fitted(kitchen_key, attempt)?;
    if kitchen_key.id().is_procedural()
        && let Some((id, distance)) = likeness::nearest(&fitted)
        && distance < likeness::least_distance()
    {
        return Err(format!("too near to kitchen {id}: {distance:.2}"));
    }
    let mut scene = FixedScene::default();
    for fixture in &fitted.fixtures {
        scene.add(&Solid::of(&fixture.shape), &fixture.pose);
    }
    let kitchen_key = at_attempt(kitchen_key, attempt);
    let things =
        placement::place(kitchen_key, &fitted, &scene, &mut random).map_err(|what| format!("a place for {what}"))?;
    Ok(DrawnRoom::of(fitted, things))
}

impl DrawnRoom {
    pub(super) fn of(fitted: FittedRoom, things: Vec<Thing>) -> Self {
        let room = Room {
            fixtures: fitted.fixtures,
            things,
            surfaces: fitted.worktops.iter().map(|worktop| worktop.surface).collect(),
            floor: (fitted.floor.low, fitted.floor.high),
        };
        Self { room, plan: fitted.plan, kept_clear: fitted.kept_clear }
    }

    /// Lets the room come to rest. The error says what is wrong with it; it is never empty.
    pub fn settle(self, id: KitchenId, timestep_s: f32) -> Result<Kitchen, Vec<Flaw>> {
        let Self { room, plan, kept_clear } = self;
        let kitchen = Kitchen::assemble(id, timestep_s, room, &DEMANDS)?;
        Ok(Kitchen { plan: Some(plan), kept_clear, ..kitchen })
    }
}

impl Kitchen {
    pub(super) fn search(kitchen_key: KitchenKey, simulation: SimulationConfig) -> Result<Self, KitchenError> {
        let id = kitchen_key.id();
        if id.scene_index().is_some() {
            return Err(KitchenError::NotBuiltIn { kitchen: id });
        }
        let attempts = if id.is_procedural() { ATTEMPTS_EACH * EDITIONS } else { ATTEMPTS };
        let mut reason = String::new();
        for attempt in 0..attempts {
            let outcome = draw_room(kitchen_key, attempt).and_then(|drawn| {
                let flaw = |flaws: Vec<Flaw>| flaws.first().map_or_else(String::new, ToString::to_string);
                drawn.settle(id, simulation.timestep_s).map_err(flaw)?.acceptable()
            });
            match outcome {
                Ok(kitchen) => return Ok(Self { attempt, ..kitchen }),
                Err(why) => {
                    tracing::debug!("kitchen {id}, attempt {attempt}: {why}");
                    reason = why;
                }
            }
        }
        Err(KitchenError::NoRoom { kitchen: id, attempts, reason })
    }

    fn acceptable(self) -> Result<Self, String> {
        let things = self.thing_count();
        if !(ithor::THINGS[0]..=ithor::THINGS[2]).contains(&(things as f32)) {
            return Err(format!("{things} things"));
        }
        if self.connected_share < CONNECTED_LEAST {
            return Err(format!("free floor ({:.2} of it connected)", self.connected_share));
        }
        if let Some(overlap) = overlaps(self.bodies(), self.settled_poses(), self.movable_bodies()).first() {
            return Err(overlap.to_string());
        }
        let least = if self.id.split() == Split::Train { SPOTS_LEAST } else { SPOTS_LEAST / 2 };
        for category in TargetCategory::ALL {
            let spots = self.target_spots(category).len();
            if spots < least {
                return Err(format!("{spots} spots for {}", category.name()));
            }
        }
        Ok(self)
    }
}
