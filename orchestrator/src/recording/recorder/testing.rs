//! Observations as tests need them, and an actor that sends them.

use bytemuck::Zeroable;
use proto::camera::FRAME_SIDE;
use proto::record::{End, RecordHeader};
use proto::reward::RewardParts;
use proto::step::{Current, Transition};
use std::time::{Duration, Instant};
use wire::message::{Halves, Observation, ObservationHeader, frame_part, observation_kind};
use wire::{Bell, ObservationPublisher, Sleeper, Wire, WireAddress, WireShape};

/// Length of every test episode, steps.
pub const EPISODE_STEPS: u32 = 5;

/// What is seen after `step` steps of an episode.
pub fn current(episode: u32, step: u32) -> Current {
    Current {
        holding: 0,
        target: episode % 6,
        previous_action: if step == 0 { 255 } else { action(episode, step - 1) },
        wrist_to_object_m: [0.3, 0.01 * step as f32, 0.4],
        object_to_goal_m: [0.0, episode as f32, 0.01 * step as f32],
        base_position_m: [0.0, 0.0],
        base_yaw_rad: 0.0,
        camera_pitch_rad: 0.0,
        wrist_position_m: [0.0, 1.0, 0.3],
        target_position_m: [1.0, 1.0, 1.0],
        goal_position_m: [2.0, 1.0, 1.0],
    }
}

/// What action `step` of an episode did.
pub fn transition(episode: u32, step: u32) -> Transition {
    let last = step + 1 == EPISODE_STEPS;
    Transition {
        action: action(episode, step),
        reward: RewardParts {
            disturbance_progress_m: -0.002,
            goal_success: f32::from(u8::from(last)),
            ..RewardParts::default()
        },
        disturbance_m: 0.002 * (step + 1) as f32,
        peak_disturbance_m: 0.002 * (step + 1) as f32,
        wrist_object_m: 0.5,
        object_goal_m: 1.0,
        disturbed_objects: 1,
        ever_disturbed_objects: 1,
        farthest_m: 0.05,
        peak_farthest_m: 0.05,
        target: episode % 6,
        holding: last.into(),
    }
}

/// The action that test episodes take.
pub fn action(episode: u32, step: u32) -> u32 {
    (episode * 7 + step) % 21
}

/// The state hash after `step` steps.
pub fn hash(episode: u32, step: u32) -> u64 {
    (u64::from(episode) << 32 | u64::from(step)).wrapping_mul(0x9E37_79B9_7F4A_7C15)
}

/// What was done and is seen after `exchange` actions, all of them taken. `flags` are set besides.
pub fn described(environment: u32, exchange: u64, flags: u32) -> (RecordHeader, Transition, Current) {
    let (episode, step) = position(exchange);
    let mut header = RecordHeader { environment, bulk: frame_part::WHOLE, ..RecordHeader::default() };
    header.begin(episode, hash(episode, 0), false);
    let mut done = Transition::default();
    if let Some((episode, step)) = exchange.checked_sub(1).map(position) {
        (header.episode, header.step) = (episode, step);
        done = transition(episode, step);
        header.act(hash(episode, step + 1), (step + 1 == EPISODE_STEPS).then_some(End::Terminated));
        if header.end().is_some() {
            header.begin(episode + 1, hash(episode + 1, 0), false);
        }
    }
    header.flags |= flags;
    (header, done, current(episode, step))
}

/// The observation after `exchange` actions.
pub fn observation(environment: u32, exchange: u64, flags: u32) -> Observation {
    let (header, transition, current) = described(environment, exchange, flags);
    let depth_mm = std::array::from_fn(|index| (index % FRAME_SIDE) as u16 + exchange as u16);
    Observation { header, transition, current, depth_mm, ..Observation::zeroed() }
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

    /// Header of an exchange.
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

    /// Sends one half's observations of an exchange, each passed through `edit`.
    pub fn send(&self, half: u32, learner_incarnation: u32, step: u64, edit: impl Fn(&mut Observation)) {
        self.send_as(observation_kind::OBSERVATIONS, half, learner_incarnation, step, edit);
    }

    /// The same as a sample of this kind.
    pub fn send_as(&self, kind: u32, half: u32, learner_incarnation: u32, step: u64, edit: impl Fn(&mut Observation)) {
        let range = self.halves.range(half);
        let deadline = Instant::now() + Duration::from_secs(20);
        loop {
            let mut sample = self.publisher.loan_slice_uninit(range.len()).unwrap();
            *sample.user_header_mut() = ObservationHeader { kind, ..self.header(half, learner_incarnation, step) };
            let sample = sample.write_from_fn(|index| {
                let mut observation = observation((range.start + index) as u32, step, 0);
                edit(&mut observation);
                observation
            });
            let recipients = sample.send().unwrap();
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
