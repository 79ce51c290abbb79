use crate::output::format::counted;
use crate::training::scores::read_result;
use anyhow::{Context, Result, bail};
use proto::bounded::TABLE_BYTES_MOST;
use proto::evaluation::{TABLE_FILE, read_table_from};
use proto::run_folder::RunFolder;
use proto::task::Spec;
use report::study::Evaluated;

pub(super) fn evaluation(spec: &Spec, run: &RunFolder) -> Result<Evaluated> {
    let (folder, result) = (run.root(), read_result(run)?);
    if result.task != spec.name {
        bail!("{} is an evaluation of the task `{}`, not of `{}`", folder.display(), result.task, spec.name);
    }
    let path = folder.join(TABLE_FILE);
    let table = run.reader(&path, TABLE_BYTES_MOST).with_context(|| format!("cannot read {}", path.display()))?;
    let episodes = read_table_from(spec, table).with_context(|| path.display().to_string())?;
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
