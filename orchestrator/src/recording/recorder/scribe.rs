//! Turns observations into messages: the messages of each step and their topics.

use crate::recording::recorder::camera::{self, FrameNames};
use crate::recording::recorder::channels::{Channels, is, vector, whole};
use crate::recording::recorder::held::{self, Held};
use crate::recording::recorder::segment::{SegmentError, Segments, Topic};
use crate::recording::schema::foxglove::{FrameTransforms, Log, RawImage, log};
use crate::recording::schema::stillroom::step::Goal;
use crate::recording::schema::stillroom::{EpisodeEnd, EpisodeStart, LearnerMetrics, StageSwitch, Step, Validation};
use prost::Message;
use prost_types::Timestamp;
use proto::camera::FRAME_SIDE;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::Plan;
use proto::event::Timing;
use proto::kitchen::Kitchens;
use proto::metric;
use proto::record::{End, RecordHeader, flag};
use proto::replay::length_m;
use proto::reward::UNDISTURBED_THRESHOLD_M;
use proto::rota::Rota;
use proto::task::Composition;
use std::collections::BTreeMap;
use wire::WireShape;
use wire::message::{Halves, Line, ObservationHeader};

#[cfg(target_endian = "big")]
compile_error!("16UC1 images are little-endian and are copied as they lie in memory");

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Messages on `/step`.
    pub steps: u64,
    /// Messages on `/episode/end`.
    pub episodes: u64,
    pub depth_frames: u64,
}

/// Figures of one trained rollout, as they arrive from the learner.
#[derive(Debug, Clone)]
pub struct RolloutMetrics {
    /// Rank in the process group.
    pub rank: u32,
    pub rollout: u64,
    /// Frames trained on so far.
    pub frames: u64,
    /// Index of the stage.
    pub stage: u32,
    /// Where the time went.
    pub timing: Timing,
    /// Named figures.
    pub metrics: BTreeMap<String, f64>,
}

/// Writes messages about environments, learner and stages into the segments.
pub struct Scribe {
    segments: Segments,
    topics: Topics,
    environments: Vec<Environment>,
    shape: WireShape,
    incarnation: u32,
    /// r and r′.
    rewards: [Composition; 2],
    channels: Channels,
    failures_only: bool,
    /// Which fixed episodes are played, in an evaluation.
    plan: Option<Plan>,
    /// Which kitchen an environment is in.
    rota: Rota,
    counts: Counts,
    frames_before: Option<u64>,
    /// Reused for every record: all but its images.
    small: Vec<Line>,
    /// Reused for every message.
    buffer: Vec<u8>,
    /// Reused for every frame.
    image: RawImage,
}

struct Topics {
    step: Topic,
    episode_start: Topic,
    episode_end: Topic,
    transforms: Topic,
    metrics: Topic,
    stage: Topic,
    evaluation: Topic,
    log: Topic,
}

/// What the scribe remembers of one environment.
struct Environment {
    /// What it is called where its kitchen does not matter.
    home: EnvironmentId,
    frames: FrameNames,
    depth: Topic,
    calibration: Topic,
    /// Observation that was last described, so that one that comes back after a HOLD is not described again.
    described: Option<(u32, u32, u32)>,
    /// What the goal sensor reads in that observation.
    goal: Option<Goal>,
    /// Transition that was last accounted for: learner incarnation, episode, step. An actor that is restarted during a
    /// HOLD has no record of the HOLD and sends the action before it again, as the next exchange.
    taken: Option<(u32, u32, u32)>,
    returns: Option<Returns>,
    /// What is held back of the episode in progress, where only failures are wanted.
    held: Held,
}

/// Returns of an episode so far; only for one seen from its first step without a gap.
struct Returns {
    episode: u32,
    next_step: u32,
    learner_incarnation: u32,
    r: f64,
    r_prime: f64,
}

