//! The screen over a run folder, without a terminal.

use super::draw::draw;
use super::model::{Lines, Look, Model};
use crate::run::identity::Identity;
use crate::training::means::tests::{history, stages};
use crate::viewer::RunReaders;
use proto::config::Config;
use proto::run_folder::RunFolder;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use view::data::{Curves, Kitchen, Problem, Runs};

const WARNING: &str = "2026-11-21T02:04:24.000000Z  WARN orchestrator::x: actor-01 died: signal 9\u{1b}[2J";

/// A run of two stages, `rollouts` of whose thirty rollouts are trained, with two learners and thirty actors on two
/// hosts. One actor was started three times.
fn run(rollouts: u64) -> (tempfile::TempDir, RunReaders, String) {
    let temporary = tempfile::tempdir().unwrap();
    let folder = RunFolder::new(temporary.path().join("my-run"));
    std::fs::create_dir_all(folder.logs()).unwrap();
    let config = Config { stages: stages(), ..Config::resolve("demo", None).unwrap() };
    std::fs::write(folder.config(), config.to_toml()).unwrap();
    Identity::new().unwrap().write(&folder).unwrap();
    let lines =
        history(rollouts).iter().map(|trained| serde_json::to_string(trained).unwrap() + "\n").collect::<String>();
    std::fs::write(folder.metrics(), lines).unwrap();
    let log = format!("2026-11-21T02:04:23.000000Z  INFO orchestrator::x: it begins\n{WARNING}\n");
    std::fs::write(folder.log("orchestrator"), log).unwrap();
    for learner in 0..2 {
        std::fs::write(folder.log(&format!("learner-{learner}")), "--- learner, start 1 of x\n").unwrap();
    }
    for actor in 0..30 {
        let there = if actor < 15 { folder.clone() } else { folder.host(1) };
        std::fs::create_dir_all(there.logs()).unwrap();
        let starts = if actor == 1 { 3 } else { 1 };
        let lines: Vec<String> =
            (1..=starts).map(|start| format!("--- actor-{actor:02}, start {start} of x\n")).collect();
        std::fs::write(there.log(&format!("actor-{actor:02}")), lines.concat()).unwrap();
    }
    let root = folder.root().to_path_buf();
    let readers = RunReaders::of(vec![root.clone()]);
    let name = readers.names_of(&[root]).remove(0);
    (temporary, readers, name)
}

fn look(readers: &RunReaders, name: &str, model: &mut Model) {
    let curves = readers.curves(name, model.curves.edition, model.curves.frames.len());
    model.take(Look { live: readers.live(name), curves, suite: None });
}

/// Such a run, and what is shown of it.
fn looked_at(rollouts: u64) -> (tempfile::TempDir, RunReaders, String, Model) {
    let (temporary, readers, name) = run(rollouts);
    let mut model = Model::default();
    look(&readers, &name, &mut model);
    (temporary, readers, name, model)
}

fn screen(model: &Model, columns: u16, lines: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(columns, lines)).unwrap();
    terminal.draw(|frame| draw(frame, model)).unwrap();
    let buffer = terminal.backend().buffer();
    let line = |y| (0..columns).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    (0..lines).map(line).collect()
}

fn press(model: &mut Model, code: KeyCode) -> bool {
    model.key(KeyEvent::new(code, KeyModifiers::NONE))
}

#[test]
fn keys_scroll_switch_and_leave() {
    let (.., mut model) = looked_at(3);
    assert!(!screen(&model, 80, 24).join("").contains("actor-29"));
    assert!(press(&mut model, KeyCode::End));
    let text = screen(&model, 80, 24).join("\n");
    assert!(text.contains("actor-29") && !text.contains("learner-0"), "{text}");
    assert!(press(&mut model, KeyCode::Home) && model.scrolled == 0);
    assert!(press(&mut model, KeyCode::Char('w')) && model.lines == Lines::Warnings);
    assert!(!screen(&model, 80, 24).join("").contains("it begins"));
    assert!(screen(&model, 40, 24).join("").contains("return") && press(&mut model, KeyCode::Tab));
    let narrow = screen(&model, 40, 24).join("\n");
    assert!(narrow.contains("SR 50.0%") && !narrow.contains("return"), "{narrow}");
    assert!(!press(&mut model, KeyCode::Char('q')) && !press(&mut model, KeyCode::Esc));
    let control = |key| KeyEvent::new(KeyCode::Char(key), KeyModifiers::CONTROL);
    assert!(!model.key(control('c')) && model.key(control('x')));
}

