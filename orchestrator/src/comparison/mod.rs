mod episodes;
mod figures;
pub mod row;
pub mod settings;

use crate::output::format::NOTHING;
use crate::output::table::{aligned, blocks, cell, is_wider};
use crate::output::terminal;
use crate::run::identity::Identity;
use anyhow::{Result, ensure};
use episodes::SameEpisodes;
use figures::Figure;
use proto::config::Config;
use proto::run_folder::RunFolder;
use row::Row;
use serde::Serialize;
use serde_json::{Value, json};
use std::path::PathBuf;

const CELL_MAX: usize = 34;
const NARROW_CELL_MAX: usize = 16;

fn column(folder: &RunFolder) -> Result<(Config, Vec<Figure>)> {
    let identity = Identity::read(folder)?;
    let config = Config::of_run(folder)?;
    let figures = figures::of(folder, &config, &identity)?;
    Ok((config, figures))
}

#[derive(Debug, PartialEq, Serialize)]
pub struct Comparison {
    pub runs: Vec<String>,
    pub configuration: Vec<Row>,
    pub figures: Vec<Row>,
    /// Of two evaluations that played the same ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub same_episodes: Vec<SameEpisodes>,
}

impl Comparison {
    /// Reads the folders of runs and evaluations. One that cannot be read is named and left out, as long as there are two
    /// others.
    pub fn read(paths: &[PathBuf]) -> Result<Self> {
        let (mut runs, mut configs, mut known) = (Vec::new(), Vec::new(), Vec::new());
        let mut problems = Vec::new();
        for (number, path) in paths.iter().enumerate() {
            ensure!(!paths[..number].contains(path), "{} is given twice", path.display());
            match column(&RunFolder::new(path)) {
                Ok((mut config, figures)) => {
                    // A file is the same by whatever path.
                    let asked = config.evaluation.as_mut().and_then(|asked| asked.checkpoint.as_mut());
                    if let Some(checkpoint) = asked
                        && let Ok(real) = std::fs::canonicalize(&*checkpoint)
                    {
                        *checkpoint = real.display().to_string();
                    }
                    runs.push(path.display().to_string());
                    configs.push(config);
                    known.push(figures);
                }
                Err(error) => problems.push((path, error)),
            }
        }
        if runs.len() < 2 && !problems.is_empty() {
            return Err(problems.swap_remove(0).1);
        }
        for (path, error) in problems {
            // A parser's message shows the place in further lines.
            let error = format!("{error:#}");
            terminal::note(&format!("{} is left out: {}", path.display(), error.lines().next().unwrap_or_default()));
        }
        let mut same_episodes = Vec::new();
        if configs.iter().all(|config| config.evaluation.is_some()) {
            figures::side_by_side(&mut known);
            if let ([one, other], [first, second]) = (&runs[..], &configs[..]) {
                let folders = [one, other].map(RunFolder::new);
                same_episodes = SameEpisodes::of(folders.each_ref(), [first, second]);
            }
        }
        let configuration = settings::differences(&configs);
        let comparison = Self { runs, configuration, figures: figures::rows(&known), same_episodes };
        Ok(comparison.with_means())
    }

    pub fn lines(&self) -> Vec<String> {
        let mut lines = self.within(terminal::width());
        if let [one, other] = &shortened(&self.runs)[..] {
            lines.extend(self.same_episodes.iter().map(|same| same.line([one, other])));
        }
        lines
    }

    /// With a column more for each experiment of several seeds: the means of its figures.
    fn with_means(mut self) -> Self {
        // Of each seed its own.
        let own = ["seed", "from.checkpoint", "from.weights", "evaluation.checkpoint"];
        let is_seed = |one: usize, other: usize| {
            let same = |row: &Row| row.values[one] == row.values[other];
            let others = self.configuration.iter().filter(|row| !own.contains(&row.name.as_str()));
            others.into_iter().all(same) && self.configuration.iter().any(|row| row.name == "seed" && !same(row))
        };
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for run in 0..self.runs.len() {
            match groups.iter_mut().find(|group| group.iter().all(|&other| is_seed(other, run))) {
                Some(group) => group.push(run),
                None => groups.push(vec![run]),
            }
        }
        for group in groups.iter().filter(|group| group.len() > 1) {
            let names: Vec<&str> = group.iter().map(|&run| self.runs[run].as_str()).collect();
            let name = mean_of(&names);
            self.runs.push(name);
            for Row { values, shown, .. } in &mut self.configuration {
                values.push(Value::Null);
                shown.push(String::new());
            }
            for Row { values, shown, format, .. } in &mut self.figures {
                let sum = group.iter().map(|&run| values[run].as_f64()).sum::<Option<f64>>();
                let mean = sum.map(|sum| sum / group.len() as f64);
                values.push(json!(mean));
                shown.push(mean.map(|mean| format.shown(mean)).unwrap_or_default());
            }
        }
        self
    }

