//! The agent: network, beliefs, rollout and optimiser behind one struct.
//!
//! ```text
//! begin_rollout ─▶ step, record … ─▶ bootstrap ─▶ begin_update, finish_update ─▶ begin_rollout …
//!               └▶ abandon_rollout
//! ```
//! After [`Agent::overlap`] the next rollout can be collected between the two calls.
//!
//! It reads no files and no clock, and it draws nothing: the noise that samples actions comes in with the observations.
//! It exchanges numbers with the other learners in an update, where their gradients add up, and with
//! `ppo.preemption_share` in [`Agent::is_preempted`]. Without that setting the same calls give the same weights, bit
//! for bit, with the same number of learners or the same shards: on the CPU with the same number of threads, and with
//! `learner.deterministic` on the same kind of GPU.

mod acting;
mod choosing;
mod error;
mod overlap;
mod padding;
mod sampling;
mod shards;
mod state;
mod step;
mod trainer;

pub use error::{AgentError, OtherSign};
pub use state::AgentState;
pub(crate) use state::{ACTING, BELIEFS, MODEL, weights_of};
pub use step::{Batch, Choice, StepInput, StepOutput};

use crate::device;
use crate::network::{IMAGES, Kept, Network, Staging, Unfit, fits, to_vec};
use crate::optimizer::Adam;
use crate::peers::{PeerError, Peers};
use crate::ppo::lagrangian::ascend;
use crate::ppo::preemption::ends_early;
use crate::ppo::running::{Running, STATISTICS};
use crate::rollout::{Outcome, Rollout};
use crate::shards::Shards;
use acting::Acting;
use overlap::{Overlap, policy};
use padding::batch_rows;
use proto::config::Config;
use proto::stage::RolloutShape;
use proto::task::PolicyAction;
use sampling::{option, sample};
use state::{FIRST_MOMENT, SECOND_MOMENT};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Range;
use step::{Inference, column_indices};
use tch::{Device, Tensor};
use trainer::{Done, HERE, Job, Trainer, build};

#[derive(Debug)]
pub struct Agent {
    config: Config,
    device: Device,
    /// None while an update has it.
    trainer: Option<Box<Trainer>>,
    /// An update that was begun and waits to be made.
    due: Option<Job>,
    overlap: Option<Overlap>,
    /// PPO-Lagrangian's λ: moves only in its stages.
    multiplier: f64,
    /// This learner's columns, numbered as in the whole run.
    columns: Range<usize>,
    shards: Shards,
    /// Rows that go through the network together, where a step may be of fewer columns.
    batch_rows: Option<usize>,
    /// The belief's states before the next observation, \[columns, state\]: all rows but the last of `table`.
    beliefs: Tensor,
    /// \[columns + 1, state\].
    table: Tensor,
    rollout: Option<Rollout>,
    /// Room for a rollout's frames and images while no rollout holds it.
    kept: Option<Kept>,
    staging: Staging,
    /// The step on a GPU.
    acting: Option<Acting>,
}

impl Agent {
    /// An agent for all environments of a run. Its initial weights are a function of the network's configuration and
    /// `config.seed`.
    pub fn new(config: &Config, device: Device) -> Result<Self, AgentError> {
        Self::among(Peers::Alone, 0..config.environments(), config, device)
    }

    /// The same as one of several, for its own of the run's columns.
    pub fn among(peers: Peers, columns: Range<usize>, config: &Config, device: Device) -> Result<Self, AgentError> {
        let (network, auxiliary) = build(config, device)?;
        let adam = Adam::new(&network.parameters.flat());
        let table = network.belief.blank(columns.len() as i64 + 1, device);
        let beliefs = table.narrow(0, 0, columns.len() as i64);
        let acting = device.is_cuda().then(|| Acting::new(&network, columns.len(), device));
        let acting = acting.transpose().unwrap_or_else(|error| {
            tracing::warn!("acting goes through libtorch operation by operation, which takes longer: {error}");
            None
        });
        let (shards, first_column) = (Shards::of(config, &columns), columns.start);
        let running = Running::before(config);
        let alike = network.belief.state() == 0 && auxiliary.is_none() && !network.is_fused();
        let graphs = (device.is_cuda() && alike).then(RefCell::default);
        let trainer =
            Trainer { network, auxiliary, adam, running, peers, shards: shards.clone(), first_column, graphs };
        let batch_rows = batch_rows(config, &shards).filter(|_| acting.as_ref().is_some_and(Acting::is_by_kernels));
        let agent = Self {
            config: config.clone(),
            device,
            trainer: Some(Box::new(trainer)),
            due: None,
            overlap: None,
            multiplier: config.reward.lagrangian.initial,
            columns,
            shards,
            batch_rows,
            beliefs,
            table,
            rollout: None,
            kept: None,
            staging: Staging::default(),
            acting,
        };
        agent.check_weights()?;
        Ok(agent)
    }

