//! Runs planned episodes with a policy: chosen actions, outcomes, and columns without further episodes. No I/O, no
//! tensors.

use crate::collector::{ColumnMap, Place, Signals, gumbel_of};
use proto::action::HOLD;
use proto::config::Config;
use proto::evaluation::{Confusion, EpisodeEnd, EpisodeRecord, Plan, category_of};
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use proto::record::{End, RecordHeader};
use proto::reward::UNDISTURBED_THRESHOLD_M;
use proto::step::Transition;
use proto::task::Composition;

/// The episode of a column.
#[derive(Debug, Clone, Default)]
struct Course {
    /// The episode's number in its kitchen; none if the column has no further episode.
    episode: Option<u32>,
    /// Episodes that this column has ended.
    played: u32,
    actions: Vec<u8>,
    pickup_step: Option<u32>,
    failed_actions: u32,
    disturbing_steps: u32,
    displaced_steps: u32,
    return_r: f64,
    return_r_prime: f64,
    /// The disturbance head's prediction for the action in flight.
    foretold: Option<bool>,
    confusion: Option<Confusion>,
}

/// An episode that has ended: its record, and the actions taken (`A_large` indices).
pub type Played = (EpisodeRecord, Vec<u8>);

/// All columns of an evaluation.
#[derive(Debug, Clone)]
pub(crate) struct Examination {
    plan: Plan,
    column_map: ColumnMap,
    /// r and r′.
    rewards: [Composition; 2],
    signals: Signals,
    /// None: take the most probable action.
    seed: Option<u64>,
    policy_actions: usize,
    courses: Vec<Course>,
    remaining: usize,
}

impl Examination {
    /// Every column at the start of its first episode. Noise of `seed` samples among `policy_actions` actions; without
    /// a seed the most probable one is taken.
    pub fn new(plan: Plan, column_map: ColumnMap, config: &Config, seed: Option<u64>, policy_actions: usize) -> Self {
        let course = |column| Course { episode: plan.dealt(column_map.environment(column), 0), ..Course::default() };
        Self {
            courses: (0..column_map.columns()).map(course).collect(),
            remaining: plan.len(),
            plan,
            column_map,
            rewards: ["r", "r_prime"].map(|name| config.reward(name)),
            signals: Signals::of(config),
            seed,
            policy_actions,
        }
    }

    /// Episodes that have not ended.
    pub(crate) fn remaining(&self) -> usize {
        self.remaining
    }

    /// The kitchen in which a column plays its episode of this number.
    fn kitchen(&self, column: usize, number: u32) -> KitchenId {
        let environment = self.column_map.environment(column);
        self.plan.kitchen_of(environment, number).unwrap_or(environment.kitchen)
    }

    /// Appends the noise for one column's step: a function of (seed, kitchen, episode, step) and nothing else.
    pub fn noise(&self, place: Place, noise: &mut Vec<f32>) {
        let (Some(seed), Some(episode)) = (self.seed, self.courses[place.column].episode) else {
            noise.resize(noise.len() + self.policy_actions, 0.0);
            return;
        };
        let played = self.courses[place.column].played;
        let kitchen = self.kitchen(place.column, played).number();
        let key = Key { seed, purpose: Purpose::Evaluation, kitchen, environment: 0, episode, step: place.step };
        gumbel_of(key, self.policy_actions, noise);
    }

    /// Notes the policy's action for a column and returns the action to send: HOLD if the column has no further
    /// episode.
    pub(crate) fn choose(&mut self, column: usize, action: u8, foretold: Option<bool>) -> u8 {
        let course = &mut self.courses[column];
        if course.episode.is_none() {
            return HOLD;
        }
        course.actions.push(action);
        course.foretold = foretold;
        action
    }

