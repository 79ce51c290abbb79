//! Recorded episodes, put together from the steps of one or more segments.
//!
//! An episode can run over several segments, and after a learner went back to its checkpoint a part of it is recorded
//! twice. Files are read in the order of time, however they are given, and steps of a newer learner incarnation replace
//! what they redo, with everything after it.

use super::reader::{Extent, RecordingError, read};
use super::wanted::{Known, Wanted};
use crate::recording::recorder::segment::{CONFIG_ATTACHMENT, IDENTITY_METADATA, identity};
use crate::recording::schema::stillroom::step::Goal;
use crate::recording::schema::stillroom::{EpisodeStart, RobotVector, Step};
use mcap::records::{Metadata, Record};
use prost::Message;
use proto::SCHEMA_VERSION;
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::evaluation::Plan;
use proto::kitchen::KitchenId;
use proto::replay::{RecordedEpisode, goal_digest};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// What a set of recordings holds.
#[derive(Debug)]
pub struct Recorded {
    /// The run's configuration, TOML.
    pub config: String,
    /// Episodes recorded from their first step, by kitchen, environment and number; the last of an environment may
    /// be unfinished.
    pub episodes: Vec<RecordedEpisode>,
    /// Episodes whose first step is in no file given.
    pub headless: u64,
    /// Episodes with a hole; they are kept up to it.
    pub broken: u64,
    /// What there is to choose from.
    pub known: Known,
    /// Steps read, those that were done again included.
    pub steps: u64,
    /// What was wrong with which file.
    pub complaints: Vec<String>,
}

/// Kitchen number, environment number, episode number.
type Key = (u8, u32, u32);

/// Incarnations of orchestrator and learner: the higher one is the newer.
type Generation = (u32, u32);

#[derive(Debug, Default)]
struct Assembly {
    generation: Generation,
    start_hash: Option<u64>,
    actions: Vec<u8>,
    hashes: Vec<u64>,
    goals: Vec<u32>,
    gap: bool,
}

/// What one step holds about its episode.
#[derive(Debug, Clone, Copy)]
struct Taken {
    action: u8,
    hash: u64,
    goal: u32,
}

impl Assembly {
    fn step(&mut self, generation: Generation, step: usize, taken: Taken) {
        if generation < self.generation {
            // Void: a newer learner has gone on from an earlier point, and that has been read already.
            return;
        }
        if generation > self.generation {
            // The learner went back to before this step: what an older one did from here on is void.
            self.generation = generation;
            self.actions.truncate(step);
            self.hashes.truncate(step);
            self.goals.truncate(step);
            self.gap = false;
        }
        match step.cmp(&self.actions.len()) {
            std::cmp::Ordering::Equal => {
                self.actions.push(taken.action);
                self.hashes.push(taken.hash);
                self.goals.push(taken.goal);
            }
            std::cmp::Ordering::Greater => self.gap = true,
            // Recorded twice under the same learner: a segment was given twice.
            std::cmp::Ordering::Less => {}
        }
    }
}

/// Reads the files, given in any order, and puts the wanted episodes together.
pub fn gather(files: &[PathBuf], wanted: Wanted) -> Result<Recorded, RecordingError> {
    let mut in_time = files.iter().map(|path| Ok((place(path)?, path))).collect::<Result<Vec<_>, RecordingError>>()?;
    in_time.sort_by_key(|(place, _)| *place);
    let mut collection = Collection { wanted, ..Collection::default() };
    let mut complaints = Vec::new();
    for (_, path) in in_time {
        let extent = collection.add(path)?;
        complaints.extend(extent.complaint(path));
    }
    collection.into_recorded(files, complaints)
}

/// Incarnation of the orchestrator and number of the segment, from the beginning of a file; none if they are not there.
/// The file's name is not used: files are copied and renamed.
fn place(path: &Path) -> Result<Option<(u32, u32)>, RecordingError> {
    /// Why reading ends before the end of the file.
    enum Enough {
        Seen(Option<(u32, u32)>),
        Failed(RecordingError),
    }
    impl From<RecordingError> for Enough {
        fn from(error: RecordingError) -> Self {
            Self::Failed(error)
        }
    }
    let outcome = read(path, |record| match record {
        Record::Metadata(Metadata { name, metadata }) if name == IDENTITY_METADATA => {
            let number = |key: &str| metadata.get(key)?.parse().ok();
            Err(Enough::Seen(number(identity::INCARNATION).zip(number(identity::SEGMENT))))
        }
        // It comes before everything that was seen.
        Record::Message { .. } => Err(Enough::Seen(None)),
        _ => Ok(()),
    });
    match outcome {
        Ok(_) => Ok(None),
        Err(Enough::Seen(place)) => Ok(place),
        Err(Enough::Failed(error)) => Err(error),
    }
}

