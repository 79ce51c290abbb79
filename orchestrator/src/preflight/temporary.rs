use super::Finding;
use rustix::fs::Access;
use std::io::{Error, ErrorKind};
use std::path::Path;
use wire::{WireAddress, WireError, temporary_folder};

pub fn check() -> Finding {
    check_folder(&temporary_folder())
}

pub fn check_for_run() -> Finding {
    match check_name(&"0".repeat(ID)) {
        Err(error) => Finding::Problem(error.to_string()),
        Ok(()) => check(),
    }
}

const ID: usize = 12;

/// Whether a run with this id finds room for its names: they begin with that of the folder.
pub fn check_name(id: &str) -> Result<(), WireError> {
    // Another host adds its number, and a later start has a longer one.
    WireAddress::new(&format!("{id}h999"), 99_999).check_root()
}

fn check_folder(folder: &Path) -> Finding {
    match usable(folder) {
        Ok(()) => Finding::Good(folder.display().to_string()),
        Err(error) => Finding::Problem(format!(
            "the temporary folder {} cannot be used: {error}. Set TMPDIR to a folder that is there and can be written to, \
             or unset it to use /tmp",
            folder.display()
        )),
    }
}

fn usable(folder: &Path) -> Result<(), Error> {
    if !std::fs::metadata(folder)?.is_dir() {
        return Err(ErrorKind::NotADirectory.into());
    }
    Ok(rustix::fs::access(folder, Access::READ_OK | Access::WRITE_OK | Access::EXEC_OK)?)
}
