//! Runs planned episodes with a policy: chosen actions, outcomes, and columns without further episodes. No I/O, no
//! tensors.

use crate::collector::{ColumnMap, Place, Signals, gumbel_of};
use crate::record::named;
use proto::config::Config;
use proto::evaluation::{Confusion, EpisodeEnd, EpisodeRecord, Plan, category_of};
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use proto::record::{End, HOLD, RecordHeader};
use proto::reward::UNDISTURBED_THRESHOLD_M;
use proto::task::{Composition, Field, Layout};

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

/// Channels that an episode's record is made of.
#[derive(Debug, Clone)]
struct Channels {
    layout: &'static Layout,
    failed_action: Field,
    goal_success: Field,
    held: Field,
    disturbance_m: Field,
    peak_disturbance_m: Field,
    disturbed_objects: Field,
    ever_disturbed_objects: Field,
    farthest_m: Field,
    peak_farthest_m: Field,
    wrist_object_m: Field,
    object_goal_m: Field,
}

impl Channels {
    fn of(config: &Config) -> Self {
        let named = |name| named(config.spec(), name);
        Self {
            layout: config.spec().layout(),
            failed_action: named("failed_action"),
            goal_success: named("goal_success"),
            held: named("held"),
            disturbance_m: named("disturbance_m"),
            peak_disturbance_m: named("peak_disturbance_m"),
            disturbed_objects: named("disturbed_objects"),
            ever_disturbed_objects: named("ever_disturbed_objects"),
            farthest_m: named("farthest_m"),
            peak_farthest_m: named("peak_farthest_m"),
            wrist_object_m: named("wrist_object_m"),
            object_goal_m: named("object_goal_m"),
        }
    }
}

/// All columns of an evaluation.
#[derive(Debug, Clone)]
pub(crate) struct Examination {
    plan: Plan,
    column_map: ColumnMap,
    /// r and r′.
    rewards: [Composition; 2],
    signals: Signals,
    channels: Channels,
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
            channels: Channels::of(config),
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
    pub fn settle(&mut self, column: usize, record: &[u8]) -> Option<Played> {
        let course = &mut self.courses[column];
        let episode = course.episode?;
        let (header, channels) = (RecordHeader::of(record), &self.channels);
        let part = |index| channels.layout.part(record, index);
        let reward = |reward: &Composition| f64::from(reward.of(part, 0.0));
        let [r, r_prime] = &self.rewards;
        course.return_r += reward(r);
        course.return_r_prime += reward(r_prime);
        let (label, held) = (self.signals.labels(part), channels.held.number(record) != 0.0);
        let disturbance_m = channels.disturbance_m.f32(record);
        course.failed_actions += u32::from(channels.failed_action.f32(record) != 0.0);
        course.disturbing_steps += u32::from(label);
        course.displaced_steps += u32::from(disturbance_m >= UNDISTURBED_THRESHOLD_M);
        if held {
            course.pickup_step.get_or_insert(course.actions.len() as u32);
        }
        if let Some(foretold) = course.foretold.take() {
            let confusion = course.confusion.get_or_insert_default();
            // As in training, an episode's last step does not count.
            if header.end().is_none() {
                confusion.count(foretold, label);
            }
        }
        let end = header.end()?;
        let environment = self.column_map.environment(column);
        let kitchen = self.plan.kitchen_of(environment, course.played).unwrap_or(environment.kitchen);
        let count = course.played + 1;
        let next = Course { episode: self.plan.dealt(environment, count), played: count, ..Course::default() };
        let ended = std::mem::replace(course, next);
        self.remaining -= 1;
        let played = EpisodeRecord {
            kitchen,
            episode,
            category: category_of(episode),
            end: match end {
                End::Terminated => EpisodeEnd::Done,
                End::Truncated => EpisodeEnd::TimeLimit,
            },
            success: channels.goal_success.f32(record) != 0.0,
            // What is held stays held until the episode ends.
            picked_up: held,
            pickup_step: ended.pickup_step,
            length: ended.actions.len() as u32,
            failed_actions: ended.failed_actions,
            return_r: ended.return_r,
            return_r_prime: ended.return_r_prime,
            disturbance_m,
            peak_disturbance_m: channels.peak_disturbance_m.f32(record),
            disturbed_objects: channels.disturbed_objects.number(record) as u32,
            ever_disturbed_objects: channels.ever_disturbed_objects.number(record) as u32,
            farthest_m: channels.farthest_m.f32(record),
            peak_farthest_m: channels.peak_farthest_m.f32(record),
            disturbing_steps: Some(ended.disturbing_steps),
            displaced_steps: Some(ended.displaced_steps),
            wrist_object_m: channels.wrist_object_m.f32(record),
            object_goal_m: channels.object_goal_m.f32(record),
            disturb_prediction: ended.confusion,
            state_hash: header.outcome_hash,
        };
        Some((played, ended.actions))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::{Kitchens, Split};
    use std::collections::BTreeSet;
    use wire::message::Line;

    fn plan(actors: u32, environments: u32) -> (Plan, ColumnMap) {
        let config = EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 7);
        let column_map = ColumnMap::new(0, actors, environments).in_kitchens(Kitchens::Split(Split::Test));
        (Plan::new(&config, actors, environments), column_map)
    }

    /// The record of a step, and channels of it that are not 0.
    fn record(end: Option<End>, numbers: &[(&str, f32)]) -> Vec<Line> {
        let config = Config::default();
        let mut lines = vec![Line([0; 64]); config.spec().layout().small_bytes / size_of::<Line>()];
        let record = Line::bytes_mut(&mut lines);
        RecordHeader::of_mut(record).act(9, end);
        let same = [
            ("disturbance_m", 0.5),
            ("peak_disturbance_m", 0.6),
            ("wrist_object_m", 1.0),
            ("object_goal_m", 2.0),
            ("farthest_m", 0.3),
            ("peak_farthest_m", 0.4),
        ];
        for &(name, number) in same.iter().chain(numbers) {
            named(config.spec(), name).of_mut(record)[0] = number;
        }
        named(config.spec(), "disturbed_objects").of_mut(record)[0] = 1_u32;
        named(config.spec(), "ever_disturbed_objects").of_mut(record)[0] = 2_u32;
        lines
    }

    fn settle(examination: &mut Examination, column: usize, record: &[Line]) -> Option<Played> {
        examination.settle(column, Line::bytes(record))
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
                    assert!(settle(&mut examination, column, &record(None, &[])).is_none());
                    continue;
                }
                let last = record(Some(End::Terminated), &[("goal_success", 1.0)]);
                let (record, actions) = settle(&mut examination, column, &last).unwrap();
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
            let mut outcome = record(
                (step == 4).then_some(End::Truncated),
                &[
                    ("disturbance_progress_m", progress_m),
                    ("disturbance_m", if step == 3 { 0.009 } else { 0.01 }),
                    ("failed_action", f32::from(u8::from(step == 1))),
                ],
            );
            named(Config::default().spec(), "held").of_mut(Line::bytes_mut(&mut outcome))[0] = u32::from(step >= 2);
            played = settle(&mut examination, 2, &outcome);
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
                settle(&mut examination, column, &record(Some(End::Terminated), &[])).unwrap();
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
