//! An evaluation, from its folder to its result files.

use super::audience::{Examiner, JOURNAL_FILE};
use super::subject;
use crate::run::identity::{Ended, Identity, RunLock, unix_now};
use crate::run::session::{EXIT_INTERRUPTED, Sitting};
use crate::showing::format::{self, NOTHING, counted, number, percent};
use crate::showing::terminal;
use crate::supervisor::event::{End, FAILED, Outcome, Saved};
use crate::training::run::{Tools, shape};
use anyhow::{Context, Result};
use proto::config::Config;
use proto::evaluation::{
    Conditions, Cost, Distribution, Evaluation, EvaluationConfig, Figures, RESULT_FILE, Subject, TABLE_FILE, describe,
    write_table,
};
use proto::kitchen::Split;
use proto::run_folder::{RunFolder, write_atomically};
use std::process::ExitCode;

/// An evaluation whose folder has been made.
pub struct Examination {
    /// The folder, with config.toml in it.
    pub folder: RunFolder,
    /// What config.toml says.
    pub config: Config,
    /// What it is asked.
    pub asked: EvaluationConfig,
    /// Print the result as JSON instead of a table.
    pub json: bool,
    /// Whose weights, as far as that is known before they are loaded.
    pub subject: subject::Origin,
    /// What run.toml says.
    pub identity: Identity,
    /// The right to run it.
    pub lock: RunLock,
    /// Programs.
    pub tools: Tools,
}

impl Examination {
    /// Plays all episodes and writes the result; the exit status of the program.
    pub fn run(mut self) -> Result<ExitCode> {
        let plan = self.config.evaluation_plan().context("an evaluation has a plan")?;
        let mut examiner = Examiner::new(plan, &self.folder)?;
        let (incarnation, address) = self.identity.begin_incarnation();
        self.identity.write(&self.folder)?;
        let sitting =
            Sitting { folder: &self.folder, config: &self.config, incarnation, address: &address, tools: &self.tools };
        let result = sitting.begin_log().and_then(|()| {
            tracing::info!(
                "evaluation {} in {}: {}, {}, seed {}",
                self.identity.id,
                self.folder.root().display(),
                counted(examiner.asked() as u64, "episode"),
                shape(&self.config),
                self.config.seed
            );
            sitting.run(&mut self.lock, &mut examiner)
        });
        let reported = result.and_then(|(outcome, recording)| {
            let status = self.report(&outcome, &examiner)?;
            recording.context("the recording is incomplete")?;
            Ok((outcome, status))
        });
        let (how, reason) = match &reported {
            Ok((outcome, _)) => match &outcome.end {
                End::Failed(reason) => (outcome.end.word(), Some(reason.clone())),
                end => (end.word(), None),
            },
            Err(error) => (FAILED, Some(format!("{error:#}"))),
        };
        let ended = Ended { how: how.to_owned(), at_unix_s: unix_now(), frames: None, weights: None, reason };
        self.identity.end_incarnation(ended);
        self.identity.write(&self.folder)?;
        reported.map(|(_, status)| status)
    }

    fn report(&self, outcome: &Outcome, examiner: &Examiner) -> Result<ExitCode> {
        match (&outcome.end, &outcome.saved) {
            (End::Complete, Some(saved)) => {
                let evaluation = self.write(examiner, saved)?;
                let path = format!("result: {}", self.folder.root().join(RESULT_FILE).display());
                if self.json {
                    terminal::note(&path);
                    terminal::out(json(&evaluation)?.trim_end());
                } else {
                    for line in lines(&evaluation) {
                        terminal::out(&line);
                    }
                    terminal::out(&path);
                }
                Ok(ExitCode::SUCCESS)
            }
            (end, _) => {
                let (played, asked) = (examiner.played(), examiner.asked());
                terminal::note(&format!(
                    "{} after {played} of {}: there is no result",
                    end.word(),
                    counted(asked as u64, "episode")
                ));
                Ok(if *end == End::Interrupted { ExitCode::from(EXIT_INTERRUPTED) } else { ExitCode::FAILURE })
            }
        }
    }

