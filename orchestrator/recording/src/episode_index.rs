//! The recordings of a run as a table of episodes that grows with them: what came of each episode, and where its steps
//! lie, so that one can be taken out without reading the others.
//!
//! Chunks are read once, in the order of time, a little at a time. A recorder replaces index and end mark of its file
//! with every flush; what comes before them stays. A chunk that cannot be read yet is looked at again later while its
//! file grows; in a file at rest it is damage, which `orchestrator recover` repairs, and the file is read up to it.

use super::assembly::{Assembly, Generation};
use super::declared::Declared;
use super::episodes::home;
use super::form::{Carries, Told};
use super::origin::Origin;
use super::reader::RecordingError;
use super::reading::{MessageError, Reading};
use super::schema::STAGES;
use super::schema::stillroom::StageSwitch;
use super::told::shown;
use mcap::read::parse_record;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use prost::Message;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenId, Kitchens};
use proto::replay::RecordedEpisode;
use proto::run_folder::{Item, RunFolder};
use proto::shell::quoted;
use proto::show::ShownEpisode;
use salvage::FileSource;
use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

const RECORD_MAX: u64 = 256 << 20;
/// Bytes before a record's content: its kind and its length.
const RECORD_HEAD: u64 = 9;
const EPISODES_MAX: usize = 1_000_000;

const NOTES_MOST: usize = 20;

const ENDED_KEPT: usize = 100;

/// Kitchen, environment, episode.
pub type Key = (u32, u32, u32);

/// Kitchen and number of an environment, of which only the number counts where it goes from kitchen to kitchen.
type Home = (u32, u32);

#[derive(Debug, Clone, Default)]
pub struct Shelved {
    generation: Generation,
    pub order: u64,
    pub steps: u32,
    pub end: Option<Ended>,
    pub target: Option<String>,
    pub fixed: Option<u32>,
    /// That of the stage in which its last step was taken.
    pub reward: Option<Arc<str>>,
    /// Chunks with messages about it: number of the file, offsets of the first and the last.
    places: Vec<(usize, u64, u64)>,
    from_its_start: bool,
}

#[derive(Debug, Clone, Default)]
pub struct Ended {
    pub outcome: String,
    pub length: u32,
    pub figures: BTreeMap<String, f64>,
}

impl Ended {
    fn of(declared: &Declared, end: &Told) -> Self {
        let returns = declared.compared.rewards().map(|name| format!("return_{name}")).zip(&end.returns);
        let metrics = declared.spec.metrics.iter().map(|metric| metric.name.clone()).zip(&end.metrics);
        Self {
            outcome: declared.spec.outcome(&end.metrics, end.engine.end()),
            length: end.engine.length,
            figures: returns.chain(metrics).filter_map(|(name, number)| Some((name, (*number)?))).collect(),
        }
    }
}

impl Shelved {
    pub fn is_playable(&self) -> bool {
        self.from_its_start && self.steps > 0
    }

    /// Takes a message of this generation; false if a newer one has gone on from before it.
    fn admits(&mut self, generation: Generation, step: u32) -> bool {
        if generation > self.generation {
            self.generation = generation;
            self.steps = self.steps.min(step);
            self.end = None;
        }
        generation == self.generation
    }

    fn lies_at(&mut self, file: usize, offset: u64) {
        match self.places.last_mut() {
            Some((last, _, end)) if *last == file => *end = offset,
            _ => self.places.push((file, offset, offset)),
        }
    }
}

#[derive(Default)]
struct Volume {
    path: PathBuf,
    offset: u64,
    length: u64,
    schemas: HashMap<u16, Vec<u8>>,
    channels: HashMap<u16, (Carries, Reading)>,
    /// Number of the channel that says which stage begins.
    switches: Option<u16>,
    config: Option<Arc<Setting>>,
    given_up: bool,
    caught_up: bool,
}

struct Setting {
    text: String,
    kitchens: Kitchens,
    declared: Declared,
}

enum Found {
    Schema(u16, Vec<u8>),
    /// Its number, that of its schema, its topic.
    Channel(u16, u16, String),
    /// Channel, time in nanoseconds since 1970, content.
    Message(u16, u64, Vec<u8>),
}

