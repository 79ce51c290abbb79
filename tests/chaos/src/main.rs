//! Chaos: real runs of the built programs under a seeded schedule of faults, each compared with an undisturbed one;
//! and a soak, which watches memory, descriptors and disk of a long one.
//!
//! ```text
//! campaign     cases until enough has happened; the undisturbed references
//! fault        what can happen, and which of it happens in which case (draw, points)
//! shape        what it happens to
//! training, evaluation, suite    one case of each kind, from its first start to its completion
//! session, place, processes      one command; where it runs; who belongs to it
//! disk, privileges               a disk whose power can fail; what the machine allows
//! inject       a fault, carried out
//! judge        whether faults explain how a command ended
//! leftovers                      what is left behind; `system_tests::evidence` has all else that is compared
//! soak, slope  a long run: what grows
//! ```

mod campaign;
mod case_folder;
mod disk;
mod draw;
mod evaluation;
mod fault;
mod inject;
mod judge;
mod leftovers;
mod points;
mod privileges;
mod processes;
mod run_kind;
mod session;
mod slope;
mod soak;
mod suite;
mod tally;
mod training;

use anyhow::Result;
use clap::Parser;
use std::process::ExitCode;

#[derive(Debug, clap::Parser)]
#[command(name = "chaos", version = version(), about = "Real runs under a seeded schedule of faults, compared with undisturbed ones")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

/// As `wire::version!`, but for the releases, in which this program is not.
fn version() -> &'static str {
    wire::version::with_commit(env!("CARGO_PKG_VERSION"), option_env!("STILLROOM_COMMIT"))
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    Faults(campaign::Campaign),
    Soak(soak::Soak),
}

fn main() -> Result<ExitCode> {
    let all_is_well = match Arguments::parse().command {
        Command::Faults(campaign) => campaign.run()?,
        Command::Soak(soak) => soak.run()?,
    };
    Ok(if all_is_well { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
