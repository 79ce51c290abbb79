//! Environments of others, as the engine runs them.

use super::Guest;
use super::notes::Notes;
use super::record::Record;
use crate::Simulator;
use proto::actor_notes::LastPlace;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::{Plan, seed_of};
use proto::kitchen::Split;
use proto::random::Key;
use proto::record::{End, RecordHeader};
use proto::task::{Check, Field, Layout};
use wire::message::{Line, Snapshot};
use xxhash_rust::xxh3::Xxh3;

#[derive(Debug, thiserror::Error)]
#[error("{place}: {problem}")]
pub struct Failure {
    place: LastPlace,
    problem: String,
}

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
    /// Images are written where they are sent from.
    writes_ahead: bool,
    environments: Vec<Environment>,
    /// None outside a run, or where they cannot be written.
    notes: Option<Notes>,
}

struct Environment {
    number: u32,
    episode: u32,
    steps: u32,
    /// All that was seen and done in this episode so far; and the same before that, if images may be shown again.
    history: Xxh3,
    before: Xxh3,
    state_hash: u64,
    /// The record as it is now, but for its header and actions, and for images that were written elsewhere.
    record: Vec<Line>,
    images_in: ImagesIn,
}

/// Where an environment's images were written last.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ImagesIn {
    /// Its own record.
    Record,
    /// The record that it is observed in next.
    Ahead,
    /// A record that is sent, and out of reach.
    Sent,
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
            before: Xxh3::new(),
            state_hash: 0,
            record: vec![Line([0; 64]); lines],
            images_in: ImagesIn::Record,
        };
        let filled: Vec<Field> = spec
            .channels
            .iter()
            .zip(&layout.fields)
            .filter(|(channel, _)| channel.is_bulk())
            .map(|(_, &field)| field)
            .collect();
        let bits = layout.images.iter().enumerate().map(|(bit, &image)| (image, 1 << bit));
        let images: Vec<(Field, u32)> = bits.filter(|(image, _)| filled.contains(image)).collect();
        Self {
            writes_ahead: guest.shows_again() && !images.is_empty(),
            guest,
            seed: config.seed,
            plan: config.evaluation_plan().zip(config.evaluation.as_ref().map(|asked| asked.split)),
            max_steps: config.episode.max_steps,
            hold: spec.actions.hold(),
            layout,
            check: Check::of(spec),
            images,
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

    /// Adds what is seen now and what the last action did to a history.
    fn add_to(&self, mut history: Xxh3, images: &[u8], layout: &Layout) -> Xxh3 {
        let record = &Line::bytes(&self.record)[..layout.small_bytes];
        history.update(&record[layout.seen.start..]);
        history.update(images);
        if self.steps > 0 {
            history.update(&record[layout.of_action.clone()]);
        }
        history
    }

    /// Refuses numbers that the task does not declare; returns the state's hash: of all that was seen and done so far.
    fn check(&mut self, check: &Check, ended: bool, ahead: &[u8], layout: &Layout) -> Result<u64, String> {
        let record = Line::bytes(&self.record);
        let acted = self.steps > 0;
        let sound = check.record(record, acted).and_then(|()| if ended { Ok(()) } else { check.choice(record) });
        sound.map_err(|problem| problem.to_string())?;
        if acted && !layout.snapshot.is_empty() {
            // A chain, which goes on from a snapshot.
            self.history = Xxh3::with_seed(self.state_hash);
        }
        let images = if ahead.is_empty() { record } else { ahead };
        if !ahead.is_empty() {
            self.before.clone_from(&self.history);
        }
        self.history = self.add_to(self.history.clone(), &images[layout.small_bytes..], layout);
        self.state_hash = self.history.digest();
        self.images_in = if ahead.is_empty() { ImagesIn::Record } else { ImagesIn::Ahead };
        Ok(self.state_hash)
    }
}

impl<G: Guest> Simulator for Served<G> {
    type Error = Failure;

