use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};
use learner::process::{self, Arguments, EvaluationArguments, Network};
use learner::{bench, probe};
use proto::exit::{EXIT_LOST_PEERS, EXIT_NON_FINITE, EXIT_UNSAVED};
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::process::ExitCode;
use wire::WireAddress;

wire::require_processor!();

/// Infers for its actors, collects rollouts and trains, together with the run's other learners. Started by
/// `orchestrator`.
#[derive(Debug, Parser)]
#[command(version = wire::version!(), args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct CommandLine {
    #[command(subcommand)]
    command: Option<Command>,
    /// Run folder; its config.toml is the configuration
    #[arg(long, required = true)]
    run: Option<PathBuf>,
    /// Where the run's shared memory lives: PREFIX@FOLDER
    #[arg(long, required = true)]
    wire: Option<WireAddress>,
    /// How often this learner has been started under this wire address
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    incarnation: u32,
    /// Rank among the run's learners; 0 reports for all
    #[arg(long, default_value_t = 0)]
    rank: u32,
    /// Standard input is a pipe from the orchestrator: save and leave when it closes, ignore Ctrl-C
    #[arg(long)]
    lifeline: bool,
    #[command(flatten)]
    network: NetworkArgs,
}

/// Where learners of several hosts meet.
#[derive(Debug, clap::Args)]
struct NetworkArgs {
    /// Hosts that share the run's learners
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), requires_all = ["meet", "address"])]
    hosts: u32,
    /// Where the first learner's store is
    #[arg(long, value_name = "ADDRESS:PORT", requires = "address")]
    meet: Option<SocketAddr>,
    /// This host's own address
    #[arg(long, value_name = "ADDRESS", requires = "meet")]
    address: Option<IpAddr>,
    /// The descriptor that the first learner has inherited, of the socket that listens at --meet
    #[arg(long, value_name = "DESCRIPTOR")]
    listener: Option<i32>,
}

impl NetworkArgs {
    fn network(self) -> Option<Network> {
        let Self { hosts, meet, address, listener } = self;
        Some(Network { hosts, store: meet?, own: address?, listener })
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Prints the version of libtorch and the devices it finds, as one line of JSON
    Check,
    /// Plays the fixed episodes of an evaluation. Started by `orchestrator eval`
    Evaluate(EvaluateArgs),
    /// Writes a new run's first checkpoint from weights of elsewhere. Started by `orchestrator import`
    Import(process::ImportArguments),
    /// Measures inference and updates on this machine
    Bench(bench::Arguments),
    /// Measures how long learners take to sum a gradient, on this machine or over a network
    Exchange(bench::exchange::Arguments),
    /// Runs network, losses and gradients on a batch from a file, to compare with another implementation
    Probe(probe::Arguments),
}

#[derive(Debug, clap::Args)]
struct EvaluateArgs {
    /// Folder of the evaluation; its config.toml is the configuration
    #[arg(long)]
    run: PathBuf,
    /// Where its shared memory lives: PREFIX@FOLDER
    #[arg(long)]
    wire: WireAddress,
    /// How often this learner has been started under this wire address
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    incarnation: u32,
    /// Standard input is a pipe from the orchestrator: leave when it closes, ignore Ctrl-C
    #[arg(long)]
    lifeline: bool,
}

/// A command line without a subcommand is the orchestrator's to write.
fn parsed() -> CommandLine {
    CommandLine::try_parse().unwrap_or_else(|error| {
        let has_no_command = std::env::args().nth(1).is_none_or(|word| word.starts_with('-'));
        match error.kind() {
            kind @ (ErrorKind::MissingRequiredArgument | ErrorKind::UnknownArgument) if has_no_command => {
                let meant = "`orchestrator up` starts it; `learner --help` lists what else it does";
                CommandLine::command().error(kind, meant).exit()
            }
            _ => error.exit(),
        }
    })
}

fn main() -> ExitCode {
    // First: any query for CUDA before its library is loaded makes CUDA unavailable for the whole process.
    learner::device::load_cuda();
    learner::device::keep_freed_memory();
    wire::logging::to_stderr();
    // One that was not started by the orchestrator has inherited no raised limit.
    wire::descriptors::raise_limit();
    learner::device::log_warnings();
    learner::device::log_refusals();
    let line = parsed();
    let result = match line {
        CommandLine { command: Some(Command::Check), .. } => process::check(std::io::stdout()),
        CommandLine { command: Some(Command::Evaluate(args)), .. } => {
            let EvaluateArgs { run: folder, wire, incarnation, lifeline } = args;
            process::evaluate(EvaluationArguments { folder, wire, incarnation, lifeline })
        }
        CommandLine { command: Some(Command::Import(arguments)), .. } => process::import(&arguments, std::io::stdout()),
        CommandLine { command: Some(Command::Bench(arguments)), .. } => bench::run(&arguments, std::io::stdout()),
        CommandLine { command: Some(Command::Exchange(arguments)), .. } => {
            bench::exchange::run(&arguments, std::io::stdout())
        }
        CommandLine { command: Some(Command::Probe(arguments)), .. } => probe::run(&arguments, std::io::stdout()),
        CommandLine { run: Some(run), wire: Some(wire), incarnation, rank, lifeline, network, .. } => {
            process::run(Arguments { run, wire, incarnation, rank, lifeline, network: network.network() })
        }
        _ => unreachable!("clap requires --run and --wire"),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if process::is_of_peers(&error) {
                // Another learner's death is the cause; the log shows it.
                tracing::info!("{error:#}");
                return ExitCode::from(EXIT_LOST_PEERS as u8);
            }
            tracing::error!("{error:#}");
            let status = match error {
                error if process::is_non_finite(&error) => EXIT_NON_FINITE,
                error if process::is_unsaved(&error) => EXIT_UNSAVED,
                _ => 1,
            };
            ExitCode::from(status as u8)
        }
    }
}
