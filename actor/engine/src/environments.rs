//! The environments of one actor: stepping them, rebuilding them, and showing what they see. Whatever simulates them.

use crate::error::EngineError;
use crate::simulator::Simulator;
use crate::whereabouts::{self, Whereabouts};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::Kitchens;
use proto::random::{Key, Purpose};
use proto::record::{End, RecordHeader};
use proto::task::{Actions, LINE_BYTES, Layout, Restore};
use std::collections::VecDeque;
use std::ops::Range;
use wire::message::{EnvironmentState, Line, Snapshot};

pub struct Environments<S> {
    running: Vec<Running>,
    simulator: S,
    rules: Rules,
    /// Environments whose next episode's start may be prepared further, first to last.
    unprepared: VecDeque<usize>,
}

struct Rules {
    layout: &'static Layout,
    actions: &'static Actions,
    /// In place of an action.
    hold: Vec<u8>,
    seed: u64,
    /// Share of the episodes whose frames are recorded.
    recorded: f64,
    restore: Restore,
    /// They are built in.
    has_kitchens: bool,
    /// An evaluation: an episode that was cut has no score.
    is_evaluation: bool,
    max_steps: u32,
}

struct Running {
    /// What it is called wherever it is.
    home: EnvironmentId,
    /// The same with the scene that it is in.
    id: EnvironmentId,
    /// What the last exchange did, and which episode and state it led to.
    header: RecordHeader,
    /// The last action, zeros if none was taken; and that before what is seen now, zeros at an episode's start.
    actions: [Vec<u8>; 2],
    /// What the last action did: parts and outcomes, as in a record.
    done: Vec<u8>,
    /// What was seen last before an action truncated an episode, as in a record; it is the last action's only if that
    /// truncated one.
    last_seen: Vec<u8>,
    /// It cannot be brought back to where the learner has it: its next action ends the episode, as a truncation without a
    /// reward. Until then it shows another episode's start.
    is_lost: bool,
}

impl Rules {
    fn of(config: &Config) -> Self {
        let spec = config.spec();
        Self {
            layout: spec.layout(),
            actions: &spec.actions,
            hold: spec.actions.hold(),
            seed: config.seed,
            recorded: if config.recording.enabled { config.recording.depth_share } else { 0.0 },
            restore: spec.restore,
            has_kitchens: config.kitchens() != Kitchens::Elsewhere,
            is_evaluation: config.evaluation.is_some(),
            max_steps: config.episode.max_steps,
        }
    }

    fn records(&self, id: EnvironmentId, episode: u32) -> bool {
        let key = Key::episode(self.seed, Purpose::Recording, id.kitchen, id.number, episode);
        key.stream().uniform_open() < self.recorded
    }

    fn begin<S: Simulator>(
        &self,
        running: &mut Running,
        simulator: &mut S,
        episode: u32,
        ahead: &mut [u8],
    ) -> Result<(), EngineError> {
        running.id = simulator.place(running.home, episode);
        whereabouts::enter(running.id, episode);
        let index = running.header.environment as usize;
        let state_hash = simulator.begin(index, running.home, episode, ahead).map_err(failed::<S>)?;
        running.header.begin(episode, state_hash, self.records(running.id, episode));
        running.actions[1].fill(0);
        Ok(())
    }

    /// Actions of a state that are still to be taken when its environment has been put there.
    fn left(&self, state: &EnvironmentState) -> usize {
        match (self.restore, state.snapshot()) {
            (Restore::None, _) => 0,
            (_, Some(_)) => 1,
            _ => state.action_count() as usize,
        }
    }

    /// Puts an environment where a state's actions begin, or as near to its last action as it can be restored.
    fn put<S: Simulator>(
        &self,
        running: &mut Running,
        simulator: &mut S,
        state: &EnvironmentState,
    ) -> Result<(), EngineError> {
        running.hold();
        running.is_lost = false;
        match (self.restore, state.snapshot()) {
            (Restore::None, _) if state.action_count() > 0 && self.is_evaluation => {
                Err(EngineError::CutEvaluation { place: running.place() })
            }
            (Restore::None, _) if state.action_count() > 0 => self.lose(running, simulator, state),
            (_, Some(snapshot)) => self.restore(running, simulator, state, snapshot),
            // Whether a reset undoes what came before it, only the environment decides.
            (Restore::Snapshot { .. }, None) if (running.header.episode, running.header.step) != (0, 0) => {
                Err(EngineError::NoSnapshot { place: running.place() })
            }
            (Restore::Snapshot { .. }, None) if (state.episode, state.action_count()) == (0, 0) => Ok(()),
            _ => self.begin(running, simulator, state.episode, &mut []),
        }
    }

