use std::fs;
use std::io;
use std::path::{Path, PathBuf};

#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    #[error("{} exists; remove it or choose another --out", .0.display())]
    Exists(PathBuf),
    #[error("{} is there: another export writes it, or was killed; if none is running, remove it", .0.display())]
    Partial(PathBuf),
    #[error("{} cannot be written", path.display())]
    Disk { path: PathBuf, source: io::Error },
    #[error("{} cannot be written", path.display())]
    Archive { path: PathBuf, source: zip::result::ZipError },
}

pub(crate) fn disk(path: &Path, source: io::Error) -> DatasetError {
    DatasetError::Disk { path: path.to_path_buf(), source }
}

pub(crate) fn write(path: &Path, content: &[u8]) -> Result<(), DatasetError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).and_then(|()| fs::write(path, content)).map_err(|source| disk(path, source))
}
