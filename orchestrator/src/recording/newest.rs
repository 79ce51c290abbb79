use super::episode_index::{EpisodeIndex, Key, Shelved};
use anyhow::{Context, Result, bail, ensure};
use proto::config::Config;
use proto::replay::{RecordedEpisode, ReplaySetup};
use proto::run_folder::RunFolder;
use std::cmp::Reverse;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_mins(10);
const OF_A_KIND: usize = 3;
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
    let picked = pick(index.episodes(), &good, only, count);
    if picked.is_empty() {
        bail!("{place}: its recordings hold no such episode that has ended");
    }
    let root = std::path::absolute(folder.root())?;
    let root = root.to_str().context("the run's folder has a name that is not text")?.to_owned();
    let take_out = |key| {
        let (config, episode) = index.take_out(key)?.context("an episode is no longer in the recordings")?;
        Ok((ReplaySetup { config, folder: Some(root.clone()), images: None }, episode))
    };
    picked.into_iter().map(take_out).collect()
}

fn pick<'a>(
    episodes: impl Iterator<Item = (Key, &'a Shelved)>,
    good: &[String],
    only: Option<Only>,
    count: Option<usize>,
) -> Vec<Key> {
    let kind = |outcome: &str| match good.iter().position(|word| word == outcome) {
        Some(0) => Kind::Undisturbed,
        Some(_) => Kind::Disturbed,
        None => Kind::Failure,
    };
    let ended = |(key, shelved): (Key, &Shelved)| {
        let end = shelved.end.as_ref().filter(|_| shelved.is_playable())?;
        Some((Reverse(shelved.order), key, kind(&end.outcome)))
    };
    let mut ended: Vec<_> = episodes.filter_map(ended).collect();
    ended.sort_unstable_by_key(|(order, ..)| *order);
    let first = |admits: &dyn Fn(Kind) -> bool, most: usize| -> Vec<Key> {
        ended.iter().filter(|(_, _, kind)| admits(*kind)).take(most).map(|(_, key, _)| *key).collect()
    };
    match (only, count) {
        (Some(only), count) => first(&|kind| only.admits(kind), count.unwrap_or(OF_A_KIND)),
        (None, Some(count)) => first(&|_| true, count),
        (None, None) => {
            let mut shown: Vec<Key> =
                SHOWN.iter().flat_map(|&(wanted, most)| first(&|kind| kind == wanted, most)).collect();
            // Where a kind is missing, such as in a run that fails only, others take its place.
            let others = ended.iter().map(|(_, key, _)| *key).filter(|key| !shown.contains(key));
            let missing = SHOWN.iter().map(|(_, most)| most).sum::<usize>() - shown.len();
            let others: Vec<Key> = others.take(missing).collect();
            shown.extend(others);
            shown
        }
    }
}
