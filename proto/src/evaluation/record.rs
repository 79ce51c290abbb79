use super::asked::ObjectSet;
use super::confusion::Confusion;
use crate::kitchen::{KitchenId, TargetCategory};
use crate::record::End;
use crate::task::Column;
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    pub kitchen: KitchenId,
    /// Its number within the kitchen.
    pub episode: u32,
    /// Of its target; none of a task without targets.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<TargetCategory>,
    pub end: End,
    /// Actions taken.
    pub length: u32,
    /// Its returns and metrics ([`crate::task::Spec::columns`]); none of a metric that it does not have.
    pub numbers: Vec<Option<f64>>,
    /// Predictions of the task's label for the actions taken; none if the policy makes none.
    pub prediction: Option<Confusion>,
    /// Hash of the simulator's state at the end.
    pub state_hash: u64,
}

impl EpisodeRecord {
    pub fn number(&self, column: Column) -> Option<f64> {
        match column {
            Column::Terminated => Some(f64::from(u8::from(self.end == End::Terminated))),
            Column::Length => Some(self.length.into()),
            Column::Number(index) => self.numbers.get(index).copied().flatten(),
        }
    }

    /// Whether all of these numbers are 1.
    pub fn has_all(&self, columns: &[Column]) -> bool {
        columns.iter().all(|&column| self.number(column) == Some(1.0))
    }

    /// Whether its target belongs to the set; one without a target is in [`ObjectSet::NoTargets`].
    pub fn is_in(&self, objects: ObjectSet) -> bool {
        match self.category {
            Some(category) => objects != ObjectSet::NoTargets && objects.contains(category),
            None => objects == ObjectSet::NoTargets,
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::task::{Kind, Spec};
    use proptest::prelude::*;

    /// A second task: two metrics, no target, no disturbance, no label.
    pub fn small() -> Spec {
        let text = r#"
        name = "small"
        actions = { kind = "discrete", names = ["Stop", "Ahead"] }
        rewards = [{ name = "r", terms = [["there", 1.0]] }]
        channels = [
            { name = "there", role = "part", dtype = "f32", values = [0, 1], doc = "There." },
            { name = "spl", role = "outcome", dtype = "f32", range = [0, 1], doc = "How straight." },
        ]
        metrics = [
            { name = "success", label = "SR", over = "last", all_of = [{ channel = "there" }], doc = "There." },
            { name = "spl", label = "SPL", over = "last", value = "spl", doc = "How straight, 0 without success." },
        ]
        figures = [{ name = "straight", label = "of successes", of = "spl", where = ["success"], doc = "SPL." }]
        "#;
        Spec::parse(text).unwrap()
    }

    /// The task that has everything.
    pub fn arm() -> &'static Spec {
        Spec::named("arm_point_nav").unwrap()
    }

    /// The numbers of a record in which these are not 0.
    pub fn numbers(spec: &Spec, given: &[(&str, f64)]) -> Vec<Option<f64>> {
        let of = |name: &str| given.iter().find(|(one, _)| *one == name).map_or(0.0, |&(_, number)| number);
        assert!(given.iter().all(|(name, _)| spec.column(name).is_some()), "{given:?}");
        spec.columns().iter().map(|column| Some(of(&column.name))).collect()
    }

    /// Any record that an episode can leave behind.
    pub fn any_record(spec: &Spec) -> impl Strategy<Value = EpisodeRecord> {
        let kinds: Vec<Kind> = spec.columns().iter().map(|column| column.kind).collect();
        let numbers: Vec<_> = kinds
            .into_iter()
            .map(|kind| match kind {
                Kind::Share => (0..=1u8).prop_map(|flag| Some(f64::from(flag))).boxed(),
                Kind::Count => proptest::option::of((0..200u32).prop_map(f64::from)).boxed(),
                Kind::F32 => (0.0f32..50.0).prop_map(|number| Some(f64::from(number))).boxed(),
                Kind::F64 => (-1e4f64..100.0).prop_map(Some).boxed(),
            })
            .collect();
        let has = [spec.channel("target").is_some(), spec.label().is_some()];
        let test_kitchens = KitchenId::of_split(crate::kitchen::Split::Test);
        let engines = (0..720u32, any::<bool>(), 1..=200u32, any::<u64>(), any::<Option<[u16; 4]>>());
        (prop::sample::select(test_kitchens), engines, numbers).prop_map(move |(kitchen, engines, numbers)| {
            let (episode, terminated, length, state_hash, counts) = engines;
            let prediction = counts.filter(|_| has[1]).map(|counts| {
                let [hits, misses, false_alarms, quiet] = counts.map(u64::from);
                Confusion { hits, misses, false_alarms, quiet }
            });
            let category = has[0].then(|| super::super::category_of(episode));
            let end = if terminated { End::Terminated } else { End::Truncated };
            EpisodeRecord { kitchen, episode, category, end, length, numbers, prediction, state_hash }
        })
    }
}