    /// Where the whole table is wider, tables of some runs each, which numbers stand for.
    fn within(&self, columns: Option<usize>) -> Vec<String> {
        let whole = aligned(&with_values(self.rows(shortened(&self.runs), CELL_MAX)));
        let Some(most) = columns.filter(|&most| is_wider(&whole, most)) else { return whole };
        let numbers: Vec<String> = (1..=self.runs.len()).map(|number| number.to_string()).collect();
        let mut lines: Vec<String> =
            numbers.iter().zip(&self.runs).map(|(number, run)| format!("{number}  {run}")).collect();
        for table in blocks(&self.rows(numbers, NARROW_CELL_MAX), Some(most)) {
            lines.push(String::new());
            lines.extend(aligned(&with_values(table)));
        }
        lines
    }

    /// The heads of the columns; then for each part of the comparison a title alone, and its rows.
    fn rows(&self, heads: Vec<String>, cell_max: usize) -> Vec<Vec<String>> {
        let head = if self.configuration.is_empty() { "configuration: the same in all" } else { "" };
        let mut rows = vec![[vec![head.to_owned()], heads].concat()];
        let settings = self.configuration.iter().map(|row| ("configuration", row.name.as_str(), row));
        let figures = self.figures.iter().map(|row| {
            let (part, name) = row.name.split_once(": ").unwrap_or(("figures", &row.name));
            (part, name, row)
        });
        let all: Vec<_> = settings.chain(figures).collect();
        for (number, (title, ..)) in all.iter().enumerate() {
            if all[..number].iter().any(|(known, ..)| known == title) {
                continue;
            }
            rows.push(vec![(*title).to_owned()]);
            for (_, name, row) in all.iter().filter(|(part, ..)| part == title) {
                let cells = row.shown.iter().map(|text| cell(text, cell_max));
                rows.push(std::iter::once(format!("  {name}")).chain(cells).collect());
            }
        }
        rows
    }
}

/// A table without the rows that have no value, and without the titles of parts that have no row.
fn with_values(mut table: Vec<Vec<String>>) -> Vec<Vec<String>> {
    table.retain(|row| row.len() == 1 || row[1..].iter().any(|cell| cell != NOTHING));
    let is_title = |row: &Vec<String>| row.len() == 1;
    let is_empty = |at: usize| is_title(&table[at]) && table.get(at + 1).is_none_or(is_title);
    (0..table.len()).filter(|&at| !is_empty(at)).map(|at| table[at].clone()).collect()
}

/// What the mean of these is called: by their name without the seed, `runs/demo, mean of 2`, or by all of their names.
fn mean_of(paths: &[&str]) -> String {
    let is_same = |at: &usize| paths.iter().all(|path| path.as_bytes().get(*at) == paths[0].as_bytes().get(*at));
    let length = (0..paths[0].len()).take_while(is_same).count();
    match paths[0].get(..length).and_then(|begin| begin.rsplit_once('-')) {
        Some((name, end)) if !end.contains('/') => format!("{name}, mean of {}", paths.len()),
        _ => {
            let (folder, _) = paths[0].split_at(paths[0].rfind('/').map_or(0, |at| at + 1));
            let names: Vec<&str> = paths.iter().map(|path| path.rsplit('/').next().unwrap_or(path)).collect();
            format!("{folder}mean of {}", names.join(", "))
        }
    }
}

