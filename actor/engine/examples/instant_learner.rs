//! A learner that answers at once: what an actor's process takes for a step, without a network. `make bench-env` starts it.
//!
//!     instant_learner CONFIG SECONDS
//!
//! CONFIG is that of a run of one actor, of a user's environments; every action is its first one. It prints the steps, and
//! the nanoseconds of the actor's processor time and of the clock that they took.

use anyhow::{Context, Result, ensure};
use proto::config::Config;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use wire::message::{ActionHeader, EnvironmentState, Halves, RestoreHeader, observation_kind};
use wire::{
    ActionPublisher, Bell, ObservationSubscriber, RestorePublisher, Sleeper, UpdateConnections, Wakeup, Wire,
    WireAddress, WireHost, WireShape,
};

/// Without an observation for so long the actor has failed.
const PATIENCE: Duration = Duration::from_mins(1);
/// What is left out: caches are cold, and Python specialises its bytecode.
const WARM_UP: Duration = Duration::from_millis(500);
/// Of the one learner that there is.
const INCARNATION: u32 = 1;

struct Learner {
    observations: ObservationSubscriber,
    wakeup: Wakeup,
    actions: ActionPublisher,
    restores: RestorePublisher,
    bell: Bell,
    environments: u32,
    action_bytes: usize,
    /// Exchanges of each half so far.
    answered: [u64; 2],
    // Ports before node and host: they are dropped in this order.
    _wire: Wire,
    host: WireHost,
}

impl Learner {
    fn open(config: &Config) -> Result<Self> {
        let address = WireAddress::new(&format!("instant{}", std::process::id()), 1);
        let shape = WireShape::of(config);
        let host = WireHost::create(&address, shape)?;
        let wire = Wire::join(&address, shape, "learner-0")?;
        Ok(Self {
            observations: wire.observation_subscriber(0)?,
            wakeup: wire.bells().wakeup(Sleeper::Learner(0)),
            actions: wire.action_publisher(0)?,
            restores: wire.restore_publisher(0)?,
            bell: wire.bells().bell([Sleeper::Actor(0)]),
            environments: config.actors.environments_per_actor,
            action_bytes: shape.action_bytes,
            answered: [0; 2],
            _wire: wire,
            host,
        })
    }

    /// Answers all that has come; returns whether anything had.
    fn serve(&mut self) -> Result<bool> {
        let mut came = false;
        while let Some(sample) = self.observations.receive().context("cannot receive observations")? {
            let header = *sample.user_header();
            drop(sample);
            if header.kind == observation_kind::HELLO {
                self.restore()?;
            } else if header.step == self.answered[header.half as usize] {
                self.answer(header.half)?;
                came = true;
            }
        }
        Ok(came)
    }

    fn restore(&self) -> Result<()> {
        self.restores.update_connections().context("cannot connect to the actor")?;
        let payload = EnvironmentState::encode(&vec![EnvironmentState::start_of(0); self.environments as usize]);
        let mut sample = self.restores.loan_slice_uninit(payload.len()).context("cannot send a restore")?;
        *sample.user_header_mut() = RestoreHeader { learner_incarnation: INCARNATION, ..RestoreHeader::default() };
        sample.write_from_slice(&payload).send().context("cannot send a restore")?;
        self.bell.ring();
        Ok(())
    }

    fn answer(&mut self, half: u32) -> Result<()> {
        let step = self.answered[half as usize];
        let bytes = Halves::of(self.environments).range(half).len() * self.action_bytes;
        let mut sample = self.actions.loan_slice_uninit(bytes).context("cannot send actions")?;
        *sample.user_header_mut() =
            ActionHeader { step, half, learner_incarnation: INCARNATION, ..ActionHeader::default() };
        sample.write_from_fn(|_| 0).send().context("cannot send actions")?;
        self.bell.ring();
        self.answered[half as usize] += 1;
        Ok(())
    }

    /// Answers for so long.
    fn serve_for(&mut self, span: Duration) -> Result<()> {
        let (begun, mut last) = (Instant::now(), Instant::now());
        while begun.elapsed() < span {
            self.wakeup.wait(Duration::from_millis(50));
            if self.serve()? {
                last = Instant::now();
            }
            ensure!(last.elapsed() < PATIENCE, "the actor has sent nothing for a minute");
        }
        Ok(())
    }

    fn steps(&self) -> u64 {
        let halves = Halves::of(self.environments);
        (0..halves.count()).map(|half| self.answered[half as usize] * halves.range(half).len() as u64).sum()
    }
}

/// What all threads of a process have used, by Linux's scheduler.
fn processor_ns(process: u32) -> Result<u64> {
    let mut sum = 0;
    for thread in std::fs::read_dir(format!("/proc/{process}/task"))? {
        let text = std::fs::read_to_string(thread?.path().join("schedstat"))?;
        sum += text.split(' ').next().unwrap_or_default().parse::<u64>()?;
    }
    Ok(sum)
}

fn measure(learner: &mut Learner, actor: &mut Child, span: Duration) -> Result<()> {
    // Its environments are made before the first step, however long that takes.
    let begun = Instant::now();
    while learner.steps() == 0 {
        learner.serve_for(WARM_UP)?;
        ensure!(actor.try_wait()?.is_none(), "the actor has ended");
        ensure!(begun.elapsed() < PATIENCE, "the actor has taken no step for a minute");
    }
    learner.serve_for(WARM_UP)?;
    let before = (learner.steps(), processor_ns(actor.id())?, Instant::now());
    learner.serve_for(span)?;
    let processor = processor_ns(actor.id())? - before.1;
    println!("{} {processor} {}", learner.steps() - before.0, before.2.elapsed().as_nanos());
    Ok(())
}

fn main() -> Result<()> {
    let mut words = std::env::args().skip(1);
    let path = words.next().context("it needs a configuration")?;
    let seconds: f64 = words.next().context("it needs a number of seconds")?.parse()?;
    let config = Config::from_toml(&std::fs::read_to_string(&path)?, &path)?;
    let environment = config.environment.as_ref().context("the run has built-in environments")?;
    wire::logging::to_stderr();
    let mut learner = Learner::open(&config)?;
    let mut command = environment.program();
    command.args(["--actor", "0", "--lifeline", "--wire", &learner.host.address().to_string(), "--config"]).arg(&path);
    let mut actor = command.stdin(Stdio::piped()).spawn()?;
    let measured = measure(&mut learner, &mut actor, Duration::from_secs_f64(seconds));
    drop(actor.stdin.take());
    actor.kill()?;
    actor.wait()?;
    let address = learner.host.address().clone();
    drop(learner);
    address.sweep()?;
    measured
}