    /// Puts an environment where it was before the last action of an episode.
    fn restore<S: Simulator>(
        &self,
        running: &mut Running,
        simulator: &mut S,
        state: &EnvironmentState,
        snapshot: &Snapshot,
    ) -> Result<(), EngineError> {
        let (episode, step) = (state.episode, state.action_count() - 1);
        running.id = simulator.place(running.home, episode);
        whereabouts::enter(running.id, episode);
        let index = running.header.environment as usize;
        simulator.restore(index, running.home, episode, step, snapshot).map_err(failed::<S>)?;
        running.header.begin(episode, snapshot.state_hash, self.records(running.id, episode));
        running.header.step = step;
        Ok(())
    }

    /// Whether the state before the last action is the one that the learner answered.
    fn compare(&self, running: &Running, state: &EnvironmentState) -> Result<(), EngineError> {
        if running.is_lost || state.hash_before().is_none_or(|hash| hash == running.header.state_hash) {
            return Ok(());
        }
        let Whereabouts { environment, episode } = running.place();
        let (place, advice) = if self.has_kitchens {
            (running.place().to_string(), "Was the run begun with another version of the simulator?")
        } else {
            let advice = "Begin another run, in which every random number comes from the episode's seed, or with \
                          metadata[\"restore\"] = \"none\"";
            (format!("environment {}, episode {episode}", environment.number), advice)
        };
        Err(EngineError::Differs { place, step: running.header.step, advice })
    }

    /// Lets an environment that cannot be brought back stand as if an episode's last action had led nowhere.
    fn lose<S: Simulator>(
        &self,
        running: &mut Running,
        simulator: &mut S,
        state: &EnvironmentState,
    ) -> Result<(), EngineError> {
        self.begin(running, simulator, state.episode, &mut [])?;
        running.header.step = state.action_count() - 1;
        running.is_lost = true;
        if state.has_ended() || state.action_count() >= self.max_steps {
            return self.act(running, simulator, state.last_action(), &mut []);
        }
        running.take(state.last_action());
        running.header.act(running.header.state_hash, None);
        Ok(())
    }

    /// Takes an action that the task has; after the last one of an episode the environment stands at the start of the
    /// next.
    fn act<S: Simulator>(
        &self,
        running: &mut Running,
        simulator: &mut S,
        action: &[u8],
        ahead: &mut [u8],
    ) -> Result<(), EngineError> {
        whereabouts::enter(running.id, running.header.episode);
        let index = running.header.environment as usize;
        let (state_hash, end) = if running.is_lost {
            running.is_lost = false;
            running.done.fill(0);
            (0, Some(End::Truncated))
        } else {
            simulator.act(index, action, &mut running.done, ahead).map_err(failed::<S>)?
        };
        running.take(action);
        running.header.act(state_hash, end);
        if end.is_some() {
            if end == Some(End::Truncated) {
                self.keep_last_seen(running, simulator)?;
            }
            let next = running.next_episode().expect("four billion episodes outlast any run");
            self.begin(running, simulator, next, ahead)?;
        }
        Ok(())
    }

    /// Keeps what is seen now, before the next episode begins.
    fn keep_last_seen<S: Simulator>(&self, running: &mut Running, simulator: &mut S) -> Result<(), EngineError> {
        let Layout { seen, last_seen, bytes, .. } = self.layout;
        if last_seen.is_empty() {
            return Ok(());
        }
        let mut record = vec![Line([0; LINE_BYTES]); bytes / LINE_BYTES];
        let (record, mut header) = (Line::bytes_mut(&mut record), running.header);
        simulator.observe(header.environment as usize, &mut header, record).map_err(failed::<S>)?;
        running.last_seen.copy_from_slice(&record[seen.clone()]);
        Ok(())
    }
}

fn failed<S: Simulator>(cause: S::Error) -> EngineError {
    EngineError::Simulator(cause.into())
}

