//! Reads the folder of an evaluation.

use crate::run::damaged::damaged;
use crate::showing::format::counted;
use anyhow::{Context, Result, bail};
use proto::SCHEMA_VERSION;
use proto::bounded::{RESULT_BYTES_MOST, TABLE_BYTES_MOST};
use proto::evaluation::{Evaluation, RESULT_FILE, TABLE_FILE, read_table_from};
use proto::run_folder::RunFolder;
use report::study::Evaluated;

/// An evaluation with its episodes.
pub(super) fn evaluation(run: &RunFolder) -> Result<Evaluated> {
    let folder = run.root();
    let read = |name: &str, most| {
        let path = folder.join(name);
        run.reader(&path, most).with_context(|| format!("cannot read {}", path.display()))
    };
    let damaged = || damaged(&folder.join(RESULT_FILE), "delete its folder, and evaluate again");
    // The version first: what a later one holds cannot be read by this one's rules.
    let value: serde_json::Value =
        serde_json::from_reader(read(RESULT_FILE, RESULT_BYTES_MOST)?).with_context(damaged)?;
    let version = value["schema_version"].as_u64();
    if version != Some(u64::from(SCHEMA_VERSION)) {
        bail!(
            "{} is of schema {}; this program reads schema {SCHEMA_VERSION}: evaluate again",
            folder.join(RESULT_FILE).display(),
            version.map_or_else(|| "unknown".to_owned(), |version| version.to_string())
        );
    }
    let result: Evaluation = serde_json::from_value(value).with_context(damaged)?;
    let table = read(TABLE_FILE, TABLE_BYTES_MOST)?;
    let episodes = read_table_from(table).with_context(|| format!("{}", folder.join(TABLE_FILE).display()))?;
    if result.overall.episodes != episodes.len() as u64 {
        bail!(
            "{}: the table has {}, the result file {}",
            folder.display(),
            counted(episodes.len() as u64, "episode"),
            result.overall.episodes
        );
    }
    let name = folder.file_name().map_or_else(|| folder.display().to_string(), |name| name.to_string_lossy().into());
    Ok(Evaluated { name, folder: folder.to_path_buf(), result, episodes })
}
