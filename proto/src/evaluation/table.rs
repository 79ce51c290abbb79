//! The table of an evaluation's episodes, as CSV: a line of names, then a line an episode.

use super::asked::ObjectSet;
use super::confusion::Confusion;
use super::distribution::Distribution;
use super::record::{EpisodeEnd, EpisodeRecord};
use crate::kitchen::{KitchenId, TargetCategory};
use crate::reward::UNDISTURBED_THRESHOLD_M;
use csv::{ErrorKind, Reader, StringRecord, WriterBuilder};
use serde::{Deserialize, Serialize, Serializer};
use std::fmt::Display;
use std::io::Read;

/// Makes the type of a line of the table from one list of columns, in order. A column of the record is copied both
/// ways. A computed one has its value beside it; what reading does with it is in [`Row::record`]. serde alone cannot do
/// this: csv writes no names for nested or flattened structs, and the record's own form, in JSON, has other flags and
/// another hash.
macro_rules! columns {
    ($record:ident, $distribution:ident; $(
        copied { $($(#[$of_copied:meta])* $copied:ident: $copied_type:ty,)* }
        computed { $($(#[$of_computed:meta])* $computed:ident: $computed_type:ty = $value:expr,)* }
    )*) => {
        /// A line of the table.
        #[derive(Debug, Serialize, Deserialize)]
        struct Row { $(
            $($(#[$of_copied])* $copied: $copied_type,)*
            $($(#[$of_computed])* $computed: $computed_type,)*
        )* }

        /// The line of names.
        const NAMES: &[&str] = &[$($(stringify!($copied),)* $(stringify!($computed),)*)*];

        impl Row {
            fn of($record: &EpisodeRecord, $distribution: Distribution) -> Self {
                Self { $($($copied: $record.$copied,)* $($computed: $value,)*)* }
            }

            fn with(self, disturb_prediction: Option<Confusion>) -> EpisodeRecord {
                EpisodeRecord { $($($copied: self.$copied,)*)* disturb_prediction }
            }
        }
    };
}

columns! { record, distribution;
    copied {
        kitchen: KitchenId,
        episode: u32,
        category: TargetCategory,
    }
    computed {
        #[serde(skip_deserializing)]
        objects: Option<ObjectSet> = Some(record.object_set()),
    }
    copied {
        end: EpisodeEnd,
        #[serde(with = "flag")]
        success: bool,
    }
    computed {
        #[serde(with = "flag", skip_deserializing)]
        success_without_disturbance: bool = record.succeeded_within(UNDISTURBED_THRESHOLD_M),
    }
    copied {
        #[serde(with = "flag")]
        picked_up: bool,
        pickup_step: Option<u32>,
        length: u32,
        failed_actions: u32,
        #[serde(serialize_with = "shortest")]
        return_r: f64,
        #[serde(serialize_with = "shortest")]
        return_r_prime: f64,
        #[serde(serialize_with = "shortest")]
        disturbance_m: f32,
        #[serde(serialize_with = "shortest")]
        peak_disturbance_m: f32,
        disturbed_objects: u32,
        ever_disturbed_objects: u32,
        #[serde(serialize_with = "shortest")]
        farthest_m: f32,
        #[serde(serialize_with = "shortest")]
        peak_farthest_m: f32,
        disturbing_steps: Option<u32>,
        displaced_steps: Option<u32>,
        #[serde(serialize_with = "shortest")]
        wrist_object_m: f32,
        #[serde(serialize_with = "shortest")]
        object_goal_m: f32,
    }
    computed {
        disturb_hits: Option<u64> = record.disturb_prediction.map(|counts| counts.hits),
        disturb_misses: Option<u64> = record.disturb_prediction.map(|counts| counts.misses),
        disturb_false_alarms: Option<u64> = record.disturb_prediction.map(|counts| counts.false_alarms),
        disturb_quiet: Option<u64> = record.disturb_prediction.map(|counts| counts.quiet),
    }
    copied {
        #[serde(with = "hash")]
        state_hash: u64,
    }
    computed {
        // Only in tables of drawn episodes, after all others: tables of fixed ones stay as they were before there were
        // two.
        #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
        distribution: Option<Distribution> = (distribution == Distribution::Run).then_some(distribution),
    }
}

impl Row {
    fn record(self) -> Result<EpisodeRecord, String> {
        let counts = [self.disturb_hits, self.disturb_misses, self.disturb_false_alarms, self.disturb_quiet];
        let disturb_prediction = match counts {
            [None, None, None, None] => None,
            [Some(hits), Some(misses), Some(false_alarms), Some(quiet)] => {
                Some(Confusion { hits, misses, false_alarms, quiet })
            }
            _ => return Err("some of the four counts of predictions are missing".to_owned()),
        };
        Ok(self.with(disturb_prediction))
    }
}

/// The shortest number that reads back the same, without an exponent.
fn shortest<S: Serializer>(value: &impl Display, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(value)
}

/// True and false as 1 and 0.
mod flag {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over references")]
    pub fn serialize<S: Serializer>(set: &bool, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u8(u8::from(*set))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
        match u8::deserialize(deserializer)? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(D::Error::custom(format!("`{other}` is not 0 or 1"))),
        }
    }
}

/// 16 hex digits.
mod hash {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde hands over references")]
    pub fn serialize<S: Serializer>(hash: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{hash:016x}"))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        let digits = String::deserialize(deserializer)?;
        u64::from_str_radix(&digits, 16).map_err(|_| D::Error::custom("state_hash is no hash"))
    }
}

/// The table of these episodes: the line of names, then a line for each.
pub fn write_table(records: &[EpisodeRecord], distribution: Distribution) -> String {
    const WRITTEN: &str = "every field of a row is one cell, and memory takes it";
    let mut writer = WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    let last = usize::from(distribution == Distribution::Fixed);
    writer.write_record(&NAMES[..NAMES.len() - last]).expect(WRITTEN);
    for record in records {
        writer.serialize(Row::of(record, distribution)).expect(WRITTEN);
    }
    let bytes = writer.into_inner().expect("memory takes every byte");
    String::from_utf8(bytes).expect("names, numbers and commas are UTF-8")
}

/// A table that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct TableError {
    /// Line in the file, from 1.
    pub line: u64,
    /// What is wrong.
    pub problem: String,
}

/// Reads what [`write_table`] wrote. Columns are found by name; unknown ones are ignored.
pub fn read_table(text: &str) -> Result<Vec<EpisodeRecord>, TableError> {
    read_table_from(text.as_bytes())
}

/// The same from a file, row by row.
pub fn read_table_from(file: impl Read) -> Result<Vec<EpisodeRecord>, TableError> {
    let mut reader = Reader::from_reader(file);
    let names = reader.headers().map_err(|error| broken(&error))?.clone();
    let read = |cells: Result<StringRecord, csv::Error>| {
        let cells = cells.map_err(|error| broken(&error))?;
        let line = cells.position().map_or(0, csv::Position::line);
        let row: Row = cells
            .deserialize(Some(&names))
            .map_err(|error| TableError { line, problem: problem(&error, &names, &cells) })?;
        row.record().map_err(|problem| TableError { line, problem })
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

/// What is wrong with a line of the right shape: with which column, where that is known.
fn problem(error: &csv::Error, names: &StringRecord, cells: &StringRecord) -> String {
    let ErrorKind::Deserialize { err, .. } = error.kind() else { return error.to_string() };
    let column = err.field().and_then(|field| usize::try_from(field).ok());
    match column.and_then(|column| names.get(column).zip(cells.get(column))) {
        Some((name, cell)) => format!("{name} is `{cell}`"),
        None => err.kind().to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::any_record;
    use super::*;
    use proptest::prelude::*;
    use proptest::strategy::ValueTree;

    const HEADER: &str = "kitchen,episode,category,objects,end,success,success_without_disturbance,picked_up,\
                         pickup_step,length,failed_actions,return_r,return_r_prime,disturbance_m,peak_disturbance_m,disturbed_objects,\
                         ever_disturbed_objects,farthest_m,peak_farthest_m,disturbing_steps,\
                         displaced_steps,wrist_object_m,object_goal_m,disturb_hits,disturb_misses,\
                         disturb_false_alarms,disturb_quiet,state_hash";

    fn record() -> EpisodeRecord {
        EpisodeRecord {
            kitchen: KitchenId::new(26).unwrap(),
            episode: 7,
            category: TargetCategory::SoapBottle,
            end: EpisodeEnd::TimeLimit,
            success: false,
            picked_up: true,
            pickup_step: Some(150),
            length: 200,
            failed_actions: 3,
            return_r: -1e-7,
            return_r_prime: 10.0,
            disturbance_m: 1e-8,
            peak_disturbance_m: 0.1,
            disturbed_objects: 0,
            ever_disturbed_objects: 2,
            farthest_m: 0.0,
            peak_farthest_m: 1e16,
            disturbing_steps: Some(2),
            displaced_steps: None,
            wrist_object_m: 1.0 / 3.0,
            object_goal_m: 2.5,
            disturb_prediction: None,
            state_hash: 0xab,
        }
    }

    #[test]
    fn every_byte_is_as_it_always_was() {
        let confusion = Confusion { hits: 1, misses: 2, false_alarms: 3, quiet: 4 };
        let seen = EpisodeRecord {
            category: TargetCategory::Apple,
            end: EpisodeEnd::Done,
            success: true,
            disturb_prediction: Some(confusion),
            state_hash: u64::MAX,
            ..record()
        };
        let numbers = "-0.0000001,10,0.00000001,0.1,0,2,0,10000000000000000,2,,0.33333334,2.5";
        let lines = [
            format!("26,7,SoapBottle,novel,time_limit,0,0,1,150,200,3,{numbers},,,,,00000000000000ab"),
            format!("26,7,Apple,seen,done,1,1,1,150,200,3,{numbers},1,2,3,4,ffffffffffffffff"),
        ];
        let records = [record(), seen];
        let fixed = format!("{HEADER}\n{}\n{}\n", lines[0], lines[1]);
        assert_eq!(write_table(&records, Distribution::Fixed), fixed);
        let drawn = format!("{HEADER},distribution\n{},run\n{},run\n", lines[0], lines[1]);
        assert_eq!(write_table(&records, Distribution::Run), drawn);
        assert_eq!(write_table(&[], Distribution::Fixed), format!("{HEADER}\n"), "no episodes, but the names");
        assert_eq!(write_table(&[], Distribution::Run), format!("{HEADER},distribution\n"));
        assert_eq!(read_table(&write_table(&[], Distribution::Fixed)), Ok(vec![]));
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(records in prop::collection::vec(any_record(), 0..20)) {
            for distribution in [Distribution::Fixed, Distribution::Run] {
                let text = write_table(&records, distribution);
                let drawn = distribution == Distribution::Run;
                prop_assert_eq!(&read_table(&text).unwrap(), &records);
                prop_assert_eq!(text.lines().count(), records.len() + 1);
                prop_assert!(text.lines().skip(1).all(|line| line.ends_with(",run") == drawn));
                prop_assert!(text.starts_with(HEADER) && text.contains(",distribution\n") == drawn);
            }
        }
    }

    #[test]
    fn a_table_of_an_older_version_lacks_columns_not_records() {
        let without = |text: String| text.replace(",pickup_step", "").replace(",1,150,200", ",1,200");
        let older = without(write_table(&[record()], Distribution::Fixed));
        assert_eq!(read_table(&older).unwrap(), [EpisodeRecord { pickup_step: None, ..record() }]);
    }

    #[test]
    fn a_broken_table_names_line_and_column() {
        let error = |text: &str| read_table(text).unwrap_err().to_string();
        assert_eq!(error("kitchen,episode\n2,three\n"), "line 2: episode is `three`");
        assert_eq!(error("kitchen,episode\n2,3\n"), "line 2: missing field `category`");
        let whole = write_table(&[record(), record()], Distribution::Fixed);
        assert_eq!(error(&whole[..whole.len() - 18]), "line 3: there are 27 cells, not 28");
        assert!(error(&whole.replacen(",0,0,1,150", ",2,0,1,150", 1)).starts_with("line 2: "));
        assert_eq!(
            error(&whole.replacen(",,,,,", ",5,,,,", 1)),
            "line 2: some of the four counts of predictions are missing"
        );
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        let record = any_record().new_tree(&mut runner).unwrap().current();
        let text = write_table(&[record], Distribution::Fixed).replacen(&format!("\n{},", record.kitchen), "\n28,", 1);
        assert!(error(&text).starts_with("line 2: "));
    }
}
