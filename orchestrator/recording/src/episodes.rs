//! Recorded episodes, put together from the steps of one or more segments.
//!
//! An episode can run over several segments, and after a learner went back to its checkpoint a part of it is recorded
//! twice. Files are read in the order of time, however they are given, and steps of a newer learner incarnation replace
//! what they redo, with everything after it. Each file is read under its own configuration.

use super::assembly::{Assembly, Generation};
use super::declared::Declared;
use super::form::{Carries, Told};
use super::origin::{Origin, world_of};
use super::reader::{Extent, RecordingError, read_with_trust};
use super::reading::Reading;
use super::wanted::{Known, Wanted};
use crate::recorder::segment::{IDENTITY_METADATA, identity};
use mcap::records::Record;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::Plan;
use proto::kitchen::{KitchenId, Kitchens};
use proto::kitchen_schedule::KitchenSchedule;
use proto::replay::RecordedEpisode;
use salvage::Trust;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

const FAULTS_MAX: usize = 20;

/// The highest incarnation of a learner that is believed where nothing but an altered message says so.
const FIRST_LEARNER_MAX: u32 = 1000;

#[derive(Debug)]
pub struct Recorded {
    pub configs: Vec<String>,
    /// Episodes recorded from their first step, by kitchen (where environments stay in theirs), environment and number;
    /// the last of an environment may be unfinished. Those that a learner had played before it went back are not there.
    pub episodes: Vec<RecordedEpisode>,
    pub config_of: Vec<usize>,
    /// Episodes whose first step is in no file given.
    pub headless: u64,
    /// Episodes with a hole; they are kept up to it.
    pub broken: u64,
    pub known: Known,
    /// Steps read, those that were done again included.
    pub steps: u64,
    pub complaints: Vec<String>,
    /// Files with which anything is wrong, also where nothing was lost.
    pub damaged_files: u64,
    pub faults: Vec<String>,
    pub from_the_start: bool,
    pub failures_only: bool,
}

/// Kitchen number, environment number, episode number. Where environments go from kitchen to kitchen the first is that
/// of none of them, but the one that all are called by.
type Key = (u32, u32, u32);

pub fn gather(files: &[PathBuf], wanted: Wanted) -> Result<Recorded, RecordingError> {
    let (mut in_time, mut passed_over) = (Vec::new(), Vec::new());
    for path in files {
        match Origin::of(path) {
            Ok(origin) => in_time.push((origin, path)),
            // Not a word of it can be read: the others can.
            Err(error @ (RecordingError::Empty(_) | RecordingError::NotMcap(_))) => passed_over.push(error),
            Err(error) => return Err(error),
        }
    }
    let mut collection = Collection { wanted, ..Collection::default() };
    collection.complaints.extend(passed_over.iter().map(|error| format!("{error}: it is passed over")));
    collection.damaged_files += passed_over.len() as u64;
    if let Some(error) = passed_over.into_iter().next().filter(|_| in_time.is_empty()) {
        return Err(error);
    }
    in_time.sort_by_key(|(origin, _)| origin.place);
    for at in 0..in_time.len() {
        let (origin, path) = &in_time[at];
        let others = in_time.iter().map(|(other, _)| other);
        let config = origin.configuration(path, others)?;
        collection.incarnation = origin.place.map(|place| place.0);
        let extent = collection.add(path, &config)?;
        collection.complaints.extend(extent.complaints(path));
        collection.damaged_files += u64::from(extent.is_damaged());
    }
    let places: Vec<_> = in_time.iter().filter_map(|(origin, _)| origin.place).collect();
    for host in places.iter().map(|(_, host, _)| *host).collect::<BTreeSet<_>>() {
        let of_host = places.iter().filter(|place| place.1 == host);
        collection.missing_segments(host, &of_host.map(|place| (place.0, place.2)).collect::<Vec<_>>());
    }
    collection.into_recorded(files, places.first() == Some(&(1, 0, 0)))
}

struct Setting {
    text: String,
    failures_only: bool,
    declared: Declared,
    world: Config,
    plan: Option<Plan>,
    kitchens: Kitchens,
    kitchen_schedule: KitchenSchedule,
}

impl Setting {
    fn place(&self, (home, number, episode): Key) -> EnvironmentId {
        let kitchen = KitchenId::new(home).expect("checked when it was read");
        self.kitchen_schedule.place(EnvironmentId { kitchen, number }, episode)
    }

