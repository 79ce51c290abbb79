//! Episodes as `actor replay` is given them.

use super::*;
use proto::evaluation::{EvaluationConfig, ObjectSet};
use proto::kitchen::Split;
use proto::replay::{Difference, ImageFormat};
use simulator::robot::action::Action;

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
    let (id, rules) = (first_kitchen(config), Rules::of(config).unwrap());
    let kitchen = Arc::new(source::of_run(id.kitchen, config, &PathBuf::new()).unwrap());
    let mut environment = tasks::open(&tasks::Run::of(config), &kitchen, id, episode).unwrap();
    let actions: Vec<u8> = actions.iter().map(|action| action.index()).collect();
    let hashes = vec![0; actions.len()];
    let (digests, start) = (vec![], vec![]);
    let mut recorded = RecordedEpisode { environment: id, episode, start_hash: None, actions, hashes, digests, start };
    let bare = recorded.clone();
    let (mut seen, mut step) = (vec![], 0);
    play(&rules, &mut *environment, &bare, |environment, moment| {
        match moment.rewards {
            None => {
                recorded.start_hash = Some(environment.base().state_hash());
                recorded.start = rules.compared.start(moment.record);
            }
            Some(rewards) => {
                recorded.hashes[step] = environment.base().state_hash();
                step += 1;
                let end = environment.base().end();
                rules.compared.step(Some(&seen), moment.record, rewards, end, &mut recorded.digests);
            }
        }
        seen = moment.record.to_vec();
        anyhow::Ok(())
    })
    .unwrap();
    recorded
}

fn replay(config: &Config, images: Option<ReplayImages>, episodes: &[RecordedEpisode]) -> Vec<ReplayVerdict> {
    let mut drawn = 0;
    let verdict = |line| match line {
        ReplayLine::Verdict(verdict) => Some(*verdict),
        ReplayLine::Drawn { drawn: more } => {
            drawn += more;
            None
        }
    };
    let verdicts: Vec<ReplayVerdict> = lines(config, images, episodes).into_iter().filter_map(verdict).collect();
    assert_eq!(drawn, verdicts.iter().map(|verdict| verdict.images).sum::<u64>());
    verdicts
}

fn lines(config: &Config, images: Option<ReplayImages>, episodes: &[RecordedEpisode]) -> Vec<ReplayLine> {
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

/// Whatever number of a recording is another one, it is found and called by its name: that of a channel, of a reward, or
/// the end.
#[test]
fn every_recorded_number_is_compared_and_named() {
    let config = config(false);
    let good = recorded(&config, 3, &WAY);
    let compared = Rules::of(&config).unwrap().compared;
    let names: Vec<String> = compared.names().collect();
    let (count, of_start) = (names.len(), compared.start_count());
    assert_eq!((good.digests.len(), good.start.len()), (count * WAY.len(), of_start));
    let altered = (0..count).map(|at| {
        let mut wrong = good.clone();
        wrong.digests[2 * count + at] ^= 1;
        wrong
    });
    let of_state = RecordedEpisode { hashes: vec![1; WAY.len()], ..good.clone() };
    let unknown = RecordedEpisode { digests: vec![0; count * WAY.len()], start: vec![], ..good.clone() };
    let all: Vec<RecordedEpisode> = altered.chain([of_state, unknown, good.clone()]).collect();
    let mut verdicts = replay(&config, None, &all).into_iter().map(|verdict| verdict.first_difference);
    let mut next = || verdicts.next().unwrap();
    for (at, name) in names.iter().enumerate() {
        let step = if compared.is_seen(at) { 2 } else { 3 };
        assert_eq!(next(), Some(Difference { step, what: name.clone() }));
    }
    assert_eq!(next(), Some(Difference { step: 1, what: "state".to_owned() }));
    assert_eq!([next(), next()], [None, None], "what was not recorded is no difference");

    let starts = (0..of_start).filter(|&at| compared.is_seen(at));
    let altered: Vec<RecordedEpisode> = starts
        .clone()
        .map(|at| {
            let mut wrong = good.clone();
            wrong.start[at] ^= 1;
            wrong
        })
        .collect();
    let verdicts = replay(&config, None, &altered).into_iter().map(|verdict| verdict.first_difference.unwrap());
    let expected = starts.map(|at| Difference { step: 0, what: names[at].clone() });
    assert_eq!(verdicts.collect::<Vec<_>>(), expected.collect::<Vec<_>>());
}

#[test]
fn a_film_of_an_episode_that_diverges_announces_the_pictures_that_it_has() {
    let config = config(false);
    let mut longer = recorded(&config, 3, &WAY);
    for _ in 0..20 {
        longer.actions.push(Action::LookUp.index());
        longer.hashes.push(1);
    }
    longer.digests.clear();
    let folder = tempfile::tempdir().unwrap();
    let images = ReplayImages { folder: folder.path().display().to_string(), format: ImageFormat::Apng, side: 48 };
    let verdict = replay(&config, Some(images), &[longer]).remove(0);
    assert_eq!(verdict.images, 5);
    assert_eq!(verdict.first_difference, Some(Difference { step: 5, what: "length".to_owned() }));
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
