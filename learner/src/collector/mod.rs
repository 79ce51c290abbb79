//! The rollout collector: a state machine without I/O, clock or tensors. (Adding the statistics of several learners up,
//! [`RolloutStatistics::over`], is the one call that communicates with other processes; the training loop makes it
//! afterwards.)
//!
//! Its inputs are observation samples and the agent's actions, its output is the next [`Task`]. For each step of a
//! rollout and each half of the environments it waits until the observations of every actor have arrived, records the
//! outcomes of the last actions, lets the agent act, and sends the actions. After the last step it waits for one more
//! observation of each half, for the bootstrap values. These observations are kept: they are the first of the next
//! rollout.
//!
//! Where a run is recorded, a half goes on only when the recorder has its observations, too ([`Collector::unrecorded`]).
//! Until then an actor that is killed can send them again, last outcomes included. So no step is trained on that the
//! recorder has not seen.
//!
//! Nothing that arrives twice or late changes anything: every sample names its exchange and the learner incarnation it
//! goes back to. [`Collector::restore`] tells a restarted actor the state of its environments, at any moment; a
//! restarted learner begins from a [`Boundary`]. The tests crash both at every point and compare what was recorded.

mod column_map;
mod environments;
mod error;
mod exchange;
mod noise;
mod statistics;
#[cfg(test)]
mod tests;

pub use column_map::ColumnMap;
pub use environments::{Environments, Mismatch, Reward};
pub use error::ProtocolError;
pub use noise::gumbel;
pub(crate) use noise::gumbel_of;
pub use statistics::{RolloutStatistics, RunningEpisode};

use crate::agent::StepInput;
use crate::rollout::Outcome;
use crate::shards::Shards;
use exchange::{Arrival, Half};
use proto::action::HOLD;
use proto::camera::DepthFrame;
use proto::config::CarriedGoal;
use proto::episode::EnvironmentId;
use proto::stage::RolloutShape;
use proto::step::{Current, Transition, current_flag};
use wire::Receipt;
use wire::message::{ActionHeader, EnvironmentState, ObservationHeader, RestoreHeader, can_follow, observation_kind};

/// One actor's observations of one half, in the order of [`ColumnMap::half`].
pub trait HalfSample {
    /// Number of observations.
    fn len(&self) -> usize;
    /// True when it holds none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Environment index in observation `i`.
    fn environment(&self, i: usize) -> u32;
    /// What the last action did.
    fn transition(&self, i: usize) -> &Transition;
    /// What is seen now.
    fn current(&self, i: usize) -> &Current;
    /// Depth frame.
    fn frame(&self, i: usize) -> DepthFrame<'_>;
}

/// The state of all environments between two rollouts: with weights and beliefs, all a run needs to go on.
#[derive(Debug, Clone, PartialEq)]
pub struct Boundary {
    /// Exchange that the next rollout begins with, the same for both halves.
    pub exchange: u64,
    /// State of each environment, by column.
    pub environments: Vec<EnvironmentState>,
    /// Figures of each environment's episode in progress, by column.
    pub running: Vec<RunningEpisode>,
}

impl Boundary {
    /// The start of a run with `columns` environments.
    pub fn start(columns: usize) -> Self {
        Self {
            exchange: 0,
            environments: vec![EnvironmentState::start_of(0); columns],
            running: vec![RunningEpisode::default(); columns],
        }
    }
}

/// Constants of a collector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Columns.
    pub column_map: ColumnMap,
    /// Seed of the run, for the action noise.
    pub seed: u64,
    /// Actions of the policy head: Gumbel draws for each environment's step.
    pub policy_actions: usize,
    /// Step limit of an episode.
    pub max_episode_steps: u32,
    /// Sign of the goal vector while the target is held.
    pub carried_goal: CarriedGoal,
    /// Discount a step, of the disturbance that PPO-Lagrangian constrains.
    pub gamma: f64,
    /// Incarnation of this learner.
    pub learner_incarnation: u32,
    /// Whether there is a recorder, whose receipts are waited for.
    pub recorded: bool,
}

/// What to do next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Task {
    /// Receive until this half's observations are complete.
    Await {
        /// The half.
        half: u32,
    },
    /// Let the agent act on this half's [`Collector::batch`], then [`Collector::answer`].
    Act {
        /// The half.
        half: u32,
        /// Row of the rollout.
        t: usize,
    },
    /// Let the agent value this half's [`Collector::batch`], then [`Collector::bootstrapped`].
    Bootstrap {
        /// The half.
        half: u32,
    },
    /// The rollout is complete: [`Collector::finish`].
    Finish,
}

