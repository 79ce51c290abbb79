//! Our figures beside the paper's, row by row as its tables have them.

use crate::figures::Subject;
use crate::paper::{AblationRow, ActionSpaceRow, ResultRow, paper};
use crate::results::FieldResult;
use crate::statistics::Aggregate;
use crate::study::{Field, Group, settings_of_preset};
use proto::evaluation::ObjectSet;
use proto::kitchen::Split;
use serde::Serialize;

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
    /// Settings that are not the preset's.
    pub differences: Vec<String>,
    /// Frames trained on when it was evaluated, fewest and most over seeds.
    pub frames: (u64, u64),
    /// Episodes a seed.
    pub episodes: u64,
    /// SR.
    pub success: Aggregate,
    /// `SRwoD`.
    pub success_without_disturbance: Aggregate,
}

const TEST_NOVEL: Field = Field { split: Split::Test, objects: ObjectSet::Novel };
const TEST_SEEN: Field = Field { split: Split::Test, objects: ObjectSet::Seen };
const VALIDATION_NOVEL: Field = Field { split: Split::Validation, objects: ObjectSet::Novel };

/// Presets that are a row of the paper in another batch shape, or with fewer frames.
const SAME_METHOD: [(&str, &str); 5] = [
    ("two-stage", "disturb-two-stage"),
    ("paper", "disturb-two-stage"),
    ("short-two-stage", "disturb-two-stage"),
    ("short-r-only", "disturb-stage1-45m"),
    ("short-scratch", "disturb-scratch-45m"),
];

/// True when the group's runs are this preset, under its own name or another. Runs that began with other weights are no
/// row of the paper, whatever their preset is called.
fn is_preset(group: &Group<'_>, preset: &str) -> bool {
    if group.untrained() || group.continued() {
        return false;
    }
    if group.preset == preset || SAME_METHOD.contains(&(group.preset.as_str(), preset)) {
        return true;
    }
    settings_of_preset(preset).is_some_and(|settings| settings == group.settings_without_preset())
}

/// SR and `SRwoD` of the paper's row that this group is, shares 0..=1.
pub fn published(group: &Group<'_>, field: Field) -> Option<Published> {
    rows_of(field).into_iter().find(|(preset, _)| is_preset(group, preset)).map(|(_, published)| published)
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
    let ours = subjects.iter().filter(|subject| is_preset(subject.group, &preset));
    let ours = ours.filter_map(|subject| Some(Ours::of(subject.group, subject.in_field(field)?))).collect();
    Row { what, preset, paper, ours }
}

impl Ours {
    /// Of a group.
    pub fn of(group: &Group<'_>, result: &FieldResult) -> Self {
        let frames = || result.seeds.iter().map(|seed| seed.frames);
        Self {
            group: group.label.clone(),
            differences: group.differences.clone(),
            frames: (frames().min().unwrap_or(0), frames().max().unwrap_or(0)),
            episodes: result.seeds.first().map_or(0, |seed| seed.episodes),
            success: result.success,
            success_without_disturbance: result.success_without_disturbance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{groups, tests::run};

    #[test]
    fn a_group_is_the_row_of_its_settings_whatever_its_preset_is_called() {
        let runs = ["lambda-15", "small-none", "two-stage", "demo"].map(|preset| run(preset, preset, 1));
        let groups = groups(&runs).unwrap();
        assert!(is_preset(&groups[0], "disturb-two-stage") && !is_preset(&groups[0], "none-two-stage"));
        assert!(is_preset(&groups[1], "ablation-resnet-plain-action-polar"));
        assert!(is_preset(&groups[2], "disturb-two-stage"));
        assert_eq!(published(&groups[0], TEST_NOVEL).unwrap().success, 81.3 / 100.0);
        assert_eq!(published(&groups[3], TEST_NOVEL), None);
        for (preset, row) in SAME_METHOD {
            // The aliases are presets, and so are the rows that they stand beside.
            assert!(settings_of_preset(preset).is_some() && settings_of_preset(row).is_some(), "{preset}");
        }
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
