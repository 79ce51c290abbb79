//! A run's surroundings inside the test process: the services, stand-in actors on threads, and the orchestrator's
//! part of the conversation with a real learner process.

#![expect(clippy::unwrap_used, reason = "a test helper fails its test by panicking")]

pub mod environment;

use environment::{FakeEnvironment, mix};
use proto::config::{Config, Memory, StageConfig};
use proto::episode::EnvironmentId;
use proto::event::LearnerEvent;
use proto::run_folder::RunFolder;
use proto::stage::{position_at, total_frames};
use proto::task::Spec;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use wire::message::{
    EnvironmentState, Halves, Line, ObservationHeader, StageAnnouncement, directive, observation_kind,
};
use wire::{
    Announcer, ObservationPublisher, Receipt, ReceiptBook, Sleeper, Wire, WireAddress, WireHost, WireShape, Written,
};

/// Longest that one learner process may take.
const DEADLINE: Duration = Duration::from_mins(2);

/// A small configuration: both halves of an actor, two stages, budgets that are no multiple of anything.
pub fn tiny() -> Config {
    let mut config = Config::resolve("demo", None).unwrap();
    config.seed = 3;
    config.actors.count = 2;
    config.actors.environments_per_actor = 3;
    config.episode.max_steps = 7;
    config.network.hidden = 16;
    config.ppo.rollout_steps = 4;
    config.ppo.epochs = 1;
    config.learner.device = proto::config::DeviceChoice::Cpu;
    config.learner.threads = 1;
    config.learner.actor_deadline_s = 30.0;
    config.checkpoint.interval_s = 0.0;
    // There is no recorder here, whose receipts a learner would wait for.
    config.recording.enabled = false;
    config.stages = vec![
        StageConfig { name: "I".into(), reward: "r".into(), frames: 62 },
        StageConfig { name: "II".into(), reward: "r_prime".into(), frames: 40 },
    ];
    config
}

/// The same with a task of numbers alone.
pub fn tiny_numbers(memory: Memory) -> Config {
    Spec::declare(include_str!("numbers.toml")).unwrap();
    let task = "task = \"numbers\"\n";
    let mut config = Config::resolve_with("gym", Some((task, "a test"))).unwrap();
    config.network.memory = memory;
    config.network.mlp = vec![12, 8];
    config.network.previous_action = memory == Memory::Gru;
    let Config { seed, actors, episode, learner, checkpoint, recording, stages, .. } = tiny();
    config.network.hidden = 16;
    config.ppo.rollout_steps = 4;
    config.ppo.minibatches = 2;
    (config.seed, config.actors, config.learner, config.checkpoint) = (seed, actors, learner, checkpoint);
    (config.recording, config.stages) = (recording, stages);
    config.stages[1].reward = "r".into();
    config.episode.max_steps = episode.max_steps;
    config
}

/// The same where the critic alone is given where the door is.
pub fn tiny_privileged(memory: Memory) -> Config {
    let text = include_str!("numbers.toml").replacen("\"numbers\"", "\"privileged_numbers\"", 1);
    let [observed, privileged] = ["observation", "privileged"].map(|role| format!("\"door\"\nrole = \"{role}\""));
    Spec::declare(&text.replacen(&observed, &privileged, 1)).unwrap();
    Config { task: "privileged_numbers".to_owned(), ..tiny_numbers(memory) }
}

/// A run folder with the services of one orchestrator incarnation and its actors.
pub struct Rig {
    pub config: Config,
    pub folder: tempfile::TempDir,
    address: WireAddress,
    host: Option<WireHost>,
    stage: Option<Announcer>,
    version: u64,
    /// Of the recorder, where there is one.
    book: Option<ReceiptBook>,
    learners: u32,
    actors: Vec<StandIn>,
}

/// How a learner process ended.
#[derive(Debug)]
pub struct Ended {
    pub status: ExitStatus,
    pub events: Vec<LearnerEvent>,
    pub stderr: String,
}

impl Ended {
    /// Frames, weights and completeness of its last word.
    pub fn finished(&self) -> (u64, String, bool) {
        match self.events.last() {
            Some(LearnerEvent::Finished { frames, weights, complete, .. }) => (*frames, weights.clone(), *complete),
            other => panic!("the learner's last word is {other:?}, {}: {}", self.status, self.stderr),
        }
    }
}

