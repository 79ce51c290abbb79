//! Wall time of a run: each start from its beginning to its end, added up. The time between two starts does not count.
//!
//! It is measured by a clock that nobody sets, and read from what survives a kill: `run.toml` has the beginning of every
//! start, and the length of those that could note it. One that was killed counts until the last rollout that it wrote to
//! `metrics.jsonl`. The next start may remove that line, so it notes the time in `run.toml` first. Where an older version
//! noted no length, the clock of the day counts.

use crate::output::format;
use crate::run::identity::{Identity, Incarnation, Moment, Sign, unix_now};
use proto::trained::History;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Wall {
    pub all_starts_s: f64,
    pub last_start_s: f64,
}

pub fn signs_of_life(history: &History) -> BTreeMap<u32, Sign> {
    let mut seen: BTreeMap<u32, Sign> = BTreeMap::new();
    for trained in history.iter() {
        let sign = Sign { at_unix_s: trained.at_unix_s, wall_s: trained.wall_s };
        let newest = seen.entry(trained.incarnation).or_insert(sign);
        // What a checkpoint says of a rollout has no length.
        if sign.wall_s >= newest.wall_s {
            *newest = Sign { at_unix_s: newest.at_unix_s.max(sign.at_unix_s), ..sign };
        }
    }
    seen
}

/// Whether the newest start has trained nothing yet.
pub fn is_idle(identity: &Identity, history: &History) -> bool {
    let newest = history.iter().next_back().map(|trained| trained.incarnation);
    identity.incarnations.last().is_some_and(|start| newest != Some(start.number))
}

/// Wall time of all starts until each rollout, seconds. Where a line says none, its rollout's own time is added.
pub fn elapsed_s(history: &History) -> impl Iterator<Item = f64> {
    let (mut start, mut before_s, mut now_s) = (0, 0.0, 0.0_f64);
    history.iter().map(move |trained| {
        if std::mem::replace(&mut start, trained.incarnation) != trained.incarnation {
            before_s = now_s;
        }
        let added = now_s + trained.timing.total_s();
        now_s = trained.wall_s.map_or(added, |wall_s| now_s.max(before_s + wall_s));
        now_s
    })
}

fn running_s(start: &Incarnation, seen: Option<Sign>) -> f64 {
    let since = |unix_s: u64| unix_now().saturating_sub(unix_s) as f64;
    let measured = start.started.as_ref().and_then(Moment::elapsed_s);
    // On another machine the clock of the day counts from its last rollout on.
    let after_last = || seen.and_then(|sign| Some(sign.wall_s? + since(sign.at_unix_s)));
    measured.or_else(after_last).unwrap_or_else(|| since(start.started_unix_s))
}

pub fn silent_s(start: &Incarnation, seen: Option<Sign>) -> f64 {
    let measured = start.started.as_ref().and_then(Moment::elapsed_s);
    let before = seen.map_or(Some(0.0), |sign| sign.wall_s);
    let newest = seen.map_or(0, |sign| sign.at_unix_s).max(start.started_unix_s);
    let by_day = || unix_now().saturating_sub(newest) as f64;
    measured.zip(before).map_or_else(by_day, |(measured_s, before_s)| (measured_s - before_s).max(0.0))
}

impl Wall {
    /// `seen`: when each incarnation was last known to be alive. `runs`: the last one runs now.
    pub fn of(identity: &Identity, seen: &BTreeMap<u32, Sign>, runs: bool) -> Self {
        let of = |(index, start): (usize, &Incarnation)| {
            let sign = seen.get(&start.number).copied();
            if runs && index + 1 == identity.incarnations.len() {
                return running_s(start, sign);
            }
            let ended = start.ended.as_ref();
            let by_day = || {
                let seen = start.seen_unix_s.max(sign.map(|sign| sign.at_unix_s));
                let end = ended.map(|ended| ended.at_unix_s).or(seen).unwrap_or(start.started_unix_s);
                // That clock can have been set back.
                end.saturating_sub(start.started_unix_s) as f64
            };
            let seen_s = || sign.and_then(|sign| sign.wall_s).or(start.seen_wall_s);
            ended.map_or_else(seen_s, |ended| ended.wall_s).unwrap_or_else(by_day)
        };
        let starts: Vec<f64> = identity.incarnations.iter().enumerate().map(of).collect();
        Self { all_starts_s: starts.iter().sum(), last_start_s: starts.last().copied().unwrap_or(0.0) }
    }

