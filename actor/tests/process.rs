//! The actor program against a stand-in for the learner, over real shared memory, with real kills.

// A test is a place to unwrap; clippy knows only the functions marked as one, not their helpers.
#![allow(clippy::unwrap_used)]

use proto::camera::{SUMS_PIXELS, sum_windows};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose};
use proto::record::{HOLD, RecordHeader, flag};
use proto::task::Layout;
use simulator::robot::action::Action;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use wire::message::{ActionHeader, EnvironmentState, Halves, Line, RestoreHeader, observation_kind};
use wire::{
    ActionPublisher, Bell, ObservationSubscriber, ReceiptBook, RestorePublisher, Sleeper, UpdateConnections, Wakeup,
    Wire, WireAddress, WireHost, WireShape,
};

const ENVIRONMENTS: u32 = 3;
const ANSWER_DEADLINE: Duration = Duration::from_mins(1);

/// A run folder, the services of one actor, and a learner that chooses actions by a counter.
struct Stand {
    folder: tempfile::TempDir,
    host: WireHost,
    observations: ObservationSubscriber,
    wakeup: Wakeup,
    actions: ActionPublisher,
    restores: RestorePublisher,
    bell: Bell,
    /// The recorder's, which meets actors.
    book: ReceiptBook,
    learner_incarnation: u32,
    /// Next observation that counts, of each half: those before it were answered.
    next: [u64; 2],
    states: Vec<EnvironmentState>,
    /// Bytes of every observation that counted, by (step, environment).
    seen: BTreeMap<(u64, u32), Vec<u8>>,
    hellos: Vec<u32>,
    /// The step at which every environment is told to hold.
    hold_at: Option<u64>,
    /// Whether it answers. If not, it keeps what counts: half, step, records.
    answers: bool,
    kept: Vec<(u32, u64, Vec<Line>)>,
}

impl Stand {
    fn new(test: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::default();
        config.actors.count = 1;
        config.actors.environments_per_actor = ENVIRONMENTS;
        config.episode.max_steps = 9;
        config.recording.depth_share = 0.5;
        std::fs::write(folder.path().join("config.toml"), config.to_toml()).unwrap();
        let address = WireAddress::new(&format!("actor{test}{}", std::process::id()), 1);
        let shape = WireShape::of(&config);
        let host = WireHost::create(&address, shape).unwrap();
        let wire = Wire::join(&address, shape, "learner-0").unwrap();
        Self {
            observations: wire.observation_subscriber(0).unwrap(),
            wakeup: wire.bells().wakeup(Sleeper::Learner(0)),
            actions: wire.action_publisher(0).unwrap(),
            restores: wire.restore_publisher(0).unwrap(),
            bell: wire.bells().bell([Sleeper::Actor(0)]),
            book: ReceiptBook::open(&address, 1).unwrap(),
            folder,
            host,
            learner_incarnation: 1,
            next: [0; 2],
            states: vec![EnvironmentState::start_of(0); ENVIRONMENTS as usize],
            seen: BTreeMap::new(),
            hellos: vec![],
            hold_at: None,
            answers: true,
            kept: vec![],
        }
    }

    fn config(&self) -> PathBuf {
        self.folder.path().join("config.toml")
    }

    fn spawn(&self, incarnation: u32, fault: Option<&str>) -> Actor {
        let mut command = Command::new(env!("CARGO_BIN_EXE_actor"));
        command.args(["--actor", "0", "--lifeline", "--incarnation", &incarnation.to_string()]);
        command.args(["--wire", &self.host.address().to_string()]).arg("--config").arg(self.config());
        if let Some(fault) = fault {
            command.env(wire::fault::VARIABLE, fault);
        }
        Actor(command.stdin(Stdio::piped()).spawn().unwrap())
    }

    fn restore(&self, actor_incarnation: u32) {
        // A subscriber that came after the last send is found by this.
        self.restores.update_connections().unwrap();
        let payload = EnvironmentState::encode(&self.states);
        let mut sample = self.restores.loan_slice_uninit(payload.len()).unwrap();
        *sample.user_header_mut() = RestoreHeader {
            step: self.next,
            stage_version: 7,
            learner_incarnation: self.learner_incarnation,
            actor_incarnation,
        };
        sample.write_from_slice(&payload).send().unwrap();
        self.bell.ring();
    }