/// What happens to a learner on its way.
pub enum Plan<'a> {
    /// Nothing.
    Undisturbed,
    /// It kills itself at a fault point.
    Fault(&'a str),
    /// STOP is announced when it says that this rollout is trained.
    StopAfter(u64),
    /// Its lifeline is cut when it says that this rollout is collected, before that is recorded.
    CutLifelineUnwritten(u64),
    /// The recorder takes nothing.
    LoseReceipts,
    /// Nothing, but the recording fails with this rollout; STOP is announced.
    FailRecording(u64),
    /// An actor dies when the learner says that this rollout is trained, and is started again.
    CrashActorAfter(u64, u32),
    /// An actor dies for good then.
    LoseActorAfter(u64, u32),
    /// From then on an actor's goal sensor says what is no number.
    PoisonActorAfter(u64, u32),
}

impl Rig {
    pub fn new(name: &str, config: Config) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("config.toml"), config.to_toml()).unwrap();
        std::fs::write(RunFolder::new(folder.path()).task(), config.spec().text()).unwrap();
        let address = WireAddress::new(&short(name), 1);
        let (host, stage, book, actors) = (None, None, None, vec![]);
        let mut rig = Self { config, folder, address, host, stage, version: 0, book, learners: 0, actors };
        rig.open();
        rig
    }

    /// Creates the services and starts the actors.
    fn open(&mut self) {
        let shape = WireShape::of(&self.config);
        let host = WireHost::create(&self.address, shape).unwrap();
        self.stage = Some(host.wire().announcer().unwrap());
        self.host = Some(host);
        self.version = 0;
        let actors = shape.shares.actors();
        self.book = self.config.recording.enabled.then(|| ReceiptBook::open(&self.address, actors).unwrap());
        self.actors = (0..actors).map(|actor| StandIn::start(&self.address, &self.config, actor, 1)).collect();
    }

    pub fn run_folder(&self) -> RunFolder {
        RunFolder::new(self.folder.path())
    }

    /// Starts a learner and plays the orchestrator until it ends.
    pub fn learner(&mut self, plan: &Plan) -> Ended {
        self.learners += 1;
        if !matches!(plan, Plan::LoseReceipts) {
            self.take_everything();
        }
        // With fewer open files than it needs, unless it raises that limit itself.
        let mut command = Command::new("sh");
        command
            .args(["-c", "ulimit -Sn 64 && exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_learner")])
            .args(self.config.evaluation.is_some().then_some("evaluate"))
            .arg("--run")
            .arg(self.folder.path())
            .args(["--wire", &self.address.to_string(), "--lifeline"])
            .args(["--incarnation", &self.learners.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        if let Plan::Fault(point) = plan {
            command.env(wire::fault::VARIABLE, point);
        }
        let mut child = command.spawn().unwrap();
        let mut lifeline = child.stdin.take();
        let mut stderr = child.stderr.take().unwrap();
        let words = std::thread::spawn(move || {
            let mut text = String::new();
            stderr.read_to_string(&mut text).unwrap();
            text
        });
        let lines = read_events(&mut child);
        let began = Instant::now();
        let mut events = vec![];
        loop {
            match lines.recv_timeout(Duration::from_millis(20)) {
                Ok(event) => {
                    self.answer(&event, plan, &mut lifeline);
                    events.push(event);
                }
                Err(RecvTimeoutError::Timeout) => self.stage.as_ref().unwrap().update().unwrap(),
                Err(RecvTimeoutError::Disconnected) => break,
            }
            if began.elapsed() > DEADLINE {
                child.kill().unwrap();
                child.wait().unwrap();
                panic!("the learner hangs after {:?}: {}", events.last(), words.join().unwrap());
            }
        }
        let status = child.wait().unwrap();
        self.host.as_ref().unwrap().sweep_dead();
        Ended { status, events, stderr: words.join().unwrap() }
    }

    /// The recorder has whatever actors may send to this learner.
    fn take_everything(&self) {
        let Some(book) = &self.book else { return };
        let receipt = Receipt { learner_incarnation: self.learners, step: 1 << 30 };
        for actor in 0..self.config.actors.count {
            book.take(actor, 0, receipt);
            book.take(actor, 1, receipt);
        }
    }

    /// The recorder hears of a collected rollout.
    fn record(&mut self, rollout: u64, plan: &Plan, lifeline: &mut Option<std::process::ChildStdin>) {
        match (plan, &self.book) {
            (Plan::CutLifelineUnwritten(unwritten), _) if *unwritten == rollout => *lifeline = None,
            (Plan::FailRecording(failed), Some(book)) if *failed == rollout => {
                book.fail();
                self.say(rollout + 1, 0, directive::STOP);
            }
            (_, Some(book)) => book.write(Written { learner_incarnation: self.learners, rollout: rollout + 1 }),
            _ => {}
        }
    }

    fn answer(&mut self, event: &LearnerEvent, plan: &Plan, lifeline: &mut Option<std::process::ChildStdin>) {
        match *event {
            LearnerEvent::Ready { rollout, frames, .. } => self.announce(rollout, frames),
            LearnerEvent::RolloutCollected { rollout, frames, .. } => {
                self.record(rollout, plan, lifeline);
                let stop = matches!(plan, Plan::StopAfter(after) | Plan::FailRecording(after) if *after == rollout);
                if !stop {
                    self.announce(rollout + 1, frames);
                } else if self.config.ppo.overlap {
                    // The update is reported when the next rollout is collected, or is not to be.
                    self.say(rollout + 1, 0, directive::STOP);
                }
            }
            LearnerEvent::RolloutTrained { rollout, .. } => match plan {
                Plan::StopAfter(after) if *after == rollout => self.say(rollout + 1, 0, directive::STOP),
                Plan::CrashActorAfter(after, actor) if *after == rollout => {
                    let old = &mut self.actors[*actor as usize];
                    old.stop();
                    *old = StandIn::start(&self.address, &self.config, *actor, old.incarnation + 1);
                }
                Plan::PoisonActorAfter(after, actor) if *after == rollout => {
                    self.actors[*actor as usize].poisoned.store(true, Ordering::Relaxed);
                }
                Plan::LoseActorAfter(after, actor) if *after == rollout => self.actors[*actor as usize].stop(),
                _ => {}
            },
            _ => {}
        }
    }

    fn announce(&mut self, rollout: u64, frames: u64) {
        if let Some(position) = position_at(&self.config.stages, frames) {
            self.say(rollout, position.stage as u32, directive::TRAIN);
        }
    }

    fn say(&mut self, rollout: u64, stage: u32, directive: u32) {
        self.version += 1;
        let announcement = StageAnnouncement { version: self.version, rollout, stage, directive };
        self.stage.as_ref().unwrap().announce(announcement).unwrap();
    }

    /// A new orchestrator incarnation: new services, new actors, the same run folder.
    pub fn next_incarnation(&mut self, number: u32) {
        self.close();
        self.address = WireAddress::new(&short(&number.to_string()), number);
        self.open();
    }

    fn close(&mut self) {
        self.actors.iter_mut().for_each(StandIn::stop);
        self.stage = None;
        self.host = None;
        self.address.sweep().unwrap();
    }

    pub fn budget(&self) -> u64 {
        total_frames(&self.config.stages)
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.close();
    }
}

