//! A stand-in for an actor's environment: every number in it is a hash of (kitchen, environment, episode, actions), so
//! it can be rebuilt from its state as a real one can, and any mistake in bookkeeping shows in all that follows.

use proto::action::{Action, HOLD, NO_ACTION};
use proto::episode::EnvironmentId;
use proto::record::{End, RecordHeader};
use proto::reward::RewardParts;
use proto::step::{Current, Transition};
use wire::message::{EnvironmentState, frame_part};

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

/// A simulated environment.
#[derive(Debug, Clone)]
pub struct FakeEnvironment {
    id: EnvironmentId,
    max_steps: u32,
    state: EnvironmentState,
    header: RecordHeader,
    transition: Transition,
}

impl FakeEnvironment {
    /// As an actor rebuilds it: replays the actions; the last one's transition is what it reports.
    pub fn rebuild(id: EnvironmentId, max_steps: u32, state: &EnvironmentState) -> Self {
        let start = EnvironmentState::start_of(state.episode);
        let (header, transition) = (RecordHeader::default(), Transition::default());
        let mut environment = Self { id, max_steps, state: start, header, transition };
        environment.header.begin(state.episode, environment.hash(), false);
        for &action in state.actions() {
            assert_eq!(environment.state.episode, state.episode, "a restored episode ends at its last action or later");
            environment.act(action);
        }
        environment
    }

    /// Hash of the whole state.
    pub fn hash(&self) -> u64 {
        let place = [u64::from(self.id.kitchen.number()), u64::from(self.id.number), u64::from(self.state.episode)];
        mix(place.into_iter().chain(self.state.actions().iter().map(|&action| u64::from(action))))
    }

    /// Takes one action; Done and the step limit end the episode.
    pub fn act(&mut self, action: u8) {
        if action == HOLD {
            self.header.hold();
            self.transition = Transition::default();
            return;
        }
        self.state.push(action);
        let hash = self.hash();
        let done = action == Action::DoneMidLevel.index();
        let success = done && hash.is_multiple_of(3);
        let failed = done && !success;
        let holding = success || hash.is_multiple_of(2);
        let picked_up = holding && action == Action::PickUpMidLevel.index();
        let limit = self.state.action_count == self.max_steps;
        let end = if done { Some(End::Terminated) } else { limit.then_some(End::Truncated) };
        let one_if = |condition: bool| f32::from(u8::from(condition));
        let reward = RewardParts {
            wrist_object_progress_m: unit(mix([hash, 1])),
            object_goal_progress_m: 0.0,
            disturbance_progress_m: unit(mix([hash, 2])) * 0.004,
            failed_action: one_if(failed),
            picked_up: one_if(picked_up),
            goal_success: one_if(success),
        };
        let (action, holding) = (u32::from(action), u32::from(holding));
        self.transition = Transition { action, reward, holding, ..Transition::default() };
        self.header.act(hash, end);
        if end.is_some() {
            self.state = EnvironmentState::start_of(self.state.episode + 1);
            self.header.begin(self.state.episode, self.hash(), false);
        }
    }

    /// What it reports as environment `index` of its actor.
    pub fn observe(&self, index: u32) -> (RecordHeader, Transition, Current) {
        let header = RecordHeader { environment: index, bulk: frame_part::WHOLE, ..self.header };
        (header, self.transition, self.current())
    }

    /// What is seen now.
    pub fn current(&self) -> Current {
        let hash = self.hash();
        Current {
            holding: u32::from(hash.is_multiple_of(2)),
            previous_action: u32::from(self.state.actions().last().copied().unwrap_or(NO_ACTION)),
            wrist_to_object_m: [1, 2, 3].map(|i| unit(mix([hash, i]))),
            object_to_goal_m: [4, 5, 6].map(|i| unit(mix([hash, i]))),
            ..Current::default()
        }
    }
}