#[test]
fn every_size_is_drawn() {
    let (.., model) = looked_at(22);
    for (columns, lines) in [(1, 1), (2, 5), (20, 7), (25, 12), (60, 15), (80, 24), (131, 41), (300, 100)] {
        let shown = screen(&model, columns, lines);
        assert_eq!(shown.len(), usize::from(lines));
        if columns > 100 && lines > 5 {
            // What the colours of its curves stand for, and a figure that has no curve.
            assert!(shown[0].contains("━ stage I  ━ stage II"), "{}", shown[0]);
            assert!(shown[3].contains("disturbance per success 0.500 m"), "{}", shown[3]);
        }
        if columns > 20 && lines > 5 {
            assert!(shown[0].contains("my-run"), "{columns}x{lines}");
        }
    }
}

#[test]
fn a_return_is_that_of_the_newest_tenth_and_the_axis_of_no_success_is_short() {
    let (.., mut model) = looked_at(20);
    model.curves.series.insert("episode/success".to_owned(), vec![Some(0.0); 20]);
    let shown = screen(&model, 120, 35).join("\n");
    // Rollouts 18 and 19, of one and of three episodes.
    assert!(shown.contains(" return 18.75 "), "{shown}");
    assert!(shown.contains("│5%│") && !shown.contains("│50%│"), "{shown}");
}

#[test]
fn an_evaluation_has_its_kitchens_and_no_long_empty_boxes() {
    let (.., mut model) = looked_at(3);
    let live = model.live.as_mut().unwrap();
    live.card.evaluation = true;
    live.workers.truncate(3);
    let kitchen = |kitchen| Kitchen { kitchen, environments: vec![0], episodes: 72, figures: [].into() };
    live.kitchens = (26..=30).map(kitchen).collect();
    live.indexed = 1.0;
    for columns in [60, 100, 120] {
        let shown = screen(&model, columns, 30);
        let text = shown.join("\n");
        assert_eq!((26..=30).filter(|kitchen| text.contains(&format!("{kitchen}      72"))).count(), 5, "{text}");
        assert!(columns < 70 || shown[24..29].iter().all(|line| line.trim().is_empty()), "{text}");
    }
}

#[test]
fn what_letters_and_axes_are_of_is_said_where_there_is_room() {
    let (.., mut model) = looked_at(20);
    let said = "SR: success, SRwoD: success without disturbance";
    let wide = screen(&model, 120, 35);
    assert!(wide[34].trim_end().ends_with(said), "{}", wide[34]);
    assert!(wide.join("\n").contains("1000 frames│"), "{}", wide.join("\n"));
    assert!(wide[0].contains("seed 1  in ") && wide[2].contains(" frames/s, mean  time: simulate "), "{}", wide[2]);
    // Where there is little room: what is less known, and numbers without their unit.
    let small = screen(&model, 80, 24).join("\n");
    assert!(!small.contains(said) && small.contains("  |  SRwoD: success without disturbance"), "{small}");
    assert!(small.contains(" 1000│") && !small.contains(" frames│"), "{small}");
    // Of an evaluation: how it plays, and that there is nothing yet.
    let live = model.live.as_mut().unwrap();
    (live.card.evaluation, live.frames_per_s, live.kitchens) = (true, None, vec![]);
    live.card.conditions = Some("my-run: sampled actions".to_owned());
    press(&mut model, KeyCode::Char('w'));
    assert!(screen(&model, 80, 24)[2].contains("my-run: sampled actions"));
}

#[test]
fn a_suite_has_two_lines_above_its_run() {
    let (_temporary, readers, name, mut model) = looked_at(3);
    let alone = screen(&model, 80, 24);
    let suite = || Some("suite small: run 2 of 2, training\nsmall-1 done, small-2 training".to_owned());
    let look = |suite| Look { live: readers.live(&name), curves: readers.curves(&name, 0, 0), suite };
    model.take(look(suite()));
    let shown = screen(&model, 80, 24);
    assert_eq!(format!("{}\n{}", shown[0].trim(), shown[1].trim()), suite().unwrap());
    assert_eq!((&shown[2], &shown[23]), (&alone[0], &alone[23]));
    // For a moment its file cannot be read.
    model.take(look(None));
    assert_eq!(screen(&model, 80, 24)[..2], shown[..2]);
}

#[test]
fn a_name_comes_before_the_stages() {
    let (.., mut model) = looked_at(3);
    "runs/20261129-205550-demo-1".clone_into(&mut model.live.as_mut().unwrap().card.folder);
    let first = |columns| screen(&model, columns, 24).remove(0);
    let narrow = first(80);
    assert!(narrow.starts_with(" runs/20261129-205550-demo-1  ") && !narrow.contains("━ stage"), "{narrow}");
    let wide = first(120);
    assert!(wide.starts_with(" runs/20261129-205550-demo-1  ") && wide.contains("━ stage I  ━ stage II"), "{wide}");
}

