//! Several hosts, one run. Each host runs this program; host 0 supervises, and an [`agent`] on every other host carries out
//! what it orders there. They meet at the [`rendezvous`], where both sides prove the run's [`token`].

pub mod address;
pub mod agent;
mod handshake;
mod host_folder;
mod link;
pub mod membership;
pub mod rendezvous;
pub mod token;
