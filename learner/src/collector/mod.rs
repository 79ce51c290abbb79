//! The rollout collector: a state machine without I/O, clock or tensors. (Adding the statistics of several learners up,
//! [`RolloutStatistics::over`], is the one call that communicates with other processes; the training loop makes it
//! afterwards.)
//!
//! Its inputs are observation samples and the agent's actions, its output is the next [`Task`]. Each half of each
//! actor's environments is a lane. For each step of a rollout and each lane it waits for the observations, records the
//! outcomes of the last actions, lets the agent act, and sends the actions. After the last step it waits for one more
//! observation of each lane, for the bootstrap values. These observations are kept: they are the first of the next
//! rollout. Which lanes act together is the [`Pace`]. What is recorded does not depend on it, nor on who is fast.
//!
//! Where a run is recorded, a lane goes on only when the recorder has its observations, too ([`Collector::unrecorded`]).
//! Until then an actor that is killed can send them again, last outcomes included. So no step is trained on that the
//! recorder has not seen.
//!
//! Nothing that arrives twice or late changes anything: every sample names its exchange and the learner incarnation it
//! goes back to. [`Collector::restore`] tells a restarted actor the state of its environments, at any moment; a
//! restarted learner begins from a [`Boundary`]. `tests/world` kills both at any point and compares what is trained on.

mod column_map;
mod environments;
mod error;
mod lanes;
mod noise;
mod settings;
mod statistics;
mod tally;
#[cfg(test)]
mod tests;

pub use column_map::ColumnMap;
pub use environments::{Environments, Mismatch};
pub use error::ProtocolError;
pub use lanes::{Lane, Pace};
pub use noise::Noise;
pub use settings::{Reward, Settings, Signals};
pub use statistics::{Ended, RolloutStatistics, RunningEpisode};

use crate::agent::Batch;
use crate::record::Inputs;
use crate::rollout::Outcome;
use crate::shards::Shards;
use environments::Settlement;
use lanes::{Arrival, Lanes, Next};
use proto::camera::DepthFrame;
use proto::episode::EnvironmentId;
use proto::record::{RecordHeader, flag};
use proto::stage::RolloutShape;
use tally::Tally;
use wire::Receipt;
use wire::message::{ActionHeader, EnvironmentState, ObservationHeader, RestoreHeader, can_follow, observation_kind};

/// One actor's observations of one half, in the order of [`ColumnMap::half`].
pub trait HalfSample {
    fn len(&self) -> usize;
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Record `i`, all but its images.
    fn record(&self, i: usize) -> &[u8];
    fn header(&self, i: usize) -> &RecordHeader {
        RecordHeader::of(self.record(i))
    }
    /// Whether its images are there, and the part of its depth frame that the network reads.
    fn has_frame(&self, i: usize) -> bool;
    /// None in a task without a frame.
    fn frame(&self, i: usize) -> Option<DepthFrame<'_>>;
    /// Record `i`'s other images, in the order of the task's.
    fn images(&self, i: usize) -> impl Iterator<Item = &[u8]>;
}

/// The state of all environments between two rollouts: with weights and beliefs, all a run needs to go on.
#[derive(Debug, Clone, PartialEq)]
pub struct Boundary {
    /// Exchange that the next rollout begins with, the same for all lanes.
    pub exchange: u64,
    /// State of each environment, by column.
    pub environments: Vec<EnvironmentState>,
    /// Figures of each environment's episode in progress, by column.
    pub running: Vec<RunningEpisode>,
}