    /// Receives and answers until the observation of `step` has come from both halves and was answered.
    fn run_to(&mut self, step: u64) {
        let deadline = Instant::now() + ANSWER_DEADLINE;
        while self.next.iter().any(|&next| next <= step) {
            assert!(Instant::now() < deadline, "no observation of step {step}; next are {:?}", self.next);
            self.wakeup.wait(Duration::from_millis(50));
            self.serve();
        }
    }

    fn serve(&mut self) {
        while let Some(sample) = self.observations.receive().unwrap() {
            let header = *sample.user_header();
            assert_eq!(header.actor, 0);
            if header.kind == observation_kind::HELLO {
                self.hellos.push(header.actor_incarnation);
                self.book.meet(0, header.actor_incarnation);
                self.restore(header.actor_incarnation);
                continue;
            }
            let next = self.next[header.half as usize];
            if header.learner_incarnation != self.learner_incarnation || header.step != next {
                continue;
            }
            let records = sample.payload();
            if self.answers {
                self.answer(header.half, header.step, records);
            } else {
                self.kept.push((header.half, header.step, records.to_vec()));
            }
        }
    }

    /// Answers a half's observations.
    fn answer(&mut self, half: u32, step: u64, records: &[Line]) {
        let range = Halves::of(ENVIRONMENTS).range(half);
        let lines = layout().bytes / size_of::<Line>();
        assert_eq!(records.len(), range.len() * lines);
        let mut actions = vec![];
        for (environment, record) in range.zip(records.chunks_exact(lines)) {
            let record = Line::bytes(record);
            self.seen.insert((step, environment as u32), bytes(record));
            let header = RecordHeader::of(record);
            assert_eq!(header.environment as usize, environment);
            assert_eq!(header.has(flag::EPISODE_START), header.step == 0);
            if header.end().is_some() {
                assert_eq!(header.episode, header.acted_episode + 1);
                self.states[environment] = EnvironmentState::start_of(header.episode);
            }
            let state = &mut self.states[environment];
            assert_eq!((header.episode, header.step), (state.episode, state.action_count()));
            if self.hold_at == Some(step) {
                actions.push(HOLD);
            } else {
                let action = chosen(environment as u32, state);
                state.push(&[action]);
                actions.push(action);
            }
        }
        let mut sample = self.actions.loan_slice_uninit(actions.len()).unwrap();
        *sample.user_header_mut() =
            ActionHeader { step, stage_version: 7, learner_incarnation: self.learner_incarnation, half };
        sample.write_from_slice(&actions).send().unwrap();
        self.bell.ring();
        self.next[half as usize] += 1;
    }

    /// Ends the stand; nothing may be left of it.
    fn end(self) {
        let address = self.host.address().clone();
        drop(self);
        address.sweep().unwrap();
        let left: Vec<_> = std::fs::read_dir("/dev/shm")
            .unwrap()
            .filter_map(|entry| entry.unwrap().file_name().into_string().ok())
            .filter(|name| name.starts_with(address.prefix()))
            .collect();
        assert!(left.is_empty(), "{left:?}");
        assert!(!address.root().exists());
    }
}

/// A child that never outlives its test.
struct Actor(Child);

impl Actor {
    fn kill(mut self) {
        self.0.kill().unwrap();
        self.0.wait().unwrap();
    }

