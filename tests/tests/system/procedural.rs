//! Kitchens without end: environments go from kitchen to kitchen, and whatever happens on the way, it is the same run.

use mcap::MessageStream;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;
use system_tests::{Run, TINY, Workshop, complete, kill_child, start};

const FRAMES: u64 = 900;
/// Six kitchens, and another one after every second episode: each environment sees several.
const KITCHENS: &str = "\n[kitchens]\nsource = \"procedural\"\ncount = 6\nepisodes_each = 2\n";

fn workshop() -> Workshop {
    let workshop = Workshop::new();
    std::fs::write(workshop.path("tiny.toml"), format!("{TINY}{KITCHENS}")).expect("a writable temporary folder");
    workshop
}

fn up(workshop: &Workshop, name: &str) -> Command {
    workshop.up(name, 2, 2, FRAMES)
}

/// Of every environment the kitchens of its recorded episodes, by the episode's number.
fn kitchens_played(run: &Run) -> BTreeMap<u64, BTreeMap<u64, u64>> {
    let mut played: BTreeMap<u64, BTreeMap<u64, u64>> = BTreeMap::new();
    for path in run.recordings() {
        let bytes = std::fs::read(&path).expect("a readable recording");
        for message in MessageStream::new(&bytes).expect("an MCAP file") {
            let message = message.expect("a whole message");
            if message.channel.topic == "/episode/start" {
                // Varint fields 1 to 3 of the message: kitchen, environment, episode; zeros are left out.
                let fields = varints(&message.data);
                let of = |field| fields.get(&field).copied().unwrap_or(0);
                played.entry(of(2)).or_default().insert(of(3), of(1));
            }
        }
    }
    played
}

/// The first varint fields of a protobuf message, up to one of another kind.
fn varints(data: &[u8]) -> BTreeMap<u64, u64> {
    let mut bytes = data.iter();
    let mut varint = || {
        let (mut value, mut shift) = (0, 0);
        loop {
            let byte = *bytes.next()?;
            value |= u64::from(byte & 0x7f) << shift;
            shift += 7;
            if byte < 0x80 {
                return Some(value);
            }
        }
    };
    let mut fields = BTreeMap::new();
    while let Some(tag) = varint().filter(|tag| tag.trailing_zeros() >= 3) {
        let Some(value) = varint() else { break };
        fields.insert(tag >> 3, value);
    }
    fields
}

#[test]
fn killed_and_resumed_it_is_the_same_run_in_the_same_kitchens() {
    let workshop = workshop();
    let undisturbed = complete(up(&workshop, "undisturbed")).result();
    assert_eq!(undisturbed.1, FRAMES);
    let run = workshop.run("undisturbed");
    let kitchens = kitchens_played(&run);
    assert_eq!(kitchens.keys().copied().collect::<Vec<_>>(), [0, 1, 2, 3]);
    let all: BTreeSet<u64> = kitchens.values().flat_map(BTreeMap::values).copied().collect();
    assert!(all.iter().all(|kitchen| (1000..1006).contains(kitchen)) && all.len() > 2, "{all:?}");
    for (environment, episodes) in &kitchens {
        // Two episodes each: the rule is a test of its own.
        assert!(episodes.keys().copied().eq(0..episodes.len() as u64), "{environment}: {episodes:?}");
        assert!(episodes.iter().all(|(episode, kitchen)| episodes[&(episode / 2 * 2)] == *kitchen), "{episodes:?}");
    }
    let kept = || std::fs::read_dir(run.folder.kitchens()).unwrap().count();
    assert!(kept() >= all.len(), "kitchens are kept in the run's folder");
    let replay = complete(workshop.orchestrator(&["replay", "--check", "undisturbed"]));
    assert!(replay.success && replay.stdout.contains("differences: 0"), "{replay:#?}");
    // One kitchen's episodes can be called for.
    let one = all.first().unwrap().to_string();
    let replay = complete(workshop.orchestrator(&["replay", "--check", "undisturbed", "--kitchen", &one]));
    assert!(replay.success && replay.stdout.contains("differences: 0"), "{replay:#?}");

    // Actors die, then the orchestrator; then what was kept of one kitchen is damaged, and of another lost.
    let child = start(up(&workshop, "killed"));
    let run = workshop.run("killed");
    for rollouts in [2, 5] {
        run.wait_for_rollouts(rollouts);
        run.kill_one("--actor ");
    }
    run.wait_for_rollouts(8);
    kill_child(child);
    run.wait_for_end();
    let mut files: Vec<_> =
        std::fs::read_dir(run.folder.kitchens()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|end| end == "kitchen"));
    files.sort();
    let whole = std::fs::read(&files[0]).unwrap();
    std::fs::write(&files[0], &whole[..whole.len() - 9]).unwrap();
    std::fs::remove_file(&files[1]).unwrap();
    assert_eq!(complete(workshop.resume("killed")).result(), undisturbed);
    run.assert_nothing_left();
    assert_eq!(kitchens_played(&run), kitchens);
    let replay = complete(workshop.orchestrator(&["replay", "--check", "killed"]));
    assert!(replay.success && replay.stdout.contains("differences: 0"), "{replay:#?}");
}

#[test]
fn kitchens_never_seen_are_evaluated_alike_whoever_dies() {
    let workshop = workshop();
    let evaluate = |out: &str| {
        let mut command = workshop.orchestrator(&["eval", "--preset", "demo", "--config", "tiny.toml", "--seed", "5"]);
        command.args(["--kitchens", "procedural:5000..5003", "--objects", "all", "--episodes", "6"]);
        command.args(["--actors", "2", "--environments", "2", "--record", "all", "--out", out]);
        command
    };
    let table = |out: &str| std::fs::read_to_string(workshop.path(out).join("episodes.csv")).expect("a table");
    let printed = complete(evaluate("first"));
    assert!(printed.success, "{printed:#?}");
    assert!(printed.stderr.contains("3 procedural kitchens (5000..5003)"), "{printed:#?}");
    let records = proto::evaluation::read_table(proto::config::Config::default().spec(), &table("first")).unwrap();
    let mut kitchens: BTreeMap<u32, u32> = BTreeMap::new();
    for record in &records {
        *kitchens.entry(record.kitchen.number()).or_default() += 1;
    }
    assert_eq!(kitchens, BTreeMap::from([(5000, 12), (5001, 12), (5002, 12)]));
    let result = std::fs::read_to_string(workshop.path("first").join("evaluation.json")).expect("a result file");
    let result: serde_json::Value = serde_json::from_str(&result).expect("JSON");
    assert_eq!(result["conditions"]["procedural"], "5000..5003");
    assert_eq!(result["kitchens"].as_array().map(Vec::len), Some(3));
    let replay = complete(workshop.orchestrator(&["replay", "--check", "first"]));
    assert!(replay.success && replay.stdout.contains("differences: 0"), "{replay:#?}");

    // Every actor dies once.
    let mut command = evaluate("actors");
    command.env("STILLROOM_FAULT", "actor.before_send:31");
    let printed = complete(command);
    assert!(printed.success && printed.deaths().len() == 2, "{printed:#?}");
    assert_eq!(table("actors"), table("first"));
}
