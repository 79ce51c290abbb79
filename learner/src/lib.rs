//! The learner: one process per GPU (or CPU) that infers for all actors of its machine, collects rollouts and trains.
//!
//! The algorithm is [`ppo`], on one page. [`agent::Agent`] is network, beliefs, rollout and optimiser behind one
//! struct; it uses no files, and of other processes only the other learners ([`peers`]). [`process`] is everything
//! around it.

pub mod agent;
pub mod auxiliary;
pub mod bench;
pub mod checkpoint;
pub mod collector;
mod declared;
pub mod device;
pub mod evaluation;
mod ffi;
pub mod import;
pub mod network;
pub mod optimizer;
pub mod peers;
pub mod ppo;
pub mod probe;
pub mod process;
pub mod record;
pub mod rollout;
pub mod shards;
mod sizes;
