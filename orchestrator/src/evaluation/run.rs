use super::audience::EvaluationAudience;
use super::journal;
use super::text::lines;
use crate::output::format::counted;
use crate::output::terminal;
use crate::preflight::programs::Tools;
use crate::run::identity::{Ended, Identity, unix_now};
use crate::run::lock::RunLock;
use crate::supervisor::event::{Outcome, Saved, SessionEnd};
use crate::supervisor::session::{EXIT_INTERRUPTED, Session, begin_log, shape};
use anyhow::{Context, Result};
use proto::config::Config;
use proto::evaluation::{
    Conditions, Cost, Evaluation, EvaluationConfig, RESULT_FILE, Subject, TABLE_FILE, write_table,
};
use proto::run_folder::{RunFolder, write_atomically};
use proto::run_state::Ending;
use std::process::ExitCode;
use wire::fault;

pub struct EvaluationRun {
    pub folder: RunFolder,
    pub config: Config,
    pub asked: EvaluationConfig,
    pub json: bool,
    pub subject: Subject,
    pub identity: Identity,
    pub lock: RunLock,
    pub tools: Tools,
}

impl EvaluationRun {
    pub fn run(mut self) -> Result<ExitCode> {
        let plan = self.config.evaluation_plan().context("an evaluation has a plan")?;
        let mut audience = EvaluationAudience::new(self.config.spec(), plan, &self.folder)?;
        let (incarnation, address) = self.identity.begin_incarnation();
        self.identity.write(&self.folder)?;
        let session = Session {
            folder: &self.folder,
            config: &self.config,
            incarnation,
            address: &address,
            tools: &self.tools,
            launched: false,
        };
        let result = begin_log(&self.folder).and_then(|()| {
            tracing::info!(
                "evaluation {} in {}: {}, {}, seed {}",
                self.identity.id,
                self.folder.root().display(),
                counted(audience.asked() as u64, "episode"),
                shape(&self.config),
                self.config.seed
            );
            session.run(&mut self.lock, &mut audience, None, &mut None)
        });
        let reported = result.and_then(|(outcome, recording)| {
            let status = self.report(&outcome, &audience)?;
            recording.context("the recording is incomplete")?;
            Ok((outcome, status))
        });
        let (how, reason) = match &reported {
            Ok((outcome, _)) => (outcome.end.ending(), outcome.end.reason().map(str::to_owned)),
            Err(error) => (Ending::Failed, Some(format!("{error:#}"))),
        };
        let ended = Ended { how, at_unix_s: unix_now(), wall_s: None, frames: None, weights: None, reason };
        self.identity.end_incarnation(ended);
        self.identity.write(&self.folder)?;
        reported.map(|(_, status)| status)
    }

    fn report(&self, outcome: &Outcome, audience: &EvaluationAudience) -> Result<ExitCode> {
        match (&outcome.end, &outcome.saved) {
            (SessionEnd::Complete, Some(saved)) => {
                let evaluation = self.write(audience, saved)?;
                let path = format!("result: {}", self.folder.root().join(RESULT_FILE).display());
                if self.json {
                    terminal::note(&path);
                    terminal::out(json(&evaluation)?.trim_end());
                } else {
                    for line in lines(self.config.spec(), &evaluation, terminal::width()) {
                        terminal::out_wrapped(&line);
                    }
                    terminal::out(&path);
                }
                Ok(ExitCode::SUCCESS)
            }
            (end, _) => {
                let (played, asked) = (audience.played(), audience.asked());
                terminal::note(&format!(
                    "{} after {played} of {}: there is no result",
                    end.ending(),
                    counted(asked as u64, "episode")
                ));
                Ok(if *end == SessionEnd::Interrupted { ExitCode::from(EXIT_INTERRUPTED) } else { ExitCode::FAILURE })
            }
        }
    }

    /// Writes the table, then the result file: where that is, all is.
    fn write(&self, audience: &EvaluationAudience, saved: &Saved) -> Result<Evaluation> {
        let records = audience.records()?;
        let subject = Subject {
            frames: audience.frames,
            weights: saved.weights.clone(),
            parameters: audience.parameters,
            ..self.subject.clone()
        };
        let conditions = Conditions::of(&self.config, &self.asked, audience.device.clone());
        let steps = records.iter().map(|(record, _)| u64::from(record.length)).sum();
        let cost = Cost { at_unix_s: unix_now(), wall_s: audience.wall().as_secs_f64(), steps };
        let spec = self.config.spec();
        let evaluation = Evaluation::of(spec, subject, conditions, cost, &records);
        let table: Vec<_> = records.into_iter().map(|(record, _)| record).collect();
        let table = write_table(spec, &table, self.asked.distribution);
        for (name, text) in [(TABLE_FILE, table), (RESULT_FILE, json(&evaluation)?)] {
            fault::reach("evaluation.before_result");
            let path = self.folder.root().join(name);
            write_atomically(&path, text.as_bytes()).with_context(|| format!("cannot write {}", path.display()))?;
        }
        journal::remove(&self.folder);
        Ok(evaluation)
    }
}

fn json(evaluation: &Evaluation) -> Result<String> {
    let mut json = serde_json::to_string_pretty(evaluation).context(RESULT_FILE)?;
    json.push('\n');
    Ok(json)
}
