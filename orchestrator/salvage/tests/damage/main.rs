//! Damaged recordings: what is read of them, and what is said of the rest.

// A maker that fails ends its test. The crate of an empty set of options is not ours to name.
#![allow(clippy::unwrap_used, clippy::default_trait_access)]

mod damaged;
mod kept;
mod maker;
mod mutated;
