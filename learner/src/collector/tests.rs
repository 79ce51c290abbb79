//! The collector against simulated actors, with crashes of both at every point.

#[path = "../../tests/support/environment.rs"]
mod environment;
mod fake_actor;
mod figures;
mod refusals;
mod taker;

use super::*;
use crate::record::named;
use environment::mix;
use fake_actor::FakeActor;
use proptest::prelude::*;
use proto::camera::FRAME_PIXELS;
use proto::config::Config;
use std::collections::{BTreeMap, VecDeque};
use taker::Taker;
use wire::message::Line;

const SEED: u64 = 5;
const MAX_STEPS: u32 = 7;
const POLICY_ACTIONS: usize = 21;
static FRAME: [u16; FRAME_PIXELS] = [0; FRAME_PIXELS];

#[derive(Debug, Clone)]
struct FakeSample(Vec<Vec<Line>>);

impl HalfSample for FakeSample {
    fn len(&self) -> usize {
        self.0.len()
    }
    fn record(&self, i: usize) -> &[u8] {
        Line::bytes(&self.0[i])
    }
    fn has_frame(&self, i: usize) -> bool {
        self.header(i).bulk != 0
    }
    fn frame(&self, _i: usize) -> Option<DepthFrame<'_>> {
        Some(DepthFrame::Whole(&FRAME))
    }
    fn images(&self, _i: usize, _row: &mut Vec<u8>) {}
}

impl FakeSample {
    /// The header of its first record.
    fn header_mut(&mut self) -> &mut RecordHeader {
        RecordHeader::of_mut(Line::bytes_mut(&mut self.0[0]))
    }

    /// Numbers of a channel of its first record.
    fn reals(&mut self, name: &str) -> &mut [f32] {
        named(Config::default().spec(), name).of_mut(Line::bytes_mut(&mut self.0[0]))
    }

    /// The same of a channel of whole numbers.
    fn wholes(&mut self, name: &str) -> &mut [u32] {
        named(Config::default().spec(), name).of_mut(Line::bytes_mut(&mut self.0[0]))
    }
}

type Message = (ObservationHeader, FakeSample);

/// What a run leaves: for each rollout everything that training would see.
#[derive(Debug, Clone, PartialEq, Default)]
struct Record {
    rollouts: Vec<RolloutRecord>,
}

#[derive(Debug, Clone, PartialEq)]
struct RolloutRecord {
    shape: RolloutShape,
    /// (t, column, action, noise and observation) for each action that counts.
    actions: Vec<(usize, usize, u8, u64)>,
    outcomes: Vec<(usize, usize, u32, bool, bool, bool)>,
    metrics: Vec<(String, u64)>,
    bootstrap: Vec<(usize, u64)>,
}

/// The learner's memory that a checkpoint holds: stands for weights and beliefs.
#[derive(Debug, Clone)]
struct Brain {
    weights: u64,
    beliefs: Vec<u64>,
}

#[derive(Debug, Clone)]
struct Checkpoint {
    boundary: Boundary,
    brain: Brain,
    frames: u64,
    rollout: usize,
}

#[derive(Debug, Clone, Copy)]
struct Run {
    column_map: ColumnMap,
    rollout_steps: usize,
    /// Rollouts are cut after this many steps.
    cut: Option<usize>,
    budget: u64,
    recorded: bool,
    /// Of rollouts with even and with odd numbers.
    paces: [Pace; 2],
}

impl Run {
    fn settings(self, learner_incarnation: u32) -> Settings {
        let Self { column_map, recorded, .. } = self;
        Settings { recorded, ..settings(column_map, learner_incarnation) }
    }

    /// The same, in lockstep and without a recorder.
    fn plain(self) -> Self {
        Self { paces: [Pace::Lockstep; 2], recorded: false, ..self }
    }
}

/// A fault of the schedule, at the n-th turn of the world.
#[derive(Debug, Clone, Copy)]
enum Fault {
    Actor(u32),
    Learner,
}

