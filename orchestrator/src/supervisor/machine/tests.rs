//! The supervisor against a world that crashes, hangs and lies at random.

mod lost_hosts;
mod one_learner;
mod scaling;
mod several_learners;

use super::*;
use crate::supervisor::stage_machine::StageSwitch;
use proptest::prelude::*;
use proto::config::Config;
use proto::event::Timing;
use proto::exit::{EXIT_NON_FINITE, EXIT_UNSAVED};
use proto::kitchen::KitchenId;
use proto::stage::{RolloutShape, position_at};
use std::collections::{BTreeMap, BTreeSet};
use wire::message::{StageAnnouncement, directive};

/// Rank 0, which speaks for all learners.
const LEARNER: Process = Process::Learner(0);
const ACTORS: u32 = 3;
const ROLLOUT_STEPS: usize = 8;
const ENVIRONMENTS: usize = 6;

fn stages() -> Vec<StageConfig> {
    let stage = |name: &str, reward: &str, frames| StageConfig { name: name.into(), reward: reward.into(), frames };
    vec![stage("I", "r", 500), stage("II", "r_prime", 333)]
}

fn deadlines(learners: u32) -> Deadlines {
    let mut config = Config { stages: stages(), ..Config::default() };
    config.actors.count = ACTORS;
    config.learner.count = learners;
    Deadlines::of(&config)
}

impl Supervisor {
    /// True once [`Action::Finish`] was given.
    pub fn is_over(&self) -> bool {
        self.phase == Phase::Over
    }

    /// Whether a stop or an end is being carried out.
    fn is_stopping(&self) -> bool {
        self.phase != Phase::Running
    }
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
    /// That the rollout at which they are is the last of this session; whether the run is complete.
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
            supervisor: Supervisor::new(deadlines(learners), stages()),
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

    /// Learners that have taken this many steps.
    fn after(steps: u32, learners: u32) -> Self {
        let mut world = Self::with(learners);
        for _ in 0..steps {
            world.step(true);
        }
        world
    }

    /// One learner whose rollouts and updates take two seconds each, after this many of both.
    fn quick(steps: u32) -> Self {
        let mut world = Self::new();
        for _ in 0..steps {
            world.pass(Duration::from_secs(2));
            world.step(true);
        }
        world
    }

    /// Why the session failed; nothing was saved.
    fn failed(&self) -> &str {
        match &self.outcome {
            Some(Outcome { end: SessionEnd::Failed(reason), saved: None }) => reason,
            other => panic!("{other:?}"),
        }
    }

    fn feed(&mut self, event: Event) {
        let actions = self.supervisor.on_event(self.now, event);
        self.carry_out(actions);
        let starts: BTreeSet<u32> = self.ranks().map(|rank| self.spawned[&Process::Learner(rank)]).collect();
        assert_eq!(starts.len(), 1, "learners are started together, and meet by their incarnation");
        let gone =
            |rank| !self.up.contains_key(&Process::Learner(rank)) && !self.supervisor.learner_group.has_finished(rank);
        // Once rank 0 has saved, they only have to leave. Who is the reason of another's end is given time to say why.
        let waits = !self.supervisor.is_stopping() && self.supervisor.learner_group.bereaved.is_some();
        if !waits && self.outcome.is_none() && !self.supervisor.learner_group.has_finished(0) && self.ranks().any(gone)
        {
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
                    let allowed = (deadlines(1).restart.in_all as u32 + 1) * (self.high_water_marks + 1) + 1;
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
        self.exit_with(process, exit, "oh");
    }

    fn exit_with(&mut self, process: Process, exit: Exit, last_words: &str) {
        if let Some(incarnation) = self.up.remove(&process) {
            self.told_to_go.remove(&process);
            self.killed.remove(&process);
            self.feed(Event::Exited { process, incarnation, exit, last_words: vec![last_words.into()] });
        }
    }

    /// The last learner's host is gone, with it and the last actor.
    fn lose_last_host(&mut self) {
        let processes = vec![Process::Learner(self.learners - 1), Process::Actor(ACTORS - 1)];
        for process in &processes {
            self.up.remove(process);
            self.told_to_go.remove(process);
            self.killed.remove(process);
        }
        self.feed(Event::HostLost { processes, reason: "host 1 (n1) was lost: its cable".into() });
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
            let (rollout, device) = (rollout as u64, "cpu".to_owned());
            return self.learner(LearnerEvent::Ready { rank, rollout, frames, device, parameters: 1, checkpoint });
        }
        if let Some(complete) = self.agreed {
            return if self.supervisor.learner_group.has_finished(rank) {
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
                here: shape.frames,
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
                self.exit(
                    process,
                    Exit::Code([0, 1, 3, EXIT_LOST_PEERS, EXIT_UNSAVED, 101][usize::from(pick) / 4 % 6]),
                );
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
                25..28 => self.lose_last_host(),
                28..38 => self.feed(Event::Scale { before: pick.is_multiple_of(2).then_some(u64::from(pick)) }),
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
        if let Some(Outcome { end: SessionEnd::Complete, saved }) = outcome {
            prop_assert_eq!(saved.map(|saved| saved.frames), Some(833));
            let last = world.switches.last().expect("it trained in both stages");
            prop_assert_eq!((last.to, last.frames), (1, 500));
        }
    }
}

/// Three learners that have trained three rollouts and saved the last; all else has been said.
fn learner_group() -> World {
    let mut world = World::with(3);
    while world.trained < 3 {
        world.step(true);
    }
    world.reports.clear();
    world
}

fn train(world: &mut World) {
    for _ in 0..200 {
        if world.outcome.is_none() {
            world.step(true);
            world.obey();
        }
    }
}