impl Scribe {
    /// A scribe for all environments of `shape`.
    pub fn new(mut segments: Segments, shape: WireShape, incarnation: u32, config: &Config) -> Self {
        let topics = Topics {
            step: segments.topic("/step".into(), "stillroom.Step"),
            episode_start: segments.topic("/episode/start".into(), "stillroom.EpisodeStart"),
            episode_end: segments.topic("/episode/end".into(), "stillroom.EpisodeEnd"),
            transforms: segments.topic("/tf".into(), "foxglove.FrameTransforms"),
            metrics: segments.topic("/learner/metrics".into(), "stillroom.LearnerMetrics"),
            stage: segments.topic("/stage".into(), "stillroom.StageSwitch"),
            evaluation: segments.topic("/evaluation".into(), "stillroom.Validation"),
            log: segments.topic("/log".into(), "foxglove.Log"),
        };
        let per_actor = shape.environments_per_actor;
        let kitchens = config.kitchens();
        let environments = (0..shape.shares.actors())
            .flat_map(|actor| (0..per_actor).map(move |index| EnvironmentId::among(kitchens, actor, index, per_actor)))
            .map(|home| {
                let prefix = match kitchens {
                    // As many topics as environments, however many kitchens they come to.
                    Kitchens::Procedural(_) => format!("procedural/{}", home.number),
                    _ => format!("kitchen-{:02}/{}", home.kitchen.number(), home.number),
                };
                // Foxglove pairs an image with the calibration that shares its name up to the last slash.
                let depth = segments.topic(format!("/depth/{prefix}/image"), "foxglove.RawImage");
                let calibration = segments.topic(format!("/depth/{prefix}/calibration"), "foxglove.CameraCalibration");
                let frames = FrameNames::under(&prefix);
                Environment {
                    home,
                    frames,
                    depth,
                    calibration,
                    described: None,
                    goal: None,
                    taken: None,
                    returns: None,
                    held: Held::default(),
                }
            })
            .collect();
        let image = RawImage {
            width: FRAME_SIDE as u32,
            height: FRAME_SIDE as u32,
            encoding: "16UC1".into(),
            step: (FRAME_SIDE * size_of::<u16>()) as u32,
            ..Default::default()
        };
        Self {
            segments,
            topics,
            environments,
            shape,
            incarnation,
            rewards: ["r", "r_prime"].map(|name| config.reward(name)),
            channels: Channels::of(config.spec()),
            small: Vec::new(),
            failures_only: config.recording.failures_only,
            plan: config.evaluation_plan(),
            rota: config.rota(),
            counts: Counts::default(),
            frames_before: None,
            buffer: Vec::new(),
            image,
        }
    }

    /// Describes one sample; returns how many steps it held. `with_transitions` is false where the transitions were
    /// recorded before.
    pub fn observations(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        records: &[Line],
        with_transitions: bool,
    ) -> Result<u64, SegmentError> {
        let first = (header.actor * self.shape.environments_per_actor) as usize;
        let range = Halves::of(self.shape.environments_per_actor).range(header.half);
        let [lines, small_lines] = self.channels.lines();
        let mut small = std::mem::take(&mut self.small);
        let mut steps = 0;
        for (index, record) in range.zip(records.chunks_exact(lines)) {
            // Copied once: what lies in shared memory can change meanwhile.
            small.clear();
            small.extend_from_slice(&record[..small_lines]);
            let copied = Line::bytes(&small);
            if self.outcome(time_ns, header, first + index, copied, with_transitions)? {
                steps += 1;
            }
            self.observation(time_ns, header, first + index, copied, Line::bytes(record))?;
        }
        self.small = small;
        Ok(steps)
    }

    /// Describes what the last action of an environment did, if that is new; whether it was.
    fn outcome(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        record: &[u8],
        with_transitions: bool,
    ) -> Result<bool, SegmentError> {
        let RecordHeader { acted_episode, acted_step, .. } = *RecordHeader::of(record);
        let taken = Some((header.learner_incarnation, acted_episode, acted_step));
        if !RecordHeader::of(record).has(flag::ACTED) || self.environments[environment].taken == taken {
            return Ok(false);
        }
        // At a restore point, too: there the transition is old, but a HOLD may follow.
        self.environments[environment].taken = taken;
        if with_transitions {
            self.step(time_ns, header, environment, record)?;
            if RecordHeader::of(record).end().is_some() {
                self.episode_end(time_ns, header, environment, record)?;
            }
        }
        Ok(with_transitions)
    }

