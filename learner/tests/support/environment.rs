//! A stand-in for an actor's environment: every number in it is a hash of (kitchen, environment, episode, actions), so
//! it can be rebuilt from its state as a real one can, and any mistake in bookkeeping shows in all that follows.

use proto::action::{Action, HOLD, NO_ACTION};
use proto::episode::EnvironmentId;
use proto::reward::RewardParts;
use proto::step::{Current, Transition, current_flag, transition_flag};
use wire::message::EnvironmentState;

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
    transition: Transition,
}

impl FakeEnvironment {
    /// As an actor rebuilds it: replays the actions; the last one's transition is what it reports.
    pub fn rebuild(id: EnvironmentId, max_steps: u32, state: &EnvironmentState) -> Self {
        let start = EnvironmentState::start_of(state.episode);
        let mut environment = Self { id, max_steps, state: start, transition: Transition::default() };
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
            self.transition = Transition::default();
            return;
        }
        let (episode, step) = (self.state.episode, self.state.action_count);
        self.state.push(action);
        let hash = self.hash();
        let done = action == Action::DoneMidLevel.index();
        let success = done && hash.is_multiple_of(3);
        let failed = done && !success;
        let holding = success || hash.is_multiple_of(2);
        let picked_up = holding && action == Action::PickUpMidLevel.index();
        let limit = !done && step + 1 == self.max_steps;
        let set = |flag, condition: bool| if condition { flag } else { 0 };
        let flags = transition_flag::VALID
            | set(transition_flag::DONE, done)
            | set(transition_flag::SUCCESS, success)
            | set(transition_flag::ACTION_FAILED, failed)
            | set(transition_flag::HOLDING, holding)
            | set(transition_flag::TIME_LIMIT, limit)
            | set(transition_flag::ENDED, done || limit)
            | set(transition_flag::PICKED_UP, picked_up);
        let one_if = |condition: bool| f32::from(u8::from(condition));
        let reward = RewardParts {
            wrist_object_progress_m: unit(mix([hash, 1])),
            object_goal_progress_m: 0.0,
            disturbance_progress_m: unit(mix([hash, 2])) * 0.004,
            failed_action: one_if(failed),
            picked_up: one_if(picked_up),
            goal_success: one_if(success),
        };
        let action = u32::from(action);
        self.transition =
            Transition { state_hash: hash, episode, step, flags, action, reward, ..Transition::default() };
        if done || limit {
            self.state = EnvironmentState::start_of(episode + 1);
        }
    }

    /// What the last action did.
    pub fn transition(&self) -> Transition {
        self.transition
    }

    /// What is seen now.
    pub fn current(&self) -> Current {
        let hash = self.hash();
        let set = |flag, condition: bool| if condition { flag } else { 0 };
        Current {
            state_hash: hash,
            episode: self.state.episode,
            step: self.state.action_count,
            flags: set(current_flag::EPISODE_START, self.state.action_count == 0)
                | set(current_flag::HOLDING, hash.is_multiple_of(2)),
            target: 0,
            previous_action: u32::from(self.state.actions().last().copied().unwrap_or(NO_ACTION)),
            wrist_to_object_m: [1, 2, 3].map(|i| unit(mix([hash, i]))),
            object_to_goal_m: [4, 5, 6].map(|i| unit(mix([hash, i]))),
            base_position_m: [0.0; 2],
            base_yaw_rad: 0.0,
            camera_pitch_rad: 0.0,
            wrist_position_m: [0.0; 3],
            target_position_m: [0.0; 3],
            goal_position_m: [0.0; 3],
            reserved: [0; 2],
        }
    }
}
