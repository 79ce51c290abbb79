//! The supervisor against a world that crashes, hangs and lies at random.

use super::*;
use crate::supervisor::stage::StageSwitch;
use proptest::prelude::*;
use proto::config::Config;
use proto::control::Timing;
use proto::kitchen::KitchenId;
use proto::message::{StageAnnouncement, directive};
use proto::reward::RewardKind;
use proto::stage::{RolloutShape, position_at};
use std::collections::BTreeSet;

const ACTORS: u32 = 3;
const ROLLOUT_STEPS: usize = 8;
const ENVIRONMENTS: usize = 6;

fn stages() -> Vec<StageConfig> {
    let stage = |name: &str, reward, frames| StageConfig { name: name.into(), reward, frames };
    vec![stage("I", RewardKind::Task, 500), stage("II", RewardKind::DisturbanceFree, 333)]
}

fn policy() -> Policy {
    let mut config = Config { stages: stages(), ..Config::default() };
    config.actors.count = ACTORS;
    Policy::of(&config)
}

/// Everything outside the supervisor: processes that live and die, and a learner that keeps to the protocol.
struct World {
    supervisor: Supervisor,
    now: Duration,
    up: BTreeMap<Process, u32>,
    spawned: BTreeMap<Process, u32>,
    told_to_go: BTreeSet<Process>,
    killed: BTreeSet<Process>,
    announced: StageAnnouncement,
    switches: Vec<StageSwitch>,
    reports: Vec<String>,
    outcome: Option<Outcome>,
    /// Boundaries (frames) of rollouts so far, and the learner's place among them.
    boundaries: Vec<u64>,
    checkpoint: usize,
    ready: bool,
    collected: bool,
    trained: usize,
    high_water_marks: u32,
}

impl World {
    fn new() -> Self {
        let mut world = Self {
            supervisor: Supervisor::new(policy(), stages()),
            now: Duration::ZERO,
            up: BTreeMap::new(),
            spawned: BTreeMap::new(),
            told_to_go: BTreeSet::new(),
            killed: BTreeSet::new(),
            announced: StageAnnouncement::default(),
            switches: vec![],
            reports: vec![],
            outcome: None,
            boundaries: vec![0],
            checkpoint: 0,
            ready: false,
            collected: false,
            trained: 0,
            high_water_marks: 0,
        };
        let actions = world.supervisor.start(Duration::ZERO);
        world.carry_out(actions);
        assert_eq!(world.up.len(), 1 + ACTORS as usize, "everything is started");
        world
    }

    fn feed(&mut self, event: Event) {
        let actions = self.supervisor.on_event(self.now, event);
        self.carry_out(actions);
    }

    fn carry_out(&mut self, actions: Vec<Action>) {
        for action in actions {
            assert!(self.outcome.is_none(), "nothing follows Finish, but {action:?} did");
            match action {
                Action::Spawn { process, incarnation } => {
                    assert!(!self.supervisor.is_stopping(), "nothing starts during a stop");
                    assert!(!self.up.contains_key(&process), "{process} is spawned while it runs");
                    let starts = self.spawned.entry(process).or_default();
                    *starts += 1;
                    assert_eq!(incarnation, *starts, "incarnations count starts");
                    let allowed = (policy().restart.in_all as u32 + 1) * (self.high_water_marks + 1) + 1;
                    assert!(*starts <= allowed, "{process} was started {starts} times");
                    self.up.insert(process, incarnation);
                    if process == LEARNER {
                        (self.ready, self.collected, self.trained) = (false, false, self.checkpoint);
                    }
                }
                Action::CloseLifeline(process) => {
                    assert!(self.up.contains_key(&process), "a lifeline of a dead process is closed");
                    self.told_to_go.insert(process);
                }
                Action::Kill(process) => {
                    assert!(self.up.contains_key(&process), "a dead process is killed");
                    assert!(self.killed.insert(process), "{process} is killed twice");
                }
                Action::Announce(announcement) => {
                    assert_eq!(announcement.version, self.announced.version + 1);
                    self.announced = announcement;
                }
                Action::SwitchStage(switch) => self.switches.push(switch),
                Action::Report(_, text) => self.reports.push(text),
                Action::Finish(outcome) => {
                    assert!(self.up.keys().all(|process| self.killed.contains(process)), "left alive: {:?}", self.up);
                    self.outcome = Some(outcome);
                }
            }
        }
    }

