//! The same seed ends in the same weights on GPUs, too, whatever happens on the way. These tests need CUDA devices, as
//! many as a run has learners: `cargo nextest run --release --workspace --run-ignored only same_weights_on`.

use system_tests::{Printed, Workshop, complete, finish, kill_child, start};

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

/// Both stages of the curriculum, with the resnet in bfloat16, and a checkpoint after every rollout, so that a killed
/// learner has a boundary to go back to.
fn configured(shape: Shape) -> Vec<String> {
    let Shape { learners, overlap, environments, frames } = shape;
    let [frames, actors, learners] = [frames, 19 * u64::from(learners), u64::from(learners)].map(|n| n.to_string());
    let flags = ["--preset", "short-two-stage", "--seed", "3", "--frames", &frames];
    let size = ["--learners", &learners, "--actors", &actors];
    let each = format!("actors.environments_per_actor={environments}");
    let overlap = format!("ppo.overlap={overlap}");
    let keys = [&each, &overlap, "learner.device=cuda", "checkpoint.interval_s=0", "validation.every_frames=0"];
    let keys = keys.iter().flat_map(|key| ["--set", key]);
    flags.into_iter().chain(size).chain(keys).map(str::to_owned).collect()
}

/// A command that is given all that.
fn given(workshop: &Workshop, command: &[&str], shape: Shape) -> std::process::Command {
    let configured = configured(shape);
    let words: Vec<&str> = command.iter().copied().chain(configured.iter().map(String::as_str)).collect();
    workshop.orchestrator(&words)
}

fn up(workshop: &Workshop, name: &str, shape: Shape) -> std::process::Command {
    given(workshop, &["up", "--run", name], shape)
}

/// One run as it is, one of which a learner and an actor are killed, one whose orchestrator is killed: one result.
fn killed_or_not(shape: Shape) {
    let workshop = Workshop::new();
    let printed = complete(up(&workshop, "undisturbed", shape));
    assert_eq!(told(&printed), [0; 3], "{printed:#?}");
    let undisturbed = printed.result();
    assert_eq!(undisturbed.1, shape.frames);

    let child = start(up(&workshop, "learner", shape));
    let run = workshop.run("learner");
    run.wait_for_rollouts(5);
    run.kill_one("--rank");
    run.wait_for_rollouts(8);
    run.kill_one("--actor ");
    let printed = finish(child);
    assert_eq!(printed.result(), undisturbed);
    assert!(printed.deaths().len() >= 2, "both kills are told: {printed:#?}");
    assert_eq!(told(&printed), [0; 3], "also what a new actor writes is read in place: {printed:#?}");

    let child = start(up(&workshop, "orchestrator", shape));
    workshop.run("orchestrator").wait_for_rollouts(6);
    kill_child(child);
    assert_eq!(complete(workshop.resume("orchestrator")).result(), undisturbed);
}

/// The others are seldom run: what they ask for must not grow old meanwhile.
#[test]
fn what_the_gpu_tests_configure_is_understood_anywhere() {
    let workshop = Workshop::new();
    for shape in [ONE_LEARNER, TWO_LEARNERS] {
        let printed = complete(given(&workshop, &["config"], shape));
        let has = |line: &str| printed.stdout.lines().any(|printed| printed == line);
        assert!(has("device = \"cuda\"") && has(&format!("count = {}", 19 * shape.learners)), "{printed:#?}");
    }
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

/// How often learners told that they act or train without a graph, or copy frames.
fn told(printed: &Printed) -> [usize; 3] {
    [
        "acting launches its kernels one by one, which takes longer: ",
        "training launches its kernels one by one, which takes longer: ",
        "acting copies frames for the GPU, which takes longer, as it cannot read them where they are: ",
    ]
    .map(|line| printed.stderr.matches(line).count())
}

/// The driver may refuse to record what is launched: then every kernel is launched by itself, here in acting from the first
/// step on and in training from the first recording, or in acting alone. And it may refuse to register shared memory, here
/// that of one actor: then all frames of a batch are copied.
#[test]
#[ignore = "needs a CUDA device"]
fn same_weights_on_one_gpu_where_the_driver_refuses() {
    let workshop = Workshop::new();
    let shape = Shape { frames: 100_000, ..ONE_LEARNER };
    let usual = complete(up(&workshop, "usual", shape));
    assert_eq!(told(&usual), [0; 3], "{usual:#?}");
    for (name, refused, lines) in [
        ("acting", "recording:1", [1, 0, 0]),
        ("both", "recording:1 recording:2", [1, 1, 0]),
        ("memory", "host_memory", [0, 0, 1]),
        ("all", "recording:1 recording:2 host_memory", [1, 1, 1]),
    ] {
        let points = refused.split(' ').map(|point| format!("fail=learner.{point}@learner"));
        let mut command = up(&workshop, name, shape);
        command.env("STILLROOM_FAULT", points.collect::<Vec<_>>().join(","));
        let printed = complete(command);
        assert_eq!(printed.result(), usual.result());
        assert_eq!(told(&printed), lines, "{printed:#?}");
        assert_eq!(printed.stderr.matches("cuMemHostRegister: CUDA error 1").count(), lines[2], "{printed:#?}");
        assert!(printed.deaths().is_empty() && !printed.stderr.contains("panicked"), "{printed:#?}");
    }
}
