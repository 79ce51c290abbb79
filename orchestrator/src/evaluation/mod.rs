//! Evaluations: what is asked ([`choice`]), whose weights ([`subject`]), the records while episodes are played
//! ([`audience`]), the progress ([`progress`], [`journal`]), the result in words ([`text`]), and the whole of it from folder
//! to result files ([`run`]).

mod audience;
pub mod choice;
pub mod journal;
pub mod progress;
pub mod run;
pub mod subject;
#[cfg(test)]
pub mod testing;
pub mod text;
