//! Two evaluations of the same episodes, episode by episode.

use crate::output::format::counted;
use proto::bounded::TABLE_BYTES_MOST;
use proto::config::Config;
use proto::evaluation::{EpisodeRecord, TABLE_FILE, read_table_from};
use proto::kitchen::KitchenId;
use proto::run_folder::RunFolder;
use proto::task::Spec;
use serde::Serialize;
use std::collections::BTreeMap;

/// How many of the episodes that both played each succeeded in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct SameEpisodes {
    pub both: u64,
    pub only: [u64; 2],
    pub neither: u64,
}

impl SameEpisodes {
    /// None where the tasks, or the episodes, are not the same, or a task has no success.
    pub fn of(folders: [&RunFolder; 2], configs: [&Config; 2]) -> Option<Self> {
        if configs[0].task != configs[1].task {
            return None;
        }
        let spec = configs[0].spec();
        let read = |folder: &RunFolder| {
            let table = folder.reader(&folder.root().join(TABLE_FILE), TABLE_BYTES_MOST).ok()?;
            outcomes(spec, &read_table_from(spec, table).ok()?)
        };
        Self::between(&read(folders[0])?, &read(folders[1])?)
    }

    fn between(one: &Outcomes, other: &Outcomes) -> Option<Self> {
        if !one.keys().eq(other.keys()) {
            return None;
        }
        let count =
            |wanted| one.values().zip(other.values()).filter(|(one, other)| (**one, **other) == wanted).count() as u64;
        let only = [count((true, false)), count((false, true))];
        Some(Self { both: count((true, true)), only, neither: count((false, false)) })
    }

    pub fn line(&self, names: [&str; 2]) -> String {
        let Self { both, only: [one, other], neither } = self;
        let all = counted(both + one + other + neither, "episode");
        let [first, second] = names;
        format!("of the same {all} succeeded: {both} in both, {one} in {first} only, {other} in {second} only")
    }
}

type Outcomes = BTreeMap<(KitchenId, u32), bool>;

fn outcomes(spec: &Spec, records: &[EpisodeRecord]) -> Option<Outcomes> {
    // The one that demands least.
    let success = spec.column(&spec.metrics[spec.successes().next_back()?].name)?;
    Some(records.iter().map(|record| ((record.kitchen, record.episode), record.has_all(&[success]))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::testing::played;
    use proto::kitchen::Split;

    #[test]
    fn episodes_are_compared_one_by_one_where_they_are_the_same() {
        let kitchen = KitchenId::of_split(Split::Test)[0];
        let of = |good: &[&str]| {
            let names = good.iter().zip(0..).map(|(name, number)| played(kitchen, number, &[*name]));
            outcomes(&Spec::built_in()[0], &names.collect::<Vec<_>>()).unwrap()
        };
        let one = of(&["success", "success", "picked_up", "success"]);
        let same = SameEpisodes::between(&one, &of(&["success", "picked_up", "success", "picked_up"])).unwrap();
        let expected = "of the same 4 episodes succeeded: 1 in both, 2 in E only, 1 in E2 only";
        assert_eq!((same.line(["E", "E2"]).as_str(), same.neither), (expected, 0));
        assert_eq!(SameEpisodes::between(&one, &of(&["success"])), None);
    }
}
