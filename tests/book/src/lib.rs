//! The book in `docs/`, which mdBook makes a site of, as data for tests: its pages, their code blocks, and the page of
//! all settings as it has to be.
//!
//! Every block of shell commands says what becomes of it: `sh,run` is run as it stands, `sh,run=small` with a tiny
//! network and few frames for `stillroom up`, `sh,norun=REASON` is not run. A block with `from=PATH:ANCHOR` is a copy of
//! that source.

mod block;
mod page;
mod settings;
mod types;

pub use block::{Block, How, REASONS};
pub use page::{Page, links, pages, source};
pub use settings::settings_page;
pub use types::Types;

use std::path::{Path, PathBuf};

/// Why the book cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum BookError {
    /// A file cannot be read.
    #[error("{path}: {cause}")]
    Unreadable { path: PathBuf, cause: std::io::Error },
    #[error("{path}: {cause}")]
    NoRust { path: PathBuf, cause: syn::Error },
    /// A type of the configuration is not among the sources.
    #[error("no source defines the type `{0}`")]
    NoType(String),
    /// What is copied is not there.
    #[error("{page} copies {target}, where there is no anchor `{anchor}`")]
    NoAnchor { page: String, target: String, anchor: String },
}

fn read(path: &Path) -> Result<String, BookError> {
    std::fs::read_to_string(path).map_err(|cause| BookError::Unreadable { path: path.to_owned(), cause })
}