    /// From now on a rollout can be collected while an update runs: with the weights from before it.
    pub fn overlap(&mut self) -> Result<(), AgentError> {
        let overlap = Overlap::start(&self.config, self.device)?;
        overlap.publish(&self.trainer().network);
        self.overlap = Some(overlap);
        Ok(())
    }

    /// Begins a rollout and remembers the beliefs it starts from. A rollout in progress is forgotten.
    pub fn begin_rollout(&mut self, shape: RolloutShape) {
        let columns = self.columns.len();
        // One more, for what nobody needs.
        let rows = (shape.steps * columns) as i64 + 1;
        let abandoned = self.rollout.take().map(Rollout::into_kept);
        let kept = self
            .kept
            .take()
            .or(abandoned)
            .filter(|kept| kept.rows() >= rows)
            .unwrap_or_else(|| self.policy().store(rows.max(self.largest_rollout() + 1)));
        self.rollout = Some(Rollout::new(shape, columns, kept, self.beliefs.copy()));
    }

    /// Chooses actions for some columns and advances their beliefs, outside of any rollout: nothing is stored. Panics
    /// when the input's slices differ in length.
    pub fn act(&mut self, input: &StepInput) -> Result<Choice, AgentError> {
        input.check();
        let (head, count) = (self.config.action_head(), input.columns.len());
        assert_eq!(input.gumbel.len(), count * head.outputs(), "noise for every column");
        let steps = self.seen(input)?;
        let Inference { beliefs, policy, .. } = self.infer(input, &steps)?;
        let rows = policy.chunks_exact(policy.len() / count).zip(input.gumbel.chunks_exact(head.outputs()));
        let chosen: Vec<PolicyAction> = rows.map(|(row, noise)| sample(&head, row, noise).0).collect();
        let _no_grad = tch::no_grad_guard();
        self.carry(input.columns, &beliefs);
        let Trainer { network, auxiliary, .. } = self.trainer();
        let beliefs = network.belief.of(&beliefs);
        let foretold = auxiliary.label_logits(&network.parameters, &beliefs).map(|logits| {
            let options: Vec<usize> = chosen.iter().map(option).collect();
            let logits = logits.gather(1, &column_indices(&options, self.device).unsqueeze(1), false);
            to_vec(&logits).into_iter().map(|logit| logit > 0.0).collect()
        });
        let mut actions = vec![];
        for action in &chosen {
            head.write(action, &mut actions);
        }
        Ok(Choice { actions, foretold })
    }

    /// Beliefs before these columns' next observations; without memory there are none.
    fn carry(&mut self, columns: &[usize], beliefs: &Tensor) {
        if self.beliefs.size()[1] > 0 {
            let _ = self.beliefs.index_copy_(0, &column_indices(columns, self.device), beliefs);
        }
    }

    /// Records the outcome of a column's action in step `t`. Not called for a column that held.
    pub fn record(&mut self, t: usize, column: usize, outcome: Outcome) {
        let rollout = self.rollout.as_mut().expect("record is called between begin_rollout and update");
        rollout.record(t, column, outcome);
    }