    fn home(&self, place: EnvironmentId) -> EnvironmentId {
        home(self.kitchens, place)
    }
}

/// What an environment is called where its kitchen does not matter: its episodes follow each other in whichever it is.
pub(super) fn home(kitchens: Kitchens, place: EnvironmentId) -> EnvironmentId {
    match kitchens {
        Kitchens::Procedural(_) => EnvironmentId::among(kitchens, place.number, 0, 1),
        Kitchens::Split(_) | Kitchens::One(_) | Kitchens::Scenes(_) | Kitchens::Elsewhere => place,
    }
}

#[derive(Default)]
struct Collection {
    wanted: Wanted,
    known: Known,
    run_id: Option<String>,
    incarnation: Option<u32>,
    settings: Vec<Setting>,
    episodes: BTreeMap<Key, Assembly>,
    /// Of every environment the newest learner, and the last episode that it began.
    newest: BTreeMap<(u32, u32), (Generation, u32)>,
    steps: u64,
    complaints: Vec<String>,
    damaged_files: u64,
    faults: Vec<String>,
}

impl Collection {
    fn add(&mut self, path: &Path, config: &str) -> Result<Extent, RecordingError> {
        let foreign = |problem: String| RecordingError::Foreign { path: path.to_path_buf(), problem };
        let config = self.configure(config).map_err(foreign)?;
        let mut schemas: HashMap<u16, Vec<u8>> = HashMap::new();
        let mut channels: HashMap<u16, (Carries, Reading)> = HashMap::new();
        let mut identified = false;
        let mut undecodable = 0u64;
        let extent = read_with_trust(path, |record, trust| {
            match record {
                Record::Metadata(metadata) if metadata.name == IDENTITY_METADATA => {
                    self.identify(&metadata.metadata).map_err(foreign)?;
                    identified = true;
                }
                Record::Schema { header, data } => drop(schemas.insert(header.id, data.into_owned())),
                Record::Channel(channel) => {
                    if !identified {
                        return Err(foreign("it was not written by this program, or its identity is lost".to_owned()));
                    }
                    if let Some((carries, form)) = self.settings[config].declared.forms.of_topic(&channel.topic) {
                        let schema = schemas.get(&channel.schema_id).map_or(&[][..], Vec::as_slice);
                        let reading = Reading::of(form, schema);
                        let reading = reading.map_err(|error| foreign(format!("{}: {error}", channel.topic)))?;
                        channels.insert(channel.id, (carries, reading));
                    }
                }
                Record::Message { header, data } => {
                    let Some((carries, reading)) = channels.get(&header.channel_id) else { return Ok(()) };
                    // A place that was altered may hold anything.
                    let doubtful = trust == Trust::Doubtful;
                    match reading.read(&data) {
                        Ok(told) if doubtful && !self.is_credible(config, &told) => undecodable += 1,
                        Ok(told) => self.take(config, *carries, told).map_err(foreign)?,
                        Err(_) if doubtful => undecodable += 1,
                        Err(cause) => return Err(foreign(cause.to_string())),
                    }
                }
                _ => {}
            }
            Ok(())
        })?;
        if undecodable > 0 {
            self.faults.push(format!("{}: {undecodable} altered messages cannot be used", path.display()));
        }
        Ok(extent)
    }

    fn configure(&mut self, config: &str) -> Result<usize, String> {
        if let Some(known) = self.settings.iter().position(|setting| setting.text == config) {
            return Ok(known);
        }
        // Only read: whether it can be run is checked by those who run it.
        let read: Config = toml::from_str(config).map_err(|cause| format!("its configuration: {cause}"))?;
        self.settings.push(Setting {
            text: config.to_owned(),
            failures_only: read.recording.failures_only,
            declared: Declared::of(&read)?,
            plan: read.evaluation_plan(),
            kitchens: read.kitchens(),
            kitchen_schedule: read.kitchen_schedule(),
            world: world_of(&read),
        });
        Ok(self.settings.len() - 1)
    }

    fn identify(&mut self, metadata: &BTreeMap<String, String>) -> Result<(), String> {
        let run_id = metadata.get(identity::RUN_ID).cloned().unwrap_or_default();
        match &self.run_id {
            Some(other) if *other != run_id => {
                Err(format!("it belongs to run {run_id}, the files before it to run {other}"))
            }
            _ => {
                self.run_id = Some(run_id);
                Ok(())
            }
        }
    }

