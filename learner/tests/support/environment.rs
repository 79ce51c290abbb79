//! A stand-in for an actor's environment: every number in it is a hash of (kitchen, environment, episode, actions), so
//! it can be rebuilt from its state as a real one can, and any mistake in bookkeeping shows in all that follows. It is of
//! `ArmPointNav`, or of a task of numbers alone.

use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::record::{End, HOLD, RecordHeader};
use proto::task::{Field, Spec};
use std::sync::LazyLock;
use wire::message::{EnvironmentState, Line};

/// `SplitMix64` over a list of words.
pub fn mix(words: impl IntoIterator<Item = u64>) -> u64 {
    words.into_iter().fold(0x9e37_79b9_7f4a_7c15, |state, word| {
        let mut z = (state ^ word).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

/// The upper bits of a hash as a number in -0.5..0.5.
fn unit(word: u64) -> f32 {
    (word >> 40) as f32 / 16_777_216.0 - 0.5
}

/// Channels that it reports; all others are 0.
struct Channels {
    task: &'static Spec,
    wrist_object_progress_m: Field,
    disturbance_progress_m: Field,
    failed_action: Field,
    picked_up: Field,
    goal_success: Field,
    held: Field,
    goal_m: Field,
}

static CHANNELS: LazyLock<Channels> = LazyLock::new(|| {
    let task = Config::default().spec();
    let named = |name| task.channel(name).expect("the task has it").1;
    Channels {
        task,
        wrist_object_progress_m: named("wrist_object_progress_m"),
        disturbance_progress_m: named("disturbance_progress_m"),
        failed_action: named("failed_action"),
        picked_up: named("picked_up"),
        goal_success: named("goal_success"),
        held: named("held"),
        goal_m: named("goal_m"),
    }
});

#[derive(Debug, Clone)]
pub struct FakeEnvironment {
    task: &'static Spec,
    id: EnvironmentId,
    max_steps: u32,
    state: EnvironmentState,
    header: RecordHeader,
    /// The last action, and the hash of the state that it led to; none after a HOLD.
    done: Option<(u8, u64)>,
}

impl FakeEnvironment {
    /// As an actor rebuilds it: replays the actions; the last one's transition is what it reports.
    pub fn rebuild(task: &'static Spec, id: EnvironmentId, max_steps: u32, state: &EnvironmentState) -> Self {
        let start = EnvironmentState::start_of(state.episode);
        let mut environment = Self { task, id, max_steps, state: start, header: RecordHeader::default(), done: None };
        environment.header.begin(state.episode, environment.hash(), false);
        for &action in state.actions() {
            assert_eq!(environment.state.episode, state.episode, "a restored episode ends at its last action or later");
            environment.act(action);
        }
        environment
    }

    pub fn hash(&self) -> u64 {
        let place = [u64::from(self.id.kitchen.number()), u64::from(self.id.number), u64::from(self.state.episode)];
        mix(place.into_iter().chain(self.state.actions().iter().map(|&action| u64::from(action))))
    }

    /// Takes one action; Done and the step limit end the episode.
    pub fn act(&mut self, action: u8) {
        if action == HOLD {
            self.header.hold();
            self.done = None;
            return;
        }
        self.state.push(&[action]);
        let hash = self.hash();
        self.done = Some((action, hash));
        let limit = self.state.action_count() == self.max_steps;
        let is_done = if self.has_frame() { is_done(action) } else { hash.is_multiple_of(11) };
        let end = if is_done { Some(End::Terminated) } else { limit.then_some(End::Truncated) };
        self.header.act(hash, end);
        if end.is_some() {
            self.state = EnvironmentState::start_of(self.state.episode + 1);
            self.header.begin(self.state.episode, self.hash(), false);
        }
    }

    fn has_frame(&self) -> bool {
        self.task.name == CHANNELS.task.name
    }

    /// The record of a task of numbers.
    fn observe_numbers(&self, index: u32) -> Vec<Line> {
        let layout = self.task.layout();
        let mut lines = vec![Line([0; 64]); layout.small_bytes / size_of::<Line>()];
        let record = Line::bytes_mut(&mut lines);
        *RecordHeader::of_mut(record) = RecordHeader { environment: index, ..self.header };
        let named = |name| self.task.channel(name).expect("the task has it").1;
        if let Some((action, hash)) = self.done {
            record[layout.action.offset] = action;
            named("gain").of_mut(record)[0] = unit(mix([hash, 1]));
        }
        record[layout.previous_action.offset] = self.state.actions().last().copied().unwrap_or(0);
        let hash = self.hash();
        named("speed").of_mut(record).copy_from_slice(&[1, 2, 3, 4].map(|word| unit(mix([hash, word]))));
        named("door").of_mut(record)[0] = (mix([hash, 5]) % 3) as i32 - 1;
        named("room").of_mut(record)[0] = (mix([hash, 6]) % 2) as u8;
        lines
    }

    /// The record, without its frame, that it reports as environment `index` of its actor.
    pub fn observe(&self, index: u32) -> Vec<Line> {
        if !self.has_frame() {
            return self.observe_numbers(index);
        }
        let Channels { task, .. } = *CHANNELS;
        let mut lines = vec![Line([0; 64]); task.layout().small_bytes / size_of::<Line>()];
        let record = Line::bytes_mut(&mut lines);
        *RecordHeader::of_mut(record) = RecordHeader { environment: index, bulk: 1, ..self.header };
        if let Some((action, hash)) = self.done {
            record[task.layout().action.offset] = action;
            let success = is_done(action) && hash.is_multiple_of(3);
            let held = success || hash.is_multiple_of(2);
            let picked_up = held && action == 19;
            for (field, number) in [
                (CHANNELS.wrist_object_progress_m, unit(mix([hash, 1]))),
                (CHANNELS.disturbance_progress_m, unit(mix([hash, 2])) * 0.004),
                (CHANNELS.failed_action, f32::from(u8::from(is_done(action) && !success))),
                (CHANNELS.picked_up, f32::from(u8::from(picked_up))),
                (CHANNELS.goal_success, f32::from(u8::from(success))),
            ] {
                field.of_mut(record)[0] = number;
            }
            CHANNELS.held.of_mut(record)[0] = u32::from(held);
        }
        let hash = self.hash();
        record[task.layout().previous_action.offset] = self.state.actions().last().copied().unwrap_or(0);
        let vector = |words: [u64; 3]| words.map(|word| unit(mix([hash, word])));
        CHANNELS.goal_m.of_mut(record).copy_from_slice(&vector([1, 2, 3]));
        lines
    }
}

fn is_done(action: u8) -> bool {
    action == 20
}
