//! Episodes in pictures: one that weights from before a run's second stage and from after it both played, else the best of
//! a run's newest evaluation; simulated again from what evaluations recorded, and drawn by `actor show`.

use crate::output::format::{self, counted, shown as in_words};
use crate::preflight::programs;
use anyhow::{Context, Result, bail};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use proto::evaluation::EpisodeRecord;
use proto::replay::{RecordedEpisode, ReplaySetup};
use proto::run_folder::RunFolder;
use proto::show::{self, ShowAnswer, ShowOrbit, ShowRequest, ShowView};
use proto::task::{Column, Kind, Metric, Spec};
use recording::episode_index::EpisodeIndex;
use report::study::{Evaluated, EvaluatedPair, Run, pair_of};
use serde::Serialize;
use std::cmp::Reverse;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use view::scene_renderer::SceneRenderer;

const FRAMES: usize = 6;
const SIZE: (u32, u32) = (320, 240);
/// Runs that are shown at most: one tells as much as its other seeds.
const RUNS: usize = 3;
/// Episodes that are looked for in the recordings, those first that show most.
const TRIED: usize = 200;
const PATIENCE: Duration = Duration::from_mins(2);

const VIOLET: &str = "Violet: what is displaced, with a ghost where it stood; green box: the goal";
const GOAL: &str = "Green box: the goal";

#[derive(Debug, Serialize)]
pub struct ShownEpisode {
    /// Name and task of its run.
    run: String,
    task: String,
    caption: String,
    /// As weights from before a stage played it and those from after it, or as one policy did.
    strips: Vec<ShownStrip>,
}

#[derive(Debug, Serialize)]
struct ShownStrip {
    title: String,
    frames: Vec<Frame>,
}

#[derive(Debug, Serialize)]
struct Frame {
    png: String,
    words: Vec<String>,
}

/// One of each of these runs, and why others could not be drawn.
pub fn strips(runs: &[Run]) -> (Vec<ShownEpisode>, Vec<String>) {
    let recorded = |one: &Evaluated| RunFolder::new(&one.folder).recordings().is_dir();
    let shown = |run: &Run| {
        let newest = |one: &&Evaluated| (one.result.subject.frames, one.result.cost.at_unix_s);
        let alone = || run.evaluations.iter().filter(|one| recorded(one)).max_by_key(newest);
        let shown = match pair_of(run, runs, recorded) {
            Some(pair) => Some(both(&pair)),
            None => alone().map(|evaluated| best(run, evaluated)),
        };
        shown.map(|shown| (run.name.clone(), shown))
    };
    let (mut episodes, mut notes) = (Vec::new(), Vec::new());
    for (run, shown) in runs.iter().filter_map(shown).take(RUNS) {
        match shown {
            Ok(found) => episodes.push(found),
            Err(error) => notes.push(format!("{run}: no episode can be shown in pictures: {error:#}.")),
        }
    }
    (episodes, notes)
}

/// The best episode of an evaluation: of those in which most that ranks policies is so, the longest.
fn best(run: &Run, evaluated: &Evaluated) -> Result<ShownEpisode> {
    let (spec, recorded) = (run.config.spec(), Recorded::of(evaluated)?);
    let ranking: Vec<Column> = spec.ranking().iter().filter_map(|metric| spec.column(&metric.name)).collect();
    let score = |record: &EpisodeRecord| ranking.iter().filter(|&&column| record.has_all(&[column])).count();
    let mut records: Vec<&EpisodeRecord> = evaluated.episodes.iter().collect();
    records.sort_by_key(|record| Reverse((score(record), record.length)));
    let found = records.iter().take(TRIED).find_map(|&record| {
        let taken = recorded.take_out(record).transpose()?;
        Some(taken.map(|taken| (record, taken)))
    });
    let (record, taken) = found.context("its recordings hold no whole episode")??;
    let (frames, _, violet) = Actor::start()?.show("best", taken, None)?;
    Ok(ShownEpisode {
        run: run.name.clone(),
        task: run.config.task.clone(),
        caption: format!(
            "{}, seed {}: {}, the best of {}. {}",
            run.name,
            run.config.seed,
            called(record),
            counted(evaluated.episodes.len() as u64, "episode"),
            marks(record, violet)
        ),
        strips: vec![ShownStrip { title: ending(spec, record), frames }],
    })
}

