//! Whole-system tests, as one program: their modules share what each would have to link.

mod bad_input;
mod budget;
mod evaluation;
mod gpu;
mod learners;
mod orchestrator_faults;
mod overlap;
mod same_weights;
mod suite;
mod whole_run;
