use crate::paper::{Published, paper};
use crate::study::{Field, Group, Source};
use proto::config::{AuxiliaryTask, Config, EpisodeConfig, KitchenSource, NetworkConfig};
use proto::evaluation::ObjectSet;
use proto::kitchen::Split;
use proto::stage::total_frames;
use proto::task::Composition;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

// The paper's tables are of fixed episodes: evaluations on drawn ones appear in none of them.
pub const TEST_NOVEL: Field = Field::new(Split::Test, ObjectSet::Novel, Source::Fixed);
pub const TEST_SEEN: Field = Field::new(Split::Test, ObjectSet::Seen, Source::Fixed);
pub const VALIDATION_NOVEL: Field = Field::new(Split::Validation, ObjectSet::Novel, Source::Fixed);

/// What makes a method, whatever it is called, in whatever batches and for however long it is trained.
#[derive(Debug, PartialEq)]
struct Method<'a> {
    environment: &'a str,
    rewards: Vec<Composition>,
    multiplier: Option<f64>,
    task: AuxiliaryTask,
    network: NetworkConfig,
    episode: EpisodeConfig,
    scenes: &'a [String],
    kitchens: KitchenSource,
}

impl<'a> Method<'a> {
    fn of(config: &'a Config) -> Self {
        let rewards: Vec<_> = config.whole_curriculum().iter().map(|stage| config.reward(&stage.reward)).collect();
        let has_multiplier = rewards.iter().any(Composition::has_multiplier);
        Self {
            environment: &config.task,
            multiplier: has_multiplier.then_some(config.reward.lagrangian.initial),
            task: config.auxiliary.task,
            // The same is seen with either sign.
            network: NetworkConfig { carried_goal: NetworkConfig::default().carried_goal, ..config.network.clone() },
            episode: config.episode,
            scenes: &config.scenes,
            kitchens: config.kitchens.source,
            rewards,
        }
    }
}

pub fn row_presets() -> &'static BTreeMap<String, Config> {
    static PRESETS: LazyLock<BTreeMap<String, Config>> = LazyLock::new(|| {
        let fields = [TEST_NOVEL, TEST_SEEN, VALIDATION_NOVEL];
        let names = fields.into_iter().flat_map(rows_of).map(|(preset, _)| preset);
        let config = |name: &str| Config::resolve(name, None).expect("every row is a preset, as tested");
        names.map(|name| (name.clone(), config(&name))).collect()
    });
    &PRESETS
}

/// Names of the paper's rows that a group is compared with: those of its method. Of several rows, those that treat
/// advantages alike, then those of the nearest budget. A run that began with
/// other weights has the method of both its parts; weights whose training is unknown match no row.
pub fn rows_beside(group: &Group<'_>) -> BTreeSet<&'static str> {
    if group.untrained() || group.unknown() || group.begun_with_unknown() {
        return BTreeSet::new();
    }
    rows_of_method(&group.runs[0].config)
}

/// Metrics on the test kitchens with novel targets of the paper's row that has a configuration's method, if there is one;
/// shares 0..=1.
pub fn level_of(config: &Config) -> Option<BTreeMap<String, f64>> {
    let rows = rows_of_method(config);
    let (_, level) = rows_of(TEST_NOVEL).into_iter().find(|(preset, _)| rows.contains(preset.as_str()))?;
    let levels = [("success", level.success), ("success_without_disturbance", level.success_without_disturbance)];
    Some(levels.map(|(name, level)| (name.to_owned(), level)).into())
}

fn rows_of_method(ours: &Config) -> BTreeSet<&'static str> {
    let distance = |row: &Config| {
        let advantages = row.ppo.normalize_advantages != ours.ppo.normalize_advantages;
        (advantages, total_frames(&row.stages).abs_diff(total_frames(&ours.whole_curriculum())))
    };
    let alike = || row_presets().iter().filter(|(_, row)| Method::of(row) == Method::of(ours));
    let nearest = alike().map(|(_, row)| distance(row)).min();
    alike().filter(|(_, row)| Some(distance(row)) == nearest).map(|(name, _)| name.as_str()).collect()
}