struct World {
    run: Run,
    actors: Vec<FakeActor>,
    to_learner: VecDeque<Message>,
    recorder: Taker,
    learner_incarnation: u32,
    record: Record,
    checkpoints: Vec<Checkpoint>,
    brain: Brain,
    frames: u64,
    collector: Collector<FakeSample>,
    in_progress: Option<RolloutRecord>,
    before: Brain,
}

impl World {
    fn new(run: Run) -> Self {
        let columns = run.column_map.columns();
        let brain = Brain { weights: 1, beliefs: vec![0; columns] };
        let boundary = Boundary::start(columns);
        let first = Checkpoint { boundary: boundary.clone(), brain: brain.clone(), frames: 0, rollout: 0 };
        let mut world = Self {
            run,
            actors: (0..run.column_map.actors()).map(|actor| FakeActor::new(actor, 1)).collect(),
            to_learner: VecDeque::new(),
            recorder: Taker::default(),
            learner_incarnation: 1,
            record: Record::default(),
            checkpoints: vec![first],
            before: brain.clone(),
            brain,
            frames: 0,
            collector: collector(run.settings(1), boundary),
            in_progress: None,
        };
        for actor in 0..run.column_map.actors() as usize {
            world.to_learner.push_back(world.actors[actor].hello());
        }
        world.broadcast();
        world
    }

    fn broadcast(&mut self) {
        for actor in 0..self.run.column_map.actors() {
            self.actors[actor as usize].restore = Some(self.collector.restore(actor, 0));
        }
    }

    /// The actor dies. What it had sent stays readable to the learner, not to the recorder; what was on its way to it is
    /// lost.
    fn kill_actor(&mut self, actor: u32) {
        self.recorder.lose(actor);
        let slot = &mut self.actors[actor as usize];
        *slot = FakeActor::new(actor, slot.incarnation + 1);
        let hello = slot.hello();
        self.to_learner.push_back(hello);
    }

    /// The learner dies and comes back from one of its newest two checkpoints.
    fn kill_learner(&mut self, back: usize) {
        let keep = self.checkpoints.len() - back.min(self.checkpoints.len() - 1);
        self.checkpoints.truncate(keep);
        let Checkpoint { boundary, brain, frames, rollout } = self.checkpoints[keep - 1].clone();
        self.learner_incarnation += 1;
        self.record.rollouts.truncate(rollout);
        self.brain = brain;
        self.frames = frames;
        self.in_progress = None;
        // Its subscriber dies with it.
        self.to_learner.clear();
        self.collector = collector(self.run.settings(self.learner_incarnation), boundary);
        self.broadcast();
        // Actors that have no restore yet keep crying.
        for actor in &self.actors {
            if actor.following.is_none() {
                self.to_learner.push_back(actor.hello());
            }
        }
    }

