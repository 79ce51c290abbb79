//! A run in other programs: live to Foxglove's protocol, and to Prometheus.

use prost_reflect::{DescriptorPool, DynamicMessage, MessageDescriptor};
use rustix::process::Signal;
use std::collections::BTreeMap;
use system_tests::{Foxglove, Recording, Viewer, Workshop, complete, finish, signal, start, wait_until};

const ACTORS: u32 = 2;
const ENVIRONMENTS: u32 = 2;
const FRAMES: u64 = 1200;
/// The learner waits in its third update until it is let go: nothing depends on how fast the run is.
const HOLD: &str = "hold=learner.before_update:3@learner";

/// What a channel's messages are, by the schema that it is offered with.
fn descriptor(foxglove: &mut Foxglove, topic: &str) -> MessageDescriptor {
    let channel = foxglove.subscribe(topic);
    let pool = DescriptorPool::decode(channel.schema.as_slice()).expect("a set of descriptors");
    pool.get_message_by_name(&channel.schema_name).unwrap_or_else(|| panic!("{topic}: no {}", channel.schema_name))
}

/// A message by its schema; nothing of it is left over.
fn decode(descriptor: &MessageDescriptor, data: &[u8]) -> DynamicMessage {
    let message = DynamicMessage::decode(descriptor.clone(), data).expect("a message of its schema");
    assert_eq!(message.unknown_fields().count(), 0, "{}", descriptor.full_name());
    message
}

fn number(message: &DynamicMessage, field: &str) -> u64 {
    let value = message.get_field_by_name(field).unwrap_or_else(|| panic!("no {field}"));
    value.as_u32().map(u64::from).or(value.as_u64()).expect("a whole number")
}

fn list_length(message: &DynamicMessage, field: &str) -> usize {
    message.get_field_by_name(field).and_then(|value| value.as_list().map(<[_]>::len)).expect("a list")
}

#[test]
fn a_run_is_live_in_foxglove_with_the_topics_of_its_recordings() {
    let workshop = Workshop::new();
    let alone = complete(workshop.up("alone", ACTORS, ENVIRONMENTS, FRAMES)).result();
    std::fs::create_dir(workshop.path("runs")).expect("a folder");
    let viewer = Viewer::start(&workshop, &[]);
    let mut command = workshop.up("runs/live", ACTORS, ENVIRONMENTS, FRAMES);
    command.env("STILLROOM_FAULT", HOLD);
    let child = start(command);
    let run = workshop.run("runs/live");
    let learner = run.wait_until_held("--rank 0 ");
    wait_until("it is in the list", || viewer.json("/api/runs").as_array().is_some_and(|runs| !runs.is_empty()));
    let mut foxglove = Foxglove::connect(&viewer.address, "/foxglove/live", &viewer.token).expect("a WebSocket");
    let topics =
        ["/step", "/learner/metrics", "/watch/scene", "/watch/tf", "/watch/depth/image", "/watch/depth/points"];
    let kinds: BTreeMap<&str, MessageDescriptor> =
        topics.into_iter().map(|topic| (topic, descriptor(&mut foxglove, topic))).collect();
    assert_eq!(foxglove.name, "Stillroom: live");
    let (mut steps, mut newest, mut seen) = (0, 0, BTreeMap::<String, DynamicMessage>::new());
    // What is recorded before a subscription is not told.
    foxglove.settle();
    signal(learner, Signal::CONT);
    while seen.len() < topics.len() || steps < 50 {
        let (topic, at_ns, data) = foxglove.message();
        let message = decode(&kinds[topic.as_str()], &data);
        if topic == "/step" {
            assert!(at_ns >= newest, "in the order of time");
            newest = at_ns;
            steps += 1;
            assert!(number(&message, "step") < 24 && number(&message, "environment") < 2);
        }
        seen.entry(topic).or_insert(message);
    }
    // The first scene has the whole room, the robot, and the goal.
    let scene = &seen["/watch/scene"];
    assert!(list_length(scene, "entities") > 50 && list_length(scene, "deletions") == 1);
    let text = format!("{scene:?}");
    for id in ["robot/0", "goal", "Floor", "watch/world"] {
        assert!(text.contains(id), "{id}");
    }
    assert_eq!(number(&seen["/watch/depth/image"], "width"), 224);
    assert_eq!(list_length(&seen["/watch/tf"], "transforms"), 5);
    assert!(
        seen["/watch/depth/points"]
            .get_field_by_name("data")
            .is_some_and(|data| data.as_bytes().is_some_and(|data| data.len() > 12_000))
    );
    assert_eq!(finish(child).result(), alone, "whoever looks, the weights are the same");
    assert!(Recording::of(&run).messages() >= FRAMES);
    drop(foxglove);

    // One that ended is shown, too; `/foxglove` means the newest. Who has no token is not answered.
    let mut foxglove = Foxglove::connect(&viewer.address, "/foxglove?watch=1-1", &viewer.token).expect("a WebSocket");
    let kind = descriptor(&mut foxglove, "/watch/scene");
    assert!(list_length(&decode(&kind, &foxglove.message().2), "entities") > 50);
    let refused = |path: &str, token: &str| Foxglove::connect(&viewer.address, path, token).err();
    assert_eq!(refused("/foxglove/none", &viewer.token), Some(404));
    assert_eq!(refused("/foxglove?watch=kitchen", &viewer.token), Some(400));
    assert_eq!(refused("/foxglove", ""), Some(401));
    assert_eq!(viewer.get("/foxglove").status, 400, "no WebSocket was asked for");
}

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
