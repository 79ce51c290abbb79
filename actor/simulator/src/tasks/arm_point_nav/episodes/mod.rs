//! The episodes of evaluations: the fixed ones of the validation and test kitchens, 12 categories times 60 in each of
//! the ten, and as many in any kitchen that are [`drawn`](drawn()).
//!
//! ```text
//! format     the file that the fixed ones are kept in, part of the program
//! fixed      what that file means in a kitchen
//! drawn      episodes drawn as training draws its own
//! programme  which episodes a run's environments play
//! ```

mod drawn;
mod fixed;
pub mod format;
mod programme;

pub use drawn::drawn;
pub use fixed::{EpisodesError, FILE_HASH, category, episode_of, fingerprint, fixed, kitchens};
pub use format::EPISODES_PER_KITCHEN;
pub(super) use programme::{episode, fixed_of};
