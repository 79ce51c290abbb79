//! One step of the policy for columns that are inferred together: on a GPU as one graph.

use super::acting::{Policy, Rows};
use super::overlap::policy;
use super::padding::padded;
use super::sampling::{Sampled, sample};
use super::step::{Inference, column_indices, pick};
use super::{Agent, AgentError, StepInput, StepOutput};
use crate::network::{FramePreparation, Kept, Observations, coordinates, table_row, to_vec};
use crate::rollout::{Step, masks_of};
use tch::Tensor;

impl Agent {
    /// [`Agent::step_each`] for columns that are inferred together.
    pub(super) fn step_together(&mut self, rows: &[usize], input: &StepInput) -> Result<StepOutput, AgentError> {
        input.check();
        let count = input.columns.len();
        let draws = self.config.action_head().outputs();
        let steps = self.rollout.as_ref().expect("step is called between begin_rollout and update").shape().steps;
        // Whose last action is taken chooses none, and needs no noise.
        let silence = rows.iter().all(|&t| t == steps).then(|| vec![0.0; count * draws]);
        let input = &StepInput { gumbel: silence.as_deref().unwrap_or(input.gumbel), ..*input };
        assert_eq!(input.gumbel.len(), count * draws, "noise for every column");
        let choices = match self.batch_rows.filter(|&wanted| count < wanted) {
            Some(wanted) => self.choose(rows, &padded(input, rows, wanted).input())?,
            None => self.choose(rows, input)?,
        };
        Ok(self.note(rows, input.columns, choices))
    }

    /// What the policy makes of a batch, of which the first `rows.len()` rows are kept: their frames and beliefs are,
    /// what was chosen is not yet.
    fn choose(&mut self, rows: &[usize], input: &StepInput) -> Result<Vec<(Step, Sampled)>, AgentError> {
        let steps = self.seen(input)?;
        let choices = match self.choose_on_gpu(rows, input, &steps)? {
            Some(choices) => choices,
            None => self.choose_by_operations(rows, input, &steps)?,
        };
        match choices.iter().zip(input.columns).take(rows.len()).find(|(choice, _)| !choice.finite) {
            Some((_, column)) => Err(AgentError::NonFinite { what: format!("column {column}: policy or value") }),
            None => Ok(steps.into_iter().zip(choices).take(rows.len()).collect()),
        }
    }

    /// The same as [`Agent::choose_on_gpu`], by libtorch's operations.
    fn choose_by_operations(
        &mut self,
        rows: &[usize],
        input: &StepInput,
        steps: &[Step],
    ) -> Result<Vec<Sampled>, AgentError> {
        let Inference { kept, beliefs, policy, values } = self.infer(input, steps)?;
        let rollout = self.rollout.as_mut().expect("step is called between begin_rollout and update");
        let head = self.config.action_head();
        let choose = |((row, noise), &value): ((&[f32], &[f32]), &f32)| {
            let (action, log_prob) = sample(&head, row, noise);
            Sampled { action, log_prob, value, finite: true }
        };
        let noisy = policy.chunks_exact(policy.len() / values.len()).zip(input.gumbel.chunks_exact(head.outputs()));
        let choices = noisy.zip(&values).map(choose).collect();

        let places = |holds: &dyn Fn(usize, usize) -> bool| -> Vec<usize> {
            (0..rows.len()).filter(|&row| holds(rows[row], input.columns[row])).collect()
        };
        let seen = places(&|t, _| t < rollout.shape().steps);
        let acting = places(&|t, column| rollout.is_valid(t, column));
        if !seen.is_empty() {
            rollout.keep(seen.iter().map(|&row| (rows[row], input.columns[row])), &kept.map(|part| pick(part, &seen)));
        }
        if !acting.is_empty() {
            let columns: Vec<usize> = acting.iter().map(|&row| input.columns[row]).collect();
            self.carry(&columns, &pick(&beliefs, &acting));
        }
        Ok(choices)
    }

    /// The network's inputs besides the frames; no actions are chosen yet.
    pub(super) fn seen(&self, input: &StepInput) -> Result<Vec<Step>, AgentError> {
        let StepInput { columns, numbers, previous_action, episode_start, masks, .. } = *input;
        let rows = columns.len();
        let (space, mut steps) = (self.config.policy_actions(), Vec::with_capacity(rows));
        let [width, options] = [numbers.len(), masks.len()].map(|count| count / rows);
        for (row, &column) in columns.iter().enumerate() {
            let numbers = &numbers[row * width..][..width];
            if !numbers.iter().all(|number| number.is_finite()) {
                return Err(AgentError::NonFinite { what: format!("column {column}: an observation") });
            }
            let action = (!episode_start[row]).then_some(previous_action[row]);
            steps.push(Step {
                numbers: coordinates(self.config.network.goal, numbers),
                previous_action: table_row(&space, action)
                    .ok_or(AgentError::UnknownAction { column, action: previous_action[row] })?,
                episode_start: episode_start[row],
                mask: masks[row * options..][..options].to_vec(),
                ..Step::default()
            });
        }
        Ok(steps)
    }