    fn begin(&mut self, index: usize, home: EnvironmentId, episode: u32, ahead: &mut [u8]) -> Result<u64, Failure> {
        let (told, seed) = self.which(home, episode);
        let one = &mut self.environments[index];
        (one.number, one.episode, one.steps) = (home.number, told, 0);
        one.history = Xxh3::new();
        let place = one.place();
        self.enter(place);
        let one = &mut self.environments[index];
        let ahead = if self.writes_ahead { ahead } else { &mut [] };
        let begun = self.guest.reset(index, seed, Record::of(&mut one.record, ahead, self.layout));
        let hash = begun.and_then(|()| one.check(&self.check, false, ahead, self.layout));
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

    fn act(
        &mut self,
        index: usize,
        action: &[u8],
        done: &mut [u8],
        ahead: &mut [u8],
    ) -> Result<(u64, Option<End>), Failure> {
        let place = self.environments[index].place();
        self.enter(place);
        let one = &mut self.environments[index];
        let ahead = if self.writes_ahead { ahead } else { &mut [] };
        let stepped = self.guest.step(index, action, Record::of(&mut one.record, ahead, self.layout));
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
            let hash = one.check(&self.check, end.is_some(), ahead, self.layout)?;
            done.copy_from_slice(&Line::bytes(&one.record)[self.layout.of_action.clone()]);
            Ok((hash, end))
        });
        result.map_err(|problem| Failure { place, problem })
    }

    fn observe(&mut self, index: usize, header: &mut RecordHeader, record: &mut [u8]) -> Result<(), Failure> {
        self.copy_seen(index, &mut record[self.layout.seen.clone()]);
        let one = &mut self.environments[index];
        for (image, bit) in &self.images {
            if one.images_in == ImagesIn::Record {
                record[image.range()].copy_from_slice(&Line::bytes(&one.record)[image.range()]);
            }
            header.bulk |= bit;
        }
        match one.images_in {
            ImagesIn::Record => {}
            ImagesIn::Ahead => one.images_in = ImagesIn::Sent,
            ImagesIn::Sent => {
                let place = one.place();
                self.enter(place);
                let one = &mut self.environments[index];
                let shown = self.guest.show_again(index, Record::of(&mut one.record, record, self.layout));
                let images = &record[self.layout.small_bytes..];
                let is_same = one.add_to(one.before.clone(), images, self.layout).digest() == one.state_hash;
                let problem = || "what it observed has changed since it was returned: return a copy".to_owned();
                shown
                    .and_then(|()| is_same.then_some(()).ok_or_else(problem))
                    .map_err(|problem| Failure { place, problem })?;
            }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Environments;
    use crate::guest::Source;
    use proto::record::HOLD;
    use proto::task::Spec;

    const TASK: &str = r#"
name = "films"
actions = { kind = "discrete", names = ["go", "stay"] }
channels = [
    { name = "gain", role = "part", dtype = "f32", range = [0, 1], doc = "" },
    { name = "screen", role = "observation", dtype = "u8", shape = [36, 36], doc = "As bright as its steps." },
]
rewards = [{ name = "r", terms = [["gain", 1.0]] }]
"#;

    struct Films {
        steps: [u8; 2],
        shows_again: bool,
    }

    impl Films {
        fn draw(&self, index: usize, mut record: Record<'_>) {
            let Source { channel, field } = Spec::named("films").and_then(|spec| Source::of(spec, "screen")).unwrap();
            record.piece(&channel)[field.range()].fill(self.steps[index]);
        }
    }

    impl Guest for Films {
        fn reset(&mut self, index: usize, _seed: u32, record: Record<'_>) -> Result<(), String> {
            self.steps[index] = 0;
            self.draw(index, record);
            Ok(())
        }

        fn step(&mut self, index: usize, _action: &[u8], record: Record<'_>) -> Result<[bool; 2], String> {
            self.steps[index] += 1;
            self.draw(index, record);
            Ok([false, self.steps[index] == 3])
        }

        fn shows_again(&self) -> bool {
            self.shows_again
        }

        fn show_again(&mut self, index: usize, record: Record<'_>) -> Result<(), String> {
            self.draw(index, record);
            Ok(())
        }
    }

    #[test]
    fn images_that_are_written_where_they_are_sent_from_are_the_same() {
        Spec::declare(TASK).unwrap();
        let config = Config::resolve_with("gym", Some(("task = \"films\"", "a test"))).unwrap();
        let lines = 2 * config.spec().layout().bytes / size_of::<Line>();
        let homes = [0, 1].map(|number| EnvironmentId::of(0, number, 2));
        let [mut kept, mut ahead] = [false, true].map(|shows_again| {
            let served = Served::new(Films { steps: [0; 2], shows_again }, 2, None, &config);
            Environments::new(served, &homes, &config).unwrap()
        });
        let observed = |environments: &mut Environments<Served<Films>>, mut records: Vec<Line>| {
            environments.observe_all(0..2, &mut records).map(|()| Line::bytes(&records).to_vec())
        };
        let empty = vec![Line([0; 64]); lines];
        assert_eq!(observed(&mut ahead, empty.clone()).unwrap(), observed(&mut kept, empty.clone()).unwrap());
        for actions in [[0, 0], [HOLD, 0], [0, HOLD], [0, 0], [0, 0]] {
            let mut records = empty.clone();
            kept.act(0..2, &actions, &mut records).unwrap();
            let expected = observed(&mut kept, empty.clone()).unwrap();
            ahead.act(0..2, &actions, &mut records).unwrap();
            assert_eq!(observed(&mut ahead, records).unwrap(), expected, "{actions:?}");
            assert_eq!(observed(&mut ahead, empty.clone()).unwrap(), expected, "sent again");
        }
        ahead.simulator().guest.steps[1] += 1;
        let error = observed(&mut ahead, empty).unwrap_err().to_string();
        assert!(error.starts_with("environment 1, ") && error.contains("return a copy"), "{error}");
    }
}