fn called(record: &EpisodeRecord) -> String {
    let target = record.category.map_or_else(String::new, |category| format!(", target {}", category.name()));
    format!("kitchen {}, episode {}{target}", record.kitchen.number(), record.episode)
}

/// `violet`: whether anything in the pictures is.
fn marks(record: &EpisodeRecord, violet: bool) -> String {
    format!("{}{}.", if violet { VIOLET } else { GOAL }, record.category.map_or("", |_| "; pink ring: the target"))
}

fn both(pair: &EvaluatedPair<'_>) -> Result<ShownEpisode> {
    let episode_indexes = [Recorded::of(pair.before)?, Recorded::of(pair.after)?];
    let found = pair.episodes.iter().take(TRIED).find_map(|records| {
        let both = [episode_indexes[0].take_out(records[0]), episode_indexes[1].take_out(records[1])];
        match both {
            [Ok(Some(before)), Ok(Some(after))] => Some(Ok((records, [before, after]))),
            [Err(error), _] | [_, Err(error)] => Some(Err(error)),
            _ => None,
        }
    });
    let (records, recorded) = found.context("their recordings hold no episode that both played")??;
    let actor = Actor::start()?;
    let [before, after] = recorded;
    let (before, orbit, violet_before) = actor.show("before", before, None)?;
    // Both from one place, that what is compared is seen alike.
    let (after, _, violet_after) = actor.show("after", after, Some(orbit))?;
    let title = |when: &str, one: &Evaluated, record: &EpisodeRecord| {
        let spec = pair.run.config.spec();
        let (frames, end) = (format::count(one.result.subject.frames), ending(spec, record));
        format!("{when} stage {}, {frames} frames: {end}", pair.stage)
    };
    Ok(ShownEpisode {
        run: pair.run.name.clone(),
        task: pair.run.config.task.clone(),
        caption: format!(
            "{}, seed {}: {}, played by the weights from before stage {} and from after it. Of the {} that both played \
             it is the one that shows most: the best afterwards, and then the largest rise of the return under the \
             stage's reward. {}",
            pair.run.name,
            pair.run.config.seed,
            called(records[0]),
            pair.stage,
            counted(pair.episodes.len() as u64, "episode"),
            marks(records[0], violet_before || violet_after),
        ),
        strips: vec![
            ShownStrip { title: title("before", pair.before, records[0]), frames: before },
            ShownStrip { title: title("after", pair.after, records[1]), frames: after },
        ],
    })
}

/// How an episode ended: the most that ranks policies and is so, and the numbers that the task prints; of one that ended
/// as well as can be those that are not 0.
fn ending(spec: &Spec, record: &EpisodeRecord) -> String {
    let is = |name: &&str| spec.column(name).is_some_and(|column| record.has_all(&[column]));
    let ranking = spec.ranking();
    let best = ranking.iter().map(|metric| metric.name.as_str()).find(is);
    let is_best = best.is_some() && best == ranking.first().map(|metric| metric.name.as_str());
    let best = best.or((!ranking.is_empty()).then_some("failure")).map(|name| name.replace('_', " "));
    let printed = spec.columns().into_iter().zip(&record.numbers).filter(|(one, _)| !one.label.is_empty());
    let numbers = printed.filter_map(|(one, &number)| match (one.kind, number) {
        (Kind::Share, _) | (_, None) => None,
        (_, Some(number)) if is_best && number < 0.0005 => None,
        (Kind::Count, Some(count)) => Some(format!("{} {count}", one.label)),
        (_, Some(_)) => Some(format!("{} {} {}", one.label, in_words(&one, number), one.unit).trim_end().to_owned()),
    });
    best.into_iter().chain(numbers).collect::<Vec<_>>().join(", ")
}

struct Recorded {
    episode_index: EpisodeIndex,
    folder: String,
}

impl Recorded {
    fn of(evaluated: &Evaluated) -> Result<Self> {
        let folder = std::path::absolute(&evaluated.folder)?;
        let text = folder.to_str().context("the evaluation's folder has a name that is not text")?.to_owned();
        let mut episode_index = EpisodeIndex::of(RunFolder::new(folder));
        episode_index.advance(PATIENCE);
        Ok(Self { episode_index, folder: text })
    }

