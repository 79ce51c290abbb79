//! Our kitchens beside iTHOR's, in figures.

use proto::kitchen::KitchenId;
use rapier3d::math::Vec3;
use simulator::kitchen::Kitchen;
use simulator::kitchen::catalogue::{CATEGORIES, Place};
use simulator::kitchen::ithor::{self, NOT_THINGS};

/// Deciles of the distance from a small thing to the nearest other one, over all of iTHOR's kitchens, metres.
const NEAREST_NEIGHBOUR_DECILES_M: [f32; 9] = [0.12, 0.15, 0.19, 0.22, 0.27, 0.31, 0.35, 0.41, 0.54];
/// Furthest that a decile of the nearest-neighbour distance may be off iTHOR's, as a share of it.
const DECILE_TOLERANCE: f32 = 0.15;

/// What is counted and measured over a set of kitchens.
#[derive(Debug, Clone, Default)]
pub struct Figures {
    /// Each kitchen with the number of its things.
    pub kitchens: Vec<(KitchenId, usize)>,
    /// Extent of the things' centres along x and z of each kitchen, metres.
    pub extents_m: [Vec<f32>; 2],
    /// Each category's number in each kitchen, in iTHOR's order.
    pub counts: Vec<(&'static str, Vec<u32>)>,
    /// Distances from each small thing to the nearest other one of its kitchen, metres.
    pub nearest_m: Vec<f32>,
}

impl Figures {
    pub fn of(kitchens: &[Kitchen]) -> Self {
        let mut figures = Self {
            counts: ithor::CATEGORIES.iter().map(|&(name, ..)| (name, Vec::new())).collect(),
            ..Self::default()
        };
        for kitchen in kitchens {
            figures.add(kitchen);
        }
        figures
    }

    pub fn add(&mut self, kitchen: &Kitchen) {
        self.kitchens.push((kitchen.id(), kitchen.thing_count()));
        let things = || {
            kitchen
                .bodies()
                .iter()
                .zip(kitchen.settled_poses())
                .filter(|(body, _)| !NOT_THINGS.contains(&body.category.as_str()))
        };
        for (name, counts) in &mut self.counts {
            counts.push(things().filter(|(body, _)| body.category == *name).count() as u32);
        }
        for (axis, extents) in self.extents_m.iter_mut().enumerate() {
            let along: Vec<f32> = things().map(|(_, pose)| pose.translation[2 * axis]).collect();
            let (low, high) = along.iter().fold((f32::MAX, f32::MIN), |(low, high), &x| (low.min(x), high.max(x)));
            extents.push(high - low);
        }
        let small: Vec<Vec3> =
            things().filter(|(body, _)| is_small(&body.category)).map(|(_, pose)| pose.translation).collect();
        for (index, position) in small.iter().enumerate() {
            let others = small.iter().enumerate().filter(|&(other, _)| other != index);
            self.nearest_m.extend(others.map(|(_, other)| (*other - *position).length()).min_by(f32::total_cmp));
        }
    }

    pub fn merge(&mut self, other: &Self) {
        self.kitchens.extend_from_slice(&other.kitchens);
        for (extents, more) in self.extents_m.iter_mut().zip(&other.extents_m) {
            extents.extend_from_slice(more);
        }
        for ((_, counts), (_, more)) in self.counts.iter_mut().zip(&other.counts) {
            counts.extend_from_slice(more);
        }
        self.nearest_m.extend_from_slice(&other.nearest_m);
    }

    /// Deciles 1 to 9 of the nearest-neighbour distance, metres.
    fn deciles_m(&self) -> [f32; 9] {
        std::array::from_fn(|index| quantile(&self.nearest_m, (index + 1) as f32 / 10.0))
    }

    /// What is further from iTHOR's kitchens than it may be.
    pub fn deviations(&self) -> Vec<String> {
        let mut found = Vec::new();
        for (index, (ours, theirs)) in self.deciles_m().into_iter().zip(NEAREST_NEIGHBOUR_DECILES_M).enumerate() {
            let off = ours / theirs - 1.0;
            if off.abs() > DECILE_TOLERANCE {
                found.push(format!(
                    "decile {} of the nearest-neighbour distance is off by {:+.0}%",
                    index + 1,
                    off * 100.0
                ));
            }
        }
        for &(kitchen, things) in &self.kitchens {
            if !(ithor::THINGS[0]..=ithor::THINGS[2]).contains(&(things as f32)) {
                found.push(format!("kitchen {kitchen} holds {things} things"));
            }
        }
        found
    }
}

/// A quantile with linear interpolation between the values in order; 0 of nothing.
fn quantile(values: &[f32], share: f32) -> f32 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let at = share * last as f32;
    let below = (at as usize).min(last);
    let above = (below + 1).min(last);
    sorted[below] + (sorted[above] - sorted[below]) * (at - below as f32)
}

/// Whether a category is a small thing: movable, and stands on surfaces.
fn is_small(category: &str) -> bool {
    !NOT_THINGS.contains(&category)
        && CATEGORIES.iter().any(|known| known.name == category && !matches!(known.place, Place::Seat | Place::Floor))
}

#[test]
fn quantiles_interpolate() {
    assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), 2.0);
    assert_eq!(quantile(&[1.0, 2.0], 0.25), 1.25);
    assert_eq!(quantile(&[], 0.5), 0.0);
}

#[test]
fn deviations_are_noticed() {
    let mut figures = Figures { nearest_m: (0..=1000).map(|i| i as f32 / 1000.0).collect(), ..Figures::default() };
    assert!(figures.deviations().len() >= 8);
    let knots: Vec<(f32, f32)> = std::iter::once((0.0, 0.08))
        .chain(NEAREST_NEIGHBOUR_DECILES_M.into_iter().enumerate().map(|(i, d)| ((i + 1) as f32 / 10.0, d)))
        .chain([(1.0, 1.0)])
        .collect();
    figures.nearest_m = (0..=1000)
        .map(|i| {
            let at = i as f32 / 1000.0;
            let upper = knots.iter().position(|&(x, _)| x >= at).unwrap().max(1);
            let ((x0, y0), (x1, y1)) = (knots[upper - 1], knots[upper]);
            y0 + (y1 - y0) * (at - x0) / (x1 - x0)
        })
        .collect();
    assert_eq!(figures.deviations(), Vec::<String>::new());
    figures.kitchens.push((KitchenId::new(1).unwrap(), 91));
    assert_eq!(figures.deviations().len(), 1);
}