/// What was done with a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Received {
    /// It was expected and is kept.
    Kept,
    /// It was seen before.
    Duplicate,
    /// It belongs to another learner incarnation: the actor has not been restored yet.
    Foreign,
    /// An actor has started: answer with [`Collector::restore`].
    Hello {
        /// Actor number.
        actor: u32,
        /// Its incarnation.
        actor_incarnation: u32,
    },
}

/// Actions to send to one actor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ActionBatch {
    /// Actor number.
    pub actor: u32,
    /// Header.
    pub header: ActionHeader,
    /// One byte an environment of the half.
    pub actions: Vec<u8>,
}

/// What an action led to: the agent's record at row `t` of `column`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settled {
    /// Row of the rollout in which the action was taken.
    pub t: usize,
    /// Column.
    pub column: usize,
    /// What it led to.
    pub outcome: Outcome,
}

/// One half's observations of all actors, in batch order.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch<'a> {
    pub(crate) columns: Vec<usize>,
    pub(crate) frames: Vec<DepthFrame<'a>>,
    pub(crate) goal_m: Vec<[f32; 3]>,
    pub(crate) previous_action: Vec<u8>,
    pub(crate) episode_start: Vec<bool>,
    pub(crate) gumbel: Vec<f32>,
}

impl Batch<'_> {
    /// The batch as the agent takes it.
    pub fn input(&self) -> StepInput<'_> {
        StepInput {
            columns: &self.columns,
            frames: &self.frames,
            goal_m: &self.goal_m,
            previous_action: &self.previous_action,
            episode_start: &self.episode_start,
            gumbel: &self.gumbel,
        }
    }
}

/// Whose action is about to be chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// Column.
    pub column: usize,
    /// Its environment.
    pub environment: EnvironmentId,
    /// Episode number within the environment.
    pub episode: u32,
    /// Actions taken in it so far.
    pub step: u32,
}

/// Where a rollout stands.
#[derive(Debug)]
struct Cursor {
    shape: RolloutShape,
    reward: Reward,
    /// Turns taken: one for each (step, half), then one for each half's bootstrap.
    turn: usize,
    boundary: Boundary,
    /// Of each shard.
    statistics: Vec<RolloutStatistics>,
}

impl Cursor {
    /// Frames so far.
    fn frames(&self) -> u64 {
        self.statistics.iter().map(RolloutStatistics::frames).sum()
    }
}

/// The collector. `S` is whatever holds a received sample; it is kept until its actions have been sent.
#[derive(Debug)]
pub struct Collector<S> {
    settings: Settings,
    halves: Vec<Half<S>>,
    environments: Environments,
    /// What each column holds, as randomness counts it.
    ids: Vec<EnvironmentId>,
    /// Which shard each column is of.
    shards: Vec<usize>,
    /// Noise for each column's next action, drawn when its observation arrives.
    noise: Vec<Vec<f32>>,
    /// Newest incarnation that each actor has announced or sent under.
    actor_incarnations: Vec<u32>,
    stage_version: u64,
    cursor: Option<Cursor>,
}

impl<S: HalfSample> Collector<S> {
    /// A collector that goes on from `boundary`.
    ///
    /// # Panics
    /// If the boundary or the shards are not of as many environments as the column map.
    pub fn new(settings: Settings, shards: &Shards, boundary: Boundary) -> Self {
        let column_map = settings.column_map;
        let Boundary { exchange, environments, running } = boundary;
        let shards = shards.of_columns();
        assert_eq!(shards.len(), column_map.columns(), "every column is of a shard");
        Self {
            settings,
            halves: (0..column_map.halves()).map(|_| Half::new(column_map.actors(), exchange)).collect(),
            environments: Environments::new(
                column_map,
                settings.max_episode_steps,
                settings.gamma,
                environments,
                running,
            ),
            ids: (0..column_map.columns()).map(|column| column_map.environment(column)).collect(),
            shards,
            noise: vec![vec![]; column_map.columns()],
            actor_incarnations: vec![0; column_map.actors() as usize],
            stage_version: 0,
            cursor: None,
        }
    }

    /// Begins a rollout under the announcement with this version.
    ///
    /// # Panics
    /// If one is in progress.
    pub fn begin(&mut self, shape: RolloutShape, reward: Reward, stage_version: u64) {
        assert!(self.cursor.is_none(), "a rollout begins when the last one is finished");
        self.stage_version = stage_version;
        let boundary = self.boundary();
        let statistics = vec![RolloutStatistics::default(); self.shards.iter().max().map_or(0, |last| last + 1)];
        self.cursor = Some(Cursor { shape, reward, turn: 0, boundary, statistics });
    }

