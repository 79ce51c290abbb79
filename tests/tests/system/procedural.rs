//! Kitchens without end: environments go from kitchen to kitchen, and whatever happens on the way, it is the same run.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;
use system_tests::{Recording, Run, Workshop, complete, kill_child, start};

const FRAMES: u64 = 900;
/// Six kitchens, and another one after every second episode: each environment sees several.
const KITCHENS: &str = "\n[kitchens]\nsource = \"procedural\"\ncount = 6\nepisodes_each = 2\n";

fn workshop() -> Workshop {
    let workshop = Workshop::new();
    workshop.configure(("", ""), KITCHENS);
    workshop
}

fn up(workshop: &Workshop, name: &str) -> Command {
    workshop.up(name, 2, 2, FRAMES)
}

/// Of every environment the kitchens of its recorded episodes, by the episode's number.
fn kitchens_played(run: &Run) -> BTreeMap<u32, BTreeMap<u32, u32>> {
    let mut played: BTreeMap<u32, BTreeMap<u32, u32>> = BTreeMap::new();
    for (kitchen, environment, episode) in Recording::of(run).starts() {
        played.entry(environment).or_default().insert(episode, kitchen);
    }
    played
}

#[test]
fn killed_and_resumed_it_is_the_same_run_in_the_same_kitchens() {
    let workshop = workshop();
    let undisturbed = complete(up(&workshop, "undisturbed")).result();
    assert_eq!(undisturbed.1, FRAMES);
    let run = workshop.run("undisturbed");
    let kitchens = kitchens_played(&run);
    assert_eq!(kitchens.keys().copied().collect::<Vec<_>>(), [0, 1, 2, 3]);
    let all: BTreeSet<u32> = kitchens.values().flat_map(BTreeMap::values).copied().collect();
    assert!(all.iter().all(|kitchen| (1000..1006).contains(kitchen)) && all.len() > 2, "{all:?}");
    for (environment, episodes) in &kitchens {
        // Two episodes each: the rule is a test of its own.
        assert!(episodes.keys().copied().eq(0..episodes.len() as u32), "{environment}: {episodes:?}");
        assert!(episodes.iter().all(|(episode, kitchen)| episodes[&(episode / 2 * 2)] == *kitchen), "{episodes:?}");
    }
    let kept = || std::fs::read_dir(run.folder.kitchens()).unwrap().count();
    assert!(kept() >= all.len(), "kitchens are kept in the run's folder");
    workshop.assert_replays("undisturbed");
    // One kitchen's episodes can be called for.
    let one = all.first().unwrap().to_string();
    let replay = workshop.call(&["replay", "--check", "undisturbed", "--kitchen", &one]);
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
    workshop.assert_replays("killed");
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
    let printed = complete(evaluate("first")).good();
    assert!(printed.stderr.contains("3 procedural kitchens (5000..5003)"), "{printed:#?}");
    let records = proto::evaluation::read_table(proto::config::Config::default().spec(), &table("first")).unwrap();
    let mut kitchens: BTreeMap<u32, u32> = BTreeMap::new();
    for record in &records {
        *kitchens.entry(record.kitchen.number()).or_default() += 1;
    }
    assert_eq!(kitchens, BTreeMap::from([(5000, 12), (5001, 12), (5002, 12)]));
    let result = workshop.json("first/evaluation.json");
    assert_eq!(result["conditions"]["procedural"], "5000..5003");
    assert_eq!(result["kitchens"].as_array().map(Vec::len), Some(3));
    workshop.assert_replays("first");

    // Every actor dies once.
    let mut command = evaluate("actors");
    command.env("STILLROOM_FAULT", "actor.before_send:31");
    let printed = complete(command);
    assert!(printed.success && printed.deaths().len() == 2, "{printed:#?}");
    assert_eq!(table("actors"), table("first"));
}