    /// One turn of the learner, as the process makes it. False when it waits.
    fn learner_turn(&mut self) -> bool {
        let column_map = self.run.column_map;
        let mut heard = false;
        while let Some((header, sample)) = self.to_learner.pop_front() {
            heard = true;
            if let Received::Hello { actor, actor_incarnation } = self.collector.receive(&header, sample).unwrap() {
                self.actors[actor as usize].restore = Some(self.collector.restore(actor, actor_incarnation));
            }
        }
        if self.in_progress.is_none() {
            if self.frames == self.run.budget {
                return heard;
            }
            let shape = RolloutShape::next(self.run.budget - self.frames, self.run.rollout_steps, column_map.columns());
            self.before = self.brain.clone();
            let reward = reward("r_prime");
            let number = self.record.rollouts.len();
            self.collector.go_at(self.run.paces[number % 2]);
            self.collector.begin(shape, reward, 1 + number as u64);
            self.in_progress =
                Some(RolloutRecord { shape, actions: vec![], outcomes: vec![], metrics: vec![], bootstrap: vec![] });
        }
        self.cut_if_due();
        match self.collector.task() {
            Task::Await => return heard,
            Task::Act(lanes) if !self.collector.unrecorded(&lanes).actors.is_empty() => {
                // As the process does, which acts meanwhile.
                self.settle(&lanes);
                return heard;
            }
            Task::Act(lanes) => {
                self.settle(&lanes);
                let record = self.in_progress.as_mut().unwrap();
                let batch = self.collector.batch(&lanes);
                assert!(batch.columns.is_sorted_by(|a, b| a < b));
                assert!(batch.columns.len() <= column_map.half(0).len() * column_map.actors() as usize);
                let mut actions = vec![];
                for (i, (&column, &t)) in batch.columns.iter().zip(&batch.at).enumerate() {
                    let (seen, belief) = look(&batch, i, self.brain.beliefs[column]);
                    let action = (mix([self.brain.weights, belief]) % POLICY_ACTIONS as u64) as u8;
                    actions.push(action);
                    if t == record.shape.steps {
                        record.bootstrap.push((column, belief));
                    } else if t + 1 < record.shape.steps || column < record.shape.environments_in_last_step {
                        self.brain.beliefs[column] = belief;
                        record.actions.push((t, column, action, seen));
                    }
                }
                for batch in self.collector.answer(&lanes, &actions) {
                    self.actors[batch.actor as usize].actions.push_back(batch);
                }
            }
            Task::Finish => {
                let mut record = self.in_progress.take().unwrap();
                // Who comes first may be first.
                record.actions.sort_unstable();
                record.outcomes.sort_unstable();
                record.bootstrap.sort_unstable();
                let metrics = self.collector.finish()[0].metrics();
                record.metrics = metrics.into_iter().map(|(name, value)| (name, value.to_bits())).collect();
                self.frames += record.shape.frames;
                let seen = record.outcomes.iter().map(|outcome| u64::from(outcome.2) ^ outcome.0 as u64);
                self.brain.weights = mix(seen.chain([self.brain.weights]));
                self.record.rollouts.push(record);
                self.checkpoints.push(Checkpoint {
                    boundary: self.collector.boundary(),
                    brain: self.brain.clone(),
                    frames: self.frames,
                    rollout: self.record.rollouts.len(),
                });
            }
        }
        true
    }

    fn cut_if_due(&mut self) {
        let Some([steps, planned]) = self.collector.between_steps() else { return };
        let record = self.in_progress.as_mut().unwrap();
        assert_eq!(planned, record.shape.steps);
        if self.run.cut == Some(steps) {
            self.collector.cut();
            record.shape = RolloutShape::next(u64::MAX, steps, self.run.column_map.columns());
        }
    }

    fn settle(&mut self, lanes: &[Lane]) {
        let record = self.in_progress.as_mut().unwrap();
        for Settled { t, column, outcome, .. } in self.collector.settle(lanes) {
            let Outcome { reward, ended, time_limit, label, .. } = outcome;
            record.outcomes.push((t, column, reward.to_bits(), ended, time_limit, label));
        }
    }

    /// Lets one of the actors, the learner or the recorder do something. False when it waits.
    fn move_one(&mut self, order: usize) -> bool {
        let actors = self.actors.len();
        match order % (actors + 2) {
            learner if learner == actors => self.learner_turn(),
            recorder if recorder > actors => {
                let Some(taken) = self.recorder.take() else { return false };
                if let Some((actor, half, receipt)) = taken {
                    self.collector.recorded(actor, half, receipt);
                }
                true
            }
            actor => {
                let Some(sent) = self.actors[actor].turn(self.run.column_map) else { return false };
                self.recorder.queue.extend(sent.clone());
                self.to_learner.extend(sent);
                true
            }
        }
    }