    /// Writes the table, then the result file: where that is, all is.
    fn write(&self, examiner: &Examiner, saved: &Saved) -> Result<Evaluation> {
        let records = examiner.records()?;
        let subject = Subject {
            preset: self.subject.preset.clone(),
            seed: self.subject.seed,
            run: self.subject.run.clone(),
            checkpoint: self.asked.checkpoint.clone(),
            frames: examiner.frames(),
            weights: saved.weights.clone(),
            parameters: examiner.parameters(),
        };
        let (_, [start_distance_max_m, goal_distance_max_m]) = episodes_of(&self.config, &self.asked);
        let conditions = Conditions {
            split: self.asked.split,
            scenes: self.config.scenes.clone(),
            objects: self.asked.objects,
            episodes: self.asked.episodes,
            distribution: self.asked.distribution,
            start_distance_max_m,
            goal_distance_max_m,
            deterministic: self.asked.deterministic,
            seed: self.config.seed,
            max_steps: self.config.episode.max_steps,
            action_space: self.config.episode.action_space,
            actors: self.config.actors.count,
            environments_per_actor: self.config.actors.environments_per_actor,
            device: examiner.device().to_owned(),
        };
        let steps = records.iter().map(|(record, _)| u64::from(record.length)).sum();
        let cost = Cost { at_unix_s: unix_now(), wall_s: examiner.wall().as_secs_f64(), steps };
        let evaluation = Evaluation::of(subject, conditions, cost, &records);
        let table: Vec<_> = records.into_iter().map(|(record, _)| record).collect();
        let table = write_table(&table, self.asked.distribution);
        for (name, text) in [(TABLE_FILE, table), (RESULT_FILE, json(&evaluation)?)] {
            let path = self.folder.root().join(name);
            write_atomically(&path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
        }
        let journal = self.folder.root().join(JOURNAL_FILE);
        if let Err(error) = std::fs::remove_file(&journal) {
            tracing::warn!("cannot remove {}: {error}", journal.display());
        }
        Ok(evaluation)
    }
}

/// Which episodes are played, as people read it, and their distances at most: of start and target, and of goal and
/// target.
pub fn episodes_of(config: &Config, asked: &EvaluationConfig) -> (String, [f32; 2]) {
    let distances_m = match asked.distribution {
        Distribution::Fixed => [0.0; 2],
        Distribution::Run => [config.episode.start_distance_max_m, config.episode.goal_distance_max_m],
    };
    (describe(asked.distribution, distances_m[0], distances_m[1]), distances_m)
}

/// Where episodes are played, in words.
pub fn place(split: Split, scenes: usize) -> String {
    let split = match split {
        _ if scenes > 0 => return format!("{} of the run's own", counted(scenes as u64, "scene")),
        Split::Train => "the 19 training kitchens",
        Split::Validation => "the 5 validation kitchens",
        Split::Test => "the 5 test kitchens",
    };
    split.to_owned()
}

/// The result file.
fn json(evaluation: &Evaluation) -> Result<String> {
    let mut json = serde_json::to_string_pretty(evaluation).context(RESULT_FILE)?;
    json.push('\n');
    Ok(json)
}

/// The result as a table on the terminal.
fn lines(evaluation: &Evaluation) -> Vec<String> {
    let Cost { wall_s, steps, .. } = evaluation.cost;
    let conditions = &evaluation.conditions;
    let place = place(conditions.split, conditions.scenes.len());
    let mut lines = vec![format!("{}, in {place}", conditions.episodes_played())];
    lines.push(format!(
        "{:<12}{:>10}{:>8}{:>8}{:>18}{:>11}{:>9}{:>10}{:>11}",
        "", "episodes", "SR", "SRwoD", "SRwoD (per axis)", "picked up", "length", "d_T (m)", "disturbed"
    ));
    lines.extend(evaluation.kitchens.iter().map(|part| line(&format!("kitchen {}", part.kitchen), &part.figures)));
    lines.extend(evaluation.categories.iter().map(|part| line(part.category.name(), &part.figures)));
    lines.extend(evaluation.object_sets.iter().map(|part| line(part.objects.name(), &part.figures)));
    lines.push(line("all", &evaluation.overall));
    let rate = if wall_s > 0.0 { format::rate(steps as f64 / wall_s) } else { NOTHING.to_owned() };
    lines.push(format!("{} steps in {wall_s:.1} s: {rate} steps/s", format::count(steps)));
    lines
}

fn line(name: &str, figures: &Figures) -> String {
    format!(
        "{name:<12}{:>10}{:>8}{:>8}{:>18}{:>11}{:>9}{:>10}{:>11}",
        figures.episodes,
        percent(figures.success),
        percent(figures.success_without_disturbance),
        percent(figures.success_without_disturbance_per_axis),
        percent(figures.picked_up),
        number(figures.length, 1),
        number(figures.disturbance_m, 3),
        number(figures.disturbed_objects, 2),
    )
}
