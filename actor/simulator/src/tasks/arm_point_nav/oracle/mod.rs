//! A planner with privileged state. It proves that the task can be solved in these kitchens with the 21 actions.
//!
//! An episode has two legs: to the target, and with it to the goal. A leg is planned as three searches, all of them A*
//! over the actions themselves: the arm into the way it travels ([`reach`]), the drive ([`floor`]), the arm to where
//! the leg ends ([`reach`] again). [`space`] says what is in the way.
//!
//! Two variants. [`Variant::Fast`] takes the shortest way it finds and sees only what is fixed: it pushes other things
//! in its way, and drives around them only if they do not move. [`Variant::Careful`] keeps clear of everything movable,
//! lifts before it drives, and tries each plan on a copy of the environment before it acts. The difference between the
//! two shows what a policy can gain from care.

mod floor;
mod moment;
mod obstacles;
mod plan;
mod reach;
mod search;
mod space;

use crate::kitchen::Kitchen;
use crate::robot::action::Action;
use crate::robot::configuration::Configuration;
use crate::tasks::arm_point_nav::Environment;
use crate::tasks::arm_point_nav::episode::Episode;
use moment::Moment;
use plan::{Carriage, Stands};
use rapier3d::math::Vec3;
use space::{Care, Space};
use std::collections::VecDeque;

/// Plans of one episode: after that many the oracle gives up.
const PLANS_MOST: u32 = 16;
/// A target that has moved this far since it was planned for is planned for again, metres.
const TARGET_MOVED_M: f32 = 0.005;
/// A trial that adds no more disturbance than this is good enough, metres.
const UNDISTURBED_M: f32 = 0.001;

/// Places from which the target is grasped before the goal counts as out of reach.
const GRASPS_MOST: usize = 12;
/// What has been pushed once is still touched: the fast variant may enter things this deeply when it goes around them,
/// metres.
const BRUSH_M: f32 = 0.003;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Variant {
    /// The shortest way; movable things are pushed.
    Fast,
    /// Around movable things.
    Careful,
}

impl Variant {
    pub const ALL: [Self; 2] = [Self::Fast, Self::Careful];

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|variant| variant.name() == name)
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Careful => "careful",
        }
    }

    /// Kinds of care, the preferred first.
    fn cares(self, failures: usize) -> &'static [Care] {
        const TOUCH: Care = Care { driving_m: Some(-BRUSH_M), reaching_m: None };
        const TOUCH_ALL: Care = Care { driving_m: Some(-BRUSH_M), reaching_m: Some(-BRUSH_M) };
        const CAREFUL: [Care; 5] = [
            Care { driving_m: Some(0.03), reaching_m: Some(0.015) },
            Care { driving_m: Some(0.015), reaching_m: Some(0.008) },
            Care { driving_m: Some(0.005), reaching_m: Some(0.002) },
            TOUCH,
            Care::NONE,
        ];
        match self {
            Self::Fast if failures == 0 => &[Care::NONE],
            Self::Fast => &[TOUCH_ALL, TOUCH, Care::NONE],
            Self::Careful => &CAREFUL,
        }
    }

    /// Ways to hold the arm while driving, the preferred first.
    fn carriages(self, holding: bool) -> &'static [Carriage] {
        const FAST: [Carriage; 6] = [
            Carriage::UNCHANGED,
            Carriage { height_ticks: None, wrist_ticks: Some([0, 0, 5]) },
            Carriage::at(14, 5),
            Carriage::at(16, 4),
            Carriage::at(12, 6),
            Carriage::at(18, 5),
        ];
        const EMPTY: [Carriage; 4] =
            [Carriage::UNCHANGED, Carriage::at(16, 4), Carriage::at(14, 5), Carriage::at(18, 5)];
        const LADEN: [Carriage; 7] = [
            Carriage::at(16, 4),
            Carriage::at(16, 6),
            Carriage::at(14, 4),
            Carriage::at(18, 4),
            Carriage::at(14, 6),
            Carriage::at(12, 5),
            Carriage::UNCHANGED,
        ];
        match (self, holding) {
            (Self::Fast, _) => &FAST,
            (Self::Careful, false) => &EMPTY,
            (Self::Careful, true) => &LADEN,
        }
    }
}

/// The oracle at work on one episode: a source of actions.
#[derive(Debug, Clone)]
pub struct Policy {
    variant: Variant,
    queue: VecDeque<Action>,
    // Where the last action was taken from, and where it should have led.
    last: Option<(Configuration, Action, Option<Configuration>)>,
    planned_for: Option<Vec3>,
    failed: Vec<(Configuration, Action)>,
    plans: u32,
}