    /// What the policy makes of a batch, by [`Acting`]. `None` where there is none. Observations and beliefs of the first
    /// `rows.len()` rows are stored; what was chosen is not.
    fn choose_on_gpu(
        &mut self,
        rows: &[usize],
        input: &StepInput,
        steps: &[Step],
    ) -> Result<Option<Vec<Sampled>>, AgentError> {
        let network = policy(self.overlap.as_ref(), self.trainer.as_deref());
        let (Some(acting), Some(rollout)) = (&mut self.acting, self.rollout.as_ref()) else { return Ok(None) };
        let (unused_belief, unused_place) = (self.table.size()[0] - 1, rollout.unused_place());
        let columns: Vec<i64> = input.columns.iter().map(|&column| column as i64).collect();
        let (mut places, mut beliefs_to) = (vec![unused_place; columns.len()], vec![unused_belief; columns.len()]);
        for (row, (&t, &column)) in rows.iter().zip(input.columns).enumerate() {
            if t < rollout.shape().steps {
                places[row] = rollout.place(t, column);
            }
            // A column that holds keeps its belief, because the same observation comes again.
            if rollout.is_valid(t, column) {
                beliefs_to[row] = column as i64;
            }
        }
        let batch = Rows {
            frames: input.frames,
            images: input.images,
            noise: input.gumbel,
            places: &places,
            columns: &columns,
            beliefs_to: &beliefs_to,
            steps,
        };
        let head = &self.config.action_head();
        let policy = Policy { network, head, beliefs: &self.table, store: rollout.kept() };
        Ok(Some(acting.step(policy, batch)?))
    }

    /// Notes what was chosen for each column at its row, or its value after the last.
    fn note(&mut self, rows: &[usize], columns: &[usize], choices: Vec<(Step, Sampled)>) -> StepOutput {
        let head = self.config.action_head();
        let rollout = self.rollout.as_mut().expect("step is called between begin_rollout and update");
        let mut output = StepOutput::default();
        for ((mut step, choice), (&t, &column)) in choices.into_iter().zip(rows.iter().zip(columns)) {
            let Sampled { log_prob, value, action, .. } = choice;
            head.write(&action, &mut output.actions);
            if t == rollout.shape().steps {
                rollout.set_bootstrap(column, value);
            } else {
                (step.action, step.log_prob, step.value) = (Some(action), log_prob, value);
                rollout.note(t, column, step);
            }
            output.log_probs.push(log_prob);
            output.values.push(value);
        }
        output
    }

    /// What the network gives for a batch; nothing is stored.
    pub(super) fn infer(&mut self, input: &StepInput, steps: &[Step]) -> Result<Inference, AgentError> {
        let StepInput { columns, frames, images, episode_start, .. } = *input;
        let rows = columns.len();
        let network = policy(self.overlap.as_ref(), self.trainer.as_deref());
        let preparation: FramePreparation = network.preparation;
        let numbers: Vec<f32> = steps.iter().flat_map(|step| &step.numbers).copied().collect();
        let previous_actions: Vec<i64> = steps.iter().map(|step| step.previous_action).collect();
        let carried: Vec<f32> = episode_start.iter().map(|&start| if start { 0.0 } else { 1.0 }).collect();
        let to_device = |tensor: Tensor| tensor.to_device(self.device);

        let _no_grad = tch::no_grad_guard();
        let frames = match frames {
            [] => preparation.store(rows as i64),
            frames => preparation.keep(frames, &mut self.staging),
        };
        let by_row = |tensor: Tensor| tensor.view([rows as i64, (tensor.numel() / rows) as i64]);
        let observations = Observations {
            kept: Kept { frames, images: to_device(network.images().gather(images, rows)) },
            numbers: to_device(by_row(Tensor::from_slice(&numbers))),
            previous_actions: to_device(Tensor::from_slice(&previous_actions)),
        };
        let before = self.beliefs.index_select(0, &column_indices(columns, self.device))
            * to_device(Tensor::from_slice(&carried).unsqueeze(1));
        let (beliefs, judged) = network.judge(&observations, &before, masks_of(steps.iter(), self.device).as_ref());
        // One copy back.
        let judged = to_vec(&judged);
        let mut policy = Vec::with_capacity(judged.len());
        let mut values = Vec::with_capacity(rows);
        for (row, &column) in judged.chunks_exact(judged.len() / rows).zip(columns) {
            if !row.iter().all(|number| number.is_finite()) {
                return Err(AgentError::NonFinite { what: format!("column {column}: policy or value") });
            }
            let (value, row_policy) = row.split_last().expect("a row has at least the value");
            policy.extend_from_slice(row_policy);
            values.push(*value);
        }
        Ok(Inference { kept: observations.kept, beliefs, policy, values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::Batch;
    use crate::agent::acting::Acting;
    use crate::bench::Frames;
    use proto::config::Config;
    use proto::stage::RolloutShape;
    use std::collections::BTreeMap;
    use tch::Device;

    /// The rows of both halves that a rule picks, as one input.
    fn picked<'a>(halves: &[Batch<'a>; 2], pick: impl Fn(usize) -> bool) -> Batch<'a> {
        let mut rows: Vec<(usize, usize, usize)> = vec![];
        for (half, batch) in halves.iter().enumerate() {
            let columns = batch.columns.iter().enumerate();
            rows.extend(columns.filter(|(_, column)| pick(**column)).map(|(row, &column)| (column, half, row)));
        }
        rows.sort_unstable();
        let actions = halves[0].gumbel.len() / halves[0].columns.len();
        let at = || rows.iter().map(|&(_, half, row)| (&halves[half], row));
        Batch {
            columns: rows.iter().map(|row| row.0).collect(),
            at: at().map(|(batch, row)| batch.at[row]).collect(),
            frames: at().map(|(batch, row)| batch.frames[row]).collect(),
            images: vec![],
            numbers: at().flat_map(|(batch, row)| batch.numbers[row * 3..][..3].to_vec()).collect(),
            previous_action: at().map(|(batch, row)| batch.previous_action[row]).collect(),
            episode_start: at().map(|(batch, row)| batch.episode_start[row]).collect(),
            masks: vec![],
            gumbel: at().flat_map(|(batch, row)| batch.gumbel[row * actions..][..actions].to_vec()).collect(),
        }
    }