fn rows_of(field: Field) -> Vec<(String, Published)> {
    // The paper's checkpoints are chosen on validation; ours are the newest or the best.
    match (Field { best: false, deterministic: false, ..field }) {
        TEST_NOVEL => paper().test_novel.iter().map(|row| (row.preset(), row.published())).collect(),
        TEST_SEEN => paper().test_seen.iter().map(|row| (row.preset(), row.published())).collect(),
        VALIDATION_NOVEL => {
            let ablations = paper().ablation_valid_novel_20m.iter().map(|row| (row.preset(), row.published()));
            ablations.chain(paper().action_space_valid.iter().map(|row| (row.preset(), row.published()))).collect()
        }
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{Run, groups, tests::run};
    use proto::config::StageConfig;

    /// Rows that this run, alone, is compared with.
    fn rows(run: Run) -> Vec<&'static str> {
        rows_beside(&groups(&[run]).unwrap()[0]).into_iter().collect()
    }

    fn changed(preset: &str, change: impl FnOnce(&mut Config)) -> Vec<&'static str> {
        let mut run = run(preset, preset, 1);
        change(&mut run.config);
        rows(run)
    }

    #[test]
    fn a_group_is_the_row_of_its_method_whatever_its_preset_is_called() {
        for (preset, expected) in [
            ("lambda-15", &["disturb-two-stage"][..]),
            ("recipe", &["disturb-two-stage"]),
            ("paper", &["disturb-two-stage"]),
            ("short-two-stage", &["disturb-two-stage"]),
            ("short-scratch", &["disturb-scratch-45m"]),
            ("disturb-stage1-45m", &["disturb-stage1-45m"]),
            // Of two budgets the nearer one.
            ("short-r-only", &["disturb-stage1-20m"]),
            // Two of the paper's tables have this row.
            ("small-none", &["ablation-resnet-plain-action-polar", "small-none"]),
            ("ablation-resnet-normalized-action-polar", &["ablation-resnet-normalized-action-polar"]),
            // The paper's sweep has a figure and no row.
            ("lambda-0", &[]),
            ("lambda-25", &[]),
            ("demo", &[]),
        ] {
            assert_eq!(changed(preset, |_| {}), expected, "{preset}");
        }
        // Every row is its own.
        for name in row_presets().keys() {
            assert!(changed(name, |_| {}).contains(&name.as_str()), "{name}");
        }
        let level = |preset: &str| level_of(&Config::resolve(preset, None).unwrap());
        let known = level("lambda-15").unwrap();
        assert_eq!([known["success"], known["success_without_disturbance"]], [81.3 / 100.0, 47.1 / 100.0]);
        assert_eq!(level("demo"), None);
    }

    #[test]
    fn a_presets_name_is_no_row_where_the_method_is_another() {
        let lagrangian = |initial: f64, task: AuxiliaryTask| {
            changed("short-scratch", |config| {
                config.auxiliary.task = task;
                config.reward.lagrangian.initial = initial;
                config.stages = vec![StageConfig { name: "I".into(), reward: "lagrangian".into(), frames: 10_000_000 }];
            })
        };
        let none: [&str; 0] = [];
        // The paper's PPO-Lagrangian has no auxiliary task.
        assert_eq!(lagrangian(15.0, AuxiliaryTask::Disturb), none);
        assert_eq!(lagrangian(15.0, AuxiliaryTask::None), ["lagrangian-15"]);
        assert_eq!(lagrangian(2.0, AuxiliaryTask::None), none);
        for (task, expected) in [
            (AuxiliaryTask::None, "none-stage1-20m"),
            (AuxiliaryTask::Cpca16, "cpca16-stage1-20m"),
            (AuxiliaryTask::InverseDynamics, "inverse-dynamics-stage1-20m"),
        ] {
            assert_eq!(changed("short-r-only", |config| config.auxiliary.task = task), [expected]);
        }
        assert_eq!(
            changed("disturb-two-stage", |config| {
                config.reward.weights.insert("lambda_disturb".into(), 5.0);
            }),
            none
        );
        assert_eq!(changed("disturb-two-stage", |config| config.network.hidden = 256), none);
        assert_eq!(changed("disturb-two-stage", |config| config.episode.start_distance_max_m = 0.7), none);
        assert_eq!(changed("disturb-two-stage", |config| config.scenes.push("mine/scene.toml".into())), none);
        assert_eq!(changed("disturb-two-stage", |config| config.kitchens.source = KitchenSource::Procedural), none);
        // What is not in force does not make a method.
        let unused = changed("disturb-stage1-20m", |config| {
            config.reward.weights.insert("lambda_disturb".into(), 5.0);
        });
        assert_eq!(unused, ["disturb-stage1-20m"]);
    }
}
