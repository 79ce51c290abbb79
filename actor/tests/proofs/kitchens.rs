//! The generated kitchens: nothing is wrong with any of them, and together they are like iTHOR's.

use crate::figures::Figures;
use actor::check::episode::verdicts;
use actor::check::kitchens::problems;
use actor::parallel::in_parallel;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenId, KitchenRange};
use simulator::kitchen::layout::Plan;
use simulator::kitchen::{Kitchen, likeness};
use simulator::tasks::arm_point_nav::episode::Episode;
use std::collections::BTreeSet;
use std::sync::Arc;

#[test]
fn nothing_is_wrong_and_all_together_are_like_ithor() {
    let config = Config::default();
    let mut kitchens = Vec::new();
    for id in KitchenId::all() {
        let kitchen = Arc::new(Kitchen::build(id, &config.simulation).unwrap());
        assert_eq!(problems(&kitchen, &config), [], "kitchen {id}");
        kitchens.push(Arc::into_inner(kitchen).unwrap());
    }
    // What procedural kitchens are kept away from is what validation and test kitchens are.
    for (number, attempt) in likeness::DRAWN_AT {
        let kitchen = kitchens.iter().find(|kitchen| kitchen.id().number() == number).unwrap();
        assert_eq!(kitchen.attempt(), attempt, "kitchen {number}");
        assert_eq!(likeness::nearest_to_kitchen(kitchen), Some((kitchen.id(), 0.0)));
    }
    for plan in [Plan::OneWall, Plan::Ell, Plan::You, Plan::Galley, Plan::Island, Plan::Peninsula] {
        assert!(kitchens.iter().any(|kitchen| kitchen.plan() == Some(plan)), "no kitchen is a {}", plan.name());
    }
    let figures = Figures::of(&kitchens);
    assert_eq!(figures.deviations(), Vec::<String>::new());

    // Medians of number and size, and the means of what most of a kitchen consists of.
    let median = |values: Vec<f32>| {
        let mut values = values;
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    };
    let things = median(figures.kitchens.iter().map(|&(_, things)| things as f32).collect());
    assert!((65.0..=75.0).contains(&things), "the median kitchen holds {things} things");
    for (extent, theirs) in figures.extents_m.iter().zip([4.23, 4.78]) {
        let ours = median(extent.clone());
        assert!((ours - theirs).abs() < 0.5, "the median kitchen extends over {ours} m, not {theirs}");
    }
    for (category, mean) in [("Cabinet", 13.93), ("Drawer", 6.21), ("CounterTop", 2.37), ("StoveBurner", 4.1)] {
        let (_, counts) = figures.counts.iter().find(|(name, _)| *name == category).unwrap();
        let with = counts.iter().filter(|&&count| count > 0).count();
        let ours = counts.iter().sum::<u32>() as f32 / with as f32;
        assert!((ours / mean - 1.0).abs() < 0.1, "{ours} of {category} in a kitchen, not {mean}");
    }
}

/// Two hundred of the kitchens without end are like iTHOR's, nothing is wrong with any of them, and none is one of
/// validation and test.
#[test]
fn kitchens_without_end_are_like_ithor_too() {
    const KITCHENS: u32 = 200;
    let config = Config::default();
    // Not those on which the generator's constants were chosen.
    let range = KitchenRange::new(5000, 5000 + KITCHENS).unwrap();
    let measured = in_parallel(KITCHENS as usize, |index| {
        let id = range.get(index as u32).unwrap();
        let kitchen = Arc::new(Kitchen::build(id, &config.simulation).unwrap());
        assert_eq!(problems(&kitchen, &config), [], "kitchen {id}");
        let (nearest, distance) = likeness::nearest_to_kitchen(&kitchen).unwrap();
        assert!(distance >= likeness::least_distance(), "kitchen {id} is {distance} from kitchen {nearest}");
        if index % 25 == 0 {
            let id = EnvironmentId { kitchen: id, number: 3 };
            let sampled = |number| Episode::sample(&kitchen, &config.episode, 1, id, number);
            for (number, verdict) in
                verdicts(&kitchen, &config, &(0..12).map(sampled).collect::<Vec<_>>()).iter().enumerate()
            {
                assert!(verdict.is_ok(), "kitchen {}, episode {number}: {verdict:?}", id.kitchen);
            }
        }
        let mut figures = Figures::of(&[]);
        figures.add(&kitchen);
        let sink = kitchen.bodies().iter().zip(kitchen.settled_poses()).find(|(body, _)| body.category == "Sink");
        (figures, kitchen.plan(), sink.map(|(_, pose)| pose.translation.to_array().map(f32::to_bits)))
    });
    let mut all = Figures::of(&[]);
    let mut sinks = BTreeSet::new();
    for (figures, _, sink) in &measured {
        all.merge(figures);
        assert!(sinks.insert(sink.unwrap()), "two kitchens have their sinks at the same place");
    }
    assert_eq!(all.deviations(), Vec::<String>::new());
    for plan in [Plan::OneWall, Plan::Ell, Plan::You, Plan::Galley, Plan::Island, Plan::Peninsula] {
        let with = measured.iter().filter(|(_, found, _)| *found == Some(plan)).count();
        assert!(with >= 4, "{with} kitchens are a {}", plan.name());
    }
    let mut off = Vec::new();
    for (category, share, mean) in
        [("DiningTable", 0.53, 1.31), ("Stool", 0.47, 1.36), ("Cabinet", 1.0, 13.93), ("Kettle", 0.5, 1.0)]
    {
        let (_, counts) = all.counts.iter().find(|(name, _)| *name == category).unwrap();
        let with = counts.iter().filter(|&&count| count > 0).count();
        let ours = counts.iter().sum::<u32>() as f32 / with as f32;
        if (ours / mean - 1.0).abs() >= 0.15 {
            off.push(format!("{ours} of {category} in a kitchen, not {mean}"));
        }
        if (with as f32 / KITCHENS as f32 / share - 1.0).abs() >= 0.15 {
            off.push(format!("{with} of {KITCHENS} have {category}, not {:.0}", share * KITCHENS as f32));
        }
    }
    assert_eq!(off, Vec::<String>::new());
}