    /// Values what was seen last of the episode that a column's action in step `t` truncated, with the belief before
    /// the next one begins; after [`Agent::record`]. Nothing happens unless ends by the step limit are to be
    /// bootstrapped. Panics outside a rollout.
    pub fn value_last(&mut self, t: usize, column: usize, numbers: &[f32]) -> Result<(), AgentError> {
        if !self.config.ppo.bootstrap_time_limits {
            return Ok(());
        }
        let rollout = self.rollout.as_ref().expect("an episode ends within a rollout");
        let chosen = rollout.step(t, column).action.as_ref().expect("an action led there");
        // Only an action with a name is an input.
        let action = self.config.policy_actions().get(sampling::option(chosen)).copied().unwrap_or_default();
        // By itself: so no bit depends on which episodes end together.
        let input = StepInput {
            columns: &[column],
            frames: &[],
            images: &[],
            numbers,
            previous_action: &[action],
            episode_start: &[false],
            masks: &[],
            gumbel: &[],
        };
        let steps = self.seen(&input)?;
        let Inference { values, .. } = self.infer(&input, &steps)?;
        self.rollout.as_mut().expect("it is still there").set_last_value(t, column, values[0]);
        Ok(())
    }

    /// Whether this learner, `steps` of `planned` steps into rollout `rollout`, should let the others wait no longer.
    pub fn is_preempted(&self, rollout: u64, steps: usize, planned: usize) -> Result<bool, PeerError> {
        let share = self.config.ppo.preemption_share;
        Ok(share > 0.0 && ends_early(share, [steps, planned], self.peers().finished(rollout)?))
    }

    /// Whether a step's columns may be whichever are ready, without changing a bit.
    pub(crate) fn takes_who_is_ready(&self) -> bool {
        self.batch_rows.is_some() && self.config.ppo.preemption_share == 0.0
    }

    pub fn columns(&self) -> Range<usize> {
        self.columns.clone()
    }

    pub(crate) fn shards(&self) -> &Shards {
        &self.shards
    }

    /// All learners. Not to be called while an update runs, which makes its own calls to them.
    pub fn peers(&self) -> &Peers {
        &self.trainer().peers
    }

    /// Ends the rollout after its first `steps` steps. The next observations go to [`Agent::bootstrap`]. Panics outside
    /// a rollout, or if it is not longer than that.
    pub fn cut_rollout(&mut self, steps: usize) {
        self.rollout.as_mut().expect("a rollout in progress is cut").cut(steps);
    }

    /// Trains on the rollout: [`Agent::begin_update`] and [`Agent::finish_update`].
    pub fn update(&mut self, progress: f64, rollout: u64) -> Result<BTreeMap<String, f64>, AgentError> {
        self.begin_update(progress, rollout);
        self.finish_update()
    }

    /// Ends the rollout, to train on it. `progress` is how far the learning rate has fallen; `rollout` its number.
    /// Panics when an action's outcome or a column's bootstrap value is missing, or when an update was not finished.
    pub fn begin_update(&mut self, progress: f64, rollout: u64) {
        let collected = self.rollout.take().expect("update ends a rollout");
        if let Some((t, column)) = collected.first_missing() {
            panic!("rollout {rollout}: action {t} of column {column} has no outcome");
        }
        let trainer = self.trainer.take().expect("one update at a time");
        let job = Job::new(trainer, collected, rollout, progress, &self.config);
        match &mut self.overlap {
            Some(overlap) => self.kept = Some(overlap.begin(job)),
            None => self.due = Some(job),
        }
    }

    /// The figures of the update that was begun, once it is through. After an error its rollout is kept, so that it can
    /// be inspected or abandoned; one in progress is forgotten.
    ///
    /// Figures: [`proto::metric`] from `loss/policy` on, and the auxiliary task's as `auxiliary/…`. Panics when none
    /// was begun.
    pub fn finish_update(&mut self) -> Result<BTreeMap<String, f64>, AgentError> {
        let Done { trainer, collected, result } = match (self.due.take(), &mut self.overlap) {
            (Some(job), _) => job.run(),
            (None, Some(overlap)) => overlap.finish(),
            (None, None) => panic!("an update is finished that was begun"),
        };
        self.trainer = Some(trainer);
        match (&result, &mut self.overlap) {
            (Ok(_), Some(overlap)) => overlap.store = Some(collected.into_kept()),
            (Ok(_), None) => self.kept = Some(collected.into_kept()),
            (Err(_), _) => self.rollout = Some(collected),
        }
        result
    }

