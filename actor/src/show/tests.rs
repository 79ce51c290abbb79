//! Requests as `orchestrator view` sends them.

use super::*;
use simulator::robot::action::Action;
use std::io::{BufReader, Read};

/// The episode that these actions make of a run's first, with a state hash that is wrong after step `wrong`.
fn recorded(config: &Config, actions: &[Action], wrong: Option<usize>) -> RecordedEpisode {
    let id = EnvironmentId { kitchen: config.kitchens().of_actor(0).unwrap(), number: 0 };
    let kitchen = Arc::new(source::of_run(id.kitchen, config, &PathBuf::new()).unwrap());
    let mut environment = tasks::open(&tasks::Run::of(config), &kitchen, id, 2).unwrap();
    let start_hash = Some(environment.base().state_hash());
    let mut done = vec![0; config.spec().layout().of_action.len()];
    let mut hashes = Vec::new();
    for &action in actions {
        environment.act(&[action.index()], &mut done);
        hashes.push(environment.base().state_hash());
    }
    if let Some(wrong) = wrong {
        hashes[wrong] ^= 1;
    }
    let actions = actions.iter().map(|action| action.index()).collect();
    RecordedEpisode { environment: id, episode: 2, start_hash, actions, hashes, digests: Vec::new(), start: Vec::new() }
}

fn open(config: &Config, name: &str, episode: RecordedEpisode) -> ShowRequest {
    let setup = ReplaySetup { config: config.to_toml(), folder: None, images: None };
    ShowRequest::Open { name: name.to_owned(), setup, episode: Box::new(episode) }
}

fn draw(name: &str, step: u32, view: ShowView, width: u32) -> ShowRequest {
    ShowRequest::Draw { name: name.to_owned(), step, view, width, height: width, fine: false }
}

/// Answers with the pictures that follow them.
fn ask(requests: &[ShowRequest]) -> Vec<(ShowAnswer, Vec<u8>)> {
    let lines: Vec<String> = requests.iter().map(|request| serde_json::to_string(request).unwrap()).collect();
    let mut output = Vec::new();
    run(lines.join("\n").as_bytes(), &mut output).unwrap();
    let mut reader = BufReader::new(&output[..]);
    let mut answers = Vec::new();
    for _ in requests {
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        let answer: ShowAnswer = serde_json::from_str(&line).unwrap();
        let bytes = if let ShowAnswer::Picture { bytes } = answer { bytes as usize } else { 0 };
        let mut picture = vec![0; bytes];
        reader.read_exact(&mut picture).unwrap();
        answers.push((answer, picture));
    }
    assert!(reader.fill_buf().unwrap().is_empty(), "nothing is left over");
    answers
}

fn problem(answer: &ShowAnswer) -> &str {
    if let ShowAnswer::Failed { problem } = answer { problem } else { panic!("{answer:?} is no failure") }
}

const WAY: [Action; 4] =
    [Action::RotateRightContinuous, Action::MoveAheadContinuous, Action::LookDown, Action::DoneMidLevel];

#[test]
fn a_state_that_is_not_as_recorded_is_named() {
    let config = Config::default();
    let answers = ask(&[open(&config, "a", recorded(&config, &WAY, Some(1)))]);
    let ShowAnswer::Opened(shown) = &answers[0].0 else { panic!("{:?}", answers[0].0) };
    assert_eq!(shown.first_difference.as_ref().map(|difference| difference.step), Some(2));
}

#[test]
fn what_cannot_be_done_is_answered_and_the_next_request_is_heard() {
    let config = Config::default();
    let mut wrong = recorded(&config, &WAY[..1], None);
    wrong.actions = vec![200];
    let nowhere =
        ShowView::Orbit(ShowOrbit { centre_m: [1e38, f32::MAX, 0.0], radius_m: 1e9, yaw_rad: 1e30, pitch_rad: 9.0 });
    let answers = ask(&[
        open(&config, "w", wrong),
        draw("w", 0, ShowView::Depth, 56),
        open(&config, "a", recorded(&config, &WAY[..1], None)),
        draw("a", 7, ShowView::Depth, 56),
        draw("a", 1, ShowView::Depth, 100_000),
        draw("a", 1, nowhere, 16),
        draw("a", 1, ShowView::Depth, 56),
    ]);
    assert!(problem(&answers[0].0).contains("there is no action 200"));
    assert_eq!(answers[1].0, ShowAnswer::NotOpen);
    assert!(problem(&answers[3].0).contains("the episode has 1 steps, not 7"));
    assert!(problem(&answers[4].0).contains("8 to 2048 pixels"));
    for at in [5, 6] {
        assert!(matches!(answers[at].0, ShowAnswer::Picture { .. }), "{:?}", answers[at].0);
    }
}

#[test]
fn solids_are_of_the_moment_that_was_asked_for() {
    let config = Config::default();
    let actions = [Action::MoveAheadContinuous, Action::LookDown];
    let asked = |step, fixed| ShowRequest::Solids { name: "a".to_owned(), step, fixed };
    let open = open(&config, "a", recorded(&config, &actions, None));
    let answers = ask(&[asked(0, true), open, asked(0, true), asked(1, false), asked(2, false), asked(3, false)]);
    assert_eq!(answers[0].0, ShowAnswer::NotOpen);
    assert!(problem(&answers[5].0).contains("has 2 steps, not 3"));
    let solids = |at: usize| match &answers[at].0 {
        ShowAnswer::Solids(solids) => solids,
        other => panic!("{other:?}"),
    };
    let (start, ahead, down) = (solids(2), solids(3), solids(4));
    let ShowAnswer::Opened(shown) = &answers[1].0 else { panic!("it is open") };
    assert!(start.solids.len() > ahead.solids.len(), "without what never moves");
    let body = |of: &ShownSolids| of.solids.iter().find(|solid| solid.name == "robot/0").unwrap().corners_m[0];
    let [start_m, ahead_m] = [0, 1].map(|step| shown.moments[step].numbers::<2>("base_position_m").unwrap());
    for (axis, base) in [(0, 0), (2, 1)] {
        let moved = ahead_m[base] - start_m[base];
        assert!((body(ahead)[axis] - body(start)[axis] - moved).abs() < 1e-4);
    }
    assert_eq!(start.depth_mm.len(), FRAME_SIDE * FRAME_SIDE);
    assert_ne!(ahead.depth_mm, down.depth_mm);
    // One LookDown turns the camera by more than 0.1 rad.
    assert!(
        down.camera_pitch_rad > ahead.camera_pitch_rad + 0.1,
        "{} {}",
        down.camera_pitch_rad,
        ahead.camera_pitch_rad
    );
}
