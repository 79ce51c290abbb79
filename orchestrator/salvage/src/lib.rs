//! Reads MCAP files, damaged ones too: what can be read is read, and what was lost is named.
//!
//! [`read`] hands on every record of a file's data in order and returns an [`Account`]: what is wrong, by place, cost
//! and time range. Damage that costs no message costs none here: messages are found without indexes, attachments or
//! summary; behind bytes that cannot be read the next record is looked for; definitions that are lost in the data are
//! taken from the summary. All checksums are checked. Bytes of any kind are read within [`Limits`], in a time that grows
//! with their number. [`rewrite`] makes a whole file of what was read.
//!
//! ```
//! use salvage::{Limits, Trust, read, rewrite};
//!
//! let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new()))?;
//! let channel = writer.add_channel(0, "/topic", "json", &Default::default())?;
//! let header = mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 1, publish_time: 1 };
//! writer.write_to_known_channel(&header, b"{}")?;
//! writer.finish()?;
//! let mut file = writer.into_inner().into_inner();
//!
//! file.truncate(file.len() - 20);
//! let account = read(&&file[..], &Limits::default(), |_, trust| {
//!     assert_eq!(trust, Trust::Sound);
//!     Ok::<_, std::convert::Infallible>(())
//! })
//! .unwrap();
//! assert_eq!((account.messages, account.is_whole(), account.is_lossless()), (1, false, true));
//!
//! let mut repaired = std::io::Cursor::new(Vec::new());
//! rewrite(&&file[..], &Limits::default(), mcap::WriteOptions::new(), &mut repaired).unwrap();
//! # Ok::<(), mcap::McapError>(())
//! ```

mod account;
mod chunk;
mod definitions;
mod ending;
mod landmarks;
mod last_chunk;
mod layout;
mod reader;
mod resync;
mod rewrite;
mod source;
mod state;
mod unpack;

pub use account::{Account, Cost, Finding, Problem, REPAIR_METADATA};
pub use reader::{ReadError, read};
pub use rewrite::{RewriteError, rewrite};
pub use source::{FileSource, Source};
pub use state::{Limits, Trust};
