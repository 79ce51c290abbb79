use crate::output::terminal;
use crate::wrong::demand;
use anyhow::{Context, Result, bail, ensure};
use proto::config::Config;
use proto::kitchen::KitchenId;
use proto::replay::{RecordedEpisode, ReplaySetup};
use proto::run_folder::RunFolder;
use recording::Recordings;
use recording::episode_index::{EpisodeIndex, Key};
use std::cmp::Reverse;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_mins(10);
const OF_A_KIND: usize = 3;
/// Steps of an episode that is over before there is much to see: where the user names no number, longer ones go first.
const SHORT: u32 = 5;
const SHOWN: [(Kind, usize); 3] = [(Kind::Undisturbed, 2), (Kind::Disturbed, 1), (Kind::Failure, 1)];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Undisturbed,
    Disturbed,
    Failure,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Only {
    Success,
    Failure,
    /// Successes that do not meet the metric that demands most, such as success without disturbance.
    Disturbed,
}

impl Only {
    fn admits(self, kind: Kind) -> bool {
        match self {
            Self::Success => kind != Kind::Failure,
            Self::Failure => kind == Kind::Failure,
            Self::Disturbed => kind == Kind::Disturbed,
        }
    }
}

pub fn newest(
    folder: &RunFolder,
    kitchen: Option<KitchenId>,
    only: Option<Only>,
    count: Option<usize>,
) -> Result<Vec<(ReplaySetup, RecordedEpisode)>> {
    let config = Config::of_run(folder)?;
    let good: Vec<String> = config.spec().good_outcomes().collect();
    let mut index = EpisodeIndex::of(folder.clone());
    let place = folder.root().display();
    ensure!(
        index.advance(PATIENCE),
        "{place}: its recordings take too long to read; choose with --environment and --episode"
    );
    index.notes.iter().for_each(|note| tracing::warn!("{note}"));
    let kind = |outcome: &str| match good.iter().position(|word| word == outcome) {
        Some(0) => Kind::Undisturbed,
        Some(_) => Kind::Disturbed,
        None => Kind::Failure,
    };
    let is_there = |(place, ..): Key| kitchen.is_none_or(|kitchen| place == kitchen.number());
    let ended = index.episodes().filter(|(key, _)| is_there(*key)).filter_map(|(key, shelved)| {
        let end = shelved.end.as_ref().filter(|_| shelved.is_playable())?;
        Some(Candidate { key, order: shelved.order, kind: kind(&end.outcome), steps: shelved.steps })
    });
    let picked = pick(ended.collect(), only, count);
    if picked.is_empty() {
        demand!(
            Recordings::of(folder).is_some(),
            "{place} has no recordings: an evaluation makes them with `--record all` (or `failures`), a run with \
            `recording.enabled = true`"
        );
        let is_readable = index.notes.is_empty() || index.episodes().next().is_some();
        ensure!(is_readable, "{place}: no episode can be read in its recordings");
        bail!("{place}: its recordings hold no such episode that has ended");
    }
    for note in explain(&picked, &good, only, count) {
        terminal::note(&note);
    }
    let root = std::path::absolute(folder.root())?;
    let root = root.to_str().context("the run's folder has a name that is not text")?.to_owned();
    let take_out = |key| {
        let (config, episode) = index.take_out(key)?.context("an episode is no longer in the recordings")?;
        Ok((ReplaySetup { config, folder: Some(root.clone()), images: None }, episode))
    };
    picked.into_iter().map(|candidate| take_out(candidate.key)).collect()
}

#[derive(Debug, Clone, Copy)]
struct Candidate {
    key: Key,
    order: u64,
    kind: Kind,
    steps: u32,
}

fn pick(mut ended: Vec<Candidate>, only: Option<Only>, count: Option<usize>) -> Vec<Candidate> {
    ended.sort_unstable_by_key(|one| (count.is_none() && one.steps <= SHORT, Reverse(one.order)));
    let first = |admits: &dyn Fn(Kind) -> bool, most: usize| -> Vec<Candidate> {
        ended.iter().filter(|one| admits(one.kind)).take(most).copied().collect()
    };
    match (only, count) {
        (Some(only), count) => first(&|kind| only.admits(kind), count.unwrap_or(OF_A_KIND)),
        (None, Some(count)) => first(&|_| true, count),
        (None, None) => {
            let mut shown: Vec<Candidate> =
                SHOWN.iter().flat_map(|&(wanted, most)| first(&|kind| kind == wanted, most)).collect();
            // Where a kind is missing, such as in a run that fails only, others take its place.
            let others = ended.iter().filter(|one| shown.iter().all(|known| known.key != one.key));
            let missing = SHOWN.iter().map(|(_, most)| most).sum::<usize>() - shown.len();
            let others: Vec<Candidate> = others.take(missing).copied().collect();
            shown.extend(others);
            shown
        }
    }
}

/// What a user might miss in films that were picked.
fn explain(picked: &[Candidate], good: &[String], only: Option<Only>, count: Option<usize>) -> Vec<String> {
    if count.is_some() {
        return Vec::new();
    }
    let names = [good.first(), good.get(1)].map(|name| name.map(|name| name.replace('-', " ")));
    let names = names.into_iter().chain([Some("failure".to_owned())]).zip(SHOWN);
    let is_missing = |kind: Kind| only.is_none() && picked.iter().all(|one| one.kind != kind);
    let missing: Vec<String> = names.filter_map(|(name, (kind, _))| name.filter(|_| is_missing(kind))).collect();
    let short = picked.iter().filter(|one| one.steps <= SHORT).count();
    let of_missing = (!missing.is_empty()).then(|| format!("no episode ended in: {}", missing.join(", ")));
    let of_short =
        (short > 0).then(|| format!("no more than {SHORT} steps in {short} of the films: no longer episode ended so"));
    of_missing.into_iter().chain(of_short).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn films_are_of_episodes_with_something_to_see_and_what_is_missing_is_said() {
        let one = |order: u32, kind, steps| Candidate { key: (1, 0, order), order: u64::from(order), kind, steps };
        let ended = vec![
            one(1, Kind::Failure, 40),
            one(2, Kind::Failure, 9),
            one(3, Kind::Undisturbed, 3),
            one(4, Kind::Failure, 1),
        ];
        let orders = |only, count| pick(ended.clone(), only, count).iter().map(|one| one.order).collect::<Vec<_>>();
        assert_eq!(orders(None, None), [3, 2, 1, 4]);
        assert_eq!(orders(Some(Only::Failure), None), [2, 1, 4]);
        assert_eq!(orders(None, Some(2)), [4, 3], "the newest, whatever they are, where their number was given");
        let good = ["success-without-disturbance".to_owned(), "success".to_owned()];
        let said = |only, count| explain(&pick(ended.clone(), only, count), &good, only, count);
        let short = |count| format!("no more than 5 steps in {count} of the films: no longer episode ended so");
        assert_eq!(said(None, None), ["no episode ended in: success".to_owned(), short(2)]);
        assert_eq!(said(Some(Only::Failure), None), [short(1)]);
        assert_eq!(said(None, Some(2)), Vec::<String>::new());
    }
}