impl Boundary {
    pub fn start(columns: usize) -> Self {
        Self {
            exchange: 0,
            environments: vec![EnvironmentState::start_of(0); columns],
            running: vec![RunningEpisode::default(); columns],
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Task {
    /// Receive until enough observations are there: see [`Collector::missing`].
    Await,
    /// Let the agent act on the [`Collector::batch`] of these lanes, or value it where the last action is taken, then
    /// [`Collector::answer`].
    Act(Vec<Lane>),
    /// The rollout is complete: [`Collector::finish`].
    Finish,
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Missing {
    /// Actors from which something is missing before the current task can go on, ascending.
    pub actors: Vec<u32>,
    /// It is enough to look again when so many samples or receipts have come.
    pub enough: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Received {
    Kept,
    Duplicate,
    /// It belongs to another learner incarnation: the actor has not been restored yet.
    Foreign,
    /// An actor has started: answer with [`Collector::restore`].
    Hello {
        actor: u32,
        actor_incarnation: u32,
    },
}

/// Actions to send to one actor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ActionBatch {
    pub actor: u32,
    pub header: ActionHeader,
    /// One action an environment of the half, as bytes.
    pub actions: Vec<u8>,
}

/// What an action led to: the agent's record at row `t` of `column`.
#[derive(Debug, Clone, PartialEq)]
pub struct Settled {
    /// Row of the rollout in which the action was taken.
    pub t: usize,
    pub column: usize,
    pub outcome: Outcome,
    /// What the policy would have been given next of an episode that it truncated, where the record has it.
    pub last_seen: Option<Vec<f32>>,
}

/// Whose action is about to be chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decision {
    pub column: usize,
    pub environment: EnvironmentId,
    pub episode: u32,
    /// Actions taken in it so far.
    pub step: u32,
}

#[derive(Debug)]
struct Cursor {
    shape: RolloutShape,
    reward: Reward,
    boundary: Boundary,
    tally: Tally,
}

/// The collector. `S` is whatever holds a received sample; it is kept until its actions have been sent.
#[derive(Debug)]
pub struct Collector<S> {
    settings: Settings,
    lanes: Lanes<S>,
    environments: Environments,
    inputs: Inputs,
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
    /// A collector that goes on from `boundary`, in lockstep. Panics if the boundary or the shards are not of as many
    /// environments as the column map.
    pub fn new(settings: Settings, shards: &Shards, boundary: Boundary) -> Self {
        let column_map = settings.column_map;
        let Boundary { exchange, environments, running } = boundary;
        let shards = shards.of_columns();
        assert_eq!(shards.len(), column_map.columns(), "every column is of a shard");
        let of_actors = (0..column_map.actors()).map(|index| shards[column_map.columns_of_actor(index).start]);
        Self {
            settings,
            lanes: Lanes::new(column_map.halves(), of_actors.collect(), exchange),
            environments: Environments::new(&settings, environments, running),
            inputs: Inputs::of(settings.task),
            ids: (0..column_map.columns()).map(|column| column_map.environment(column)).collect(),
            shards,
            noise: vec![vec![]; column_map.columns()],
            actor_incarnations: vec![0; column_map.actors() as usize],
            stage_version: 0,
            cursor: None,
        }
    }

    /// Who acts together from the next rollout on; at first all of a half, in lockstep. Panics if a rollout is in
    /// progress.
    pub fn go_at(&mut self, pace: Pace) {
        assert!(self.cursor.is_none(), "a rollout goes on as it began");
        self.lanes.go_at(pace);
    }

    /// Begins a rollout under the announcement with this version. Panics if one is in progress.
    pub fn begin(&mut self, shape: RolloutShape, reward: Reward, stage_version: u64) {
        assert!(self.cursor.is_none(), "a rollout begins when the last one is finished");
        self.stage_version = stage_version;
        let boundary = self.boundary();
        self.lanes.begin();
        let tally = Tally::new(
            self.settings.column_map,
            self.settings.task,
            self.shards.iter().max().map_or(0, |last| last + 1),
        );
        self.cursor = Some(Cursor { shape, reward, boundary, tally });
    }

    /// The state as of the last boundary: the start of the rollout in progress, or now if there is none.
    pub fn boundary(&self) -> Boundary {
        if let Some(cursor) = &self.cursor {
            return cursor.boundary.clone();
        }
        assert!(!self.environments.any_in_flight(), "between rollouts nothing is on its way");
        Boundary {
            exchange: self.lanes.boundary(),
            environments: self.environments.states().to_vec(),
            running: self.environments.running().to_vec(),
        }
    }

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
        match self.lanes.arrival(index, half, step) {
            Arrival::Duplicate => return Ok(Received::Duplicate),
            Arrival::Ahead => {
                let sent = self.lanes.step(index, half);
                return Err(ProtocolError::Ahead { actor, half, found: step, sent });
            }
            Arrival::Awaited => {}
        }
        let columns = column_map.columns_of(index, half);
        if sample.len() != columns.len() {
            return Err(ProtocolError::Length { actor, half, found: sample.len(), expected: columns.len() });
        }
        for (i, column) in columns.clone().enumerate() {
            self.environments.check(column, sample.record(i))?;
            if !sample.has_frame(i) {
                let problem = "its depth frame, the part of it that is needed, or an image, is not there".to_owned();
                return Err(self.environments.mismatch(column, problem).into());
            }
        }
        // Here, because others are still awaited: once enough are there, those wait for their actions.
        for (i, column) in columns.enumerate() {
            let (Settings { seed, noise, .. }, place) = (self.settings, self.ids[column]);
            let RecordHeader { episode, step, .. } = *sample.header(i);
            self.noise[column].clear();
            noise.draw(seed, place, episode, step, &mut self.noise[column]);
        }
        self.lanes.keep(index, half, sample);
        Ok(Received::Kept)
    }

    /// Halves: 1 or 2.
    pub(crate) fn halves(&self) -> u32 {
        self.settings.column_map.halves()
    }

    /// The recorder's newest receipt of one half of an actor of this learner's. Panics if there is no such actor or
    /// half.
    pub fn recorded(&mut self, actor: u32, half: u32, receipt: Receipt) {
        let index = self.settings.column_map.index_of(actor).expect("a learner reads receipts of its own actors");
        if receipt.learner_incarnation == self.settings.learner_incarnation {
            self.lanes.recorded(index, half, receipt.step);
        }
    }

    /// Actors of which the recorder does not have the observations of these lanes yet, ascending. While there are some,
    /// the lanes are not answered.
    pub fn unrecorded(&self, lanes: &[Lane]) -> Missing {
        let unseen = |lane: &&Lane| self.settings.recorded && !self.lanes.is_recorded(lane.index, lane.half);
        let mut actors: Vec<u32> =
            lanes.iter().filter(unseen).map(|lane| self.settings.column_map.actor(lane.index)).collect();
        actors.dedup();
        let enough = (actors.len() as u32).div_ceil(2);
        Missing { actors, enough }
    }

    /// An actor's state according to all messages received from it and sent to it: an actor that has just started must
    /// rebuild this state. `actor_incarnation` 0 addresses any incarnation. Panics if it is not this learner's.
    pub fn restore(&self, actor: u32, actor_incarnation: u32) -> (RestoreHeader, Vec<EnvironmentState>) {
        let column_map = self.settings.column_map;
        let index = column_map.index_of(actor).expect("only a learner's own actors ask it");
        let header = RestoreHeader {
            step: [0, self.lanes.halves() - 1].map(|half| self.lanes.step(index, half)),
            stage_version: self.stage_version,
            learner_incarnation: self.settings.learner_incarnation,
            actor_incarnation,
        };
        let columns = column_map.columns_of_actor(index);
        (header, columns.map(|column| self.environments.state(column).clone()).collect())
    }

    pub fn all_seen(&self) -> bool {
        self.lanes.all_seen()
    }

    /// Whom the current task waits for: nobody unless it is [`Task::Await`].
    pub fn missing(&self) -> Missing {
        match self.next() {
            Next::Await { actors, enough } => {
                let column_map = self.settings.column_map;
                Missing { actors: actors.into_iter().map(|index| column_map.actor(index)).collect(), enough }
            }
            _ => Missing::default(),
        }
    }

    /// What to do next. Panics if no rollout is in progress.
    pub fn task(&self) -> Task {
        match self.next() {
            Next::Await { .. } => Task::Await,
            Next::Act(lanes) => Task::Act(lanes),
            Next::Finish => Task::Finish,
        }
    }

    fn next(&self) -> Next {
        assert!(self.cursor.is_some(), "there is a task while a rollout is in progress");
        self.lanes.next(self.settings.recorded)
    }

    /// Returns the outcomes of these lanes' last actions, once. Empty if they were returned before, and for the first
    /// observations. Panics if their observations are not here.
    pub fn settle(&mut self, of: &[Lane]) -> Vec<Settled> {
        let Self { settings, lanes, environments, inputs, shards, cursor, .. } = self;
        let Cursor { reward, tally, .. } = cursor.as_mut().expect("outcomes belong to a rollout in progress");
        let mut settled = vec![];
        for &lane in of {
            if !lanes.begin_settling(lane) {
                continue;
            }
            let sample = lanes.sample(lane);
            for (i, column) in settings.column_map.columns_of(lane.index, lane.half).enumerate() {
                let record = sample.record(i);
                let settlement = environments.settle(column, record, reward);
                if let Some(Settlement { outcome, ended }) = settlement {
                    let t = lane.t - 1;
                    tally.take(t, column, outcome.reward, ended);
                    settled.push(Settled { t, column, outcome, last_seen: inputs.read_last(record) });
                }
            }
        }
        tally.add(lanes.settled_rows(), shards);
        settled
    }

    /// The records of these lanes, by column: not acted where a column held. Panics if their observations are not here.
    pub(crate) fn records(&self, lanes: &[Lane]) -> impl Iterator<Item = (usize, &[u8])> {
        let column_map = self.settings.column_map;
        lanes.iter().flat_map(move |&lane| {
            let sample = self.lanes.sample(lane);
            let columns = column_map.columns_of(lane.index, lane.half).enumerate();
            columns.map(|(i, column)| (column, sample.record(i)))
        })
    }

    /// The observations of these lanes as a batch, with the noise that will choose the actions. Panics if they are not
    /// here.
    pub fn batch(&self, lanes: &[Lane]) -> Batch<'_> {
        self.batch_with(lanes, |place, noise| noise.extend_from_slice(&self.noise[place.column]))
    }

    /// The same with the caller's noise: `noise` gets the place and appends as many draws as the policy takes. Panics
    /// if the observations are not here.
    pub(crate) fn batch_with(&self, lanes: &[Lane], mut noise: impl FnMut(Decision, &mut Vec<f32>)) -> Batch<'_> {
        let Settings { column_map, noise: kind, .. } = self.settings;
        let count = lanes.iter().map(|lane| column_map.half(lane.half).len()).sum();
        let mut batch = Batch {
            columns: Vec::with_capacity(count),
            at: Vec::with_capacity(count),
            frames: Vec::with_capacity(count),
            images: vec![],
            numbers: Vec::with_capacity(count * self.inputs.width()),
            previous_action: Vec::with_capacity(count),
            episode_start: Vec::with_capacity(count),
            masks: vec![],
            gumbel: Vec::with_capacity(count * kind.count()),
        };
        for &lane in lanes {
            let sample = self.lanes.sample(lane);
            for (i, column) in column_map.columns_of(lane.index, lane.half).enumerate() {
                let (header, record) = (sample.header(i), sample.record(i));
                let start = header.has(flag::EPISODE_START);
                batch.columns.push(column);
                batch.at.push(lane.t);
                batch.frames.extend(sample.frame(i));
                batch.images.extend(sample.images(i));
                self.inputs.read(record, &mut batch.numbers);
                batch.previous_action.push(self.inputs.previous_action(record));
                batch.episode_start.push(start);
                self.inputs.read_mask(record, &mut batch.masks);
                let environment = self.ids[column];
                let RecordHeader { episode, step, .. } = *header;
                noise(Decision { column, environment, episode, step }, &mut batch.gumbel);
            }
        }
        batch
    }

