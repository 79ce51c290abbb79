//! Observations, actions and outcomes of one rollout of T steps × N columns.
//!
//! Frames and images stay on the learner's device; the few numbers besides them lie on the host, row-major in (step,
//! column), and go to the device once an update ([`StepTable`]), where they are put into the order of a [`Packing`].

use crate::device::upload;
use crate::network::{Kept, Observations, Packing};
use proto::stage::RolloutShape;
use proto::task::PolicyAction;
use std::collections::BTreeMap;
use tch::{Device, Kind, Tensor};

// Four independent facts, not a state machine.
#[allow(clippy::struct_excessive_bools)]
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Step {
    /// The numbers that the network is given beside the frame.
    pub numbers: Vec<f32>,
    /// Row of the action embedding for the previous action.
    pub previous_action: i64,
    /// Whether each option may be chosen; empty in a task without masks.
    pub mask: Vec<bool>,
    /// The belief was zeroed before this observation.
    pub episode_start: bool,
    /// The action taken; none in a step that was never stored.
    pub action: Option<PolicyAction>,
    /// Its log-probability when it was taken.
    pub log_prob: f32,
    /// The observation's value when the action was taken.
    pub value: f32,
    pub reward: f32,
    pub ended: bool,
    /// It ended by the step limit.
    pub time_limit: bool,
    /// Value of what was seen last then, where it is known.
    pub last_value: Option<f32>,
    /// Discounted sum of the episode's rewards up to this one, the newest undiscounted.
    pub discounted_return: f64,
    /// What the auxiliary task predicts holds of the action.
    pub label: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outcome {
    /// Reward under the stage in force.
    pub reward: f32,
    pub ended: bool,
    /// It ended by the step limit.
    pub time_limit: bool,
    /// Discounted sum of the episode's rewards up to this one, the newest undiscounted.
    pub discounted_return: f64,
    pub label: bool,
}

/// The steps of a rollout on a device, one row for each (step, column) as in its store. What was never stored is 0.
#[derive(Debug)]
pub(crate) struct StepTable {
    /// f32 \[rows, numbers\].
    pub numbers: Tensor,
    /// i64 \[rows\].
    pub previous_actions: Tensor,
    /// As [`crate::ppo::loss::Experience`] has these.
    pub actions: Tensor,
    pub masks: Option<Tensor>,
    pub log_probs: Tensor,
    pub values: Tensor,
}

#[derive(Debug)]
pub struct Rollout {
    shape: RolloutShape,
    columns: usize,
    /// Frames and images, T · N rows.
    kept: Kept,
    steps: Vec<Step>,
    /// Which steps have an outcome.
    recorded: Vec<bool>,
    /// Value of the observation after the last action, by column.
    bootstrap: Vec<Option<f32>>,
    /// The belief's states before the first step \[N, state\].
    beliefs_at_start: Tensor,
}

impl Rollout {
    /// An empty rollout over `columns` columns; of no steps, where all that act are other learners'. `kept` has room
    /// for steps · columns rows; they are overwritten. Panics if the shape does not fit.
    pub fn new(shape: RolloutShape, columns: usize, kept: Kept, beliefs_at_start: Tensor) -> Self {
        assert!(shape.environments_in_last_step <= columns, "no more columns act than there are");
        assert!((shape.steps == 0) == (shape.environments_in_last_step == 0), "in a last step some act");
        let rows = shape.steps * columns;
        assert!(kept.rows() >= rows as i64, "there is room for every frame");
        assert_eq!(beliefs_at_start.size()[0], columns as i64, "every column has a belief");
        Self {
            shape,
            columns,
            kept,
            steps: vec![Step::default(); rows],
            recorded: vec![false; rows],
            bootstrap: vec![None; columns],
            beliefs_at_start,
        }
    }

    pub fn shape(&self) -> RolloutShape {
        self.shape
    }

    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Steps that a column acts: one fewer for those that hold in the last.
    pub(crate) fn steps_of(&self, column: usize) -> usize {
        self.shape.steps.saturating_sub(usize::from(column >= self.shape.environments_in_last_step))
    }

    /// Whether (t, column) is a frame to train on: false for a column that holds in the last step.
    pub(crate) fn is_valid(&self, t: usize, column: usize) -> bool {
        column < self.columns && t < self.steps_of(column)
    }

    pub fn step(&self, t: usize, column: usize) -> &Step {
        &self.steps[self.index(t, column)]
    }

    /// Stores the observations and actions of some columns in step t. `kept` holds their frames and images in the
    /// same order.
    pub fn store(&mut self, t: usize, columns: &[usize], kept: &Kept, steps: &[Step]) {
        self.keep(columns.iter().map(|&column| (t, column)), kept);
        for (&column, step) in columns.iter().zip(steps) {
            self.note(t, column, step.clone());
        }
    }

    /// Stores rows of frames and images, each at its step and column.
    pub(crate) fn keep(&mut self, places: impl Iterator<Item = (usize, usize)>, kept: &Kept) {
        let rows: Vec<i64> = places.map(|(t, column)| self.index(t, column) as i64).collect();
        let rows = Tensor::from_slice(&rows).to_device(self.device());
        for (store, new) in self.kept.parts(kept) {
            let _ = store.shallow_clone().index_copy_(0, &rows, new);
        }
    }

    fn device(&self) -> Device {
        self.kept.frames.device()
    }

    /// Row of the store for a frame.
    pub(crate) fn place(&self, t: usize, column: usize) -> i64 {
        self.index(t, column) as i64
    }

    /// Row of the store that no frame of a rollout has.
    pub(crate) fn unused_place(&self) -> i64 {
        self.kept.rows() - 1
    }

    pub(crate) fn kept(&self) -> &Kept {
        &self.kept
    }

    /// Notes the observation and action of a column in step t, whose frame is in the store.
    pub(crate) fn note(&mut self, t: usize, column: usize, step: Step) {
        let index = self.index(t, column);
        self.steps[index] = step;
        self.recorded[index] = false;
    }

    pub fn record(&mut self, t: usize, column: usize, outcome: Outcome) {
        assert!(self.is_valid(t, column), "step {t} of column {column} is no frame of this rollout");
        let index = self.index(t, column);
        let step = &mut self.steps[index];
        step.reward = outcome.reward;
        step.ended = outcome.ended;
        step.time_limit = outcome.time_limit;
        step.discounted_return = outcome.discounted_return;
        step.label = outcome.label;
        self.recorded[index] = true;
    }

    /// Notes the value of what was seen last of the episode that ended with a column's action in step t.
    pub fn set_last_value(&mut self, t: usize, column: usize, value: f32) {
        let index = self.index(t, column);
        self.steps[index].last_value = Some(value);
    }

    pub fn set_bootstrap(&mut self, column: usize, value: f32) {
        self.bootstrap[column] = Some(value);
    }

    /// Value of the observation after a column's last action. For a column that holds in the last step it is the value
    /// of that step. Panics if [`Rollout::set_bootstrap`] has not been called for a column that acted in the last step.
    pub(crate) fn bootstrap_value(&self, column: usize) -> f32 {
        match self.bootstrap[column] {
            Some(value) => value,
            None if self.steps_of(column) < self.shape.steps => self.step(self.shape.steps - 1, column).value,
            None => panic!("column {column} has no bootstrap value"),
        }
    }

    /// The first frame without an outcome, as (step, column).
    pub(crate) fn first_missing(&self) -> Option<(usize, usize)> {
        (0..self.shape.steps)
            .flat_map(|t| (0..self.columns).map(move |n| (t, n)))
            .find(|&(t, n)| self.is_valid(t, n) && !self.recorded[self.index(t, n)])
    }

    /// The belief's states before the first step \[N, state\].
    pub(crate) fn beliefs_at_start(&self) -> &Tensor {
        &self.beliefs_at_start
    }

    /// Packs the valid steps of some columns.
    pub fn packing(&self, columns: impl IntoIterator<Item = usize>) -> Packing {
        Packing::new(columns, |n| self.steps_of(n), |t, n| self.step(t, n).episode_start)
    }

    /// All steps, where its frames and images are.
    pub(crate) fn table(&self) -> StepTable {
        self.table_on(self.device())
    }

    fn table_on(&self, device: Device) -> StepTable {
        let steps = self.steps.iter();
        let width = steps.clone().map(|step| step.numbers.len()).max().unwrap_or(0);
        let mut numbers = Vec::with_capacity(self.steps.len() * width);
        for (end, step) in (1..).zip(&self.steps) {
            numbers.extend_from_slice(&step.numbers);
            numbers.resize(end * width, 0.0);
        }
        let of = |number: fn(&Step) -> f32| upload(&self.steps.iter().map(number).collect::<Vec<_>>(), device);
        let previous_actions: Vec<i64> = steps.clone().map(|step| step.previous_action).collect();
        StepTable {
            numbers: upload(&numbers, device).view([self.steps.len() as i64, width as i64]),
            previous_actions: upload(&previous_actions, device),
            actions: actions_of(steps.clone(), device),
            masks: masks_of(steps, device),
            log_probs: of(|step| step.log_prob),
            values: of(|step| step.value),
        }
    }

    /// Rows of the store and of the table that a packing has, in its order: i64 on the device.
    pub(crate) fn rows(&self, packing: &Packing) -> Tensor {
        let rows: Vec<i64> = packing.rows.iter().map(|&(t, n)| self.index(t, n) as i64).collect();
        upload(&rows, self.device())
    }

    /// The observations of some rows.
    pub(crate) fn observations(&self, table: &StepTable, rows: &Tensor) -> Observations {
        Observations {
            kept: self.kept.map(|part| part.index_select(0, rows)),
            numbers: table.numbers.index_select(0, rows),
            previous_actions: table.previous_actions.index_select(0, rows),
        }
    }

    /// One number a row, in the order of a packing, on the device.
    pub fn gather<T: tch::kind::Element>(&self, packing: &Packing, number: impl Fn(&Step) -> T) -> Tensor {
        let values: Vec<T> = packing.rows.iter().map(|&(t, n)| number(self.step(t, n))).collect();
        upload(&values, self.device())
    }

    /// All of it on the CPU, by name: (T, N, …), `bootstrap` (N); this and `last_value` are NaN where there is none.
    /// Rows that are not `recorded` have no outcome; rows that were never stored hold data of an earlier rollout.
    pub fn tensors(&self) -> BTreeMap<&'static str, Tensor> {
        fn table<T: tch::kind::Element>(steps: &[Step], columns: usize, number: impl Fn(&Step) -> T) -> Tensor {
            let values: Vec<T> = steps.iter().map(number).collect();
            Tensor::from_slice(&values).view([-1, columns as i64])
        }
        let (steps, columns, side) = (&self.steps, self.columns, self.kept.frames.size()[1]);
        let StepTable { numbers, previous_actions, actions, masks, log_probs, values } = self.table_on(Device::Cpu);
        let bootstrap: Vec<f32> = self.bootstrap.iter().map(|value| value.unwrap_or(f32::NAN)).collect();
        let Kept { frames, images } =
            self.kept.map(|part| part.narrow(0, 0, steps.len() as i64).to_device(Device::Cpu));
        let size = [(steps.len() / columns) as i64, columns as i64];
        let cells = |rows: &Tensor| rows.view([&size, &rows.size()[1..]].concat().as_slice());
        // One choice needs no dimension of its own.
        let is_alone = actions.kind() == Kind::Int64 && actions.size()[1] == 1;
        let actions = if is_alone { actions.squeeze_dim(1) } else { actions };
        let mut tensors = BTreeMap::from([
            ("frames", cells(&frames)),
            ("images", cells(&images)),
            // What stands beside a frame is called the goal.
            (if side == 0 { "numbers" } else { "goal" }, cells(&numbers)),
            ("previous_action", cells(&previous_actions)),
            ("episode_start", table(steps, columns, |step| step.episode_start)),
            ("action", cells(&actions)),
            ("log_prob", cells(&log_probs)),
            ("value", cells(&values)),
            ("reward", table(steps, columns, |step| step.reward)),
            ("discounted_return", table(steps, columns, |step| step.discounted_return)),
            ("ended", table(steps, columns, |step| step.ended)),
            ("time_limit", table(steps, columns, |step| step.time_limit)),
            ("last_value", table(steps, columns, |step| step.last_value.unwrap_or(f32::NAN))),
            ("disturbed", table(steps, columns, |step| step.label)),
            ("recorded", Tensor::from_slice(&self.recorded).view([-1, columns as i64])),
            ("bootstrap", Tensor::from_slice(&bootstrap)),
        ]);
        tensors.extend(masks.map(|masks| ("mask", cells(&masks))));
        tensors
    }

    /// Ends it after its first `steps` steps, which all columns have taken. Panics if it is not longer than that.
    pub fn cut(&mut self, steps: usize) {
        assert!((1..self.shape.steps).contains(&steps), "a rollout is cut short");
        let rows = steps * self.columns;
        self.shape = RolloutShape { steps, environments_in_last_step: self.columns, frames: rows as u64 };
        self.steps.truncate(rows);
        self.recorded.truncate(rows);
    }

    /// Moves frames and images to another store of the same size and returns the one that they were in.
    pub(crate) fn move_to(&mut self, store: Kept) -> Kept {
        let rows = self.steps.len() as i64;
        for (to, from) in store.parts(&self.kept) {
            tch::no_grad(|| to.narrow(0, 0, rows).copy_(&from.narrow(0, 0, rows)));
        }
        std::mem::replace(&mut self.kept, store)
    }

    pub(crate) fn into_kept(self) -> Kept {
        self.kept
    }

    fn index(&self, t: usize, column: usize) -> usize {
        assert!(t < self.shape.steps && column < self.columns, "({t}, {column}) lies outside the rollout");
        t * self.columns + column
    }
}

