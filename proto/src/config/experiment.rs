//! The paper's experiments as presets: every row of its tables by name (`docs/method.md`, Experiments), composed from
//! what the rows have in common.
//!
//! ```text
//! {original, none, cpca16, inverse-dynamics, disturb} - {stage1-20m, stage1-45m, scratch-45m, two-stage, stage2-25m}
//! ablation - {cnn, resnet} - {normalized, plain} - {no-action, action} - {cartesian, polar}    the twelve of the table
//! small - {original, none, disturb, disturb-two-stage}                                        A_small; the others are A_large
//! lambda - {0, 1, 5, 10, 15, 20, 25}                                                             λ_disturb of stage II
//! lagrangian - {1, 15}                                                                        λ_0 of PPO-Lagrangian
//! ```

use super::preset::Preset;

/// Auxiliary tasks, and their names in the paper.
const TASKS: [(&str, &str, &str); 5] = [
    ("original", "none", "the original baseline (small encoder, cartesian goal, normalised advantages)"),
    ("none", "none", "no auxiliary task"),
    ("cpca16", "cpca16", "CPC|A, 16 steps"),
    ("inverse-dynamics", "inverse_dynamics", "inverse dynamics"),
    ("disturb", "disturb", "disturbance prediction"),
];

/// Rewards and frames.
const PLANS: [(&str, &[Stage], &str); 5] = [
    ("stage1-20m", &[("I", "r", 20_000_000)], "reward r, 20M frames"),
    ("stage1-45m", &[("I", "r", 45_000_000)], "reward r, 45M frames"),
    ("scratch-45m", &[("I", "r_prime", 45_000_000)], "reward r′ from scratch, 45M frames"),
    ("two-stage", &TWO_STAGES, "reward r for 20M frames, then r′ for 25M"),
    ("stage2-25m", &[("II", "r_prime", 25_000_000)], "reward r′, 25M frames, on the weights of a stage I (--from)"),
];

/// Name, reward, frames.
type Stage = (&'static str, &'static str, u64);

const STAGE_ONE: [Stage; 1] = [("I", "r", 20_000_000)];
const TWO_STAGES: [Stage; 2] = [("I", "r", 20_000_000), ("II", "r_prime", 25_000_000)];

/// Rows of the ablation table: encoder, normalised advantages, previous action, polar goal. All with `A_small`.
const ABLATIONS: [(&str, bool, bool, bool); 12] = [
    ("cnn", true, false, false),
    ("cnn", false, false, false),
    ("cnn", false, true, false),
    ("cnn", true, true, true),
    ("cnn", false, false, true),
    ("cnn", false, true, true),
    ("resnet", true, false, false),
    ("resnet", false, false, false),
    ("resnet", false, true, false),
    ("resnet", true, true, true),
    ("resnet", false, false, true),
    ("resnet", false, true, true),
];

const LAMBDAS: [u32; 7] = [0, 1, 5, 10, 15, 20, 25];

const MULTIPLIERS: [u32; 2] = [1, 15];
const LAGRANGIAN: [Stage; 1] = [("I", "lagrangian", 45_000_000)];

/// Model selection: 45 evaluations in 45M frames.
const VALIDATION: &str = "validation.every_frames = 1_000_000\n";

/// The network and advantages of one row.
fn method(encoder: &str, normalized: bool, previous_action: bool, polar: bool) -> String {
    // The paper pools frames before its own encoder only.
    let (pool, goal) = (if encoder == "resnet" { 2 } else { 1 }, if polar { "polar" } else { "cartesian" });
    format!(
        "network.encoder = \"{encoder}\"\nnetwork.input_pool = {pool}\nnetwork.goal = \"{goal}\"\n\
         network.previous_action = {previous_action}\nppo.normalize_advantages = {normalized}\n"
    )
}

fn task_of(task: &str) -> String {
    format!("auxiliary.task = \"{task}\"\n")
}

fn stages(stages: &[Stage]) -> String {
    let table = |(name, reward, frames): &Stage| {
        format!("[[stages]]\nname = \"{name}\"\nreward = \"{reward}\"\nframes = {frames}\n")
    };
    stages.iter().map(table).collect::<Vec<_>>().concat()
}