    fn take_out(&self, record: &EpisodeRecord) -> Result<Option<(ReplaySetup, RecordedEpisode)>> {
        let mut playable = self.episode_index.episodes().filter(|(_, shelved)| shelved.is_playable());
        let wanted = |(kitchen, fixed)| (kitchen, fixed) == (record.kitchen.number(), Some(record.episode));
        let found = playable.find(|((kitchen, _, _), shelved)| wanted((*kitchen, shelved.fixed)));
        let Some((key, _)) = found else { return Ok(None) };
        let setup = |config| ReplaySetup { config, folder: Some(self.folder.clone()), images: None };
        Ok(self.episode_index.take_out(key)?.map(|(config, episode)| (setup(config), episode)))
    }
}

struct Actor {
    runtime: Runtime,
    scene_renderer: SceneRenderer,
}

impl Actor {
    fn start() -> Result<Self> {
        let runtime = Builder::new_current_thread().enable_all().build().context("cannot wait for `actor show`")?;
        let scene_renderer = runtime.block_on(async { anyhow::Ok(SceneRenderer::new(programs::find("actor")?)) })?;
        Ok(Self { runtime, scene_renderer })
    }

    /// Its pictures, the camera, and whether anything in them is displaced.
    fn show(
        &self,
        name: &str,
        (setup, episode): (ReplaySetup, RecordedEpisode),
        orbit: Option<ShowOrbit>,
    ) -> Result<(Vec<Frame>, ShowOrbit, bool)> {
        let (answer, _) = self.ask(ShowRequest::Open { name: name.to_owned(), setup, episode: Box::new(episode) })?;
        let ShowAnswer::Opened(shown) = answer else { bail!("an episode cannot be simulated again: {}", why(&answer)) };
        if let Some(difference) = &shown.first_difference {
            bail!("an episode simulated again differs from its recording from step {} on", difference.step);
        }
        let orbit = orbit.unwrap_or(shown.orbit);
        let frames = steps(shown.moments.len()).map(|step| {
            let request = ShowRequest::Draw {
                name: name.to_owned(),
                step: step as u32,
                view: ShowView::Orbit(orbit),
                width: SIZE.0,
                height: SIZE.1,
                fine: true,
                dark: false,
            };
            let (answer, png) = self.ask(request)?;
            match answer {
                ShowAnswer::Picture { .. } => {
                    let png = format!("data:image/png;base64,{}", BASE64_STANDARD.encode(png));
                    Ok(Frame { png, words: words(&shown, step) })
                }
                answer => bail!("a picture cannot be drawn: {}", why(&answer)),
            }
        });
        let violet = steps(shown.moments.len()).any(|step| !shown.moments[step].moved.is_empty());
        Ok((frames.collect::<Result<_>>()?, orbit, violet))
    }

    fn ask(&self, request: ShowRequest) -> Result<(ShowAnswer, Vec<u8>)> {
        Ok(self.runtime.block_on(self.scene_renderer.ask(request))?)
    }
}

fn why(answer: &ShowAnswer) -> &str {
    match answer {
        ShowAnswer::Failed { problem } => problem,
        ShowAnswer::Opened(_) | ShowAnswer::Picture { .. } | ShowAnswer::NotOpen => "another answer than was asked for",
    }
}

fn steps(moments: usize) -> impl Iterator<Item = usize> {
    let last = moments.saturating_sub(1);
    let wanted = FRAMES.min(moments).max(1);
    (0..wanted).map(move |number| (number * last + (wanted - 1) / 2) / (wanted - 1).max(1))
}

fn words(shown: &show::ShownEpisode, step: usize) -> Vec<String> {
    let last = shown.moments.len() - 1;
    let printed = shown.task.metrics.iter().filter(|metric| metric.curve && !metric.label.is_empty());
    let values = printed.filter_map(|Metric { label, unit, value, .. }| {
        let [number] = shown.moments[step].numbers(value.as_deref()?)?;
        Some(format!("{label} {number:.3} {unit}").trim_end().to_owned())
    });
    std::iter::once(format!("step {step} of {last}")).chain(values).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_and_the_last_moment_are_drawn_and_none_twice() {
        let of = |moments: usize| steps(moments).collect::<Vec<_>>();
        assert_eq!(of(1), [0]);
        assert_eq!(of(2), [0, 1]);
        assert_eq!(of(6), [0, 1, 2, 3, 4, 5]);
        for moments in 2..300 {
            let found = of(moments);
            assert!(found.is_sorted_by(|a, b| a < b), "{moments}: {found:?}");
            assert_eq!((found[0], found.last().copied()), (0, Some(moments - 1)));
        }
    }
}
