//! Wall time of a run: each start from its beginning to its end, added up. The time between two starts does not count.
//!
//! It is read from what survives a kill: `run.toml` has the beginning of every start, and the end of those that could
//! note it. One that was killed counts until the last rollout that it wrote to `metrics.jsonl`. The next start may
//! remove that line, so it notes the time in `run.toml` first.

use crate::run::identity::Identity;
use crate::run::json_lines;
use crate::showing::format;
use anyhow::Result;
use proto::run_folder::RunFolder;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// Wall time, seconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Wall {
    /// Of all starts.
    pub all_starts_s: f64,
    /// Of the last one.
    pub last_start_s: f64,
}

/// Until when the last start counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Last {
    /// It has ended or was killed, according to its files.
    AsNoted,
    /// It runs: until this moment, seconds since 1970.
    Until(u64),
    /// It ends just now and has measured itself.
    Took(Duration),
}

/// The part of a line of `metrics.jsonl` which shows that an orchestrator was alive.
#[derive(Debug, Clone, Copy, Deserialize)]
struct Sign {
    incarnation: u32,
    at_unix_s: u64,
}

impl Wall {
    /// Reads it from a run's folder.
    pub fn read(folder: &RunFolder, identity: &Identity, last: Last) -> Result<Self> {
        Ok(Self::of(identity, &Self::signs_of_life(folder)?, last))
    }

    /// When each incarnation last wrote of a rollout, seconds since 1970.
    pub fn signs_of_life(folder: &RunFolder) -> Result<BTreeMap<u32, u64>> {
        let mut seen = BTreeMap::new();
        for Sign { incarnation, at_unix_s } in json_lines::read(&folder.metrics())? {
            let newest = seen.entry(incarnation).or_insert(at_unix_s);
            *newest = at_unix_s.max(*newest);
        }
        Ok(seen)
    }

    /// `seen`: when each incarnation was last known to be alive, seconds since 1970.
    fn of(identity: &Identity, seen: &BTreeMap<u32, u64>, last: Last) -> Self {
        let starts = &identity.incarnations;
        let noted = |number: usize| {
            let start = &starts[number];
            let seen = start.seen_unix_s.max(seen.get(&start.number).copied());
            let end = start.ended.as_ref().map(|ended| ended.at_unix_s).or(seen);
            // A clock can have been set back.
            end.unwrap_or(start.started_unix_s).saturating_sub(start.started_unix_s) as f64
        };
        let Some(newest) = starts.len().checked_sub(1) else { return Self { all_starts_s: 0.0, last_start_s: 0.0 } };
        let last_start_s = match last {
            Last::AsNoted => noted(newest),
            Last::Until(now) => now.saturating_sub(starts[newest].started_unix_s) as f64,
            Last::Took(time) => time.as_secs_f64(),
        };
        Self { all_starts_s: (0..newest).map(noted).sum::<f64>() + last_start_s, last_start_s }
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
    use crate::run::identity::Ended;
    use crate::run::json_lines::Writer;
    use proto::run_state::Ending;

    /// Starts at 1000, 2000 and 3000 s: stopped after 100 s, killed, and the last.
    fn identity() -> Identity {
        let mut identity = Identity::new().unwrap();
        for number in 1..=3 {
            identity.begin_incarnation();
            identity.incarnations[number - 1].started_unix_s = number as u64 * 1000;
            let stopped = Ended { how: Ending::Stopped, at_unix_s: 1100, frames: None, weights: None, reason: None };
            identity.incarnations[number - 1].ended = Some(stopped).filter(|_| number == 1);
        }
        identity
    }

    #[test]
    fn starts_add_up_and_a_killed_one_counts_until_its_last_rollout() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        let wall = |last| {
            let Wall { all_starts_s, last_start_s } = Wall::read(&folder, &identity(), last).unwrap();
            (all_starts_s, last_start_s)
        };
        assert_eq!(wall(Last::AsNoted), (100.0, 0.0), "nobody knows how long the killed ones lived");
        let mut journal = Writer::open(&folder.metrics()).unwrap();
        for (incarnation, at_unix_s) in [(1, 1090), (2, 2010), (2, 2030), (3, 3005)] {
            journal.append(&serde_json::json!({ "incarnation": incarnation, "at_unix_s": at_unix_s })).unwrap();
        }
        assert_eq!(wall(Last::AsNoted), (135.0, 5.0));
        assert_eq!(wall(Last::Until(3020)), (150.0, 20.0));
        assert_eq!(wall(Last::Took(Duration::from_millis(2500))), (132.5, 2.5));
        // The next start removes what is trained again.
        let mut noted = identity();
        noted.note_signs_of_life(&Wall::signs_of_life(&folder).unwrap());
        std::fs::remove_file(folder.metrics()).unwrap();
        assert_eq!(Wall::read(&folder, &noted, Last::AsNoted).unwrap().all_starts_s, 135.0);
        let Wall { all_starts_s, last_start_s } = Wall::of(&Identity::new().unwrap(), &BTreeMap::new(), Last::AsNoted);
        assert_eq!((all_starts_s, last_start_s), (0.0, 0.0), "an imported run has had no start");
    }

    #[test]
    fn a_clock_that_was_set_back_takes_nothing_away() {
        let seen = BTreeMap::from([(2, 500), (3, 400)]);
        assert_eq!(Wall::of(&identity(), &seen, Last::AsNoted), Wall { all_starts_s: 100.0, last_start_s: 0.0 });
        assert_eq!(Wall::of(&identity(), &seen, Last::Until(5)), Wall { all_starts_s: 100.0, last_start_s: 0.0 });
    }

    #[test]
    fn one_start_is_not_counted_out() {
        let wall = Wall { all_starts_s: 181.0, last_start_s: 61.0 };
        assert_eq!(wall.text(2), "wall time 3 min 01 s over 2 starts (the last 1 min 01 s)");
        assert_eq!(wall.text(1), "wall time 3 min 01 s");
    }
}