    /// Whether an altered message says what can follow those before it. One wrong incarnation would make everything
    /// after it void.
    fn is_credible(&self, config: usize, told: &Told) -> bool {
        let ((kitchen, environment, episode), generation) = told.engine.whose();
        let setting = &self.settings[config];
        let home =
            KitchenId::new(kitchen).ok().map(|kitchen| setting.home(EnvironmentId { kitchen, number: environment }));
        if home.is_none_or(|home| setting.kitchen_schedule.place(home, episode).kitchen.number() != kitchen) {
            return false;
        }
        let newest = home.and_then(|home| self.newest.get(&(home.kitchen.number(), home.number)));
        // The first of an environment: from its file's start, and learners do not restart so often.
        let may_be_first = self.incarnation == Some(generation.0) && generation.1 <= FIRST_LEARNER_MAX;
        newest.map_or(may_be_first, |(newest, last)| *newest == generation && episode <= last.saturating_add(1))
    }

    fn take(&mut self, config: usize, carries: Carries, told: Told) -> Result<(), String> {
        let (key, generation) = told.engine.whose();
        self.steps += u64::from(carries == Carries::Step);
        let Some((assembly, settings)) = self.assembly(key, generation, config, told.engine.fixed_episode)? else {
            return Ok(());
        };
        let declared = &settings[config].declared;
        match carries {
            Carries::Start => assembly.begin(declared, &told),
            Carries::End => assembly.end(declared, told),
            Carries::Step => {
                let at = told.engine.step as usize;
                if assembly.hashes.is_empty() || at == 0 && generation > assembly.generation {
                    assembly.config = config;
                } else if assembly.config != config && settings[assembly.config].world != settings[config].world {
                    // Nobody can simulate one episode in two worlds.
                    assembly.moved_to.get_or_insert((config, at));
                    return Ok(());
                }
                assembly.step(declared, told);
            }
        }
        Ok(())
    }

    fn assembly(
        &mut self,
        (kitchen, environment, episode): (u32, u32, u32),
        generation: Generation,
        config: usize,
        fixed: Option<u32>,
    ) -> Result<Option<(&mut Assembly, &[Setting])>, String> {
        let kitchen = KitchenId::new(kitchen).map_err(|_| format!("there is no kitchen {kitchen}"))?;
        let of = EnvironmentId { kitchen, number: environment };
        let setting = &self.settings[config];
        let home = setting.home(of);
        let was_in = setting.kitchen_schedule.place(home, episode).kitchen;
        if was_in != kitchen {
            return Err(format!(
                "episode {episode} of environment {environment} is said to be in kitchen {kitchen}, but it was in {was_in}"
            ));
        }
        // In an evaluation episodes are called by the numbers of its table; an environment that has run out plays none.
        let number = match &self.settings[config].plan {
            None => episode,
            Some(plan) => match plan.dealt(home, episode) {
                Some(fixed) => fixed,
                None => return Ok(None),
            },
        };
        if fixed.is_some_and(|fixed| fixed != number) {
            return Err(format!("an episode is called {} of its table, but it is {number}", fixed.unwrap_or_default()));
        }
        self.known.environments.insert((kitchen.number(), environment));
        let newest = self.newest.entry((home.kitchen.number(), environment)).or_default();
        *newest = (*newest).max((generation, episode));
        if !self.wanted.is_of(of) {
            return Ok(None);
        }
        self.known.episodes.insert(number);
        if !self.wanted.has_number(number) {
            return Ok(None);
        }
        let assembly = self.episodes.entry((home.kitchen.number(), environment, episode)).or_default();
        Ok(Some((assembly, &self.settings)))
    }

    fn missing_segments(&mut self, host: u32, places: &[(u32, u32)]) {
        let of_host = if host == 0 { String::new() } else { format!("host {host}'s ") };
        for pair in places.windows(2) {
            let ((incarnation, before), (next_incarnation, next)) = (pair[0], pair[1]);
            let first = if incarnation == next_incarnation { before + 1 } else { 0 };
            if first < next {
                let name = |segment: u32| format!("{of_host}incarnation-{next_incarnation:03}.{segment:03}.mcap");
                self.faults.push(match next - first {
                    1 => format!("{} is missing", name(first)),
                    _ => format!("{} to {} are missing", name(first), name(next - 1)),
                });
            }
        }
    }