    /// Records the outcome of a column's last action; returns the record of its episode if that has ended.
    pub fn settle(&mut self, column: usize, header: &RecordHeader, transition: &Transition) -> Option<Played> {
        let course = &mut self.courses[column];
        let episode = course.episode?;
        let [r, r_prime] = &self.rewards;
        let reward = |reward: &Composition| f64::from(reward.of(|index| transition.reward.part(index), 0.0));
        course.return_r += reward(r);
        course.return_r_prime += reward(r_prime);
        course.failed_actions += u32::from(transition.failed());
        course.disturbing_steps += u32::from(self.signals.labels(transition));
        course.displaced_steps += u32::from(transition.disturbance_m >= UNDISTURBED_THRESHOLD_M);
        if transition.holds() {
            course.pickup_step.get_or_insert(course.actions.len() as u32);
        }
        if let Some(foretold) = course.foretold.take() {
            let confusion = course.confusion.get_or_insert_default();
            // As in training, an episode's last step does not count.
            if header.end().is_none() {
                confusion.count(foretold, self.signals.labels(transition));
            }
        }
        let end = header.end()?;
        let environment = self.column_map.environment(column);
        let kitchen = self.plan.kitchen_of(environment, course.played).unwrap_or(environment.kitchen);
        let played = course.played + 1;
        let next = Course { episode: self.plan.dealt(environment, played), played, ..Course::default() };
        let ended = std::mem::replace(course, next);
        self.remaining -= 1;
        let record = EpisodeRecord {
            kitchen,
            episode,
            category: category_of(episode),
            end: match end {
                End::Terminated => EpisodeEnd::Done,
                End::Truncated => EpisodeEnd::TimeLimit,
            },
            success: transition.succeeded(),
            // What is held stays held until the episode ends.
            picked_up: transition.holds(),
            pickup_step: ended.pickup_step,
            length: ended.actions.len() as u32,
            failed_actions: ended.failed_actions,
            return_r: ended.return_r,
            return_r_prime: ended.return_r_prime,
            disturbance_m: transition.disturbance_m,
            peak_disturbance_m: transition.peak_disturbance_m,
            disturbed_objects: transition.disturbed_objects,
            ever_disturbed_objects: transition.ever_disturbed_objects,
            farthest_m: transition.farthest_m,
            peak_farthest_m: transition.peak_farthest_m,
            disturbing_steps: Some(ended.disturbing_steps),
            displaced_steps: Some(ended.displaced_steps),
            wrist_object_m: transition.wrist_object_m,
            object_goal_m: transition.object_goal_m,
            disturb_prediction: ended.confusion,
            state_hash: header.outcome_hash,
        };
        Some((record, ended.actions))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::{Kitchens, Split};
    use proto::reward::RewardParts;
    use std::collections::BTreeSet;

    fn plan(actors: u32, environments: u32) -> (Plan, ColumnMap) {
        let config = EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 7);
        let column_map = ColumnMap::new(0, actors, environments).in_kitchens(Kitchens::Split(Split::Test));
        (Plan::new(&config, actors, environments), column_map)
    }

    fn header(end: Option<End>) -> RecordHeader {
        let mut header = RecordHeader::default();
        header.act(9, end);
        header
    }

    fn transition(disturbance_progress_m: f32) -> Transition {
        Transition {
            reward: RewardParts { disturbance_progress_m, ..RewardParts::default() },
            disturbance_m: 0.5,
            peak_disturbance_m: 0.6,
            wrist_object_m: 1.0,
            object_goal_m: 2.0,
            disturbed_objects: 1,
            ever_disturbed_objects: 2,
            farthest_m: 0.3,
            peak_farthest_m: 0.4,
            ..Transition::default()
        }
    }

