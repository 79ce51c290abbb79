//! `actor soak`: many random actions in many kitchens, watched at every sub-step of physics. Nothing may tunnel,
//! nothing may explode.

use anyhow::{Context, Result, ensure};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::random::{Key, Purpose};
use simulator::kitchen::Kitchen;
use simulator::physics::watch::Extremes;
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::check;
use std::io::Write;
use std::sync::Arc;

/// Nothing may be faster than this, metres per second. Velocities are held below it by [`simulator::physics::world`];
/// what passes it is a thing that was put somewhere else between two sub-steps.
pub const SPEED_LIMIT_M_PER_S: f32 = 10.0;
/// Nothing may stand this deep in a fixed thing, metres. Pressed by the robot, which nothing can hold back, things do
/// enter what is behind them until the motion is stopped for it.
pub const DEPTH_LIMIT_M: f32 = 0.05;
/// An action is taken up to this many times on end: steps of which each undoes the last lead nowhere and touch little.
const REPEATS_MOST: u32 = 8;

#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Report {
    pub steps: u64,
    pub episodes: u64,
    /// Actions after which some thing other than the target was further from its place than before, or nearer to it.
    pub disturbing_steps: u64,
    pub extremes: Extremes,
}

impl Report {
    pub fn failures(&self) -> Vec<String> {
        let Extremes { fastest_m_per_s, deepest_in_fixed_m, left_room, not_finite, .. } = self.extremes;
        let mut failures = Vec::new();
        if fastest_m_per_s >= SPEED_LIMIT_M_PER_S {
            failures.push(format!("{fastest_m_per_s:.1} m/s"));
        }
        if deepest_in_fixed_m >= DEPTH_LIMIT_M {
            failures.push(format!("{:.0} mm inside a fixed thing", 1e3 * deepest_in_fixed_m));
        }
        if left_room > 0 {
            failures.push(format!("{left_room} left the room"));
        }
        if not_finite > 0 {
            failures.push(format!("{not_finite} not finite"));
        }
        failures
    }

    fn merge(&mut self, other: &Self) {
        self.steps += other.steps;
        self.episodes += other.episodes;
        self.disturbing_steps += other.disturbing_steps;
        self.extremes.merge(&other.extremes);
    }
}

/// Takes `steps` random actions in a kitchen, each once or several times on end: all actions but Done, which would only
/// cut episodes short.
pub fn soak(kitchen: &Arc<Kitchen>, steps: u64, seed: u64, config: &Config) -> Result<Report> {
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let config = Config { seed, ..config.clone() };
    let mut environment = Environment::new(Arc::clone(kitchen), id, &config)?;
    environment.watch();
    let lasting: Vec<Action> = Action::ALL.into_iter().filter(|&action| action != Action::DoneMidLevel).collect();
    let mut report = Report { steps, episodes: 1, ..Report::default() };
    let (mut episode, mut step) = (0, 0);
    let (mut action, mut repeats) = (Action::LookDown, 0);
    for _ in 0..steps {
        if repeats == 0 {
            let kitchen = id.kitchen.number();
            let key = Key { seed, purpose: Purpose::RandomPolicy, kitchen, environment: 0, episode, step };
            let mut random = key.stream();
            action = lasting[random.below(lasting.len() as u32) as usize];
            repeats = 1 + random.below(REPEATS_MOST);
        }
        repeats -= 1;
        let transition = environment.step(action);
        check(config.spec(), &transition, &environment.current()).context("a learner would refuse a report")?;
        report.disturbing_steps += u64::from(transition.disturbance_progress_m != 0.0);
        step += 1;
        if environment.ended() {
            report.extremes.merge(environment.simulation().extremes().context("nobody watched the episode")?);
            (episode, step) = (episode + 1, 0);
            environment.start_episode(episode);
            environment.watch();
            report.episodes += 1;
        }
    }
    report.extremes.merge(environment.simulation().extremes().context("nobody watched the episode")?);
    Ok(report)
}

/// Spreads `steps` over the kitchens and prints a line for each, the totals last. An error if anything is wrong.
pub fn run(kitchens: &[KitchenId], steps: u64, seed: u64) -> Result<()> {
    ensure!(!kitchens.is_empty() && steps >= kitchens.len() as u64, "a soak takes one step a kitchen at least");
    let config = Config::default();
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:>7} {:>9} {:>9} {:>10} {:>11} {:>12} {:>10} {:>9} {:>11}",
        "kitchen",
        "steps",
        "episodes",
        "disturbing",
        "sub-steps",
        "fastest m/s",
        "deepest mm",
        "left room",
        "not finite"
    )?;
    let mut line = |name: &str, report: &Report| {
        let Extremes { substeps, fastest_m_per_s, deepest_in_fixed_m, left_room, not_finite } = report.extremes;
        writeln!(
            out,
            "{name:>7} {:>9} {:>9} {:>10} {substeps:>11} {fastest_m_per_s:>12.2} {:>10.1} {left_room:>9} {not_finite:>11}  {}",
            report.steps,
            report.episodes,
            report.disturbing_steps,
            1e3 * deepest_in_fixed_m,
            report.failures().join(", ")
        )
    };
    let mut totals = Report::default();
    let mut failed = 0;
    for (index, &id) in (0..).zip(kitchens) {
        let count = kitchens.len() as u64;
        let share = steps * (index + 1) / count - steps * index / count;
        let kitchen = Arc::new(Kitchen::build(id, &config.simulation)?);
        let report = soak(&kitchen, share, seed, &config)?;
        line(&id.to_string(), &report)?;
        failed += usize::from(!report.failures().is_empty());
        totals.merge(&report);
    }
    line("all", &totals)?;
    ensure!(failed == 0, "{failed} of {} kitchens failed the soak", kitchens.len());
    Ok(())
}
