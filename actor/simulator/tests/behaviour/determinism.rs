//! The same kitchen, episode and actions give the same state at each step, bit for bit: whoever else is simulated in
//! the process, whatever came before, on every x86-64 machine, in debug and release (`make check-determinism`).

use super::support::{environment, kitchen, random_action, run};
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::Transition;

const STEPS: u32 = 200;

/// What an action does, and the state that it leads to.
fn taken(environment: &mut Environment, action: Action) -> (Transition, u64) {
    (environment.step(action), environment.state_hash())
}

/// Hashes that every machine and every later version must reproduce. A change here changes every recording: the
/// release it goes into has another schema version than the release before it, and a line in the changelog.
#[test]
fn golden_hashes() {
    const GOLDEN: [(u32, u64, u64); 3] = [
        (1, 0xdc3c01c67293817b, 0x1467e7b06f73c953),
        (8, 0x3bc5d18b29bef64a, 0xebba76e1ce653efe),
        (30, 0x23a8d8d5d0d0439a, 0x31a9fcc827209ed9),
    ];
    let found: Vec<(u32, u64, u64)> = GOLDEN
        .iter()
        .map(|&(number, ..)| {
            let mut environment = environment(&kitchen(number), 0);
            let start = environment.state_hash();
            // All of an episode is in the hash, not only how it ends.
            let transitions = run(&mut environment, 0, 0, STEPS);
            let all = transitions.iter().fold(0_u64, |hash, (_, state_hash)| {
                hash.rotate_left(7).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ state_hash
            });
            (number, start, all)
        })
        .collect();
    assert_eq!(found, GOLDEN, "found {found:#x?}");
}

#[test]
fn alone_and_among_32_in_one_process() {
    for number in [1, 14] {
        let alone_kitchen = kitchen(number);
        let id = alone_kitchen.id();
        let shared_kitchen = kitchen(number);
        let mut crowd: Vec<Environment> = (0..32).map(|index| environment(&shared_kitchen, index)).collect();
        let mut together: Vec<Vec<(Transition, u64)>> = vec![Vec::new(); crowd.len()];
        for step in 0..STEPS {
            for ((index, environment), transitions) in (0..).zip(&mut crowd).zip(&mut together) {
                transitions.push(taken(environment, random_action(id, index, 0, step)));
            }
        }
        for index in [0, 5, 13, 31] {
            let mut alone = environment(&alone_kitchen, index);
            let expected = run(&mut alone, index, 0, STEPS);
            assert_eq!(expected, together[index as usize], "kitchen {number}, environment {index}");
            assert_eq!(alone.current(), crowd[index as usize].current());
        }
        assert!(
            together.iter().flatten().any(|(transition, _)| transition.disturbance_m > 0.01),
            "something was pushed: physics was at work"
        );
    }
}

#[test]
fn an_earlier_episode_leaves_no_trace() {
    for number in [1, 14] {
        let kitchen = kitchen(number);
        let mut fresh = environment(&kitchen, 3);
        fresh.start_episode(2);
        let expected = run(&mut fresh, 3, 2, STEPS);
        let mut reused = environment(&kitchen, 3);
        run(&mut reused, 3, 0, 60);
        reused.start_episode(2);
        assert_eq!(reused.previous_action(), None);
        assert_eq!(run(&mut reused, 3, 2, STEPS), expected, "kitchen {number}");
        assert_eq!(reused.current(), fresh.current());
    }
}

/// What an actor does that was killed: it takes the actions so far once more, and goes on.
#[test]
fn rebuilt_from_its_actions_at_every_step() {
    for (number, index) in [(1, 0), (14, 5)] {
        let kitchen = kitchen(number);
        let mut uninterrupted = environment(&kitchen, index);
        let mut transitions = Vec::new();
        for step in 0..STEPS {
            let rebuilt = {
                let mut environment = environment(&kitchen, index);
                assert_eq!(run(&mut environment, index, 0, step), transitions, "kitchen {number}, {step} actions");
                assert_eq!(environment.current(), uninterrupted.current(), "kitchen {number}, {step} actions");
                taken(&mut environment, random_action(kitchen.id(), index, 0, step))
            };
            transitions.push(taken(&mut uninterrupted, random_action(kitchen.id(), index, 0, step)));
            assert_eq!(rebuilt, transitions[step as usize], "kitchen {number}, step {step} after a rebuild");
        }
    }
}
