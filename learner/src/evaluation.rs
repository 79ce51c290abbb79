//! Runs planned episodes with a policy: chosen actions, outcomes, and columns without further episodes. No I/O, no
//! tensors.

use crate::collector::{ColumnMap, Decision, Noise, Signals};
use proto::config::Config;
use proto::evaluation::{Confusion, EpisodeRecord, Plan, category_of, has_targets};
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use proto::record::RecordHeader;
use proto::task::{Composition, Layout, Summing, Sums};

/// The episode of a column.
#[derive(Debug, Clone, Default)]
struct Course {
    /// The episode's number in its kitchen; none if the column has no further episode.
    episode: Option<u32>,
    played: u32,
    actions: Vec<u8>,
    /// Returns and metrics; none before the first action.
    sums: Option<Sums>,
    /// The prediction of the label for the action in flight.
    foretold: Option<bool>,
    confusion: Option<Confusion>,
}

/// An episode that has ended: its record, and the bytes of the actions taken.
pub type Played = (EpisodeRecord, Vec<u8>);

#[derive(Debug, Clone)]
pub(crate) struct Examination {
    plan: Plan,
    column_map: ColumnMap,
    layout: &'static Layout,
    has_targets: bool,
    rewards: Vec<Composition>,
    summing: Summing,
    signals: Signals,
    /// None: take the most probable action.
    seed: Option<u64>,
    noise: Noise,
    /// In place of an action.
    hold: Vec<u8>,
    courses: Vec<Course>,
    remaining: usize,
}

impl Examination {
    /// Every column at the start of its first episode. Noise of `seed` samples actions; without a seed the most probable
    /// one is taken.
    pub fn new(plan: Plan, column_map: ColumnMap, config: &Config, seed: Option<u64>) -> Self {
        let course = |column| Course { episode: plan.dealt(column_map.environment(column), 0), ..Course::default() };
        let spec = config.spec();
        Self {
            courses: (0..column_map.columns()).map(course).collect(),
            remaining: plan.len(),
            plan,
            column_map,
            layout: spec.layout(),
            has_targets: has_targets(spec),
            rewards: spec.plain_rewards().map(|name| config.reward(name)).collect(),
            summing: Summing::of(spec),
            signals: Signals::of(config),
            seed,
            noise: Noise::of(&config.action_head()),
            hold: spec.actions.hold(),
        }
    }

    pub(crate) fn remaining(&self) -> usize {
        self.remaining
    }

    fn kitchen(&self, column: usize, number: u32) -> KitchenId {
        let environment = self.column_map.environment(column);
        self.plan.kitchen_of(environment, number).unwrap_or(environment.kitchen)
    }

    /// Appends the noise for one column's step: a function of (seed, kitchen, episode, step) and nothing else.
    pub fn noise(&self, place: Decision, noise: &mut Vec<f32>) {
        let (Some(seed), Some(episode)) = (self.seed, self.courses[place.column].episode) else {
            noise.resize(noise.len() + self.noise.count(), 0.0);
            return;
        };
        let played = self.courses[place.column].played;
        let kitchen = self.kitchen(place.column, played).number();
        let key = Key { seed, purpose: Purpose::Evaluation, kitchen, environment: 0, episode, step: place.step };
        self.noise.draw_from(key, noise);
    }

    /// Notes the policy's action for a column and returns the action to send: HOLD if the column has no further
    /// episode.
    pub(crate) fn choose<'a>(&'a mut self, column: usize, action: &'a [u8], foretold: Option<bool>) -> &'a [u8] {
        let course = &mut self.courses[column];
        if course.episode.is_none() {
            return &self.hold;
        }
        course.actions.extend_from_slice(action);
        course.foretold = foretold;
        action
    }