    /// Waits for an update in progress, whatever comes of it. The rollout in progress stays.
    pub(crate) fn await_update(&mut self) {
        if let Some(overlap) = self.overlap.as_mut().filter(|overlap| overlap.is_busy()) {
            self.trainer = Some(overlap.finish().trainer);
        }
    }

    /// Puts the beliefs back to where the rollout began and forgets it.
    pub fn abandon_rollout(&mut self) {
        if let Some(rollout) = self.rollout.take() {
            tch::no_grad(|| self.beliefs.copy_(rollout.beliefs_at_start()));
            self.kept = Some(rollout.into_kept());
        }
    }

    pub fn multiplier(&self) -> f64 {
        self.multiplier
    }

    /// PPO-Lagrangian's step of the multiplier after an update, by the mean discounted cost of the episodes that ended. If
    /// none ended, the multiplier does not change.
    pub fn constrain(&mut self, mean_discounted_cost: Option<f64>) {
        if let Some(cost) = mean_discounted_cost {
            self.multiplier = ascend(self.multiplier, self.config.reward.lagrangian.learning_rate, cost);
        }
    }

    /// A new stage: a fresh optimiser, of the multiplier too. Weights and beliefs go on.
    pub fn start_stage(&mut self) {
        self.trainer_mut().adam.restart();
        self.multiplier = self.config.reward.lagrangian.initial;
    }

    /// The rollout in progress for diagnosis: tensors on the CPU named `rollout.…`. Empty if no rollout is in progress.
    /// The beliefs it began with are in [`Agent::state`].
    pub fn rollout_tensors(&self) -> BTreeMap<String, Tensor> {
        let Some(rollout) = &self.rollout else { return BTreeMap::new() };
        let mut tensors = rollout.tensors();
        let images = tensors.remove("images").expect("a rollout has rows of images, if only of none");
        let cells = images.size();
        let named = self.policy().images().named(&images.flatten(0, 1)).into_iter().map(|(name, image)| {
            let of_cells = [&cells[..2], &image.size()[1..]].concat();
            (format!("{IMAGES}{name}"), image.view(of_cells.as_slice()))
        });
        let tensors = tensors.into_iter().map(|(name, tensor)| (name.to_owned(), tensor)).chain(named);
        tensors.map(|(name, tensor)| (format!("rollout.{name}"), tensor)).collect()
    }

    /// SHA-256 over (name, 0, dimensions as little-endian u64, little-endian f32 values) of all weights in name order,
    /// 64 hex digits.
    pub fn weights_digest(&self) -> String {
        self.trainer().network.parameters.digest()
    }

    /// Device and precision as text: see [`device::describe`].
    pub fn device(&self) -> String {
        device::describe(self.device, self.policy().is_in_bfloat16())
    }

    pub(crate) fn parameter_count(&self) -> u64 {
        self.policy().parameters.count() as u64
    }

    /// Everything a checkpoint keeps, as of the last rollout boundary: in the middle of a rollout, the beliefs are
    /// those it started from.
    pub fn state(&self) -> AgentState {
        let host = |tensor: &Tensor| tensor.detach().to_device(Device::Cpu).copy();
        let Trainer { network, adam, running, .. } = self.trainer();
        let acting = self.overlap.iter().map(|overlap| (ACTING, &overlap.policy));
        let mut tensors: BTreeMap<String, Tensor> = running.tensors().collect();
        for (prefix, network) in acting.chain([(MODEL, network)]) {
            let weights = network.parameters.named();
            tensors.extend(weights.map(|(name, weight)| (format!("{prefix}{name}"), host(&weight))));
        }
        tensors.insert(FIRST_MOMENT.into(), host(&adam.first));
        tensors.insert(SECOND_MOMENT.into(), host(&adam.second));
        tensors.insert(BELIEFS.into(), self.boundary_beliefs());
        AgentState {
            tensors,
            adam_steps: adam.steps,
            multiplier: self.multiplier,
            carried_goal: self.config.network.carried_goal,
        }
    }

    /// Beliefs' states \[columns, state\] as of the last rollout boundary, on the CPU.
    pub(crate) fn boundary_beliefs(&self) -> Tensor {
        let beliefs = self.rollout.as_ref().map_or(&self.beliefs, Rollout::beliefs_at_start);
        beliefs.detach().to_device(Device::Cpu).copy()
    }

