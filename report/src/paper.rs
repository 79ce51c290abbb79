//! The paper's own figures, for comparison with ours: Ni et al. (WACV 2023), tables 1 to 3 and their supplement.

use serde::{Deserialize, Serialize};
use std::sync::LazyLock;

pub(crate) const METRICS: [&str; 2] = ["success", "success_without_disturbance"];

/// All tables. Rates are percentages.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Paper {
    pub source: String,
    pub test_novel: Vec<ResultRow>,
    pub test_seen: Vec<ResultRow>,
    /// Parts of the method, 20M frames of stage I, validation kitchens, novel targets.
    #[serde(rename = "ablation_valid_novel_20M")]
    pub ablation_valid_novel_20m: Vec<AblationRow>,
    pub action_space_valid: Vec<ActionSpaceRow>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResultRow {
    /// `I`, `II`, or PPO-Lagrangian with its first multiplier.
    pub stage: String,
    pub reward: String,
    pub init: String,
    pub frames: String,
    pub aux: String,
    pub sr: f64,
    /// SR, mean of the middle three seeds.
    #[serde(default)]
    pub sr_iqm: Option<f64>,
    pub srwod: f64,
    #[serde(default)]
    pub srwod_iqm: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AblationRow {
    /// `cnn` or `resnet`.
    pub encoder: String,
    pub normalized_advantage: bool,
    pub previous_action: bool,
    /// `cartesian` or `polar`.
    pub goal: String,
    pub sr: f64,
    pub srwod: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActionSpaceRow {
    pub action_space: String,
    /// `r` or `r'`.
    pub reward: String,
    /// `scratch` or `finetune`.
    pub init: String,
    /// Auxiliary task; `none_original` is the original baseline.
    pub aux: String,
    pub sr: f64,
    pub srwod: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Published {
    pub success: f64,
    pub success_iqm: Option<f64>,
    pub success_without_disturbance: f64,
    pub success_without_disturbance_iqm: Option<f64>,
}

pub fn paper() -> &'static Paper {
    static PAPER: LazyLock<Paper> =
        LazyLock::new(|| serde_json::from_str(include_str!("paper_results.json")).expect("our own file, as tested"));
    &PAPER
}

fn task(aux: &str) -> String {
    if aux == "none_original" { "original".to_owned() } else { aux.replace('_', "-") }
}

impl Published {
    fn new([success, success_without_disturbance]: [f64; 2], iqm: [Option<f64>; 2]) -> Self {
        let share = |percent: f64| percent / 100.0;
        Self {
            success: share(success),
            success_iqm: iqm[0].map(share),
            success_without_disturbance: share(success_without_disturbance),
            success_without_disturbance_iqm: iqm[1].map(share),
        }
    }
}

impl ResultRow {
    pub fn preset(&self) -> String {
        if let Some(initial) = self.stage.strip_prefix("PPO-Lagrangian lambda0=") {
            return format!("lagrangian-{initial}");
        }
        let plan = match (self.init.as_str(), self.reward.as_str()) {
            ("finetune", _) => "two-stage".to_owned(),
            (_, "r'") => format!("scratch-{}", self.frames.to_lowercase()),
            _ => format!("stage1-{}", self.frames.to_lowercase()),
        };
        format!("{}-{plan}", task(&self.aux))
    }

    pub(crate) fn published(&self) -> Published {
        Published::new([self.sr, self.srwod], [self.sr_iqm, self.srwod_iqm])
    }
}

impl AblationRow {
    pub fn preset(&self) -> String {
        let advantages = if self.normalized_advantage { "normalized" } else { "plain" };
        let action = if self.previous_action { "action" } else { "no-action" };
        format!("ablation-{}-{advantages}-{action}-{}", self.encoder, self.goal)
    }

    pub(crate) fn published(&self) -> Published {
        Published::new([self.sr, self.srwod], [None, None])
    }
}

impl ActionSpaceRow {
    pub fn preset(&self) -> String {
        let task = task(&self.aux);
        match (self.action_space.as_str(), self.init.as_str()) {
            ("small", "finetune") => format!("small-{task}-two-stage"),
            ("small", _) => format!("small-{task}"),
            (_, "finetune") => format!("{task}-two-stage"),
            _ => format!("{task}-stage1-20m"),
        }
    }

    pub(crate) fn published(&self) -> Published {
        Published::new([self.sr, self.srwod], [None, None])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::{AuxiliaryTask, Config, Encoder, GoalCoordinates, presets};
    use std::collections::BTreeSet;

    fn config(preset: &str) -> Config {
        Config::resolve(preset, None).unwrap_or_else(|error| panic!("{preset}: {error}"))
    }

    fn task_of(aux: &str) -> AuxiliaryTask {
        match aux {
            "none_original" | "none" => AuxiliaryTask::None,
            "cpca16" => AuxiliaryTask::Cpca16,
            "inverse_dynamics" => AuxiliaryTask::InverseDynamics,
            "disturb" => AuxiliaryTask::Disturb,
            other => panic!("{other}"),
        }
    }

    #[test]
    fn the_tables_have_all_their_rows() {
        let paper = paper();
        assert_eq!((paper.test_novel.len(), paper.test_seen.len()), (19, 19));
        assert_eq!((paper.ablation_valid_novel_20m.len(), paper.action_space_valid.len()), (12, 8));
        let last = paper.test_novel.last().unwrap();
        assert_eq!((last.sr, last.srwod, last.srwod_iqm), (81.3, 47.1, Some(46.6)));
    }

    /// Every row has a preset, and the preset's configuration is the row's.
    #[test]
    fn every_row_is_a_preset_that_does_what_the_row_says() {
        let mut named = BTreeSet::new();
        for row in paper().test_novel.iter().chain(&paper().test_seen) {
            let config = config(&row.preset());
            named.insert(row.preset());
            assert_eq!(config.auxiliary.task, task_of(&row.aux), "{row:?}");
            assert_eq!(config.network.encoder == Encoder::Cnn, row.aux == "none_original", "{row:?}");
            let millions: Vec<String> =
                config.stages.iter().map(|stage| format!("{}M", stage.frames / 1_000_000)).collect();
            assert_eq!(millions.join("+"), row.frames, "{row:?}");
            assert_eq!(config.stages.len() == 2, row.init == "finetune", "{row:?}");
            let last = config.stages.last().unwrap();
            assert_eq!(last.reward == "r_prime", row.reward == "r'", "{row:?}");
            if let Some(initial) = row.stage.strip_prefix("PPO-Lagrangian lambda0=") {
                assert_eq!(config.reward.lagrangian.initial.to_string(), initial, "{row:?}");
                assert_eq!(last.reward, "lagrangian", "{row:?}");
            }
        }
        assert_eq!(named.len(), 19);
        for row in &paper().ablation_valid_novel_20m {
            let config = config(&row.preset());
            assert_eq!(config.network.encoder == Encoder::Cnn, row.encoder == "cnn", "{row:?}");
            assert_eq!(config.ppo.normalize_advantages, row.normalized_advantage, "{row:?}");
            assert_eq!(config.network.previous_action, row.previous_action, "{row:?}");
            assert_eq!(config.network.goal == GoalCoordinates::Polar, row.goal == "polar", "{row:?}");
            named.insert(row.preset());
        }
        for row in &paper().action_space_valid {
            let config = config(&row.preset());
            assert_eq!(config.episode.action_space.name(), row.action_space, "{row:?}");
            assert_eq!(config.auxiliary.task, task_of(&row.aux), "{row:?}");
            assert_eq!(config.stages.len() == 2, row.init == "finetune", "{row:?}");
            named.insert(row.preset());
        }
        assert_eq!(named.len(), 19 + 12 + 4);
        for lambda in [0, 1, 5, 10, 15, 20, 25] {
            assert_eq!(config(&format!("lambda-{lambda}")).reward.weights["lambda_disturb"], lambda as f32);
            named.insert(format!("lambda-{lambda}"));
        }
        let listed: BTreeSet<&str> = presets().iter().map(|preset| preset.name.as_str()).collect();
        assert!(named.iter().all(|name| listed.contains(name.as_str())));
    }
}
