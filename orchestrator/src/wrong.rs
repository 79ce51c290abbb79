//! What is wrong in itself: the command line, or what it names.

use anyhow::{Error, Result, anyhow};
use proto::config::ConfigError;
use proto::stage::TooFewFrames;
use std::fmt::{Display, Formatter};
use std::io::ErrorKind;
use std::path::Path;

/// The command line, or a file or folder that it names, is wrong or not there: the exit status is 2, since the same call
/// fails again.
#[derive(Debug)]
struct Wrong(Error);

impl Display for Wrong {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:#}", self.0)
    }
}

impl std::error::Error for Wrong {}

pub fn wrong(error: impl Into<Error>) -> Error {
    Wrong(error.into()).into()
}

pub fn judged<T>(result: Result<T>) -> Result<T> {
    result.map_err(wrong)
}

/// Refuses a file to write whose folder is not there.
pub fn demand_folder(out: &Path) -> Result<()> {
    match out.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
        Some(folder) => {
            Err(wrong(anyhow!("--out {}: there is no folder {}: make it first", out.display(), folder.display())))
        }
        None => Ok(()),
    }
}

/// Refuses what is asked.
macro_rules! reject {
    ($($text:tt)*) => {
        return Err($crate::wrong::wrong(anyhow::anyhow!($($text)*)))
    };
}

/// Refuses what is asked, unless this is so.
macro_rules! demand {
    ($so:expr, $($text:tt)*) => {
        if !$so {
            $crate::wrong::reject!($($text)*);
        }
    };
}

pub(crate) use {demand, reject};

const NAMED_WRONGLY: [ErrorKind; 5] = [
    ErrorKind::NotFound,
    ErrorKind::PermissionDenied,
    ErrorKind::InvalidInput,
    ErrorKind::InvalidData,
    ErrorKind::FileTooLarge,
];

/// An error and its causes, also of what is wrong in itself.
pub fn causes(error: &Error) -> impl Iterator<Item = &(dyn std::error::Error + 'static)> {
    error.downcast_ref::<Wrong>().map_or(error, |Wrong(inner)| inner).chain()
}

pub fn is_wrong(error: &Error) -> bool {
    let of_config = |cause: &ConfigError| match cause {
        // A disk that fails may work again.
        ConfigError::Unreadable { cause, .. } => NAMED_WRONGLY.contains(&cause.kind()),
        // A run's own files are not what the user typed.
        ConfigError::OfRun { .. } | ConfigError::OtherTask { .. } => false,
        _ => true,
    };
    let is_typed = |cause: &(dyn std::error::Error + 'static)| cause.is::<Wrong>() || cause.is::<TooFewFrames>();
    error.chain().any(|cause| is_typed(cause) || cause.downcast_ref().is_some_and(of_config))
}
