//! Several hosts, one run. Each host runs this program; host 0 supervises, and an agent on every other host carries out
//! what it orders there.
//!
//! [`membership`] knows from flags and a launcher's variables which host this is. The hosts meet at the [`rendezvous`],
//! where both sides prove the run's token ([`token`], [`handshake`]); from then on messages go over a [`link`]. [`agent`]
//! is what other hosts run, with what [`place`] prepares there. [`address`] finds this host's own address.

pub mod address;
pub mod agent;
mod handshake;
mod host_folder;
mod link;
pub mod membership;
pub mod rendezvous;
pub mod token;
