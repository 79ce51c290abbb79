//! The task can be solved in our kitchens, and care pays: a planner plays some of the fixed episodes.

use actor::check::episode as check;
use actor::oracle_table::{Outcome, play};
use actor::parallel::in_parallel;
use proto::config::Config;
use proto::episode::EnvironmentId;
use simulator::kitchen::Kitchen;
use simulator::kitchen::spots::Stand;
use simulator::robot::action::Action;
use simulator::tasks::Run;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::episode::{Episode, at_goal};
use simulator::tasks::arm_point_nav::episodes::{self, EPISODES_PER_KITCHEN, EpisodesError, drawn};
use simulator::tasks::arm_point_nav::oracle::Variant;

use proto::evaluation::{Distribution, EvaluationConfig, ObjectSet};
use proto::kitchen::{KitchenId, Split, TargetCategory};
use rapier3d::math::Vec3;
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

#[test]
fn the_task_can_be_solved_and_care_avoids_disturbance() {
    let (fast, careful) = (outcomes(Variant::Fast), outcomes(Variant::Careful));
    for (name, outcomes) in [("fast", &fast), ("careful", &careful)] {
        let solved = rate(outcomes, |outcome| outcome.success);
        assert!(solved >= 0.9, "the {name} oracle solves only {solved} of the episodes");
        assert!(outcomes.iter().all(|outcome| !outcome.success || outcome.picked_up));
        assert!(outcomes.iter().all(|outcome| outcome.actions.len() <= 200));
    }
    let (without_care, with_care) =
        (rate(&fast, |outcome| outcome.undisturbed), rate(&careful, |outcome| outcome.undisturbed));
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
    assert_eq!(environment.state_hash(), expected.state_hash);
    assert_eq!(last.succeeded(), expected.success);
    assert_eq!(expected.actions.last(), Some(&Action::DoneMidLevel));
}

#[test]
fn displacements_agree_with_one_another_and_what_was_disturbed_stays_noted() {
    let config = Config::default();
    let kitchen = &kitchens()[0];
    let mut disturbed = 0;
    for (number, episode) in episodes::fixed(kitchen).unwrap().into_iter().take(EPISODES).enumerate() {
        let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
        let mut environment = Environment::with_episode(Arc::clone(kitchen), id, &config, number as u32, episode);
        let actions = play(kitchen, &config, number as u32, episode, Variant::Fast).actions;
        let (mut ever, mut farthest_m) = (0, 0.0_f32);
        for action in actions {
            let transition = environment.step(action);
            assert!(transition.farthest_m <= transition.disturbance_m && transition.peak_farthest_m >= farthest_m);
            assert!(transition.farthest_m * 120.0 >= transition.disturbance_m, "no kitchen has that many things");
            assert!(transition.ever_disturbed_objects >= ever.max(transition.disturbed_objects));
            // Nothing further than 1 cm on any axis: at most √3 cm in all.
            assert!(transition.disturbed_objects > 0 || transition.farthest_m < 0.01733);
            ever = transition.ever_disturbed_objects;
            farthest_m = transition.peak_farthest_m.max(transition.farthest_m);
            assert_eq!(farthest_m, transition.peak_farthest_m);
            disturbed += u32::from(transition.disturbed_objects > 0);
        }
        environment.begin_episode(7, episode);
        assert_eq!(environment.step(Action::LookUp).ever_disturbed_objects, 0, "a new episode knows nothing of it");
    }
    assert!(disturbed > 0, "the fast oracle disturbs something");
}

#[test]
fn the_state_hash_of_an_evaluated_episode_depends_on_no_number_of_environments() {
    let kitchen = &kitchens()[1];
    let id = |number| EnvironmentId { kitchen: kitchen.id(), number };
    let actions = [Action::LookUp, Action::MoveAheadContinuous, Action::RotateRightContinuous, Action::DoneMidLevel];
    let play = |environment: &mut Environment| -> Vec<u64> {
        let mut hashes = vec![environment.state_hash()];
        for action in actions {
            environment.step(action);
            hashes.push(environment.state_hash());
        }
        hashes
    };
    // Hashes of the seven episodes of a kitchen that these environments play, in the order of the plan.
    let hashes = |actors: u32, environments: u32, hashes_by_kitchen: bool| -> Vec<Vec<u64>> {
        let mut config = Config::default();
        (config.actors.count, config.actors.environments_per_actor) = (actors, environments);
        let asked = EvaluationConfig::fixed(Split::Test, ObjectSet::Seen, 7);
        config.evaluation = Some(EvaluationConfig { hashes_by_kitchen, ..asked });
        let run = Run::of(&config);
        let here = environments * (actors / 5);
        let of = |index: u32| {
            let (id, number) = (id(index % here), index / here);
            let mut made = Environment::open(&run, Arc::clone(kitchen), id, number).unwrap();
            let mut begun = Environment::open(&run, Arc::clone(kitchen), id, 0).unwrap();
            begun.start_episode(number);
            let hashes = play(&mut made);
            assert_eq!(play(&mut begun), hashes, "episode {index}");
            hashes
        };
        (0..7).map(of).collect()
    };
    let one = hashes(5, 1, true);
    assert_eq!(hashes(5, 4, true), one);
    assert_eq!(hashes(10, 2, true), one);
    // It is the number that the table has: the first of the seen targets, and the seventh.
    let fixed = episodes::fixed(kitchen).unwrap();
    for (index, number) in [(0, 0), (6, 12)] {
        let config = Config::default();
        let mut environment =
            Environment::with_episode(Arc::clone(kitchen), id(0), &config, number, fixed[number as usize]);
        assert_eq!(play(&mut environment), one[index]);
    }
    // Recordings of older evaluations have the environment's own count, and can be replayed.
    let older = hashes(5, 4, false);
    assert_ne!(older, hashes(5, 1, false));
    let mut second = Environment::with_episode(Arc::clone(kitchen), id(0), &Config::default(), 1, fixed[4]);
    assert_eq!(play(&mut second), older[4]);
}

