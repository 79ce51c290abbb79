//! `actor episodes`: draws the fixed episodes, or checks those that are part of the program.

use super::draw;
use crate::check::episode::verdicts;
use anyhow::{Context, Result, bail};
use proto::config::Config;
use simulator::kitchen::Kitchen;
use simulator::tasks::arm_point_nav::episodes::format::File;
use simulator::tasks::arm_point_nav::episodes::{EPISODES_PER_KITCHEN, FILE_HASH, fixed, kitchens};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
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
    /// Check those that are part of this program.
    Check,
}

pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Generate { out } => generate(out),
        Command::Check => check_all(),
    }
}

/// Draws the fixed episodes of all kitchens that have some and writes them to a file.
fn generate(path: &Path) -> Result<()> {
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

/// Checks every fixed episode that is part of the program: a line per kitchen; an error if one is not valid.
fn check_all() -> Result<()> {
    let config = Config::default();
    let mut out = std::io::stdout().lock();
    let (mut valid, mut wrong) = (0, 0);
    for id in kitchens() {
        let kitchen = Arc::new(Kitchen::build(id, &config.simulation)?);
        let verdicts = verdicts(&kitchen, &config, &fixed(&kitchen)?);
        for (index, verdict) in verdicts.iter().enumerate() {
            if let Err(problem) = verdict {
                writeln!(out, "kitchen {id}, episode {index}: {problem}")?;
            }
        }
        let good = verdicts.iter().filter(|verdict| verdict.is_ok()).count();
        writeln!(out, "kitchen {id:>2}: {good} of {} episodes valid", verdicts.len())?;
        out.flush()?;
        valid += good;
        wrong += verdicts.len() - good;
    }
    writeln!(out, "all: {valid} of {} episodes valid", valid + wrong)?;
    if wrong > 0 {
        bail!("{wrong} episodes are not valid");
    }
    Ok(())
}