#[test]
fn what_is_new_is_added_and_what_is_gone_is_said() {
    let (temporary, readers, name, mut model) = looked_at(10);
    let folder = RunFolder::new(temporary.path().join("my-run"));
    assert_eq!(model.curves.frames.len(), 10);
    let lines =
        |rollouts| history(rollouts).iter().map(|one| serde_json::to_string(one).unwrap() + "\n").collect::<String>();
    std::fs::write(folder.metrics(), lines(25)).unwrap();
    look(&readers, &name, &mut model);
    let known = &model.curves;
    assert_eq!((known.frames.len(), known.frames[24]), (25, 1250));
    assert!(known.series.values().all(|column| column.len() == 25));
    // Written anew, as after a resume from an older checkpoint.
    std::fs::write(folder.metrics(), lines(4)).unwrap();
    look(&readers, &name, &mut model);
    assert_eq!(model.curves.frames.len(), 4);
    std::fs::remove_dir_all(folder.root()).unwrap();
    look(&readers, &name, &mut model);
    let shown = screen(&model, 80, 24);
    assert!(shown[0].contains("my-run"), "what was known stays");
    assert!(shown[23].contains("there is no run called my-run"), "{}", shown[23]);
}

#[test]
fn a_figure_that_comes_or_ends_has_no_value_where_it_is_missing() {
    let new = |from, frames: [u64; 2], name: &str| Curves {
        edition: 1,
        from,
        frames: frames.to_vec(),
        stage: vec![0; 2],
        series: std::iter::once((name.to_owned(), vec![Some(1.0); 2])).collect(),
        ..Curves::default()
    };
    let mut model = Model::default();
    let nothing = || Err(Problem::Unreadable("not asked".to_owned()));
    let mut take = |curves| model.take(Look { live: nothing(), curves: Ok(curves), suite: None });
    take(new(0, [10, 20], "early"));
    take(new(2, [30, 40], "late"));
    assert_eq!(model.curves.frames, [10, 20, 30, 40]);
    assert_eq!(model.curves.series["early"], [Some(1.0), Some(1.0), None, None]);
    assert_eq!(model.curves.series["late"], [None, None, Some(1.0), Some(1.0)]);
    assert_eq!(model.problem.as_deref(), Some("not asked"));
}

#[test]
fn kitchens_are_shown_in_every_usual_size_and_what_is_cut_is_counted() {
    let (.., mut model) = looked_at(3);
    let live = model.live.as_mut().unwrap();
    live.kitchens = (1..=19)
        .map(|kitchen| Kitchen {
            kitchen,
            environments: vec![0],
            episodes: u64::from(100 + kitchen),
            figures: [].into(),
        })
        .collect();
    live.indexed = 1.0;
    let counts = |shown: &str| (101..=119).filter(|count| shown.contains(&format!(" {count} "))).count();
    let wide = screen(&model, 200, 50).join("\n");
    assert_eq!(counts(&wide), 19, "{wide}");
    let usual = screen(&model, 120, 35).join("\n");
    let known = counts(&usual);
    assert!(known > 8 && usual.contains(&format!("…{} more", 19 - known)), "{usual}");
    assert!(usual.contains("kitchen episodes SR     SRwoD  disturbance"), "{usual}");
    assert!(usual.contains("└ no room for disturbance per success ─") && !wide.contains("no room"), "{usual}");
    assert!(
        usual.contains("restarts starts cores") && usual.contains("actor-01     ended   2        3      –"),
        "{usual}"
    );
    assert_eq!(counts(&screen(&model, 80, 24).join("\n")), 0);
    press(&mut model, KeyCode::Char('w'));
    press(&mut model, KeyCode::Char('w'));
    assert_eq!(model.lines, Lines::Kitchens);
    let small = screen(&model, 80, 24).join("\n");
    let known = counts(&small);
    assert!(known > 4 && small.contains(&format!("…{} more", 19 - known)), "{small}");
    assert!(small.contains("└ no room for 2 columns ─"), "{small}");
    press(&mut model, KeyCode::End);
    assert!(screen(&model, 80, 24).join("\n").contains(" 119 "));
    press(&mut model, KeyCode::Char('w'));
    assert_eq!(model.lines, Lines::Last);
}

/// They are read in the order of time: what is known of a long run is of its beginning at first.
#[test]
fn the_oldest_episodes_are_not_shown_as_the_newest() {
    let (.., mut model) = looked_at(3);
    let live = model.live.as_mut().unwrap();
    live.kitchens = vec![Kitchen { kitchen: 17, environments: vec![0], episodes: 43, figures: [].into() }];
    let mut shown = |indexed| {
        model.live.as_mut().unwrap().indexed = indexed;
        screen(&model, 150, 40).join("\n")
    };
    let early = shown(0.4);
    assert!(early.contains(" newest episodes, 40% of recordings read ") && !early.contains("17      43"), "{early}");
    assert!(early.contains("the recordings are read first"), "{early}");
    let late = shown(0.95);
    assert!(late.contains(" newest episodes, 95% of recordings read ") && late.contains("17      43"), "{late}");
    let whole = shown(1.0);
    assert!(whole.contains(" newest episodes ") && whole.contains("17      43"), "{whole}");
}