    /// Takes the bytes of the agent's actions, in batch order, and returns what to send to each actor. In a rollout's
    /// last step the environments beyond its shape HOLD, whatever the agent chose for them. Lanes whose last action is
    /// taken are valued now; there is nothing to send to them. Panics if their observations are not here, they are at
    /// other rows, there is not one action for each of their environments, or the recorder does not have what is
    /// answered.
    pub fn answer(&mut self, lanes: &[Lane], actions: &[u8]) -> Vec<ActionBatch> {
        assert!(self.unrecorded(lanes).actors.is_empty(), "what is answered is recorded");
        let Settings { column_map, learner_incarnation, .. } = self.settings;
        let shape = self.rollout().shape;
        let hold = self.settings.task.actions.hold();
        let mut chosen = actions;
        let mut batches = Vec::with_capacity(lanes.len());
        for &lane in lanes {
            let Lane { index, half, t } = lane;
            let columns = column_map.columns_of(index, half);
            assert!(self.lanes.stands(lane), "it is the turn of these lanes");
            let own =
                chosen.split_off(..columns.len() * hold.len()).expect("one action for each environment of the lanes");
            if t == shape.steps {
                columns.for_each(|column| self.environments.forget_outcome(column));
                self.lanes.value(lane);
                continue;
            }
            let acting = if t + 1 == shape.steps { shape.environments_in_last_step } else { column_map.columns() };
            let mut sent = Vec::with_capacity(own.len());
            let sample = self.lanes.sample(lane);
            for (i, (column, action)) in columns.zip(own.chunks_exact(hold.len())).enumerate() {
                let action = if column < acting { action } else { &hold };
                self.environments.act(column, action, sample.record(i));
                sent.extend_from_slice(action);
            }
            let (step, stage_version) = (self.lanes.step(index, half), self.stage_version);
            let header = ActionHeader { step, stage_version, learner_incarnation, half };
            self.lanes.advance(lane);
            batches.push(ActionBatch { actor: column_map.actor(index), header, actions: sent });
        }
        assert!(chosen.is_empty(), "one action for each environment of the lanes");
        batches
    }

