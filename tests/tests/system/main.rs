//! Whole-system tests, as one program: their modules share what each would have to link.

mod bad_input;
mod before_and_after;
mod book;
mod budget;
mod evaluation;
mod figures;
mod gpu;
mod hangs;
mod hosts;
mod learners;
mod measuring;
mod opens;
mod orchestrator_faults;
mod overlap;
mod pictures;
mod procedural;
mod recordings;
mod same_weights;
mod strangers;
mod suite;
mod tables;
mod terminal;
mod view;
mod view_beside;
mod view_page;
mod whole_run;
