use crate::output::format::counted;
use crate::run::scenes::config_by_content;
use crate::training::scores::read_result;
use anyhow::{Context, Result, bail};
use proto::bounded::TABLE_BYTES_MOST;
use proto::config::Config;
use proto::evaluation::{Subject, TABLE_FILE, read_table_from};
use proto::run_folder::RunFolder;
use proto::task::Spec;
use report::study::{Evaluated, Origin, Run, differences_between};
use std::path::PathBuf;

pub(super) struct UnclaimedEvaluation {
    pub place: PathBuf,
    folder: RunFolder,
    config: Config,
    pub evaluated: Evaluated,
}

impl UnclaimedEvaluation {
    pub fn read(folder: &RunFolder, place: PathBuf) -> Result<Self> {
        let config = config_by_content(folder)?;
        let evaluated = evaluation(config.spec(), folder)?;
        Ok(Self { place, folder: folder.clone(), config, evaluated })
    }

    /// As a run of its own: its run was not given, or it has none.
    pub fn alone(self) -> Run {
        let subject = &self.evaluated.result.subject;
        // Only its run's folder contains how the weights were trained, if that folder still exists.
        let folder = subject.run.as_ref().map(RunFolder::new);
        // Another run may have taken its place.
        let folder = folder.filter(|folder| subject.run_id.is_none() || folder.id() == subject.run_id);
        let trained = folder.and_then(|folder| config_by_content(&folder).ok());
        let trained = trained.filter(|trained| is_of(subject, trained));
        let (origin, config) = match (&subject.run, trained) {
            (Some(_), Some(trained)) => (Origin::NotGiven, trained),
            (run, _) => {
                let origin = match (run, &subject.checkpoint) {
                    (None, None) => Origin::Untrained,
                    (None, Some(file)) => Origin::Policy(file.rsplit('/').next().unwrap_or(file).to_owned()),
                    (Some(_), _) => Origin::Unknown,
                };
                // The configuration is the evaluation's: its own seed, its own number of actors.
                let mut config = Config { seed: subject.seed, evaluation: None, ..self.config };
                if let Ok(preset) = Config::resolve(&config.preset, None) {
                    config.actors = preset.actors;
                }
                (origin, config)
            }
        };
        Run {
            name: self.folder.root().display().to_string(),
            origin,
            config,
            rollouts: Vec::new(),
            stages: Vec::new(),
            evaluations: vec![self.evaluated],
            validation: Vec::new(),
        }
    }
}

/// Whether a run with this configuration can have trained what was evaluated.
pub(super) fn is_of(subject: &Subject, config: &Config) -> bool {
    config.evaluation.is_none() && (&config.preset, config.seed) == (&subject.preset, subject.seed)
}

/// Whether evaluations without their run are of one: of checkpoints of the same run, or of the same fresh weights.
pub(super) fn same_run(known: &Run, other: &Run) -> bool {
    let subject = |run: &Run| run.evaluations.first().map(|evaluated| evaluated.result.subject.clone());
    let (Some(known_subject), Some(other_subject)) = (subject(known), subject(other)) else { return false };
    if let (Some(id), Some(other_id)) = (&known_subject.run_id, &other_subject.run_id) {
        return id == other_id;
    }
    match (&known_subject.run, &other_subject.run) {
        (None, None) => known_subject.weights == other_subject.weights,
        // By what it learned, too: another run may have taken the place of one that was removed.
        (Some(place), Some(other_place)) => {
            place == other_place
                && (known.config.seed, &known.origin) == (other.config.seed, &other.origin)
                && differences_between(&known.config, &other.config).is_empty()
        }
        _ => false,
    }
}

pub(super) fn evaluation(spec: &Spec, run: &RunFolder) -> Result<Evaluated> {
    let (folder, result) = (run.root(), read_result(run)?);
    if result.task != spec.name {
        bail!("{} is an evaluation of the task `{}`, not of `{}`", folder.display(), result.task, spec.name);
    }
    let path = folder.join(TABLE_FILE);
    let table = run.reader(&path, TABLE_BYTES_MOST).with_context(|| format!("cannot read {}", path.display()))?;
    let episodes = read_table_from(spec, table).with_context(|| path.display().to_string())?;
    if result.overall.episodes != episodes.len() as u64 {
        bail!(
            "{}: the table has {}, the result file {}",
            folder.display(),
            counted(episodes.len() as u64, "episode"),
            result.overall.episodes
        );
    }
    let name = folder.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into());
    Ok(Evaluated { name, folder: folder.to_path_buf(), result, episodes })
}
