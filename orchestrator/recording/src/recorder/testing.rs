//! Records as tests need them, and an actor that sends them.

use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::record::{End, RecordHeader};
use proto::task::{Field, Spec};
use std::time::{Duration, Instant};
use wire::message::{Halves, Line, ObservationHeader, observation_kind};
use wire::{Bell, ObservationPublisher, Sleeper, Wire, WireAddress, WireShape};

/// Length of every test episode, steps.
pub const EPISODE_STEPS: u32 = 5;

/// The shape of so many processes.
pub fn shape(shares: proto::shares::Shares, environments_per_actor: u32) -> WireShape {
    WireShape::new(shares, environments_per_actor, task())
}

fn task() -> &'static Spec {
    Config::default().spec()
}

pub struct Record(pub Vec<Line>);

impl Record {
    pub fn header(&self) -> &RecordHeader {
        RecordHeader::of(Line::bytes(&self.0))
    }

    pub fn header_mut(&mut self) -> &mut RecordHeader {
        RecordHeader::of_mut(Line::bytes_mut(&mut self.0))
    }

    /// Numbers of a channel.
    pub fn reals(&mut self, name: &str) -> &mut [f32] {
        field(name).of_mut(Line::bytes_mut(&mut self.0))
    }

    /// Whole numbers of a channel.
    pub fn wholes(&mut self, name: &str) -> &mut [u32] {
        field(name).of_mut(Line::bytes_mut(&mut self.0))
    }

    pub fn depth_mm(&mut self) -> &mut [u16] {
        field("depth_mm").of_mut(Line::bytes_mut(&mut self.0))
    }

    /// The last action.
    pub fn action(&mut self) -> &mut u8 {
        &mut Line::bytes_mut(&mut self.0)[task().layout().action.offset]
    }

    /// What is seen after `step` steps of an episode.
    fn see(&mut self, episode: u32, step: u32) {
        self.wholes("current_target")[0] = episode % 6;
        for (name, numbers) in [
            ("wrist_to_object_m", [0.3, 0.01 * step as f32, 0.4]),
            ("object_to_goal_m", [0.0, episode as f32, 0.01 * step as f32]),
            ("wrist_position_m", [0.0, 1.0, 0.3]),
            ("target_position_m", [1.0, 1.0, 1.0]),
            ("goal_position_m", [2.0, 1.0, 1.0]),
        ] {
            self.reals(name).copy_from_slice(&numbers);
        }
    }

    /// What action `step` of an episode did.
    fn act(&mut self, episode: u32, step: u32) {
        let last = step + 1 == EPISODE_STEPS;
        *self.action() = action(episode, step) as u8;
        let disturbance_m = 0.002 * (step + 1) as f32;
        for (name, number) in [
            ("disturbance_progress_m", -0.002),
            ("goal_success", f32::from(u8::from(last))),
            ("disturbance_m", disturbance_m),
            ("peak_disturbance_m", disturbance_m),
            ("wrist_object_m", 0.5),
            ("object_goal_m", 1.0),
            ("farthest_m", 0.05),
            ("peak_farthest_m", 0.05),
        ] {
            self.reals(name)[0] = number;
        }
        for (name, number) in
            [("disturbed_objects", 1), ("ever_disturbed_objects", 1), ("target", episode % 6), ("held", last.into())]
        {
            self.wholes(name)[0] = number;
        }
    }
}

fn field(name: &str) -> Field {
    task().channel(name).unwrap().1
}

/// The action that test episodes take.
pub fn action(episode: u32, step: u32) -> u32 {
    (episode * 7 + step) % 21
}

/// The state hash after `step` steps.
pub fn hash(episode: u32, step: u32) -> u64 {
    (u64::from(episode) << 32 | u64::from(step)).wrapping_mul(0x9E37_79B9_7F4A_7C15)
}

/// What was done and is seen after `exchange` actions, all of them taken.
fn record(environment: u32, exchange: u64) -> Record {
    let mut record = Record(vec![Line([0; 64]); task().layout().bytes / size_of::<Line>()]);
    *record.header_mut() = header(environment, exchange);
    if let Some((episode, step)) = exchange.checked_sub(1).map(position) {
        record.act(episode, step);
    }
    let (episode, step) = position(exchange);
    record.see(episode, step);
    for (index, depth_mm) in record.depth_mm().iter_mut().enumerate() {
        *depth_mm = (index % FRAME_SIDE) as u16 + exchange as u16;
    }
    record
}

fn header(environment: u32, exchange: u64) -> RecordHeader {
    let mut header = RecordHeader { environment, bulk: 1, ..RecordHeader::default() };
    header.begin(0, hash(0, 0), false);
    if let Some((episode, step)) = exchange.checked_sub(1).map(position) {
        (header.episode, header.step) = (episode, step);
        header.act(hash(episode, step + 1), (step + 1 == EPISODE_STEPS).then_some(End::Terminated));
        if header.end().is_some() {
            header.begin(episode + 1, hash(episode + 1, 0), false);
        }
    }
    header
}

fn position(exchange: u64) -> (u32, u32) {
    let steps = u64::from(EPISODE_STEPS);
    ((exchange / steps) as u32, (exchange % steps) as u32)
}

/// An actor that sends what a test asks for.
pub struct FakeActor {
    publisher: ObservationPublisher,
    bell: Bell,
    actor: u32,
    halves: Halves,
    _wire: Wire,
}

impl FakeActor {
    /// Joins as actor `actor`.
    pub fn join(address: &WireAddress, shape: WireShape, actor: u32) -> Self {
        let wire = Wire::join(address, shape, &format!("actor-{actor:02}")).unwrap();
        Self {
            publisher: wire.observation_publisher(actor).unwrap(),
            // The learner it wakes, too, is the test.
            bell: wire.bells().bell([Sleeper::Recorder]),
            actor,
            halves: Halves::of(shape.environments_per_actor),
            _wire: wire,
        }
    }

    pub fn header(&self, half: u32, learner_incarnation: u32, step: u64) -> ObservationHeader {
        ObservationHeader {
            step,
            stage_version: 1,
            kind: observation_kind::OBSERVATIONS,
            actor: self.actor,
            actor_incarnation: 1,
            learner_incarnation,
            half,
            reserved: 0,
        }
    }

    /// Sends one half's records of an exchange, each passed through `edit`.
    pub fn send(&self, half: u32, learner_incarnation: u32, step: u64, edit: impl Fn(&mut Record)) {
        self.send_as(observation_kind::OBSERVATIONS, half, learner_incarnation, step, edit);
    }

    /// The same as a sample of this kind.
    pub fn send_as(&self, kind: u32, half: u32, learner_incarnation: u32, step: u64, edit: impl Fn(&mut Record)) {
        let range = self.halves.range(half);
        let deadline = Instant::now() + Duration::from_secs(20);
        loop {
            let mut records = Vec::new();
            for environment in range.clone() {
                let mut record = record(environment as u32, step);
                edit(&mut record);
                records.extend(record.0);
            }
            let mut sample = self.publisher.loan_slice_uninit(records.len()).unwrap();
            *sample.user_header_mut() = ObservationHeader { kind, ..self.header(half, learner_incarnation, step) };
            let recipients = sample.write_from_slice(&records).send().unwrap();
            self.bell.ring();
            if recipients == 1 {
                return;
            }
            // A subscriber that has not met this publisher yet is not waited for once its buffer is full: it meets
            // it with its next `receive`.
            assert!(Instant::now() < deadline, "the recorder never connects");
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