impl Running {
    fn hold(&mut self) {
        self.header.hold();
        self.actions[0].fill(0);
        self.done.fill(0);
    }

    fn take(&mut self, action: &[u8]) {
        self.actions.iter_mut().for_each(|last| last.copy_from_slice(action));
    }

    fn next_episode(&self) -> Option<u32> {
        self.header.episode.checked_add(1)
    }

    fn place(&self) -> Whereabouts {
        Whereabouts { environment: self.id, episode: self.header.episode }
    }
}

impl<S: Simulator> Environments<S> {
    /// Environments of these names, each in its episode 0.
    pub fn new(mut simulator: S, homes: &[EnvironmentId], config: &Config) -> Result<Self, EngineError> {
        if homes.is_empty() {
            return Err(EngineError::NoEnvironments);
        }
        let rules = Rules::of(config);
        simulator.announce(homes.iter().map(|&home| simulator.place(home, 0)));
        let mut running = Vec::new();
        for (index, &home) in (0..).zip(homes) {
            let header = RecordHeader { environment: index, ..RecordHeader::default() };
            let done = vec![0; rules.layout.of_action.len()];
            let actions = [(); 2].map(|()| vec![0; rules.hold.len()]);
            let last_seen = vec![0; rules.layout.last_seen.len()];
            let mut one = Running { home, id: home, header, actions, done, last_seen, is_lost: false };
            rules.begin(&mut one, &mut simulator, 0, &mut [])?;
            running.push(one);
        }
        Ok(Self { unprepared: (0..running.len()).collect(), running, simulator, rules })
    }

    pub fn simulator(&mut self) -> &mut S {
        &mut self.simulator
    }

    pub fn count(&self) -> u32 {
        self.running.len() as u32
    }

    /// Prepares episodes that come next, by a piece of work of about a quarter of a millisecond: for whoever has nothing
    /// to do but wait. Returns whether there was anything to prepare. To start an episode takes as long as ten steps, and
    /// while one environment does, everybody else waits for its actor.
    pub fn prepare(&mut self) -> bool {
        let Some(&index) = self.unprepared.front() else { return false };
        let running = &self.running[index];
        let more = running.next_episode().is_some_and(|next| {
            whereabouts::enter(self.simulator.place(running.home, next), next);
            self.simulator.prepare(index, running.home, next)
        });
        if !more {
            self.unprepared.pop_front();
        }
        true
    }

    /// Puts every environment into the state that its actions lead to. Nothing is rendered on the way, and what was
    /// simulated before does not matter. All take their last actions at the same moment, so that environments which step
    /// together do so here, too.
    pub fn rebuild(&mut self, states: &[EnvironmentState]) -> Result<(), EngineError> {
        let Self { running, simulator, rules, unprepared } = self;
        assert_eq!(states.len(), running.len(), "a restore holds one state an environment");
        *unprepared = (0..states.len()).collect();
        let left: Vec<usize> = states.iter().map(|state| rules.left(state)).collect();
        let moments = left.iter().copied().max().unwrap_or_default();
        let mut order: Vec<usize> = (0..states.len()).collect();
        order.sort_by_key(|&index| moments - left[index]);
        let places = order.iter().map(|&index| {
            let place = simulator.place(running[index].home, states[index].episode);
            (place != running[index].id).then_some(place)
        });
        simulator.announce(places.collect::<Vec<_>>().into_iter().flatten());
        let bytes = rules.hold.len();
        let mut actions = rules.hold.repeat(states.len());
        for moment in 0..=moments {
            for &index in order.iter().filter(|&&index| left[index] + moment == moments) {
                rules.put(&mut running[index], simulator, &states[index])?;
            }
            if moment == moments {
                break;
            }
            let acting = || order.iter().copied().filter(|&index| left[index] + moment >= moments);
            for index in acting() {
                let step = states[index].action_count() as usize + moment - moments;
                let action = &states[index].actions()[step * bytes..][..bytes];
                if !rules.actions.has(action) {
                    let (action, place) = (rules.actions.text(action), running[index].place());
                    return Err(EngineError::NoSuchActionBefore { action, step, place });
                }
                actions[index * bytes..][..bytes].copy_from_slice(action);
            }
            if moment + 1 == moments {
                acting().try_for_each(|index| rules.compare(&running[index], &states[index]))?;
            }
            simulator.act_together(0, &actions).map_err(failed::<S>)?;
            for index in acting() {
                let place = running[index].place();
                rules.act(&mut running[index], simulator, &actions[index * bytes..][..bytes], &mut [])?;
                let (all, left) = (states[index].action_count() as usize, moments - moment - 1);
                if running[index].header.end().is_some() && left > 0 {
                    return Err(EngineError::EndsEarlier { actions: all, place, ended: all - left });
                }
            }
        }
        Ok(())
    }

