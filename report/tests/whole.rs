//! The whole report on made-up runs. Its files are left in the test's own temporary folder, to be looked at.

use proto::config::Config;
use proto::evaluation::{
    Conditions, Confusion, Cost, Distribution, EPISODES_PER_KITCHEN, EpisodeEnd, EpisodeRecord, Evaluation, ObjectSet,
    Subject, category_of,
};
use proto::kitchen::{KitchenId, Split};
use proto::metric;
use proto::random::{Key, Purpose, Random};
use proto::run_state::{Ending, RunState};
use report::study::{ELAPSED_S, Evaluated, FRAMES_PER_S, Origin, Rollout, Run, Validated};
use report::{Made, Options};
use std::collections::BTreeMap;

fn random(seed: u64, kitchen: u8, episode: u32) -> Random {
    Key { seed, purpose: Purpose::RandomPolicy, kitchen, environment: 0, episode, step: 0 }.stream()
}

/// An episode that succeeds with chance `skill`, and disturbs less the larger `care` is.
fn episode(seed: u64, kitchen: KitchenId, episode: u32, skill: f64, care: f64) -> (EpisodeRecord, Vec<u8>) {
    let mut draw = random(seed, kitchen.number(), episode);
    let success = draw.uniform_open() < skill * (0.8 + 0.1 * f64::from(kitchen.number() % 5));
    let disturbance_m = if draw.uniform_open() < care { 0.0 } else { 0.002 * (1.0 / draw.uniform_open()).powf(1.7) };
    let length = if success { 40 + draw.below(100) } else { 200 };
    let actions = (0..length)
        .map(|step| {
            if success && step + 1 == length {
                return 20;
            }
            let drive = step < 30 + draw.below(20);
            if drive { 16 + draw.below(3) as u8 } else { draw.below(19) as u8 }
        })
        .collect();
    let disturbed_objects = if disturbance_m < 0.01 { 0 } else { 1 + (disturbance_m * 4.0) as u32 };
    let record = EpisodeRecord {
        kitchen,
        episode,
        category: category_of(episode),
        end: if success { EpisodeEnd::Done } else { EpisodeEnd::TimeLimit },
        success,
        picked_up: success || draw.uniform_open() < 0.3,
        length,
        failed_actions: length / 9,
        return_r: if success { 14.0 } else { -1.0 },
        return_r_prime: if success { 14.0 } else { -1.0 } - 15.0 * disturbance_m,
        disturbance_m: disturbance_m.min(9.0) as f32,
        peak_disturbance_m: disturbance_m.min(9.0) as f32,
        disturbed_objects,
        ever_disturbed_objects: disturbed_objects + u32::from(draw.uniform_open() < 0.1),
        farthest_m: 0.4,
        peak_farthest_m: 0.4,
        wrist_object_m: 0.1,
        object_goal_m: if success { 0.04 } else { 0.9 },
        disturb_prediction: Some(Confusion { hits: 4, misses: 3, false_alarms: 6, quiet: u64::from(length) }),
        state_hash: 7,
    };
    (record, actions)
}

fn evaluated(config: &Config, split: Split, objects: ObjectSet, skill: f64, care: f64) -> Evaluated {
    let records: Vec<_> = KitchenId::of_split(split)
        .into_iter()
        .flat_map(|kitchen| (0..EPISODES_PER_KITCHEN).map(move |number| (kitchen, number)))
        .filter(|&(_, number)| objects.contains(category_of(number)))
        .map(|(kitchen, number)| episode(config.seed, kitchen, number, skill, care))
        .collect();
    let subject = Subject {
        preset: config.preset.clone(),
        seed: config.seed,
        run: Some("runs/x".into()),
        checkpoint: Some("checkpoints/rollout-00000120.json".into()),
        frames: config.stages.iter().map(|stage| stage.frames).sum(),
        weights: format!("{:064x}", config.seed),
        parameters: 5_800_000,
    };
    let conditions = Conditions {
        split,
        scenes: Vec::new(),
        objects,
        episodes: 0,
        distribution: Distribution::Fixed,
        start_distance_max_m: 0.0,
        goal_distance_max_m: 0.0,
        deterministic: false,
        seed: config.seed,
        max_steps: config.episode.max_steps,
        action_space: config.episode.action_space,
        actors: 5,
        environments_per_actor: 32,
        device: "cpu, 1 thread".into(),
    };
    let result = Evaluation::of(subject, conditions, Cost::default(), &records);
    let episodes = records.into_iter().map(|(record, _)| record).collect();
    let split = if split == Split::Test { "test" } else { "valid" };
    Evaluated { name: format!("20261121-{split}-{}", objects.name()), result, episodes }
}

