//! One episode, put together from its steps, and what is missing of it.

use crate::recording::schema::stillroom::step::Goal;
use crate::recording::schema::stillroom::{EpisodeEnd, EpisodeStart, RobotVector, Step};
use proto::replay::{RecordedStep, STEP_ASPECTS, goal_digest, start_digest};
use proto::reward::UNDISTURBED_THRESHOLD_M;
use std::cmp::Ordering;

/// Incarnations of orchestrator and learner: the higher one is the newer.
pub type Generation = (u32, u32);

/// What was recorded of an episode so far.
#[derive(Debug, Default)]
pub struct Assembly {
    pub generation: Generation,
    /// Number of the configuration that its file carries.
    pub config: usize,
    pub start_hash: Option<u64>,
    pub start: Option<u32>,
    pub actions: Vec<u8>,
    pub hashes: Vec<u64>,
    pub goals: Vec<u32>,
    pub steps: Vec<[u32; STEP_ASPECTS.len()]>,
    /// The first step that is not there though later ones are.
    pub gap: Option<usize>,
    /// A file under another configuration goes on with it: the one, from this step on.
    pub moved_to: Option<(usize, usize)>,
    /// The last step taken.
    last: Option<RecordedStep>,
    /// Returns under r and r′ of all steps, if one start of the programs recorded them all.
    returns: Option<(f64, f64)>,
    end: Option<EpisodeEnd>,
}

/// What one step holds about its episode.
#[derive(Debug, Clone, Copy)]
pub struct Taken {
    pub action: u8,
    pub hash: u64,
    pub goal: u32,
    pub digests: [u32; STEP_ASPECTS.len()],
    pub step: RecordedStep,
}

impl Taken {
    /// What a message says; none where there is no such action.
    pub fn of(step: &Step) -> Option<Self> {
        let recorded = RecordedStep {
            failed: step.action_failed,
            picked_up: step.picked_up,
            success: step.success,
            holding: step.holding,
            ends: [step.done, step.time_limit, step.ended],
            target: step.target as u32,
            progress_m: [step.wrist_object_progress_m, step.object_goal_progress_m, step.disturbance_progress_m],
            rewards: [step.reward_r, step.reward_r_prime],
            disturbance_m: [step.disturbance_m, step.peak_disturbance_m],
            disturbed_objects: step.disturbed_objects,
            distances_m: [step.wrist_object_m, step.object_goal_m],
        };
        Some(Self {
            action: u8::try_from(step.action).ok()?,
            hash: step.state_hash,
            goal: digest(step.goal.as_ref()),
            digests: recorded.digests(),
            step: recorded,
        })
    }
}

impl Assembly {
    /// Takes a step that was recorded under configuration `config`.
    pub fn step(&mut self, generation: Generation, step: usize, taken: &Taken) {
        if !self.is_current(generation, step) {
            return;
        }
        match step.cmp(&self.actions.len()) {
            Ordering::Equal => {
                let [r, r_prime] = taken.step.rewards.map(f64::from);
                let (before, before_prime) = if step == 0 { (0.0, 0.0) } else { self.returns.unwrap_or_default() };
                let known = step == 0 || self.returns.is_some();
                self.returns = known.then_some((before + r, before_prime + r_prime));
                self.actions.push(taken.action);
                self.hashes.push(taken.hash);
                self.goals.push(taken.goal);
                self.steps.push(taken.digests);
                self.last = Some(taken.step);
            }
            Ordering::Greater => drop(self.gap.get_or_insert(self.actions.len())),
            // Recorded twice under the same learner: a segment was given twice.
            Ordering::Less => {}
        }
    }

    /// Takes the episode's beginning.
    pub fn begin(&mut self, start: &EpisodeStart) {
        self.start_hash = Some(start.state_hash);
        self.start = Some(start_digest(start.target as u32, start.wrist_object_m, start.object_goal_m));
    }

    /// Takes the episode's end.
    pub fn end(&mut self, generation: Generation, end: EpisodeEnd) {
        if self.is_current(generation, end.length as usize) {
            self.end = Some(end);
        }
    }

    /// Whether a step counts: not if a newer learner has gone on from an earlier point, and that has been read already.
    /// A newer one voids what an older one did from here on.
    fn is_current(&mut self, generation: Generation, step: usize) -> bool {
        if generation > self.generation {
            self.generation = generation;
            if self.actions.len() > step {
                self.last = None;
            }
            self.actions.truncate(step);
            self.hashes.truncate(step);
            self.goals.truncate(step);
            self.steps.truncate(step);
            (self.gap, self.moved_to, self.end, self.returns) = (None, None, None, None);
        }
        generation == self.generation
    }

    /// Whether its last step or a message says that it has ended.
    pub fn has_ended(&self) -> bool {
        self.end.is_some() || self.last.is_some_and(|last| last.ends[2])
    }

