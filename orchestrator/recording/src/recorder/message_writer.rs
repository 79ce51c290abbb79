use crate::declared::Declared;
use crate::engine::Engine;
use crate::form::{Carries, Told};
use crate::recorder::camera::{self, FrameNames};
use crate::recorder::channels::{Images, Pose};
use crate::recorder::held_back::{self, HeldBack};
use crate::recorder::segment::{Segments, Topic};
use crate::schema::foxglove::{FrameTransforms, Log, log};
use crate::schema::stillroom::{LearnerMetrics, StageSwitch, Validation};
use crate::schema::{STAGES, Schema};
use anyhow::Result;
use prost::Message;
use prost_types::Timestamp;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::Plan;
use proto::event::Timing;
use proto::kitchen::Kitchens;
use proto::kitchen_schedule::KitchenSchedule;
use proto::metric;
use proto::record::{RecordHeader, flag};
use proto::task::{LINE_BYTES, Sums};
use std::collections::BTreeMap;
use wire::WireShape;
use wire::message::{Halves, Line, ObservationHeader};

#[cfg(target_endian = "big")]
compile_error!("16UC1 images are little-endian and are copied as they lie in memory");

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    pub steps: u64,
    pub episodes: u64,
    pub depth_frames: u64,
}

#[derive(Debug, Clone)]
pub struct RolloutMetrics {
    pub rank: u32,
    pub rollout: u64,
    pub frames: u64,
    pub stage: u32,
    pub timing: Timing,
    pub metrics: BTreeMap<String, f64>,
}