    /// To the last bit, by kernels and by operations: some go through all of a rollout before others begin, and halves stand
    /// beside one another in other places than in lockstep.
    #[test]
    #[ignore = "needs a CUDA device"]
    fn what_the_network_makes_of_a_row_does_not_depend_on_the_others() {
        const STEPS: usize = 3;
        let _alone = crate::device::cuda_alone();
        let mut config = Config::resolve("recipe", None).unwrap();
        for ([actors, environments], shards, groups) in [
            ([38, 1], 0, 5),
            ([128, 1], 0, 3),
            ([8, 1], 4, 3),
            ([19, 16], 0, 5),
            ([19, 16], 0, 2),
            ([8, 16], 4, 3),
            ([38, 16], 0, 4),
            ([10, 2], 0, 4),
        ] {
            // Frames come in two halves.
            let with_halves = if environments == 1 { [actors / 2, 2] } else { [actors, environments] };
            [config.actors.count, config.actors.environments_per_actor] = with_halves;
            let frames = Frames::new(&config).unwrap();
            [config.actors.count, config.actors.environments_per_actor] = [actors, environments];
            config.learner.shards = shards;
            let lanes = |column: usize| column / (environments as usize).div_ceil(2);
            for by_kernels in [true, false] {
                let [mut lockstep, mut ready] = [(); 2].map(|()| Agent::new(&config, Device::Cuda(0)).unwrap());
                let mut outputs = [BTreeMap::new(), BTreeMap::new()];
                for agent in [&mut lockstep, &mut ready] {
                    agent.acting = agent.acting.take().filter(|_| by_kernels);
                    agent.begin_rollout(RolloutShape::next(u64::MAX, STEPS, config.environments()));
                }
                let mut step = |agent: &mut Agent, which: usize, batch: &Batch| {
                    let output = agent.step_each(&batch.at, &batch.input()).unwrap();
                    for (row, (&t, &column)) in batch.at.iter().zip(&batch.columns).enumerate() {
                        // After the last action none is chosen.
                        let action = if t == STEPS { 0 } else { output.actions[row] };
                        let said = (action, output.values[row].to_bits());
                        assert!(outputs[which].insert((t, column), said).is_none());
                    }
                };
                for t in 0..=STEPS {
                    let halves = [0, 1].map(|half| frames.batch(half, t, frames.noise(half, t)));
                    let whole = if environments == 1 { vec![picked(&halves, |_| true)] } else { halves.into() };
                    for batch in &whole {
                        step(&mut lockstep, 0, batch);
                    }
                }
                for group in 0..groups {
                    for t in 0..=STEPS {
                        let halves = [0, 1].map(|half| frames.batch(half, t, frames.noise(half, t)));
                        // No more of a shard than fit.
                        for part in 0..2 {
                            let of = |column| lanes(column) * 7 % groups == group && lanes(column) / 2 % 2 == part;
                            let batch = picked(&halves, of);
                            if !batch.columns.is_empty() {
                                step(&mut ready, 1, &batch);
                            }
                        }
                    }
                }
                assert_eq!(ready.acting.as_mut().is_some_and(Acting::is_recorded), by_kernels);
                let [first, second] = outputs;
                assert_eq!(first.len(), (STEPS + 1) * config.environments());
                assert!(first == second, "{actors} x {environments}, kernels: {by_kernels}");
                assert!(lockstep.beliefs.equal(&ready.beliefs), "beliefs");
                let stored = |agent: &Agent| agent.rollout_tensors();
                let (one, other) = (stored(&lockstep), stored(&ready));
                for (name, tensor) in &one {
                    // Not a number is equal to nothing, but it is the same.
                    let (left, right) = (tensor.nan_to_num(7.0, None, None), other[name].nan_to_num(7.0, None, None));
                    assert!(left.equal(&right), "{name}");
                }
            }
        }
    }
}
