//! `actor dataset`: recorded episodes, simulated again and written as a data set.
//!
//! Input and output are the lines of [`proto::dataset`]. Threads simulate episodes; one after the other, in the order of
//! the input, they are written. No thread is more than a few episodes ahead of the writer, so that memory is bounded.
//! Nothing is written of a recording that the simulator does not give as it was recorded.

use crate::replay::film;
use crate::replay::{Player, Started};
use anyhow::{Context, Result, anyhow, bail, ensure};
use dataset::{About, Episode, Frames, Moment, Source, Writer};
use picture::{Captions, Scene, Standpoint};
use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::dataset::{DatasetAnswer, DatasetRequest, DatasetSetup, PictureKind};
use proto::replay::{Performance, ReplayVerdict, Rules, Seen, play};
use proto::task::{Channel, Described, Field, UNFINISHED};
use simulator::depth::DepthCamera;
use simulator::environment::{Base, Environment};
use std::collections::BTreeMap;
use std::io::{BufRead, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

const SIDE_MAX: u32 = 1024;
/// How many episodes each thread may be ahead.
const AHEAD_EACH: usize = 2;

/// Reads a setup and episodes from `input` until it ends, writes the data set, and answers on `output`.
pub fn run(input: impl BufRead + Send, mut output: impl Write) -> Result<()> {
    let mut lines = input.lines();
    // The process that wanted the episodes has ended before it said which.
    let Some(first) = lines.next() else { return Ok(()) };
    let first = first.context("cannot read the setup")?;
    let setup: DatasetSetup = serde_json::from_str(&first).context("the first line is not a setup")?;
    ensure!((8..=SIDE_MAX).contains(&setup.side_px), "pictures have 8 to {SIDE_MAX} pixels, not {}", setup.side_px);
    let configs = setup.configs.iter().map(|config| Config::from_toml(config, "a configuration of the recordings"));
    let configs = configs.collect::<Result<Vec<_>, _>>()?;
    let rules = configs.iter().map(Rules::of).collect::<Result<Vec<_>, _>>()?;
    let source = source_of(&configs, &rules, &setup)?;
    let numbers = source.numbers.clone();
    if let Some(metric) = &setup.keep {
        let shares = source.spec.columns().into_iter().filter(Described::is_share);
        let names: Vec<String> = shares.map(|metric| metric.name).collect();
        let has = names.contains(metric);
        ensure!(has, "--only {metric}: task `{}` has {}", source.spec.name, names.join(", "));
    }
    let mut writer = Writer::create(Path::new(&setup.out), source)?;
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let work = Work {
        configs: &configs,
        rules: &rules,
        setup: &setup,
        numbers,
        lines: Mutex::new((0, Box::new(lines))),
        board: Mutex::new(Board::default()),
        changed: Condvar::new(),
        ahead: threads * AHEAD_EACH,
    };
    let mut kept = 0;
    let all = thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| work.simulate());
        }
        let outcome = write_all(&work, &mut writer, &mut kept, &mut output);
        // Whatever happened, nobody shall wait for more.
        work.board().closed = true;
        work.changed.notify_all();
        outcome
    })?;
    if !all {
        return Ok(());
    }
    let answer = if kept == 0 {
        DatasetAnswer::Nothing
    } else {
        let dataset::Size { episodes, steps, bytes } = writer.finish()?;
        DatasetAnswer::Written { episodes, steps, bytes }
    };
    say(&mut output, &answer)
}

/// Takes episodes in their order until there are no more, or enough; whether all agreed with the recording.
fn write_all(work: &Work, writer: &mut Writer, kept: &mut u64, output: &mut impl Write) -> Result<bool> {
    let limit = work.setup.limit.unwrap_or(u64::MAX);
    while *kept < limit {
        let Some(told) = work.next()? else {
            let (came, said) = (work.board().next as u64, work.setup.episodes);
            ensure!(came == said, "the input ended after {came} of {said} episodes");
            break;
        };
        let is_kept = told.verdict.first_difference.is_none() && told.episode.is_some();
        let differs = told.verdict.first_difference.is_some();
        if let Some(episode) = told.episode.filter(|_| is_kept) {
            writer.add(&episode)?;
            *kept += 1;
        }
        let (verdict, unfinished) = (told.verdict, told.unfinished);
        say(output, &DatasetAnswer::Simulated { verdict, kept: is_kept, unfinished })?;
        if differs {
            return Ok(false);
        }
    }
    Ok(true)
}

fn say(output: &mut impl Write, answer: &DatasetAnswer) -> Result<()> {
    serde_json::to_writer(&mut *output, answer).context("cannot write an answer")?;
    output.write_all(b"\n").and_then(|()| output.flush()).context("cannot write an answer")
}