    /// What is missing of the episode, or contradicts itself. `goes_on`: a later one of its environment was recorded.
    pub fn fault(&self, goes_on: bool) -> Option<String> {
        let got = self.actions.len();
        if let Some(gap) = self.gap {
            return Some(format!("step {gap} is missing, and what comes after it cannot be replayed"));
        }
        let Some(end) = &self.end else {
            return match (self.has_ended(), goes_on) {
                (true, _) => Some("its message on /episode/end is missing".to_owned()),
                (false, true) => Some(format!("its steps from {got} on and its end are missing")),
                (false, false) => None,
            };
        };
        let length = end.length as usize;
        match got.cmp(&length) {
            Ordering::Less => {
                return Some(format!("{} of its {length} steps are missing at its end", length - got));
            }
            Ordering::Greater => return Some(format!("it has {got} steps, but /episode/end says {length}")),
            Ordering::Equal => {}
        }
        let last = self.last.as_ref()?;
        let differing = differing(end, last, self.returns);
        (!differing.is_empty()).then(|| format!("/episode/end contradicts its last step: {}", differing.join(", ")))
    }
}

/// Fields of an episode's end that are not as its steps have them.
fn differing(end: &EpisodeEnd, last: &RecordedStep, returns: Option<(f64, f64)>) -> Vec<&'static str> {
    let [_, time_limit, ended] = last.ends;
    let [disturbance_m, peak_disturbance_m] = last.disturbance_m;
    let [wrist_object_m, object_goal_m] = last.distances_m;
    let undisturbed = last.success && disturbance_m < UNDISTURBED_THRESHOLD_M;
    let returned = |recorded: Option<f64>, summed: Option<f64>| match (recorded, summed) {
        (Some(recorded), Some(summed)) => recorded.to_bits() == summed.to_bits(),
        // A recorder that did not see all of the episode writes none.
        _ => true,
    };
    let fields = [
        ("end", ended),
        ("target", end.target as u32 == last.target),
        ("success", end.success == last.success),
        ("success_undisturbed", end.success_undisturbed == undisturbed),
        ("picked_up", end.picked_up == last.holding),
        ("time_limit", end.time_limit == time_limit),
        ("disturbance_m", end.disturbance_m == disturbance_m),
        ("peak_disturbance_m", end.peak_disturbance_m == peak_disturbance_m),
        ("disturbed_objects", end.disturbed_objects == last.disturbed_objects),
        ("wrist_object_m", end.wrist_object_m == wrist_object_m),
        ("object_goal_m", end.object_goal_m == object_goal_m),
        ("return_r", returned(end.return_r, returns.map(|(r, _)| r + 0.0))),
        ("return_r_prime", returned(end.return_r_prime, returns.map(|(_, r_prime)| r_prime + 0.0))),
    ];
    fields.into_iter().filter(|(_, agrees)| !agrees).map(|(name, _)| name).collect()
}

