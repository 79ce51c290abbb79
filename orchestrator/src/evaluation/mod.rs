//! Evaluations: what is asked, whose weights they are, and the whole of it from folder to result files ([`run`]).

mod audience;
pub mod choice;
pub mod journal;
pub mod progress;
pub mod run;
pub mod subject;
#[cfg(test)]
pub mod testing;
pub mod text;
