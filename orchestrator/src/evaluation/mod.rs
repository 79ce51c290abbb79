//! Evaluations: whose weights ([`subject`]), what is heard while episodes are played ([`audience`]), how far it is
//! ([`standing`]), and the whole of it from folder to result files ([`run`]).

mod audience;
pub mod run;
pub mod standing;
pub mod subject;
#[cfg(test)]
pub mod testing;
