//! The fault points of the sources: where each can be reached, and how often at least in a short run.

use crate::draw::Draw;

/// A fault point, in the program that passes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Point {
    /// Its name in the sources.
    pub name: &'static str,
    pub program: &'static str,
    /// A start of a run passes it this often at least, if there is as much left to train.
    pub passes: u64,
}

const fn point(program: &'static str, name: &'static str, passes: u64) -> Point {
    Point { name, program, passes }
}

/// What every run that trains passes.
pub const TRAINING: &[Point] = &[
    // Three times a half-step, and once more for each piece of an episode that is prepared.
    point("actor", "actor.before_receive", 120),
    point("actor", "actor.mid_receive", 120),
    point("actor", "actor.after_hello", 1),
    point("actor", "actor.before_rebuild", 1),
    point("actor", "actor.after_rebuild", 1),
    point("actor", "actor.after_receive", 40),
    point("actor", "actor.before_send", 40),
    point("actor", "actor.before_loan", 40),
    point("actor", "actor.after_loan", 40),
    point("actor", "actor.after_write", 40),
    point("actor", "actor.before_bell", 40),
    point("actor", "actor.after_send", 40),
    point("learner", "learner.before_receive", 40),
    point("learner", "learner.after_receive", 40),
    point("learner", "learner.before_restore", 2),
    point("learner", "learner.after_restore", 2),
    point("learner", "learner.before_loan", 40),
    point("learner", "learner.after_loan", 40),
    point("learner", "learner.after_send", 40),
    point("learner", "learner.after_announcement", 6),
    point("learner", "learner.mid_rollout", 20),
    point("learner", "learner.before_update", 6),
    point("learner", "learner.before_exchange", 6),
    point("learner", "learner.after_update", 6),
    point("learner", "learner.before_trained_told", 6),
    point("learner", "learner.before_checkpoint", 6),
    point("learner", "learner.after_tensors", 6),
    point("learner", "learner.after_sync", 6),
    point("learner", "learner.after_figures", 6),
    point("learner", "learner.after_manifest", 6),
    point("learner", "learner.after_pin", 6),
    point("learner", "learner.after_prune", 6),
    point("learner", "learner.before_checkpoint_told", 6),
    point("learner", "file.before_write", 12),
    point("learner", "file.before_fsync", 12),
    point("learner", "file.before_rename", 12),
    point("learner", "file.after_rename", 12),
    point("learner", "learner.before_finished", 1),
    point("learner", "learner.after_finished", 1),
    point("orchestrator", "orchestrator.after_lock", 1),
    point("orchestrator", "orchestrator.after_wire", 1),
    point("orchestrator", "orchestrator.before_spawn", 1),
    point("orchestrator", "orchestrator.after_spawn", 2),
    point("orchestrator", "orchestrator.before_announce", 6),
    point("orchestrator", "orchestrator.after_announce", 6),
    point("orchestrator", "orchestrator.stage_switch", 1),
    point("orchestrator", "orchestrator.before_recorder_finish", 1),
    point("orchestrator", "orchestrator.before_summary", 1),
    point("orchestrator", "orchestrator.after_summary", 1),
    point("orchestrator", "recorder.after_receive", 60),
    point("orchestrator", "recorder.before_chunk", 2),
    point("orchestrator", "recorder.after_chunk", 2),
    point("orchestrator", "recorder.before_fsync", 1),
    point("orchestrator", "recorder.after_fsync", 1),
    point("orchestrator", "metrics.before_line", 6),
    point("orchestrator", "metrics.after_line", 6),
    point("orchestrator", "file.before_write", 2),
    point("orchestrator", "file.before_fsync", 2),
    point("orchestrator", "file.before_rename", 2),
    point("orchestrator", "file.after_rename", 2),
];

/// What only the first start passes, while it makes the folder.
pub const CREATION: &[Point] = &[
    point("orchestrator", "create.after_folder", 4),
    point("orchestrator", "create.after_lock", 1),
    point("orchestrator", "create.before_config", 1),
    point("orchestrator", "create.before_identity", 1),
    point("orchestrator", "create.after_identity", 1),
];

/// What only a run that validates passes.
pub const VALIDATION: &[Point] = &[
    point("orchestrator", "validation.before_pin", 2),
    point("learner", "validation.before_link", 4),
    point("orchestrator", "validation.after_start", 2),
    point("orchestrator", "validation.before_line", 1),
    point("orchestrator", "validation.after_line", 1),
    point("orchestrator", "validation.before_crown", 1),
    point("orchestrator", "validation.after_crown", 1),
];

/// What an evaluation passes.
pub const EVALUATION: &[Point] = &[
    point("actor", "actor.after_rebuild", 1),
    point("actor", "actor.before_loan", 20),
    point("actor", "actor.before_bell", 20),
    point("learner", "learner.mid_evaluation", 3),
    point("learner", "learner.after_send", 20),
    point("orchestrator", "evaluation.before_record", 3),
    point("orchestrator", "evaluation.before_result", 2),
];

/// What a suite passes; the points of its runs are armed in all of them.
pub const SUITE: &[Point] = &[
    point("orchestrator", "suite.before_file", 2),
    point("orchestrator", "suite.before_process", 3),
    point("orchestrator", "suite.after_process", 3),
    point("orchestrator", "report.before_page", 1),
    point("learner", "learner.before_update", 6),
    point("learner", "learner.mid_evaluation", 3),
    point("actor", "actor.after_write", 20),
];

impl Point {
    /// One of these, and which of its passes is the fatal one.
    pub fn draw(points: &[&[Self]], draw: &mut Draw) -> (Self, u64) {
        let all: Vec<Self> = points.concat();
        let point = draw.of(&all);
        (point, draw.within(1..=point.passes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::path::Path;

    /// Points that tests of their own arm: they are passed only where a complete run's budget changes, and where a suite
    /// clears an evaluation that was cut off.
    const ELSEWHERE: [&str; 4] =
        ["resume.before_budget", "resume.amid_budget", "resume.after_budget", "cut_off.after_entry"];

    fn points_under(folder: &Path, found: &mut BTreeSet<String>) {
        for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            if entry.is_dir() {
                points_under(&entry, found);
            } else if entry.extension().is_some_and(|extension| extension == "rs") {
                let text = std::fs::read_to_string(&entry).unwrap();
                let calls = text.split("fault::reach(\"").skip(1);
                found.extend(calls.filter_map(|call| Some(call.split_once('"')?.0.to_owned())));
            }
        }
    }

    #[test]
    fn the_list_holds_every_point_of_the_sources() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let mut found = BTreeSet::new();
        for source in [
            "proto/src",
            "proto/wire/src",
            "actor/engine/src",
            "actor/src",
            "learner/src",
            "orchestrator/src",
            "orchestrator/recording/src",
        ] {
            points_under(&root.join(source), &mut found);
        }
        let lists = [TRAINING, CREATION, VALIDATION, EVALUATION, SUITE].concat();
        let listed: BTreeSet<String> =
            lists.iter().map(|point| point.name).chain(ELSEWHERE).map(str::to_owned).collect();
        assert!(found.len() > 60, "{found:?}");
        assert_eq!(found, listed);
    }
}
