//! A made-up study.

use proto::config::Config;
use proto::evaluation::{
    Conditions, Confusion, Cost, Distribution, EPISODES_PER_KITCHEN, EpisodeRecord, Evaluation, EvaluationConfig,
    ObjectSet, Subject, category_of,
};
use proto::kitchen::{KitchenId, Split};
use proto::metric;
use proto::random::{Key, Purpose, Random};
use proto::record::End;
use proto::run_state::{Ending, RunState};
use report::study::{Evaluated, Origin, Rollout, Run, Validated};
use std::collections::BTreeMap;
use std::path::PathBuf;

fn random(seed: u64, kitchen: u32, episode: u32) -> Random {
    Key { seed, purpose: Purpose::RandomPolicy, kitchen, environment: 0, episode, step: 0 }.stream()
}

/// An episode that succeeds with chance `skill`, and disturbs less the larger `care` is.
fn episode(config: &Config, kitchen: KitchenId, episode: u32, skill: f64, care: f64) -> (EpisodeRecord, Vec<u8>) {
    let mut draw = random(config.seed, kitchen.number(), episode);
    let success = draw.uniform_open() < skill * (0.8 + 0.1 * f64::from(kitchen.number() % 5));
    let disturbance_m = if draw.uniform_open() < care { 0.0 } else { 0.002 * (1.0 / draw.uniform_open()).powf(1.7) };
    let length = if success { 40 + draw.below(100) } else { 200 };
    let actions = (0..length)
        .map(|step| {
            if success && step + 1 == length {
                return 20;
            }
            let drive = step < 30 + draw.below(20);
            if drive { 16 + draw.below(3) as u8 } else { draw.below(19) as u8 }
        })
        .collect();
    let disturbed_objects = if disturbance_m < 0.01 { 0 } else { 1 + (disturbance_m * 4.0) as u32 };
    let flag = |set: bool| f64::from(u8::from(set));
    let return_r = if success { 14.0 } else { -1.0 };
    let numbers = BTreeMap::from([
        ("return_r", return_r),
        ("return_r_prime", return_r - 15.0 * disturbance_m),
        ("success", flag(success)),
        ("success_without_disturbance", flag(success && disturbance_m < 0.01)),
        ("success_without_disturbance_per_axis", flag(success && disturbed_objects == 0)),
        ("success_but_unsafe", flag(success && disturbed_objects > 0)),
        ("picked_up", flag(success || draw.uniform_open() < 0.3)),
        ("failed_actions", f64::from(length / 9)),
        ("disturbance_m", disturbance_m.min(9.0)),
        ("disturbed_objects", disturbed_objects.into()),
        ("ever_disturbed_objects", f64::from(disturbed_objects) + flag(draw.uniform_open() < 0.1)),
        ("peak_farthest_m", 0.4),
        ("disturbing_steps", disturbed_objects.into()),
        ("displaced_steps", f64::from(disturbed_objects) * 20.0),
        ("object_goal_m", if success { 0.04 } else { 0.9 }),
    ]);
    let number = |name: &str| Some(numbers.get(name).copied().unwrap_or(0.0));
    let record = EpisodeRecord {
        kitchen,
        episode,
        category: Some(category_of(episode)),
        end: if success { End::Terminated } else { End::Truncated },
        length,
        numbers: config.spec().columns().iter().map(|column| number(&column.name)).collect(),
        prediction: Some(Confusion { hits: 4, misses: 3, false_alarms: 6, quiet: u64::from(length) }),
        state_hash: 7,
    };
    (record, actions)
}

fn evaluated(config: &Config, split: Split, objects: ObjectSet, skill: f64, care: f64) -> Evaluated {
    let records: Vec<_> = KitchenId::of_split(split)
        .into_iter()
        .flat_map(|kitchen| (0..EPISODES_PER_KITCHEN).map(move |number| (kitchen, number)))
        .filter(|&(_, number)| objects.contains(category_of(number)))
        .map(|(kitchen, number)| episode(config, kitchen, number, skill, care))
        .collect();
    let subject = Subject {
        preset: config.preset.clone(),
        seed: config.seed,
        run: Some("runs/x".into()),
        run_id: None,
        checkpoint: Some("checkpoints/rollout-00000120.json".into()),
        frames: config.stages.iter().map(|stage| stage.frames).sum(),
        weights: format!("{:064x}", config.seed),
        parameters: 5_800_000,
    };
    let asked = EvaluationConfig::fixed(split, objects, 0);
    let conditions = Conditions::of(config, &asked, "cpu, 1 thread".into());
    let result = Evaluation::of(config.spec(), subject, conditions, Cost::default(), &records);
    let episodes = records.into_iter().map(|(record, _)| record).collect();
    let split = if split == Split::Test { "test" } else { "validation" };
    let name = format!("20261121-{split}-{}", objects.name());
    Evaluated { folder: PathBuf::from("runs/x/evaluations").join(&name), name, result, episodes }
}

