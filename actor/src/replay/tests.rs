//! Episodes as `actor replay` is given them.

use super::*;
use proto::evaluation::{EvaluationConfig, ObjectSet};
use proto::kitchen::Split;
use proto::replay::ImageFormat;
use simulator::tasks::arm_point_nav::Current;

/// An evaluation of one novel episode a kitchen, or a run.
fn config(evaluation: bool) -> Config {
    let mut config = Config::default();
    if evaluation {
        config.evaluation = Some(EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 6));
        config.actors = proto::config::ActorsConfig { count: 5, environments_per_actor: 1 };
    }
    config
}

fn first_kitchen(config: &Config) -> EnvironmentId {
    EnvironmentId { kitchen: config.kitchens().of_actor(0).unwrap(), number: 0 }
}

/// An episode as the recorder would have recorded it.
fn recorded(config: &Config, episode: u32, actions: &[Action]) -> RecordedEpisode {
    let id = first_kitchen(config);
    let kitchen = Arc::new(source::of_run(id.kitchen, config, &PathBuf::new()).unwrap());
    let mut environment = Environment::open(&Run::of(config), Arc::clone(&kitchen), id, episode).unwrap();
    let start_hash = Some(environment.state_hash());
    let start = Some(start_of(&environment));
    let (mut hashes, mut goals, mut steps) = (Vec::new(), Vec::new(), Vec::new());
    for &action in actions {
        let Current { holding, wrist_to_object_m, object_to_goal_m, .. } = environment.current();
        goals.push(goal_digest(holding == 1, if holding == 1 { object_to_goal_m } else { wrist_to_object_m }));
        let transition = environment.step(action);
        hashes.push(environment.state_hash());
        steps.push(digests_of(&environment, &transition, &Rewards::of(config)));
    }
    let actions = actions.iter().map(|action| action.index()).collect();
    RecordedEpisode { environment: id, episode, start_hash, actions, hashes, goals, start, steps }
}

fn replay(config: &Config, images: Option<ReplayImages>, episodes: &[RecordedEpisode]) -> Vec<ReplayVerdict> {
    let setup = ReplaySetup { config: config.to_toml(), folder: None, images };
    let mut input = serde_json::to_string(&setup).unwrap();
    for episode in episodes {
        input = format!("{input}\n{}", serde_json::to_string(episode).unwrap());
    }
    let mut output = Vec::new();
    run(input.as_bytes(), &mut output).unwrap();
    String::from_utf8(output).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

const WAY: [Action; 4] =
    [Action::RotateRightContinuous, Action::MoveAheadContinuous, Action::LookDown, Action::DoneMidLevel];

#[test]
fn a_goal_vector_that_the_simulator_does_not_give_is_a_difference() {
    let config = config(false);
    let good = recorded(&config, 3, &WAY);
    let mut unknown = good.clone();
    unknown.goals[1] = 0;
    let mut wrong = good.clone();
    wrong.goals[2] ^= 1;
    let differences =
        replay(&config, None, &[good, unknown, wrong]).into_iter().map(|verdict| verdict.first_difference);
    let difference = Difference { step: 2, aspect: Aspect::Goal };
    assert_eq!(differences.collect::<Vec<_>>(), [None, None, Some(difference)]);
}

#[test]
fn all_that_was_recorded_of_a_step_is_compared() {
    let config = config(false);
    let good = recorded(&config, 3, &WAY);
    for (number, aspect) in STEP_ASPECTS.into_iter().enumerate() {
        let mut wrong = good.clone();
        wrong.steps[2][number] ^= 1;
        let verdict = replay(&config, None, &[wrong]).remove(0);
        assert_eq!(verdict.first_difference, Some(Difference { step: 3, aspect }));
    }
    let mut wrong = good.clone();
    wrong.start = wrong.start.map(|start| start ^ 1);
    let difference = replay(&config, None, &[wrong]).remove(0).first_difference;
    assert_eq!(difference, Some(Difference { step: 0, aspect: Aspect::Start }));
    // What an older recording does not hold is no difference.
    let older = RecordedEpisode { start: None, steps: Vec::new(), ..good };
    assert_eq!(replay(&config, None, &[older]).remove(0).first_difference, None);
}

#[test]
fn a_film_of_an_episode_that_diverges_announces_the_pictures_that_it_has() {
    let config = config(false);
    let mut longer = recorded(&config, 3, &WAY);
    for _ in 0..20 {
        longer.actions.push(Action::LookUp.index());
        longer.hashes.push(1);
        longer.goals.push(0);
        longer.steps.push([0; 4]);
    }
    let folder = tempfile::tempdir().unwrap();
    let images = ReplayImages { folder: folder.path().display().to_string(), format: ImageFormat::Apng, side: 48 };
    let verdict = replay(&config, Some(images), &[longer]).remove(0);
    assert_eq!(verdict.images, 5);
    assert_eq!(verdict.first_difference, Some(Difference { step: 5, aspect: Aspect::Length }));
    let file = std::fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap().path();
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(std::fs::File::open(file).unwrap())).read_info().unwrap();
    let frames = reader.info().animation_control().unwrap().num_frames;
    assert_eq!(frames, 5);
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    for frame in 0..frames {
        assert!(reader.next_frame(&mut bytes).is_ok(), "frame {frame}");
    }
}

#[test]
fn a_film_is_called_by_the_fixed_episode_and_has_a_picture_for_every_state() {
    let config = config(true);
    let episode = recorded(&config, 2, &WAY);
    let fixed = config.evaluation_plan().unwrap().dealt(episode.environment, 2).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let images = ReplayImages { folder: folder.path().display().to_string(), format: ImageFormat::Apng, side: 96 };
    let verdict = replay(&config, Some(images), &[episode]).remove(0);
    assert_eq!((verdict.images, verdict.first_difference), (5, None));
    let files: Vec<String> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    let target = proto::evaluation::category_of(fixed).name();
    let kitchen = config.kitchens().of_actor(0).unwrap().number();
    assert_eq!(files, [format!("kitchen-{kitchen:02}-episode-{fixed:03}-{target}-failure.png")]);
    let file = std::fs::File::open(folder.path().join(&files[0])).unwrap();
    let reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    assert_eq!(reader.info().animation_control().unwrap().num_frames, 5);
}