    fn exit(&mut self, process: Process, exit: Exit) {
        if let Some(incarnation) = self.up.remove(&process) {
            self.told_to_go.remove(&process);
            self.killed.remove(&process);
            self.feed(Event::Exited { process, incarnation, exit, last_words: vec!["oh".into()] });
        }
    }

    fn learner(&mut self, event: LearnerEvent) {
        let incarnation = self.up[&LEARNER];
        self.feed(Event::Learner { incarnation, event });
    }

    /// The learner's next step under the protocol.
    fn learner_step(&mut self, checkpoints: bool) {
        if !self.up.contains_key(&LEARNER) {
            return;
        }
        let rank = 0;
        let (rollout, frames) = (self.trained, self.boundaries[self.trained]);
        if !self.ready {
            self.ready = true;
            let checkpoint = (rollout > 0).then(|| "checkpoints/x.json".to_owned());
            return self.learner(LearnerEvent::Ready {
                rank,
                rollout: rollout as u64,
                frames,
                device: "cpu".into(),
                parameters: 1,
                checkpoint,
            });
        }
        let position = position_at(&stages(), frames);
        let stop = self.announced.directive == directive::STOP || self.told_to_go.contains(&LEARNER);
        if self.collected {
            let next = rollout + 1;
            (self.collected, self.trained) = (false, next);
            if self.supervisor.frames_reached < self.boundaries[next] {
                self.high_water_marks += 1;
            }
            if checkpoints {
                self.checkpoint = next;
            }
            let frames = self.boundaries[next];
            self.learner(LearnerEvent::RolloutTrained {
                rank,
                rollout: rollout as u64,
                frames,
                stage: self.announced.stage,
                timing: Timing::default(),
                metrics: BTreeMap::new(),
            });
        } else if position.is_none() || stop {
            self.checkpoint = rollout;
            let weights = "0".repeat(64);
            self.learner(LearnerEvent::Finished { rank, frames, weights, complete: position.is_none() });
            self.exit(LEARNER, Exit::Code(0));
        } else if let Some(position) = position
            && self.announced.rollout == rollout as u64
        {
            assert_eq!(self.announced.stage as usize, position.stage, "announced is what the frames say");
            let shape = RolloutShape::next(position.frames_left, ROLLOUT_STEPS, ENVIRONMENTS);
            self.boundaries.truncate(rollout + 1);
            self.boundaries.push(frames + shape.frames);
            self.collected = true;
            self.learner(LearnerEvent::RolloutCollected {
                rank,
                rollout: rollout as u64,
                frames: frames + shape.frames,
            });
        }
    }

    /// Those who were told to go, go.
    fn obey(&mut self) {
        if let Some(process) = self.killed.iter().next().copied() {
            self.exit(process, Exit::Signal(9));
        } else if let Some(process) = self.told_to_go.iter().find(|&&process| process != LEARNER).copied() {
            self.exit(process, Exit::Code(0));
        }
    }

    fn pass(&mut self, time: Duration) {
        self.now += time;
        self.feed(Event::Tick);
    }

