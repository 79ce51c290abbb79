//! The whole report on made-up runs.

mod study;

use proto::config::FromConfig;
use proto::evaluation::Distribution;
use proto::kitchen::{KitchenRange, Split};
use proto::task::Column;
use report::comparison::Comparison;
use report::study::{Run, pair_of};
use report::{Kept, Options, Report};
use study::{run, study};

fn made(runs: &[Run]) -> Report {
    Report::of(runs, &Options::default(), Vec::new()).expect("sound runs")
}

/// The page showed 0 to 0.
#[test]
fn seeds_without_a_success_have_wilsons_interval() {
    let report = made(&[1, 2].map(|seed| run("disturb-two-stage", seed, (-1.0, 0.5))));
    let result = &report.groups[0].results[0];
    let rate = result.rates["success"];
    assert_eq!((result.metrics["success"].mean.interval, rate.share), (None, 0.0));
    assert!(rate.interval.low.abs() < 1e-12, "{rate:?}");
    let episodes = result.pooled.episodes as f64;
    let square = 1.959_963_984_540_054_f64.powi(2);
    assert!((rate.interval.high - square / (episodes + square)).abs() < 1e-9, "{rate:?} of {episodes}");
}

#[test]
fn the_numbers_are_those_of_the_tables() {
    let runs = study();
    let report = made(&runs);
    let row = report.comparisons[0].rows.iter().find(|row| row.preset == "disturb-two-stage").expect("a row");
    assert_eq!(row.ours.len(), 1, "the group of its own name; lambda-15 is not there");
    let ours = &row.ours[0];
    let success = ours.metrics["success"];
    assert_eq!((success.seeds, ours.episodes), (5, 1800));
    // The mean by hand, over the seeds' own result files.
    let rates: Vec<f64> =
        runs[..5].iter().map(|run| run.evaluations[0].result.overall.get("success").expect("episodes")).collect();
    let mean = rates.iter().sum::<f64>() / 5.0;
    assert!((success.mean.point - mean).abs() < 1e-12);
    let interval = success.mean.interval.expect("five seeds");
    assert!(interval.low < mean && mean < interval.high && interval.high - interval.low < 0.1, "{interval:?}");
    let mut sorted = rates;
    sorted.sort_by(f64::total_cmp);
    assert!((success.iqm_of_seeds - sorted[1..4].iter().sum::<f64>() / 3.0).abs() < 1e-12);
    // The made-up episodes disturb an object just where their displacement is a centimetre or more.
    let [paper, axis] = ["", "_per_axis"].map(|kind| ours.metrics[&format!("success_without_disturbance{kind}")]);
    assert_eq!(paper.mean.point, axis.mean.point);
    // SRwoD over the threshold passes through SRwoD, and never falls.
    let result = &report.groups[0].results[0];
    for (curve, metric, label) in [
        ("success_by_displacement", "success_without_disturbance", "SRwoD"),
        ("success_by_disturbed_objects", "success_without_disturbance_per_axis", "SRwoD (per axis)"),
    ] {
        let task = &report.tasks["arm_point_nav"];
        let mark = task.curves.iter().find(|one| one.name == curve).expect("a curve").marks[label];
        let points = &result.curves[curve];
        let at = points.iter().find(|point| point.at as f32 == mark).expect("a point");
        assert!((at.mean - result.metrics[metric].mean.point).abs() < 1e-12);
        assert!(points.is_sorted_by(|a, b| a.mean <= b.mean));
    }
    // One sweep a field, over 1, 5, 15, 25.
    assert_eq!(report.sweeps.len(), 3);
    let lambdas: Vec<f64> = report.sweeps[0].points.iter().map(|point| point.value).collect();
    assert_eq!((lambdas, report.sweeps[0].weight.as_str()), (vec![1.0, 5.0, 15.0, 25.0], "lambda_disturb"));
    // The same runs give the same numbers.
    let again = made(&runs);
    assert_eq!(serde_json::to_string(&again).expect("numbers"), serde_json::to_string(&report).expect("numbers"));
}

#[test]
fn a_table_over_two_reports_is_that_of_one() {
    let runs = &study()[..7];
    let [first, rest, whole] = [&runs[..2], &runs[2..], runs].map(|runs| made(runs).comparisons);
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
    let mean = row.ours[0].metrics["success"].mean;
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
    let problem = all.clone().add(&made(&other).comparisons).expect_err("other weights").to_string();
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
    let report = made(&[one]);
    let row = report.comparisons[0].rows.iter().find(|row| row.preset == "disturb-two-stage").expect("a row");
    let fields: Vec<&str> = row.ours.iter().map(|ours| ours.field.as_str()).collect();
    assert_eq!(fields, ["test-novel", "test-novel-best"]);
    assert!(row.ours.iter().all(|ours| ours.differences.is_empty()), "{:?}", row.ours[0].differences);
}