fn preset(name: String, summary: String, settings: &[String]) -> Preset {
    // Dotted keys first: what follows a table's header belongs to the table.
    Preset { name, summary, text: format!("{VALIDATION}{}", settings.concat()).into() }
}

/// All of them, in the order above.
pub(super) fn all() -> Vec<Preset> {
    let original = method("cnn", true, false, false);
    let small = "episode.action_space = \"small\"\n".to_owned();
    let network_of = |name: &str| if name == "original" { original.clone() } else { String::new() };
    let mut presets = Vec::new();
    for (name, task, what) in TASKS {
        for (plan, plan_stages, how) in PLANS {
            presets.push(preset(
                format!("{name}-{plan}"),
                format!("{what}; {how}"),
                &[network_of(name), task_of(task), stages(plan_stages)],
            ));
        }
    }
    for (encoder, normalized, previous_action, polar) in ABLATIONS {
        let advantages = if normalized { "normalized" } else { "plain" };
        let action = if previous_action { "action" } else { "no-action" };
        let goal = if polar { "polar" } else { "cartesian" };
        presets.push(preset(
            format!("ablation-{encoder}-{advantages}-{action}-{goal}"),
            format!("ablation: {encoder}, {advantages} advantages, {action} input, {goal} goal; reward r, 20M frames"),
            &[small.clone(), method(encoder, normalized, previous_action, polar), task_of("none"), stages(&STAGE_ONE)],
        ));
    }
    for (name, task, plan_stages) in [
        ("original", "none", &STAGE_ONE[..]),
        ("none", "none", &STAGE_ONE),
        ("disturb", "disturb", &STAGE_ONE),
        ("disturb-two-stage", "disturb", &TWO_STAGES),
    ] {
        presets.push(preset(
            format!("small-{name}"),
            format!("the 13 actions of A_small; {name}"),
            &[small.clone(), network_of(name), task_of(task), stages(plan_stages)],
        ));
    }
    for lambda in LAMBDAS {
        presets.push(preset(
            format!("lambda-{lambda}"),
            format!("two stages with disturbance prediction, λ_disturb = {lambda}"),
            &[task_of("disturb"), format!("reward.lambda_disturb = {lambda}.0\n"), stages(&TWO_STAGES)],
        ));
    }
    for initial in MULTIPLIERS {
        presets.push(preset(
            format!("lagrangian-{initial}"),
            format!("PPO-Lagrangian, λ₀ = {initial}; no auxiliary task, 45M frames"),
            &[task_of("none"), format!("reward.lagrangian.initial = {initial}.0\n"), stages(&LAGRANGIAN)],
        ));
    }
    presets
}

#[cfg(test)]
mod tests {
    use super::super::{CarriedGoal, Config};
    use super::*;
    use std::collections::BTreeSet;

    fn config(name: &str) -> Config {
        Config::resolve(name, None).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    #[test]
    fn every_row_of_the_papers_tables_is_a_preset_of_its_own() {
        let all = all();
        assert_eq!(all.len(), 5 * 5 + 12 + 4 + 7 + 2);
        let mut contents = BTreeSet::new();
        for preset in &all {
            let mut config = config(&preset.name);
            assert_eq!(config.environments(), 19);
            config.preset.clear();
            if !contents.insert(config.to_toml()) {
                // The paper's tables share these rows.
                assert!(
                    ["lambda-15", "small-original", "small-none", "ablation-resnet-plain-action-polar"]
                        .contains(&preset.name.as_str()),
                    "{} repeats another",
                    preset.name
                );
            }
        }
    }

    /// Presets with the paper's constants have the reference's sign and learning-rate schedule; presets with own
    /// results keep theirs.
    #[test]
    fn every_row_has_the_references_sign_and_rate() {
        let names = all().into_iter().map(|preset| preset.name).chain(["paper".to_owned()]);
        let reference = (CarriedGoal::GoalToObject, 30_000_000);
        for name in names {
            let config = config(&name);
            assert_eq!((config.network.carried_goal, config.ppo.learning_rate_frames), reference, "{name}");
        }
        for name in ["demo", "recipe", "short-two-stage", "short-r-only", "short-scratch"] {
            let config = config(name);
            let own = (CarriedGoal::ObjectToGoal, 0);
            assert_eq!((config.network.carried_goal, config.ppo.learning_rate_frames), own, "{name}");
        }
    }
}