pub struct MessageWriter {
    segments: Segments,
    topics: Topics,
    environments: Vec<Environment>,
    shape: WireShape,
    incarnation: u32,
    declared: Declared,
    images: Images,
    pose: Option<Pose>,
    failures_only: bool,
    plan: Option<Plan>,
    kitchen_schedule: KitchenSchedule,
    pub counts: Counts,
    frames_before: Option<u64>,
    small: Vec<Line>,
    told: [Told; 3],
    room: Vec<u8>,
    buffer: Vec<u8>,
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

struct Environment {
    home: EnvironmentId,
    frames: FrameNames,
    /// Of each image of the task: of itself and its calibration.
    images: Vec<[Topic; 2]>,
    /// Observation that was last described, so that one that comes back after a HOLD is not described again.
    described: Option<(u32, u32, u32)>,
    seen: Vec<u8>,
    /// Transition that was last accounted for: learner incarnation, episode, step. An actor that is restarted during a
    /// HOLD has no record of the HOLD and sends the action before it again, as the next exchange.
    taken: Option<(u32, u32, u32)>,
    course: Option<Course>,
    held: HeldBack,
}

/// An episode so far; only one seen from its first step without a gap.
struct Course {
    episode: u32,
    next_step: u32,
    learner_incarnation: u32,
    sums: Sums,
}

impl MessageWriter {
    pub fn new(
        mut segments: Segments,
        shape: WireShape,
        incarnation: u32,
        config: &Config,
        declared: Declared,
    ) -> Self {
        let forms = &declared.forms;
        let topics = Topics {
            step: segments.topic("/step", &forms.step.schema()),
            episode_start: segments.topic("/episode/start", &forms.start.schema()),
            episode_end: segments.topic("/episode/end", &forms.end.schema()),
            transforms: segments.topic("/tf", &Schema::of("foxglove.FrameTransforms")),
            metrics: segments.topic("/learner/metrics", &Schema::of("stillroom.LearnerMetrics")),
            stage: segments.topic(STAGES, &Schema::of("stillroom.StageSwitch")),
            evaluation: segments.topic("/evaluation", &Schema::of("stillroom.Validation")),
            log: segments.topic("/log", &Schema::of("foxglove.Log")),
        };
        let per_actor = shape.environments_per_actor;
        let kitchens = config.kitchens();
        let (images, pose) = (Images::of(declared.spec), Pose::of(declared.spec));
        let [image, calibration] = ["foxglove.RawImage", "foxglove.CameraCalibration"].map(Schema::of);
        let environments = (0..shape.shares.actors())
            .flat_map(|actor| (0..per_actor).map(move |index| EnvironmentId::among(kitchens, actor, index, per_actor)))
            .map(|home| {
                let prefix = match kitchens {
                    // As many topics as environments, however many kitchens they come to.
                    Kitchens::Procedural(_) => format!("procedural/{}", home.number),
                    _ => format!("kitchen-{:02}/{}", home.kitchen.number(), home.number),
                };
                // Foxglove pairs an image with the calibration that shares its name up to the last slash.
                let images = images.names().map(|name| {
                    let topic = |what: &str| format!("/{name}/{prefix}/{what}");
                    [segments.topic(topic("image"), &image), segments.topic(topic("calibration"), &calibration)]
                });
                Environment {
                    home,
                    images: images.collect(),
                    frames: FrameNames::under(&prefix),
                    described: None,
                    seen: vec![0; declared.spec.layout().small_bytes],
                    taken: None,
                    course: None,
                    held: HeldBack::default(),
                }
            })
            .collect();
        Self {
            segments,
            topics,
            environments,
            shape,
            incarnation,
            told: [&forms.step, &forms.start, &forms.end].map(|form| form.empty.clone()),
            declared,
            images,
            pose,
            small: Vec::new(),
            failures_only: config.recording.failures_only,
            plan: config.evaluation_plan(),
            kitchen_schedule: config.kitchen_schedule(),
            counts: Counts::default(),
            frames_before: None,
            room: Vec::new(),
            buffer: Vec::new(),
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
    ) -> Result<u64> {
        let first = (header.actor * self.shape.environments_per_actor) as usize;
        let range = Halves::of(self.shape.environments_per_actor).range(header.half);
        let layout = self.declared.spec.layout();
        let [lines, small_lines] = [layout.bytes, layout.small_bytes].map(|bytes| bytes / LINE_BYTES);
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

    fn outcome(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        record: &[u8],
        with_transitions: bool,
    ) -> Result<bool> {
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
    ) -> Result<()> {
        let seen = RecordHeader::of(record);
        let known = &mut self.environments[environment];
        let described = Some((header.learner_incarnation, seen.episode, seen.step));
        if known.described == described {
            return Ok(());
        }
        known.described = described;
        known.seen.copy_from_slice(record);
        if seen.has(flag::EPISODE_START) {
            self.episode_start(time_ns, header, environment, record)?;
        }
        if seen.has(flag::RECORD_BULK) {
            self.images(time_ns, environment, record, whole)?;
        }
        Ok(())
    }

    pub fn metrics(&mut self, time_ns: u64, trained: &RolloutMetrics) -> Result<()> {
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

    pub fn stage(&mut self, time_ns: u64, message: &StageSwitch) -> Result<()> {
        self.write(self.topics.stage, time_ns, message)
    }

    pub fn validation(&mut self, time_ns: u64, message: &Validation) -> Result<()> {
        self.write(self.topics.evaluation, time_ns, message)
    }

    pub fn log(&mut self, time_ns: u64, level: log::Level, process: &str, line: String) -> Result<()> {
        let message = Log {
            timestamp: Some(timestamp(time_ns)),
            level: level.into(),
            message: line,
            name: process.to_owned(),
            ..Default::default()
        };
        self.write(self.topics.log, time_ns, &message)
    }

    pub fn segments(&mut self) -> &mut Segments {
        &mut self.segments
    }

    /// The recording ends. What is held of episodes that run is written: the next start goes on with them. An evaluation
    /// has none.
    pub fn finish(&mut self) -> Result<()> {
        if self.plan.is_none() {
            for environment in 0..self.environments.len() {
                self.release(environment, true)?;
            }
        }
        self.segments.finish()
    }

    pub fn into_segments(self) -> Segments {
        self.segments
    }

    fn engine(&self, header: &ObservationHeader, environment: usize, episode: u32) -> Engine {
        let home = self.environments[environment].home;
        Engine {
            kitchen: self.kitchen_schedule.place(home, episode).kitchen.number(),
            environment: home.number,
            episode,
            incarnation: self.incarnation,
            learner_incarnation: header.learner_incarnation,
            fixed_episode: self.plan.as_ref().and_then(|plan| plan.dealt(home, episode)),
            ..Engine::default()
        }
    }

    fn step(&mut self, time_ns: u64, header: &ObservationHeader, environment: usize, bytes: &[u8]) -> Result<()> {
        let record = RecordHeader::of(bytes);
        let engine = Engine {
            actor: header.actor,
            environment_index: (environment as u32) % self.shape.environments_per_actor,
            step: record.acted_step,
            exchange: header.step,
            actor_incarnation: header.actor_incarnation,
            stage_version: header.stage_version,
            state_hash: record.outcome_hash,
            ..self.engine(header, environment, record.acted_episode).ended(record.end())
        };
        let (declared, known, [told, ..]) = (&self.declared, &mut self.environments[environment], &mut self.told);
        told.engine = engine;
        // The action was chosen from the observation that was described last.
        let chosen_from = Some((header.learner_incarnation, record.acted_episode, record.acted_step));
        told.seen = known.described == chosen_from;
        told.record.copy_from_slice(&known.seen);
        let layout = declared.spec.layout();
        for range in [layout.action.range(), layout.of_action.clone()] {
            told.record[range.clone()].copy_from_slice(&bytes[range]);
        }
        declared.compared.reward(layout, bytes, &mut told.rewards);
        known.follow(declared, told);
        self.write_of(environment, Carries::Step, (engine.episode, engine.step + 1), time_ns)
    }

    fn episode_start(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        bytes: &[u8],
    ) -> Result<()> {
        let record = RecordHeader::of(bytes);
        let engine = Engine {
            state_hash: record.state_hash,
            bulk_recorded: record.has(flag::RECORD_BULK),
            ..self.engine(header, environment, record.episode)
        };
        let [_, told, _] = &mut self.told;
        (told.engine, told.seen) = (engine, true);
        told.record.copy_from_slice(bytes);
        self.write_of(environment, Carries::Start, (engine.episode, 0), time_ns)
    }

    fn episode_end(
        &mut self,
        time_ns: u64,
        header: &ObservationHeader,
        environment: usize,
        bytes: &[u8],
    ) -> Result<()> {
        let record = RecordHeader::of(bytes);
        let length = record.acted_step + 1;
        let engine = self.engine(header, environment, record.acted_episode).ended(record.end());
        let course = self.environments[environment].course.take();
        let [last, _, told] = &mut self.told;
        told.engine = Engine { length, ..engine };
        self.declared.close(course.as_ref().map(|course| &course.sums), last, told);
        let is_failure = !self.declared.succeeded(told);
        self.write_of(environment, Carries::End, (engine.episode, length + 1), time_ns)?;
        self.release(environment, is_failure)
    }

    /// The images that are there, and where the camera is. What is not there is not recorded: the learner refuses it.
    fn images(&mut self, time_ns: u64, environment: usize, record: &[u8], whole: &[u8]) -> Result<()> {
        let bulk = RecordHeader::of(record).bulk;
        for image in 0..self.images.count() {
            if !self.images.is_there(image, bulk) {
                continue;
            }
            let known = &self.environments[environment];
            let ([topic, calibration], frames) = (known.images[image], &known.frames);
            if let Some(pose) = &self.pose {
                let intrinsics = camera::calibration(timestamp(time_ns), &frames.camera);
                let transforms = camera::transforms(timestamp(time_ns), frames, &pose.places(record));
                self.write(self.topics.transforms, time_ns, &FrameTransforms { transforms })?;
                self.write(calibration, time_ns, &intrinsics)?;
            }
            let frame_id = &self.environments[environment].frames.camera;
            let message = self.images.message(image, timestamp(time_ns), frame_id, whole);
            self.buffer.clear();
            message.encode_raw(&mut self.buffer);
            self.segments.write(topic, time_ns, &self.buffer)?;
            self.counts.depth_frames += 1;
        }
        Ok(())
    }

    fn write_of(
        &mut self,
        environment: usize,
        carries: Carries,
        (episode, place): (u32, u32),
        time_ns: u64,
    ) -> Result<()> {
        let Self { topics, declared: Declared { forms, .. }, told: [step, start, end], .. } = self;
        let (topic, form, told) = match carries {
            Carries::Step => (topics.step, &forms.step, step),
            Carries::Start => (topics.episode_start, &forms.start, start),
            Carries::End => (topics.episode_end, &forms.end, end),
        };
        let data = form.write(told, &mut self.room);
        if self.failures_only {
            let message = held_back::Message { topic, time_ns, data: data.to_vec() };
            self.environments[environment].held.hold(episode, place, message);
            return Ok(());
        }
        self.segments.write(topic, time_ns, data)?;
        self.count(topic);
        Ok(())
    }

    fn release(&mut self, environment: usize, wanted: bool) -> Result<()> {
        let held = self.environments[environment].held.take();
        for held_back::Message { topic, time_ns, data } in held.filter(|_| wanted) {
            self.count(topic);
            self.segments.write(topic, time_ns, &data)?;
        }
        Ok(())
    }

    fn count(&mut self, topic: Topic) {
        self.counts.steps += u64::from(topic == self.topics.step);
        self.counts.episodes += u64::from(topic == self.topics.episode_end);
    }

    fn write(&mut self, topic: Topic, time_ns: u64, message: &impl Message) -> Result<()> {
        self.buffer.clear();
        message.encode_raw(&mut self.buffer);
        self.segments.write(topic, time_ns, &self.buffer)
    }
}

impl Environment {
    fn follow(&mut self, declared: &Declared, told: &Told) {
        let Engine { episode, step, learner_incarnation, .. } = told.engine;
        if step == 0 {
            self.course = Some(Course { episode, next_step: 0, learner_incarnation, sums: declared.nothing() });
        }
        match &mut self.course {
            Some(course)
                if (course.episode, course.next_step, course.learner_incarnation)
                    == (episode, step, learner_incarnation) =>
            {
                course.next_step += 1;
                declared.add(&mut course.sums, told);
            }
            course => *course = None,
        }
    }
}

pub fn timestamp(time_ns: u64) -> Timestamp {
    Timestamp { seconds: (time_ns / 1_000_000_000) as i64, nanos: (time_ns % 1_000_000_000) as i32 }
}
