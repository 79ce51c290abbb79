//! The batch file for Slurm, with programs in the place of srun and scontrol that do what these do for it: two
//! orchestrators with Slurm's variables, the highest exit status of both, a note of what is to be queued again.

use rustix::process::Signal;
use std::process::{Child, Command};
use system_tests::{Printed, Run, Workshop, complete, finish, kill, signal, start};

const BATCH: &str = include_str!("../../../deploy/slurm/stillroom.sbatch");
const FRAMES: u64 = 1203;

/// Of an `--option=value` each before the program.
const SRUN: &str = r#"#!/bin/bash
while [[ $1 == --* ]]; do shift; done
export SLURM_NNODES=2 SLURM_STEP_NUM_NODES=2 SLURM_STEP_NODELIST=localhost,other SLURM_LOCALID=0
SLURM_NODEID=0 "$@" & nodes=$!
SLURM_NODEID=1 "$@" & nodes="$nodes $!"
highest=0
# A signal does not end it before its nodes.
trap : TERM
for node in $nodes; do
    while kill -0 "$node" 2>/dev/null; do wait "$node"; done
    wait "$node"; status=$?
    [ "$status" -le "$highest" ] || highest=$status
done
exit "$highest"
"#;
const SCONTROL: &str = "#!/bin/sh\necho \"$@\" >>queued\n";

/// A place in which jobs are run.
struct Cluster {
    workshop: Workshop,
    job: String,
}

impl Cluster {
    fn new() -> Self {
        let workshop = Workshop::new();
        std::fs::create_dir(workshop.path("bin")).expect("a writable folder");
        for (name, text) in [("bin/srun", SRUN), ("bin/scontrol", SCONTROL), ("batch", BATCH)] {
            workshop.script(name, text);
        }
        workshop.secret("token", "0123456789abcdef0123456789abcdef\n");
        // The port is made of it: those of tests that run at the same time differ.
        Self { workshop, job: std::process::id().to_string() }
    }

    /// A start of the job. `orchestrator`: what the batch file takes for it.
    fn batch(&self, orchestrator: &str) -> Command {
        let up = self.workshop.up("run", 4, 2, FRAMES);
        let mut batch = self.workshop.program(self.workshop.path("batch"));
        batch.args(up.get_args().skip(1)).args(["--learners", "2"]).env_remove("STILLROOM_TOKEN_FILE");
        let path = std::env::var("PATH").unwrap_or_default();
        batch.env("PATH", format!("{}:{path}", self.workshop.path("bin").display()));
        batch.env("SLURM_JOB_ID", &self.job).env("STILLROOM_ORCHESTRATOR", orchestrator);
        batch
    }

    fn start(&self) -> Child {
        let before = self.run().metrics().len();
        let child = start(self.batch(&program()));
        self.run().wait_for_rollouts(before + 3);
        child
    }

    fn run(&self) -> Run {
        self.workshop.run("run")
    }

    /// How often the job was queued again.
    fn queued(&self) -> usize {
        let text = std::fs::read_to_string(self.workshop.path("queued")).unwrap_or_default();
        text.lines().filter(|line| **line == format!("requeue {}", self.job)).count()
    }
}

fn program() -> String {
    system_tests::binary("orchestrator").display().to_string()
}

/// The orchestrator of the second node.
fn agent(run: &Run) -> u32 {
    let is_second = |pid: &u32| {
        let variables = std::fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        let program = std::fs::read_to_string(format!("/proc/{pid}/comm")).unwrap_or_default();
        program.trim() == "orchestrator" && variables.split(|byte| *byte == 0).any(|word| word == b"SLURM_NODEID=1")
    };
    *run.processes("--learners").iter().find(|pid| is_second(pid)).expect("the second node has an orchestrator")
}

fn assert_queued(printed: &Printed, why: &str) {
    assert!(printed.success && printed.stdout.contains(why), "{printed:#?}");
}

#[test]
fn a_job_is_queued_again_until_its_run_is_complete() {
    let cluster = Cluster::new();
    let run = cluster.run();

    let job = cluster.start();
    kill(agent(&run));
    assert_queued(&finish(job), "a host was lost: the job is queued again");
    run.wait_for_end();

    let job = cluster.start();
    signal(job.id(), Signal::USR1);
    assert_queued(&finish(job), "saved: the job is queued again");
    assert_eq!(cluster.queued(), 2);
    assert!(run.trained() < FRAMES, "both times in its middle");

    let last = complete(cluster.batch(&program()));
    assert!(last.success && !last.stdout.contains("queued again"), "{last:#?}");
    let alone = {
        let mut command = cluster.workshop.up("alone", 4, 2, FRAMES);
        command.args(["--learners", "2"]);
        complete(command).result()
    };
    assert!(last.stdout.contains(&format!("weights: {}\nframes: {}\n", alone.0, alone.1)), "{last:#?}");
    assert_eq!(cluster.queued(), 2);
    run.assert_nothing_left();
}

/// Slurm sends SIGTERM to every process of a job that it preempts, at the beginning of the grace time.
#[test]
fn a_job_that_is_preempted_is_saved_and_queued_again() {
    let cluster = Cluster::new();
    let job = cluster.start();
    let everyone = cluster.run().processes("");
    assert!(everyone.len() >= 2 + 2 + 4, "orchestrators, learners and actors: {everyone:?}");
    for process in everyone {
        signal(process, Signal::TERM);
    }
    assert_queued(&finish(job), "saved: the job is queued again");
    assert_eq!(cluster.queued(), 1);
    cluster.run().assert_nothing_left();
}

#[test]
fn a_job_that_saves_nothing_is_not_queued_for_ever() {
    let cluster = Cluster::new();
    let ends_with = |status: i32, first: &str| {
        let ends = cluster.workshop.script("ends", &format!("#!/bin/sh\n{first}\nexit {status}\n"));
        let orchestrator = ends.display().to_string();
        (complete(cluster.batch(&orchestrator)), cluster.queued())
    };
    for status in [7, 137, 1] {
        let (printed, queued) = ends_with(status, ":");
        assert_eq!((printed.status, queued), (Some(status), 0), "{printed:#?}");
    }
    let saves = "mkdir -p run/checkpoints && touch run/checkpoints/rollout-0000000";
    for (status, checkpoint, queued) in [(1, 1, 0), (7, 2, 1), (137, 3, 2), (7, 3, 2), (130, 4, 2)] {
        let (printed, all) = ends_with(status, &format!("{saves}{checkpoint}.json"));
        assert_eq!(all, queued, "status {status}, checkpoint {checkpoint}: {printed:#?}");
    }
}
