use crate::method::{TEST_NOVEL, TEST_SEEN, VALIDATION_NOVEL, row_presets, rows_beside};
use crate::paper::{Published, ResultRow, paper};
use crate::results::{FieldResult, GroupResults, SeedResult};
use crate::statistics::Aggregate;
use crate::study::{Field, Group, differences_between};
use proto::config::Config;
use proto::kitchen::KitchenId;
use serde::Serialize;
use std::collections::BTreeMap;

#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    pub name: String,
    pub title: String,
    pub field: String,
    pub columns: Vec<&'static str>,
    pub rows: Vec<Row>,
}

#[derive(Debug, Clone, Serialize)]
pub struct Row {
    pub what: Vec<String>,
    pub preset: String,
    pub paper: Published,
    pub ours: Vec<Ours>,
}

#[derive(Debug, Clone, Serialize)]
pub struct Ours {
    pub group: String,
    pub field: String,
    pub differences: Vec<String>,
    #[serde(skip)]
    pub kitchens: Vec<KitchenId>,
    #[serde(skip)]
    pub seeds: Vec<SeedResult>,
    pub frames: (u64, u64),
    pub episodes: u64,
    pub metrics: BTreeMap<String, Aggregate>,
}

pub(crate) fn comparisons(entries: &[GroupResults<'_>]) -> Vec<Comparison> {
    let results = |name: &str, title: &str, field: Field, rows: &[ResultRow]| Comparison {
        name: name.to_owned(),
        title: title.to_owned(),
        field: field.key(),
        columns: vec!["stage", "reward", "start", "frames", "auxiliary task"],
        rows: rows
            .iter()
            .map(|row| {
                let what = [&row.stage, &row.reward, &row.init, &row.frames, &row.aux].map(|cell| plain(cell)).to_vec();
                row_of(what, row.preset(), row.published(), entries, field)
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
                    row_of(what, row.preset(), row.published(), entries, VALIDATION_NOVEL)
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
                    row_of(what, row.preset(), row.published(), entries, VALIDATION_NOVEL)
                })
                .collect(),
        },
    ]
}

fn plain(cell: &str) -> String {
    match cell {
        "r'" => "r_prime".to_owned(),
        "none_original" => "none (original)".to_owned(),
        "cpca16" => "CPC|A-16".to_owned(),
        "finetune" => "stage I".to_owned(),
        other => other.replace('_', " ").replace("lambda0", "λ₀"),
    }
}

fn row_of(what: Vec<String>, preset: String, paper: Published, entries: &[GroupResults<'_>], field: Field) -> Row {
    let here = entries.iter().filter(|entry| rows_beside(entry.group).contains(preset.as_str()));
    let ours = here
        .flat_map(|entry| {
            // Of a group that was evaluated in one way only, that one.
            let either = |field: Field| entry.in_field(field).or_else(|| entry.in_field(field.of_most_probable()));
            [field, field.of_best()].map(|field| (entry.group, either(field)))
        })
        .filter_map(|(group, result)| Some(Ours::of(group, &preset, result?)))
        .collect();
    Row { what, preset, paper, ours }
}

impl Ours {
    fn of(group: &Group<'_>, preset: &str, result: &FieldResult) -> Self {
        let frames = || result.seeds.iter().map(|seed| seed.frames);
        Self {
            group: group.label.clone(),
            field: result.field.clone(),
            differences: differences_between(&row_presets()[preset], &as_one_run(&group.runs[0].config)),
            kitchens: result.kitchens.clone(),
            seeds: result.seeds.clone(),
            frames: (frames().min().unwrap_or(0), frames().max().unwrap_or(0)),
            episodes: result.seeds.first().map_or(0, |seed| seed.episodes),
            metrics: result.metrics.clone(),
        }
    }
}

fn as_one_run(config: &Config) -> Config {
    Config { stages: config.whole_curriculum(), from: None, ..config.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

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
