//! What is proved about kitchens, episodes and scenes, in small.

// Helpers of tests are tests too, which clippy's own exception does not see.
#![allow(clippy::unwrap_used)]

mod figures;
mod kitchens;
mod oracle;
mod scene_file;
mod soak;