fn rollouts(config: &Config, ceiling: f64) -> Vec<Rollout> {
    let budget: u64 = config.stages.iter().map(|stage| stage.frames).sum();
    (1..=300)
        .map(|index| {
            let frames = budget * index / 300;
            let part = index as f64 / 300.0;
            let mut draw = random(config.seed, 0, index as u32);
            let success = ceiling * (1.0 - (-4.0 * part).exp()) * (0.9 + 0.2 * draw.uniform_open());
            let metrics = [
                (metric::EPISODES, 19.0),
                (metric::RETURN, 14.0 * success - 1.0),
                (metric::SUCCESS, success),
                (metric::SUCCESS_UNDISTURBED, success * (0.4 + 0.2 * part)),
                (metric::DISTURBANCE, 0.4 - 0.25 * part + 0.05 * draw.uniform_open()),
                ("auxiliary/precision", 0.1 + 0.5 * part + 0.05 * draw.uniform_open()),
                ("auxiliary/recall_disturb", 0.2 + 0.4 * part + 0.05 * draw.uniform_open()),
                ("auxiliary/recall_no_disturb", 0.99 - 0.02 * part),
                ("auxiliary/label_rate", 0.05 - 0.02 * part),
                (metric::ENTROPY, 3.0 - 1.5 * part + 0.1 * draw.uniform_open()),
                (metric::APPROXIMATE_KL, 0.002 + 0.004 * draw.uniform_open()),
                (metric::VALUE_LOSS, 0.5 - 0.4 * part + 0.2 * draw.uniform_open()),
                (metric::GRADIENT_NORM, if index == 1 { 40.0 } else { 0.5 + 0.5 * draw.uniform_open() }),
                (FRAMES_PER_S, 2000.0 + 200.0 * draw.uniform_open()),
                (ELAPSED_S, frames as f64 / 2100.0),
            ];
            let metrics = metrics.map(|(name, value)| (name.to_owned(), value));
            Rollout { frames, metrics: BTreeMap::from(metrics) }
        })
        .collect()
}

fn run(preset: &str, seed: u64, (skill, care): (f64, f64)) -> Run {
    let config = Config { seed, ..Config::resolve(preset, None).expect("a preset") };
    let luck = 0.02 * seed as f64;
    let validation = (1..=9).map(|index| Validated {
        frames: index * 5_000_000,
        distribution: Distribution::Fixed,
        success: skill * index as f64 / 9.0 - luck,
        success_without_disturbance: skill * care * index as f64 / 9.0 - luck,
    });
    Run {
        name: format!("runs/{preset}-{seed}"),
        origin: Origin::Run(RunState::Ended(Ending::Complete)),
        rollouts: rollouts(&config, skill - luck),
        evaluations: [
            (Split::Test, ObjectSet::Novel, skill),
            (Split::Test, ObjectSet::Seen, skill + 0.02),
            (Split::Validation, ObjectSet::Novel, skill - 0.05),
        ]
        .map(|(split, objects, skill)| evaluated(&config, split, objects, skill - luck, care))
        .into(),
        validation: validation.filter(|point| point.success_without_disturbance > 0.0).collect(),
        config,
    }
}

fn study() -> Vec<Run> {
    let mut runs = Vec::new();
    for (preset, seeds, found) in [
        ("disturb-two-stage", 5, (0.8, 0.55)),
        ("none-two-stage", 3, (0.75, 0.5)),
        ("disturb-stage1-45m", 2, (0.8, 0.3)),
        ("disturb-scratch-45m", 1, (0.12, 0.6)),
        ("lambda-1", 2, (0.82, 0.35)),
        ("lambda-5", 2, (0.82, 0.45)),
        ("lambda-25", 2, (0.7, 0.6)),
        ("small-none", 1, (0.7, 0.25)),
    ] {
        runs.extend((1..=seeds).map(|seed| run(preset, seed, found)));
    }
    let mut untrained = run("two-stage", 1, (0.02, 0.3));
    untrained.origin = Origin::Untrained;
    untrained.rollouts.clear();
    untrained.validation.clear();
    runs.push(untrained);
    runs
}

fn made(runs: &[Run]) -> Made {
    Made::of(runs, &Options::default(), Vec::new()).expect("sound runs")
}

