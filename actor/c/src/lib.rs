//! The shared library `libstillroom_actor`: a simulator in any language is an actor. `include/stillroom_actor.h` describes
//! it for those who call it.
//!
//! ```text
//! exports  the functions of the header
//! ffi      a simulator as the header describes it, checked; the only unsafe code but for the exports
//! serving  what the program is asked: to describe itself, to take part in a run, to simulate recorded episodes again
//! error    why it does not
//! ```

mod error;
mod exports;
mod ffi;
mod serving;
