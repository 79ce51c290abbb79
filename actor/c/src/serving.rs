//! What a program is asked by the orchestrator that has started it: the same questions as `python -m stillroom serve`.

use crate::error::ServeError;
use crate::ffi::{Environments, Simulator};
use clap::Parser;
use engine::guest::{Guest, GuestActor, Record, Replay};
use proto::replay::ReplaySetup;
use proto::task::{Check, Field, Role, Spec};
use std::ffi::OsString;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use wire::message::Line;

/// Steps of the episode that is played twice.
const STEPS: usize = 40;

/// Serves a simulator to a run; the orchestrator starts this.
#[derive(Debug, Parser)]
#[expect(clippy::struct_excessive_bools, reason = "each is a flag")]
struct Arguments {
    /// Print what the environment says of itself, as JSON
    #[arg(long)]
    describe: bool,
    /// Channels that the user declares beside, as JSON; they are no part of what is described
    #[arg(long, requires = "describe")]
    declared: Option<String>,
    /// Print which build of Stillroom this is
    #[arg(long)]
    build: bool,
    /// Simulate the recorded episodes on standard input again
    #[arg(long)]
    replay: bool,
    #[arg(long)]
    actor: Option<u32>,
    #[arg(long, default_value_t = 1)]
    incarnation: u32,
    #[arg(long)]
    wire: Option<String>,
    #[arg(long)]
    config: Option<PathBuf>,
    #[arg(long)]
    lifeline: bool,
}

pub fn serve(words: &[OsString], simulator: Simulator) -> Result<(), ServeError> {
    let arguments = Arguments::try_parse_from(words).map_err(|error| {
        let text = error.to_string();
        ServeError::Refused(text.lines().next().unwrap_or_default().trim_start_matches("error: ").to_owned())
    })?;
    // What the simulator prints goes to the log, and it reads nothing.
    let asked = File::from(rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdin(), 3).map_err(std::io::Error::from)?);
    let answer = rustix::io::fcntl_dupfd_cloexec(rustix::stdio::stdout(), 3).map_err(std::io::Error::from)?;
    if arguments.lifeline {
        wire::lifeline::hold_apart()?;
    } else {
        rustix::stdio::dup2_stdin(File::open("/dev/null")?).map_err(std::io::Error::from)?;
        rustix::stdio::dup2_stdout(rustix::stdio::stderr()).map_err(std::io::Error::from)?;
    }
    let description = serde_json::to_string(&simulator.description)?;
    let mut answer = File::from(answer);
    if arguments.build {
        return Ok(writeln!(answer, "{}", wire::version::BUILD)?);
    }
    if arguments.describe {
        prove(simulator)?;
        return Ok(writeln!(answer, "{description}")?);
    }
    if arguments.replay {
        let mut lines = BufReader::new(asked).lines();
        let setup = lines.next().transpose()?.unwrap_or_default();
        if serde_json::from_str::<ReplaySetup>(&setup)?.images.is_some() {
            return Err(ServeError::Refused(
                "a simulator of this header draws no pictures: --check replays".to_owned(),
            ));
        }
        let mut replay = Replay::new(&setup, &description, |config| simulator.environments_of(1, config))?;
        for line in lines {
            writeln!(answer, "{}", replay.verdict(&line?)?)?;
        }
        return Ok(());
    }
    let (Some(number), Some(wire), Some(config)) = (arguments.actor, arguments.wire, arguments.config) else {
        let problem = "--actor, --wire and --config are given by the orchestrator, which starts this: `orchestrator up \
                       --env-command ...`";
        return Err(ServeError::Refused(problem.to_owned()));
    };
    drop(asked);
    wire::logging::to_stderr();
    let actor = GuestActor::open(number, arguments.incarnation, &wire, &config)?;
    actor.check(&description)?;
    let environments = simulator.environments_of(actor.environments() as usize, actor.config())?;
    match actor.run(environments)? {}
}

/// Plays an episode twice, another one between, and refuses a simulator that does not repeat the first.
fn prove(simulator: Simulator) -> Result<(), ServeError> {
    let spec = Spec::kept(&simulator.description.declaration("")?)?;
    let actions = spec.actions.names().len();
    let mut environments = simulator.environments(1, spec)?;
    let [first, _, again] = [1, 2, 1].map(|seed| play(&mut environments, seed, actions, spec));
    let (first, again) = (first?, again?);
    let Some(step) = (0..first.len().max(again.len())).find(|&step| first.get(step) != again.get(step)) else {
        return Ok(());
    };
    Err(ServeError::Refused(format!(
        "it does not repeat itself: after reset with seed 1 and the same {step} actions its numbers are others. A run \
         rebuilds an environment by its seed and actions: draw all random numbers from the seed, and reset everything"
    )))
}

/// What is seen in an episode whose actions follow from its seed and from what is allowed, and the reward after each.
fn play(environments: &mut Environments, seed: u32, actions: usize, spec: &Spec) -> Result<Vec<Vec<u8>>, ServeError> {
    let (layout, check) = (spec.layout(), Check::of(spec));
    let observed = spec.channels.iter().zip(&layout.fields);
    let observed: Vec<Field> =
        observed.filter(|(channel, _)| channel.role != Role::Outcome).map(|(_, &field)| field).collect();
    let mut lines = vec![Line([0; 64]); layout.bytes / size_of::<Line>()];
    let mut seen = vec![];
    environments.reset(0, seed, Record::of(&mut lines, &mut [], layout)).map_err(ServeError::Refused)?;
    for step in 0..=STEPS {
        let record = Line::bytes(&lines);
        check.record(record, step > 0).map_err(|problem| ServeError::Refused(problem.to_string()))?;
        seen.push(observed.iter().flat_map(|field| &record[field.range()]).copied().collect());
        let first = step * 7 + step / 3 + seed as usize;
        let allows = |&action: &usize| {
            spec.mask().is_none_or(|mask| spec.actions.allows(&record[mask.range()], &[action as u8]))
        };
        let Some(action) = (0..actions).map(|more| (first + more) % actions).find(allows) else {
            return Err(ServeError::Refused("its mask allows no action: one at least can always be taken".to_owned()));
        };
        let stepped = environments.step(0, &[action as u8], Record::of(&mut lines, &mut [], layout));
        let ended = stepped.map_err(ServeError::Refused)?;
        if ended.contains(&true) {
            break;
        }
    }
    Ok(seen)
}