    /// A number that grows whenever an actor has started again.
    pub(crate) fn actor_starts(&self) -> u64 {
        self.actor_incarnations.iter().copied().map(u64::from).sum()
    }

    /// Frames of the rollout in progress so far; 0 when there is none.
    pub fn collected(&self) -> u64 {
        self.cursor.as_ref().map_or(0, |cursor| cursor.tally.frames())
    }

    /// Steps of the rollout in progress. Panics if there is none.
    pub fn steps(&self) -> usize {
        self.rollout().shape.steps
    }

    /// Steps that every column has taken, and steps planned; none if a column is within a step or no step follows.
    pub(crate) fn between_steps(&self) -> Option<[usize; 2]> {
        let planned = self.rollout().shape.steps;
        self.lanes.common_row().filter(|&row| row < planned).map(|row| [row, planned])
    }

    /// Whether the first of all lanes, which has steps to take, is among these.
    pub(crate) fn has_first(&self, lanes: &[Lane]) -> bool {
        lanes.first().is_some_and(|lane| (lane.index, lane.half) == (0, 0) && lane.t < self.rollout().shape.steps)
    }

    /// Ends the rollout after the steps taken so far: the observations that come next are for the bootstrap. Panics if
    /// the columns have not all taken the same number of steps, or none.
    pub fn cut(&mut self) {
        let [steps, _] = self.between_steps().expect("a rollout is cut between steps");
        assert!(steps > 0, "a rollout has frames");
        let columns = self.settings.column_map.columns();
        let cursor = self.cursor.as_mut().expect("there are steps in a rollout");
        cursor.shape = RolloutShape { steps, environments_in_last_step: columns, frames: (steps * columns) as u64 };
    }

    /// Ends the rollout; the figures of each shard. Its last observations stay: they are the next rollout's first.
    /// Panics if it is not complete, or the number of recorded frames differs from its shape.
    pub fn finish(&mut self) -> Vec<RolloutStatistics> {
        assert_eq!(self.task(), Task::Finish, "a rollout is finished when it is complete");
        let cursor = self.cursor.take().expect("a task is due in a rollout");
        assert_eq!(cursor.tally.frames(), cursor.shape.frames, "every frame of the budget is recorded once");
        cursor.tally.finish()
    }

    fn rollout(&self) -> &Cursor {
        self.cursor.as_ref().expect("there is a task while a rollout is in progress")
    }
}
