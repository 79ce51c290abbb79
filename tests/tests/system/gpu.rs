//! The same seed ends in the same weights on GPUs, too, whatever happens on the way. These tests need CUDA devices, as
//! many as a run has learners: `cargo nextest run --release --workspace --run-ignored only same_weights_on`.

use system_tests::{Workshop, complete, finish, kill, kill_child, start};

/// Both stages of the curriculum, with the resnet in bfloat16.
fn up(workshop: &Workshop, name: &str, learners: u32, overlap: bool) -> std::process::Command {
    let frames = (200_000 * u64::from(learners)).to_string();
    let (actors, learners, overlap) =
        ((19 * learners).to_string(), learners.to_string(), format!("ppo.overlap={overlap}"));
    let up = ["up", "--preset", "short-two-stage", "--device", "cuda", "--seed", "3", "--run", name];
    let size = ["--learners", &learners, "--actors", &actors, "--frames", &frames];
    // A checkpoint after every rollout: a killed learner has a boundary to go back to.
    let often = ["--set", "checkpoint.interval_s=0", "--set", "validation.every_frames=0"];
    workshop.orchestrator(&[&up[..], &size, &often, &["--set", &overlap]].concat())
}

/// One run as it is, one whose learner and an actor are killed, one whose orchestrator is killed: one result.
fn killed_or_not(learners: u32, overlap: bool) {
    let workshop = Workshop::new();
    let undisturbed = complete(up(&workshop, "undisturbed", learners, overlap)).result();
    assert_eq!(undisturbed.1, 200_000 * u64::from(learners));

    let child = start(up(&workshop, "learner", learners, overlap));
    let run = workshop.run("learner");
    run.wait_for_rollouts(5);
    kill(run.learner());
    run.wait_for_rollouts(8);
    run.kill_one("--actor ");
    let printed = finish(child);
    assert_eq!(printed.result(), undisturbed);
    assert!(printed.deaths().len() >= 2, "both kills are told: {printed:#?}");

    let child = start(up(&workshop, "orchestrator", learners, overlap));
    workshop.run("orchestrator").wait_for_rollouts(6);
    kill_child(child);
    assert_eq!(complete(workshop.resume("orchestrator")).result(), undisturbed);
}

#[test]
#[ignore = "needs a CUDA device"]
fn same_weights_on_one_gpu() {
    killed_or_not(1, false);
}

#[test]
#[ignore = "needs two CUDA devices"]
fn same_weights_on_two_gpus() {
    killed_or_not(2, false);
}

/// With updates beside the collecting of the next rollout.
#[test]
#[ignore = "needs a CUDA device"]
fn same_weights_on_one_gpu_with_overlap() {
    killed_or_not(1, true);
}

#[test]
#[ignore = "needs two CUDA devices"]
fn same_weights_on_two_gpus_with_overlap() {
    killed_or_not(2, true);
}
