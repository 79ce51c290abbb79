//! The learner's authoritative list of environment states, and the check that actors agree with it.

use super::column_map::ColumnMap;
use super::settings::{Reward, Settings, Signals};
use super::statistics::{Ended, RunningEpisode};
use crate::rollout::Outcome;
use proto::kitchen::KitchenId;
use proto::record::{End, RecordHeader, flag};
use proto::task::{Actions, Check, Field, Implausible, Layout, Measure};
use wire::message::{EnvironmentState, Snapshot};

#[derive(Debug, Clone, PartialEq)]
pub struct Settlement {
    pub outcome: Outcome,
    pub ended: Option<Ended>,
}

/// An actor's report contradicts the learner's record of that environment. One of the two is faulty, so the data must
/// not be used for training.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("actor {actor}, {}environment {environment}: {problem}", in_kitchen(*kitchen))]
pub struct Mismatch {
    pub actor: u32,
    /// None where environments are not built in.
    pub kitchen: Option<KitchenId>,
    pub environment: u32,
    pub problem: String,
    /// Nothing but that a number is not finite.
    pub non_finite: bool,
}

fn in_kitchen(kitchen: Option<KitchenId>) -> String {
    kitchen.map_or_else(String::new, |kitchen| format!("kitchen {kitchen}, "))
}

/// Every environment's episode, actions taken in it, and figures so far.
///
/// An environment is rebuilt from its [`EnvironmentState`] alone. An action is noted when it is sent, its outcome later
/// ([`Environments::settle`]). In between the state already contains the action: an actor that restarts then replays it
/// and reports the same outcome.
#[derive(Debug, Clone)]
pub struct Environments {
    column_map: ColumnMap,
    max_episode_steps: u32,
    gamma: f64,
    signals: Signals,
    layout: &'static Layout,
    actions: &'static Actions,
    /// In place of an action.
    hold: Vec<u8>,
    mask: Option<Field>,
    soundness: Check,
    measures: Vec<Measure>,
    states: Vec<EnvironmentState>,
    running: Vec<RunningEpisode>,
    /// The last action was sent, and its outcome is not yet recorded.
    in_flight: Vec<bool>,
}

impl Environments {
    /// Environments at the given states. Panics if the lists do not have one entry a column.
    pub fn new(settings: &Settings, states: Vec<EnvironmentState>, running: Vec<RunningEpisode>) -> Self {
        let Settings { column_map, task, max_episode_steps, gamma, signals, .. } = *settings;
        assert!(
            states.len() == column_map.columns() && running.len() == column_map.columns(),
            "there is one state and one running episode for each environment"
        );
        let in_flight = vec![false; column_map.columns()];
        let (layout, soundness) = (task.layout(), Check::of(task));
        let measures = task.rollout_metrics().map(|(_, one)| one).collect();
        Self {
            column_map,
            max_episode_steps,
            gamma,
            signals,
            layout,
            actions: &task.actions,
            hold: task.actions.hold(),
            mask: task.mask(),
            soundness,
            measures,
            states,
            running,
            in_flight,
        }
    }

    /// State of one column, actions in flight included.
    pub fn state(&self, column: usize) -> &EnvironmentState {
        &self.states[column]
    }

    pub fn states(&self) -> &[EnvironmentState] {
        &self.states
    }

    pub fn running(&self) -> &[RunningEpisode] {
        &self.running
    }

    pub(crate) fn any_in_flight(&self) -> bool {
        self.in_flight.contains(&true)
    }

    /// Nobody needs a column's last outcome again: where it ended an episode, the next one begins. Until then the state
    /// holds all of the old one: an actor that has to send that outcome again can. A snapshot is kept until there is a
    /// newer one: without it nothing leads to the next episode's start.
    pub(crate) fn forget_outcome(&mut self, column: usize) {
        if self.layout.snapshot.is_empty() {
            self.begin_next(column);
        }
    }

    /// Where the last outcome ended an episode, the next one begins.
    fn begin_next(&mut self, column: usize) {
        let state = &mut self.states[column];
        if state.has_ended() {
            *state = EnvironmentState::start_of(state.episode + 1);
        }
    }

    /// Notes an action that answers the record `seen`; HOLD only has the last outcome forgotten. Panics if the bytes
    /// are neither HOLD nor an action that the record allows, or the last action's outcome has not been taken in.
    pub fn act(&mut self, column: usize, action: &[u8], seen: &[u8]) {
        assert!(!self.in_flight[column], "one action at a time is in flight");
        if action == self.hold {
            self.forget_outcome(column);
            return;
        }
        self.begin_next(column);
        assert!(self.actions.has(action), "the agent answers with actions of the task, not {action:?}");
        let allows = |mask: Field| self.actions.allows(&seen[mask.range()], action);
        assert!(self.mask.is_none_or(allows), "the agent answers with what the mask allows, not {action:?}");
        self.states[column].push(action);
        let (state_hash, bytes) = (RecordHeader::of(seen).state_hash, self.layout.snapshot_in(seen).to_vec());
        self.states[column].remember(Snapshot { state_hash, bytes });
        self.in_flight[column] = true;
    }