    fn random_step(&mut self, kind: u8, pick: u8, time_ms: u32) {
        let processes: Vec<Process> = self.up.keys().copied().collect();
        let process = processes.get(usize::from(pick) % processes.len().max(1)).copied();
        match (kind, process) {
            (0..=9, _) => self.learner_step(pick.is_multiple_of(3)),
            (10, Some(process)) => self.exit(process, Exit::Signal(9)),
            (11, Some(process)) if pick.is_multiple_of(4) => {
                self.exit(process, Exit::Code([0, 1, 3, 101][usize::from(pick) / 4 % 4]));
            }
            (12..=15, _) => self.pass(Duration::from_millis(u64::from(time_ms))),
            (16..=17, _) => self.obey(),
            (18, _) if self.ready && self.up.contains_key(&LEARNER) => self.learner(LearnerEvent::WaitingForActor {
                rank: 0,
                actor: u32::from(pick) % (ACTORS + 1),
                waited_s: f64::from(time_ms) / 100.0,
            }),
            (19, _) => match pick {
                0..10 => self.feed(Event::Stop),
                10..20 => self.feed(Event::Interrupt),
                20..25 => self.feed(Event::CannotWrite("disk full".into())),
                _ => {}
            },
            _ => {}
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Whatever crashes, hangs or is asked for, and in whatever order: the run ends, within every bound.
    #[test]
    fn every_schedule_ends(
        schedule in prop::collection::vec((0u8..20, any::<u8>(), 0u32..20_000), 0..500),
        world_dies in any::<bool>(),
    ) {
        let mut world = World::new();
        for (kind, pick, time_ms) in schedule {
            if world.outcome.is_none() {
                world.random_step(kind, pick, time_ms);
            }
        }
        // From here on either all keep to the protocol, or nothing ever speaks again and only kills are obeyed.
        for _ in 0..20_000 {
            if world.outcome.is_some() {
                break;
            }
            world.obey();
            if world.outcome.is_none() && !world_dies {
                world.learner_step(true);
            }
            if world.outcome.is_none() {
                world.pass(Duration::from_secs(1));
            }
        }
        let outcome = world.outcome.clone();
        prop_assert!(outcome.is_some(), "no end; {:?}", world.reports.last());
        prop_assert!(world.supervisor.is_over());
        if let Some(Outcome { end: End::Complete, saved }) = outcome {
            prop_assert_eq!(saved.map(|saved| saved.frames), Some(833));
            let last = world.switches.last().expect("it trained in both stages");
            prop_assert_eq!((last.to, last.frames), (1, 500));
        }
    }
}

fn train(world: &mut World) {
    for _ in 0..200 {
        if world.outcome.is_none() {
            world.learner_step(true);
            world.obey();
        }
    }
}

#[test]
fn an_undisturbed_run_trains_both_stages_and_ends_complete() {
    let mut world = World::new();
    train(&mut world);
    assert_eq!(
        world.outcome,
        Some(Outcome { end: End::Complete, saved: Some(Saved { frames: 833, weights: "0".repeat(64) }) })
    );
    let switches: Vec<_> = world.switches.iter().map(|switch| (switch.from, switch.to, switch.frames)).collect();
    assert_eq!(switches, [(None, 0, 0), (Some(0), 1, 500)]);
    assert!(world.spawned.values().all(|&starts| starts == 1));
}

#[test]
fn a_stop_saves_and_can_be_told_from_completion() {
    let mut world = World::new();
    for _ in 0..6 {
        world.learner_step(false);
    }
    world.feed(Event::Interrupt);
    assert_eq!(world.announced.directive, directive::STOP);
    world.feed(Event::Stop);
    train(&mut world);
    let outcome = world.outcome.expect("it ended");
    assert_eq!(outcome.end, End::Stopped);
    assert!(outcome.saved.is_some_and(|saved| saved.frames > 0 && saved.frames < 833));
}

#[test]
fn a_second_interrupt_kills_everything_at_once() {
    let mut world = World::new();
    world.learner_step(false);
    world.feed(Event::Interrupt);
    assert!(world.killed.is_empty());
    world.feed(Event::Interrupt);
    assert_eq!(world.killed.len(), 1 + ACTORS as usize);
    for _ in 0..=ACTORS {
        world.obey();
    }
    assert_eq!(world.outcome, Some(Outcome { end: End::Interrupted, saved: None }));
}

#[test]
fn a_crash_loop_ends_the_run_in_order_and_names_the_culprit() {
    let mut world = World::new();
    for _ in 0..4 {
        world.learner_step(true);
    }
    for _ in 0..20 {
        world.exit(Process::Actor(2), Exit::Signal(11));
        world.pass(Duration::from_secs(5));
    }
    assert_eq!(world.announced.directive, directive::STOP, "the learner is asked to save first");
    train(&mut world);
    let outcome = world.outcome.expect("it ended");
    assert!(outcome.saved.is_some(), "what was trained is kept");
    let End::Failed(reason) = outcome.end else { panic!("{:?}", outcome.end) };
    for part in ["actor-02 (kitchen 4)", "died 6 times", "signal 11 (SIGSEGV)", "\n    oh"] {
        assert!(reason.contains(part), "{part:?} is not in {reason:?}");
    }
}

#[test]
fn a_learner_that_refuses_to_begin_is_not_asked_again() {
    let mut world = World::new();
    world.exit(LEARNER, Exit::Code(1));
    train(&mut world);
    assert!(matches!(world.outcome, Some(Outcome { end: End::Failed(_), saved: None })));
    assert_eq!(world.spawned[&LEARNER], 1);
}

#[test]
fn non_finite_numbers_are_forgiven_once_between_progress() {
    let mut world = World::new();
    for _ in 0..3 {
        world.learner_step(true);
    }
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 2);
    for _ in 0..3 {
        world.learner_step(true);
    }
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 3, "a rollout further the count begins anew");
    world.learner_step(true);
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 3);
    assert!(world.supervisor.is_stopping());
}

