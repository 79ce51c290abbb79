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

/// How many of the episodes that both played each succeeded in, by one of the task's successes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SameEpisodes {
    /// The success's label.
    pub metric: String,
    pub both: u64,
    pub only: [u64; 2],
    pub neither: u64,
}

impl SameEpisodes {
    /// Of each success, that which demands least first; none where the tasks, or the episodes, are not the same.
    pub fn of(folders: [&RunFolder; 2], configs: [&Config; 2]) -> Vec<Self> {
        let spec = configs[0].spec();
        let read = |folder: &RunFolder| {
            let table = folder.reader(&folder.root().join(TABLE_FILE), TABLE_BYTES_MOST).ok()?;
            read_table_from(spec, table).ok()
        };
        let same_task = configs[0].task == configs[1].task;
        let both = same_task.then(|| Some((read(folders[0])?, read(folders[1])?))).flatten();
        both.map_or_else(Vec::new, |(one, other)| Self::between(spec, &one, &other))
    }

    fn between(spec: &Spec, one: &[EpisodeRecord], other: &[EpisodeRecord]) -> Vec<Self> {
        let count = |success: usize| {
            let success = &spec.metrics[success];
            let [one, other] = [outcomes(spec, &success.name, one)?, outcomes(spec, &success.name, other)?];
            let pairs = || one.values().copied().zip(other.values().copied());
            let [both, first, second, neither] = [(true, true), (true, false), (false, true), (false, false)]
                .map(|wanted| pairs().filter(|pair| *pair == wanted).count() as u64);
            let metric = success.label.clone();
            one.keys().eq(other.keys()).then_some(Self { metric, both, only: [first, second], neither })
        };
        spec.successes().rev().filter_map(count).collect()
    }

    pub fn line(&self, names: [&str; 2]) -> String {
        let Self { metric, both, only: [one, other], neither } = self;
        let all = counted(both + one + other + neither, "episode");
        let [first, second] = names;
        format!("{metric} of the same {all}: {both} in both, {one} in {first} only, {other} in {second} only")
    }
}

fn outcomes(spec: &Spec, success: &str, records: &[EpisodeRecord]) -> Option<BTreeMap<(KitchenId, u32), bool>> {
    let success = spec.column(success)?;
    Some(records.iter().map(|record| ((record.kitchen, record.episode), record.has_all(&[success]))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::testing::played;
    use proto::kitchen::Split;

    #[test]
    fn episodes_are_compared_one_by_one_by_each_success_where_they_are_the_same() {
        let kitchen = KitchenId::of_split(Split::Test)[0];
        let best = ["success", "success_without_disturbance"];
        let of = |good: &[&[&str]]| {
            good.iter().zip(0..).map(|(names, number)| played(kitchen, number, names)).collect::<Vec<_>>()
        };
        let one = of(&[&best[..], &best[..1], &["picked_up"], &best[..]]);
        let other = of(&[&best[..], &["picked_up"], &best[..], &["picked_up"]]);
        let spec = &Spec::built_in()[0];
        let lines: Vec<String> =
            SameEpisodes::between(spec, &one, &other).iter().map(|same| same.line(["E", "E2"])).collect();
        let expected = [
            "SR of the same 4 episodes: 1 in both, 2 in E only, 1 in E2 only",
            "SRwoD of the same 4 episodes: 1 in both, 1 in E only, 1 in E2 only",
        ];
        assert_eq!(lines, expected);
        assert_eq!(SameEpisodes::between(spec, &one, &other[..3]), []);
    }
}
