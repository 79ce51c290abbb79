use super::events::tests::points_in;
use super::*;
use crate::training::means::tests::{history, stages};

/// A run's board in its first start, and the folder.
fn board(incarnation: u32, folder: &RunFolder) -> Board {
    Board::of(folder, &Config { stages: stages(), ..Config::default() }, incarnation)
}

/// Steps that TensorBoard shows of a folder, with their returns.
fn shown(folder: &RunFolder, of: &str) -> Vec<(u64, f32)> {
    let points = points_in(&folder.tensorboard().join(of));
    points.iter().map(|point| (point.step, point.values["charts/episodic_return"])).collect()
}

fn expected(rollouts: std::ops::Range<u64>) -> Vec<(u64, f32)> {
    rollouts.map(|rollout| ((rollout + 1) * 50, rollout as f32)).collect()
}

fn file_count(folder: &RunFolder, of: &str) -> usize {
    std::fs::read_dir(folder.tensorboard().join(of)).map_or(0, Iterator::count)
}

/// Trains the rollouts from `from` to `to`.
fn train(board: &mut Board, from: u64, to: u64) {
    (from..to).for_each(|rollout| board.rollout(&history(rollout + 1)));
}

#[test]
fn each_stage_has_its_own_curves_and_a_new_start_a_file_of_its_own() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(temporary.path());
    let mut first = board(1, &folder);
    first.begin(&History::default());
    assert!(!folder.tensorboard().exists(), "nothing to say yet");
    // Stage I has 20 rollouts.
    train(&mut first, 0, 25);
    assert_eq!(shown(&folder, "stage-1-I"), expected(0..20));
    assert_eq!(shown(&folder, "stage-2-II"), expected(20..25));
    let newest = points_in(&folder.tensorboard().join("stage-2-II")).pop().unwrap();
    // 50 frames in two seconds.
    assert_eq!((newest.values["charts/SPS"], newest.values["time/update_s"]), (25.0, 0.6));
    assert_eq!((newest.values["charts/success_rate"], newest.at_unix_s), (0.5, 48));

    let mut second = board(2, &folder);
    second.begin(&history(25));
    assert_eq!(file_count(&folder, "stage-2-II"), 1, "all was said");
    train(&mut second, 25, 27);
    assert_eq!((file_count(&folder, "stage-1-I"), file_count(&folder, "stage-2-II")), (1, 2));
    assert_eq!(shown(&folder, "stage-2-II"), expected(20..27));
}

#[test]
fn what_a_learner_trains_again_is_shown_once() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(temporary.path());
    let mut first = board(1, &folder);
    train(&mut first, 0, 25);
    // Back into stage I, by the same orchestrator: stage II has not begun.
    first.begin(&history(18));
    assert_eq!((shown(&folder, "stage-1-I"), shown(&folder, "stage-2-II")), (expected(0..18), vec![]));
    train(&mut first, 18, 23);
    assert_eq!((shown(&folder, "stage-1-I"), shown(&folder, "stage-2-II")), (expected(0..20), expected(20..23)));
    // The next one knows from the checkpoint what this one was killed before it could write.
    board(2, &folder).begin(&history(25));
    assert_eq!(shown(&folder, "stage-2-II"), expected(20..25));
}

#[test]
fn files_that_lack_something_or_say_something_else_are_corrected() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(temporary.path());
    train(&mut board(1, &folder), 0, 10);
    let stage = folder.tensorboard().join("stage-1-I");
    let path = std::fs::read_dir(&stage).unwrap().next().unwrap().unwrap().path();
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    assert!(shown(&folder, "stage-1-I").len() < 10);
    board(2, &folder).begin(&history(10));
    assert_eq!(shown(&folder, "stage-1-I"), expected(0..10));
    std::fs::remove_dir_all(&stage).unwrap();
    board(3, &folder).begin(&history(10));
    assert_eq!(shown(&folder, "stage-1-I"), expected(0..10));
    // Another figure for rollout 4.
    let mut other = history(10);
    let mut fourth = other.iter().nth(4).unwrap().clone();
    let mut figures = fourth.metrics.to_map();
    figures.insert(metric::RETURN.to_owned(), -1.0);
    fourth.metrics = figures.into();
    other.insert(fourth);
    board(4, &folder).begin(&other);
    let mut corrected = expected(0..5);
    corrected[4].1 = -1.0;
    assert_eq!(shown(&folder, "stage-1-I"), corrected);
}

#[test]
fn a_board_that_cannot_be_written_ends_no_run_and_is_tried_again() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(temporary.path());
    std::fs::write(folder.tensorboard(), "in the way").unwrap();
    let mut first = board(1, &folder);
    first.begin(&History::default());
    train(&mut first, 0, 3);
    assert!(first.given_up && !first.is_whole(&history(3), &[]));
    std::fs::remove_file(folder.tensorboard()).unwrap();
    train(&mut first, 3, 4);
    assert!(!folder.tensorboard().exists(), "a gap would be left");
    assert!(first.is_whole(&history(4), &[]));
    assert_eq!(shown(&folder, "stage-1-I"), expected(0..4));
}

#[test]
fn validations_are_curves_whenever_they_come() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(temporary.path());
    let score = |rollout: u64, success: f64| {
        let line = serde_json::json!({ "rollout": rollout, "frames": rollout * 100, "weights": "", "result": "",
            "episodes": 5, "success": success, "success_without_disturbance": 0.25, "picked_up": 1.0, "length": 9.0,
            "disturbance_m": 0.5, "disturbed_objects": 1.0, "at_unix_s": 7, "wall_s": 1.0 });
        serde_json::from_value::<Score>(line).unwrap()
    };
    let shown = || {
        let points = points_in(&folder.tensorboard().join("validation"));
        // The tag of a share ends so, that of a value does not.
        assert!(points.iter().all(|point| point.values["charts/disturbance_m"] == 0.5));
        points.iter().map(|point| (point.step, point.values["charts/success_rate"])).collect::<Vec<_>>()
    };
    let mut first = board(1, &folder);
    first.validations(&[]);
    assert!(!folder.tensorboard().exists());
    first.validations(&[score(3, 0.5)]);
    // One that was made again after a later one.
    first.validations(&[score(3, 0.5), score(5, 0.75), score(4, 0.625)]);
    assert_eq!(shown(), [(300, 0.5), (400, 0.625), (500, 0.75)]);
    board(2, &folder).validations(&[score(3, 0.5), score(4, 0.625), score(5, 0.75)]);
    assert_eq!((shown().len(), file_count(&folder, "validation")), (3, 1), "nothing new");
}