/// What the data set is of: one task, and the same actions in all configurations.
fn source_of(configs: &[Config], rules: &[Rules], setup: &DatasetSetup) -> Result<Source> {
    let (config, rules_of_first) = configs.first().zip(rules.first()).context("there is no configuration")?;
    let (space, spec) = (config.episode.action_space, rules_of_first.spec);
    ensure!(
        configs.iter().all(|config| config.episode.action_space == space && config.task == spec.name),
        "the recordings have different tasks or action spaces: export them one by one"
    );
    let actions = config.policy_actions().into_iter().map(|action| spec.actions.names()[usize::from(action)].clone());
    let actions: Vec<String> = actions.collect();
    let number = |name: &String| actions.iter().position(|own| own == name).map(|number| number as u32);
    let numbers = spec.actions.names().iter().map(number).collect();
    ensure!(
        configs.iter().all(|other| other.rewards == config.rewards),
        "the recordings' configurations have different [[rewards]]: export them one by one"
    );
    // The task's last one stays last: tools take it for the reward.
    let own = rules_of_first.own_rewards.iter().map(|(name, _)| name.clone());
    let rewards = own.chain(rules_of_first.compared.rewards().map(str::to_owned)).collect();
    Ok(Source { spec, actions, numbers, rewards, configs: setup.configs.clone() })
}

struct Told {
    verdict: ReplayVerdict,
    unfinished: bool,
    /// If it is to be kept.
    episode: Option<Episode>,
}

/// What threads leave for the writer.
#[derive(Default)]
struct Board {
    done: BTreeMap<usize, Result<Told>>,
    /// Number of the episode that is written next.
    next: usize,
    /// How many there are, once the input has ended.
    count: Option<usize>,
    closed: bool,
}

type Lines<'a> = Box<dyn Iterator<Item = std::io::Result<String>> + Send + 'a>;

struct Work<'a> {
    configs: &'a [Config],
    rules: &'a [Rules],
    setup: &'a DatasetSetup,
    /// For each of the task's actions its number among the run's.
    numbers: Vec<Option<u32>>,
    /// Number of the next line.
    lines: Mutex<(usize, Lines<'a>)>,
    board: Mutex<Board>,
    changed: Condvar,
    ahead: usize,
}

impl Work<'_> {
    fn board(&self) -> MutexGuard<'_, Board> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'b>(&self, board: MutexGuard<'b, Board>) -> MutexGuard<'b, Board> {
        self.changed.wait(board).unwrap_or_else(PoisonError::into_inner)
    }

    /// The next episode in the order of the input; none after the last.
    fn next(&self) -> Result<Option<Told>> {
        let mut board = self.board();
        loop {
            let next = board.next;
            if let Some(told) = board.done.remove(&next) {
                board.next += 1;
                self.changed.notify_all();
                return told.map(Some);
            }
            if board.count.is_some_and(|count| next >= count) {
                return Ok(None);
            }
            board = self.wait(board);
        }
    }

    /// The next line of the input and its number, when the writer is near enough.
    fn take(&self) -> Option<(usize, Result<String>)> {
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        let number = lines.0;
        let mut board = self.board();
        while !board.closed && number >= board.next + self.ahead {
            board = self.wait(board);
        }
        if board.closed {
            return None;
        }
        drop(board);
        let Some(line) = lines.1.next() else {
            self.board().count = Some(number);
            self.changed.notify_all();
            return None;
        };
        lines.0 += 1;
        Some((number, line.context("cannot read an episode")))
    }

    /// A thread: simulates episodes until there are no more.
    fn simulate(&self) {
        let mut players: BTreeMap<usize, Player> = BTreeMap::new();
        while let Some((number, line)) = self.take() {
            let told = line.and_then(|line| {
                let parsed = serde_json::from_str(&line).with_context(|| format!("line {} is no episode", number + 2));
                let parsed = parsed?;
                // The writer waits for this episode, also if the physics panic in it.
                catch_unwind(AssertUnwindSafe(|| self.tell(&mut players, &parsed)))
                    .unwrap_or_else(|_| Err(anyhow!("the simulation of line {} failed", number + 2)))
            });
            self.board().done.insert(number, told);
            self.changed.notify_all();
        }
    }

    fn tell(&self, players: &mut BTreeMap<usize, Player>, request: &DatasetRequest) -> Result<Told> {
        let recorded = &request.recorded;
        let config = self.configs.get(request.config).context("an episode has a configuration that is not there")?;
        let folder = || PathBuf::from(self.setup.folder.clone().unwrap_or_default());
        let player = players.entry(request.config).or_insert_with(|| Player::new(config.clone(), folder()));
        let Started { environment, camera, fixed } = player.open(recorded)?;
        let rules = &self.rules[request.config];
        let mut telling = Telling::new(self, rules);
        let Performance { verdict, outcome, metrics } =
            play(rules, environment, recorded, |environment, seen| telling.moment(environment, camera, seen))?;
        let unfinished = outcome == UNFINISHED;
        let holds = |name: &String| {
            let mut named = rules.spec.metrics.iter().zip(&metrics).filter(|(metric, _)| metric.name == *name);
            named.any(|(_, number)| *number == Some(1.0))
        };
        let wanted = !unfinished && self.setup.keep.as_ref().is_none_or(holds);
        if !wanted || verdict.first_difference.is_some() {
            return Ok(Told { verdict, unfinished, episode: None });
        }
        let about = About {
            kitchen: recorded.environment.kitchen.number(),
            environment: recorded.environment.number,
            number: recorded.episode,
            fixed,
            outcome,
            metrics: metrics.into_iter().map(|number| number.unwrap_or(f64::NAN)).collect(),
            seed: config.seed,
        };
        let episode = telling.finish(about, environment.base());
        Ok(Told { verdict, unfinished, episode: Some(episode) })
    }
}

