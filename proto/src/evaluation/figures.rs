use super::confusion::{Confusion, share};
use super::record::EpisodeRecord;
use crate::task::{Column, Curve, Spec, Take};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Figures of a set of episodes. Shares are 0..=1. A mean or share of nothing is none (`null`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Figures {
    pub episodes: u64,
    /// The mean of each number of an episode, and the task's further figures ([`Spec::described`]).
    #[serde(flatten)]
    numbers: BTreeMap<String, Option<f64>>,
    pub curves: BTreeMap<String, Vec<CurvePoint>>,
    /// Predictions of the task's label; none where the policy makes none.
    pub prediction: Option<PredictionFigures>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    pub limit: f32,
    /// Of all episodes.
    pub share: f64,
}

/// Quality of prediction over all steps of all episodes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PredictionFigures {
    #[serde(flatten)]
    pub counts: Confusion,
    pub precision: Option<f64>,
    pub recall: Option<f64>,
    pub recall_of_quiet: Option<f64>,
}

impl Figures {
    /// The figures of these episodes. Sums go in their order, so the same table gives the same bits.
    pub fn of<'a>(spec: &Spec, records: impl Iterator<Item = &'a EpisodeRecord>) -> Self {
        let records: Vec<&EpisodeRecord> = records.collect();
        let column = |name: &String| spec.column(name).expect("a task is checked when it is read");
        let mean = |column: Column| mean(records.iter().filter_map(|record| record.number(column)));
        let engines = [("terminated", Column::Terminated), ("length", Column::Length)];
        let columns = spec.columns().into_iter().enumerate().map(|(index, one)| (one.name, Column::Number(index)));
        let columns = engines.map(|(name, column)| (name.to_owned(), column)).into_iter().chain(columns);
        let mut numbers: BTreeMap<_, _> = columns.map(|(name, column)| (name, mean(column))).collect();
        for figure in &spec.figures {
            let among: Vec<Column> = figure.among.iter().map(column).collect();
            let chosen = || records.iter().filter(|record| record.has_all(&among));
            let of = |name: &String| {
                let column = column(name);
                chosen().filter_map(move |record| record.number(column))
            };
            let number = match &figure.per {
                Some(per) => quotient(of(&figure.of).sum(), of(per).sum()),
                None => taken(figure.take, of(&figure.of).collect()),
            };
            numbers.insert(figure.name.clone(), number);
        }
        let curve = |curve: &Curve| {
            let (limits, _) = curve.limits();
            let share = |&limit: &f32| {
                let within = spec.is_within(curve, limit);
                let count = records.iter().filter(|record| within(record)).count() as u64;
                Some(CurvePoint { limit, share: share(count, records.len() as u64)? })
            };
            (curve.name.clone(), limits.iter().filter_map(share).collect())
        };
        Self {
            episodes: records.len() as u64,
            numbers,
            curves: spec.curves.iter().map(curve).collect(),
            prediction: PredictionFigures::of(records.iter().filter_map(|record| record.prediction.as_ref())),
        }
    }

    pub fn get(&self, name: &str) -> Option<f64> {
        self.numbers.get(name).copied().flatten()
    }
}

impl Spec {
    /// Whether an episode counts at this limit of a curve.
    pub fn is_within(&self, curve: &Curve, limit: f32) -> impl Fn(&EpisodeRecord) -> bool + use<> {
        let column = |name: &String| self.column(name).expect("a task is checked when it is read");
        let (of, among): (_, Vec<Column>) = (column(&curve.of), curve.among.iter().map(column).collect());
        let ((_, inclusive), limit) = (curve.limits(), f64::from(limit));
        move |record| {
            let within = |number: f64| if inclusive { number <= limit } else { number < limit };
            record.has_all(&among) && record.number(of).is_some_and(within)
        }
    }
}

impl PredictionFigures {
    fn of<'a>(predictions: impl Iterator<Item = &'a Confusion>) -> Option<Self> {
        let counts = predictions.copied().reduce(Confusion::merged)?;
        let (precision, recall, recall_of_quiet) = (counts.precision(), counts.recall(), counts.recall_of_quiet());
        Some(Self { counts, precision, recall, recall_of_quiet })
    }
}

fn quotient(sum: f64, of: f64) -> Option<f64> {
    (of != 0.0).then(|| sum / of)
}

fn mean(numbers: impl Iterator<Item = f64>) -> Option<f64> {
    let numbers: Vec<f64> = numbers.collect();
    quotient(numbers.iter().sum(), numbers.len() as f64)
}

