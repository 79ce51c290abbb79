//! Environments of others, as the engine runs them.

use super::Guest;
use super::notes::Notes;
use crate::Simulator;
use proto::actor_notes::LastPlace;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::{Plan, seed_of};
use proto::kitchen::Split;
use proto::random::Key;
use proto::record::{End, RecordHeader};
use proto::task::{Channel, Check, Field, Layout, REWARD, Role, Spec};
use wire::message::{Line, Snapshot};
use xxhash_rust::xxh3::Xxh3;

/// An environment failed.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct Failure {
    place: LastPlace,
    problem: String,
}

/// Environments of a run.
pub struct Served<G> {
    guest: G,
    seed: u64,
    /// An evaluation's episodes, and whether they are the test's or validation's.
    plan: Option<(Plan, Split)>,
    max_steps: u32,
    /// In place of an action.
    hold: Vec<u8>,
    layout: &'static Layout,
    check: Check,
    /// Images, each with its bit in the header.
    images: Vec<(Field, u32)>,
    environments: Vec<Environment>,
    /// None outside a run, or where they cannot be written.
    notes: Option<Notes>,
}

/// A channel that an environment fills in.
#[derive(Debug, Clone)]
pub struct Source {
    pub channel: Channel,
    pub field: Field,
}

impl Source {
    /// The channel of a name.
    pub fn of(spec: &Spec, name: &str) -> Option<Self> {
        let (channel, field) = spec.channel(name)?;
        Some(Self { channel: channel.clone(), field })
    }

    /// What a step reports beside observations and the reward.
    pub fn reported(spec: &Spec) -> Vec<Self> {
        let is_reported = |channel: &&Channel| channel.role != Role::Observation && channel.name != REWARD;
        spec.channels.iter().filter(is_reported).filter_map(|channel| Self::of(spec, &channel.name)).collect()
    }

    /// The environment's own reward.
    pub fn reward(spec: &Spec) -> Option<Self> {
        Self::of(spec, REWARD)
    }
}

/// One environment.
struct Environment {
    number: u32,
    episode: u32,
    steps: u32,
    /// All that was seen and done in this episode so far.
    history: Xxh3,
    state_hash: u64,
    /// The record as it is now, but for its header and actions.
    record: Vec<Line>,
}

impl<G: Guest> Served<G> {
    /// So many environments in a run of this configuration.
    pub(super) fn new(guest: G, count: usize, notes: Option<Notes>, config: &Config) -> Self {
        let spec = config.spec();
        let layout = spec.layout();
        let lines = layout.bytes / size_of::<Line>();
        let environment = || Environment {
            number: 0,
            episode: 0,
            steps: 0,
            history: Xxh3::new(),
            state_hash: 0,
            record: vec![Line([0; 64]); lines],
        };
        let filled: Vec<Field> = spec
            .channels
            .iter()
            .zip(&layout.fields)
            .filter(|(channel, _)| channel.is_bulk())
            .map(|(_, &field)| field)
            .collect();
        let bits = layout.images.iter().enumerate().map(|(bit, &image)| (image, 1 << bit));
        Self {
            guest,
            seed: config.seed,
            plan: config.evaluation_plan().zip(config.evaluation.as_ref().map(|asked| asked.split)),
            max_steps: config.episode.max_steps,
            hold: spec.actions.hold(),
            layout,
            check: Check::of(spec),
            images: bits.filter(|(image, _)| filled.contains(image)).collect(),
            environments: std::iter::repeat_with(environment).take(count).collect(),
            notes,
        }
    }

    /// The number of an episode wherever it is told of, and the seed that it begins with.
    fn which(&self, home: EnvironmentId, episode: u32) -> (u32, u32) {
        match &self.plan {
            None => (episode, Key::episode_seed(self.seed, home.number, episode)),
            Some((plan, split)) => {
                // One that has run out is not asked to act.
                let dealt = plan.dealt(home, episode).unwrap_or_default();
                (dealt, seed_of(*split, dealt))
            }
        }
    }

    /// Says where this process is, before the guest is called: it may not return.
    fn enter(&self, place: LastPlace) {
        self.notes.iter().for_each(|notes| notes.enter(place));
    }

    /// Copies what is seen now of an environment, but for images.
    pub fn copy_seen(&self, index: usize, seen: &mut [u8]) {
        seen.copy_from_slice(&Line::bytes(&self.environments[index].record)[self.layout.seen.clone()]);
    }
}