#[derive(Default)]
struct Collection {
    wanted: Wanted,
    known: Known,
    run_id: Option<String>,
    config: Option<String>,
    /// Which fixed episodes were played, in an evaluation.
    plan: Option<Plan>,
    episodes: BTreeMap<Key, Assembly>,
    steps: u64,
}

/// What a channel of one file carries, as far as episodes are concerned.
#[derive(Clone, Copy)]
enum Carries {
    Step,
    EpisodeStart,
}

impl Collection {
    fn add(&mut self, path: &Path) -> Result<Extent, RecordingError> {
        let foreign = |problem: String| RecordingError::Foreign { path: path.to_path_buf(), problem };
        let mut channels: HashMap<u16, Carries> = HashMap::new();
        let mut identified = false;
        read(path, |record| {
            match record {
                Record::Metadata(metadata) if metadata.name == IDENTITY_METADATA => {
                    self.identify(&metadata.metadata).map_err(foreign)?;
                    identified = true;
                }
                Record::Attachment { header, data, .. } if header.name == CONFIG_ATTACHMENT => {
                    let config = String::from_utf8(data.into_owned())
                        .map_err(|_| foreign("its configuration is not text".to_owned()))?;
                    self.configure(config).map_err(foreign)?;
                }
                Record::Channel(channel) => {
                    if !identified {
                        return Err(foreign("it was not written by this program".to_owned()));
                    }
                    match channel.topic.as_str() {
                        "/step" => drop(channels.insert(channel.id, Carries::Step)),
                        "/episode/start" => drop(channels.insert(channel.id, Carries::EpisodeStart)),
                        _ => {}
                    }
                }
                Record::Message { header, data } => match channels.get(&header.channel_id) {
                    Some(Carries::Step) => {
                        let step = Step::decode(&*data).map_err(|cause| foreign(cause.to_string()))?;
                        self.step(&step).map_err(foreign)?;
                    }
                    Some(Carries::EpisodeStart) => {
                        let start = EpisodeStart::decode(&*data).map_err(|cause| foreign(cause.to_string()))?;
                        self.start(&start).map_err(foreign)?;
                    }
                    None => {}
                },
                _ => {}
            }
            Ok(())
        })
    }

    fn configure(&mut self, config: String) -> Result<(), String> {
        // All files of one run have the same.
        if self.config.is_none() {
            // Only read: whether it can be run is checked by those who run it.
            let read: Config = toml::from_str(&config).map_err(|cause| format!("{CONFIG_ATTACHMENT}: {cause}"))?;
            self.plan = read.evaluation_plan();
            self.config = Some(config);
        }
        Ok(())
    }