    /// Runs to the budget. `order` decides who moves next; a fault strikes after its number of turns.
    fn run(mut self, mut order: impl FnMut() -> usize, faults: &[(usize, Fault)]) -> Record {
        let actors = self.actors.len();
        let mut idle = 0;
        let mut turn = 0;
        while self.frames < self.run.budget || self.in_progress.is_some() {
            for (_, fault) in faults.iter().filter(|(at, _)| *at == turn) {
                match *fault {
                    Fault::Actor(actor) => self.kill_actor(actor % actors as u32),
                    Fault::Learner => self.kill_learner(turn % 2),
                }
            }
            turn += 1;
            let moved = self.move_one(order());
            idle = if moved { 0 } else { idle + 1 };
            assert!(idle < 10_000, "everybody waits for somebody: {:?}", self.collector.task());
        }
        if self.run.recorded {
            assert_eq!(self.recorder.steps.len() as u64, self.run.budget, "every step is recorded: {faults:?}");
        }
        self.record
    }
}

/// Whose turn it is.
fn due(collector: &Collector<FakeSample>) -> Vec<Lane> {
    let Task::Act(lanes) = collector.task() else { panic!("{:?}", collector.task()) };
    lanes
}

/// All columns are one shard.
fn collector(settings: Settings, boundary: Boundary) -> Collector<FakeSample> {
    Collector::new(settings, &Shards::one(settings.column_map.columns()), boundary)
}

fn reward(name: &str) -> Reward {
    Reward { composition: Config::default().reward(name), multiplier: 0.0 }
}

fn settings(column_map: ColumnMap, learner_incarnation: u32) -> Settings {
    Settings {
        column_map,
        task: Config::default().spec(),
        seed: SEED,
        noise: Noise::Gumbel(POLICY_ACTIONS),
        max_episode_steps: MAX_STEPS,
        gamma: 0.99,
        signals: Signals::of(&Config::default()),
        learner_incarnation,
        recorded: false,
    }
}

/// Everything the batch says about row `i` as one number, and the belief after it.
fn look(batch: &Batch, i: usize, belief: u64) -> (u64, u64) {
    let input = batch.input();
    let noise = &input.gumbel[i * POLICY_ACTIONS..][..POLICY_ACTIONS];
    let numbers = input.numbers[3 * i..][..3].iter().chain(noise).map(|value| u64::from(value.to_bits()));
    let seen = mix(numbers.chain([u64::from(input.previous_action[i]), u64::from(input.episode_start[i])]));
    let belief = if input.episode_start[i] { 0 } else { belief };
    (seen, mix([belief, seen]))
}

fn round_robin() -> impl FnMut() -> usize {
    let mut next = 0;
    move || {
        next += 1;
        next
    }
}

fn random_order(seed: u64) -> impl FnMut() -> usize {
    let mut state = seed;
    move || {
        state = mix([state, 1]);
        (state >> 8) as usize
    }
}

fn any_run() -> impl Strategy<Value = Run> {
    let pace = || prop_oneof![Just(Pace::Lockstep), Just(Pace::Ready)];
    (1u32..4, 1u32..5, 1usize..9, 1u64..120, any::<bool>(), [pace(), pace()]).prop_map(
        |(actors, environments, rollout_steps, budget, recorded, paces)| Run {
            column_map: ColumnMap::new(0, actors, environments),
            rollout_steps,
            cut: None,
            budget,
            recorded,
            paces,
        },
    )
}

