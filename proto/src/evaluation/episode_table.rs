//! The table of an evaluation's episodes, as CSV: a line of names, then a line an episode.

use super::asked::ObjectSet;
use super::confusion::Confusion;
use super::distribution::Distribution;
use super::record::EpisodeRecord;
use crate::kitchen::{KitchenId, Kitchens, TargetCategory};
use crate::record::End;
use crate::task::{Described, Kind, Spec};
use csv::{ErrorKind, Reader, StringRecord, WriterBuilder};
use std::io::Read;
use std::str::FromStr;

/// The counts of a confusion matrix.
const COUNTS: [&str; 4] = ["prediction_hits", "prediction_misses", "prediction_false_alarms", "prediction_quiet"];

fn names(spec: &Spec, distribution: Distribution) -> Vec<String> {
    let mut names = if has_kitchens(distribution) { vec!["kitchen", "episode"] } else { vec!["episode"] };
    names.extend(["category", "objects"].iter().filter(|_| has_targets(spec)));
    names.extend(["end", "length"]);
    let mut names: Vec<String> = names.into_iter().map(str::to_owned).collect();
    names.extend(spec.columns().into_iter().map(|column| column.name));
    names.extend(COUNTS.iter().filter(|_| spec.label().is_some()).map(|&name| name.to_owned()));
    names.push("state_hash".to_owned());
    // Only in tables of drawn episodes.
    names.extend((distribution == Distribution::Run).then(|| "distribution".to_owned()));
    names
}

fn has_kitchens(distribution: Distribution) -> bool {
    distribution != Distribution::Seeds
}

/// Whether an episode of the task has a target, of a category that is novel or seen.
pub fn has_targets(spec: &Spec) -> bool {
    spec.is_built_in() && spec.channel("target").is_some()
}

/// The table of these episodes: the line of names, then a line for each. A number that an episode does not have is an
/// empty cell; numbers are the shortest that read back the same, without an exponent.
pub fn write_table(spec: &Spec, records: &[EpisodeRecord], distribution: Distribution) -> String {
    const WRITTEN: &str = "all lines have as many cells as the first, and memory takes them";
    let mut writer = WriterBuilder::new().from_writer(Vec::new());
    writer.write_record(names(spec, distribution)).expect(WRITTEN);
    let columns = spec.columns();
    for record in records {
        let mut cells = if has_kitchens(distribution) { vec![record.kitchen.to_string()] } else { vec![] };
        cells.push(record.episode.to_string());
        if let Some(category) = record.category.filter(|_| has_targets(spec)) {
            let set = if ObjectSet::Novel.contains(category) { ObjectSet::Novel } else { ObjectSet::Seen };
            cells.extend([category.name(), set.name()].map(str::to_owned));
        }
        cells.extend([record.end.name().to_owned(), record.length.to_string()]);
        let cell = |(column, number): (&Described, &Option<f64>)| match (column.kind, *number) {
            (_, None) => String::new(),
            (Kind::F32, Some(number)) => (number as f32).to_string(),
            (_, Some(number)) => number.to_string(),
        };
        cells.extend(columns.iter().zip(&record.numbers).map(cell));
        if spec.label().is_some() {
            let counts = record.prediction.map(|Confusion { hits, misses, false_alarms, quiet }| {
                [hits, misses, false_alarms, quiet].map(|count| count.to_string())
            });
            cells.extend(counts.unwrap_or_default());
        }
        cells.push(format!("{:016x}", record.state_hash));
        cells.extend((distribution == Distribution::Run).then(|| distribution.name().to_owned()));
        writer.write_record(cells).expect(WRITTEN);
    }
    let bytes = writer.into_inner().expect("memory takes every byte");
    String::from_utf8(bytes).expect("names, numbers and commas are UTF-8")
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct TableError {
    /// Line in the file, from 1.
    pub line: u64,
    pub problem: String,
}

/// Reads what [`write_table`] wrote. Columns are found by name; unknown ones are ignored, and a metric without a column is
/// none of any episode.
pub fn read_table(spec: &Spec, text: &str) -> Result<Vec<EpisodeRecord>, TableError> {
    read_table_from(spec, text.as_bytes())
}

/// The same from a file, row by row.
pub fn read_table_from(spec: &Spec, file: impl Read) -> Result<Vec<EpisodeRecord>, TableError> {
    let mut reader = Reader::from_reader(file);
    let names = reader.headers().map_err(|error| broken(&error))?.clone();
    let columns = spec.columns();
    let place = |column: &Described| names.iter().position(|name| name == column.name);
    let places: Vec<Option<usize>> = columns.iter().map(place).collect();
    let read = |cells: Result<StringRecord, csv::Error>| {
        let cells = cells.map_err(|error| broken(&error))?;
        let line = cells.position().map_or(0, csv::Position::line);
        let row = Row { names: &names, cells: &cells };
        row.record(spec, &columns, &places).map_err(|problem| TableError { line, problem })
    };
    reader.records().map(read).collect()
}

/// Lines that are not of the table's shape.
fn broken(error: &csv::Error) -> TableError {
    let line = error.position().map_or(1, csv::Position::line);
    let problem = match error.kind() {
        ErrorKind::UnequalLengths { expected_len, len, .. } => format!("there are {len} cells, not {expected_len}"),
        _ => error.to_string(),
    };
    TableError { line, problem }
}

struct Row<'a> {
    names: &'a StringRecord,
    cells: &'a StringRecord,
}

