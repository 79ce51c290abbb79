//! One leg of an episode: hold the arm so that it can travel, drive, reach.

use super::floor::Floor;
use super::moment::Moment;
use super::reach::{self, Aim};
use super::search::Search;
use super::space::{Care, Space};
use crate::robot::action::Action;
use crate::robot::configuration::Configuration;

/// Floor poses that a search expands.
const EXPANSIONS: u32 = 40_000;
/// Floor poses in reach whose final configurations are looked for before the best of them is chosen.
const STANDS_COMPARED: usize = 16;
/// Floor poses nearer to each other than this count as the same if they face the same way, metres.
const SAME_STAND_M: f32 = 0.1;

/// Which floor poses in reach of the aim are looked at.
#[derive(Debug, Clone, Copy)]
pub struct Stands<'a> {
    most: usize,
    /// None that is like one of these.
    avoided: &'a [Configuration],
}

impl<'a> Stands<'a> {
    /// The first few: for a caller that has another plan to try.
    pub const FIRST: Self = Self { most: 400, avoided: &[] };

    /// Nearly all of them: for a caller that must know whether any way exists. They come in order of the drive, those
    /// from which the arm just does not reach before those from which it does.
    pub const fn all_but(avoided: &'a [Configuration]) -> Self {
        Self { most: 4000, avoided }
    }

    fn avoid(&self, at: &Configuration) -> bool {
        self.avoided.iter().any(|other| {
            let (x, z) = (at.x_m - other.x_m, at.z_m - other.z_m);
            at.yaw_ticks == other.yaw_ticks && x * x + z * z < SAME_STAND_M * SAME_STAND_M
        })
    }
}

/// How the arm is held on the way: its height (none: as it is) and the wrist, in ticks.
#[derive(Debug, Clone, Copy)]
pub struct Carriage {
    /// Height of the arm's base; none leaves it.
    pub height_ticks: Option<i32>,
    /// Wrist relative to the arm's base; none leaves it.
    pub wrist_ticks: Option<[i32; 3]>,
}

impl Carriage {
    pub const UNCHANGED: Self = Self { height_ticks: None, wrist_ticks: None };

    /// At a height and this far ahead of the arm's base.
    pub const fn at(height_ticks: i32, ahead_ticks: i32) -> Self {
        Self { height_ticks: Some(height_ticks), wrist_ticks: Some([0, 0, ahead_ticks]) }
    }

    fn of(self, now: &Configuration) -> Configuration {
        let held = self == Self::UNCHANGED;
        Configuration {
            height_ticks: self.height_ticks.unwrap_or(now.height_ticks),
            wrist_ticks: self.wrist_ticks.unwrap_or(now.wrist_ticks),
            elbow_ticks: if held { now.elbow_ticks } else { 0 },
            ..*now
        }
    }
}

impl PartialEq for Carriage {
    fn eq(&self, other: &Self) -> bool {
        (self.height_ticks, self.wrist_ticks) == (other.height_ticks, other.wrist_ticks)
    }
}

/// The actions of one leg up to where the aim is met; none if this carriage does not allow any, or none of the floor
/// poses that are looked at does.
pub fn leg(
    moment: &Moment,
    care: Care,
    carriage: Carriage,
    forbidden: &[(Configuration, Action)],
    allowed: Stands,
) -> Option<Vec<Action>> {
    let aim = Aim::of(moment);
    let now = moment.robot;
    let space = Space::of(moment, care);
    let (reaching, driving) = (space.for_reaching(), space.for_driving());
    let carried = carriage.of(&now);
    let (mut actions, travelling) =
        if carried == now { (Vec::new(), now) } else { reach::way(&reaching, now, &[carried], forbidden)? };

    let passable = |from: &Configuration, action, to: &Configuration| driving.passable(from, action, to);
    let floor = Floor { passable: &passable, place: aim.place(), slack_m: aim.slack_m(), forbidden };
    let mut search = Search::new(&floor, travelling, EXPANSIONS);
    let (mut looked_at, mut exhausted) = (0, false);
    while looked_at < allowed.most && !exhausted {
        // Some floor poses from which the aim can be met, by their length of drive and reach together.
        let mut stands: Vec<(u32, usize, Vec<Configuration>)> = Vec::new();
        while stands.len() < STANDS_COMPARED && looked_at < allowed.most {
            let Some(index) = search.next(&floor) else {
                exhausted = true;
                break;
            };
            let at = *search.state(index);
            // No nearer drive can make up for more reach than this.
            if stands.iter().any(|(total, _, _)| search.cost(index) > *total) {
                break;
            }
            if !floor.faces_place(&at) || allowed.avoid(&at) {
                continue;
            }
            looked_at += 1;
            let finals = reach::finals(&reaching, &at, &aim);
            if let Some(nearest) = finals.first() {
                stands.push((search.cost(index) + reach::distance(&at, nearest), index, finals));
            }
        }
        stands.sort_by_key(|&(total, index, _)| (total, index));
        for (_, index, finals) in stands {
            let at = *search.state(index);
            if let Some((reach, _)) = reach::way(&reaching, at, &finals, forbidden) {
                actions.extend(search.path(index));
                actions.extend(reach);
                return Some(actions);
            }
        }
    }
    None
}
