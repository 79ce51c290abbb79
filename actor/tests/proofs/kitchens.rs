//! The generated kitchens: nothing is wrong with any of them, and together they are like iTHOR's.

use actor::check::kitchens::problems;
use actor::figures::Figures;
use proto::config::Config;
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use simulator::kitchen::Kitchen;
use simulator::kitchen::layout::{FittedRoom, Plan};
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
    let things = median(figures.kitchens.iter().map(|&(.., things)| things as f32).collect());
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

#[test]
fn layouts_do_not_repeat() {
    let draw = |id: KitchenId, attempt| {
        let key =
            Key { seed: 0, purpose: Purpose::Kitchen, kitchen: id.number(), environment: attempt, episode: 0, step: 0 };
        FittedRoom::draw(id, &mut key.stream())
    };
    let mut sinks = Vec::new();
    for id in KitchenId::all() {
        // What found no place is drawn anew; one of the first few draws has room for all.
        let layout = (0..8).find_map(|attempt| draw(id, attempt).ok()).unwrap();
        assert!(!sinks.contains(&layout.sink), "two kitchens have their sinks at {}", layout.sink);
        sinks.push(layout.sink);
        assert!(layout.kept_clear.len() >= 2 && layout.burners.len() == 4, "kitchen {id}");
    }
}
