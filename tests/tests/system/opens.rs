//! A run in other programs: in Prometheus.

use system_tests::{Viewer, Workshop, finish, start, wait_until};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 2;

#[test]
fn prometheus_sees_a_run_and_its_end() {
    let workshop = Workshop::new();
    let child = start(workshop.up("runs/seen", ACTORS, ENVIRONMENTS, 600));
    workshop.run("runs/seen").wait_for_rollouts(2);
    let viewer = Viewer::start(&workshop, &["runs"]);
    let metrics = || String::from_utf8(viewer.get("/metrics").body).expect("text");
    wait_until("its processes are seen", || metrics().contains("process=\"learner-0\""));
    finish(child).result();
    wait_until("it has ended", || metrics().contains("stillroom_run_running{run=\"seen\"} 0\n"));
    let text = metrics();
    assert!(text.contains("stillroom_run_frames{run=\"seen\"} 600\n"), "{text}");
    assert!(text.contains("state=\"complete\",kind=\"training\"} 1\n"), "{text}");
    assert!(!text.contains("stillroom_process_up"), "{text}");
}
