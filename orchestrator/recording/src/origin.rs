//! Where a recording comes from: what stands at its beginning.

use super::reader::{RecordingError, open, read_source};
use crate::recorder::segment::{CONFIG_ATTACHMENT, IDENTITY_METADATA, RECORDING_VERSION, identity};
use mcap::records::{Metadata, Record};
use proto::config::Config;
use proto::run_folder::RunFolder;
use salvage::{FileSource, Trust};
use std::path::Path;

/// Identity, configuration and schemas lie before this, whatever a file holds after them.
const BEGINNING_BYTES_MOST: u64 = 16 << 20;

/// Incarnation of the orchestrator, host, and number of the segment.
type Place = (u32, u32, u32);

/// The beginning of a file: its name is not used, because files are copied and renamed.
#[derive(Debug, Default, Clone)]
pub struct Origin {
    pub place: Option<Place>,
    run_id: Option<String>,
    version: Option<u32>,
    seed: Option<u64>,
    config: Option<String>,
}

impl Origin {
    pub fn of(path: &Path) -> Result<Self, RecordingError> {
        Self::read(path, open(path)?.0)
    }

    pub fn read(path: &Path, source: FileSource) -> Result<Self, RecordingError> {
        enum Enough {
            Seen,
            Failed(RecordingError),
        }
        impl From<RecordingError> for Enough {
            fn from(error: RecordingError) -> Self {
                Self::Failed(error)
            }
        }
        let mut origin = Self::default();
        let beginning = source.up_to(BEGINNING_BYTES_MOST);
        let outcome = read_source(path, &beginning, false, |record, trust| match record {
            Record::Metadata(Metadata { name, metadata }) if name == IDENTITY_METADATA => {
                let number = |key: &str| metadata.get(key)?.parse().ok();
                let host = number(identity::HOST).unwrap_or(0);
                let place = number(identity::INCARNATION).zip(number(identity::SEGMENT));
                origin.place = place.map(|(incarnation, segment)| (incarnation, host, segment));
                origin.run_id = metadata.get(identity::RUN_ID).cloned();
                origin.version = metadata.get(identity::VERSION).and_then(|version| version.parse().ok());
                origin.seed = metadata.get(identity::SEED).and_then(|seed| seed.parse().ok());
                Ok(())
            }
            Record::Attachment { header, data, .. } if header.name == CONFIG_ATTACHMENT && trust == Trust::Sound => {
                origin.config = String::from_utf8(data.into_owned()).ok();
                Ok(())
            }
            // Both come before everything else.
            Record::Message { .. } => Err(Enough::Seen),
            _ => Ok(()),
        });
        match outcome {
            Ok(_) | Err(Enough::Seen) => Ok(origin),
            Err(Enough::Failed(error)) => Err(error),
        }
    }

    pub fn configuration<'a>(
        &self,
        path: &Path,
        mut others: impl Iterator<Item = &'a Self>,
    ) -> Result<String, RecordingError> {
        let foreign = |problem: String| RecordingError::Foreign { path: path.to_path_buf(), problem };
        let start = |origin: &Self| origin.place.map(|place| place.0);
        if self.run_id.is_none() {
            return Err(foreign("it was not written by this program, or its identity is lost".to_owned()));
        }
        match self.version {
            Some(RECORDING_VERSION) => {}
            Some(older) if older < RECORDING_VERSION => {
                return Err(foreign(
                    "it was recorded by an older version; the programs of commit 0e4cae3e and before read it"
                        .to_owned(),
                ));
            }
            version => {
                let version = version.map_or_else(|| "none".to_owned(), |version| version.to_string());
                return Err(foreign(format!("it has version {version}, this program reads {RECORDING_VERSION}")));
            }
        }
        let same_start =
            |other: &&Self| other.run_id == self.run_id && start(other) == start(self) && other.config.is_some();
        let of_folder = || {
            let folder = RunFolder::of_recording(path)?;
            let config = Config::of_run(&folder).ok()?;
            Some(config.to_toml()).filter(|_| self.seed.is_none_or(|seed| seed == config.seed))
        };
        let found = self.config.clone().or_else(|| others.find(same_start)?.config.clone()).or_else(of_folder);
        let Some(text) = found else {
            return Err(foreign("it holds no configuration, or a damaged one: give the run's folder".to_owned()));
        };
        let seed = toml::from_str::<Config>(&text).map(|config| config.seed).ok();
        match (self.seed, seed) {
            (Some(recorded), Some(seed)) if recorded != seed => Err(foreign(format!(
                "it was recorded with seed {recorded}, but its configuration says {seed}: one of them was altered"
            ))),
            _ => Ok(text),
        }
    }
}

/// What of a configuration decides what the simulator does; the rest is as by default.
pub fn world_of(config: &Config) -> Config {
    let mut actors = config.actors;
    if config.evaluation.is_none() {
        // Another number of them (`orchestrator scale`) leaves each environment as it is.
        actors.count = Config::default().actors.count;
    }
    Config {
        seed: config.seed,
        scenes: config.scenes.clone(),
        kitchens: config.kitchens,
        actors,
        simulation: config.simulation,
        episode: config.episode,
        task: config.task.clone(),
        reward: config.reward.clone(),
        rewards: config.rewards.clone(),
        evaluation: config.evaluation.clone(),
        ..Config::default()
    }
}
