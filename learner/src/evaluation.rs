//! Playing fixed episodes with a policy: what is chosen, what came of it, and who has run out. No I/O, no tensors.

use crate::collector::{Layout, Place, gumbel_of};
use proto::action::HOLD;
use proto::evaluation::{Confusion, EpisodeEnd, EpisodeRecord, Plan, category_of};
use proto::message::{Transition, transition_flag};
use proto::random::{Key, Purpose};
use proto::reward::{DISTURBANCE_LABEL_THRESHOLD_M, RewardKind};

/// The episode that a column plays.
#[derive(Debug, Clone, Default)]
struct Course {
    /// Number of the fixed episode; none when the column has run out.
    fixed: Option<u32>,
    /// Episodes that this column has ended.
    played: u32,
    actions: Vec<u8>,
    failed_actions: u32,
    return_r: f64,
    return_r_prime: f64,
    /// What the head said of the action on its way.
    foretold: Option<bool>,
    confusion: Option<Confusion>,
}

/// An episode that has ended: its record, and the actions taken (`A_large` indices).
pub type Played = (EpisodeRecord, Vec<u8>);

/// All columns of an evaluation.
#[derive(Debug, Clone)]
pub struct Examination {
    plan: Plan,
    layout: Layout,
    lambda_disturb: f32,
    /// None takes the most probable action.
    seed: Option<u64>,
    policy_actions: usize,
    courses: Vec<Course>,
    remaining: usize,
}

impl Examination {
    /// Every column at the start of its first episode. Noise of `seed` samples among `policy_actions` actions; without
    /// a seed the most probable one is taken. `lambda_disturb` is that of the return under r′.
    pub fn new(plan: Plan, layout: Layout, lambda_disturb: f32, seed: Option<u64>, policy_actions: usize) -> Self {
        let course = |column| Course { fixed: plan.fixed(layout.environment(column), 0), ..Course::default() };
        Self {
            courses: (0..layout.columns()).map(course).collect(),
            remaining: plan.len(),
            plan,
            layout,
            lambda_disturb,
            seed,
            policy_actions,
        }
    }

    /// Episodes that have not ended.
    pub fn remaining(&self) -> usize {
        self.remaining
    }

    /// Appends the noise for one column's step: a function of (seed, kitchen, fixed episode, step) and nothing else.
    pub fn noise(&self, place: Place, noise: &mut Vec<f32>) {
        let (Some(seed), Some(fixed)) = (self.seed, self.courses[place.column].fixed) else {
            noise.resize(noise.len() + self.policy_actions, 0.0);
            return;
        };
        let kitchen = place.environment.kitchen.number();
        let key = Key { seed, purpose: Purpose::Evaluation, kitchen, environment: 0, episode: fixed, step: place.step };
        gumbel_of(key, self.policy_actions, noise);
    }

    /// Notes what the policy chose for a column, and returns what to send: HOLD for one that has run out.
    pub fn choose(&mut self, column: usize, action: u8, foretold: Option<bool>) -> u8 {
        let course = &mut self.courses[column];
        if course.fixed.is_none() {
            return HOLD;
        }
        course.actions.push(action);
        course.foretold = foretold;
        action
    }

    /// Takes in what a column's last action did; the record of its episode if that has ended.
    pub fn settle(&mut self, column: usize, transition: &Transition) -> Option<Played> {
        let course = &mut self.courses[column];
        let fixed = course.fixed?;
        let has = |flag| transition.flags & flag != 0;
        let reward = |kind| f64::from(transition.reward.compose(kind, self.lambda_disturb));
        course.return_r += reward(RewardKind::Task);
        course.return_r_prime += reward(RewardKind::DisturbanceFree);
        course.failed_actions += u32::from(has(transition_flag::ACTION_FAILED));
        if let Some(foretold) = course.foretold.take() {
            let confusion = course.confusion.get_or_insert_default();
            // As in training, an episode's last step is not asked about.
            if !has(transition_flag::ENDED) {
                let came = transition.reward.disturbance_progress_m <= -DISTURBANCE_LABEL_THRESHOLD_M;
                confusion.count(foretold, came);
            }
        }
        if !has(transition_flag::ENDED) {
            return None;
        }
        let environment = self.layout.environment(column);
        let played = course.played + 1;
        let next = Course { fixed: self.plan.fixed(environment, played), played, ..Course::default() };
        let ended = std::mem::replace(course, next);
        self.remaining -= 1;
        let record = EpisodeRecord {
            kitchen: environment.kitchen,
            episode: fixed,
            category: category_of(fixed),
            end: if has(transition_flag::DONE) { EpisodeEnd::Done } else { EpisodeEnd::TimeLimit },
            success: has(transition_flag::SUCCESS),
            // What is held stays held until the episode ends.
            picked_up: has(transition_flag::HOLDING),
            length: ended.actions.len() as u32,
            failed_actions: ended.failed_actions,
            return_r: ended.return_r,
            return_r_prime: ended.return_r_prime,
            disturbance_m: transition.disturbance_m,
            peak_disturbance_m: transition.peak_disturbance_m,
            disturbed_objects: transition.disturbed_objects,
            ever_disturbed_objects: transition.ever_disturbed_objects,
            farthest_m: transition.farthest_m,
            peak_farthest_m: transition.peak_farthest_m,
            wrist_object_m: transition.wrist_object_m,
            object_goal_m: transition.object_goal_m,
            disturb_prediction: ended.confusion,
            state_hash: transition.state_hash,
        };
        Some((record, ended.actions))
    }
}
