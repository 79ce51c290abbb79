//! Tasks that are not built in, for commands without a run folder, in which the declaration would lie.

use proto::bounded::read_text;
use proto::config::Setting;
use proto::task::Spec;
use std::path::Path;

/// Declares the task of this file, and gives the setting that names it.
pub(crate) fn declare(path: &str) -> Result<Setting, String> {
    let text = read_text(Path::new(path)).map_err(|cause| format!("cannot be read: {cause}"))?;
    let spec = Spec::declare(&text).map_err(|cause| cause.to_string())?;
    Setting::new("task", spec.name.clone().into()).map_err(|cause| cause.to_string())
}
