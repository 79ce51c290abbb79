//! Reads MCAP files, damaged ones too: what can be read is read, and what was lost is named.
//!
//! [`read`] hands on every record of a file's data in order and returns an [`Account`]: what is wrong, by place, cost
//! and time range. Damage that costs no message costs none here: messages are found without indexes, attachments or
//! summary; behind bytes that cannot be read the next record is looked for; definitions that are lost in the data are
//! taken from the summary. All checksums are checked. Bytes of any kind are read within [`Limits`], in a time that grows
//! with their number. [`rewrite`] makes a whole file of what was read.
//!
//! ```
//! let file = mcap::Writer::new(std::io::Cursor::new(Vec::new()))?.into_inner().into_inner();
//! let visit = |_: mcap::records::Record<'_>, _| Ok::<_, std::convert::Infallible>(());
//! let account = salvage::read(&&file[..], &salvage::Limits::default(), visit).unwrap();
//! assert!(account.cut && !account.is_lossless());
//! # Ok::<(), mcap::McapError>(())
//! ```

mod account;
mod chunk;
mod definitions;
mod layout;
mod reader;
mod records;
mod rewrite;
mod source;
mod state;
mod summary;

pub use account::{Account, Cost, Finding, REPAIR_METADATA};
pub use reader::read;
pub use rewrite::rewrite;
pub use source::{FileSource, Source};
pub use state::{Limits, ReadError, Trust};