#[test]
fn drawn_episodes_are_the_runs_task_and_the_same_for_every_seed() {
    let near = Config::resolve("demo", None).unwrap();
    let (start_m, goal_m) = (near.episode.start_distance_max_m, near.episode.goal_distance_max_m);
    for kitchen in kitchens() {
        let draw = |config: &Config| -> Vec<Episode> {
            (0..2 * EPISODES as u32).map(|number| drawn(kitchen, &config.episode, number)).collect()
        };
        let episodes = draw(&near);
        assert_eq!(draw(&Config { seed: 99, ..near.clone() }), episodes, "no seed of a run is in it");
        assert_ne!(draw(&Config::default()), episodes, "the distances are");
        let fixed = episodes::fixed(kitchen).unwrap();
        for (number, episode) in episodes.iter().enumerate() {
            assert_eq!(episode.category, episodes::category(number));
            assert_eq!(check::check(kitchen, &near, episode), Ok(()), "kitchen {}, episode {number}", kitchen.id());
            assert!((episode.goal - episode.start).length() <= goal_m, "episode {number}");
            assert!(!fixed.contains(episode));
        }
        // As in training, where no pose of the robot is so near, the nearest takes its place.
        let distance_m = |stand: &Stand, target: Vec3| (stand.x_m - target.x).hypot(stand.z_m - target.z);
        let near_starts =
            episodes.iter().filter(|episode| distance_m(&episode.stand, episode.start) <= start_m).count();
        assert!(2 * near_starts > episodes.len(), "{near_starts} of {}", episodes.len());
        let farthest_m = episodes.iter().map(|episode| distance_m(&episode.stand, episode.start)).fold(0.0, f32::max);
        assert!(farthest_m < start_m + 0.5, "{farthest_m}");
        // Training's own episodes are others.
        let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
        let sampled = (0..50).map(|number| Episode::sample(kitchen, &near.episode, near.seed, id, number));
        assert!(sampled.into_iter().all(|episode| !episodes.contains(&episode)));
    }
}

#[test]
fn an_evaluation_in_a_training_kitchen_plays_drawn_episodes() {
    let id = KitchenId::of_split(Split::Train)[0];
    let mut config = Config::default();
    let kitchen = Arc::new(Kitchen::build(id, &config.simulation).unwrap());
    config.evaluation = Some(EvaluationConfig {
        distribution: Distribution::Run,
        ..EvaluationConfig::fixed(Split::Train, ObjectSet::Novel, 3)
    });
    let run = Run::of(&config);
    let id = EnvironmentId { kitchen: id, number: 0 };
    let mut environment = Environment::open(&run, Arc::clone(&kitchen), id, 0).unwrap();
    for (number, dealt) in [6, 7, 8].into_iter().enumerate() {
        environment.start_episode(number as u32);
        assert_eq!(*environment.episode(), drawn(&kitchen, &config.episode, dealt));
    }
    // It has run out: something to look at while it holds.
    environment.start_episode(3);

    if let Some(asked) = &mut config.evaluation {
        asked.distribution = Distribution::Fixed;
    }
    let problem = Environment::open(&Run::of(&config), Arc::clone(&kitchen), id, 0).unwrap_err().to_string();
    assert_eq!(problem, EpisodesError::NotFixed(kitchen.id()).to_string());
}

#[test]
fn fixed_episodes_are_balanced_valid_and_only_of_evaluation_kitchens() {
    let config = Config::default();
    for kitchen in kitchens() {
        let episodes = episodes::fixed(kitchen).unwrap();
        for category in TargetCategory::ALL {
            let count = episodes.iter().filter(|episode| episode.category == category).count();
            assert_eq!(count * TargetCategory::ALL.len(), EPISODES_PER_KITCHEN);
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