    fn identify(&mut self, metadata: &BTreeMap<String, String>) -> Result<(), String> {
        let version = metadata.get(identity::SCHEMA_VERSION).map_or("none", String::as_str);
        if version != SCHEMA_VERSION.to_string() {
            return Err(format!("it has schema version {version}, this program speaks {SCHEMA_VERSION}"));
        }
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

    fn step(&mut self, step: &Step) -> Result<(), String> {
        self.steps += 1;
        let action = u8::try_from(step.action).map_err(|_| format!("there is no action {}", step.action))?;
        let generation = (step.incarnation, step.learner_incarnation);
        if let Some(assembly) = self.assembly(step.kitchen, step.environment, step.episode)? {
            let taken = Taken { action, hash: step.state_hash, goal: digest(step.goal.as_ref()) };
            assembly.step(generation, step.step as usize, taken);
        }
        Ok(())
    }

    fn start(&mut self, start: &EpisodeStart) -> Result<(), String> {
        if let Some(assembly) = self.assembly(start.kitchen, start.environment, start.episode)? {
            assembly.start_hash = Some(start.state_hash);
        }
        Ok(())
    }

    /// The episode, if it is wanted.
    fn assembly(&mut self, kitchen: u32, environment: u32, episode: u32) -> Result<Option<&mut Assembly>, String> {
        let kitchen = u8::try_from(kitchen)
            .ok()
            .and_then(|number| KitchenId::new(number).ok())
            .ok_or_else(|| format!("there is no kitchen {kitchen}"))?;
        let of = EnvironmentId { kitchen, number: environment };
        // In an evaluation episodes are called by the numbers of its table; an environment that has run out plays none.
        let number = match &self.plan {
            None => episode,
            Some(plan) => match plan.dealt(of, episode) {
                Some(fixed) => fixed,
                None => return Ok(None),
            },
        };
        self.known.environments.insert((kitchen.number(), environment));
        if !self.wanted.is_of(of) {
            return Ok(None);
        }
        self.known.episodes.insert(number);
        if !self.wanted.has_number(number) {
            return Ok(None);
        }
        Ok(Some(self.episodes.entry((kitchen.number(), environment, episode)).or_default()))
    }

    fn into_recorded(self, files: &[PathBuf], complaints: Vec<String>) -> Result<Recorded, RecordingError> {
        let Some(config) = self.config else {
            let path = files.first().cloned().unwrap_or_default();
            return Err(RecordingError::Foreign { path, problem: "it holds no configuration".to_owned() });
        };
        let mut recorded = Recorded {
            config,
            episodes: Vec::new(),
            headless: 0,
            broken: 0,
            known: self.known,
            steps: self.steps,
            complaints,
        };
        for ((kitchen, number, episode), assembly) in self.episodes {
            if assembly.actions.is_empty() {
                // A start without a step is an episode that had just begun; steps without the first are headless.
                recorded.headless += u64::from(assembly.gap);
                continue;
            }
            recorded.broken += u64::from(assembly.gap);
            let kitchen = KitchenId::new(kitchen).expect("checked when it was read");
            recorded.episodes.push(RecordedEpisode {
                environment: EnvironmentId { kitchen, number },
                episode,
                start_hash: assembly.start_hash,
                actions: assembly.actions,
                hashes: assembly.hashes,
                goals: assembly.goals,
            });
        }
        Ok(recorded)
    }
}

/// Digest of what the goal sensor read; 0 where that was not recorded.
fn digest(goal: Option<&Goal>) -> u32 {
    match goal {
        None => 0,
        Some(Goal::WristToObjectM(RobotVector { x, y, z })) => goal_digest(false, [*x, *y, *z]),
        Some(Goal::ObjectToGoalM(RobotVector { x, y, z })) => goal_digest(true, [*x, *y, *z]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn taken(action: u8, hash: u64) -> Taken {
        Taken { action, hash, goal: u32::from(action) }
    }

    proptest! {
        /// A reference by brute force: of every step, the newest generation counts, and nothing older lies beyond
        /// the newest generation's last step.
        #[test]
        fn rewinds_leave_what_the_newest_learner_did(
            runs in prop::collection::vec((0usize..12, 1usize..12), 1..6),
        ) {
            let mut assembly = Assembly::default();
            let mut reference: Vec<(u8, u64)> = Vec::new();
            for (generation, (back, length)) in runs.iter().enumerate() {
                let from = reference.len().saturating_sub(*back);
                reference.truncate(from);
                for step in from..from + length {
                    let (action, hash) = ((generation * 3 + step) as u8, (generation * 1000 + step) as u64);
                    reference.push((action, hash));
                    assembly.step((1, generation as u32 + 1), step, taken(action, hash));
                }
            }
            prop_assert!(!assembly.gap);
            let got: Vec<_> = assembly.actions.iter().copied().zip(assembly.hashes.iter().copied()).collect();
            prop_assert_eq!(got, reference);
            let goals: Vec<u32> = assembly.actions.iter().map(|&action| u32::from(action)).collect();
            prop_assert_eq!(assembly.goals, goals);
        }
    }

    #[test]
    fn an_older_learner_adds_nothing_to_a_newer_one() {
        let mut assembly = Assembly::default();
        assembly.step((2, 1), 0, taken(1, 10));
        assembly.step((1, 1), 1, taken(9, 90));
        assert!(!assembly.gap);
        assert_eq!((assembly.actions, assembly.hashes), (vec![1], vec![10]));
    }

    #[test]
    fn a_hole_ends_an_episode_and_a_rewind_mends_it() {
        let mut assembly = Assembly::default();
        for step in [0, 1, 3, 4] {
            assembly.step((1, 1), step, taken(step as u8, 0));
        }
        assert!(assembly.gap);
        assert_eq!(assembly.actions, [0, 1]);
        for step in [1, 2, 3] {
            assembly.step((2, 1), step, taken(10 + step as u8, 0));
        }
        assert!(!assembly.gap);
        assert_eq!(assembly.actions, [0, 11, 12, 13]);
    }
}
