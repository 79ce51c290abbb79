//! The supervisor against a world that crashes, hangs and lies at random.

use super::*;
use crate::supervisor::stage::StageSwitch;
use proptest::prelude::*;
use proto::config::Config;
use proto::event::Timing;
use proto::exit::EXIT_NON_FINITE;
use proto::kitchen::KitchenId;
use proto::reward::RewardKind;
use proto::stage::{RolloutShape, position_at};
use std::collections::BTreeSet;
use wire::message::{StageAnnouncement, directive};

/// Rank 0, which speaks for all learners.
const LEARNER: Process = Process::Learner(0);
const ACTORS: u32 = 3;
const ROLLOUT_STEPS: usize = 8;
const ENVIRONMENTS: usize = 6;

fn stages() -> Vec<StageConfig> {
    let stage = |name: &str, reward, frames| StageConfig { name: name.into(), reward, frames };
    vec![stage("I", RewardKind::Task, 500), stage("II", RewardKind::DisturbanceFree, 333)]
}

fn policy(learners: u32) -> Policy {
    let mut config = Config { stages: stages(), ..Config::default() };
    config.actors.count = ACTORS;
    config.learner.count = learners;
    Policy::of(&config)
}

/// Everything outside the supervisor: processes that live and die, and learners that keep to the protocol.
struct World {
    learners: u32,
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
    /// Boundaries (frames) of rollouts so far, and the learners' place among them.
    boundaries: Vec<u64>,
    checkpoint: usize,
    /// Ranks that have said so.
    ready: BTreeSet<u32>,
    connected: BTreeSet<u32>,
    collected: bool,
    trained: usize,
    /// That the rollout at which they are is the last of this sitting; whether the run is complete.
    agreed: Option<bool>,
    high_water_marks: u32,
}

impl World {
    fn new() -> Self {
        Self::with(1)
    }

    fn with(learners: u32) -> Self {
        let mut world = Self {
            learners,
            supervisor: Supervisor::new(policy(learners), stages()),
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
            ready: BTreeSet::new(),
            connected: BTreeSet::new(),
            collected: false,
            trained: 0,
            agreed: None,
            high_water_marks: 0,
        };
        let actions = world.supervisor.start(Duration::ZERO);
        world.carry_out(actions);
        assert_eq!(world.up.len(), (learners + ACTORS) as usize, "everything is started");
        world
    }

    fn feed(&mut self, event: Event) {
        let actions = self.supervisor.on_event(self.now, event);
        self.carry_out(actions);
        let starts: BTreeSet<u32> = self.ranks().map(|rank| self.spawned[&Process::Learner(rank)]).collect();
        assert_eq!(starts.len(), 1, "learners are started together, and meet by their incarnation");
        let gone = |rank| !self.up.contains_key(&Process::Learner(rank)) && !self.supervisor.gang.has_finished(rank);
        // Once rank 0 has saved, they only have to leave. Who is the reason of another's end is given time to say why.
        let waits = !self.supervisor.is_stopping() && self.supervisor.gang.awaits_a_reason();
        if !waits && self.outcome.is_none() && !self.supervisor.gang.has_finished(0) && self.ranks().any(gone) {
            for process in self.ranks().map(Process::Learner) {
                let left = self.up.contains_key(&process) && !self.killed.contains(&process);
                assert!(!left, "{process} is left to wait for one that is dead");
            }
        }
    }

    fn ranks(&self) -> std::ops::Range<u32> {
        0..self.learners
    }