    #[test]
    fn every_episode_is_recorded_once_and_who_has_run_out_holds() {
        let (plan, column_map) = plan(7, 3);
        let mut examination = Examination::new(plan.clone(), column_map, &Config::default(), Some(1), 21);
        let mut seen = BTreeSet::new();
        let mut rounds = 0;
        while examination.remaining() > 0 {
            rounds += 1;
            assert!(rounds < 10);
            for column in 0..column_map.columns() {
                if examination.choose(column, 20, None) == HOLD {
                    assert!(examination.settle(column, &header(None), &transition(0.0)).is_none());
                    continue;
                }
                let mut last = transition(0.0);
                last.reward.goal_success = 1.0;
                let (record, actions) = examination.settle(column, &header(Some(End::Terminated)), &last).unwrap();
                assert_eq!((record.length, actions.as_slice()), (1, &[20][..]));
                assert_eq!(record.kitchen, column_map.environment(column).kitchen);
                assert!(record.success && record.end == EpisodeEnd::Done && record.disturb_prediction.is_none());
                assert!(seen.insert((record.kitchen, record.episode)));
            }
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), plan.episodes().collect::<Vec<_>>());
        assert!((0..column_map.columns()).all(|column| examination.choose(column, 3, None) == HOLD));
    }

    #[test]
    fn an_episodes_steps_add_up() {
        let (plan, column_map) = plan(5, 1);
        let mut examination = Examination::new(plan, column_map, &Config::default(), None, 21);
        // Foretold and came; missed; false alarm; quiet; and a last step, which is not asked about.
        let steps = [(true, -0.001), (false, -0.002), (true, 0.0), (false, -0.0009), (true, -0.5)];
        let mut played = None;
        for (step, (foretold, progress_m)) in steps.into_iter().enumerate() {
            assert!(played.is_none());
            assert_eq!(examination.choose(2, step as u8, Some(foretold)), step as u8);
            let disturbance_m = if step == 3 { 0.009 } else { 0.01 };
            let holding = u32::from(step >= 2);
            let mut outcome = Transition { disturbance_m, holding, ..transition(progress_m) };
            outcome.reward.failed_action = f32::from(u8::from(step == 1));
            played = examination.settle(2, &header((step == 4).then_some(End::Truncated)), &outcome);
        }
        let (record, actions) = played.unwrap();
        assert_eq!(actions, [0, 1, 2, 3, 4]);
        assert_eq!((record.end, record.success, record.picked_up), (EpisodeEnd::TimeLimit, false, true));
        assert_eq!((record.pickup_step, record.length, record.failed_actions), (Some(3), 5, 1));
        assert_eq!((record.disturbing_steps, record.displaced_steps), (Some(3), Some(4)));
        let counts = Confusion { hits: 1, misses: 1, false_alarms: 1, quiet: 1 };
        assert_eq!(record.disturb_prediction, Some(counts));
        assert!((record.return_r + 5.0 * 0.01 + 0.03).abs() < 1e-6);
        assert!((record.return_r_prime - record.return_r + 15.0 * 0.5039).abs() < 1e-5);
        assert_eq!((record.ever_disturbed_objects, record.peak_farthest_m, record.state_hash), (2, 0.4, 9));
    }

    /// However the episodes are dealt out, the noise of an episode's step is the same.
    #[test]
    fn noise_belongs_to_the_episode() {
        let draw = |actors, environments, column, number, step, seed| {
            let (plan, column_map) = plan(actors, environments);
            let mut examination = Examination::new(plan, column_map, &Config::default(), seed, 4);
            for _ in 0..number {
                examination.choose(column, 20, None);
                examination.settle(column, &header(Some(End::Terminated)), &transition(0.0)).unwrap();
            }
            let environment = column_map.environment(column);
            let mut noise = vec![];
            examination.noise(Place { column, environment, episode: number, step }, &mut noise);
            assert_eq!(noise.len(), 4);
            noise
        };
        // Kitchen 8 is the second; entry 2 of its list.
        let reference = draw(5, 1, 1, 2, 6, Some(3));
        assert_eq!(reference, draw(5, 3, 5, 0, 6, Some(3)));
        assert_eq!(reference, draw(10, 1, 1, 1, 6, Some(3)));
        for other in [draw(5, 1, 1, 2, 7, Some(3)), draw(5, 1, 1, 1, 6, Some(3)), draw(5, 1, 2, 2, 6, Some(3))] {
            assert_ne!(reference, other);
        }
        assert_ne!(reference, draw(5, 1, 1, 2, 6, Some(4)));
        assert_eq!(draw(5, 1, 1, 2, 6, None), [0.0; 4]);
    }
}
