//! The same seed ends in the same weights on GPUs, too, whatever happens on the way. These tests need CUDA devices, as
//! many as a run has learners: `cargo nextest run --release --workspace --run-ignored only same_weights_on`.

use system_tests::{Workshop, complete, finish, kill, kill_child, start};

/// What is run.
#[derive(Clone, Copy)]
struct Shape {
    learners: u32,
    overlap: bool,
    /// Of an actor. With one, whoever is ready acts; with more, actors go in lockstep.
    environments: u32,
    frames: u64,
}

const ONE_LEARNER: Shape = Shape { learners: 1, overlap: false, environments: 16, frames: 200_000 };
const TWO_LEARNERS: Shape = Shape { learners: 2, frames: 400_000, ..ONE_LEARNER };

/// Both stages of the curriculum, with the resnet in bfloat16.
fn up(workshop: &Workshop, name: &str, shape: Shape) -> std::process::Command {
    let Shape { learners, overlap, environments, frames } = shape;
    let [frames, actors, learners] = [frames, 19 * u64::from(learners), u64::from(learners)].map(|n| n.to_string());
    let each = format!("actors.environments_per_actor={environments}");
    let overlap = format!("ppo.overlap={overlap}");
    let up = ["up", "--preset", "short-two-stage", "--device", "cuda", "--seed", "3", "--run", name];
    let size = ["--learners", &learners, "--actors", &actors, "--frames", &frames, "--set", &each];
    // A checkpoint after every rollout: a killed learner has a boundary to go back to.
    let often = ["--set", "checkpoint.interval_s=0", "--set", "validation.every_frames=0"];
    workshop.orchestrator(&[&up[..], &size, &often, &["--set", &overlap]].concat())
}

/// One run as it is, one whose learner and an actor are killed, one whose orchestrator is killed: one result.
fn killed_or_not(shape: Shape) {
    let workshop = Workshop::new();
    let undisturbed = complete(up(&workshop, "undisturbed", shape)).result();
    assert_eq!(undisturbed.1, shape.frames);

    let child = start(up(&workshop, "learner", shape));
    let run = workshop.run("learner");
    run.wait_for_rollouts(5);
    kill(run.learner());
    run.wait_for_rollouts(8);
    run.kill_one("--actor ");
    let printed = finish(child);
    assert_eq!(printed.result(), undisturbed);
    assert!(printed.deaths().len() >= 2, "both kills are told: {printed:#?}");

    let child = start(up(&workshop, "orchestrator", shape));
    workshop.run("orchestrator").wait_for_rollouts(6);
    kill_child(child);
    assert_eq!(complete(workshop.resume("orchestrator")).result(), undisturbed);
}

#[test]
#[ignore = "needs a CUDA device"]
fn same_weights_on_one_gpu() {
    killed_or_not(ONE_LEARNER);
}

#[test]
#[ignore = "needs two CUDA devices"]
fn same_weights_on_two_gpus() {
    killed_or_not(TWO_LEARNERS);
}

/// With updates beside the collecting of the next rollout.
#[test]
#[ignore = "needs a CUDA device"]
fn same_weights_on_one_gpu_with_overlap() {
    killed_or_not(Shape { overlap: true, ..ONE_LEARNER });
}

#[test]
#[ignore = "needs two CUDA devices"]
fn same_weights_on_two_gpus_with_overlap() {
    killed_or_not(Shape { overlap: true, ..TWO_LEARNERS });
}

/// Whoever is ready acts, and is recorded.
#[test]
#[ignore = "needs a CUDA device"]
fn same_weights_on_one_gpu_whoever_is_ready() {
    killed_or_not(Shape { overlap: true, environments: 1, frames: 20_000, ..ONE_LEARNER });
}
