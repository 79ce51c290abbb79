//! The whole report on made-up runs. Its files are left in the test's own temporary folder, to be looked at.

mod study;

use proto::config::FromConfig;
use proto::evaluation::Distribution;
use proto::kitchen::{KitchenRange, Split};
use report::comparison::Comparison;
use report::study::{Run, pair_of};
use report::{Frame, Kept, Made, Options, ShownPair, ShownStrip};
use study::{run, study};

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
        std::fs::write(folder.join(format!("{}.svg", figure.name)), figure.svg()).expect("a file");
    }
    std::fs::write(folder.join("report.json"), serde_json::to_string(&made.report).expect("numbers")).expect("a file");

    for outside in ["src=", "href=\"http", "href=\"figures", "<script", "@import", "url("] {
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

#[test]
fn a_table_over_two_reports_is_that_of_one() {
    let runs = &study()[..7];
    let [first, rest, whole] = [&runs[..2], &runs[2..], runs].map(|runs| made(runs).report.comparisons);
    let table = |reports: &[&[Comparison]]| {
        let mut kept = Kept::default();
        for report in reports {
            kept.add(report).expect("rows that fit");
        }
        kept
    };
    let all = table(&[&whole]);
    assert_eq!(table(&[&first, &rest]), all);
    assert_eq!(table(&[&whole, &first]), all, "a run that is there already changes nothing");
    let row = whole[0].rows.iter().find(|row| row.preset == "disturb-two-stage").expect("a row");
    let mean = row.ours[0].success.mean;
    let interval = mean.interval.expect("five seeds");
    let percent = |share: f64| format!("{:.1}", 100.0 * share);
    let [mean, low, high] = [mean.point, interval.low, interval.high].map(percent);
    let markdown = all.markdown().expect("a matrix");
    assert!(markdown.contains(&format!("| ours, last checkpoint | 5 | {mean} [{low}, {high}] |")), "{markdown}");
    assert!(all.runs().contains("disturb-two-stage-5"), "{:?}", all.runs());

    let mut other = runs[..2].to_vec();
    for evaluated in &mut other[1].evaluations {
        evaluated.result.subject.weights = "f".repeat(64);
    }
    let problem = all.clone().add(&made(&other).report.comparisons).expect_err("other weights").to_string();
    assert!(problem.contains("disturb-two-stage, test-novel: seed 2 is there already with other weights"), "{problem}");
}

/// The best checkpoint stands beside the newest, and a stage II of its own in the row of two stages.
#[test]
fn a_row_has_the_newest_checkpoint_and_the_best() {
    let mut one = run("disturb-stage2-25m", 1, (0.8, 0.5));
    let stages = run("disturb-stage1-20m", 1, (0.8, 0.5)).config.stages;
    let from = FromConfig { checkpoint: "a.json".into(), frames: 20_000_000, weights: "a".repeat(64), stages };
    one.config.from = Some(from);
    let mut best = one.evaluations.clone();
    for evaluated in &mut best {
        evaluated.result.subject.checkpoint = Some("runs/x/best/rollout-00000007.json".into());
    }
    one.evaluations.extend(best);
    let report = made(&[one]).report;
    let row = report.comparisons[0].rows.iter().find(|row| row.preset == "disturb-two-stage").expect("a row");
    let fields: Vec<&str> = row.ours.iter().map(|ours| ours.field.as_str()).collect();
    assert_eq!(fields, ["test-novel", "test-novel-best"]);
    assert!(row.ours.iter().all(|ours| ours.differences.is_empty()), "{:?}", row.ours[0].differences);
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
        "--record all",
    ] {
        assert!(page.contains(said), "{said}");
    }
    assert_eq!(page.matches("<tr class=\"absent\">").count(), 19 + 19 + 12 + 8);
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

/// A picture of one colour, PNG.
fn picture() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 4, 3);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(&[200, 30, 30].repeat(12)).expect("twelve pixels");
    writer.finish().expect("memory");
    bytes
}

#[test]
fn an_episode_is_shown_before_and_after() {
    let strip = |title: &str| ShownStrip {
        title: title.to_owned(),
        frames: vec![Frame { png: picture(), words: vec!["step 0 of 9".into()] }; 6],
        size: (4, 3),
    };
    let pair = ShownPair { caption: "Kitchen 26".into(), strips: [strip("before stage II"), strip("after stage II")] };
    let made = made(&[run("demo", 1, (0.5, 0.5))]).with_episodes(vec![pair], vec!["another cannot be drawn".into()]);
    assert!(made.report.figures.contains(&"episode-1".to_owned()));
    let page = made.page("Made for a test.");
    assert!(page.contains("another cannot be drawn") && page.contains("<figure id=\"episode-1\""));
    assert_eq!(page.matches("<image ").count(), 12, "on the page; those to take away are written as numbers");
    let figure = made.figures.all().find(|figure| figure.name == "episode-1").expect("a figure");
    assert!(figure.csv().contains("before stage II,1,step 0 of 9"), "{}", figure.csv());
    assert_eq!(figure.svg().matches("<image ").count(), 12, "the file holds the frames");
}

