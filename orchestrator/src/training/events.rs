use super::means::recent;
use super::scores::Score;
use super::summary::Summary;
use crate::output::events::tell;
use crate::run::identity::Identity;
use crate::supervisor::event::SessionEnd;
use proto::config::{Config, StageConfig};
use proto::event::LearnerEvent;
use proto::run_folder::RunFolder;
use proto::stage::total_frames;
use proto::trained::History;
use serde_json::{Value, json};

pub fn started(folder: &RunFolder, config: &Config, identity: &Identity, start: u32) {
    tell("started", || {
        json!({
            "run": identity.id,
            "folder": folder.root().display().to_string(),
            "start": start,
            "preset": config.preset,
            "seed": config.seed,
            "actors": config.actors.count,
            "environments_per_actor": config.actors.environments_per_actor,
            "learners": config.learner.count,
            "budget": total_frames(&config.stages),
            "stages": config.stages,
        })
    });
}

/// A learner reports. `history`: the report's rollout included.
pub fn learner(event: &LearnerEvent, stages: &[StageConfig], history: &History) {
    match event {
        LearnerEvent::Ready { rollout, frames, device, parameters, checkpoint, .. } => tell("learner_ready", || {
            json!({ "rollout": rollout, "frames": frames, "device": device, "parameters": parameters,
                    "checkpoint": checkpoint })
        }),
        LearnerEvent::RolloutTrained { rollout, frames, stage, timing, metrics, .. } => tell("rollout", || {
            let recent = recent(stages, history, false);
            json!({
                "rollout": rollout,
                "frames": frames,
                "budget": recent.budget,
                "stage": stages.get(*stage as usize).map(|stage| &stage.name),
                "frames_per_s": recent.frames_per_s,
                "left_s": recent.left_s,
                "timing": timing,
                "metrics": metrics,
            })
        }),
        LearnerEvent::CheckpointWritten { path, rollout, frames, .. } => {
            tell("checkpoint", || json!({ "rollout": rollout, "frames": frames, "path": path }));
        }
        LearnerEvent::WaitingForActor { actor, waited_s, .. } => {
            tell("waiting", || json!({ "process": format!("actor-{actor:02}"), "waited_s": waited_s }));
        }
        LearnerEvent::WaitingForRecorder { waited_s, .. } => {
            tell("waiting", || json!({ "process": "recorder", "waited_s": waited_s }));
        }
        LearnerEvent::ActorsConnected { .. }
        | LearnerEvent::RolloutCollected { .. }
        | LearnerEvent::CheckpointBegun { .. }
        | LearnerEvent::EpisodePlayed { .. }
        | LearnerEvent::Finished { .. } => {}
    }
}

pub fn scaled(before: u32, actors: u32) {
    tell("scaled", || json!({ "before": before, "actors": actors }));
}

pub fn validated(score: &Score) {
    tell("validation", || {
        let mut fields = serde_json::to_value(score).unwrap_or_default();
        // The event has a time of its own.
        if let Some(fields) = fields.as_object_mut() {
            fields.remove("at_unix_s");
        }
        fields
    });
}

pub fn ended(folder: &RunFolder, run: &str, end: &SessionEnd, summary: Option<&Summary>) {
    tell_end(folder, run, &end.ending().to_string(), end.reason(), summary);
}

pub fn failed(folder: &RunFolder, run: &str, reason: &str) {
    tell_end(folder, run, "failed", Some(reason), None);
}

fn tell_end(folder: &RunFolder, run: &str, how: &str, reason: Option<&str>, summary: Option<&Summary>) {
    tell("ended", || {
        let summary: Value = summary.and_then(|summary| serde_json::to_value(summary).ok()).unwrap_or_default();
        json!({ "run": run, "folder": folder.root().display().to_string(), "how": how, "reason": reason, "summary": summary })
    });
}