fn rollouts(config: &Config, ceiling: f64) -> Vec<Rollout> {
    let budget: u64 = config.stages.iter().map(|stage| stage.frames).sum();
    (1..=300)
        .map(|index| {
            let frames = budget * index / 300;
            let part = index as f64 / 300.0;
            let mut draw = random(config.seed, 0, index as u32);
            let success = ceiling * (1.0 - (-4.0 * part).exp()) * (0.9 + 0.2 * draw.uniform_open());
            let metrics = [
                (metric::EPISODES, 19.0),
                (metric::RETURN, 14.0 * success - 1.0),
                ("episode/success", success),
                ("episode/success_without_disturbance", success * (0.4 + 0.2 * part)),
                ("episode/disturbance_m", 0.4 - 0.25 * part + 0.05 * draw.uniform_open()),
                ("auxiliary/precision", 0.1 + 0.5 * part + 0.05 * draw.uniform_open()),
                ("auxiliary/recall_disturb", 0.2 + 0.4 * part + 0.05 * draw.uniform_open()),
                ("auxiliary/recall_no_disturb", 0.99 - 0.02 * part),
                ("auxiliary/label_rate", 0.05 - 0.02 * part),
                (metric::ENTROPY, 3.0 - 1.5 * part + 0.1 * draw.uniform_open()),
                (metric::APPROXIMATE_KL, 0.002 + 0.004 * draw.uniform_open()),
                (metric::VALUE_LOSS, 0.5 - 0.4 * part + 0.2 * draw.uniform_open()),
                (metric::GRADIENT_NORM, if index == 1 { 40.0 } else { 0.5 + 0.5 * draw.uniform_open() }),
            ];
            let metrics = BTreeMap::from(metrics.map(|(name, value)| (name.to_owned(), value)));
            let frames_per_s = Some(2000.0 + 200.0 * draw.uniform_open());
            Rollout { frames, frames_per_s, elapsed_s: frames as f64 / 2100.0, metrics: metrics.into() }
        })
        .collect()
}

/// A made-up run of a preset: its skill, and how seldom it disturbs.
pub fn run(preset: &str, seed: u64, (skill, care): (f64, f64)) -> Run {
    let config = Config { seed, ..Config::resolve(preset, None).expect("a preset") };
    let luck = 0.02 * seed as f64;
    let validation = (1..=9).map(|index| {
        let success = skill * index as f64 / 9.0;
        let figures = [("success", success - luck), ("success_without_disturbance", care * success - luck)];
        Validated {
            frames: index * 5_000_000,
            distribution: Distribution::Fixed,
            figures: figures.map(|(name, share)| (name.to_owned(), share)).into(),
        }
    });
    Run {
        name: format!("runs/{preset}-{seed}"),
        origin: Origin::Run(RunState::Ended(Ending::Complete)),
        rollouts: rollouts(&config, skill - luck),
        stages: Vec::new(),
        evaluations: [
            (Split::Test, ObjectSet::Novel, skill),
            (Split::Test, ObjectSet::Seen, skill + 0.02),
            (Split::Validation, ObjectSet::Novel, skill - 0.05),
        ]
        .map(|(split, objects, skill)| evaluated(&config, split, objects, skill - luck, care))
        .into(),
        validation: validation.filter(|point| point.figures["success_without_disturbance"] > 0.0).collect(),
        config,
    }
}

/// Several presets with several seeds, evaluated on everything.
pub fn study() -> Vec<Run> {
    let mut runs = Vec::new();
    for (preset, seeds, found) in [
        ("disturb-two-stage", 5, (0.8, 0.55)),
        ("none-two-stage", 3, (0.75, 0.5)),
        ("disturb-stage1-45m", 2, (0.8, 0.3)),
        ("disturb-scratch-45m", 1, (0.12, 0.6)),
        ("lambda-1", 2, (0.82, 0.35)),
        ("lambda-5", 2, (0.82, 0.45)),
        ("lambda-25", 2, (0.7, 0.6)),
        ("small-none", 1, (0.7, 0.25)),
    ] {
        runs.extend((1..=seeds).map(|seed| run(preset, seed, found)));
    }
    let mut untrained = run("recipe", 1, (0.02, 0.3));
    untrained.origin = Origin::Untrained;
    untrained.rollouts.clear();
    untrained.validation.clear();
    runs.push(untrained);
    runs
}