    /// As people read it: `wall time 3 min 01 s over 2 starts (the last 1 min 01 s)`.
    pub fn text(&self, starts: u32) -> String {
        let time = |seconds| format::duration(Duration::try_from_secs_f64(seconds).unwrap_or_default());
        let all = time(self.all_starts_s);
        if starts > 1 {
            format!("wall time {all} over {starts} starts (the last {})", time(self.last_start_s))
        } else {
            format!("wall time {all}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::identity::tests::ended;
    use proto::run_state::Ending;
    use proto::trained::Trained;

    /// Starts at 1000, 2000 and 3000 s by the clock of the day: stopped after 100 s, killed, and the last.
    fn identity() -> Identity {
        let mut identity = Identity::new().unwrap();
        for number in 1..=3 {
            identity.begin_incarnation();
            let start = &mut identity.incarnations[number - 1];
            (start.started_unix_s, start.started) = (number as u64 * 1000, None);
            start.ended = (number == 1).then(|| ended(Ending::Stopped, 1100));
        }
        identity
    }

    fn seen(signs: &[(u32, u64, Option<f64>)]) -> BTreeMap<u32, Sign> {
        signs.iter().map(|&(number, at_unix_s, wall_s)| (number, Sign { at_unix_s, wall_s })).collect()
    }

    fn wall(identity: &Identity, seen: &BTreeMap<u32, Sign>) -> [f64; 2] {
        let Wall { all_starts_s, last_start_s } = Wall::of(identity, seen, false);
        [all_starts_s, last_start_s]
    }

    #[test]
    fn a_start_is_idle_until_it_has_trained() {
        let mut history = History::default();
        assert!(is_idle(&identity(), &history) && !is_idle(&Identity::new().unwrap(), &history));
        for (rollout, incarnation) in [(0, 2), (1, 3)] {
            history.insert(Trained { rollout, incarnation, ..Trained::default() });
            assert_eq!(is_idle(&identity(), &history), incarnation == 2);
        }
    }

    #[test]
    fn starts_of_older_versions_add_up_by_the_clock_of_the_day() {
        assert_eq!(wall(&identity(), &seen(&[])), [100.0, 0.0], "nobody knows how long the killed ones lived");
        let signs = seen(&[(1, 1090, None), (2, 2030, None), (3, 3005, None)]);
        assert_eq!(wall(&identity(), &signs), [135.0, 5.0]);
        // The next start removes what is trained again.
        let mut noted = identity();
        noted.note_signs_of_life(&signs);
        assert_eq!(wall(&noted, &seen(&[])), [135.0, 5.0]);
        assert_eq!(wall(&Identity::new().unwrap(), &seen(&[])), [0.0, 0.0], "an imported run has had no start");
        assert_eq!(wall(&identity(), &seen(&[(2, 500, None), (3, 400, None)])), [100.0, 0.0], "set back");
    }

    #[test]
    fn the_clock_of_the_day_may_be_set_while_a_run_goes_on() {
        for [first, second] in [[0, 9_000_000_000], [9_000_000_000, 0]] {
            let mut identity = identity();
            identity.incarnations[0].ended.as_mut().unwrap().wall_s = Some(90.5);
            identity.incarnations[0].ended.as_mut().unwrap().at_unix_s = first;
            let signs = seen(&[(2, second, Some(30.25)), (3, first, Some(4.0))]);
            assert_eq!(wall(&identity, &signs), [124.75, 4.0]);
            let mut noted = identity.clone();
            noted.note_signs_of_life(&signs);
            assert_eq!(wall(&noted, &seen(&[])), [124.75, 4.0]);
            // One that goes on, and has just begun.
            let (_, _) = identity.begin_incarnation();
            identity.incarnations[3].started_unix_s = second;
            let Wall { all_starts_s, last_start_s } = Wall::of(&identity, &signs, true);
            assert!((0.0..60.0).contains(&last_start_s), "{last_start_s}");
            assert!((all_starts_s - last_start_s - 124.75).abs() < 1e-9);
            let start = &identity.incarnations[3];
            assert!(silent_s(start, None) < 60.0);
            assert!(silent_s(start, Some(Sign { at_unix_s: second, wall_s: Some(0.0) })) < 60.0);
            // Its end is measured, too.
            let ended = identity.incarnations[0].ended.clone().unwrap();
            identity.end_incarnation(ended);
            assert!((0.0..60.0).contains(&Wall::of(&identity, &signs, false).last_start_s));
        }
    }

    #[test]
    fn a_sign_of_life_is_the_latest_and_a_checkpoint_takes_none_away() {
        let mut history = crate::training::means::tests::history(5);
        let mut last = history.iter().next_back().unwrap().clone();
        (last.rollout, last.wall_s, last.at_unix_s) = (5, None, 3);
        history.insert(last);
        assert_eq!(signs_of_life(&history), seen(&[(1, 8, Some(8.0))]));
    }

    #[test]
    fn the_time_until_a_rollout_goes_on_from_start_to_start() {
        let mut history = crate::training::means::tests::history(3);
        for (rollout, wall_s) in [(3, Some(1.5)), (4, None)] {
            let last = history.iter().next_back().unwrap().clone();
            history.insert(proto::trained::Trained { rollout, wall_s, incarnation: 2, at_unix_s: 0, ..last });
        }
        assert_eq!(elapsed_s(&history).collect::<Vec<_>>(), [0.0, 2.0, 4.0, 5.5, 7.5]);
    }

    #[test]
    fn one_start_is_not_counted_out() {
        let wall = Wall { all_starts_s: 181.0, last_start_s: 61.0 };
        assert_eq!(wall.text(2), "wall time 3 min 01 s over 2 starts (the last 1 min 01 s)");
        assert_eq!(wall.text(1), "wall time 3 min 01 s");
    }
}
