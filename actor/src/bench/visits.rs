//! What it costs an actor's step that an environment goes on to another kitchen.

use super::clock::processor_time;
use crate::process::prefetcher::{KitchenPrefetcher, Opened, Order};
use anyhow::{Result, ensure};
use proto::config::{Config, KitchenSource};
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use simulator::depth::Scenery;
use simulator::tasks::arm_point_nav::Environment;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// Episodes that begin in one kitchen, one after the other.
const EPISODES: u32 = 8;

/// Processor time of the thread that steps, summed over many times.
#[derive(Debug, Default)]
struct Spent {
    time: Duration,
    times: u32,
}

impl Spent {
    fn on<T>(&mut self, work: impl FnOnce() -> T) -> T {
        let before = processor_time();
        let result = work();
        self.time += processor_time().saturating_sub(before);
        self.times += 1;
        result
    }

    fn mean_ms(&self) -> f64 {
        1000.0 * self.time.as_secs_f64() / f64::from(self.times.max(1))
    }
}

/// What a change of kitchen takes.
#[derive(Debug, Default)]
struct Change {
    open: Spent,
    environment: Spent,
    scenery: Spent,
    leave: Spent,
    /// An episode in the kitchen where the environment is.
    episode: Spent,
}

/// Measures and prints: one environment goes through kitchens that are kept in the folder.
pub(super) fn run(kitchens: &[KitchenId], folder: &Path, mut out: impl Write) -> Result<()> {
    let mut config = Config::default();
    config.kitchens.source = KitchenSource::Procedural;
    let at_once = measure(kitchens, &KitchenPrefetcher::without_thread(&config, folder), &config, false)?;
    let ahead = measure(kitchens, &KitchenPrefetcher::of(&config, folder)?, &config, true)?;
    writeln!(out, "an episode begins in {:.2} ms; in another kitchen it takes", at_once.episode.mean_ms())?;
    for (when, change) in [("opened at once", at_once), ("opened ahead", ahead)] {
        let Change { open, environment, scenery, leave, .. } = &change;
        let all_ms: f64 = [open, environment, scenery, leave].map(Spent::mean_ms).iter().sum();
        writeln!(
            out,
            "{all_ms:8.2} ms, {when}: kitchen {:.2}, scenery {:.2}, environment with its episode {:.2}, leaving the old \
             one {:.2}",
            open.mean_ms(),
            scenery.mean_ms(),
            environment.mean_ms(),
            leave.mean_ms(),
        )?;
    }
    Ok(())
}

fn measure(kitchens: &[KitchenId], prefetcher: &KitchenPrefetcher, config: &Config, ahead: bool) -> Result<Change> {
    let mut change = Change::default();
    let mut here = None;
    for &kitchen in kitchens {
        let id = EnvironmentId { kitchen, number: 0 };
        if ahead {
            prefetcher.order(Order { environment: id.number, kitchen, open: true });
            let begun = Instant::now();
            while !prefetcher.is_ready(id.number) {
                ensure!(begun.elapsed() < Duration::from_mins(5), "nobody opens kitchen {kitchen}");
                std::thread::sleep(Duration::from_millis(1));
            }
        }
        let Opened { kitchen, scenery } = change.open.on(|| prefetcher.take(id.number, kitchen))?;
        let mut environment = change.environment.on(|| Environment::new(kitchen, id, config))?;
        let bodies = environment.kitchen().bodies();
        let scenery = change.scenery.on(|| scenery.unwrap_or_else(|| Scenery::of(bodies)));
        for episode in 1..=EPISODES {
            change.episode.on(|| environment.start_episode(episode));
        }
        let before = here.replace((environment, scenery));
        change.leave.on(|| drop(before));
    }
    Ok(change)
}
