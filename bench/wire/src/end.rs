//! What all ways have in common: where processes meet, what they exchange, and the two ends of an exchange.

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use proto::config::Config;
use std::fmt;
use std::path::PathBuf;
use wire::message::Halves;

/// Action after which nothing is noted.
pub const UNMEASURED: u8 = 0;
/// Action of an exchange that counts.
pub const MEASURED: u8 = 1;
/// Action after which a half sends nothing more.
pub const STOP: u8 = 2;

/// A way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Way {
    /// The product's own: iceoryx2 with bells
    Wire,
    /// POSIX shared memory, one slot a half, with semaphores
    Shm,
    /// Unix stream sockets
    Unix,
    /// ZeroMQ, ROUTER and DEALER, over IPC
    Zeromq,
    /// gRPC (tonic), a bidirectional stream for each actor, over TCP of this machine
    Grpc,
}

impl Way {
    pub const ALL: [Self; 5] = [Self::Wire, Self::Shm, Self::Unix, Self::Zeromq, Self::Grpc];
}

impl fmt::Display for Way {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match self {
            Self::Wire => "wire",
            Self::Shm => "shm",
            Self::Unix => "unix",
            Self::Zeromq => "zeromq",
            Self::Grpc => "grpc",
        };
        formatter.write_str(name)
    }
}

/// Where the processes of a cell meet, and how many they are.
#[derive(Debug, Clone, Args)]
pub struct Place {
    /// Number of the cell's process, of which all names are made
    #[arg(long)]
    pub cell: u32,
    /// Actor processes
    #[arg(long)]
    pub actors: u32,
    /// Frames of a half
    #[arg(long)]
    pub frames: u32,
}

impl Place {
    pub fn new(actors: u32, frames: u32) -> Result<Self> {
        let place = Self { cell: std::process::id(), actors, frames };
        std::fs::create_dir(place.folder()).with_context(|| place.folder().display().to_string())?;
        Ok(place)
    }

    /// Environments of an actor: both halves, but an actor of one environment has only one.
    pub fn environments(&self) -> u32 {
        if self.frames == 1 { 1 } else { 2 * self.frames }
    }

    pub fn halves(&self) -> u32 {
        Halves::of(self.environments()).count()
    }

    pub fn bytes(&self) -> usize {
        self.frames as usize * Config::default().spec().layout().bytes
    }

    pub fn pattern(&self, actor: u32, half: u32, step: u64) -> u8 {
        (step as u8).wrapping_mul(16).wrapping_add((actor * 2 + half) as u8)
    }

    pub fn folder(&self) -> PathBuf {
        std::env::temp_dir().join(format!("stillroom-bench-{}", self.cell))
    }
}

/// What a process other than the learner's is told.
#[derive(Debug, Clone, Args)]
pub struct EndArgs {
    #[command(flatten)]
    pub place: Place,
}

impl EndArgs {
    pub fn arguments(&self) -> Vec<String> {
        let Place { cell, actors, frames } = self.place;
        vec![format!("--cell={cell}"), format!("--actors={actors}"), format!("--frames={frames}")]
    }
}

/// What an actor is told.
#[derive(Debug, Clone, Args)]
pub struct ActorArgs {
    /// The way
    #[arg(long)]
    pub way: Way,
    /// Its number
    #[arg(long)]
    pub actor: u32,
    #[command(flatten)]
    pub end: EndArgs,
}

impl ActorArgs {
    pub fn arguments(&self) -> Vec<String> {
        let mut words = self.end.arguments();
        words.extend([format!("--way={}", self.way), format!("--actor={}", self.actor)]);
        words
    }
}

/// An actor's end.
pub trait ActorEnd {
    /// Writes a half's observations, every byte `pattern`, and sends them.
    fn send(&mut self, half: u32, pattern: u8) -> Result<()>;
    /// Waits for a half's actions; the first of them.
    fn wait(&mut self) -> Result<(u32, u8)>;
}

/// The learner's end.
pub trait LearnerEnd {
    /// Waits until a half of every actor is there, and shows each: the actor, and the bytes where they lie.
    fn receive(&mut self, half: u32, each: &mut dyn FnMut(u32, &[u8])) -> Result<()>;
    /// Sends every actor the actions of a half, one byte an environment, and gives the observations back.
    fn answer(&mut self, half: u32, action: u8) -> Result<()>;
}

pub fn actions(place: &Place, action: u8) -> Vec<u8> {
    vec![action; place.frames as usize]
}
