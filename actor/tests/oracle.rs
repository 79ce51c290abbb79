//! The task can be solved in our kitchens, and care pays: a planner plays some of the fixed episodes.

// Helpers of tests are tests too, which clippy's own exception does not see.
#![allow(clippy::unwrap_used)]

use actor::environment::Environment;
use actor::episode::at_goal;
use actor::episodes::{self, EPISODES_PER_CATEGORY, EpisodesError, check};
use actor::kitchen::Kitchen;
use actor::oracle::Variant;
use actor::oracle::table::{Outcome, UNDISTURBED_M, in_parallel, play};
use proto::action::Action;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenId, Split, TargetCategory};
use proto::message::transition_flag;
use std::sync::{Arc, OnceLock};

/// Every category once.
const EPISODES: usize = 12;

/// The kitchens of this test, built once.
fn kitchens() -> &'static [Arc<Kitchen>] {
    static KITCHENS: OnceLock<Vec<Arc<Kitchen>>> = OnceLock::new();
    KITCHENS.get_or_init(|| {
        [2, 20]
            .into_iter()
            .map(|number| {
                let id = KitchenId::new(number).unwrap();
                Arc::new(Kitchen::build(id, &Config::default().simulation).unwrap())
            })
            .collect()
    })
}

fn outcomes(variant: Variant) -> Vec<Outcome> {
    let config = Config::default();
    kitchens()
        .iter()
        .flat_map(|kitchen| {
            let episodes = episodes::fixed(kitchen).unwrap();
            in_parallel(EPISODES, |number| play(kitchen, &config, number as u32, episodes[number], variant))
        })
        .collect()
}

fn rate(outcomes: &[Outcome], test: impl Fn(&Outcome) -> bool) -> f64 {
    outcomes.iter().filter(|outcome| test(outcome)).count() as f64 / outcomes.len() as f64
}

fn undisturbed(outcome: &Outcome) -> bool {
    outcome.success && outcome.disturbance_m < UNDISTURBED_M
}

#[test]
fn the_task_can_be_solved_and_care_avoids_disturbance() {
    let (fast, careful) = (outcomes(Variant::Fast), outcomes(Variant::Careful));
    for (name, outcomes) in [("fast", &fast), ("careful", &careful)] {
        let solved = rate(outcomes, |outcome| outcome.success);
        assert!(solved >= 0.9, "the {name} oracle solves only {solved} of the episodes");
        assert!(outcomes.iter().all(|outcome| !outcome.success || outcome.picked_up));
        assert!(outcomes.iter().all(|outcome| outcome.actions.len() <= 200));
    }
    let (without_care, with_care) = (rate(&fast, undisturbed), rate(&careful, undisturbed));
    assert!(
        without_care < 0.9,
        "nothing is in the way: {without_care} of the episodes end undisturbed without any care"
    );
    assert!(with_care > without_care + 0.1, "care does not pay: {with_care} against {without_care}");

    // Again, and action by action by hand: the same.
    let (kitchen, config) = (&kitchens()[0], Config::default());
    let episode = episodes::fixed(kitchen).unwrap()[3];
    let expected = &fast[3];
    assert_eq!(*expected, play(kitchen, &config, 3, episode, Variant::Fast));
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let mut environment = Environment::with_episode(Arc::clone(kitchen), id, &config, 3, episode);
    let last = expected.actions.iter().map(|&action| environment.step(action)).last().unwrap();
    assert_eq!(last.state_hash, expected.state_hash);
    assert_eq!(last.flags & transition_flag::SUCCESS != 0, expected.success);
    assert_eq!(expected.actions.last(), Some(&Action::DoneMidLevel));
}

#[test]
fn fixed_episodes_are_balanced_valid_and_only_of_evaluation_kitchens() {
    let config = Config::default();
    for kitchen in kitchens() {
        let episodes = episodes::fixed(kitchen).unwrap();
        for category in TargetCategory::ALL {
            let count = episodes.iter().filter(|episode| episode.category == category).count();
            assert_eq!(count, EPISODES_PER_CATEGORY);
        }
        assert!(episodes.iter().all(|episode| !at_goal(episode.start, episode.goal)));
        let problems: Vec<_> = in_parallel(EPISODES, |number| check::check(kitchen, &config, &episodes[number]));
        assert!(problems.iter().all(Result::is_ok), "kitchen {}: {problems:?}", kitchen.id());
        // What is put where something stands is not valid.
        let mut crowded = episodes[0];
        let other = kitchen.bodies().iter().position(|body| body.category == "Pot").unwrap();
        crowded.start = kitchen.settled_poses()[other].translation;
        assert!(check::check(kitchen, &config, &crowded).is_err());
        let mut there = episodes[0];
        there.goal = there.start;
        assert_eq!(check::check(kitchen, &config, &there), Err(check::Problem::AlreadyThere));
    }
    let train = KitchenId::of_split(Split::Train)[0];
    let kitchen = Kitchen::build(train, &config.simulation).unwrap();
    assert_eq!(episodes::fixed(&kitchen), Err(EpisodesError::NotFixed(train)));
}