    /// What contradicts the record of a column.
    pub(super) fn mismatch(&self, column: usize, problem: String) -> Mismatch {
        let (actor, environment) = self.column_map.place(column);
        let kitchen = self.column_map.kitchen(column);
        Mismatch { actor, kitchen, environment, problem, non_finite: false }
    }

    pub fn check(&self, column: usize, record: &[u8]) -> Result<(), Mismatch> {
        let header = RecordHeader::of(record);
        let (_, index) = self.column_map.place(column);
        let mismatch = |problem| self.mismatch(column, problem);
        if header.environment != index {
            return Err(mismatch(format!("its place in the sample holds environment {}", header.environment)));
        }
        header.check().map_err(|cause| mismatch(cause.to_string()))?;
        let state = &self.states[column];
        let next = (state.episode + 1, 0);
        let mut expected = if state.has_ended() { next } else { (state.episode, state.action_count()) };
        if self.in_flight[column] {
            let reported = &record[self.layout.action.range()];
            check_action(state, header, reported, self.actions).map_err(&mismatch)?;
            if header.end().is_some() {
                expected = next;
            } else if state.action_count() >= self.max_episode_steps {
                return Err(mismatch(format!(
                    "episode {} goes on after {} steps; the limit is {}",
                    state.episode,
                    state.action_count(),
                    self.max_episode_steps
                )));
            }
        }
        let seen = (header.episode, header.step);
        if seen != expected {
            return Err(mismatch(format!(
                "it is at episode {}, step {}; by its actions so far it must be at episode {}, step {}",
                seen.0, seen.1, expected.0, expected.1
            )));
        }
        let start = header.step == 0;
        if header.has(flag::EPISODE_START) != start {
            return Err(mismatch(format!("its episode-start flag is wrong at step {}", header.step)));
        }
        let reported = &record[self.layout.previous_action.range()];
        if !start && reported != state.last_action() {
            let [reported, previous] = [reported, state.last_action()].map(|action| self.actions.text(action));
            return Err(mismatch(format!("it reports {reported} as the previous action; that was {previous}")));
        }
        let sound = self.soundness.record(record, header.has(flag::ACTED));
        sound.and_then(|()| self.soundness.choice(record)).map_err(|cause| {
            let problem = format!("at episode {}, step {}, {cause}", header.episode, header.step);
            Mismatch { non_finite: matches!(cause, Implausible::NotFinite(_)), ..mismatch(problem) }
        })
    }

    /// Records the outcome of the action in flight, if there is one. Call it once for each checked report.
    pub fn settle(&mut self, column: usize, record: &[u8], reward: &Reward) -> Option<Settlement> {
        if !std::mem::take(&mut self.in_flight[column]) {
            return None;
        }
        let header = RecordHeader::of(record);
        let Self { layout, signals, gamma, .. } = *self;
        let part = |index| layout.part(record, index);
        let value = reward.composition.of(part, reward.multiplier);
        let cost = signals.cost.map_or(0.0, |(index, weight)| weight * part(index));
        let running = &mut self.running[column];
        running.add(header.acted_step, value, cost, gamma);
        let discounted_return = running.discounted_return;
        running.metrics.resize(self.measures.len(), 0.0);
        for (metric, measure) in running.metrics.iter_mut().zip(&self.measures) {
            *metric = measure.after(|index| layout.fields[index].number(record), *metric);
        }
        let ended = header.end().map(|_| Ended { length: header.acted_step + 1, running: std::mem::take(running) });
        if ended.is_some() {
            self.states[column].end();
        }
        let outcome = Outcome {
            reward: value,
            ended: ended.is_some(),
            time_limit: header.end() == Some(End::Truncated),
            discounted_return,
            label: signals.labels(part),
        };
        Some(Settlement { outcome, ended })
    }
}

/// The last action of `state` must be reported.
fn check_action(
    state: &EnvironmentState,
    header: &RecordHeader,
    reported: &[u8],
    actions: &Actions,
) -> Result<(), String> {
    let step = state.action_count() - 1;
    let action = || actions.text(state.last_action());
    if !header.has(flag::ACTED) {
        return Err(format!("it reports nothing of action {} of episode {}, step {step}", action(), state.episode));
    }
    let seen = (header.acted_episode, header.acted_step, reported);
    let expected = (state.episode, step, state.last_action());
    if seen != expected {
        return Err(format!(
            "its last action is that of episode {}, step {}, action {}; sent was episode {}, step {}, action {}",
            seen.0,
            seen.1,
            actions.text(reported),
            expected.0,
            expected.1,
            action()
        ));
    }
    Ok(())
}
