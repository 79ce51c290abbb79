//! Damaged recordings: what is read of them, and what is said of the rest.

mod damaged;
mod maker;
mod mutated;