/// Masks of steps: bool \[steps, options\]; none in a task without masks. A step that was never stored allows nothing.
pub(crate) fn masks_of<'a>(steps: impl Iterator<Item = &'a Step> + Clone, device: Device) -> Option<Tensor> {
    let options = steps.clone().map(|step| step.mask.len()).max().filter(|&options| options > 0)?;
    let of = move |step: &'a Step| step.mask.iter().copied().chain(std::iter::repeat(false)).take(options);
    let masks: Vec<bool> = steps.flat_map(of).collect();
    Some(upload(&masks, device).view([-1, options as i64]))
}

/// Actions of steps: \[steps, choices\] or \[steps, numbers\].
fn actions_of<'a>(steps: impl Iterator<Item = &'a Step> + Clone, device: Device) -> Tensor {
    // Of a step that was never stored there is none.
    let blank = match steps.clone().find_map(|step| step.action.as_ref()) {
        Some(PolicyAction::Numbers(numbers)) => PolicyAction::Numbers(vec![0.0; numbers.len()]),
        Some(PolicyAction::Options(options)) => PolicyAction::Options(vec![0; options.len()]),
        None => PolicyAction::Options(vec![0]),
    };
    let (mut rows, mut options, mut numbers) = (0, vec![], vec![]);
    for step in steps {
        rows += 1;
        match step.action.as_ref().unwrap_or(&blank) {
            PolicyAction::Options(chosen) => options.extend_from_slice(chosen),
            PolicyAction::Numbers(drawn) => numbers.extend_from_slice(drawn),
        }
    }
    let width = (options.len() + numbers.len()).checked_div(rows).unwrap_or(1);
    let table = if numbers.is_empty() { upload(&options, device) } else { upload(&numbers, device) };
    table.view([rows as i64, width as i64])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rollout() -> Rollout {
        // 3 steps of 2 columns, the second of which holds in the last.
        let shape = RolloutShape { steps: 3, environments_in_last_step: 1, frames: 5 };
        let float = (Kind::Float, Device::Cpu);
        Rollout::new(shape, 2, Kept::of_frames(Tensor::zeros([6, 1, 1], float)), Tensor::zeros([2, 4], float))
    }

    #[test]
    fn a_frame_without_an_outcome_is_found() {
        let mut rollout = rollout();
        let outcome = Outcome { reward: 1.0, ..Outcome::default() };
        for (t, n) in [(0, 0), (0, 1), (1, 0), (2, 0)] {
            rollout.record(t, n, outcome);
        }
        assert_eq!(rollout.first_missing(), Some((1, 1)));
        rollout.record(1, 1, outcome);
        assert_eq!(rollout.first_missing(), None);
    }
}