    /// Goes on from a saved state; a rollout in progress is forgotten. After an error nothing has changed.
    pub fn load_state(&mut self, state: &AgentState) -> Result<(), AgentError> {
        let AgentState { tensors, adam_steps, multiplier, carried_goal } = state;
        OtherSign::refuse(*carried_goal, &self.config.network)?;
        let saved = |name: &str, place: &Tensor| fits(name, tensors.get(name), &place.size());
        let first = saved(FIRST_MOMENT, &self.trainer().adam.first)?;
        let second = saved(SECOND_MOMENT, &self.trainer().adam.second)?;
        let beliefs = saved(BELIEFS, &self.beliefs)?;
        let known = |name: &str| {
            [MODEL, ACTING, STATISTICS].iter().any(|prefix| name.starts_with(prefix))
                || [FIRST_MOMENT, SECOND_MOMENT, BELIEFS].contains(&name)
        };
        if let Some(name) = tensors.keys().find(|name| !known(name)) {
            return Err(Unfit::no_place(name).into());
        }
        if !multiplier.is_finite() {
            return Err(Unfit::not_finite("multiplier").into());
        }
        if let Some(unfit) = self.trainer().running.differing(tensors) {
            return Err(unfit.into());
        }
        self.load(tensors, &weights_of(tensors, ACTING))?;
        // Nothing can fail from here on.
        self.abandon_rollout();
        let adam = &mut self.trainer.as_mut().expect(HERE).adam;
        tch::no_grad(|| {
            adam.first.copy_(first);
            adam.second.copy_(second);
            self.beliefs.copy_(beliefs);
        });
        adam.steps = *adam_steps;
        self.multiplier = *multiplier;
        Ok(())
    }

    /// Takes the weights of another run's state, with the statistics that belong to them, and nothing else. After an
    /// error nothing has changed.
    pub fn load_weights(&mut self, state: &AgentState) -> Result<(), AgentError> {
        OtherSign::refuse(state.carried_goal, &self.config.network)?;
        Ok(self.load(&state.tensors, &BTreeMap::new())?)
    }

    /// Takes a state's weights and statistics, and other weights to act with; the same where there are none. After an
    /// error nothing has changed.
    fn load(&mut self, tensors: &BTreeMap<String, Tensor>, acting: &BTreeMap<String, Tensor>) -> Result<(), Unfit> {
        let trainer = self.trainer.as_mut().expect(HERE);
        let before = trainer.network.parameters.flat().copy();
        let running = trainer.running.found_in(tensors)?;
        trainer.network.parameters.load(&weights_of(tensors, MODEL))?;
        let loaded = match &mut self.overlap {
            None => Ok(()),
            Some(overlap) if acting.is_empty() => {
                overlap.publish(&trainer.network);
                Ok(())
            }
            Some(overlap) => overlap.policy.parameters.load(acting).inspect_err(|_| {
                tch::no_grad(|| trainer.network.parameters.flat().copy_(&before));
            }),
        };
        loaded.map(|()| trainer.running = running)
    }

    /// Actors have started again. To be called before frames of theirs are given to a step.
    pub(crate) fn recheck_memory(&mut self) {
        if let Some(acting) = &mut self.acting {
            acting.recheck_memory();
        }
    }

    fn policy(&self) -> &Network {
        policy(self.overlap.as_ref(), self.trainer.as_deref())
    }

    fn trainer(&self) -> &Trainer {
        self.trainer.as_deref().expect(HERE)
    }

    fn trainer_mut(&mut self) -> &mut Trainer {
        self.trainer.as_deref_mut().expect(HERE)
    }

    fn largest_rollout(&self) -> i64 {
        i64::from(self.config.ppo.rollout_steps) * self.columns.len() as i64
    }

    fn check_weights(&self) -> Result<(), AgentError> {
        let parameters = &self.policy().parameters;
        match parameters.first_non_finite(&parameters.flat()) {
            Some(name) => Err(AgentError::NonFinite { what: format!("weight {name}") }),
            None => Ok(()),
        }
    }
}
