//! `ppo.overlap`: updates run while the next rollout is collected. `kills.rs` has deaths of such a learner.

use system_tests::{Workshop, complete};

/// A workshop whose runs overlap. `tables`: more of their configuration.
pub fn workshop(tables: &str) -> Workshop {
    let workshop = Workshop::new();
    workshop.configure(("[ppo]\n", "[ppo]\noverlap = true\n"), tables);
    workshop
}

#[test]
fn a_learner_that_hangs_is_killed_and_one_that_updates_and_collects_is_not() {
    let workshop = workshop("");
    let up = |name| {
        let mut command = workshop.up(name, 2, 3, 700);
        // Or it might hang in a checkpoint, as it might at the end of a stage.
        for setting in ["learner.progress_deadline_s=3.0", "checkpoint.interval_s=600.0"] {
            command.args(["--set", setting]);
        }
        command
    };
    let undisturbed = complete(up("undisturbed"));
    assert_eq!(undisturbed.deaths(), Vec::<&str>::new());

    // In the middle of rollout 4, beside update 3.
    let mut command = up("hung");
    command.env("STILLROOM_FAULT", "hold=learner.mid_rollout:45@learner");
    let printed = complete(command);
    assert_eq!(printed.result(), undisturbed.result());
    for part in ["learner-0 has finished no rollout or update for", "learner-0 died: killed by the orchestrator"] {
        assert!(printed.stderr.contains(part), "{part}: {printed:#?}");
    }
    assert_eq!(printed.deaths().len(), 1, "{printed:#?}");
    workshop.run("hung").assert_nothing_left();
}