struct Telling<'a> {
    rules: &'a Rules,
    setup: &'a DatasetSetup,
    numbers: &'a [Option<u32>],
    moments: Vec<Moment>,
    /// The task's image, if it has one of depth.
    depth: Option<Frames>,
    /// For pictures; else none.
    drawn: Vec<picture::Moment>,
}

impl<'a> Telling<'a> {
    fn new(work: &'a Work, rules: &'a Rules) -> Self {
        let depth = rules.spec.channels.iter().find(|channel| channel.is_bulk() && channel.unit == "mm");
        let frames = |channel: &Channel| {
            let name = channel.bare_name().to_owned();
            Frames { name, side: FRAME_SIDE, is_depth: true, frames: Vec::new() }
        };
        let (numbers, setup) = (work.numbers.as_slice(), work.setup);
        Self { rules, setup, numbers, moments: Vec::new(), depth: depth.map(frames), drawn: Vec::new() }
    }

    fn moment(&mut self, environment: &mut dyn Environment, camera: &mut DepthCamera, seen: &Seen) -> Result<()> {
        let environment = environment.base_mut();
        let layout = self.rules.spec.layout();
        let mut record = seen.record.to_vec();
        if seen.rewards.is_some() {
            self.check(layout.action, &record)?;
            // It is the one before what is seen now.
            record.copy_within(layout.action.range(), layout.previous_action.offset);
        }
        let own = self.rules.own_rewards.iter();
        let own = own.map(|(_, reward)| reward.of(|index| layout.part(seen.record, index), 0.0));
        let rewards = seen.rewards.map_or_else(Vec::new, |rewards| own.chain(rewards.iter().copied()).collect());
        let (state_hash, end) = (environment.state_hash(), environment.end());
        self.moments.push(Moment { record, state_hash, rewards, end });
        if let Some(depth) = &mut self.depth {
            let mut depth_mm = vec![0; FRAME_SIDE * FRAME_SIDE];
            environment.look(camera, FRAME_SIDE, &mut depth_mm);
            depth.frames.push(depth_mm.into_iter().flat_map(u16::to_le_bytes).collect());
        }
        if !self.setup.pictures.is_empty() {
            self.drawn.push(film::moment(environment, Captions::default()));
        }
        Ok(())
    }

    /// An action is one of the run's.
    fn check(&self, action: Field, record: &[u8]) -> Result<()> {
        let number = action.number(record) as usize;
        if self.numbers.get(number).is_some_and(Option::is_none) {
            bail!("action {} is none of the run's", self.rules.spec.actions.names()[number]);
        }
        Ok(())
    }

    fn finish(self, about: About, environment: &Base) -> Episode {
        let mut cameras: Vec<Frames> = self.depth.into_iter().collect();
        if let Some(last) = self.moments.last().filter(|_| !self.drawn.is_empty()) {
            let task = picture::task(self.rules.spec, environment, &last.record, String::new());
            let scene = Scene::new(Arc::clone(environment.kitchen()), task, &self.drawn);
            let side = self.setup.side_px as usize;
            for &kind in &self.setup.pictures {
                let from = match kind {
                    PictureKind::Robot => Standpoint::Robot,
                    PictureKind::Outside => Standpoint::Outside(scene.best(&self.drawn, 1.0)),
                };
                let photograph = |moment| scene.photograph(moment, &from, side).pixels.into_flattened();
                let frames = self.drawn.iter().map(photograph).collect();
                cameras.push(Frames { name: kind.name().to_owned(), side, is_depth: false, frames });
            }
        }
        Episode { about, moments: self.moments, cameras }
    }
}
