//! Whole-system tests, as one program: their modules share what each would have to link.

mod bad_input;
mod budget;
mod evaluation;
mod figures;
mod gpu;
mod hangs;
mod learners;
mod measuring;
mod orchestrator_faults;
mod recordings;
mod same_weights;
mod suite;
mod whole_run;