    /// The state as of the last boundary: the start of the rollout in progress, or now if there is none.
    pub fn boundary(&self) -> Boundary {
        if let Some(cursor) = &self.cursor {
            return cursor.boundary.clone();
        }
        assert!(
            !self.environments.any_in_flight() && self.halves.iter().all(|half| half.step() == self.halves[0].step()),
            "between rollouts both halves stand at the same exchange and nothing is on its way"
        );
        Boundary {
            exchange: self.halves[0].step(),
            environments: self.environments.states().to_vec(),
            running: self.environments.running().to_vec(),
        }
    }

    /// Takes a sample in.
    pub fn receive(&mut self, header: &ObservationHeader, sample: S) -> Result<Received, ProtocolError> {
        let ObservationHeader { kind, actor, actor_incarnation, learner_incarnation, half, step, .. } = *header;
        let column_map = self.settings.column_map;
        let Some(index) = column_map.index_of(actor).filter(|_| half < column_map.halves()) else {
            return Err(ProtocolError::Header(*header));
        };
        let newest = &mut self.actor_incarnations[index as usize];
        if !can_follow(*newest, actor_incarnation) {
            return Err(ProtocolError::Header(*header));
        }
        let outdated = actor_incarnation < *newest;
        *newest = (*newest).max(actor_incarnation);
        match kind {
            // A HELLO of an older, dead incarnation: an answer to it could overwrite the answer to the living one.
            observation_kind::HELLO if outdated => return Ok(Received::Duplicate),
            observation_kind::HELLO => return Ok(Received::Hello { actor, actor_incarnation }),
            observation_kind::OBSERVATIONS => {}
            _ => return Err(ProtocolError::Header(*header)),
        }
        if learner_incarnation != self.settings.learner_incarnation {
            return Ok(Received::Foreign);
        }
        match self.halves[half as usize].arrival(index, step) {
            Arrival::Duplicate => return Ok(Received::Duplicate),
            Arrival::Ahead => {
                let sent = self.halves[half as usize].step();
                return Err(ProtocolError::Ahead { actor, half, found: step, sent });
            }
            Arrival::Awaited => {}
        }
        let columns = column_map.columns_of(index, half);
        if sample.len() != columns.len() {
            return Err(ProtocolError::Length { actor, half, found: sample.len(), expected: columns.len() });
        }
        for (i, column) in columns.clone().enumerate() {
            self.environments.check(column, sample.environment(i), sample.transition(i), sample.current(i))?;
        }
        // Here, because others are still awaited: once the half is complete, all wait for its actions.
        for (i, column) in columns.enumerate() {
            let (Settings { seed, policy_actions, .. }, place) = (self.settings, self.ids[column]);
            let Current { episode, step, .. } = *sample.current(i);
            self.noise[column].clear();
            gumbel(seed, place, episode, step, policy_actions, &mut self.noise[column]);
        }
        self.halves[half as usize].keep(index, sample);
        Ok(Received::Kept)
    }

    /// Halves: 1 or 2.
    pub(crate) fn halves(&self) -> u32 {
        self.settings.column_map.halves()
    }

    /// The recorder's newest receipt of one half of an actor of this learner's.
    ///
    /// # Panics
    /// If there is no such actor or half.
    pub fn recorded(&mut self, actor: u32, half: u32, receipt: Receipt) {
        let index = self.settings.column_map.index_of(actor).expect("a learner reads receipts of its own actors");
        if receipt.learner_incarnation == self.settings.learner_incarnation {
            self.halves[half as usize].recorded(index, receipt.step);
        }
    }

    /// Actors whose observations of this half's exchange the recorder does not have yet, ascending. While there are
    /// some, the half is not answered.
    pub fn unrecorded(&self, half: u32) -> Vec<u32> {
        let column_map = self.settings.column_map;
        let half = Some(&self.halves[half as usize]).filter(|_| self.settings.recorded);
        half.into_iter().flat_map(Half::unrecorded).map(|index| column_map.actor(index)).collect()
    }

    /// An actor's state according to all messages received from it and sent to it: an actor that has just started must
    /// rebuild this state. `actor_incarnation` 0 addresses any incarnation.
    ///
    /// # Panics
    /// If it is not this learner's.
    pub fn restore(&self, actor: u32, actor_incarnation: u32) -> (RestoreHeader, Vec<EnvironmentState>) {
        let first = self.halves[0].step();
        let header = RestoreHeader {
            step: [first, self.halves.get(1).map_or(first, Half::step)],
            stage_version: self.stage_version,
            learner_incarnation: self.settings.learner_incarnation,
            actor_incarnation,
        };
        let column_map = self.settings.column_map;
        let columns =
            column_map.columns_of_actor(column_map.index_of(actor).expect("only a learner's own actors ask it"));
        (header, columns.map(|column| *self.environments.state(column)).collect())
    }