    /// Deaths that the user was told of.
    fn deaths(&self) -> Vec<&str> {
        self.reports.iter().filter(|text| text.contains(" died")).map(String::as_str).collect()
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
                    let allowed = (policy(1).restart.in_all as u32 + 1) * (self.high_water_marks + 1) + 1;
                    assert!(*starts <= allowed, "{process} was started {starts} times");
                    self.up.insert(process, incarnation);
                    if let Process::Learner(rank) = process {
                        for (other, started) in &self.up {
                            let together = !matches!(other, Process::Learner(_)) || *started == incarnation;
                            assert!(together, "{process} is started while {other} is of another incarnation");
                        }
                        self.ready.remove(&rank);
                        self.connected.remove(&rank);
                        (self.collected, self.trained, self.agreed) = (false, self.checkpoint, None);
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
        let incarnation = self.up[&Process::Learner(event.rank())];
        self.feed(Event::Learner { incarnation, event });
    }

    /// A learner's next step under the protocol.
    fn learner_step(&mut self, rank: u32, checkpoints: bool) {
        if !self.up.contains_key(&Process::Learner(rank)) {
            return;
        }
        let (rollout, frames) = (self.trained, self.boundaries[self.trained]);
        if self.ready.insert(rank) {
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
        if let Some(complete) = self.agreed {
            return if self.supervisor.gang.has_finished(rank) {
                self.exit(Process::Learner(rank), Exit::Code(0));
            } else {
                self.finishes(rank, complete);
            };
        }
        // What they do together takes all of them.
        if !self.ranks().all(|rank| self.up.contains_key(&Process::Learner(rank)) && self.ready.contains(&rank)) {
            return;
        }
        let stop = self.announced.directive == directive::STOP
            || self.told_to_go.iter().any(|process| matches!(process, Process::Learner(_)));
        let position = position_at(&stages(), frames);
        let acts = self.announced.rollout == rollout as u64 && position.is_some() && !stop;
        if acts && self.connected.insert(rank) {
            return self.learner(LearnerEvent::ActorsConnected { rank });
        }
        if rank == 0 {
            self.gang_step(rollout, frames, position, stop, checkpoints);
        }
    }

    /// The next step of all learners together, told by rank 0.
    fn gang_step(
        &mut self,
        rollout: usize,
        frames: u64,
        position: Option<proto::stage::StagePosition>,
        stop: bool,
        checkpoints: bool,
    ) {
        let rank = 0;
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
            self.agreed = Some(position.is_none());
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

    fn finishes(&mut self, rank: u32, complete: bool) {
        let frames = self.boundaries[self.trained];
        self.learner(LearnerEvent::Finished { rank, frames, weights: "0".repeat(64), complete });
    }

    /// A step of each learner, the last one's first.
    fn step(&mut self, checkpoints: bool) {
        for rank in self.ranks().rev() {
            if self.outcome.is_none() {
                self.learner_step(rank, checkpoints);
            }
        }
    }

    /// Those who were told to go, go.
    fn obey(&mut self) {
        if let Some(process) = self.killed.iter().next().copied() {
            self.exit(process, Exit::Signal(9));
        } else if let Some(process) =
            self.told_to_go.iter().find(|process| matches!(process, Process::Actor(_))).copied()
        {
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
            (0..=9, _) => self.learner_step(u32::from(pick) / 3 % self.learners, pick.is_multiple_of(3)),
            (10, Some(process)) => self.exit(process, Exit::Signal(9)),
            (11, Some(process)) if pick.is_multiple_of(4) => {
                self.exit(process, Exit::Code([0, 1, 3, EXIT_LOST_PEERS, 101][usize::from(pick) / 4 % 5]));
            }
            (12..=15, _) => self.pass(Duration::from_millis(u64::from(time_ms))),
            (16..=17, _) => self.obey(),
            (18, Some(Process::Learner(rank))) if self.ready.contains(&rank) => {
                self.learner(LearnerEvent::WaitingForActor {
                    rank,
                    actor: u32::from(pick) % (ACTORS + 1),
                    waited_s: f64::from(time_ms) / 100.0,
                });
            }
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
        world_dies in any::<bool>(), learners in 1..=ACTORS,
    ) {
        let mut world = World::with(learners);
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
            if !world_dies {
                world.step(true);
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
            world.step(true);
            world.obey();
        }
    }
}

#[test]
fn an_undisturbed_run_trains_both_stages_and_ends_complete() {
    for learners in 1..=3 {
        let mut world = World::with(learners);
        train(&mut world);
        assert_eq!(
            world.outcome,
            Some(Outcome { end: End::Complete, saved: Some(Saved { frames: 833, weights: "0".repeat(64) }) })
        );
        let switches: Vec<_> = world.switches.iter().map(|switch| (switch.from, switch.to, switch.frames)).collect();
        assert_eq!(switches, [(None, 0, 0), (Some(0), 1, 500)]);
        assert!(world.spawned.values().all(|&starts| starts == 1));
        let said = |text: &str| world.reports.iter().filter(|report| report.contains(text)).count();
        assert_eq!(
            (said("all 3 actors connected"), said(" ready on cpu"), world.deaths().len()),
            (1, learners as usize, 0)
        );
    }
}

#[test]
fn a_stop_saves_and_can_be_told_from_completion() {
    let mut world = World::new();
    for _ in 0..6 {
        world.step(false);
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
fn a_stopped_evaluation_is_not_said_to_save() {
    let interrupted = |stages: Vec<StageConfig>| {
        let mut supervisor = Supervisor::new(policy(1), stages);
        supervisor.start(Duration::ZERO);
        let said = supervisor.on_event(Duration::from_secs(1), Event::Interrupt).into_iter().find_map(|action| {
            let Action::Report(Level::Info, text) = action else { return None };
            Some(text)
        });
        said.expect("who presses Ctrl-C is told what follows")
    };
    assert!(interrupted(stages()).starts_with("stopping: the learner saves; Ctrl-C again"));
    let evaluation = interrupted(Vec::new());
    assert!(!evaluation.contains("save") && evaluation.contains("leaves no result; Ctrl-C again"), "{evaluation}");
}

#[test]
fn a_second_interrupt_kills_everything_at_once() {
    let mut world = World::new();
    world.step(false);
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
        world.step(true);
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
    for _ in 0..4 {
        world.step(true);
    }
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 2);
    for _ in 0..4 {
        world.step(true);
    }
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 3, "a rollout further the count begins anew");
    world.step(true);
    world.exit(LEARNER, Exit::Code(EXIT_NON_FINITE));
    assert_eq!(world.spawned[&LEARNER], 3);
    assert!(world.supervisor.is_stopping());
}

#[test]
fn a_hanging_actor_is_killed_and_started_again() {
    let mut world = World::new();
    world.step(false);
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
    world.step(false);
    world.step(false);
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
    let mut supervisor = Supervisor::new(policy(1), Vec::new());
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
        assert!(actions.contains(&spawned) || !supervisor.gang.is_ready(0), "{actions:?}");
        assert!(incarnation < 100, "a learner that gets no further is given up");
    };
    assert!(failed.iter().any(|action| matches!(action, Action::CloseLifeline(_))));

    let mut supervisor = Supervisor::new(policy(1), Vec::new());
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

// Several learners

/// Three learners that have trained three rollouts and saved the last; all else has been said.
fn gang() -> World {
    let mut world = World::with(3);
    while world.trained < 3 {
        world.step(true);
    }
    world.reports.clear();
    world
}

#[test]
fn whoever_of_the_learners_dies_takes_the_others_along_and_all_go_on_together() {
    for rank in 0..3 {
        let mut world = gang();
        world.exit(Process::Learner(rank), Exit::Signal(9));
        let others: Vec<Process> = (0..3).filter(|&other| other != rank).map(Process::Learner).collect();
        assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), others);
        assert_eq!(
            world.deaths(),
            [format!(
                "learner-{rank} died: signal 9 (SIGKILL: killed, perhaps by the kernel for want of memory); start number 2 \
                 follows; all 3 learners go on from the last checkpoint"
            )]
        );
        // One ends by itself before the kill reaches it, the last takes its time.
        world.exit(others[0], Exit::Code(1));
        world.pass(Duration::from_secs(5));
        assert_eq!(world.spawned[&LEARNER], 1, "one is still there");
        world.exit(others[1], Exit::Signal(9));
        assert!(
            world
                .ranks()
                .all(|rank| world.spawned[&Process::Learner(rank)] == 2
                    && !world.killed.contains(&Process::Learner(rank)))
        );
        assert_eq!(world.deaths().len(), 1, "what follows is no death of its own");
        train(&mut world);
        let outcome = world.outcome.as_ref().expect("it ended");
        assert_eq!(outcome.end, End::Complete);
        assert!(
            world
                .spawned
                .iter()
                .all(|(process, &starts)| starts == 1 + u32::from(matches!(process, Process::Learner(_))))
        );
    }
}

#[test]
fn a_learner_that_speaks_while_its_peer_is_dead_is_not_listened_to() {
    let mut world = gang();
    world.exit(Process::Learner(1), Exit::Signal(9));
    for rank in [0, 2] {
        world.exit(Process::Learner(rank), Exit::Signal(9));
    }
    // They come up again, and one dies before rank 0 is ready: it says so when it is already being killed.
    world.learner_step(2, true);
    world.exit(Process::Learner(1), Exit::Signal(11));
    let (version, reports) = (world.announced.version, world.reports.len());
    world.learner_step(0, true);
    assert_eq!((world.announced.version, world.reports.len()), (version, reports));
    world.exit(Process::Learner(0), Exit::Signal(9));
    world.pass(Duration::from_secs(5));
    assert_eq!(world.spawned[&LEARNER], 2, "the last still holds on");
    world.exit(Process::Learner(2), Exit::Signal(9));
    assert_eq!(world.spawned[&LEARNER], 3);
    // What the one before had in its pipe is nobody's word any more.
    world.feed(Event::Learner { incarnation: 2, event: LearnerEvent::ActorsConnected { rank: 2 } });
    assert!(!world.reports.iter().skip(reports).any(|text| text.contains("connected")));
    train(&mut world);
    assert_eq!(world.outcome.map(|outcome| outcome.end), Some(End::Complete));
}

#[test]
fn a_fall_is_one_death_in_the_count() {
    let mut world = gang();
    let falls = policy(3).restart.in_window as u32;
    for fall in 0..=falls {
        assert_eq!(world.outcome, None);
        assert!(!world.supervisor.is_stopping(), "fall {fall}");
        for rank in [fall % 3, (fall + 1) % 3, (fall + 2) % 3] {
            world.exit(Process::Learner(rank), Exit::Signal(11));
        }
        if fall < falls {
            world.pass(Duration::from_secs(4));
            assert_eq!(world.spawned[&LEARNER], fall + 2);
        }
    }
    for _ in 0..ACTORS {
        world.obey();
    }
    let Some(Outcome { end: End::Failed(reason), saved: None }) = &world.outcome else { panic!("{:?}", world.outcome) };
    let expected = "the learners died 6 times while the run got no further, last learner-2 with signal 11 (SIGSEGV)";
    assert!(reason.starts_with(expected), "{reason}");
}

#[test]
fn non_finite_numbers_of_all_learners_are_one_fall() {
    let mut world = gang();
    for (fall, exits) in [[EXIT_NON_FINITE; 3], [1, EXIT_NON_FINITE, EXIT_NON_FINITE]].iter().enumerate() {
        assert!(!world.supervisor.is_stopping(), "fall {fall}");
        for (rank, &code) in exits.iter().enumerate() {
            world.exit(Process::Learner(rank as u32), Exit::Code(code));
        }
    }
    assert_eq!(world.spawned[&LEARNER], 2);
    assert!(world.reports.last().is_some_and(|text| text.contains("learner-1 met non-finite numbers twice")));
    assert!(world.supervisor.is_stopping());
}

#[test]
fn who_lost_another_is_not_the_reason_and_the_reason_is_waited_for() {
    // At their first start, too: that is no refusal.
    for mut world in [gang(), World::with(3)] {
        world.exit(Process::Learner(2), Exit::Code(EXIT_LOST_PEERS));
        world.exit(Process::Learner(1), Exit::Code(EXIT_LOST_PEERS));
        assert!(world.deaths().is_empty() && world.killed.is_empty(), "the reason can still say what it has to");
        world.exit(Process::Learner(0), Exit::Signal(9));
        assert_eq!(world.deaths().len(), 1);
        assert!(world.deaths()[0].starts_with("learner-0 died: signal 9"), "{:?}", world.deaths());
        world.pass(Duration::from_secs(5));
        assert!(world.ranks().all(|rank| world.spawned[&Process::Learner(rank)] == 2));
    }
}

#[test]
fn where_nobody_is_the_reason_who_lost_another_falls_with_all() {
    // One hangs: it is ended with the rest. All lost one another: there is nobody to wait for.
    for everyone in [false, true] {
        let mut world = gang();
        world.exit(Process::Learner(1), Exit::Code(EXIT_LOST_PEERS));
        world.exit(Process::Learner(2), Exit::Code(EXIT_LOST_PEERS));
        if everyone {
            world.exit(Process::Learner(0), Exit::Code(EXIT_LOST_PEERS));
        } else {
            world.pass(policy(3).killed);
            assert!(world.killed.contains(&LEARNER));
            world.exit(LEARNER, Exit::Signal(9));
        }
        assert_eq!(world.deaths().len(), 1);
        assert!(world.deaths()[0].starts_with("learner-1 died: exit status 4"), "{:?}", world.deaths());
        world.pass(Duration::from_secs(5));
        assert!(world.ranks().all(|rank| world.spawned[&Process::Learner(rank)] == 2));
    }
}

#[test]
fn a_learner_that_refuses_to_begin_ends_the_run_for_all() {
    let mut world = World::with(3);
    world.learner_step(0, true);
    world.exit(Process::Learner(2), Exit::Code(1));
    assert_eq!(world.killed.len(), 2, "the others cannot save without it");
    train(&mut world);
    let Some(Outcome { end: End::Failed(reason), saved: None }) = world.outcome else { panic!("{:?}", world.outcome) };
    assert!(reason.starts_with("learner-2 could not begin: exit status 1"), "{reason}");
}

#[test]
fn learners_may_leave_in_any_order() {
    // At the budget, and at a stop.
    for stopped in [false, true] {
        for order in [[0, 1, 2], [2, 1, 0], [1, 0, 2]] {
            let mut world = gang();
            if stopped {
                world.feed(Event::Stop);
            }
            while world.agreed.is_none() {
                world.step(true);
            }
            for rank in order {
                world.finishes(rank, !stopped);
                world.exit(Process::Learner(rank), Exit::Code(0));
                let left = world.ranks().filter(|&rank| world.up.contains_key(&Process::Learner(rank)));
                assert!(left.into_iter().all(|rank| !world.killed.contains(&Process::Learner(rank))));
            }
            for _ in 0..ACTORS {
                world.obey();
            }
            let end = if stopped { End::Stopped } else { End::Complete };
            let outcome = world.outcome.as_ref().expect("it ended");
            assert_eq!((&outcome.end, outcome.saved.is_some()), (&end, true), "{order:?}");
            assert!(world.deaths().is_empty() && world.spawned.values().all(|&starts| starts == 1));
        }
    }
}

#[test]
fn a_stop_when_one_has_already_left_lets_the_others_save() {
    let mut world = gang();
    while world.agreed.is_none() {
        world.step(true);
    }
    world.finishes(2, true);
    world.exit(Process::Learner(2), Exit::Code(0));
    world.feed(Event::Stop);
    assert_eq!(world.announced.directive, directive::STOP);
    assert!(world.killed.is_empty());
    train(&mut world);
    assert_eq!(world.outcome.map(|outcome| outcome.end), Some(End::Complete));
}

#[test]
fn one_that_left_comes_back_when_rank_0_dies_before_it_has_saved() {
    let mut world = gang();
    while world.agreed.is_none() {
        world.step(true);
    }
    world.finishes(1, true);
    world.exit(Process::Learner(1), Exit::Code(0));
    world.exit(LEARNER, Exit::Signal(9));
    assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [Process::Learner(2)]);
    world.obey();
    assert!(world.ranks().all(|rank| world.spawned[&Process::Learner(rank)] == 2));
    train(&mut world);
    assert_eq!(world.outcome.map(|outcome| outcome.end), Some(End::Complete));
}

#[test]
fn a_learner_that_dies_while_they_save_is_named() {
    for rank in 0..3 {
        let mut world = gang();
        world.feed(Event::Stop);
        world.exit(Process::Learner(rank), Exit::Signal(11));
        // What the others do then is their own affair.
        world.exit(Process::Learner((rank + 1) % 3), Exit::Code(1));
        assert_eq!(world.killed.len(), 1);
        for _ in 0..=ACTORS {
            world.obey();
        }
        let Some(Outcome { end: End::Failed(reason), saved: None }) = &world.outcome else {
            panic!("{:?}", world.outcome)
        };
        assert!(reason.starts_with(&format!("learner-{rank} died while it saved (signal 11 (SIGSEGV))")), "{reason}");
        assert_eq!(world.deaths().len(), 1);
        assert!(world.spawned.values().all(|&starts| starts == 1));
    }
}

#[test]
fn a_learner_that_dies_after_rank_0_has_saved_changes_nothing() {
    let mut world = gang();
    world.feed(Event::Stop);
    while world.agreed.is_none() {
        world.step(true);
    }
    world.finishes(0, false);
    world.exit(Process::Learner(1), Exit::Signal(11));
    world.exit(LEARNER, Exit::Code(0));
    world.exit(Process::Learner(2), Exit::Code(1));
    for _ in 0..ACTORS {
        world.obey();
    }
    let outcome = world.outcome.as_ref().expect("it ended");
    assert_eq!((&outcome.end, outcome.saved.is_some(), world.deaths().len()), (&End::Stopped, true, 0));
}

#[test]
fn a_stop_in_the_middle_of_a_fall_waits_for_nobody() {
    let mut world = gang();
    world.exit(Process::Learner(1), Exit::Signal(9));
    world.feed(Event::Stop);
    for _ in 0..2 + ACTORS {
        world.obey();
    }
    assert_eq!(world.outcome, Some(Outcome { end: End::Stopped, saved: None }));
    assert!(world.spawned.values().all(|&starts| starts == 1));
}

#[test]
fn silent_learners_are_killed_together() {
    let mut world = gang();
    for _ in 0..3000 {
        if world.killed.is_empty() {
            world.pass(Duration::from_secs(1));
        }
    }
    assert_eq!(world.killed.iter().copied().collect::<Vec<_>>(), [0, 1, 2].map(Process::Learner));
    for _ in 0..3 {
        world.obey();
    }
    assert_eq!(world.deaths().len(), 1);
    assert!(world.reports[0].starts_with("the 3 learners finished neither a rollout nor an update for "));
    assert!(world.ranks().all(|rank| world.spawned[&Process::Learner(rank)] == 2));
}

#[test]
fn a_learner_that_is_never_ready_or_connected_is_named() {
    let mut world = World::with(2);
    world.learner_step(0, true);
    for _ in 0..200 {
        if world.outcome.is_none() {
            world.pass(Duration::from_secs(1));
            world.obey();
        }
    }
    let Some(Outcome { end: End::Failed(reason), .. }) = world.outcome else { panic!("{:?}", world.outcome) };
    assert!(reason.starts_with("learner-1 was not ready after 120 s"), "{reason}");

    let mut world = World::with(2);
    for rank in [1, 0, 0] {
        world.learner_step(rank, true);
    }
    while !world.supervisor.is_stopping() {
        world.pass(Duration::from_secs(1));
    }
    assert!(world.reports.last().is_some_and(|text| text.starts_with("not all of its actors had answered learner-1 ")));
    train(&mut world);
    assert!(world.outcome.is_some_and(|outcome| outcome.saved.is_some()), "all are there, so they save");
}