fn read_events(child: &mut Child) -> Receiver<LearnerEvent> {
    let (sender, receiver) = channel();
    let output = BufReader::new(child.stdout.take().unwrap());
    std::thread::spawn(move || {
        for line in output.lines() {
            let line = line.unwrap();
            let event = serde_json::from_str(&line).unwrap_or_else(|error| panic!("not an event: {line}: {error}"));
            if sender.send(event).is_err() {
                break;
            }
        }
    });
    receiver
}

/// A stand-in actor on a thread. Stopping it is its death: its ports and all it held are gone.
struct StandIn {
    incarnation: u32,
    stop: Arc<AtomicBool>,
    poisoned: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl StandIn {
    fn start(address: &WireAddress, config: &Config, number: u32, incarnation: u32) -> Self {
        let [stop, poisoned] = [(); 2].map(|()| Arc::new(AtomicBool::new(false)));
        let (address, config, flags) = (address.clone(), config.clone(), [stop.clone(), poisoned.clone()]);
        let thread = std::thread::spawn(move || Acting::new(&address, &config, number, incarnation, flags).run());
        Self { incarnation, stop, poisoned, thread: Some(thread) }
    }

    fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take()
            && let Err(panic) = thread.join()
            && !std::thread::panicking()
        {
            std::panic::resume_unwind(panic);
        }
    }
}

impl Drop for StandIn {
    fn drop(&mut self) {
        self.stop();
    }
}

struct Acting {
    wire: Wire,
    config: Config,
    number: u32,
    incarnation: u32,
    stop: Arc<AtomicBool>,
    poisoned: Arc<AtomicBool>,
    following: u32,
    steps: [u64; 2],
    environments: Vec<FakeEnvironment>,
}

/// Node names must differ for a restarted actor only in logs, but they cost nothing.
static NODES: AtomicU32 = AtomicU32::new(0);