/// The second of them was in no line.
#[test]
fn evaluations_that_sample_and_that_do_not_are_two_results() {
    let mut one = run("disturb-two-stage", 1, (0.8, 0.5));
    one.evaluations.truncate(1);
    one.evaluations.push(one.evaluations[0].clone());
    one.evaluations[1].result.conditions.deterministic = true;
    one.evaluations[1].name = "most-probable".to_owned();
    for _ in 0..2 {
        let report = made(std::slice::from_ref(&one));
        let results = report.groups[0].results.iter().map(|result| (&*result.name, &*result.seeds[0].evaluation));
        let both = ["test, novel objects", "test, novel objects, deterministic"];
        assert!(results.eq(both.into_iter().zip(["20261121-test-novel", "most-probable"])));
        assert!(report.notes.iter().all(|note| !note.contains("Left out")), "{:?}", report.notes);
        one.evaluations.reverse();
    }
    // The paper's row has the one that is alone.
    one.evaluations.retain(|one| one.result.conditions.deterministic);
    let report = made(&[one.clone()]);
    let row = report.comparisons[0].rows.iter().find(|row| row.preset == "disturb-two-stage").expect("a row");
    assert_eq!(row.ours[0].field, "test-novel-deterministic");
    let mut kept = Kept::default();
    kept.add(&report.comparisons).expect("rows that fit");
    assert!(kept.markdown().expect("a matrix").contains("| ours, last checkpoint, deterministic | 1 |"));
    // Another of the same weights in the same way.
    one.evaluations.push(one.evaluations[0].clone());
    one.evaluations[1].name = "again".to_owned();
    assert!(made(&[one]).notes.iter().any(|note| note.contains("Left out: most-probable of ")));
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
    let ours = |made: &Report| -> usize {
        made.comparisons.iter().flat_map(|table| &table.rows).map(|row| row.ours.len()).sum()
    };
    let near = drawn(run("demo", 1, (0.6, 0.5)));
    let fixed = made(&[run("disturb-two-stage", 1, (0.8, 0.5)), near.clone()]);
    assert!(ours(&fixed) > 0);
    assert_eq!(fixed.episodes.len(), 4, "{:#?}", fixed.episodes);
    assert_eq!(fixed.episodes[0], "disturb-two-stage-1: figures of fixed episodes at full distance.");
    let sentence = &fixed.episodes[2];
    assert!(sentence.contains("starts within 0.7 m,") && sentence.starts_with("demo-1: figures of"), "{sentence}");
    let fields = |index: usize| -> Vec<&str> {
        fixed.groups[index].results.iter().map(|result| result.field.as_str()).collect()
    };
    assert_eq!(fields(0), ["test-novel", "test-seen", "validation-novel"]);
    assert_eq!(fields(1), ["test-novel-drawn", "test-seen-drawn", "validation-novel-drawn"]);

    // A row's own method, and yet not on the paper's episodes: beside it, and in figures, stands nothing.
    let drawn = made(&[drawn(run("disturb-two-stage", 1, (0.8, 0.5)))]);
    assert_eq!(ours(&drawn), 0);
    assert!(drawn.episodes[0].starts_with("disturb-two-stage-1: figures of drawn episodes at full distance."));
    assert!(!drawn.notes.iter().any(|note| note.contains("instead of the paper's 1800")));

    // In scenes of one's own.
    let mut scenes = near;
    scenes.evaluations.truncate(1);
    let conditions = &mut scenes.evaluations[0].result.conditions;
    (conditions.split, conditions.scenes) = (Split::Train, vec!["scenes/000/scene.toml".into()]);
    let made = made(&[scenes]);
    assert_eq!((made.groups[0].results[0].field.as_str(), ours(&made)), ("scenes-novel", 0));
}

#[test]
fn seeds_that_were_evaluated_on_different_episodes_are_not_averaged() {
    let mut short = run("demo", 2, (0.5, 0.5));
    short.evaluations.truncate(1);
    short.evaluations[0].episodes.truncate(300);
    let (mut long, few) = (run("demo", 1, (0.5, 0.5)), short.evaluations[0].clone());
    let report = made(&[long.clone(), short.clone()]);
    assert!(report.notes.iter().any(|note| note.contains("seeds are compared on the same episodes only")));
    let fields: Vec<&str> = report.groups[0].results.iter().map(|result| result.field.as_str()).collect();
    assert_eq!(fields, ["test-seen", "validation-novel"]);
    assert!(report.notes.iter().any(|note| note.contains("and therefore not in its means: runs/demo-2")));

    // Both have these, though one has more.
    long.evaluations.push(few);
    let report = made(&[long, short]);
    let found = report.groups[0].results.iter().find(|result| result.field == "test-novel").expect("it is compared");
    assert_eq!(found.seeds.iter().map(|seed| seed.episodes).collect::<Vec<_>>(), [300, 300]);
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
    assert_eq!(names(&with([170_000, 420_000, 420_000])), Some([first.clone(), second.clone()]));
    assert_eq!(names(&with([420_000, 100_000, 420_000])), Some([second, first]));
    assert_eq!(names(&with([170_001, 420_000, 420_000])), None, "both are from after the stage's end");
    assert_eq!(names(&with([170_000, 100_000, 420_000])), None, "the third is of other kitchens");
    let runs = with([170_000, 420_000, 420_000]);
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

    let mut runs = with([170_000, 420_000, 420_000]);
    let [number, other] = [3, 5].map(|at| runs[0].evaluations[0].episodes[at].episode);
    let kitchen = runs[0].evaluations[0].episodes[3].kitchen;
    let spec = runs[0].config.spec();
    let mut set = |of: usize, at: usize, name: &str, number: f64| {
        let Some(Column::Number(column)) = spec.column(name) else { panic!("{name}") };
        runs[0].evaluations[of].episodes[at].numbers[column] = Some(number);
    };
    for at in [3, 5] {
        for (of, return_r_prime) in [(0, -300.0 - at as f64), (1, 14.0)] {
            set(of, at, "return_r_prime", return_r_prime);
            set(of, at, "success", 1.0);
            set(of, at, "success_without_disturbance", 1.0);
        }
    }
    set(1, 5, "success_without_disturbance", 0.0);
    let pair = pair_of(&runs[0], &runs, |_| true).expect("a pair");
    let [earlier, later] = pair.episodes[0];
    assert_eq!(
        (earlier.kitchen, earlier.episode, later.episode),
        (kitchen, number, number),
        "and not {other}, a failure"
    );
    assert_eq!(pair.stage, "II");
}
