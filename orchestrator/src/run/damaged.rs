//! What is said of a file of a run that cannot be understood. Ours are written atomically, so something else did it.

use std::path::Path;

pub fn damaged(path: &Path, remedy: &str) -> String {
    format!("{} is damaged ({remedy})", path.display())
}
