//! Our figures beside the paper's, row by row as its tables have them.

use crate::figures::Subject;
use crate::paper::{AblationRow, ActionSpaceRow, ResultRow, paper};
use crate::results::FieldResult;
use crate::statistics::Aggregate;
use crate::study::{Field, Group, Source, differences_between};
use proto::config::{AuxiliaryTask, Config, EpisodeConfig, NetworkConfig};
use proto::evaluation::ObjectSet;
use proto::kitchen::Split;
use proto::reward::RewardKind;
use proto::stage::total_frames;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::LazyLock;

/// One of the paper's tables with ours beside it.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// `test-novel`, ...
    pub name: String,
    /// What it shows, for people.
    pub title: String,
    /// Where ours were evaluated: `test-novel`, ...
    pub field: String,
    /// Heads of the columns that say what a row is.
    pub columns: Vec<&'static str>,
    /// The paper's rows in its order, each with ours.
    pub rows: Vec<Row>,
}

/// A row of the paper, with ours.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// One cell a column.
    pub what: Vec<String>,
    /// Preset that is this row.
    pub preset: String,
    /// The paper's figures.
    pub paper: Published,
    /// Our groups that are this row; empty where none was evaluated.
    pub ours: Vec<Ours>,
}

/// Published figures, shares 0..=1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Published {
    /// SR, mean over seeds.
    pub success: f64,
    /// SR, mean of the middle three seeds.
    pub success_iqm: Option<f64>,
    /// `SRwoD`, mean over seeds.
    pub success_without_disturbance: f64,
    /// `SRwoD`, mean of the middle three seeds.
    pub success_without_disturbance_iqm: Option<f64>,
}

/// What a group of ours came to.
#[derive(Debug, Clone, Serialize)]
pub struct Ours {
    /// The group.
    pub group: String,
    /// Settings that are not those of the row's preset.
    pub differences: Vec<String>,
    /// Frames trained on when it was evaluated, fewest and most over seeds.
    pub frames: (u64, u64),
    /// Episodes a seed.
    pub episodes: u64,
    /// SR.
    pub success: Aggregate,
    /// `SRwoD`.
    pub success_without_disturbance: Aggregate,
    /// `SRwoD` by the largest displacement on an axis.
    pub success_without_disturbance_per_axis: Aggregate,
}

// The paper's tables are of fixed episodes: what was evaluated on drawn ones stands in none of them.
const TEST_NOVEL: Field = Field::new(Split::Test, ObjectSet::Novel, Source::Fixed);
const TEST_SEEN: Field = Field::new(Split::Test, ObjectSet::Seen, Source::Fixed);
const VALIDATION_NOVEL: Field = Field::new(Split::Validation, ObjectSet::Novel, Source::Fixed);

/// What makes a method, whatever it is called, in whatever batches and for however long it is trained.
#[derive(Debug, PartialEq)]
struct Method<'a> {
    rewards: Vec<RewardKind>,
    /// Where a stage has r′.
    lambda_disturb: Option<f32>,
    /// PPO-Lagrangian's first multiplier, where a stage has one.
    multiplier: Option<f64>,
    task: AuxiliaryTask,
    network: NetworkConfig,
    episode: EpisodeConfig,
    scenes: &'a [String],
}

impl<'a> Method<'a> {
    fn of(config: &'a Config) -> Self {
        let rewards: Vec<RewardKind> = config.stages.iter().map(|stage| stage.reward).collect();
        let where_used = |reward: RewardKind| rewards.contains(&reward);
        Self {
            lambda_disturb: where_used(RewardKind::DisturbanceFree).then_some(config.reward.lambda_disturb),
            multiplier: where_used(RewardKind::Lagrangian).then_some(config.reward.lagrangian.initial),
            task: config.auxiliary.task,
            // The same is seen with either sign.
            network: NetworkConfig { carried_goal: NetworkConfig::default().carried_goal, ..config.network },
            episode: config.episode,
            scenes: &config.scenes,
            rewards,
        }
    }
}

