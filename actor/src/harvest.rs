//! `actor dataset`: recorded episodes, simulated again and written as a data set.
//!
//! Input and output are the lines of [`proto::dataset`]. Threads simulate episodes; one after the other, in the order of
//! the input, they are written. No thread is more than a few episodes ahead of the writer, so that memory is bounded.
//! Nothing is written of a recording that the simulator does not give as it was recorded.

use crate::replay::film::Outcome;
use crate::replay::{Rewards, Theatre};
use anyhow::{Context, Result, anyhow, ensure};
use dataset::{About, Episode, Frames, Seen, Source, Step, Writer};
use picture::{Moment, Scene, Standpoint, Task};
use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::dataset::{DatasetAnswer, DatasetRequest, DatasetSetup, Keep, PictureKind};
use proto::replay::ReplayVerdict;
use simulator::depth::DepthCamera;
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::Transition;
use std::collections::BTreeMap;
use std::io::{BufRead, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Widest picture, pixels.
const SIDE_MAX: u32 = 1024;
/// How many episodes each thread may be ahead.
const AHEAD_EACH: usize = 2;

/// Reads a setup and episodes from `input` until it ends, writes the data set, and answers on `output`.
pub fn run(input: impl BufRead + Send, mut output: impl Write) -> Result<()> {
    let mut lines = input.lines();
    let first = lines.next().context("the input is empty: its first line is the setup")??;
    let setup: DatasetSetup = serde_json::from_str(&first).context("the first line is not a setup")?;
    ensure!((8..=SIDE_MAX).contains(&setup.side_px), "pictures have 8 to {SIDE_MAX} pixels, not {}", setup.side_px);
    let configs = setup.configs.iter().map(|config| Config::from_toml(config, "a configuration of the recordings"));
    let configs = configs.collect::<Result<Vec<_>, _>>()?;
    let actions = actions_of(&configs)?;
    let source =
        Source { actions: actions.iter().map(|action| action.name()).collect(), configs: setup.configs.clone() };
    let mut writer = Writer::create(Path::new(&setup.out), source)?;
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let work = Work {
        configs: &configs,
        setup: &setup,
        actions,
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

/// The actions by their numbers, which must be the same in all configurations.
fn actions_of(configs: &[Config]) -> Result<Vec<Action>> {
    let first = configs.first().context("there is no configuration")?;
    ensure!(
        configs.iter().all(|config| config.episode.action_space == first.episode.action_space),
        "the recordings have different action spaces: export them one by one"
    );
    Ok(first.policy_actions().into_iter().filter_map(Action::from_index).collect())
}

/// An episode that was simulated.
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
    /// The writer takes no more.
    closed: bool,
}

type Lines<'a> = Box<dyn Iterator<Item = std::io::Result<String>> + Send + 'a>;

struct Work<'a> {
    configs: &'a [Config],
    setup: &'a DatasetSetup,
    actions: Vec<Action>,
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
        let mut theatres: BTreeMap<usize, Theatre> = BTreeMap::new();
        while let Some((number, line)) = self.take() {
            let told = line.and_then(|line| {
                let parsed = serde_json::from_str(&line).with_context(|| format!("line {} is no episode", number + 2));
                let parsed = parsed?;
                // The writer waits for this episode, also if the physics panic in it.
                catch_unwind(AssertUnwindSafe(|| self.tell(&mut theatres, &parsed)))
                    .unwrap_or_else(|_| Err(anyhow!("the simulation of line {} failed", number + 2)))
            });
            self.board().done.insert(number, told);
            self.changed.notify_all();
        }
    }

    fn tell(&self, theatres: &mut BTreeMap<usize, Theatre>, request: &DatasetRequest) -> Result<Told> {
        let recorded = &request.recorded;
        let config = self.configs.get(request.config).context("an episode has a configuration that is not there")?;
        let folder = || PathBuf::from(self.setup.folder.clone().unwrap_or_default());
        let theatre = theatres.entry(request.config).or_insert_with(|| Theatre::new(config, folder()));
        let mut stage = theatre.open(recorded)?;
        let mut telling = Telling::new(self, config);
        let verdict = stage.play(recorded, config, |environment, camera, transition| {
            telling.moment(environment, camera, transition)
        })?;
        let last = telling.steps.last().map(|step| &step.transition);
        let outcome = Outcome::of(last, stage.environment.end());
        let unfinished = outcome == Outcome::Unfinished;
        let wanted = match self.setup.keep {
            Keep::Ended => !unfinished,
            Keep::Successes => matches!(outcome, Outcome::Success | Outcome::SuccessWithoutDisturbance),
            Keep::Undisturbed => outcome == Outcome::SuccessWithoutDisturbance,
        };
        if !wanted || verdict.first_difference.is_some() {
            return Ok(Told { verdict, unfinished, episode: None });
        }
        let about = About {
            kitchen: recorded.environment.kitchen.number(),
            environment: recorded.environment.number,
            number: recorded.episode,
            fixed: stage.fixed,
            target: stage.environment.episode().category.name(),
            outcome: outcome.word(),
            seed: config.seed,
        };
        let episode = telling.finish(about, stage.environment);
        Ok(Told { verdict, unfinished, episode: Some(episode) })
    }
}