/// Digest of what the goal sensor read; 0 where that was not recorded.
fn digest(goal: Option<&Goal>) -> u32 {
    match goal {
        None => 0,
        Some(Goal::WristToObjectM(RobotVector { x, y, z })) => goal_digest(false, [*x, *y, *z]),
        Some(Goal::ObjectToGoalM(RobotVector { x, y, z })) => goal_digest(true, [*x, *y, *z]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn taken(action: u8, hash: u64) -> Taken {
        let step = Step { action: action.into(), state_hash: hash, ..Step::default() };
        Taken { goal: u32::from(action), ..Taken::of(&step).unwrap() }
    }

    proptest! {
        /// A reference by brute force: of every step, the newest generation counts, and nothing older lies beyond
        /// the newest generation's last step.
        #[test]
        fn rewinds_leave_what_the_newest_learner_did(
            runs in prop::collection::vec((0usize..12, 1usize..12), 1..6),
        ) {
            let mut assembly = Assembly::default();
            let mut reference: Vec<(u8, u64)> = Vec::new();
            for (generation, (back, length)) in runs.iter().enumerate() {
                let from = reference.len().saturating_sub(*back);
                reference.truncate(from);
                for step in from..from + length {
                    let (action, hash) = ((generation * 3 + step) as u8, (generation * 1000 + step) as u64);
                    reference.push((action, hash));
                    assembly.step((1, generation as u32 + 1), step, &taken(action, hash));
                }
            }
            prop_assert!(assembly.gap.is_none());
            prop_assert_eq!(assembly.steps.len(), reference.len());
            let got: Vec<_> = assembly.actions.iter().copied().zip(assembly.hashes.iter().copied()).collect();
            prop_assert_eq!(got, reference);
            let goals: Vec<u32> = assembly.actions.iter().map(|&action| u32::from(action)).collect();
            prop_assert_eq!(assembly.goals, goals);
        }
    }

    #[test]
    fn an_older_learner_adds_nothing_to_a_newer_one() {
        let mut assembly = Assembly::default();
        assembly.step((2, 1), 0, &taken(1, 10));
        assembly.step((1, 1), 1, &taken(9, 90));
        assert!(assembly.gap.is_none());
        assert_eq!((assembly.actions, assembly.hashes), (vec![1], vec![10]));
    }

    #[test]
    fn a_hole_ends_an_episode_and_a_rewind_mends_it() {
        let mut assembly = Assembly::default();
        for step in [0, 1, 3, 4] {
            assembly.step((1, 1), step, &taken(step as u8, 0));
        }
        assert_eq!(assembly.gap, Some(2));
        assert!(assembly.fault(false).unwrap().starts_with("step 2 is missing"));
        assert_eq!(assembly.actions, [0, 1]);
        for step in [1, 2, 3] {
            assembly.step((2, 1), step, &taken(10 + step as u8, 0));
        }
        assert!(assembly.gap.is_none());
        assert_eq!(assembly.actions, [0, 11, 12, 13]);
    }

    /// An episode of three steps and its end, all in agreement.
    fn ended() -> (Vec<Taken>, EpisodeEnd) {
        let steps = [0.25f32, -0.5, 10.0].map(|reward_r| {
            let last = reward_r == 10.0;
            let step = Step {
                reward_r,
                reward_r_prime: 2.0 * reward_r,
                disturbance_m: 0.02,
                peak_disturbance_m: 0.03,
                disturbed_objects: 1,
                wrist_object_m: 0.4,
                object_goal_m: 0.5,
                target: 3,
                holding: last,
                done: last,
                success: last,
                ended: last,
                ..Step::default()
            };
            Taken::of(&step).unwrap()
        });
        let end = EpisodeEnd {
            target: 3,
            length: 3,
            success: true,
            picked_up: true,
            disturbance_m: 0.02,
            peak_disturbance_m: 0.03,
            disturbed_objects: 1,
            wrist_object_m: 0.4,
            object_goal_m: 0.5,
            return_r: Some(9.75),
            return_r_prime: Some(19.5),
            ..EpisodeEnd::default()
        };
        (steps.to_vec(), end)
    }

    fn fault_of(steps: &[Taken], end: Option<EpisodeEnd>, goes_on: bool) -> Option<String> {
        let mut assembly = Assembly::default();
        for (step, taken) in steps.iter().enumerate() {
            assembly.step((1, 1), step, taken);
        }
        if let Some(end) = end {
            assembly.end((1, 1), end);
        }
        assembly.fault(goes_on)
    }

    #[test]
    fn what_is_missing_at_an_end_is_named() {
        let (steps, end) = ended();
        assert_eq!(fault_of(&steps, Some(end), true), None);
        assert_eq!(fault_of(&steps[..1], Some(end), false).unwrap(), "2 of its 3 steps are missing at its end");
        assert_eq!(fault_of(&steps, None, false).unwrap(), "its message on /episode/end is missing");
        assert_eq!(fault_of(&steps[..2], None, true).unwrap(), "its steps from 2 on and its end are missing");
        assert_eq!(fault_of(&steps[..2], None, false), None, "an episode that runs has no end yet");
        let short = EpisodeEnd { length: 2, ..end };
        assert!(fault_of(&steps, Some(short), true).unwrap().contains("it has 3 steps, but /episode/end says 2"));
    }

    #[test]
    fn every_field_of_an_end_is_compared_with_the_steps() {
        type Alter = fn(&mut EpisodeEnd);
        let cases: [(&str, Alter); 12] = [
            ("target", |end| end.target = 4),
            ("success", |end| end.success = false),
            ("success_undisturbed", |end| end.success_undisturbed = true),
            ("picked_up", |end| end.picked_up = false),
            ("time_limit", |end| end.time_limit = true),
            ("disturbance_m", |end| end.disturbance_m = 0.0),
            ("peak_disturbance_m", |end| end.peak_disturbance_m = 0.0),
            ("disturbed_objects", |end| end.disturbed_objects = 0),
            ("wrist_object_m", |end| end.wrist_object_m = 0.0),
            ("object_goal_m", |end| end.object_goal_m = 0.0),
            ("return_r", |end| end.return_r = Some(9.5)),
            ("return_r_prime", |end| end.return_r_prime = Some(9.5)),
        ];
        let (steps, end) = ended();
        for (field, alter) in cases {
            let mut wrong = end;
            alter(&mut wrong);
            let fault = fault_of(&steps, Some(wrong), true);
            assert_eq!(fault.as_deref(), Some(&*format!("/episode/end contradicts its last step: {field}")));
        }
    }
}
