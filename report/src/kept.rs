//! The paper's main tables over many reports. Runs of one table rarely fit on one machine in one day: the scores of each
//! are kept in a small file, every new report adds its own, and the table is made of all of them.

use crate::comparison::{Comparison, comparisons};
use crate::format::{percent, share};
use crate::method::{TEST_NOVEL, TEST_SEEN};
use crate::paper::METRICS;
use crate::statistics::{Aggregate, Estimate, RESAMPLES, Scores, ScoresError};
use proto::kitchen::KitchenId;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt::Write;

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kept {
    rows: Vec<KeptRow>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeptRow {
    field: String,
    preset: String,
    differences: Vec<String>,
    kitchens: Vec<KitchenId>,
    seeds: Vec<KeptSeed>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeptSeed {
    seed: u64,
    run: String,
    frames: u64,
    episodes: u64,
    weights: String,
    success: Vec<f64>,
    success_without_disturbance: Vec<f64>,
}

#[derive(Debug, thiserror::Error)]
pub enum KeptError {
    #[error("{preset}, {field}: seed {seed} is there already with other weights ({known} there, {new} now)")]
    OtherWeights { preset: String, field: String, seed: u64, known: String, new: String },
    #[error(transparent)]
    Scores(#[from] ScoresError),
}

impl Kept {
    pub fn add(&mut self, tables: &[Comparison]) -> Result<(), KeptError> {
        for table in tables.iter().filter(|table| is_main(&table.field)) {
            for (preset, ours) in table.rows.iter().flat_map(|row| row.ours.iter().map(|ours| (&row.preset, ours))) {
                let alike = |row: &KeptRow| {
                    (&row.field, &row.preset, &row.differences, &row.kitchens)
                        == (&ours.field, preset, &ours.differences, &ours.kitchens)
                };
                let index = self.rows.iter().position(alike).unwrap_or_else(|| {
                    self.rows.push(KeptRow {
                        field: ours.field.clone(),
                        preset: preset.clone(),
                        differences: ours.differences.clone(),
                        kitchens: ours.kitchens.clone(),
                        seeds: Vec::new(),
                    });
                    self.rows.len() - 1
                });
                let row = &mut self.rows[index];
                let [success, undisturbed] = METRICS;
                for new in &ours.seeds {
                    match row.seeds.iter().find(|known| known.seed == new.seed) {
                        Some(known) if known.weights != new.weights => {
                            return Err(KeptError::OtherWeights {
                                preset: preset.clone(),
                                field: ours.field.clone(),
                                seed: new.seed,
                                known: known.weights.clone(),
                                new: new.weights.clone(),
                            });
                        }
                        Some(_) => {}
                        None => row.seeds.push(KeptSeed {
                            seed: new.seed,
                            run: new.run.rsplit('/').next().unwrap_or(&new.run).to_owned(),
                            frames: new.frames,
                            episodes: new.episodes,
                            weights: new.weights.clone(),
                            success: new.by_kitchen[success].clone(),
                            success_without_disturbance: new.by_kitchen[undisturbed].clone(),
                        }),
                    }
                }
                row.seeds.sort_by_key(|seed| seed.seed);
            }
        }
        let key = |row: &KeptRow| (row.field.clone(), row.preset.clone(), row.differences.clone());
        self.rows.sort_by_cached_key(key);
        Ok(())
    }

    pub fn runs(&self) -> BTreeSet<&str> {
        self.rows.iter().flat_map(|row| &row.seeds).map(|seed| seed.run.as_str()).collect()
    }

    pub fn markdown(&self) -> Result<String, KeptError> {
        let mut text = String::new();
        let everywhere = |one: &&String| self.rows.iter().all(|row| row.differences.contains(one));
        let shared: Vec<&str> =
            self.rows.iter().take(1).flat_map(|row| &row.differences).filter(everywhere).map(String::as_str).collect();
        if !shared.is_empty() {
            let _ = writeln!(text, "All of ours: {}.\n", shared.join("; "));
        }
        for table in comparisons(&[]).into_iter().filter(|table| is_main(&table.field)) {
            let which = |kept: &KeptRow| {
                Some(match kept.field.strip_prefix(&table.field)? {
                    "" => "ours, last checkpoint",
                    "-best" => "ours, best checkpoint",
                    "-deterministic" => "ours, last checkpoint, deterministic",
                    "-deterministic-best" => "ours, best checkpoint, deterministic",
                    _ => return None,
                })
            };
            let _ = write!(
                text,
                "**{}**\n\n| | seeds | SR: mean | IQM | IQM of seeds | SRwoD: mean | IQM | IQM of seeds |\n\
                 |---|---|---|---|---|---|---|---|\n",
                table.title
            );
            for row in table.rows {
                let paper = row.paper;
                let mean = |mean: f64, iqm: Option<f64>| format!("{} | | {}", percent(mean), share(iqm));
                let [success, undisturbed] = [
                    mean(paper.success, paper.success_iqm),
                    mean(paper.success_without_disturbance, paper.success_without_disturbance_iqm),
                ];
                let _ = writeln!(text, "| {}, paper | 5 | {success} | {undisturbed} |", row.preset);
                for kept in self.rows.iter().filter(|kept| kept.preset == row.preset) {
                    let Some(which) = which(kept) else { continue };
                    let own = kept.differences.iter().map(String::as_str).filter(|one| !shared.contains(one));
                    let which = [which].into_iter().chain(own).collect::<Vec<_>>().join(", ");
                    text.push_str(&kept.line(&which)?);
                }
            }
            text.push('\n');
        }
        Ok(text)
    }
}

impl KeptRow {
    fn line(&self, which: &str) -> Result<String, KeptError> {
        let of = |score: fn(&KeptSeed) -> &Vec<f64>| -> Result<String, KeptError> {
            let rows: Vec<Vec<f64>> = self.seeds.iter().map(|seed| score(seed).clone()).collect();
            let Aggregate { mean, iqm, iqm_of_seeds, .. } = Aggregate::of(&Scores::new(&rows)?, RESAMPLES);
            Ok(format!("{} | {} | {}", with_interval(&mean), with_interval(&iqm), percent(iqm_of_seeds)))
        };
        let (success, undisturbed) = (of(|seed| &seed.success)?, of(|seed| &seed.success_without_disturbance)?);
        Ok(format!("| {which} | {} | {success} | {undisturbed} |\n", self.seeds.len()))
    }
}

fn with_interval(estimate: &Estimate) -> String {
    let interval = estimate.interval.as_ref().map(|interval| format!(" {}", crate::format::interval(interval)));
    format!("{}{}", percent(estimate.point), interval.unwrap_or_default())
}

fn is_main(field: &str) -> bool {
    [TEST_NOVEL, TEST_SEEN].iter().any(|main| main.key() == field)
}
