//! The shared library `libstillroom_actor`: a simulator in any language is an actor. `include/stillroom_actor.h` describes
//! it for those who call it.
//!
//! ```text
//! ffi      what the header declares, checked; the only unsafe code
//! serving  what the program is asked: to describe itself, to take part in a run, to simulate recorded episodes again
//! ```

mod ffi;
mod serving;