impl Acting {
    fn new(
        address: &WireAddress,
        config: &Config,
        number: u32,
        incarnation: u32,
        [stop, poisoned]: [Arc<AtomicBool>; 2],
    ) -> Self {
        let node = NODES.fetch_add(1, Ordering::Relaxed);
        let wire = Wire::join(address, WireShape::of(config), &format!("actor-{number}-{node}")).unwrap();
        let config = config.clone();
        Self { wire, config, number, incarnation, stop, poisoned, following: 0, steps: [0; 2], environments: vec![] }
    }

    fn run(mut self) {
        let restores = self.wire.restore_subscriber(self.number).unwrap();
        let actions = self.wire.action_subscriber(self.number).unwrap();
        let wakeup = self.wire.bells().wakeup(Sleeper::Actor(self.number));
        let observations = self.wire.observation_publisher(self.number).unwrap();
        let bell = self.wire.observations_bell(self.number);
        let halves = Halves::of(self.config.actors.environments_per_actor);
        let mut cried: Option<Instant> = None;
        let mut unsent: Vec<u32> = vec![];
        while !self.stop.load(Ordering::Relaxed) {
            let due = cried.is_none_or(|at| at.elapsed() > Duration::from_millis(200));
            if self.following == 0 && due {
                cried = Some(Instant::now());
                self.send(&observations, observation_kind::HELLO, 0);
                bell.ring();
            }
            while let Some(sample) = restores.receive().unwrap() {
                let header = sample.user_header();
                let meant = header.actor_incarnation == 0 || header.actor_incarnation == self.incarnation;
                if meant && header.learner_incarnation > self.following {
                    self.following = header.learner_incarnation;
                    self.steps = header.step;
                    let per_actor = self.config.actors.environments_per_actor;
                    let rebuild = |(e, state)| {
                        let id = EnvironmentId::of(self.number, e as u32, per_actor);
                        FakeEnvironment::rebuild(self.config.spec(), id, self.config.episode.max_steps, state)
                    };
                    let states = EnvironmentState::decode(sample.payload(), 1).unwrap();
                    self.environments = states.iter().enumerate().map(rebuild).collect();
                    unsent = (0..halves.count()).collect();
                }
            }
            while let Some(sample) = actions.receive().unwrap() {
                let header = sample.user_header();
                let step = &mut self.steps[header.half as usize];
                if header.learner_incarnation == self.following && header.step == *step {
                    *step += 1;
                    for (e, &action) in halves.range(header.half).zip(sample.payload()) {
                        self.environments[e].act(action);
                    }
                    unsent.push(header.half);
                }
            }
            let due = unsent.len();
            unsent.retain(|&half| !self.send(&observations, observation_kind::OBSERVATIONS, half));
            (unsent.len()..due).for_each(|_| bell.ring_counted());
            wakeup.wait(Duration::from_millis(if unsent.is_empty() { 20 } else { 2 }));
        }
    }

    /// True when somebody received it.
    fn send(&self, publisher: &ObservationPublisher, kind: u32, half: u32) -> bool {
        let halves = Halves::of(self.config.actors.environments_per_actor);
        let range = halves.range(half);
        let shape = self.wire.shape();
        let mut sample = publisher.loan_slice_uninit(shape.lines(range.len())).unwrap();
        *sample.user_header_mut() = ObservationHeader {
            step: self.steps[half as usize],
            kind,
            actor: self.number,
            actor_incarnation: self.incarnation,
            learner_incarnation: self.following,
            half,
            ..ObservationHeader::default()
        };
        let mut sample = sample.write_from_fn(|_| Line([0; 64]));
        let named = |name| self.config.spec().channel(name).unwrap().1;
        for (lines, e) in sample.payload_mut().chunks_exact_mut(shape.record_lines).zip(range) {
            let Some(environment) = self.environments.get(e) else { continue };
            let small = environment.observe(e as u32);
            lines[..small.len()].copy_from_slice(&small);
            let record = Line::bytes_mut(lines);
            if self.config.spec().layout().images.is_empty() {
                continue;
            }
            if self.poisoned.load(Ordering::Relaxed) {
                named("goal_m").of_mut(record)[1] = f32::NAN;
            }
            let hash = environment.hash();
            for (row, line) in named("depth_mm").of_mut::<u16>(record).chunks_mut(224).enumerate() {
                line.fill((mix([hash, row as u64]) % 4000) as u16);
            }
        }
        sample.send().unwrap() > 0
    }
}

/// A short run id: paths of sockets have little room.
fn short(name: &str) -> String {
    format!("t{name}{:x}", std::process::id())
}