fn taken(take: Take, mut numbers: Vec<f64>) -> Option<f64> {
    let quarter = match take {
        Take::Mean => return mean(numbers.into_iter()),
        Take::Max => 4,
        Take::LowerQuartile => 1,
        Take::Median => 2,
        Take::UpperQuartile => 3,
    };
    numbers.sort_by(f64::total_cmp);
    let last = numbers.len().checked_sub(1)?;
    Some(numbers[last * quarter / 4])
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::{any_record, arm, numbers, small};
    use super::*;
    use crate::kitchen::KitchenId;
    use crate::record::End;
    use proptest::prelude::*;

    fn record(spec: &Spec, length: u32, given: &[(&str, f64)]) -> EpisodeRecord {
        EpisodeRecord {
            kitchen: KitchenId::new(2).unwrap(),
            episode: 0,
            category: None,
            end: if length < 200 { End::Terminated } else { End::Truncated },
            length,
            numbers: numbers(spec, given),
            prediction: None,
            state_hash: 0,
        }
    }

    #[test]
    fn figures_of_four_known_episodes() {
        let spec = arm();
        let episode = |success: bool, disturbance_m: f32, objects: f64, ever: f64, length: u32| {
            let flag = |set: bool| f64::from(u8::from(set));
            let mut record = record(
                spec,
                length,
                &[
                    ("success", flag(success)),
                    ("success_without_disturbance", flag(success && disturbance_m < 0.01)),
                    ("success_but_unsafe", flag(success && disturbance_m >= 0.01)),
                    ("picked_up", flag(success)),
                    ("steps_after_pickup", f64::from(length) - 30.0),
                    ("pickup_step", 30.0),
                    ("disturbance_m", disturbance_m.into()),
                    ("disturbed_objects", objects),
                    ("ever_disturbed_objects", ever),
                    ("failed_actions", 10.0),
                ],
            );
            let Some(Column::Number(pickup_step)) = spec.column("pickup_step") else { unreachable!() };
            record.numbers[pickup_step].take_if(|_| !success);
            record
        };
        let mut records = [
            episode(true, 0.0, 0.0, 0.0, 40),
            // Just at the threshold: not below it.
            episode(true, 0.01, 0.0, 2.0, 60),
            episode(true, 0.5, 2.0, 2.0, 100),
            episode(false, 0.0, 0.0, 0.0, 200),
        ];
        records[2].prediction = Some(Confusion { hits: 1, misses: 1, false_alarms: 3, quiet: 5 });
        let figures = Figures::of(spec, records.iter());
        assert_eq!(figures.episodes, 4);
        for (name, expected) in [
            ("success", 0.75),
            ("success_without_disturbance", 0.25),
            ("terminated", 0.75),
            ("length", 100.0),
            ("length_of_successes", 200.0 / 3.0),
            ("failed_action_share", 0.1),
            ("disturbed_objects", 0.5),
            ("ever_disturbed_objects", 1.0),
            ("pickup_step", 30.0),
            ("done_after_pickup", 110.0 / 3.0),
            ("sbu", 0.5),
            ("unsafe_successes", 2.0 / 3.0),
            ("disturbance_lower_quartile_m", 0.0),
            ("disturbance_median_m", 0.0),
            ("disturbance_upper_quartile_m", f64::from(0.01f32)),
            ("worst_severity_m", 0.0),
        ] {
            assert_eq!(figures.get(name), Some(expected), "{name}");
        }
        let displacement = &figures.curves["success_by_displacement"];
        let at = |limit: f32| displacement.iter().find(|point| point.limit == limit).unwrap().share;
        assert_eq!((at(0.01), at(0.02), at(0.5), at(0.75)), (0.25, 0.5, 0.5, 0.75));
        let objects: Vec<f64> =
            figures.curves["success_by_disturbed_objects"].iter().map(|point| point.share).collect();
        assert_eq!(objects[..3], [0.5, 0.5, 0.75]);
        let prediction = figures.prediction.unwrap();
        assert_eq!((prediction.precision, prediction.recall), (Some(0.25), Some(0.5)));
        assert_eq!(prediction.recall_of_quiet, Some(0.625));
        let text = serde_json::to_string(&figures).unwrap();
        assert_eq!(serde_json::from_str::<Figures>(&text).unwrap(), figures);
    }

    #[test]
    fn another_task_has_its_own_figures() {
        let spec = small();
        let half = record(&spec, 7, &[("success", 1.0), ("spl", 0.5), ("return_r", 1.0)]);
        let figures = Figures::of(&spec, [half, record(&spec, 200, &[])].iter());
        let text = r#"{"episodes":2,"length":103.5,"return_r":0.5,"spl":0.25,"straight":0.5,"success":0.5,"terminated":0.5,"curves":{},"prediction":null}"#;
        assert_eq!(serde_json::to_string(&figures).unwrap(), text);
        let described = spec.described();
        let printed: Vec<_> = described.iter().filter(|one| !one.label.is_empty()).map(|one| &*one.label).collect();
        assert_eq!(printed, ["length", "SR", "SPL", "of successes"]);
    }

    #[test]
    fn nothing_has_no_figures() {
        let figures = Figures::of(arm(), std::iter::empty());
        assert_eq!((figures.episodes, figures.get("success"), figures.get("failed_action_share")), (0, None, None));
        assert!(figures.curves.values().all(Vec::is_empty) && figures.prediction.is_none());
    }

    proptest! {
        #[test]
        fn curves_rise_towards_the_success_rate(records in prop::collection::vec(any_record(arm()), 1..40)) {
            let figures = Figures::of(arm(), records.iter());
            for curve in figures.curves.values() {
                prop_assert!(curve.is_sorted_by(|one, next| one.share <= next.share));
                prop_assert!(curve.last().unwrap().share <= figures.get("success").unwrap());
            }
        }
    }
}