fn any_fault() -> impl Strategy<Value = (usize, Fault)> {
    (0usize..400, prop_oneof![3 => (0u32..4).prop_map(Fault::Actor), 1 => Just(Fault::Learner)])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Whoever dies when, in whatever order messages arrive, and whoever acts together: the same rollouts are recorded.
    #[test]
    fn no_crash_and_no_timing_changes_what_is_recorded(
        run in any_run(), order in any::<u64>(), faults in prop::collection::vec(any_fault(), 0..8),
    ) {
        let undisturbed = World::new(run.plain()).run(round_robin(), &[]);
        let frames: u64 = undisturbed.rollouts.iter().map(|rollout| rollout.shape.frames).sum();
        prop_assert_eq!(frames, run.budget);
        for rollout in &undisturbed.rollouts {
            prop_assert_eq!(rollout.actions.len() as u64, rollout.shape.frames);
            prop_assert_eq!(rollout.outcomes.len() as u64, rollout.shape.frames);
            prop_assert_eq!(rollout.bootstrap.len(), run.column_map.columns());
        }
        prop_assert_eq!(World::new(run).run(random_order(order), &faults), undisturbed);
    }

    /// A rollout that is ended early is, in all that is recorded, one that was to be that short.
    #[test]
    fn a_rollout_cut_short_is_a_short_one(
        run in any_run(), cut in 1usize..9, order in any::<u64>(), faults in prop::collection::vec(any_fault(), 0..3),
    ) {
        // Who has run ahead cannot be cut.
        let run = Run { paces: [Pace::Lockstep; 2], ..run };
        let short = Run { rollout_steps: cut.min(run.rollout_steps), ..run };
        let cut = Run { cut: Some(cut), ..run };
        prop_assert_eq!(World::new(cut).run(random_order(order), &faults), World::new(short).run(round_robin(), &[]));
    }

    /// A stop at any point loses nothing: the boundary of the rollout in progress is the one it began at.
    #[test]
    fn a_stop_at_any_point_resumes_to_the_same_run(run in any_run(), stop_after in 0usize..300) {
        let undisturbed = World::new(run).run(round_robin(), &[]);
        let mut world = World::new(run);
        let mut order = round_robin();
        for _ in 0..stop_after {
            world.move_one(order());
        }
        let brain = if world.in_progress.is_some() { world.before.clone() } else { world.brain.clone() };
        let (boundary, frames) = (world.collector.boundary(), world.frames);
        let stored = world.checkpoints.last().unwrap();
        prop_assert_eq!(&boundary, &stored.boundary, "a stop saves what the last boundary was");
        let rollout = world.record.rollouts.len();
        let mut resumed = World::new(run);
        resumed.record = world.record;
        resumed.recorder = world.recorder;
        resumed.checkpoints = vec![Checkpoint { boundary, brain, frames, rollout }];
        resumed.kill_learner(0);
        prop_assert_eq!(resumed.run(round_robin(), &[]), undisturbed);
    }
}

/// Every single point of a run, one crash each: shorter than chance, but complete.
#[test]
fn a_crash_at_each_turn() {
    let column_map = ColumnMap::new(0, 2, 3);
    for paces in [[Pace::Lockstep; 2], [Pace::Ready; 2], [Pace::Lockstep, Pace::Ready]] {
        let run = Run { column_map, rollout_steps: 3, cut: None, budget: 40, recorded: true, paces };
        let undisturbed = World::new(run.plain()).run(round_robin(), &[]);
        assert!(undisturbed.rollouts.iter().flat_map(|rollout| &rollout.outcomes).any(|outcome| outcome.3), "some end");
        for turn in 0..200 {
            for fault in [Fault::Actor(0), Fault::Actor(1), Fault::Learner] {
                let disturbed = World::new(run).run(round_robin(), &[(turn, fault)]);
                assert_eq!(disturbed, undisturbed, "{fault:?} at {turn}, {paces:?}");
            }
        }
    }
}