    /// Records the outcome of a column's last action; returns the record of its episode if that has ended.
    pub fn settle(&mut self, column: usize, record: &[u8]) -> Option<Played> {
        let course = &mut self.courses[column];
        let episode = course.episode?;
        let (header, layout) = (RecordHeader::of(record), self.layout);
        let part = |index| layout.part(record, index);
        let rewards: Vec<f32> = self.rewards.iter().map(|reward| reward.of(part, 0.0)).collect();
        let sums = course.sums.get_or_insert_with(|| self.summing.nothing(rewards.len()));
        self.summing.add(sums, record, &rewards);
        if let Some(foretold) = course.foretold.take() {
            let confusion = course.confusion.get_or_insert_default();
            // As in training, an episode's last step does not count.
            if header.end().is_none() {
                confusion.count(foretold, self.signals.labels(part));
            }
        }
        let end = header.end()?;
        let environment = self.column_map.environment(column);
        let kitchen = self.plan.kitchen_of(environment, course.played).unwrap_or(environment.kitchen);
        let count = course.played + 1;
        let next = Course { episode: self.plan.dealt(environment, count), played: count, ..Course::default() };
        let ended = std::mem::replace(course, next);
        self.remaining -= 1;
        let sums = ended.sums?;
        let metrics = self.summing.metrics(Some(&sums), record);
        let played = EpisodeRecord {
            kitchen,
            episode,
            category: self.has_targets.then(|| category_of(episode)),
            end,
            length: (ended.actions.len() / self.hold.len()) as u32,
            numbers: sums.returns.iter().copied().map(Some).chain(metrics).collect(),
            prediction: ended.confusion,
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
    use proto::record::{End, HOLD};
    use proto::task::Dtype;
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
        for &(name, number) in numbers {
            let (_, field) = config.spec().channel(name).unwrap();
            match field.dtype {
                Dtype::F32 => field.of_mut(record)[0] = number,
                _ => field.of_mut(record)[0] = number as u32,
            }
        }
        lines
    }

    /// A number of an episode; NaN where it has none.
    fn number(record: &EpisodeRecord, name: &str) -> f64 {
        record.number(Config::default().spec().column(name).unwrap()).unwrap_or(f64::NAN)
    }

    fn settle(examination: &mut Examination, column: usize, record: &[Line]) -> Option<Played> {
        examination.settle(column, Line::bytes(record))
    }

    #[test]
    fn every_episode_is_recorded_once_and_who_has_run_out_holds() {
        let (plan, column_map) = plan(7, 3);
        let mut examination = Examination::new(plan.clone(), column_map, &Config::default(), Some(1));
        let mut seen = BTreeSet::new();
        let mut rounds = 0;
        while examination.remaining() > 0 {
            rounds += 1;
            assert!(rounds < 10);
            for column in 0..column_map.columns() {
                if examination.choose(column, &[20], None) == [HOLD] {
                    assert!(settle(&mut examination, column, &record(None, &[])).is_none());
                    continue;
                }
                let last = record(Some(End::Terminated), &[("goal_success", 1.0)]);
                let (record, actions) = settle(&mut examination, column, &last).unwrap();
                assert_eq!((record.length, actions.as_slice()), (1, &[20][..]));
                assert_eq!(record.kitchen, column_map.environment(column).kitchen);
                assert!(
                    number(&record, "success") == 1.0 && record.end == End::Terminated && record.prediction.is_none()
                );
                assert_eq!(record.category, Some(category_of(record.episode)));
                assert!(seen.insert((record.kitchen, record.episode)));
            }
        }
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), plan.episodes().collect::<Vec<_>>());
        assert!((0..column_map.columns()).all(|column| examination.choose(column, &[3], None) == [HOLD]));
    }

    #[test]
    fn an_episodes_steps_add_up() {
        let (plan, column_map) = plan(5, 1);
        let mut examination = Examination::new(plan, column_map, &Config::default(), None);
        // Foretold and came; missed; false alarm; quiet; and a last step, which is not asked about.
        let steps = [(true, -0.001), (false, -0.002), (true, 0.0), (false, -0.0009), (true, -0.5)];
        let mut played = None;
        for (step, (foretold, progress_m)) in steps.into_iter().enumerate() {
            assert!(played.is_none());
            assert_eq!(examination.choose(2, &[step as u8], Some(foretold)), [step as u8]);
            let flag = |set: bool| f32::from(u8::from(set));
            let outcome = record(
                (step == 4).then_some(End::Truncated),
                &[
                    ("disturbance_progress_m", progress_m),
                    ("disturbance_m", if step == 3 { 0.009 } else { 0.01 }),
                    ("failed_action", flag(step == 1)),
                    ("picked_up", flag(step == 2)),
                    ("held", flag(step >= 2)),
                    ("disturbed_objects", 1.0),
                    ("ever_disturbed_objects", 2.0),
                    ("peak_farthest_m", 0.4),
                ],
            );
            played = settle(&mut examination, 2, &outcome);
        }
        let (record, actions) = played.unwrap();
        assert_eq!(actions, [0, 1, 2, 3, 4]);
        assert_eq!((record.end, record.length, record.state_hash), (End::Truncated, 5, 9));
        for (name, expected) in [
            ("success", 0.0),
            ("picked_up", 1.0),
            ("pickup_step", 3.0),
            ("steps_after_pickup", 2.0),
            ("failed_actions", 1.0),
            ("disturbing_steps", 3.0),
            ("displaced_steps", 4.0),
            ("ever_disturbed_objects", 2.0),
            ("temporary_displacement", 1.0),
            ("peak_farthest_m", f64::from(0.4f32)),
        ] {
            assert_eq!(number(&record, name), expected, "{name}");
        }
        let counts = Confusion { hits: 1, misses: 1, false_alarms: 1, quiet: 1 };
        assert_eq!(record.prediction, Some(counts));
        let returns = ["return_r", "return_r_prime"].map(|name| number(&record, name));
        assert!((returns[0] + 5.0 * 0.01 + 0.03 - 5.0).abs() < 1e-6);
        assert!((returns[1] - returns[0] + 15.0 * 0.5039).abs() < 1e-5);
    }

    /// However the episodes are dealt out, the noise of an episode's step is the same.
    #[test]
    fn noise_belongs_to_the_episode() {
        let draw = |actors, environments, column, number, step, seed| {
            let (plan, column_map) = plan(actors, environments);
            let mut examination = Examination::new(plan, column_map, &Config::default(), seed);
            for _ in 0..number {
                examination.choose(column, &[20], None);
                settle(&mut examination, column, &record(Some(End::Terminated), &[])).unwrap();
            }
            let environment = column_map.environment(column);
            let mut noise = vec![];
            examination.noise(Decision { column, environment, episode: number, step }, &mut noise);
            assert_eq!(noise.len(), 21);
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
        assert_eq!(draw(5, 1, 1, 2, 6, None), [0.0; 21]);
    }
}