    /// Applies one action to each environment of `range`, of as many bytes as the task's have. HOLD leaves an environment as
    /// it is. `ahead` are the records that they are observed in next, or none: images may be written there at once.
    pub fn act(&mut self, range: Range<usize>, actions: &[u8], ahead: &mut [Line]) -> Result<(), EngineError> {
        let bytes = self.rules.hold.len();
        assert_eq!(range.len() * bytes, actions.len(), "one action an environment");
        let mut together = actions.to_vec();
        for (index, action) in range.clone().zip(together.chunks_exact_mut(bytes)) {
            if action != self.rules.hold && !self.rules.actions.has(action) {
                let (action, place) = (self.rules.actions.text(action), self.running[index].place());
                return Err(EngineError::NoSuchAction { action, place });
            }
            if self.running[index].is_lost {
                action.copy_from_slice(&self.rules.hold);
            }
        }
        self.simulator.act_together(range.start, &together).map_err(failed::<S>)?;
        let mut records = Line::bytes_mut(ahead).chunks_exact_mut(self.rules.layout.bytes);
        for (index, action) in range.zip(actions.chunks_exact(bytes)) {
            let ahead = records.next().unwrap_or_default();
            let running = &mut self.running[index];
            let episode = running.header.episode;
            if action == self.rules.hold {
                running.hold();
            } else {
                self.rules.act(running, &mut self.simulator, action, ahead)?;
            }
            if running.header.episode != episode && !self.unprepared.contains(&index) {
                self.unprepared.push_back(index);
            }
        }
        Ok(())
    }

    pub fn observe_all(&mut self, range: Range<usize>, records: &mut [Line]) -> Result<(), EngineError> {
        let mut records = Line::bytes_mut(records).chunks_exact_mut(self.rules.layout.bytes);
        range.zip(&mut records).try_for_each(|(index, record)| self.observe(index, record))
    }