    /// Actors from which something is missing before the current task can go on, ascending.
    pub fn missing(&self) -> Vec<u32> {
        match self.task() {
            Task::Await { half } => {
                let column_map = self.settings.column_map;
                self.halves[half as usize].missing().map(|index| column_map.actor(index)).collect()
            }
            _ => vec![],
        }
    }

    /// What to do next.
    ///
    /// # Panics
    /// If no rollout is in progress.
    pub fn task(&self) -> Task {
        let cursor = self.rollout();
        let halves = self.halves.len();
        let (t, half) = (cursor.turn / halves, (cursor.turn % halves) as u32);
        if t > cursor.shape.steps {
            return Task::Finish;
        }
        if self.halves[half as usize].missing().next().is_some() {
            return Task::Await { half };
        }
        if t == cursor.shape.steps { Task::Bootstrap { half } } else { Task::Act { half, t } }
    }

    /// Returns the outcomes of this half's last actions, once. Empty if they were returned before, and for the first
    /// observations.
    ///
    /// # Panics
    /// If the half's observations are not complete.
    pub fn settle(&mut self, half: u32) -> Vec<Settled> {
        let Self { settings, halves, environments, shards, cursor, .. } = self;
        let cursor = cursor.as_mut().expect("outcomes belong to a rollout in progress");
        let exchange = &mut halves[half as usize];
        if !exchange.begin_settling() {
            return vec![];
        }
        let mut settled = vec![];
        let step = exchange.step();
        for (index, sample) in (0..).zip(exchange.complete().expect("a half settles when it is complete")) {
            for (i, column) in settings.column_map.columns_of(index, half).enumerate() {
                let statistics = &mut cursor.statistics[shards[column]];
                let outcome = environments.settle(column, sample.transition(i), cursor.reward, statistics);
                if let Some(outcome) = outcome {
                    settled.push(Settled { t: (step - 1 - cursor.boundary.exchange) as usize, column, outcome });
                }
            }
        }
        settled
    }

    /// The transitions of this half's last exchange, by column, as its actors reported them; none for a column that
    /// held.
    ///
    /// # Panics
    /// If the half's observations are not complete.
    pub(crate) fn transitions(&self, half: u32) -> impl Iterator<Item = (usize, &Transition)> {
        let samples = self.halves[half as usize].complete().expect("outcomes are told of a complete half");
        let column_map = self.settings.column_map;
        (0..).zip(samples).flat_map(move |(index, sample)| {
            column_map.columns_of(index, half).enumerate().map(|(i, column)| (column, sample.transition(i)))
        })
    }