pub struct EpisodeIndex {
    folder: RunFolder,
    volumes: Vec<Volume>,
    numbers: HashMap<PathBuf, usize>,
    episodes: BTreeMap<Key, Shelved>,
    /// Of every environment the newest learner, and the last episode that it began, whichever kitchen that is in.
    newest: HashMap<Home, (Generation, u32)>,
    /// What the environments are called where their kitchen does not matter.
    homes: HashMap<(u32, u32), Home>,
    /// Of each stage that has begun, by the time of its beginning, nanoseconds since 1970: only host 0 records it.
    rewards: BTreeMap<u64, Arc<str>>,
    met: u64,
    is_full: bool,
    /// Of every kitchen the episodes that ended last, the newest last.
    ended: HashMap<u32, VecDeque<Key>>,
    pub notes: Vec<String>,
}

pub(super) enum Next {
    Chunk(Vec<u8>, u64),
    Other(u64),
    End,
    Damaged,
}

impl EpisodeIndex {
    pub fn of(folder: RunFolder) -> Self {
        Self {
            folder,
            volumes: Vec::new(),
            numbers: HashMap::new(),
            episodes: BTreeMap::new(),
            newest: HashMap::new(),
            homes: HashMap::new(),
            rewards: BTreeMap::new(),
            met: 0,
            is_full: false,
            ended: HashMap::new(),
            notes: Vec::new(),
        }
    }

    /// Reads on for about as long as this; true if all that is there was read.
    pub fn advance(&mut self, patience: Duration) -> bool {
        let began = Instant::now();
        self.find_volumes();
        for number in 0..self.volumes.len() {
            while !self.volumes[number].given_up && !self.volumes[number].caught_up {
                if began.elapsed() > patience {
                    return false;
                }
                if !self.read_on(number) {
                    break;
                }
            }
        }
        true
    }

    pub fn indexed(&self) -> f64 {
        let sum = |of: fn(&Volume) -> u64| self.volumes.iter().map(of).sum::<u64>();
        // After the data come index and end mark, which are not read.
        let all = sum(|volume| if volume.given_up || volume.caught_up { volume.offset } else { volume.length });
        let read = sum(|volume| volume.offset);
        if all == 0 { 1.0 } else { (read as f64 / all as f64).min(1.0) }
    }

    /// All episodes that count: not those that a learner had played before it went back.
    pub fn episodes(&self) -> impl Iterator<Item = (Key, &Shelved)> {
        self.episodes.iter().filter(|(key, _)| self.counts(key)).map(|(key, shelved)| (*key, shelved))
    }

    pub fn get(&self, key: Key) -> Option<&Shelved> {
        self.episodes.get(&key)
    }

    fn newest(&self, environment: (u32, u32)) -> Option<u32> {
        self.newest.get(self.homes.get(&environment)?).map(|(_, last)| *last)
    }

    fn counts(&self, (kitchen, environment, episode): &Key) -> bool {
        self.newest((*kitchen, *environment)).is_none_or(|last| *episode <= last)
    }

    pub fn last_of(&self, kitchen: u32, environment: u32) -> Option<Key> {
        let last = self.newest((kitchen, environment))?;
        let range = (kitchen, environment, 0)..=(kitchen, environment, last);
        self.episodes.range(range).rev().find(|(_, shelved)| shelved.is_playable()).map(|(key, _)| *key)
    }

    pub fn newest_of(&self, kitchen: u32, count: usize) -> impl Iterator<Item = &Shelved> {
        let ended = self.ended.get(&kitchen).into_iter().flatten().rev();
        ended.filter(|key| self.counts(key)).filter_map(|key| self.episodes.get(key)).take(count)
    }

    pub fn environments(&self) -> impl Iterator<Item = (u32, u32)> {
        self.homes.keys().copied()
    }

    pub fn take_out(&self, key: Key) -> Result<Option<(String, RecordedEpisode)>, RecordingError> {
        let Ok(kitchen) = KitchenId::new(key.0) else { return Ok(None) };
        let taken = self.assembled(key, Assembly::default())?;
        Ok(taken.map(|(setting, assembly)| {
            (setting.text.clone(), assembly.recorded(EnvironmentId { kitchen, number: key.1 }, key.2))
        }))
    }