impl Policy {
    pub fn new(variant: Variant) -> Self {
        Self { variant, queue: VecDeque::new(), last: None, planned_for: None, failed: Vec::new(), plans: 0 }
    }

    /// The next action. Done when the target is at its goal, and also when nothing is left to try.
    pub fn next(&mut self, environment: &Environment) -> Action {
        let now = *environment.robot();
        if let Some((from, action, expected)) = self.last.take()
            && expected.is_some_and(|expected| expected != now)
        {
            self.failed.push((from, action));
            self.queue.clear();
        }
        let target = environment.kitchen().target_movable(environment.episode().category);
        let target = environment.simulation().movable_pose(target).translation;
        let holding = environment.simulation().holding();
        let moved = self.planned_for.is_some_and(|planned| (target - planned).length() > TARGET_MOVED_M);
        if !holding && moved {
            self.queue.clear();
        }
        if self.queue.is_empty() {
            self.planned_for = (!holding).then_some(target);
            if self.plans < PLANS_MOST {
                self.plans += 1;
                self.queue.extend(self.plan(environment));
            }
        }
        let action = self.queue.pop_front().unwrap_or(Action::DoneMidLevel);
        self.last = Some((now, action, now.after(action)));
        action
    }

    /// Actions of the leg at hand, with `PickUp` or Done at its end; nothing if there is no way.
    fn plan(&self, environment: &Environment) -> Vec<Action> {
        let holding = environment.simulation().holding();
        let end = if holding { Action::DoneMidLevel } else { Action::PickUpMidLevel };
        let moment = Moment::of(environment);
        let mut least: Option<(f32, Vec<Action>)> = None;
        for &care in self.variant.cares(self.failed.len()) {
            for &carriage in self.variant.carriages(holding) {
                let Some(mut actions) = plan::leg(&moment, care, carriage, &self.failed, Stands::FIRST) else {
                    continue;
                };
                actions.push(end);
                if self.variant == Variant::Fast {
                    return actions;
                }
                let cost_m = trial(environment, &actions);
                if cost_m <= UNDISTURBED_M {
                    return actions;
                }
                if least.as_ref().is_none_or(|(least_m, _)| cost_m < *least_m) {
                    least = Some((cost_m, actions));
                }
            }
        }
        least.map(|(_, actions)| actions).unwrap_or_default()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Leg {
    ToTarget,
    ToGoal,
}

/// The first leg of an episode for which there is no way among what is fixed; none if both have one. A grasp after
/// which the robot cannot turn away with the target in hand is not the end of it: it is tried from other places.
pub fn first_obstructed_leg(kitchen: &Kitchen, episode: &Episode) -> Option<Leg> {
    let leg = |moment: &Moment, avoided: &[Configuration]| {
        let carriages = Variant::Fast.carriages(moment.held.is_some());
        carriages.iter().find_map(|&carriage| plan::leg(moment, Care::NONE, carriage, &[], Stands::all_but(avoided)))
    };
    let beginning = Moment::beginning(kitchen, episode);
    let mut tried = Vec::new();
    for _ in 0..GRASPS_MOST {
        let Some(holding) = leg(&beginning, &tried).and_then(|actions| beginning.clone().picked_up_after(&actions))
        else {
            break;
        };
        if leg(&holding, &[]).is_some() {
            return None;
        }
        tried.push(holding.robot);
    }
    Some(if tried.is_empty() { Leg::ToTarget } else { Leg::ToGoal })
}

/// Whether the robot touches nothing, fixed or movable, as an episode begins.
pub fn start_is_free(kitchen: &Kitchen, episode: &Episode) -> bool {
    let moment = Moment::beginning(kitchen, episode);
    let care = Care { driving_m: Some(0.0), reaching_m: Some(0.0) };
    Space::of(&moment, care).for_driving().free(&moment.robot.posture())
}

/// Disturbance that the actions add on a copy of the environment, metres; infinite if one of them fails.
fn trial(environment: &Environment, actions: &[Action]) -> f32 {
    let mut copy = environment.clone();
    let before_m = copy.disturbance_m();
    let mut after_m = before_m;
    for &action in actions {
        if copy.ended() {
            return f32::INFINITY;
        }
        let transition = copy.step(action);
        if transition.failed() {
            return f32::INFINITY;
        }
        after_m = transition.disturbance_m;
    }
    after_m - before_m
}
