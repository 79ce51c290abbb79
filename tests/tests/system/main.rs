//! Whole-system tests, as one program: their modules share what each would have to link.

mod bad_input;
mod budget;
mod evaluation;
mod figures;
mod gpu;
mod hangs;
mod hosts;
mod learners;
mod measuring;
mod orchestrator_faults;
mod procedural;
mod recordings;
mod same_weights;
mod suite;
mod tables;
mod terminal;
mod view;
mod view_page;
mod whole_run;
