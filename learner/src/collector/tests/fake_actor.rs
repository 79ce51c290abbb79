//! Simulated actors.

use super::environment::FakeEnvironment;
use super::{ActionBatch, ColumnMap, FakeSample, MAX_STEPS, Message};
use proto::config::Config;
use std::collections::VecDeque;
use wire::message::{EnvironmentState, ObservationHeader, RestoreHeader, observation_kind};

/// A simulated actor process and its queues.
#[derive(Debug)]
pub struct FakeActor {
    pub number: u32,
    pub incarnation: u32,
    /// Learner incarnation it follows, and the exchange of each half; none until its first restore.
    pub following: Option<(u32, [u64; 2])>,
    pub environments: Vec<FakeEnvironment>,
    /// On its way to it; what is lost when it dies.
    pub actions: VecDeque<ActionBatch>,
    pub restore: Option<(RestoreHeader, Vec<EnvironmentState>)>,
}

impl FakeActor {
    pub fn new(number: u32, incarnation: u32) -> Self {
        Self { number, incarnation, following: None, environments: vec![], actions: VecDeque::new(), restore: None }
    }

    pub fn hello(&self) -> Message {
        let header = ObservationHeader {
            kind: observation_kind::HELLO,
            actor: self.number,
            actor_incarnation: self.incarnation,
            ..ObservationHeader::default()
        };
        (header, FakeSample(vec![]))
    }

    pub fn observe(&self, column_map: ColumnMap, half: u32) -> Message {
        let (learner_incarnation, steps) = self.following.expect("an actor observes once it is restored");
        let header = ObservationHeader {
            step: steps[half as usize],
            kind: observation_kind::OBSERVATIONS,
            actor: self.number,
            actor_incarnation: self.incarnation,
            learner_incarnation,
            half,
            ..ObservationHeader::default()
        };
        let observe = |e: usize| self.environments[e].observe(e as u32);
        (header, FakeSample(column_map.half(half).map(observe).collect()))
    }

    /// Handles one message that waits for it, and returns what it sends. None when nothing waits.
    pub fn turn(&mut self, column_map: ColumnMap) -> Option<Vec<Message>> {
        if let Some((header, states)) = self.restore.take() {
            let meant = header.actor_incarnation == 0 || header.actor_incarnation == self.incarnation;
            if !meant || self.following.is_some_and(|(learner, _)| learner >= header.learner_incarnation) {
                return Some(vec![]);
            }
            let first = column_map.columns_of_actor(self.number).start;
            self.environments = states
                .iter()
                .enumerate()
                .map(|(e, state)| {
                    FakeEnvironment::rebuild(
                        Config::default().spec(),
                        column_map.environment(first + e),
                        MAX_STEPS,
                        state,
                    )
                })
                .collect();
            self.following = Some((header.learner_incarnation, header.step));
            return Some((0..column_map.halves()).map(|half| self.observe(column_map, half)).collect());
        }
        let ActionBatch { header, actions, .. } = self.actions.pop_front()?;
        let Some((learner, steps)) = &mut self.following else { return Some(vec![]) };
        if header.learner_incarnation != *learner || header.step != steps[header.half as usize] {
            return Some(vec![]);
        }
        steps[header.half as usize] += 1;
        for (e, action) in column_map.half(header.half).zip(actions) {
            self.environments[e].act(action);
        }
        Some(vec![self.observe(column_map, header.half)])
    }
}
