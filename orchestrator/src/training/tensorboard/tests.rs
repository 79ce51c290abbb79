use super::events::tests::points_in;
use super::*;
use crate::training::means::tests::{history, stages};
use std::collections::BTreeMap;

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
    let figures = fourth.metrics.iter().map(|(name, value)| (name.to_owned(), value));
    fourth.metrics = figures.chain([(metric::RETURN.to_owned(), -1.0)]).collect::<BTreeMap<_, _>>().into();
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
