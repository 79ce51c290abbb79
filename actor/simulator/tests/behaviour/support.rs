//! Kitchens, environments and a random policy for tests.

use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use simulator::kitchen::Kitchen;
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::{Current, Transition, check, record};
use std::sync::Arc;

/// A built-in kitchen as it is by default.
pub fn kitchen(number: u32) -> Arc<Kitchen> {
    let id = KitchenId::new(number).unwrap();
    Arc::new(Kitchen::build(id, &Config::default().simulation).unwrap())
}

/// An environment of it as it is by default.
pub fn environment(kitchen: &Arc<Kitchen>, number: u32) -> Environment {
    let id = EnvironmentId { kitchen: kitchen.id(), number };
    Environment::new(Arc::clone(kitchen), id, &Config::default()).unwrap()
}

/// Uniform over all actions but Done, so that episodes are long.
pub fn random_action(kitchen: KitchenId, environment: u32, episode: u32, step: u32) -> Action {
    let key = Key { seed: 11, purpose: Purpose::RandomPolicy, kitchen: kitchen.number(), environment, episode, step };
    Action::ALL[key.stream().below(20) as usize]
}

/// Takes an action. The learner refuses reports that cannot be, and ours are never among them.
pub fn sound_step(environment: &mut Environment, action: Action) -> Transition {
    let transition = environment.step(action);
    check(Config::default().spec(), &transition, &environment.current()).unwrap();
    transition
}

/// The reward r of a step.
pub fn reward(transition: &Transition) -> f32 {
    let config = Config::default();
    let record = record(config.spec(), transition, &Current::default());
    config.reward("r").of(|index| config.spec().layout().part(&record, index), 0.0)
}

/// Takes this many random actions from where the environment is: what each did, and the state that it led to.
pub fn run(environment: &mut Environment, number: u32, episode: u32, steps: u32) -> Vec<(Transition, u64)> {
    let kitchen = environment.kitchen().id();
    let step = |index| {
        let transition = sound_step(environment, random_action(kitchen, number, episode, index));
        (transition, environment.state_hash())
    };
    (0..steps).map(step).collect()
}
