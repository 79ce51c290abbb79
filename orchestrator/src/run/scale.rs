//! What `orchestrator scale` asks of the orchestrator that runs: a file of the run folder, which that one looks for.

use super::damaged;
use crate::output::format::counted;
use anyhow::{Context, Result, anyhow, bail};
use proto::config::Config;
use proto::run_folder::{RunFolder, write_atomically};
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScaleRequest {
    /// The start that is asked. One that a crash left behind is nobody's.
    pub incarnation: u32,
    pub actors: u32,
    /// The rollout that is to be the first with them; none: the next that has not begun.
    pub at_rollout: Option<u64>,
    pub refused: Option<String>,
}

impl ScaleRequest {
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        let path = folder.scale_request();
        let text = toml::to_string(self).context("scale.toml")?;
        write_atomically(&path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))
    }

    pub fn read(folder: &RunFolder) -> Result<Option<Self>> {
        let path = folder.scale_request();
        match folder.read_text(&path) {
            Ok(text) => {
                Ok(Some(toml::from_str(&text).with_context(|| damaged(&path, "delete it, and ask again if need be"))?))
            }
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).with_context(|| path.display().to_string()),
        }
    }

    /// Why `asked` cannot be, if this says so. Another command may ask at the same time, and has an answer of its own.
    pub fn answers(self, asked: &Self) -> Option<String> {
        let Self { refused, .. } = &self;
        let answer = Self { refused: refused.clone(), ..asked.clone() };
        if self == answer { self.refused } else { None }
    }

    pub fn remove(folder: &RunFolder) {
        match std::fs::remove_file(folder.scale_request()) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                tracing::warn!("cannot remove {}: {error}", folder.scale_request().display());
            }
            _ => {}
        }
    }

    /// Takes what is asked of this start, if it can be; what cannot be is answered in the file. `next`: the first rollout
    /// that has not begun; none where this start is being ended already.
    pub fn take(folder: &RunFolder, incarnation: u32, config: &Config, next: Option<u64>) -> Option<Self> {
        let request = match Self::read(folder) {
            Ok(found) => found?,
            Err(error) => {
                tracing::warn!("{error:#}: it is removed");
                Self::remove(folder);
                return None;
            }
        };
        if request.refused.is_some() {
            return None;
        }
        if request.incarnation != incarnation {
            Self::remove(folder);
            return None;
        }
        if let Err(error) = request.check(config, next) {
            tracing::warn!("scale to {} actors is refused: {error:#}", request.actors);
            let answer = Self { refused: Some(format!("{error:#}")), ..request };
            if let Err(error) = answer.write(folder) {
                tracing::warn!("{error:#}");
            }
            return None;
        }
        Self::remove(folder);
        Some(request)
    }

    fn check(&self, config: &Config, next: Option<u64>) -> Result<()> {
        with_actors(config, self.actors)?;
        let Some(next) = next else {
            bail!("it is being saved, to end or for a change that was asked for before: ask again when it goes on")
        };
        match self.at_rollout {
            Some(at) if at < next => {
                bail!("rollout {at} has begun already; the next one that can have another number is {next}")
            }
            _ => Ok(()),
        }
    }
}

pub fn with_actors(config: &Config, actors: u32) -> Result<Config> {
    let mut new = config.clone();
    new.actors.count = actors;
    // Other runs can have it: a failure, not wrong usage.
    new.validate().map_err(|error| {
        anyhow!("the run cannot have {}: {:#}", counted(u64::from(actors), "actor"), anyhow::Error::from(error))
    })?;
    Ok(new)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(incarnation: u32, actors: u32, at_rollout: Option<u64>) -> ScaleRequest {
        ScaleRequest { incarnation, actors, at_rollout, refused: None }
    }

    #[test]
    fn a_request_is_taken_once_and_only_by_the_start_that_it_asks() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        let mut config = Config::resolve("demo", None).unwrap();
        config.actors.count = 4;
        config.learner.count = 2;
        let take = || ScaleRequest::take(&folder, 3, &config, Some(7));
        assert_eq!(take(), None, "nobody asks");
        request(3, 5, Some(7)).write(&folder).unwrap();
        assert_eq!(take(), Some(request(3, 5, Some(7))));
        assert!(!folder.scale_request().exists() && take().is_none());
        request(2, 5, None).write(&folder).unwrap();
        assert_eq!(take(), None, "asked of a start that is over");
        assert!(!folder.scale_request().exists());
        std::fs::write(folder.scale_request(), "actors = 1").unwrap();
        assert_eq!(take(), None);
        assert!(!folder.scale_request().exists());
    }
}