/// The presets that are the paper's rows, each once.
fn row_presets() -> &'static BTreeMap<String, Config> {
    static PRESETS: LazyLock<BTreeMap<String, Config>> = LazyLock::new(|| {
        let fields = [TEST_NOVEL, TEST_SEEN, VALIDATION_NOVEL];
        let names = fields.into_iter().flat_map(rows_of).map(|(preset, _)| preset);
        let config = |name: &str| Config::resolve(name, None).expect("every row is a preset, as tested");
        names.map(|name| (name.clone(), config(&name))).collect()
    });
    &PRESETS
}

/// Names of the rows of the paper that a group stands beside: those of its method. Where rows differ in what a method
/// leaves open, those whose advantages are alike, then those of the nearest budget. Runs that began with other weights
/// are no row of the paper, nor are weights of which nobody knows how they were trained.
fn rows_beside(group: &Group<'_>) -> BTreeSet<&'static str> {
    if group.untrained() || group.unknown() || group.continued() {
        return BTreeSet::new();
    }
    let ours = &group.runs[0].config;
    let distance = |row: &Config| {
        let advantages = row.ppo.normalize_advantages != ours.ppo.normalize_advantages;
        (advantages, total_frames(&row.stages).abs_diff(total_frames(&ours.stages)))
    };
    let alike = || row_presets().iter().filter(|(_, row)| Method::of(row) == Method::of(ours));
    let nearest = alike().map(|(_, row)| distance(row)).min();
    alike().filter(|(_, row)| Some(distance(row)) == nearest).map(|(name, _)| name.as_str()).collect()
}

/// SR and `SRwoD` of the paper's row that this group is, shares 0..=1.
pub fn published(group: &Group<'_>, field: Field) -> Option<Published> {
    let rows = rows_beside(group);
    rows_of(field).into_iter().find(|(preset, _)| rows.contains(preset.as_str())).map(|(_, published)| published)
}

fn rows_of(field: Field) -> Vec<(String, Published)> {
    match field {
        TEST_NOVEL => paper().test_novel.iter().map(|row| (row.preset(), row.published())).collect(),
        TEST_SEEN => paper().test_seen.iter().map(|row| (row.preset(), row.published())).collect(),
        VALIDATION_NOVEL => {
            let ablations = paper().ablation_valid_novel_20m.iter().map(|row| (row.preset(), row.published()));
            ablations.chain(paper().action_space_valid.iter().map(|row| (row.preset(), row.published()))).collect()
        }
        _ => Vec::new(),
    }
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
    fn published(&self) -> Published {
        Published::new([self.sr, self.srwod], [self.sr_iqm, self.srwod_iqm])
    }
}

impl AblationRow {
    fn published(&self) -> Published {
        Published::new([self.sr, self.srwod], [None, None])
    }
}

impl ActionSpaceRow {
    fn published(&self) -> Published {
        Published::new([self.sr, self.srwod], [None, None])
    }
}

/// The paper's tables with ours beside them, in its order.
pub fn comparisons(subjects: &[Subject<'_>]) -> Vec<Comparison> {
    let results = |name: &str, title: &str, field: Field, rows: &[ResultRow]| Comparison {
        name: name.to_owned(),
        title: title.to_owned(),
        field: field.key(),
        columns: vec!["stage", "reward", "start", "frames", "auxiliary task"],
        rows: rows
            .iter()
            .map(|row| {
                let what = [&row.stage, &row.reward, &row.init, &row.frames, &row.aux].map(|cell| plain(cell)).to_vec();
                row_of(what, row.preset(), row.published(), subjects, field)
            })
            .collect(),
    };
    let yes = |set: bool| if set { "yes" } else { "no" }.to_owned();
    vec![
        results("test-novel", "Test kitchens, novel objects", TEST_NOVEL, &paper().test_novel),
        results("test-seen", "Test kitchens, seen objects", TEST_SEEN, &paper().test_seen),
        Comparison {
            name: "ablation".into(),
            title: "Ablation: validation kitchens, novel objects, A_small, stage I, 20M frames".into(),
            field: VALIDATION_NOVEL.key(),
            columns: vec!["encoder", "advantages", "previous action", "goal"],
            rows: paper()
                .ablation_valid_novel_20m
                .iter()
                .map(|row| {
                    let advantages = if row.normalized_advantage { "normalised" } else { "plain" };
                    let what =
                        vec![row.encoder.clone(), advantages.to_owned(), yes(row.previous_action), row.goal.clone()];
                    row_of(what, row.preset(), row.published(), subjects, VALIDATION_NOVEL)
                })
                .collect(),
        },
        Comparison {
            name: "action-space".into(),
            title: "Action spaces: validation kitchens, novel objects".into(),
            field: VALIDATION_NOVEL.key(),
            columns: vec!["actions", "reward", "start", "auxiliary task"],
            rows: paper()
                .action_space_valid
                .iter()
                .map(|row| {
                    let actions = format!("A_{}", row.action_space);
                    let mut what = vec![actions];
                    what.extend([&row.reward, &row.init, &row.aux].map(|cell| plain(cell)));
                    row_of(what, row.preset(), row.published(), subjects, VALIDATION_NOVEL)
                })
                .collect(),
        },
    ]
}

/// A cell of the paper's data as a reader has it.
fn plain(cell: &str) -> String {
    match cell {
        "r'" => "r′".to_owned(),
        "none_original" => "none (original)".to_owned(),
        "cpca16" => "CPC|A-16".to_owned(),
        "finetune" => "stage I".to_owned(),
        other => other.replace('_', " ").replace("lambda0", "λ₀"),
    }
}

fn row_of(what: Vec<String>, preset: String, paper: Published, subjects: &[Subject<'_>], field: Field) -> Row {
    let here = subjects.iter().filter(|subject| rows_beside(subject.group).contains(preset.as_str()));
    let ours = here.filter_map(|subject| Some(Ours::of(subject.group, &preset, subject.in_field(field)?))).collect();
    Row { what, preset, paper, ours }
}

impl Ours {
    /// Of a group beside the row of this preset.
    fn of(group: &Group<'_>, preset: &str, result: &FieldResult) -> Self {
        let frames = || result.seeds.iter().map(|seed| seed.frames);
        Self {
            group: group.label.clone(),
            differences: differences_between(&row_presets()[preset], &group.runs[0].config),
            frames: (frames().min().unwrap_or(0), frames().max().unwrap_or(0)),
            episodes: result.seeds.first().map_or(0, |seed| seed.episodes),
            success: result.success,
            success_without_disturbance: result.success_without_disturbance,
            success_without_disturbance_per_axis: result.success_without_disturbance_per_axis,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{Run, groups, tests::run};
    use proto::config::StageConfig;

    /// Rows beside which this run stands, alone.
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
            ("two-stage", &["disturb-two-stage"]),
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
        let runs = ["lambda-15", "demo"].map(|preset| run(preset, preset, 1));
        let groups = groups(&runs).unwrap();
        assert_eq!(published(&groups[0], TEST_NOVEL).unwrap().success, 81.3 / 100.0);
        assert_eq!(published(&groups[1], TEST_NOVEL), None);
    }

    #[test]
    fn a_presets_name_is_no_row_where_the_method_is_another() {
        let lagrangian = |initial: f64, task: AuxiliaryTask| {
            changed("short-scratch", |config| {
                config.auxiliary.task = task;
                config.reward.lagrangian.initial = initial;
                config.stages =
                    vec![StageConfig { name: "I".into(), reward: RewardKind::Lagrangian, frames: 10_000_000 }];
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
        assert_eq!(changed("disturb-two-stage", |config| config.reward.lambda_disturb = 5.0), none);
        assert_eq!(changed("disturb-two-stage", |config| config.network.hidden = 256), none);
        assert_eq!(changed("disturb-two-stage", |config| config.episode.start_distance_max_m = 0.7), none);
        assert_eq!(changed("disturb-two-stage", |config| config.scenes.push("mine/scene.toml".into())), none);
        // What is not in force does not make a method.
        let unused = changed("disturb-stage1-20m", |config| config.reward.lambda_disturb = 5.0);
        assert_eq!(unused, ["disturb-stage1-20m"]);
    }

    #[test]
    fn without_evaluations_the_papers_rows_stand_alone() {
        let tables = comparisons(&[]);
        let lengths: Vec<usize> = tables.iter().map(|table| table.rows.len()).collect();
        assert_eq!(lengths, [19, 19, 12, 8]);
        for row in tables.iter().flat_map(|table| &table.rows) {
            assert!(row.ours.is_empty());
        }
    }
}