#[test]
fn the_pair_is_of_the_same_episodes_and_of_weights_from_both_sides_of_the_stage() {
    let with = |frames: [u64; 3]| -> Vec<Run> {
        let mut run = run("demo", 1, (0.5, 0.5));
        for (evaluated, frames) in run.evaluations.iter_mut().zip(frames) {
            evaluated.result.subject.frames = frames;
        }
        // The second on the same episodes as the first.
        run.evaluations[1].result.conditions = run.evaluations[0].result.conditions.clone();
        run.evaluations[1].episodes = run.evaluations[0].episodes.clone();
        vec![run]
    };
    let names = |runs: &[Run]| {
        pair_of(&runs[0], runs, |_| true).map(|pair| [pair.before.name.clone(), pair.after.name.clone()])
    };
    let [first, second] = ["20261121-test-novel", "20261121-test-seen"].map(str::to_owned);
    assert_eq!(names(&with([260_000, 440_000, 440_000])), Some([first.clone(), second.clone()]));
    assert_eq!(names(&with([440_000, 100_000, 440_000])), Some([second, first]));
    assert_eq!(names(&with([260_001, 440_000, 440_000])), None, "both are from after the stage's end");
    assert_eq!(names(&with([260_000, 100_000, 440_000])), None, "the third is of other kitchens");
    let runs = with([260_000, 440_000, 440_000]);
    assert!(pair_of(&runs[0], &runs, |one| one.name.ends_with("seen")).is_none(), "what was not recorded is no use");
    // Drawn episodes depend on no seed either.
    let mut runs = vec![drawn(runs[0].clone())];
    runs[0].evaluations[1].result.conditions.seed += 1;
    assert!(names(&runs).is_some());
    // Kitchens without end do, and another run's scenes may be others under the same names.
    let mut before = runs[0].clone();
    before.evaluations.truncate(1);
    let from = &before.evaluations[0].result.subject;
    let (frames, weights) = (from.frames, from.weights.clone());
    runs[0].config.from = Some(FromConfig { checkpoint: "a.json".into(), frames, weights, stages: vec![] });
    runs[0].evaluations = vec![runs[0].evaluations.remove(1)];
    runs[0].evaluations[0].result.subject.weights = "f".repeat(64);
    runs.push(before);
    assert!(names(&runs).is_some());
    runs[1].config.kitchens.seed = 9;
    assert!(names(&runs).is_some(), "they are the built-in kitchens");
    for run in &mut runs {
        let conditions = &mut run.evaluations[0].result.conditions;
        (conditions.split, conditions.procedural) = (Split::Train, KitchenRange::new(5000, 5100));
    }
    assert_eq!(names(&runs), None);
    runs[1].config.kitchens.seed = 0;
    assert!(names(&runs).is_some());
    for run in &mut runs {
        let conditions = &mut run.evaluations[0].result.conditions;
        (conditions.scenes, conditions.procedural) = (vec!["scenes/000/scene.toml".into()], None);
        run.config.scenes = conditions.scenes.clone();
    }
    assert!(names(&runs).is_some());
    runs[1].config.scenes = vec!["scenes/000/scene.toml (sha256 0123456789abcdef)".into()];
    assert_eq!(names(&runs), None);

    let mut runs = with([260_000, 440_000, 440_000]);
    let [number, other] = [3, 5].map(|at| runs[0].evaluations[0].episodes[at].episode);
    let kitchen = runs[0].evaluations[0].episodes[3].kitchen;
    for at in [3, 5] {
        for (of, disturbance_m) in [(0, 20.0 + at as f32), (1, 0.0)] {
            let record = &mut runs[0].evaluations[of].episodes[at];
            (record.disturbance_m, record.success) = (disturbance_m, true);
        }
    }
    runs[0].evaluations[1].episodes[5].success = false;
    let pair = pair_of(&runs[0], &runs, |_| true).expect("a pair");
    let [earlier, later] = pair.episodes[0];
    assert_eq!(
        (earlier.kitchen, earlier.episode, later.episode),
        (kitchen, number, number),
        "and not {other}, a failure"
    );
    assert_eq!(pair.stage, "II");
}