    /// The episode as its messages have it, of an environment that nothing here simulates.
    pub fn told(&self, key: Key) -> Result<Option<ShownEpisode>, RecordingError> {
        let taken = self.assembled(key, Assembly::keeping())?;
        let ended = self.get(key).and_then(|shelved| shelved.end.as_ref());
        let ended = ended.map(|ended| (ended.outcome.clone(), ended.figures.clone()));
        Ok(taken.and_then(|(setting, assembly)| {
            let config = toml::from_str(&setting.text).ok()?;
            Some(shown(&config, &setting.declared, assembly, ended))
        }))
    }

    /// Puts an episode's messages together, and says what the first of its files was recorded under.
    fn assembled(&self, key: Key, mut assembly: Assembly) -> Result<Option<(&Setting, Assembly)>, RecordingError> {
        let Some(shelved) = self.episodes.get(&key) else { return Ok(None) };
        let mut first_setting = None;
        for &(number, first, last) in &shelved.places {
            let volume = &self.volumes[number];
            let unreadable = |cause| RecordingError::Unreadable { path: volume.path.clone(), cause };
            let Some(setting) = &volume.config else { continue };
            first_setting.get_or_insert(&**setting);
            let file = self.folder.open(&volume.path).map_err(unreadable)?;
            let mut offset = first;
            while offset <= last {
                offset = match next(&file, offset, volume.length).map_err(unreadable)? {
                    Next::Chunk(body, end) => {
                        for found in contents(&body).unwrap_or_default() {
                            if let Found::Message(channel, _, data) = found
                                && let Some((carries, reading)) = volume.channels.get(&channel)
                                && let Ok(told) = reading.read(&data)
                            {
                                assemble(&mut assembly, key, *carries, told, &setting.declared);
                            }
                        }
                        end
                    }
                    Next::Other(end) => end,
                    Next::End | Next::Damaged => break,
                };
            }
        }
        Ok(first_setting.filter(|_| !assembly.hashes.is_empty()).map(|setting| (setting, assembly)))
    }

    fn find_volumes(&mut self) {
        let files = match super::files_in(&self.folder) {
            Ok(files) => files,
            // There is none yet.
            Err(RecordingError::NoRecordings(_)) => return,
            Err(error) => {
                self.note(error.to_string());
                return;
            }
        };
        for Item { path, bytes: length, .. } in files {
            if let Some(&number) = self.numbers.get(&path) {
                let volume = &mut self.volumes[number];
                volume.caught_up &= volume.length == length;
                volume.length = length;
                continue;
            }
            let offset = mcap::MAGIC.len() as u64;
            self.numbers.insert(path.clone(), self.volumes.len());
            self.volumes.push(Volume { path, offset, length, ..Volume::default() });
        }
    }

