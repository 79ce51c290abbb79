//! `orchestrator top`: a run on a terminal, live. What is shown comes from [`crate::viewer`], as that of the page does.

mod curves;
mod draw;
mod model;
mod panels;
pub mod session;

#[cfg(test)]
mod tests;