    /// This half's observations as a batch, with the noise that will choose the actions.
    ///
    /// # Panics
    /// If they are not complete.
    pub fn batch(&self, half: u32) -> Batch<'_> {
        self.batch_with(half, |place, noise| noise.extend_from_slice(&self.noise[place.column]))
    }

    /// The same with the caller's noise: `noise` gets the place and appends one number for each action of the policy.
    ///
    /// # Panics
    /// If the half's observations are not complete.
    pub(crate) fn batch_with(&self, half: u32, mut noise: impl FnMut(Place, &mut Vec<f32>)) -> Batch<'_> {
        let Settings { column_map, policy_actions, carried_goal, .. } = self.settings;
        let samples = self.halves[half as usize].complete().expect("a batch is made of a complete half");
        let count = column_map.half(half).len() * samples.len();
        let mut batch = Batch {
            columns: column_map.batch(half).collect(),
            frames: Vec::with_capacity(count),
            goal_m: Vec::with_capacity(count),
            previous_action: Vec::with_capacity(count),
            episode_start: Vec::with_capacity(count),
            gumbel: Vec::with_capacity(count * policy_actions),
        };
        for (index, sample) in (0..).zip(samples) {
            for (i, column) in column_map.columns_of(index, half).enumerate() {
                let current = sample.current(i);
                batch.frames.push(sample.frame(i));
                batch.goal_m.push(current.goal_vector_m(carried_goal));
                batch.previous_action.push(current.previous_action as u8);
                batch.episode_start.push(current.flags & current_flag::EPISODE_START != 0);
                let environment = self.ids[column];
                let Current { episode, step, .. } = *current;
                noise(Place { column, environment, episode, step }, &mut batch.gumbel);
            }
        }
        batch
    }

    /// Takes the agent's actions, in batch order, and returns what to send to each actor. In a rollout's last step
    /// the environments beyond its shape HOLD, whatever the agent chose for them.
    ///
    /// # Panics
    /// If the current task is not to act on this half, there is not one action for each of its environments, or the
    /// recorder does not have what is answered.
    pub fn answer(&mut self, half: u32, actions: &[u8]) -> Vec<ActionBatch> {
        let Task::Act { half: due, t } = self.task() else { panic!("actions are answered when they are due") };
        assert_eq!(half, due, "the halves take turns");
        assert!(self.unrecorded(half).is_empty(), "what is answered is recorded");
        let column_map = self.settings.column_map;
        let width = column_map.half(half).len();
        assert_eq!(actions.len(), width * column_map.actors() as usize, "one action for each environment of the half");
        let cursor = self.cursor.as_mut().expect("a task is due in a rollout");
        cursor.turn += 1;
        let acting =
            if t + 1 == cursor.shape.steps { cursor.shape.environments_in_last_step } else { column_map.columns() };
        let exchange = &mut self.halves[half as usize];
        let header = ActionHeader {
            step: exchange.step(),
            stage_version: self.stage_version,
            learner_incarnation: self.settings.learner_incarnation,
            half,
        };
        exchange.advance();
        let mut batches = Vec::with_capacity(column_map.actors() as usize);
        for (index, chosen) in (0..).zip(actions.chunks(width)) {
            let columns = column_map.columns_of(index, half);
            let sent: Vec<u8> =
                columns.clone().zip(chosen).map(|(column, &a)| if column < acting { a } else { HOLD }).collect();
            for (column, &action) in columns.zip(&sent) {
                self.environments.act(column, action);
            }
            batches.push(ActionBatch { actor: column_map.actor(index), header, actions: sent });
        }
        batches
    }

    /// A number that grows whenever an actor has started again.
    pub(crate) fn actor_starts(&self) -> u64 {
        self.actor_incarnations.iter().copied().map(u64::from).sum()
    }

    /// Frames of the rollout in progress so far; 0 when there is none.
    pub fn collected(&self) -> u64 {
        self.cursor.as_ref().map_or(0, Cursor::frames)
    }

    /// Steps that every column has taken, and steps planned; none if a column is within a step or no step follows.
    pub(crate) fn between_steps(&self) -> Option<[usize; 2]> {
        let Cursor { shape, turn, .. } = self.rollout();
        let halves = self.halves.len();
        (turn % halves == 0 && turn / halves < shape.steps).then_some([turn / halves, shape.steps])
    }

    /// Ends the rollout after the steps taken so far: the observations that come next are for the bootstrap.
    ///
    /// # Panics
    /// If the columns have not all taken the same number of steps, or none.
    pub fn cut(&mut self) {
        let [steps, _] = self.between_steps().expect("a rollout is cut between steps");
        assert!(steps > 0, "a rollout has frames");
        let columns = self.settings.column_map.columns();
        let cursor = self.cursor.as_mut().expect("there are steps in a rollout");
        cursor.shape = RolloutShape { steps, environments_in_last_step: columns, frames: (steps * columns) as u64 };
    }

    /// The agent has computed the values of this half's last observations.
    ///
    /// # Panics
    /// If that was not the current task, or the recorder does not have these observations.
    pub fn bootstrapped(&mut self, half: u32) {
        assert_eq!(self.task(), Task::Bootstrap { half }, "a half is bootstrapped when it is due");
        assert!(self.unrecorded(half).is_empty(), "what a rollout ends with is recorded");
        for column in self.settings.column_map.batch(half) {
            self.environments.forget_outcome(column);
        }
        self.cursor.as_mut().expect("a task is due in a rollout").turn += 1;
    }

    /// Ends the rollout; the figures of each shard. Its last observations stay: they are the next rollout's first.
    ///
    /// # Panics
    /// If it is not complete, or the number of recorded frames differs from its shape.
    pub fn finish(&mut self) -> Vec<RolloutStatistics> {
        assert_eq!(self.task(), Task::Finish, "a rollout is finished when it is complete");
        let cursor = self.cursor.take().expect("a task is due in a rollout");
        assert_eq!(cursor.frames(), cursor.shape.frames, "every frame of the budget is recorded once");
        cursor.statistics
    }

    fn rollout(&self) -> &Cursor {
        self.cursor.as_ref().expect("there is a task while a rollout is in progress")
    }
}