    fn note(&mut self, note: String) {
        if self.notes.len() < NOTES_MOST && !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// Reads the next record of a file; false if there is none yet, or never.
    fn read_on(&mut self, number: usize) -> bool {
        let volume = &mut self.volumes[number];
        if volume.config.is_none() {
            match config_of(&self.folder, &volume.path) {
                Ok(config) => volume.config = Some(Arc::new(config)),
                Err(_) if volume.offset >= volume.length || super::is_growing(&self.folder, &volume.path) => {
                    return false;
                }
                Err(error) => {
                    volume.given_up = true;
                    self.note(error.to_string());
                    return false;
                }
            }
        }
        let record = self.folder.open(&volume.path).and_then(|file| next(&file, volume.offset, volume.length));
        let (offset, read) = match record {
            Ok(Next::Chunk(body, end)) => (end, contents(&body)),
            Ok(Next::Other(end)) => (end, Some(Vec::new())),
            Ok(Next::End) => {
                volume.caught_up = true;
                return false;
            }
            Err(_) => return false,
            Ok(Next::Damaged) => (volume.offset, None),
        };
        let Some(contents) = read else {
            // A flush that is seen half is whole a moment later.
            if !super::is_growing(&self.folder, &volume.path) {
                volume.given_up = true;
                let note = format!(
                    "{} is damaged after {} bytes: the table has what comes before, `orchestrator recover {}` saves the \
                     rest",
                    volume.path.display(),
                    volume.offset,
                    quoted(&volume.path)
                );
                self.note(note);
            }
            return false;
        };
        let at = volume.offset;
        volume.offset = offset;
        for found in contents {
            let volume = &mut self.volumes[number];
            match found {
                Found::Schema(id, descriptor) => drop(volume.schemas.insert(id, descriptor)),
                Found::Channel(id, schema, topic) => {
                    if let Err(problem) = volume.meet(id, schema, &topic) {
                        let note = format!("{}: {topic}: {problem}", volume.path.display());
                        volume.given_up = true;
                        self.note(note);
                        return false;
                    }
                }
                Found::Message(channel, time_ns, data) if volume.switches == Some(channel) => {
                    if let Ok(switch) = StageSwitch::decode(data.as_slice()) {
                        self.rewards.insert(time_ns, switch.reward.into());
                    }
                }
                Found::Message(channel, time_ns, data) => {
                    if let Some((carries, reading)) = volume.channels.get(&channel)
                        && let Ok(told) = reading.read(&data)
                    {
                        let carries = *carries;
                        self.take((number, at), time_ns, carries, &told);
                    }
                }
            }
        }
        true
    }

    fn take(&mut self, place: (usize, u64), time_ns: u64, carries: Carries, told: &Told) {
        let Some(setting) = self.volumes[place.0].config.clone() else { return };
        let (whose, generation) = told.engine.whose();
        let step = match carries {
            Carries::Step => told.engine.step,
            Carries::Start => 0,
            Carries::End => told.engine.length,
        };
        let reward = self.rewards.range(..=time_ns).next_back().map(|(_, reward)| Arc::clone(reward));
        let Some(shelved) = self.shelved(whose, generation, step, place) else { return };
        match carries {
            Carries::Start => {}
            Carries::Step => {
                shelved.from_its_start |= step == 0;
                shelved.target = shelved.target.take().or_else(|| target(&setting.declared, told));
                shelved.fixed = told.engine.fixed_episode;
                shelved.reward = reward;
                shelved.steps = shelved.steps.max(step.saturating_add(1));
            }
            Carries::End => {
                shelved.end = Some(Ended::of(&setting.declared, told));
                let ended = self.ended.entry(whose.0).or_default();
                // A learner that went back plays some again.
                ended.retain(|key| *key != whose);
                if ended.len() == ENDED_KEPT {
                    ended.pop_front();
                }
                ended.push_back(whose);
            }
        }
    }

    fn shelved(
        &mut self,
        (kitchen, environment, episode): (u32, u32, u32),
        generation: Generation,
        step: u32,
        (number, at): (usize, u64),
    ) -> Option<&mut Shelved> {
        // One that is no kitchen has no episode that could be simulated.
        let place = EnvironmentId { kitchen: KitchenId::new(kitchen).ok()?, number: environment };
        let home = home(self.volumes[number].config.as_ref()?.kitchens, place);
        let home = (home.kitchen.number(), home.number);
        self.homes.insert((kitchen, environment), home);
        let newest = self.newest.entry(home).or_default();
        *newest = (*newest).max((generation, episode));
        let key = (kitchen, environment, episode);
        if !self.episodes.contains_key(&key) {
            if self.episodes.len() >= EPISODES_MAX {
                if !std::mem::replace(&mut self.is_full, true) {
                    self.notes
                        .push(format!("the table has the first {EPISODES_MAX} episodes, later ones are left out"));
                }
                return None;
            }
            self.met += 1;
            let new = Shelved { order: self.met, generation, ..Shelved::default() };
            self.episodes.insert(key, new);
        }
        let shelved = self.episodes.get_mut(&key)?;
        if !shelved.admits(generation, step) {
            return None;
        }
        shelved.lies_at(number, at);
        Some(shelved)
    }
}

impl Volume {
    fn meet(&mut self, id: u16, schema: u16, topic: &str) -> Result<(), MessageError> {
        if topic == STAGES {
            self.switches = Some(id);
        }
        let Some(setting) = &self.config else { return Ok(()) };
        if let Some((carries, form)) = setting.declared.forms.of_topic(topic) {
            let descriptor = self.schemas.get(&schema).map_or(&[][..], Vec::as_slice);
            self.channels.insert(id, (carries, Reading::of(form, descriptor)?));
        }
        Ok(())
    }
}

fn target(declared: &Declared, step: &Told) -> Option<String> {
    let (channel, field) = declared.spec.channel("target")?;
    channel.names.get(field.number(&step.record) as usize).cloned()
}

fn assemble(assembly: &mut Assembly, key: Key, carries: Carries, told: Told, declared: &Declared) {
    match carries {
        _ if told.engine.whose().0 != key => {}
        Carries::Step => assembly.step(declared, told),
        Carries::Start => assembly.begin(declared, &told),
        Carries::End => {}
    }
}

/// What a chunk holds; none if its content is not what its checksum says.
fn contents(body: &[u8]) -> Option<Vec<Found>> {
    let mut found = Vec::new();
    each_record(body, |record| match record {
        Record::Schema { header, data } => found.push(Found::Schema(header.id, data.into_owned())),
        Record::Channel(channel) => found.push(Found::Channel(channel.id, channel.schema_id, channel.topic)),
        Record::Message { header, data } => {
            found.push(Found::Message(header.channel_id, header.log_time, data.into_owned()));
        }
        _ => {}
    })?;
    Some(found)
}

/// Takes every record of a chunk; none if its content is not what its checksum says. No room is made for what a damaged
/// length claims.
pub(super) fn each_record(body: &[u8], mut take: impl FnMut(Record)) -> Option<()> {
    let Ok(Record::Chunk { header, .. }) = parse_record(op::CHUNK, body) else { return None };
    if header.uncompressed_size > RECORD_MAX {
        return None;
    }
    let options = LinearReaderOptions::default().with_skip_start_magic(true).with_skip_end_magic(true);
    let options = options.with_prevalidate_chunk_crcs(true).with_record_length_limit(RECORD_MAX as usize);
    let mut reader = LinearReader::new_with_options(options);
    let mut head = vec![op::CHUNK];
    head.extend((body.len() as u64).to_le_bytes());
    let mut rest = [head.as_slice(), body].into_iter();
    let mut piece = rest.next().unwrap_or_default();
    while let Some(event) = reader.next_event() {
        match event.ok()? {
            LinearReadEvent::ReadRequest(wanted) => {
                if piece.is_empty() {
                    piece = rest.next().unwrap_or_default();
                }
                let (now, later) = piece.split_at(wanted.min(piece.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                piece = later;
            }
            LinearReadEvent::Record { data, opcode } => take(parse_record(opcode, data).ok()?),
        }
    }
    Some(())
}

fn config_of(folder: &RunFolder, path: &Path) -> Result<Setting, RecordingError> {
    let source = folder.open(path).and_then(FileSource::new);
    let source = source.map_err(|cause| RecordingError::Unreadable { path: path.to_path_buf(), cause })?;
    let text = Origin::read(path, source)?.configuration(path, std::iter::empty())?;
    let foreign = |problem: String| RecordingError::Foreign { path: path.to_path_buf(), problem };
    let config: Config = toml::from_str(&text).map_err(|cause| foreign(cause.to_string()))?;
    Ok(Setting { kitchens: config.kitchens(), declared: Declared::of(&config).map_err(foreign)?, text })
}

pub(super) fn next(file: &File, offset: u64, length: u64) -> std::io::Result<Next> {
    if offset + RECORD_HEAD > length {
        return Ok(Next::End);
    }
    let mut head = [0; RECORD_HEAD as usize];
    file.read_exact_at(&mut head, offset)?;
    let size = u64::from_le_bytes(std::array::from_fn(|at| head[at + 1]));
    // What follows the data is index; a recorder that goes on replaces it.
    if head[0] == op::DATA_END {
        return Ok(Next::End);
    }
    if head[0] == 0 || size > RECORD_MAX {
        return Ok(Next::Damaged);
    }
    let end = offset + RECORD_HEAD + size;
    if end > length {
        return Ok(Next::Damaged);
    }
    if head[0] != op::CHUNK {
        return Ok(Next::Other(end));
    }
    let mut body = vec![0; size as usize];
    file.read_exact_at(&mut body, offset + RECORD_HEAD)?;
    Ok(Next::Chunk(body, end))
}
