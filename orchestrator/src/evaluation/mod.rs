//! Evaluations: whose weights ([`subject`]), what is heard while episodes are played ([`audience`]), how far it is
//! ([`standing`], [`journal`]), the result in words ([`words`]), and the whole of it from folder to result files
//! ([`run`]).

mod audience;
mod journal;
pub mod run;
pub mod standing;
pub mod subject;
#[cfg(test)]
pub mod testing;
pub mod words;