impl Environment {
    fn place(&self) -> LastPlace {
        LastPlace { environment: self.number, episode: self.episode, step: self.steps }
    }

    /// Refuses numbers that the task does not declare; returns the state's hash: of all that was seen and done so far.
    fn check(&mut self, check: &Check, [acted, ended]: [bool; 2], layout: &Layout) -> Result<u64, String> {
        let record = Line::bytes(&self.record);
        let sound = check.record(record, acted).and_then(|()| if ended { Ok(()) } else { check.choice(record) });
        sound.map_err(|problem| problem.to_string())?;
        if acted && !layout.snapshot.is_empty() {
            // A chain, which goes on from a snapshot.
            self.history = Xxh3::with_seed(self.state_hash);
        }
        self.history.update(&record[layout.seen.start..]);
        if acted {
            self.history.update(&record[layout.of_action.clone()]);
        }
        self.state_hash = self.history.digest();
        Ok(self.state_hash)
    }
}

impl<G: Guest> Simulator for Served<G> {
    type Error = Failure;

    fn begin(&mut self, index: usize, home: EnvironmentId, episode: u32) -> Result<u64, Failure> {
        let (told, seed) = self.which(home, episode);
        let one = &mut self.environments[index];
        (one.number, one.episode, one.steps) = (home.number, told, 0);
        one.history = Xxh3::new();
        let place = one.place();
        self.enter(place);
        let one = &mut self.environments[index];
        let begun = self.guest.reset(index, seed, Line::bytes_mut(&mut one.record));
        let hash = begun.and_then(|()| one.check(&self.check, [false, false], self.layout));
        hash.map_err(|problem| Failure { place, problem })
    }

    fn restore(
        &mut self,
        index: usize,
        home: EnvironmentId,
        episode: u32,
        step: u32,
        snapshot: &Snapshot,
    ) -> Result<(), Failure> {
        let (told, _) = self.which(home, episode);
        let one = &mut self.environments[index];
        (one.number, one.episode, one.steps) = (home.number, told, step);
        one.state_hash = snapshot.state_hash;
        let place = one.place();
        self.enter(place);
        self.guest.restore(index, &snapshot.bytes).map_err(|problem| Failure { place, problem })
    }

    fn act_together(&mut self, first: usize, actions: &[u8]) -> Result<(), Failure> {
        let mut each = actions.chunks_exact(self.hold.len());
        let Some(acting) = each.position(|action| action != self.hold) else { return Ok(()) };
        let place = self.environments[first + acting].place();
        self.enter(place);
        self.guest.step_together(first, actions).map_err(|problem| Failure { place, problem })
    }

    fn act(&mut self, index: usize, action: &[u8], done: &mut [u8]) -> Result<(u64, Option<End>), Failure> {
        let place = self.environments[index].place();
        self.enter(place);
        let one = &mut self.environments[index];
        let stepped = self.guest.step(index, action, Line::bytes_mut(&mut one.record));
        let result = stepped.and_then(|[terminated, truncated]| {
            one.steps += 1;
            let end = match (terminated, truncated || one.steps >= self.max_steps) {
                (true, _) => Some(End::Terminated),
                (false, true) => Some(End::Truncated),
                (false, false) => None,
            };
            if end.is_some() {
                self.notes.iter_mut().for_each(Notes::ended);
            }
            let hash = one.check(&self.check, [true, end.is_some()], self.layout)?;
            done.copy_from_slice(&Line::bytes(&one.record)[self.layout.of_action.clone()]);
            Ok((hash, end))
        });
        result.map_err(|problem| Failure { place, problem })
    }

    fn observe(&mut self, index: usize, header: &mut RecordHeader, record: &mut [u8]) -> Result<(), Failure> {
        self.copy_seen(index, &mut record[self.layout.seen.clone()]);
        let seen = Line::bytes(&self.environments[index].record);
        for (image, bit) in &self.images {
            record[image.range()].copy_from_slice(&seen[image.range()]);
            header.bulk |= bit;
        }
        if self.layout.snapshot.is_empty() {
            return Ok(());
        }
        let place = self.environments[index].place();
        self.enter(place);
        let taken = self.guest.snapshot(index).and_then(|bytes| {
            let fits = !bytes.is_empty() && self.layout.write_snapshot(&bytes, record);
            let problem = || format!("its snapshot has {} bytes, which is none or more than are declared", bytes.len());
            fits.then_some(()).ok_or_else(problem)
        });
        taken.map_err(|problem| Failure { place, problem })
    }
}