#[test]
fn a_hanging_actor_is_killed_and_started_again() {
    let mut world = World::new();
    world.learner_step(false);
    world.pass(Duration::from_secs(100));
    let waiting = |waited_s| LearnerEvent::WaitingForActor { rank: 0, actor: 1, waited_s };
    world.learner(waiting(10.0));
    assert!(world.killed.is_empty());
    world.learner(waiting(61.0));
    assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [Process::Actor(1)]);
    world.learner(waiting(62.0));
    world.obey();
    assert_eq!(world.spawned[&Process::Actor(1)], 2);
    world.learner(waiting(63.0));
    assert!(world.killed.is_empty(), "the new one is given its time");
}

#[test]
fn a_silent_learner_is_killed_and_a_dead_ones_words_are_ignored() {
    let mut world = World::new();
    world.learner_step(false);
    world.learner_step(false);
    for _ in 0..3000 {
        if world.killed.is_empty() {
            world.pass(Duration::from_secs(1));
        }
    }
    assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [LEARNER]);
    world.obey();
    assert_eq!(world.spawned[&LEARNER], 2);
    let version = world.announced.version;
    world.feed(Event::Learner {
        incarnation: 1,
        event: LearnerEvent::RolloutCollected { rank: 0, rollout: 0, frames: 48 },
    });
    assert_eq!(world.announced.version, version);
}

#[test]
fn a_learner_that_never_gets_ready_ends_the_run() {
    let mut world = World::new();
    for _ in 0..200 {
        if world.outcome.is_none() {
            world.pass(Duration::from_secs(1));
            world.obey();
        }
    }
    let Some(Outcome { end: End::Failed(reason), .. }) = world.outcome else { panic!("{:?}", world.outcome) };
    assert!(reason.contains("not ready after 120 s"), "{reason}");
}

/// What an evaluation's learner says of an episode that ended.
fn played(episode: u32) -> LearnerEvent {
    let record = crate::evaluation::uneventful(KitchenId::new(2).unwrap(), episode);
    LearnerEvent::EpisodePlayed { record, actions: vec![20] }
}

#[test]
fn an_evaluation_is_complete_without_a_frame_and_playing_again_is_no_progress() {
    let ready = || LearnerEvent::Ready {
        rank: 0,
        rollout: 7,
        frames: 700,
        device: "cpu".into(),
        parameters: 1,
        checkpoint: None,
    };
    let mut supervisor = Supervisor::new(policy(), Vec::new());
    let mut now = Duration::ZERO;
    supervisor.start(now);
    let mut incarnation = 1;
    // Each learner plays one episode and dies: the same one, so it is given up.
    let failed = loop {
        let speaks = |event| Event::Learner { incarnation, event };
        let actions = supervisor.on_event(now, speaks(ready()));
        assert!(!actions.iter().any(|action| matches!(action, Action::Announce(_))), "there is nothing to train on");
        supervisor.on_event(now, speaks(played(0)));
        let exit = Exit::Signal(11);
        let actions =
            supervisor.on_event(now, Event::Exited { process: LEARNER, incarnation, exit, last_words: vec![] });
        if actions.iter().any(|action| matches!(action, Action::Report(Level::Error, _))) {
            break actions;
        }
        now += Duration::from_secs(10);
        let actions = supervisor.on_event(now, Event::Tick);
        incarnation += 1;
        let spawned = Action::Spawn { process: LEARNER, incarnation };
        assert!(actions.contains(&spawned) || supervisor.learner.ready.is_none(), "{actions:?}");
        assert!(incarnation < 100, "a learner that gets no further is given up");
    };
    assert!(failed.iter().any(|action| matches!(action, Action::CloseLifeline(_))));

    let mut supervisor = Supervisor::new(policy(), Vec::new());
    supervisor.start(now);
    let finished = LearnerEvent::Finished { rank: 0, frames: 0, weights: "w".into(), complete: true };
    for event in [ready(), played(0), played(1), finished] {
        supervisor.on_event(now, Event::Learner { incarnation: 1, event });
    }
    let mut last = vec![];
    for process in std::iter::once(LEARNER).chain((0..ACTORS).map(Process::Actor)) {
        let exit = Exit::Code(0);
        last = supervisor.on_event(now, Event::Exited { process, incarnation: 1, exit, last_words: vec![] });
    }
    let saved = Some(Saved { frames: 0, weights: "w".into() });
    assert_eq!(last, [Action::Finish(Outcome { end: End::Complete, saved })]);
}
