use crate::kitchen::Kitchen;
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
