//! `orchestrator top`: a run on a terminal, live. What is shown comes from [`crate::viewer`], as that of the page does.
//!
//! [`model`] holds what was read last and what the keys have chosen, [`curves`] makes points of rollouts, [`draw`] puts
//! both on the screen, [`panels`] its parts. [`session`] is the terminal around it: keys, signals, a thread that reads,
//! and the way back.

mod curves;
mod draw;
mod model;
mod panels;
pub mod session;

#[cfg(test)]
mod tests;
