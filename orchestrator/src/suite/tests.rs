//! The suites of this repository.

use super::by_name::BUILT_IN;
use super::file::{Asked, Suite, SuiteEntry};
use proto::config::{Config, PpoConfig};
use report::paper::{AblationRow, ActionSpaceRow, ResultRow};
use std::path::Path;

fn built_in(name: &str) -> &'static str {
    BUILT_IN.iter().find(|(built_in, _)| *built_in == name).unwrap().1
}

#[test]
fn every_suite_of_the_repository_is_taken_by_its_name() {
    let files = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../suites")).unwrap();
    let mut names: Vec<_> = files.map(|file| file.unwrap().path().file_stem().unwrap().to_owned()).collect();
    names.sort_unstable();
    assert_eq!(names, BUILT_IN.map(|(name, _)| name));
    let (suite, text) = Suite::read(Path::new("two-seeds"), &[]).unwrap();
    assert_eq!((suite.entries[0].name.as_str(), text.as_str()), ("disturb-1", built_in("two-seeds")));
    assert_eq!(suite.apart(), ["none: auxiliary.task = \"none\""]);
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("lambdas.toml"), "").unwrap();
    let meant = format!("; did you mean `{}`?", at("lambdas.toml").display());
    for (name, tip) in [
        ("papr".into(), "; did you mean `paper`?"),
        (at("paper.toml"), "; did you mean `paper`?"),
        (at("lambda.toml"), &meant),
        ("demo".into(), "; `orchestrator up --preset demo` trains a preset"),
        ("demmo".into(), "; `orchestrator up --preset demo` trains a preset"),
        ("short-two-stage".into(), "; `orchestrator up --preset short-two-stage` trains a preset"),
        (at("qqq"), "shows one)"),
    ] {
        let unknown = Suite::read(&name, &[]).unwrap_err().to_string();
        let known =
            "no built-in suite (ablations, kitchens, paper, recipe, seeds, short, two-seeds): a suite is a TOML file";
        assert!(unknown.contains(known) && unknown.ends_with(tip), "{unknown}");
    }
}

/// The suites in the repository are sound, and together they are every row of the paper's tables.
#[test]
fn our_own_suites_cover_the_paper() {
    let main = Suite::parse(built_in("paper")).unwrap();
    // Fourteen other rows, and the run with the other learning rate.
    assert_eq!(main.entries.len(), 5 * 5 + 14 * 3 + 1);
    assert_eq!(
        main.evaluations.iter().map(Asked::folder).collect::<Vec<_>>(),
        ["suite-test-all", "suite-test-all-best"]
    );
    Suite::parse(built_in("two-seeds")).unwrap();
    let smaller = Suite::parse(built_in("ablations")).unwrap();
    let short = Suite::parse(built_in("short")).unwrap();
    assert_eq!(short.entries.iter().filter(|entry| entry.from == Some(0)).count(), 5);
    let kitchens = Suite::parse(built_in("kitchens")).unwrap();
    let counts: Vec<_> = kitchens.entries.iter().map(|entry| entry.config.kitchens().count()).collect();
    assert_eq!(counts, [[19; 3], [100; 3], [1000; 3]].concat());
    let recipe = Suite::parse(built_in("recipe")).unwrap();
    assert!(recipe.entries.iter().all(|entry| proto::stage::total_frames(&entry.config.stages) == 45_000_000));
    let settings = |config: &Config| Config { preset: String::new(), seed: 0, ..config.clone() };
    let resolved = |preset: &str| Config::resolve(preset, None).unwrap();
    let paper = report::paper::paper();
    for preset in paper.test_novel.iter().chain(&paper.test_seen).map(ResultRow::preset) {
        let seeds: Vec<_> =
            main.entries.iter().filter(|entry| entry.name == format!("{preset}-{}", entry.seed)).collect();
        assert!([3, 5].contains(&seeds.len()), "{preset}");
        for SuiteEntry { config, from, .. } in seeds {
            let row = resolved(&preset);
            let before = from.iter().flat_map(|&from| &main.entries[from].config.stages);
            let stages: Vec<_> =
                before.chain(&config.stages).map(|stage| (stage.reward.clone(), stage.frames)).collect();
            assert_eq!(stages, row.stages.iter().map(|stage| (stage.reward.clone(), stage.frames)).collect::<Vec<_>>());
            let Config { actors, recording, validation, .. } = config.clone();
            let PpoConfig { rollout_steps, minibatches, overlap, .. } = config.ppo;
            let ppo = PpoConfig { rollout_steps, minibatches, overlap, ..row.ppo };
            let in_our_shape = Config { stages: config.stages.clone(), actors, ppo, recording, validation, ..row };
            assert_eq!(settings(config), settings(&in_our_shape), "{preset}");
        }
    }
    let run: Vec<Config> = smaller.entries.iter().map(|entry| settings(&entry.config)).collect();
    let ablations = paper.ablation_valid_novel_20m.iter().map(AblationRow::preset);
    for preset in ablations.chain(paper.action_space_valid.iter().map(ActionSpaceRow::preset)) {
        assert!(run.contains(&settings(&resolved(&preset))), "{preset}");
    }
}
