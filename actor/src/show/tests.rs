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
    ShowRequest::Draw { name: name.to_owned(), step, view, width, height: width, fine: false, dark: false }
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

/// What the last picture showed at the same place is not lit anew.
#[test]
fn a_fine_picture_is_the_same_whatever_was_drawn_before_it() {
    let config = Config::default();
    let opened = open(&config, "a", recorded(&config, &WAY, None));
    let orbit = ShowOrbit { centre_m: [0.0, 0.8, 0.0], radius_m: 1.5, yaw_rad: 0.4, pitch_rad: 0.6 };
    let at = |step| match draw("a", step, ShowView::Orbit(orbit), 96) {
        ShowRequest::Draw { name, step, view, width, height, dark, .. } => {
            ShowRequest::Draw { name, step, view, width, height, fine: true, dark }
        }
        open @ ShowRequest::Open { .. } => open,
    };
    let alone = ask(&[opened.clone(), at(2)]);
    let after = ask(&[opened, at(0), at(2)]);
    assert_eq!(alone[1], after[2]);
    assert_ne!(after[1], after[2], "something moved");
}