#[test]
fn an_actor_that_disagrees_is_named() {
    let column_map = ColumnMap::new(0, 2, 2);
    let mut collector = collector(settings(column_map, 1), Boundary::start(column_map.columns()));
    let mut actor = FakeActor::new(1, 1);
    actor.restore = Some(collector.restore(1, 0));
    let sent = actor.turn(column_map).unwrap();
    let broken = |change: &dyn Fn(&mut ObservationHeader, &mut FakeSample)| {
        let (mut header, mut sample) = sent[1].clone();
        change(&mut header, &mut sample);
        (header, sample)
    };
    let mut said = |(header, sample): Message| {
        let error = collector.receive(&header, sample).unwrap_err();
        (error.to_string(), error.is_non_finite())
    };
    let (not_finite, is_non_finite) = said(broken(&|_, sample| sample.reals("wrist_to_object_m")[1] = f32::NAN));
    assert!(is_non_finite && not_finite.contains("wrist_to_object_m[1] is not finite"), "{not_finite}");
    let mut text = |message| {
        let (text, is_non_finite) = said(message);
        assert!(!is_non_finite, "{text}");
        text
    };

    let wrong_episode = text(broken(&|_, sample| sample.header_mut().episode = 3));
    assert!(wrong_episode.contains("actor 1, kitchen 3, environment 1: it is at episode 3, step 0"), "{wrong_episode}");
    let no_start = text(broken(&|_, sample| sample.header_mut().flags = 0));
    assert!(no_start.contains("episode-start flag"), "{no_start}");
    let swapped = text(broken(&|_, sample| sample.header_mut().environment = 0));
    assert!(swapped.contains("holds environment 0"), "{swapped}");
    let unseen = text(broken(&|_, sample| sample.header_mut().bulk = 0));
    assert!(unseen.contains("actor 1, kitchen 3, environment 1: its depth frame"), "{unseen}");
    let short = text(broken(&|_, sample| sample.0.clear()));
    assert!(short.contains("actor 1 sent 0 observations for half 1, which has 1"), "{short}");
    let ahead = text(broken(&|header, _| header.step = 1));
    assert!(ahead.contains("actor 1 is at exchange 1 of half 1"), "{ahead}");
    let nobody = text(broken(&|header, _| header.actor = 2));
    assert!(nobody.contains("makes no sense"), "{nobody}");
    let never_started = text(broken(&|header, _| header.actor_incarnation = u32::MAX));
    assert!(never_started.contains("makes no sense"), "{never_started}");
    let flags = text(broken(&|_, sample| sample.header_mut().flags |= flag::TERMINATED));
    assert!(flags.contains("its header's flags are 0xa"), "{flags}");
    let target = text(broken(&|_, sample| sample.wholes("current_target")[0] = 99));
    assert!(target.contains("current_target is 99"), "{target}");
    let far = text(broken(&|_, sample| sample.reals("object_to_goal_m")[0] = 1e6));
    assert!(far.contains("object_to_goal_m[0] is 1000000"), "{far}");

    // What is right is taken once; a copy, an old learner's and a dead predecessor's change nothing.
    let (header, sample) = sent[1].clone();
    assert_eq!(collector.receive(&header, sample.clone()), Ok(Received::Kept));
    assert_eq!(collector.receive(&header, sample.clone()), Ok(Received::Duplicate));
    let old = ObservationHeader { learner_incarnation: 0, ..header };
    assert_eq!(collector.receive(&old, sample), Ok(Received::Foreign));
    let (hello, nothing) = FakeActor::new(1, 2).hello();
    assert_eq!(collector.receive(&hello, nothing.clone()), Ok(Received::Hello { actor: 1, actor_incarnation: 2 }));
    let (hello, _) = FakeActor::new(1, 1).hello();
    assert_eq!(collector.receive(&hello, nothing), Ok(Received::Duplicate));
}

#[test]
fn a_batch_has_the_goal_vector_that_was_reported() {
    let column_map = ColumnMap::new(0, 1, 1);
    let mut collector = collector(settings(column_map, 1), Boundary::start(1));
    let mut actor = FakeActor::new(0, 1);
    actor.restore = Some(collector.restore(0, 0));
    let (header, mut sample) = actor.turn(column_map).unwrap().remove(0);
    sample.reals("goal_m").copy_from_slice(&[0.25, -1.5, 3.0]);
    collector.receive(&header, sample).unwrap();
    collector.begin(RolloutShape { steps: 1, environments_in_last_step: 1, frames: 1 }, reward("r"), 1);
    assert_eq!(collector.batch(&due(&collector)).input().numbers, [0.25, -1.5, 3.0]);
}
