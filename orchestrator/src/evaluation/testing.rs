//! Records and events for tests.

use proto::config::Config;
use proto::evaluation::{
    Conditions, Cost, EpisodeRecord, Evaluation, EvaluationConfig, ObjectSet, Subject, category_of,
};
use proto::event::LearnerEvent;
use proto::kitchen::{KitchenId, Split};
use proto::record::End;
use proto::run_state::RunState;
use report::study::{Evaluated, Origin, Run};

/// An episode of one step, of the default task; of its numbers these are 1, the others 0.
pub fn played(kitchen: KitchenId, episode: u32, ones: &[&str]) -> EpisodeRecord {
    let columns = Config::default().spec().columns();
    EpisodeRecord {
        kitchen,
        episode,
        category: Some(category_of(episode)),
        end: End::Terminated,
        length: 1,
        numbers: columns.iter().map(|one| Some(f64::from(u8::from(ones.contains(&one.name.as_str()))))).collect(),
        prediction: None,
        state_hash: 0,
    }
}

/// The result of an evaluation of one episode.
pub fn result_of(config: &Config, asked: &EvaluationConfig, record: &EpisodeRecord) -> Evaluation {
    let conditions = Conditions::of(config, asked, "cpu".to_owned());
    let records = [(record.clone(), vec![20])];
    Evaluation::of(config.spec(), Subject::default(), conditions, Cost::default(), &records)
}

/// A run of the demonstration with this seed and clip, which has trained nothing, and evaluations of it.
pub fn run(name: &str, seed: u64, clip: f64, deterministic: &[bool]) -> Run {
    let mut config = Config { seed, ..Config::resolve("demo", None).unwrap() };
    config.ppo.clip = clip;
    let evaluated = |&deterministic: &bool| {
        let asked = EvaluationConfig { deterministic, ..EvaluationConfig::fixed(Split::Test, ObjectSet::Novel, 1) };
        let record = played(KitchenId::of_split(Split::Test)[0], 6, &["success"]);
        let (name, result) = (format!("deterministic-{deterministic}"), result_of(&config, &asked, &record));
        Evaluated { folder: name.clone().into(), name, result, episodes: vec![record] }
    };
    let evaluations = deterministic.iter().map(evaluated).collect();
    let (rollouts, stages, validation) = (Vec::new(), Vec::new(), Vec::new());
    Run {
        name: name.to_owned(),
        origin: Origin::Run(RunState::NotStarted),
        config,
        rollouts,
        stages,
        evaluations,
        validation,
    }
}

/// A learner without a checkpoint is ready.
pub fn ready(rank: u32, rollout: u64, frames: u64) -> LearnerEvent {
    let device = "cpu".to_owned();
    LearnerEvent::Ready { rank, rollout, frames, device, parameters: 1, checkpoint: None }
}