impl Row<'_> {
    fn record(&self, spec: &Spec, columns: &[Described], places: &[Option<usize>]) -> Result<EpisodeRecord, String> {
        let number = |(column, place): (&Described, &Option<usize>)| {
            let Some(cell) = place.map(|place| &self.cells[place]).filter(|cell| !cell.is_empty()) else {
                return Ok(None);
            };
            let number = match column.kind {
                Kind::F32 => cell.parse::<f32>().ok().map(f64::from),
                _ => cell.parse().ok(),
            };
            let is_sound =
                |number: &f64| number.is_finite() && (column.kind != Kind::Share || [0.0, 1.0].contains(number));
            number.filter(is_sound).map(Some).ok_or_else(|| format!("{} is `{cell}`", column.name))
        };
        let counts = COUNTS.map(|name| self.text(name).ok().filter(|cell| !cell.is_empty()).map(|_| self.parsed(name)));
        let prediction = match counts {
            [None, None, None, None] => None,
            [Some(hits), Some(misses), Some(false_alarms), Some(quiet)] => {
                Some(Confusion { hits: hits?, misses: misses?, false_alarms: false_alarms?, quiet: quiet? })
            }
            _ => return Err("some of the four counts of predictions are missing".to_owned()),
        };
        let category_named = |name: &str| TargetCategory::ALL.into_iter().find(|category| category.name() == name);
        let category = has_targets(spec).then(|| self.with("category", category_named));
        Ok(EpisodeRecord {
            kitchen: match Kitchens::Elsewhere.ids()[..] {
                [elsewhere] if !self.names.iter().any(|name| name == "kitchen") => elsewhere,
                _ => self.with("kitchen", |cell| KitchenId::new(cell.parse().ok()?).ok())?,
            },
            episode: self.parsed("episode")?,
            category: category.transpose()?,
            end: self
                .with("end", |name| [End::Terminated, End::Truncated].into_iter().find(|end| end.name() == name))?,
            length: self.parsed("length")?,
            numbers: columns.iter().zip(places).map(number).collect::<Result<_, String>>()?,
            prediction,
            state_hash: self.with("state_hash", |digits| u64::from_str_radix(digits, 16).ok())?,
        })
    }

    fn text(&self, name: &str) -> Result<&str, String> {
        let place = self.names.iter().position(|one| one == name);
        place.map(|place| &self.cells[place]).ok_or_else(|| format!("there is no column `{name}`"))
    }

    fn with<T>(&self, name: &str, read: impl FnOnce(&str) -> Option<T>) -> Result<T, String> {
        let cell = self.text(name)?;
        read(cell).ok_or_else(|| format!("{name} is `{cell}`"))
    }

    fn parsed<T: FromStr>(&self, name: &str) -> Result<T, String> {
        self.with(name, |cell| cell.parse().ok())
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::{any_record, arm, numbers, small};
    use super::*;
    use proptest::prelude::*;

    fn record(spec: &Spec, given: &[(&str, f64)]) -> EpisodeRecord {
        EpisodeRecord {
            kitchen: KitchenId::new(26).unwrap(),
            episode: 7,
            category: has_targets(spec).then_some(TargetCategory::SoapBottle),
            end: End::Truncated,
            length: 200,
            numbers: numbers(spec, given),
            prediction: None,
            state_hash: 0xab,
        }
    }

    #[test]
    fn every_number_is_the_shortest_that_reads_back_the_same() {
        let given = [
            ("picked_up", 1.0),
            ("pickup_step", 150.0),
            ("return_r", -1e-7),
            ("disturbance_m", f64::from(1e-8f32)),
            ("peak_farthest_m", f64::from(1e16f32)),
            ("wrist_object_m", f64::from(1.0f32 / 3.0)),
        ];
        let spec = arm();
        let mut one = record(spec, &given);
        one.prediction = Some(Confusion { hits: 1, misses: 2, false_alarms: 3, quiet: 4 });
        let text = write_table(spec, &[one], Distribution::Run);
        let (names, line) = text.trim_end().split_once('\n').unwrap();
        let cell = |name: &str| {
            let place = names.split(',').position(|one| one == name).unwrap_or_else(|| panic!("{name}"));
            line.split(',').nth(place).unwrap()
        };
        for (name, expected) in [
            ("category", "SoapBottle"),
            ("objects", "novel"),
            ("end", "truncated"),
            ("picked_up", "1"),
            ("pickup_step", "150"),
            ("return_r", "-0.0000001"),
            ("disturbance_m", "0.00000001"),
            ("peak_farthest_m", "10000000000000000"),
            ("wrist_object_m", "0.33333334"),
            ("prediction_quiet", "4"),
            ("state_hash", "00000000000000ab"),
            ("distribution", "run"),
        ] {
            assert_eq!(cell(name), expected, "{name}");
        }
    }

    #[test]
    fn another_task_has_its_own_columns() {
        let spec = small();
        let mut there = record(&spec, &[("success", 1.0), ("spl", 0.5), ("return_r", 1.0)]);
        there.end = End::Terminated;
        there.numbers[2] = None;
        let text = write_table(&spec, &[record(&spec, &[]), there.clone()], Distribution::Fixed);
        let expected = "kitchen,episode,end,length,return_r,success,spl,state_hash\n\
                        26,7,truncated,200,0,0,0,00000000000000ab\n\
                        26,7,terminated,200,1,1,,00000000000000ab\n";
        assert_eq!(text, expected);
        assert_eq!(read_table(&spec, &text).unwrap()[1], there);
        // Elsewhere there are no kitchens, and all is as if in one.
        there.kitchen = Kitchens::Elsewhere.ids()[0];
        let elsewhere = write_table(&spec, std::slice::from_ref(&there), Distribution::Seeds);
        assert_eq!(elsewhere.lines().nth(1), Some("7,terminated,200,1,1,,00000000000000ab"));
        assert_eq!(read_table(&spec, &elsewhere).unwrap(), [there.clone()]);
        there.kitchen = KitchenId::new(26).unwrap();
        // A metric that was declared later is none of an older table's episodes.
        let older = text.replace(",spl", "").replace(",0,0,0,", ",0,0,").replace(",1,1,,", ",1,1,");
        assert_eq!(read_table(&spec, &older).unwrap()[1], there);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            records in prop::collection::vec(any_record(arm()), 0..20),
            others in prop::collection::vec(any_record(&small()), 0..5),
        ) {
            for (spec, records) in [(arm(), &records), (&small(), &others)] {
                for distribution in [Distribution::Fixed, Distribution::Run] {
                    let text = write_table(spec, records, distribution);
                    let drawn = distribution == Distribution::Run;
                    prop_assert_eq!(&read_table(spec, &text).unwrap(), records);
                    prop_assert_eq!(text.lines().count(), records.len() + 1);
                    prop_assert!(text.lines().skip(1).all(|line| line.ends_with(",run") == drawn));
                }
            }
        }
    }

    #[test]
    fn a_broken_table_names_line_and_column() {
        let spec = arm();
        let error = |text: &str| read_table(spec, text).unwrap_err().to_string();
        assert_eq!(error("kitchen,category,episode\n2,Mug,three\n"), "line 2: episode is `three`");
        assert_eq!(error("kitchen,episode\n2,3\n"), "line 2: there is no column `category`");
        let whole = write_table(spec, &[record(spec, &[]), record(spec, &[])], Distribution::Fixed);
        let cells = whole.lines().next().unwrap().split(',').count();
        let cut = error(&whole[..whole.len() - 18]);
        assert_eq!(cut, format!("line 3: there are {} cells, not {cells}", cells - 1));
        let wrong = |from: &str, to: &str| {
            assert!(whole.contains(from), "{whole}");
            error(&whole.replacen(from, to, 1))
        };
        // Its returns, then `success`.
        assert_eq!(wrong(",200,0,0,0,", ",200,0,0,2,"), "line 2: success is `2`");
        assert_eq!(wrong(",200,0,0,0,", ",200,0,inf,0,"), "line 2: return_r_prime is `inf`");
        assert_eq!(wrong(",,,,00", ",5,,,00"), "line 2: some of the four counts of predictions are missing");
        assert_eq!(wrong("truncated", "time_limit"), "line 2: end is `time_limit`");
        assert!(wrong("\n26,", "\n28,").starts_with("line 2: kitchen"));
    }
}