    /// Writes the record of environment `index`, its images in place. Panics if the record has not the task's size.
    pub fn observe(&mut self, index: usize, record: &mut [u8]) -> Result<(), EngineError> {
        let Self { running, simulator, rules: Rules { layout, .. }, .. } = self;
        let running = &running[index];
        whereabouts::enter(running.id, running.header.episode);
        // All but what is written whole below: it may be long.
        record[..layout.seen.start].fill(0);
        record[layout.last_seen.end.max(layout.snapshot.end)..layout.small_bytes].fill(0);
        for (field, action) in [layout.action, layout.previous_action].into_iter().zip(&running.actions) {
            record[field.range()].copy_from_slice(action);
        }
        record[layout.of_action.clone()].copy_from_slice(&running.done);
        let last_seen = &mut record[layout.last_seen.clone()];
        if running.header.end() == Some(End::Truncated) {
            last_seen.copy_from_slice(&running.last_seen);
        } else {
            last_seen.fill(0);
        }
        let mut header = running.header;
        simulator.observe(index, &mut header, record).map_err(failed::<S>)?;
        *RecordHeader::of_mut(record) = header;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::record::HOLD;
    use proto::task::Spec;
    use std::convert::Infallible;

    const TASK: &str = r#"
name = "counts"
actions = { kind = "discrete", names = ["go", "end"] }
channels = [
    { name = "gain", role = "part", dtype = "f32", range = [0, 1], doc = "" },
    { name = "count", role = "observation", dtype = "u32", range = [0, 99], doc = "Ten times the episode, and its steps." },
]
rewards = [{ name = "r", terms = [["gain", 1.0]] }]
"#;

    /// Each episode is truncated after three steps, if no action ends it before.
    #[derive(Default)]
    struct Counts([[u32; 2]; 2]);

    impl Simulator for Counts {
        type Error = Infallible;

        fn begin(
            &mut self,
            index: usize,
            _home: EnvironmentId,
            episode: u32,
            _ahead: &mut [u8],
        ) -> Result<u64, Infallible> {
            self.0[index] = [episode, 0];
            Ok(0)
        }

        fn restore(
            &mut self,
            index: usize,
            _home: EnvironmentId,
            episode: u32,
            step: u32,
            _snapshot: &Snapshot,
        ) -> Result<(), Infallible> {
            self.0[index] = [episode, step];
            Ok(())
        }

        fn act(
            &mut self,
            index: usize,
            action: &[u8],
            _done: &mut [u8],
            _ahead: &mut [u8],
        ) -> Result<(u64, Option<End>), Infallible> {
            self.0[index][1] += 1;
            let limit = (self.0[index][1] == 3).then_some(End::Truncated);
            Ok((0, if action == [1] { Some(End::Terminated) } else { limit }))
        }

        fn observe(&mut self, index: usize, _header: &mut RecordHeader, record: &mut [u8]) -> Result<(), Infallible> {
            let spec = Spec::named("counts").expect("it is declared");
            let (_, place) = spec.channel("count").expect("it is there");
            let [episode, step] = self.0[index];
            record[spec.layout().seen.clone()].fill(0);
            place.of_mut(record)[0] = 10 * episode + step;
            Ok(())
        }
    }

    /// The records of two environments: their counts, what was seen last, and all bytes.
    fn records(environments: &mut Environments<Counts>) -> [(u32, u32, Vec<u8>); 2] {
        let layout = Spec::named("counts").expect("it is declared").layout();
        [0, 1].map(|index| {
            let mut record = vec![Line([7; LINE_BYTES]); layout.bytes / LINE_BYTES];
            environments.observe(index, Line::bytes_mut(&mut record)).expect("nothing fails");
            let bytes = Line::bytes(&record);
            let count = |at: usize| u32::from_ne_bytes(bytes[at..][..4].try_into().expect("four bytes"));
            (count(layout.seen.start), count(layout.last_seen.start), bytes.to_vec())
        })
    }

    #[test]
    fn what_was_seen_last_of_a_truncated_episode_stands_beside_the_start_of_the_next() {
        Spec::declare(TASK).expect("a sound task");
        let config = Config::resolve_with("gym", Some(("task = \"counts\"", "a test"))).expect("it fits");
        let homes = [0, 1].map(|number| EnvironmentId::of(0, number, 2));
        let new = || Environments::new(Counts::default(), &homes, &config).expect("nothing fails");
        let mut environments = new();
        let whole = 0..2;
        let mut seen = vec![];
        for actions in [[0, 0], [0, 0], [0, 1], [0, HOLD], [HOLD, 0]] {
            environments.act(whole.clone(), &actions, &mut []).expect("nothing fails");
            seen.push(records(&mut environments).map(|(count, last, _)| (count, last)));
        }
        // The first one is truncated after three actions, the second one ends by itself then.
        let expected = [[(1, 0), (1, 0)], [(2, 0), (2, 0)], [(10, 3), (10, 0)], [(11, 0), (10, 0)], [(11, 0), (11, 0)]];
        assert_eq!(seen, expected);

        // Rebuilt from its actions, it is sent again.
        let mut environments = new();
        for actions in [[0, 0], [0, 0], [0, 1]] {
            environments.act(whole.clone(), &actions, &mut []).expect("nothing fails");
        }
        let mut rebuilt = new();
        let states = [EnvironmentState::after(0, &[0, 0, 0], 1), EnvironmentState::after(0, &[0, 0, 1], 1)];
        rebuilt.rebuild(&states).expect("nothing fails");
        assert_eq!(records(&mut rebuilt), records(&mut environments));

        // The learner answered a state of hash 0, as each of these is.
        let [mut first, second] = states;
        first.remember(Snapshot { state_hash: 0, bytes: vec![] });
        rebuilt.rebuild(&[first.clone(), second.clone()]).expect("nothing fails");
        first.remember(Snapshot { state_hash: 1, bytes: vec![] });
        let refused = rebuilt.rebuild(&[first, second]).unwrap_err().to_string();
        assert!(refused.starts_with("kitchen 1, environment 0, episode 0, step 2: the same seed"), "{refused}");
    }
}