#[test]
fn a_full_study_has_every_section_and_needs_no_network() {
    let made = made(&study());
    let page = made.page("Made for a test.");
    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("report");
    std::fs::create_dir_all(&folder).expect("a folder for tests");
    std::fs::write(folder.join("report.html"), &page).expect("a file");
    for figure in made.figures.all() {
        let png = figure.png().expect("a drawable figure");
        std::fs::write(folder.join(format!("{}.png", figure.name)), png).expect("a file");
    }
    std::fs::write(folder.join("report.json"), serde_json::to_string(&made.report).expect("numbers")).expect("a file");

    for outside in ["src=", "href=\"http", "<script", "@import", "url("] {
        assert!(!page.contains(outside), "the page reaches out by {outside}");
    }
    assert!(!page.contains("NaN") && !page.contains("class=\"missing\">None of these"), "nothing is missing");
    for name in [
        "results-test-novel",
        "learning",
        "optimisation",
        "validation",
        "prediction",
        "srwod-by-threshold",
        "srwod-by-objects",
    ] {
        assert!(page.contains(&format!("<figure id=\"{name}")), "{name}");
    }
    assert_eq!(page.matches("<figure id=\"actions-").count(), 9);
    assert!(page.contains("<figure id=\"lambda-sweep\" "));
    // Panels for what was noted, and for nothing else.
    let section = page.split("<h2 id=").find(|section| section.starts_with("\"optimisation\"")).expect("a section");
    for (title, there) in [
        ("entropy of the policy", true),
        ("approximate KL of an update", true),
        ("gradient norm", true),
        ("throughput", true),
        ("time trained", true),
        ("policy loss", false),
    ] {
        assert_eq!(section.contains(&format!("<desc>{title}</desc>")), there, "{title}");
    }
    assert!(section.contains(">hours</text>"), "45M frames take hours");
    // One's own results come first; a table of the paper with none of them is one closed line.
    let at = |what: &str| page.find(what).unwrap_or_else(|| panic!("{what} is not on the page"));
    assert!(at("<h2 id=\"groups\">") < at("<h2 id=\"paper\">"));
    assert!(page.contains("<h3 id=\"table-test-novel\">") && !page.contains("<details open"));
    assert_eq!(made.page("Made for a test."), page, "the same runs give the same page");
}

#[test]
fn the_numbers_are_those_of_the_tables() {
    let runs = study();
    let report = made(&runs).report;
    let row = report.comparisons[0].rows.iter().find(|row| row.preset == "disturb-two-stage").expect("a row");
    assert_eq!(row.ours.len(), 1, "the group of its own name; lambda-15 is not there");
    let ours = &row.ours[0];
    assert_eq!((ours.success.seeds, ours.episodes), (5, 1800));
    // The mean by hand, over the seeds' own result files.
    let rates: Vec<f64> =
        runs[..5].iter().map(|run| run.evaluations[0].result.overall.success.expect("episodes")).collect();
    let mean = rates.iter().sum::<f64>() / 5.0;
    assert!((ours.success.mean.point - mean).abs() < 1e-12);
    let interval = ours.success.mean.interval.expect("five seeds");
    assert!(interval.low < mean && mean < interval.high && interval.high - interval.low < 0.1, "{interval:?}");
    let mut sorted = rates;
    sorted.sort_by(f64::total_cmp);
    assert!((ours.success.iqm_of_seeds - sorted[1..4].iter().sum::<f64>() / 3.0).abs() < 1e-12);
    // The made-up episodes disturb an object just where their displacement is a centimetre or more.
    let [paper, axis] = [ours.success_without_disturbance, ours.success_without_disturbance_per_axis];
    assert_eq!(paper.mean.point, axis.mean.point);
    // SRwoD over the threshold passes through SRwoD, and never falls.
    let result = &report.groups[0].results[0];
    let at = |threshold_m: f64| result.by_threshold.iter().find(|point| point.at == threshold_m).expect("a point").mean;
    assert_eq!(result.by_disturbed_objects[0].mean, result.success_without_disturbance_per_axis.mean.point);
    assert!((at(0.01) - result.success_without_disturbance.mean.point).abs() < 1e-12);
    assert!(result.by_threshold.is_sorted_by(|a, b| a.mean <= b.mean));
    assert!(result.by_disturbed_objects.is_sorted_by(|a, b| a.mean <= b.mean));
    // One sweep a field, over 1, 5, 15, 25.
    assert_eq!(report.sweeps.len(), 3);
    let lambdas: Vec<f64> = report.sweeps[0].points.iter().map(|point| point.lambda_disturb).collect();
    assert_eq!(lambdas, [1.0, 5.0, 15.0, 25.0]);
    // The same runs give the same numbers.
    let again = made(&runs).report;
    assert_eq!(serde_json::to_string(&again).expect("numbers"), serde_json::to_string(&report).expect("numbers"));
}