/// Paths without the folders that all of them are in, if those are more than one.
fn shortened(runs: &[String]) -> Vec<String> {
    let parts = |run: &String| run.split('/').map(str::to_owned).collect::<Vec<_>>();
    let paths: Vec<Vec<String>> = runs.iter().map(parts).collect();
    let is_common = |at: usize| paths.iter().all(|path| at + 1 < path.len() && path[at] == paths[0][at]);
    let most = paths.first().map_or(0, Vec::len);
    let common = Some((0..most).take_while(|&at| is_common(at)).count()).filter(|&count| count > 1).unwrap_or(0);
    paths.iter().map(|path| path[common..].join("/")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use row::Format;

    #[test]
    fn the_seeds_of_one_experiment_have_a_mean() {
        let with = |name: &str, values: [Value; 4], shown: [&str; 4], format| Row {
            name: name.to_owned(),
            values: values.to_vec(),
            shown: shown.map(str::to_owned).to_vec(),
            format,
        };
        let row = |name: &str, values, shown| with(name, values, shown, Format::Text);
        let share = || Format::Metric(proto::task::Spec::built_in()[0].shown()[0].clone());
        let runs = ["runs/a-1", "runs/a-2", "runs/b", "runs/a-3"].map(str::to_owned).to_vec();
        let of = |values: [f64; 4]| values.map(|value| json!(value));
        let configuration = vec![
            row("ppo.clip", of([0.1, 0.1, 0.2, 0.1]), ["0.1", "0.1", "0.2", "0.1"]),
            row("seed", [1, 2, 1, 3].map(|seed| json!(seed)), ["1", "2", "1", "3"]),
        ];
        let figures = vec![
            row("state", ["complete"; 4].map(|state| json!(state)), ["complete"; 4]),
            with("frames", [3000, 3000, 9, 4500].map(|count| json!(count)), [""; 4], Format::Count),
            with("stage I: SR", of([0.1, 0.2, 0.9, 0.6]), [""; 4], share()),
            with("stage I: path (m)", of([0.5, 0.25, 0.9, 0.75]), [""; 4], Format::Decimals(3)),
            // The first has no figure's text.
            with("wall time", of([0.0, 90.0, 1.0, 180.0]), [""; 4], Format::Seconds),
            with("frames/s, mean", of([1200.0, 1300.0, 1.0, 1100.0]), [""; 4], Format::Rate),
            with("II: SR", [json!(0.1), Value::Null, json!(0.2), json!(0.3)], [""; 4], share()),
        ];
        let with_means = Comparison { runs, configuration, figures, same_episodes: Vec::new() }.with_means();
        assert_eq!(with_means.runs[4..], ["runs/a, mean of 3"]);
        let shown: Vec<&str> = with_means.figures.iter().map(|row| row.shown[4].as_str()).collect();
        assert_eq!(shown, ["", "3,500", "30.0%", "0.500", "1 min 30 s", "1,200", ""]);
        assert_eq!(
            [&with_means.figures[1], &with_means.configuration[1]].map(|row| &row.values[4]),
            [&json!(3500.0), &Value::Null]
        );
        assert_eq!(mean_of(&["runs/one", "runs/other"]), "runs/mean of one, other");
    }

    #[test]
    fn a_comparison_that_is_too_wide_is_several_tables_of_numbered_runs() {
        let row = |name: &str, shown: [&str; 3]| Row {
            name: name.to_owned(),
            values: Vec::new(),
            shown: shown.map(str::to_owned).to_vec(),
            format: Format::Text,
        };
        let runs = ["runs/s/runs/one", "runs/s/runs/two", "runs/s/three"].map(str::to_owned).to_vec();
        let figures = vec![
            row("state", ["complete", "stopped", "complete"]),
            row("stage I: SR", ["1.0%", "2.0%", "3.0%"]),
            row("test kitchens: SR", ["", "", "4.0%"]),
            row("stage I: SPL", ["0.10", "0.20", ""]),
            row("stage I: path", ["", NOTHING, ""]),
        ];
        let comparison = Comparison {
            runs,
            configuration: vec![row("seed", ["1", "a\nb", "3"])],
            figures,
            same_episodes: Vec::new(),
        };
        let whole = [
            "         runs/one  runs/two  three",
            "configuration",
            "  seed   1         a b       3",
            "figures",
            "  state  complete  stopped   complete",
            "stage I",
            "  SR     1.0%      2.0%      3.0%",
            "  SPL    0.10      0.20      –",
            "test kitchens",
            "  SR     –         –         4.0%",
        ];
        assert_eq!([comparison.within(None), comparison.within(Some(37))], [whole, whole]);
        let narrow = [
            "1  runs/s/runs/one",
            "2  runs/s/runs/two",
            "3  runs/s/three",
            "",
            "         1         2",
            "configuration",
            "  seed   1         a b",
            "figures",
            "  state  complete  stopped",
            "stage I",
            "  SR     1.0%      2.0%",
            "  SPL    0.10      0.20",
            "",
            "         3",
            "configuration",
            "  seed   3",
            "figures",
            "  state  complete",
            "stage I",
            "  SR     3.0%",
            "test kitchens",
            "  SR     4.0%",
        ];
        assert_eq!(comparison.within(Some(35)), narrow);
    }
}