    fn examine(&mut self, failures_only: bool, from_the_start: bool) {
        // Of an environment that moves, those in one kitchen do not follow each other.
        let moves = self.settings.iter().any(|setting| setting.kitchen_schedule.moves());
        let some_kitchens = self.wanted.kitchen.is_some() || self.wanted.environment.is_some();
        let all = self.wanted.episodes.is_empty() && !failures_only && !(moves && some_kitchens);
        let mut before: Option<Key> = None;
        for (&(kitchen, number, episode), assembly) in &self.episodes {
            let setting = &self.settings[assembly.config];
            let place = |episode: u32| {
                let in_kitchen = setting.place((kitchen, number, episode)).kitchen;
                format!("kitchen {in_kitchen}, environment {number}, episode {episode}")
            };
            let last = self.last_of((kitchen, number, episode));
            let follows = before.filter(|before| (before.0, before.1) == (kitchen, number)).map(|before| before.2);
            before = Some((kitchen, number, episode));
            if self.is_void((kitchen, number, episode)) {
                continue;
            }
            // Numbers begin with 0.
            let next = follows.map(|before| before + 1).or(from_the_start.then_some(0));
            if let Some(next) = next.filter(|next| all && *next < episode) {
                let range = if next + 1 == episode { String::new() } else { format!(" to {}", episode - 1) };
                self.faults.push(format!("{}{range}: not recorded, though episode {episode} is", place(next)));
            }
            if let Some((config, step)) = assembly.moved_to {
                let (then, now) = (&self.settings[assembly.config].world, &self.settings[config].world);
                let changes = now.changes_since(then).join(", ");
                self.faults
                    .push(format!("{}: from step {step} on under another configuration ({changes})", place(episode)));
                continue;
            }
            // One without its first step is counted apart.
            let headless = assembly.hashes.is_empty() && (assembly.gap.is_some() || assembly.start_hash.is_none());
            let left = failures_only && self.is_left((kitchen, number, episode), assembly);
            if !headless
                && !left
                && let Some(fault) = assembly.fault(&setting.declared, episode < last)
            {
                self.faults.push(format!("{}: {fault}", place(episode)));
            }
        }
    }

    fn last_of(&self, (kitchen, number, episode): Key) -> u32 {
        self.newest.get(&(kitchen, number)).map_or(episode, |(_, last)| *last)
    }

    /// Whether the learner went back to before this episode.
    fn is_void(&self, key: Key) -> bool {
        key.2 > self.last_of(key)
    }

    /// Where only failures are recorded: an episode that ran when a start ended, and that a later start has not failed in.
    /// Its beginning alone was written.
    fn is_left(&self, (kitchen, number, episode): Key, assembly: &Assembly) -> bool {
        let newest = self.newest.get(&(kitchen, number));
        let later = newest.is_some_and(|((start, _), last)| episode < *last && assembly.generation.0 < *start);
        later && !assembly.has_ended() && assembly.gap.is_none()
    }

    fn into_recorded(mut self, files: &[PathBuf], from_the_start: bool) -> Result<Recorded, RecordingError> {
        let Some(&Setting { failures_only, .. }) = self.settings.first() else {
            let path = files.first().cloned().unwrap_or_default();
            return Err(RecordingError::Foreign { path, problem: "it holds no configuration".to_owned() });
        };
        self.examine(failures_only, from_the_start);
        if self.faults.len() > FAULTS_MAX {
            let more = self.faults.len() - FAULTS_MAX;
            self.faults.truncate(FAULTS_MAX);
            self.faults.push(format!("and {more} more"));
        }
        let (mut episodes, mut config_of, mut headless, mut broken) = (Vec::new(), Vec::new(), 0, 0);
        for (key, assembly) in std::mem::take(&mut self.episodes) {
            if self.is_void(key) || failures_only && self.is_left(key, &assembly) {
                continue;
            }
            if assembly.hashes.is_empty() {
                // A start without a step is an episode that had just begun; steps without the first are headless.
                headless += u64::from(assembly.gap.is_some());
                continue;
            }
            broken += u64::from(assembly.gap.is_some());
            config_of.push(assembly.config);
            let place = self.settings[assembly.config].place(key);
            episodes.push(assembly.recorded(place, key.2));
        }
        let Self { known, steps, complaints, damaged_files, faults, .. } = self;
        let configs = self.settings.into_iter().map(|setting| setting.text).collect();
        Ok(Recorded {
            configs,
            episodes,
            config_of,
            headless,
            broken,
            known,
            steps,
            complaints,
            damaged_files,
            faults,
            from_the_start,
            failures_only,
        })
    }
}