    /// Describes what is seen now, if that is new. `whole`: the record where it lies.
    fn observation(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        record: &[u8],
        whole: &[u8],
    ) -> Result<(), SegmentError> {
        let seen = RecordHeader::of(record);
        let known = &mut self.environments[environment];
        let described = Some((header.learner_incarnation, seen.episode, seen.step));
        if known.described == described {
            return Ok(());
        }
        known.described = described;
        known.goal = Some(self.channels.goal(record));
        if seen.has(flag::EPISODE_START) {
            self.episode_start(time_ns, header, environment, record)?;
        }
        // Both come of one draw in the actor. What is not there is not recorded: the learner refuses it.
        if self.channels.has_frame(seen.bulk) && seen.has(flag::RECORD_BULK) {
            self.depth(time_ns, environment, record, whole)?;
        }
        Ok(())
    }

    /// Figures of a trained rollout.
    pub fn metrics(&mut self, time_ns: u64, trained: &RolloutMetrics) -> Result<(), SegmentError> {
        let mut other = trained.metrics.clone();
        let mut take = |name: &str| other.remove(name);
        let timing = &trained.timing;
        let seconds = timing.simulate_s + timing.infer_s + timing.update_s + timing.other_s;
        // After a rewind the count goes back: no rate then.
        let frames = self.frames_before.and_then(|before| trained.frames.checked_sub(before));
        self.frames_before = Some(trained.frames);
        let message = LearnerMetrics {
            rank: trained.rank,
            rollout: trained.rollout,
            frames: trained.frames,
            stage: trained.stage,
            simulate_s: timing.simulate_s,
            infer_s: timing.infer_s,
            update_s: timing.update_s,
            other_s: timing.other_s,
            frames_per_s: frames.filter(|_| seconds > 0.0).map(|frames| frames as f64 / seconds),
            episode_count: take(metric::EPISODES),
            episode_return: take(metric::RETURN),
            episode_length: take(metric::LENGTH),
            rollout_reward: take(metric::REWARD),
            loss_policy: take(metric::POLICY_LOSS),
            loss_value: take(metric::VALUE_LOSS),
            loss_auxiliary: take(metric::AUXILIARY_LOSS),
            policy_entropy: take(metric::ENTROPY),
            policy_clip_fraction: take(metric::CLIP_FRACTION),
            policy_approximate_kl: take(metric::APPROXIMATE_KL),
            optimizer_gradient_norm: take(metric::GRADIENT_NORM),
            optimizer_learning_rate: take(metric::LEARNING_RATE),
            other,
        };
        self.write(self.topics.metrics, time_ns, &message)
    }

    pub fn stage(&mut self, time_ns: u64, message: &StageSwitch) -> Result<(), SegmentError> {
        self.write(self.topics.stage, time_ns, message)
    }

    /// Figures on the validation kitchens.
    pub fn validation(&mut self, time_ns: u64, message: &Validation) -> Result<(), SegmentError> {
        self.write(self.topics.evaluation, time_ns, message)
    }

    pub fn log(&mut self, time_ns: u64, level: log::Level, process: &str, line: String) -> Result<(), SegmentError> {
        let message = Log {
            timestamp: Some(timestamp(time_ns)),
            level: level.into(),
            message: line,
            name: process.to_owned(),
            ..Default::default()
        };
        self.write(self.topics.log, time_ns, &message)
    }

    /// The segments, to flush, finish or abandon them.
    pub fn segments(&mut self) -> &mut Segments {
        &mut self.segments
    }

    /// The recording ends. What is held of episodes that run is written: the next start goes on with them. An evaluation
    /// has none.
    pub fn finish(&mut self) -> Result<(), SegmentError> {
        if self.plan.is_none() {
            for environment in 0..self.environments.len() {
                self.release(environment, true)?;
            }
        }
        self.segments.finish()
    }

    /// The segments, for good.
    pub fn into_segments(self) -> Segments {
        self.segments
    }

