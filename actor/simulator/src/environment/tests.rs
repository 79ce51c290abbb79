use crate::kitchen::Kitchen;
use crate::robot::action::Action;
use crate::tasks::arm_point_nav::Environment;
use crate::tasks::arm_point_nav::episode::Episode;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use std::sync::Arc;

#[test]
fn a_prepared_start_is_used_for_its_episode_and_for_no_other() {
    let config = Config::default();
    let id = EnvironmentId { kitchen: KitchenId::new(7).unwrap(), number: 0 };
    let kitchen = Arc::new(Kitchen::build(id.kitchen, &config.simulation).unwrap());
    let environment = || Environment::new(Arc::clone(&kitchen), id, &config).unwrap();
    let at_once = |number| {
        let mut environment = environment();
        environment.start_episode(number);
        assert!(environment.past.is_none());
        (environment.state_hash(), environment.current())
    };
    let mut prepared = environment();
    while prepared.prepare_episode(1) {}
    prepared.start_episode(1);
    assert!(prepared.past.is_some(), "what was prepared to the end was used");
    assert_eq!((prepared.state_hash(), prepared.current()), at_once(1));

    prepared.forget_past();
    assert!(prepared.prepare_episode(2), "it is not at rest at once");
    prepared.start_episode(2);
    assert!(prepared.past.is_some(), "what was begun was used");
    assert_eq!((prepared.state_hash(), prepared.current()), at_once(2));

    prepared.forget_past();
    assert!(prepared.prepare_episode(3));
    prepared.start_episode(4);
    assert!(prepared.past.is_none() && prepared.ahead.is_none(), "what was of another episode was not");
    assert_eq!((prepared.state_hash(), prepared.current()), at_once(4));

    assert!(prepared.prepare_episode(5));
    prepared.begin_episode(5, Episode::sample(&kitchen, &config.episode, config.seed, id, 6));
    assert!(prepared.past.is_none(), "nor what had its number only");
}

/// Who follows the teacher ends without disturbance, also after actions of his own.
#[test]
fn advice_leads_to_the_goal_and_is_given_where_the_run_has_it() {
    let mut config = Config::default();
    (config.teacher.coefficient, config.teacher.share, config.teacher.episodes) = (1.0, 1.0, 4);
    let id = EnvironmentId { kitchen: KitchenId::new(7).unwrap(), number: 0 };
    let kitchen = Arc::new(Kitchen::build(id.kitchen, &config.simulation).unwrap());
    let (_, field) = config.spec().channel("advice").unwrap();
    let seen_from = config.spec().layout().seen.clone();
    let advice = |environment: &Environment| {
        let mut record = vec![0; seen_from.end];
        crate::environment::Environment::observe(environment, &mut record[seen_from.clone()]);
        field.number(&record) as usize
    };
    let mut environment = Environment::new(Arc::clone(&kitchen), id, &config).unwrap();
    let mut undisturbed = 0;
    // The share falls: 1 in the first episode, a half in the third, none in the fifth.
    for (number, turns) in [(0, true), (1, false)] {
        environment.start_episode(number);
        let mut last = None;
        while !environment.ended() {
            let advised = advice(&environment);
            assert_eq!(advised, advice(&environment.clone()), "it is a function of the state");
            let action = match advised.checked_sub(1) {
                Some(action) if !(turns && environment.previous_action().is_none()) => Action::ALL[action],
                _ => Action::RotateLeftContinuous,
            };
            last = Some(environment.step(action));
        }
        undisturbed += u32::from(last.is_some_and(|last| last.succeeded() && last.disturbance_m < 0.01));
    }
    assert_eq!(undisturbed, 2);
    let asked = |environment: &mut Environment, number| {
        environment.start_episode(number);
        (0..40)
            .filter(|_| {
                let asked = advice(environment) > 0;
                environment.step(Action::RotateLeftContinuous);
                asked
            })
            .count()
    };
    assert!((8..32).contains(&asked(&mut environment, 2)));
    assert_eq!(asked(&mut environment, 4), 0);
    config.teacher.coefficient = 0.0;
    assert_eq!(asked(&mut Environment::new(kitchen, id, &config).unwrap(), 0), 0);
}
