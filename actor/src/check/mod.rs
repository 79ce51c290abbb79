//! `actor check`: what must be true of kitchens, of episodes, and of scenes of one's own.
//!
//! ```text
//! kitchens  everything that a kitchen must satisfy
//! episode   what an episode must satisfy
//! scene     what a scene must satisfy
//! ```

pub mod episode;
pub mod kitchens;
pub mod scene;