    /// What was recorded so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    fn step(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        bytes: &[u8],
    ) -> Result<(), SegmentError> {
        let (record, channels) = (RecordHeader::of(bytes), &self.channels);
        let end = record.end();
        let composed = |reward: &Composition| reward.of(|index| channels.layout.part(bytes, index), 0.0);
        let [reward_r, reward_r_prime] = self.rewards.each_ref().map(composed);
        let known = &mut self.environments[environment];
        known.add_rewards(header.learner_incarnation, record, reward_r, reward_r_prime);
        // The action was chosen from the observation that was described last.
        let chosen_from = Some((header.learner_incarnation, record.acted_episode, record.acted_step));
        let goal = if known.described == chosen_from { known.goal } else { None };
        let home = known.home;
        let message = Step {
            kitchen: self.rota.place(home, record.acted_episode).kitchen.number(),
            environment: home.number,
            actor: header.actor,
            environment_index: (environment as u32) % self.shape.environments_per_actor,
            episode: record.acted_episode,
            step: record.acted_step,
            exchange: header.step,
            incarnation: self.incarnation,
            learner_incarnation: header.learner_incarnation,
            actor_incarnation: header.actor_incarnation,
            stage_version: header.stage_version,
            action: bytes[channels.layout.action.offset].into(),
            target: whole(channels.target, bytes) as i32,
            action_failed: is(channels.failed_action, bytes),
            holding: is(channels.held, bytes),
            picked_up: is(channels.picked_up, bytes),
            done: end == Some(End::Terminated),
            success: is(channels.goal_success, bytes),
            time_limit: end == Some(End::Truncated),
            ended: end.is_some(),
            state_hash: record.outcome_hash,
            wrist_object_progress_m: channels.wrist_object_progress_m.f32(bytes),
            object_goal_progress_m: channels.object_goal_progress_m.f32(bytes),
            disturbance_progress_m: channels.disturbance_progress_m.f32(bytes),
            reward_r,
            reward_r_prime,
            disturbance_m: channels.disturbance_m.f32(bytes),
            peak_disturbance_m: channels.peak_disturbance_m.f32(bytes),
            disturbed_objects: whole(channels.disturbed_objects, bytes),
            wrist_object_m: channels.wrist_object_m.f32(bytes),
            object_goal_m: channels.object_goal_m.f32(bytes),
            fixed_episode: fixed(self.plan.as_ref(), home, record.acted_episode),
            goal,
        };
        let place = (message.episode, message.step + 1);
        self.write_of(environment, place, (self.topics.step, time_ns), &message)
    }

    fn episode_start(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        bytes: &[u8],
    ) -> Result<(), SegmentError> {
        let (record, channels) = (RecordHeader::of(bytes), &self.channels);
        let home = self.environments[environment].home;
        let message = EpisodeStart {
            kitchen: self.rota.place(home, record.episode).kitchen.number(),
            environment: home.number,
            episode: record.episode,
            incarnation: self.incarnation,
            learner_incarnation: header.learner_incarnation,
            target: whole(channels.current_target, bytes) as i32,
            state_hash: record.state_hash,
            depth_recorded: record.has(flag::RECORD_BULK),
            wrist_object_m: length_m(vector(channels.wrist_to_object_m, bytes)),
            object_goal_m: length_m(vector(channels.object_to_goal_m, bytes)),
            fixed_episode: fixed(self.plan.as_ref(), home, record.episode),
        };
        self.write_of(environment, (message.episode, 0), (self.topics.episode_start, time_ns), &message)
    }

    fn episode_end(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        bytes: &[u8],
    ) -> Result<(), SegmentError> {
        let (record, channels) = (RecordHeader::of(bytes), &self.channels);
        let (success, disturbance_m) = (is(channels.goal_success, bytes), channels.disturbance_m.f32(bytes));
        let known = &mut self.environments[environment];
        let returns = known.returns.take();
        let home = known.home;
        let message = EpisodeEnd {
            kitchen: self.rota.place(home, record.acted_episode).kitchen.number(),
            environment: home.number,
            episode: record.acted_episode,
            incarnation: self.incarnation,
            learner_incarnation: header.learner_incarnation,
            target: whole(channels.target, bytes) as i32,
            length: record.acted_step + 1,
            success,
            success_undisturbed: success && disturbance_m < UNDISTURBED_THRESHOLD_M,
            // What is held stays held until the episode ends.
            picked_up: is(channels.held, bytes),
            time_limit: record.end() == Some(End::Truncated),
            disturbance_m: channels.disturbance_m.f32(bytes),
            peak_disturbance_m: channels.peak_disturbance_m.f32(bytes),
            disturbed_objects: whole(channels.disturbed_objects, bytes),
            wrist_object_m: channels.wrist_object_m.f32(bytes),
            object_goal_m: channels.object_goal_m.f32(bytes),
            return_r: returns.as_ref().map(|returns| returns.r),
            return_r_prime: returns.as_ref().map(|returns| returns.r_prime),
            fixed_episode: fixed(self.plan.as_ref(), home, record.acted_episode),
        };
        let place = (message.episode, message.length + 1);
        self.write_of(environment, place, (self.topics.episode_end, time_ns), &message)?;
        self.release(environment, !message.success)
    }

    fn depth(&mut self, time_ns: u64, environment: usize, record: &[u8], whole: &[u8]) -> Result<(), SegmentError> {
        let known = &self.environments[environment];
        let (depth, calibration) = (known.depth, known.calibration);
        self.image.timestamp = Some(timestamp(time_ns));
        self.image.frame_id.clone_from(&known.frames.camera);
        self.image.data.clear();
        self.image.data.extend_from_slice(&whole[self.channels.depth_mm.range()]);
        let intrinsics = camera::calibration(timestamp(time_ns), &known.frames.camera);
        let places = self.channels.places(record);
        let transforms = camera::transforms(timestamp(time_ns), &known.frames, &places);
        let transforms = FrameTransforms { transforms };
        self.write(self.topics.transforms, time_ns, &transforms)?;
        self.write(calibration, time_ns, &intrinsics)?;
        self.buffer.clear();
        self.image.encode_raw(&mut self.buffer);
        self.segments.write(depth, time_ns, &self.buffer)?;
        self.counts.depth_frames += 1;
        Ok(())
    }

    /// Writes a message about an environment's episode, or holds it back at its place there.
    fn write_of(
        &mut self,
        environment: usize,
        (episode, place): (u32, u32),
        (topic, time_ns): (Topic, u64),
        message: &impl Message,
    ) -> Result<(), SegmentError> {
        if self.failures_only {
            let message = held::Message { topic, time_ns, data: message.encode_to_vec() };
            self.environments[environment].held.hold(episode, place, message);
            return Ok(());
        }
        self.count(topic);
        self.write(topic, time_ns, message)
    }

    /// Writes what is held of an environment's episode, or drops it.
    fn release(&mut self, environment: usize, wanted: bool) -> Result<(), SegmentError> {
        let held = self.environments[environment].held.take();
        for held::Message { topic, time_ns, data } in held.filter(|_| wanted) {
            self.count(topic);
            self.segments.write(topic, time_ns, &data)?;
        }
        Ok(())
    }

    fn count(&mut self, topic: Topic) {
        self.counts.steps += u64::from(topic == self.topics.step);
        self.counts.episodes += u64::from(topic == self.topics.episode_end);
    }

    fn write(&mut self, topic: Topic, time_ns: u64, message: &impl Message) -> Result<(), SegmentError> {
        self.buffer.clear();
        message.encode_raw(&mut self.buffer);
        self.segments.write(topic, time_ns, &self.buffer)
    }
}

impl Environment {
    fn add_rewards(&mut self, learner_incarnation: u32, record: &RecordHeader, r: f32, r_prime: f32) {
        let (episode, step) = (record.acted_episode, record.acted_step);
        if step == 0 {
            self.returns = Some(Returns { episode, next_step: 0, learner_incarnation, r: 0.0, r_prime: 0.0 });
        }
        match &mut self.returns {
            Some(returns)
                if (returns.episode, returns.next_step, returns.learner_incarnation)
                    == (episode, step, learner_incarnation) =>
            {
                returns.next_step += 1;
                returns.r += f64::from(r);
                returns.r_prime += f64::from(r_prime);
            }
            _ => self.returns = None,
        }
    }
}

/// A wall-clock time as protobuf writes it.
pub fn timestamp(time_ns: u64) -> Timestamp {
    Timestamp { seconds: (time_ns / 1_000_000_000) as i64, nanos: (time_ns % 1_000_000_000) as i32 }
}

/// The number in an evaluation's table of an environment's episode.
fn fixed(plan: Option<&Plan>, environment: EnvironmentId, episode: u32) -> Option<u32> {
    plan.and_then(|plan| plan.dealt(environment, episode))
}
