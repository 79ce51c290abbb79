//! `actor oracle`: runs the oracle on episodes and prints its results, one line per kitchen.

use crate::arguments::numbered;
use crate::parallel::in_parallel;
use anyhow::{Context, Result, ensure};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenId, Split};
use proto::task::Spec;
use simulator::kitchen::Kitchen;
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::episode::Episode;
use simulator::tasks::arm_point_nav::oracle::{Policy, Variant};
use simulator::tasks::arm_point_nav::{Current, Environment, Transition, check, record};
use std::io::Write;
use std::sync::Arc;

#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    pub actions: Vec<Action>,
    pub picked_up: bool,
    pub success: bool,
    /// And nothing else was disturbed: the task's headline.
    pub undisturbed: bool,
    /// Things that moved by more than 1 cm on an axis.
    pub disturbed_objects: u32,
    pub state_hash: u64,
}

pub fn play(kitchen: &Arc<Kitchen>, config: &Config, number: u32, episode: Episode, variant: Variant) -> Outcome {
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let mut environment = Environment::with_episode(Arc::clone(kitchen), id, config, number, episode);
    let mut policy = Policy::new(variant);
    let mut actions = Vec::new();
    loop {
        let action = policy.next(&environment);
        actions.push(action);
        let transition = environment.step(action);
        check(config.spec(), &transition, &environment.current()).expect("a learner takes what a simulator reports");
        if environment.ended() {
            return Outcome {
                actions,
                picked_up: transition.holds(),
                success: transition.succeeded(),
                undisturbed: is_undisturbed(config.spec(), &transition),
                disturbed_objects: transition.disturbed_objects,
                state_hash: environment.state_hash(),
            };
        }
    }
}

/// Whether the task's headline holds after the last step.
fn is_undisturbed(spec: &Spec, last: &Transition) -> bool {
    let headline = spec.ranking().first().and_then(|headline| spec.rollout_metrics().find(|(one, _)| one == headline));
    let record = record(spec, last, &Current::default());
    headline.is_some_and(|(_, measure)| measure.after(|index| spec.layout().fields[index].number(&record), 0.0) != 0.0)
}

/// What `actor oracle` is asked.
#[derive(Debug, Clone, clap::Args)]
pub struct Settings {
    /// Kitchens to play in: train, validation or test.
    #[arg(long, value_parser = split, default_value = "test", value_name = "SPLIT")]
    pub split: Split,
    /// Play in one kitchen only, whatever its split.
    #[arg(long, value_parser = numbered, conflicts_with = "split", value_name = "1..30")]
    pub kitchen: Option<KitchenId>,
    /// How it goes about it.
    #[arg(long, value_parser = variant(), default_value = "fast")]
    pub variant: Variant,
    /// Episodes in each kitchen.
    #[arg(long, default_value_t = 720, value_name = "N")]
    pub episodes: u32,
}

fn variant() -> impl TypedValueParser<Value = Variant> {
    PossibleValuesParser::new(Variant::ALL.map(Variant::name))
        .map(|name| Variant::named(&name).expect("the parser takes the names of variants only"))
}

fn split(text: &str) -> Result<Split, String> {
    match text {
        "train" => Ok(Split::Train),
        "validation" => Ok(Split::Validation),
        "test" => Ok(Split::Test),
        _ => Err(format!("`{text}` is none of train, validation, test")),
    }
}

pub fn run(settings: &Settings) -> Result<()> {
    ensure!(settings.episodes > 0, "play at least one episode");
    let config = Config::default();
    let kitchens = settings.kitchen.map_or_else(|| KitchenId::of_split(settings.split), |kitchen| vec![kitchen]);
    let mut out = std::io::stdout().lock();
    let variant = settings.variant.name();
    writeln!(
        out,
        "{:>8}  {:>8}  {:>8}  {:>6}  {:>6}  {:>9}  {:>6}  {:>11}  {:>9}",
        "kitchen", "variant", "episodes", "SR", "SRwoD", "SRwoD/SR", "length", "picked up", "disturbed"
    )?;
    let built = in_parallel(kitchens.len(), |index| Kitchen::build(kitchens[index], &config.simulation));
    let mut all = Vec::new();
    for kitchen in built {
        let kitchen = Arc::new(kitchen?);
        let episodes = episodes(&kitchen, &config, settings)?;
        let outcomes = in_parallel(episodes.len(), |index| {
            play(&kitchen, &config, index as u32, episodes[index], settings.variant)
        });
        line(&mut out, &kitchen.id().to_string(), variant, &outcomes)?;
        all.extend(outcomes);
    }
    line(&mut out, "all", variant, &all)
}

/// The first episodes of a kitchen: fixed ones where it has them, sampled ones in training kitchens.
fn episodes(kitchen: &Kitchen, config: &Config, settings: &Settings) -> Result<Vec<Episode>> {
    let count = settings.episodes as usize;
    if kitchen.id().split() == Split::Train {
        let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
        let sample = |number| Episode::sample(kitchen, &config.episode, config.seed, id, number);
        return Ok((0..settings.episodes).map(sample).collect());
    }
    let mut fixed = simulator::tasks::arm_point_nav::episodes::fixed(kitchen)?;
    ensure!(count <= fixed.len(), "kitchen {} has {} fixed episodes, not {count}", kitchen.id(), fixed.len());
    fixed.truncate(count);
    Ok(fixed)
}

fn line(out: &mut impl Write, name: &str, variant: &str, outcomes: &[Outcome]) -> Result<()> {
    let count = outcomes.len() as f64;
    let share =
        |test: &dyn Fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| test(outcome)).count() as f64 / count;
    let success = share(&|outcome| outcome.success);
    let undisturbed = share(&|outcome| outcome.undisturbed);
    let picked_up = share(&|outcome| outcome.picked_up);
    let length = outcomes.iter().map(|outcome| outcome.actions.len()).sum::<usize>() as f64 / count;
    let disturbed = outcomes.iter().map(|outcome| f64::from(outcome.disturbed_objects)).sum::<f64>() / count;
    let ratio = if success > 0.0 { undisturbed / success } else { 0.0 };
    writeln!(
        out,
        "{name:>8}  {variant:>8}  {:>8}  {success:>6.3}  {undisturbed:>6.3}  {ratio:>9.3}  {length:>6.1}  {picked_up:>11.3}  {disturbed:>9.2}",
        outcomes.len()
    )
    .context("cannot write the table")?;
    Ok(out.flush()?)
}