/// A run whose evaluations are of drawn episodes within its distances.
fn drawn(mut run: Run) -> Run {
    for evaluated in &mut run.evaluations {
        let conditions = &mut evaluated.result.conditions;
        conditions.distribution = Distribution::Run;
        conditions.start_distance_max_m = run.config.episode.start_distance_max_m;
        conditions.goal_distance_max_m = run.config.episode.goal_distance_max_m;
    }
    run.validation.iter_mut().for_each(|point| point.distribution = Distribution::Run);
    run
}

#[test]
fn drawn_episodes_are_named_on_top_and_stand_in_no_row_of_the_paper() {
    let ours = |made: &Made| -> usize {
        made.report.comparisons.iter().flat_map(|table| &table.rows).map(|row| row.ours.len()).sum()
    };
    let near = drawn(run("demo", 1, (0.6, 0.5)));
    let fixed = made(&[run("disturb-two-stage", 1, (0.8, 0.5)), near.clone()]);
    assert!(ours(&fixed) > 0);
    assert_eq!(fixed.report.episodes.len(), 4, "{:#?}", fixed.report.episodes);
    assert_eq!(fixed.report.episodes[0], "Figures of fixed episodes at full distance: disturb-two-stage.");
    let sentence = &fixed.report.episodes[2];
    assert!(
        sentence.contains("within 0.7 m of the target") && sentence.contains(": demo. Not the paper's"),
        "{sentence}"
    );
    let fields = |index: usize| -> Vec<&str> {
        fixed.report.groups[index].results.iter().map(|result| result.field.as_str()).collect()
    };
    assert_eq!(fields(0), ["test-novel", "test-seen", "validation-novel"]);
    assert_eq!(fields(1), ["test-novel-drawn", "test-seen-drawn", "validation-novel-drawn"]);
    let page = fixed.page("Made for a test.");
    assert!(page.find("within 0.7 m").unwrap() < page.find("Beside the paper</h2>").unwrap());

    // A row's own method, and yet not on the paper's episodes: beside it, and in figures, stands nothing.
    let drawn = made(&[drawn(run("disturb-two-stage", 1, (0.8, 0.5)))]);
    assert_eq!(ours(&drawn), 0);
    assert!(drawn.report.episodes[0].starts_with("Figures of drawn episodes at full distance: disturb-two-stage."));
    assert!(!drawn.report.notes.iter().any(|note| note.contains("instead of the paper's 1800")));

    // In scenes of one's own.
    let mut scenes = near;
    scenes.evaluations.truncate(1);
    let conditions = &mut scenes.evaluations[0].result.conditions;
    (conditions.split, conditions.scenes) = (Split::Train, vec!["scenes/000/scene.toml".into()]);
    let made = made(&[scenes]);
    assert_eq!((made.report.groups[0].results[0].field.as_str(), ours(&made)), ("scenes-novel", 0));
}

#[test]
fn what_is_missing_is_said() {
    let mut bare = run("demo", 1, (0.5, 0.5));
    bare.rollouts.clear();
    bare.evaluations.clear();
    bare.validation.clear();
    let page = made(&[bare]).page("Made for a test.");
    for said in [
        "None of these runs has trained a rollout",
        "None of these runs was evaluated during training",
        "None of these runs has noted an update",
        "None of these runs has been evaluated yet",
        "No two of these groups differ",
        "None of these runs trained the auxiliary task",
        "No group here is a row of this table",
    ] {
        assert!(page.contains(said), "{said}");
    }
    assert_eq!(page.matches("not run").count(), 19 + 19 + 12 + 8);
    let folded: Vec<&str> = page.split("<details").skip(1).collect();
    assert_eq!(folded.len(), 4, "each table of the paper is folded");
    assert!(folded.iter().all(|fold| fold.contains("<summary>") && !fold.starts_with(" open")));

    // Seeds that were evaluated on different episodes are not averaged.
    let mut short = run("demo", 2, (0.5, 0.5));
    short.evaluations.truncate(1);
    short.evaluations[0].episodes.truncate(300);
    let report = made(&[run("demo", 1, (0.5, 0.5)), short]).report;
    assert!(report.notes.iter().any(|note| note.contains("seeds are compared on the same episodes only")));
    let fields: Vec<&str> = report.groups[0].results.iter().map(|result| result.field.as_str()).collect();
    assert_eq!(fields, ["test-seen", "validation-novel"]);
    assert!(report.notes.iter().any(|note| note.contains("and therefore not in its means: runs/demo-2")));
}