/// An episode while it is simulated.
struct Telling<'a> {
    rewards: Rewards,
    setup: &'a DatasetSetup,
    actions: Vec<Action>,
    seen: Vec<Seen>,
    steps: Vec<Step>,
    depth: Frames,
    /// For pictures; else none.
    moments: Vec<Moment>,
}

impl<'a> Telling<'a> {
    fn new(work: &Work<'a>, config: &'a Config) -> Self {
        let depth = Frames { name: "depth", side: FRAME_SIDE, is_depth: true, frames: Vec::new() };
        let (actions, setup) = (work.actions.clone(), work.setup);
        Self {
            rewards: Rewards::of(config),
            setup,
            actions,
            seen: Vec::new(),
            steps: Vec::new(),
            depth,
            moments: Vec::new(),
        }
    }

    fn moment(
        &mut self,
        environment: &mut Environment,
        camera: &mut DepthCamera,
        transition: Option<Transition>,
    ) -> Result<()> {
        if let Some(transition) = transition {
            let action = environment.previous_action().context("an action led here")?;
            let action = self.number(action)?;
            let (end, rewards) = (environment.end(), self.rewards.of_step(&transition));
            self.steps.push(Step { action, transition, end, rewards });
        }
        let current = environment.current();
        let none = self.actions.len() as u32;
        let previous_action = environment.previous_action().map_or(Ok(none), |action| self.number(action))?;
        self.seen.push(Seen { goal_m: current.goal_m, previous_action, state_hash: environment.state_hash() });
        let mut depth_mm = vec![0; FRAME_SIDE * FRAME_SIDE];
        environment.look(camera, FRAME_SIDE, &mut depth_mm);
        self.depth.frames.push(depth_mm.into_iter().flat_map(u16::to_le_bytes).collect());
        if !self.setup.pictures.is_empty() {
            self.moments.push(Moment::of(environment, transition.as_ref()));
        }
        Ok(())
    }

    /// Number of an action among those of the run.
    fn number(&self, action: Action) -> Result<u32> {
        let number = self.actions.iter().position(|&own| own == action);
        number.map(|number| number as u32).ok_or_else(|| anyhow!("action {} is none of the run's", action.name()))
    }

    fn finish(self, about: About, environment: &Environment) -> Episode {
        let mut cameras = vec![self.depth];
        if let Some(first) = self.moments.first() {
            let (kitchen, episode) = (environment.kitchen(), environment.episode());
            let target = kitchen.target_movable(episode.category);
            let task = Task { target, goal: episode.goal, title: String::new() };
            let scene = Scene::new(Arc::clone(kitchen), task, first);
            let side = self.setup.side_px as usize;
            for &kind in &self.setup.pictures {
                let from = match kind {
                    PictureKind::Robot => Standpoint::Robot,
                    PictureKind::Outside => Standpoint::Outside(scene.best(&self.moments)),
                };
                let photograph = |moment| scene.photograph(moment, &from, side).pixels.into_flattened();
                let frames = self.moments.iter().map(photograph).collect();
                cameras.push(Frames { name: kind.name(), side, is_depth: false, frames });
            }
        }
        Episode { about, seen: self.seen, steps: self.steps, cameras }
    }
}