    fn code_within(&mut self, limit: Duration) -> Option<i32> {
        let deadline = Instant::now() + limit;
        while Instant::now() < deadline {
            if let Some(status) = self.0.try_wait().unwrap() {
                return Some(status.code().unwrap_or(-1));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        None
    }
}

impl Drop for Actor {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Any action, Done included, as a function of environment, episode and step alone.
fn chosen(environment: u32, state: &EnvironmentState) -> u8 {
    let id = EnvironmentId::of(0, environment, ENVIRONMENTS);
    let key = Key {
        seed: 5,
        purpose: Purpose::RandomPolicy,
        kitchen: id.kitchen.number(),
        environment,
        episode: state.episode,
        step: state.action_count(),
    };
    Action::ALL[key.stream().below(Action::ALL.len() as u32) as usize].index()
}

fn layout() -> &'static Layout {
    Config::default().spec().layout()
}

/// All that it says: what it has not is whatever lay there.
fn bytes(record: &[u8]) -> Vec<u8> {
    let [whole, sums] = layout().images[..] else { panic!("a frame and its sums") };
    let header = RecordHeader::of(record);
    assert_eq!(header.bulk & 2, 2, "the paper's network averages");
    let recorded = header.has(flag::RECORD_BULK);
    assert_eq!(header.bulk & 1 != 0, recorded, "and needs no more than the sums");
    let mut said = record.to_vec();
    if recorded {
        let mut sums_mm: Box<[u16; SUMS_PIXELS]> = vec![0; SUMS_PIXELS].try_into().unwrap();
        let depth_mm = whole.of(record).try_into().unwrap();
        assert!(sum_windows(depth_mm, &mut sums_mm) && *sums_mm == *sums.of::<u16>(record), "both are one frame");
    } else {
        said[whole.range()].fill(0);
    }
    said
}

fn assert_same(a: &BTreeMap<(u64, u32), Vec<u8>>, b: &BTreeMap<(u64, u32), Vec<u8>>, steps: std::ops::Range<u64>) {
    for step in steps {
        for environment in 0..ENVIRONMENTS {
            let key = (step, environment);
            let at = a[&key].iter().zip(&b[&key]).position(|(a, b)| a != b);
            assert_eq!(at, None, "the observation of step {step}, environment {environment} differs from that byte on");
        }
    }
}

/// What an undisturbed actor says in exchanges 0..=last.
fn undisturbed(test: &str, last: u64) -> BTreeMap<(u64, u32), Vec<u8>> {
    let mut stand = Stand::new(test);
    let actor = stand.spawn(1, None);
    stand.run_to(last);
    actor.kill();
    let seen = std::mem::take(&mut stand.seen);
    stand.end();
    seen
}

#[test]
fn a_killed_actor_and_a_new_learner_change_no_byte() {
    const LAST: u64 = 200;
    let expected = undisturbed("calm", LAST);
    let frames: std::collections::BTreeSet<&[u8]> =
        expected.values().map(|bytes| &bytes[layout().small_bytes..]).collect();
    assert!(frames.len() > 30, "the frames show what happens: {} are different", frames.len());

    let mut stand = Stand::new("rough");
    let mut actor = stand.spawn(1, None);
    // Killed by us, with its answers on the way.
    stand.run_to(57);
    actor.kill();
    stand.host.sweep_dead();
    // Killed by itself at each step of the protocol.
    let faults = [
        "actor.after_hello",
        "actor.before_rebuild",
        "actor.after_rebuild",
        "actor.after_receive:9",
        "actor.before_send:11",
        "actor.after_send:13",
    ];
    let mut incarnation = 2;
    for fault in faults {
        let mut faulty = stand.spawn(incarnation, Some(fault));
        let deadline = Instant::now() + ANSWER_DEADLINE;
        while faulty.0.try_wait().unwrap().is_none() {
            assert!(Instant::now() < deadline, "{fault} was never reached");
            stand.wakeup.wait(Duration::from_millis(20));
            stand.serve();
        }
        stand.host.sweep_dead();
        incarnation += 1;
    }
    actor = stand.spawn(incarnation, None);
    stand.run_to(120);
    assert_same(&expected, &stand.seen, 0..120);
    assert!((1..=incarnation).all(|n| stand.hellos.contains(&n)), "{:?}", stand.hellos);

    // A learner that comes back from a checkpoint: the actor, still running, rewinds.
    let (next, states) = (stand.next, stand.states.clone());
    stand.run_to(150);
    (stand.next, stand.states) = (next, states);
    stand.learner_incarnation = 2;
    let rewound = next[0].max(next[1]);
    stand.seen.retain(|&(step, _), _| step < rewound);
    stand.restore(0);
    stand.run_to(LAST);
    assert_same(&expected, &stand.seen, 0..LAST);
    actor.kill();
    stand.end();
}

/// A learner that has the predecessor's observations answers them at any moment, also right after the restore.
#[test]
fn actions_that_come_together_with_their_restore_are_not_lost() {
    let expected = undisturbed("apart", 9);
    let mut stand = Stand::new("together");
    let actor = stand.spawn(1, None);
    stand.run_to(3);
    // Steps 0 to 3 are answered; those of step 4 are kept, and their sender dies.
    stand.answers = false;
    let deadline = Instant::now() + ANSWER_DEADLINE;
    while stand.kept.len() < 2 {
        assert!(Instant::now() < deadline, "no observations of step 4");
        stand.wakeup.wait(Duration::from_millis(20));
        stand.serve();
    }
    actor.kill();
    stand.host.sweep_dead();

    // Its successor, held in the middle of a look, gets its state and the answers.
    let mut actor = stand.spawn(2, Some("hold=actor.mid_receive:2"));
    let stat = format!("/proc/{}/stat", actor.0.id());
    while !std::fs::read_to_string(&stat).unwrap().rsplit_once(") ").unwrap().1.starts_with('T') {
        assert!(Instant::now() < deadline && actor.0.try_wait().unwrap().is_none(), "it was never held");
        std::thread::sleep(Duration::from_millis(2));
    }
    stand.serve();
    assert_eq!(stand.hellos.last(), Some(&2));
    stand.answers = true;
    for (half, step, records) in std::mem::take(&mut stand.kept) {
        stand.answer(half, step, &records);
    }
    let pid = rustix::process::Pid::from_child(&actor.0);
    rustix::process::kill_process(pid, rustix::process::Signal::CONT).unwrap();
    stand.run_to(9);
    assert_same(&expected, &stand.seen, 0..10);
    actor.kill();
    stand.end();
}

#[test]
fn hold_shows_the_same_again_without_a_transition() {
    let mut stand = Stand::new("hold");
    stand.hold_at = Some(4);
    let actor = stand.spawn(1, None);
    stand.run_to(6);
    for environment in 0..ENVIRONMENTS {
        let (before, held) = (&stand.seen[&(4, environment)], &stand.seen[&(5, environment)]);
        let layout = layout();
        let header = |bytes: &[u8]| bytemuck::pod_read_unaligned::<RecordHeader>(&bytes[..size_of::<RecordHeader>()]);
        let mut expected = header(before);
        expected.hold();
        assert_eq!(header(held), expected, "nothing was done, and what is seen stays");
        let at = (layout.previous_action.offset..held.len())
            .find(|at| !layout.of_action.contains(at) && before[*at] != held[*at]);
        assert_eq!(at, None, "what is seen stays, but for that byte");
        let done = |bytes: &[u8]| {
            [layout.action.range(), layout.of_action.clone()]
                .into_iter()
                .any(|range| bytes[range].iter().any(|&b| b != 0))
        };
        assert!(!done(held) && done(&stand.seen[&(6, environment)]), "nothing was done, and it goes on");
    }
    actor.kill();
    stand.end();
}

#[test]
fn it_ends_with_its_lifeline_also_when_nobody_reads() {
    let stand = Stand::new("lifeline");
    let mut actor = stand.spawn(1, None);
    // Nobody receives: HELLOs fill the learner's queue and the next one blocks.
    let deadline = Instant::now() + ANSWER_DEADLINE;
    while !stand.observations.has_samples().unwrap() {
        assert!(Instant::now() < deadline, "no HELLO");
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(700));
    let interrupt = Command::new("kill").args(["-INT", &actor.0.id().to_string()]).status().unwrap();
    assert!(interrupt.success());
    assert_eq!(actor.code_within(Duration::from_millis(200)), None, "Ctrl-C is the orchestrator's");
    drop(actor.0.stdin.take());
    assert_eq!(actor.code_within(Duration::from_secs(1)), Some(0));
    stand.end();
}

#[test]
fn bad_settings_are_named_once() {
    let stand = Stand::new("bad");
    let address = stand.host.address().to_string();
    let config = stand.config();
    let config = config.to_str().unwrap();
    let run = |actor: &str, config: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_actor"))
            .args(["--actor", actor, "--wire", &address, "--config", config])
            .stdin(Stdio::null())
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let (code, text) = run("4", config);
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("there is no actor 4"), "{text}");
    let (code, text) = run("0", "/nowhere/config.toml");
    assert_eq!(code, Some(1), "{text}");
    assert_eq!(text.matches("/nowhere/config.toml").count(), 1, "{text}");
    stand.end();
}

/// Each takes seconds: whoever waits for many sees how far it is.
#[test]
fn a_sheet_of_many_kitchens_says_how_far_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("six.png");
    let mut command = Command::new(env!("CARGO_BIN_EXE_actor"));
    command.args(["kitchens", "sheet", "--kitchens", "1,2,3,4,5,6", "--width", "320", "--out"]).arg(&out);
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && out.is_file(), "{said}");
    assert_eq!(said, "6 kitchens are built and drawn, each for some seconds\n5 of 6 kitchens are drawn\n");
}
