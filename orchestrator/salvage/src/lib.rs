//! Reads MCAP files, damaged ones too: what can be read is read, and what was lost is named.
//!
//! [`read`] hands on every record of a file's data in order and returns an [`Account`]: what is wrong, and where. A record
//! or chunk that was altered is left out, and the next one read; where lengths were altered, reading ends. Our recorder's
//! files need no more: whatever lies behind a damage of a power failure is recorded again when the run is resumed.
//! [`rewrite`] makes a whole file of what was read.
//!
//! ```
//! let file = mcap::Writer::new(std::io::Cursor::new(Vec::new()))?.into_inner().into_inner();
//! let account = salvage::read(&&file[..], |_| Ok::<_, std::convert::Infallible>(())).unwrap();
//! assert!(account.cut && !account.is_lossless());
//! # Ok::<(), mcap::McapError>(())
//! ```

mod account;
mod layout;
mod reader;
mod rewrite;
mod source;

pub use account::{Account, REPAIR_METADATA};
pub use layout::{Frame, Next, each_record, next};
pub use reader::{ReadError, read};
pub use rewrite::rewrite;
pub use source::{FileSource, Source};
