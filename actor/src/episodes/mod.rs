//! `actor episodes`: the fixed episodes, drawn anew.
//!
//! `draw` makes them from a fixed seed, [`crate::check::episode`] says what an episode must satisfy, and
//! [`simulator::tasks::arm_point_nav::episodes`] keeps the file and its hash. `actor check` goes through them.

mod draw;

use anyhow::{Context, Result};
use proto::config::Config;
use simulator::kitchen::Kitchen;
use simulator::tasks::arm_point_nav::episodes::format::File;
use simulator::tasks::arm_point_nav::episodes::{EPISODES_PER_KITCHEN, FILE_HASH, kitchens};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// What `actor episodes` is asked.
#[derive(Debug, Clone, clap::Subcommand)]
pub enum Command {
    /// Draw them anew for the kitchens as they are now.
    Generate {
        /// File to write.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
}

/// Draws the fixed episodes of all kitchens that have some and writes them to a file.
pub fn run(Command::Generate { out: path }: &Command) -> Result<()> {
    let config = Config::default();
    let mut out = std::io::stdout().lock();
    let mut file = File::default();
    for id in kitchens() {
        let kitchen = Arc::new(Kitchen::build(id, &config.simulation)?);
        let (section, rejected) = draw::draw(&kitchen, &config)?;
        let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
        for problem in &rejected {
            *kinds.entry(problem.kind()).or_default() += 1;
        }
        let kinds: Vec<String> = kinds.into_iter().map(|(kind, count)| format!("{count} {kind}")).collect();
        writeln!(
            out,
            "kitchen {id:>2}: {EPISODES_PER_KITCHEN} episodes; {} draws rejected: {}",
            rejected.len(),
            kinds.join(", ")
        )?;
        out.flush()?;
        file.sections.push(section);
    }
    let bytes = file.to_bytes();
    std::fs::write(path, &bytes).with_context(|| format!("cannot write {}", path.display()))?;
    let hash = xxh3_64(&bytes);
    writeln!(out, "{}: {} bytes, hash {hash:#018x}", path.display(), bytes.len())?;
    if hash != FILE_HASH {
        writeln!(
            out,
            "to be put into actor/simulator/src/tasks/arm_point_nav/episodes/fixed.rs as FILE_HASH (now {FILE_HASH:#018x})"
        )?;
    }
    Ok(())
}
