//! An actor: the real protocol in a shell that follows `actor/src/process/mod.rs` and `link.rs` turn by turn.

use crate::environment::FakeEnvironment;
use crate::kernel::{MILLISECOND, Next, Program, World};
use crate::service::{Delivery, NoPlace, TaskId};
use crate::setup::{MAX_STEPS, Mutation};
use crate::wire::Observations;
use engine::protocol::{Protocol, Todo, Verdict};
use orchestrator::Exit;
use proto::config::Config;
use proto::episode::EnvironmentId;
use std::rc::Rc;
use wire::message::{ActionHeader, EnvironmentState, observation_kind};

/// Actions for a half.
type Batch = (ActionHeader, Rc<Vec<u8>>);

struct Ports {
    restores: u32,
    actions: u32,
    observations: u32,
}

/// What it is in the middle of.
enum Doing {
    /// Its kitchen is being made.
    Starting,
    /// Between two passes of its loop.
    Nothing,
    /// It has looked for actions, and not yet for restores.
    Looking(Vec<Batch>),
    /// A sample is on its way to one subscriber after the other.
    Sending { sample: Observations, place: usize, receivers: usize },
    /// It has arrived wherever it can; the bell is next.
    Sent { sample: Observations, receivers: usize },
}

pub struct Actor {
    session: usize,
    number: u32,
    rank: u32,
    ids: Vec<EnvironmentId>,
    protocol: Protocol,
    environments: Vec<FakeEnvironment>,
    accepted: [Vec<u8>; 2],
    ports: Option<Ports>,
    doing: Doing,
    begun: u64,
}

impl Actor {
    /// An actor that has just been started.
    pub fn new(world: &World, session: usize, number: u32, incarnation: u32) -> Self {
        let config = &world.setup.config;
        let each = config.actors.environments_per_actor;
        let ids: Vec<EnvironmentId> =
            (0..each).map(|index| EnvironmentId::among(config.kitchens(), number, index, each)).collect();
        let start = EnvironmentState::start_of(0);
        Self {
            session,
            number,
            rank: config.shares().learner_of(number),
            environments: ids
                .iter()
                .map(|&id| FakeEnvironment::rebuild(config.spec(), id, MAX_STEPS, &start))
                .collect(),
            ids,
            protocol: Protocol::new(number, incarnation, each, !world.setup.has(Mutation::IgnoresReceipts)),
            accepted: Default::default(),
            ports: None,
            doing: Doing::Starting,
            begun: world.now,
        }
    }

    fn open(&self, world: &mut World, me: TaskId) -> Result<Ports, NoPlace> {
        let wire = &mut world.wires[self.session];
        Ok(Ports {
            restores: wire.restores[self.number as usize].subscribe(me)?,
            actions: wire.actions[self.number as usize].subscribe(me)?,
            observations: wire.observations[self.rank as usize].publish(me)?,
        })
    }

    /// One pass of its loop: a look for actions, and then the rest of it; a message can come in between.
    fn look(&mut self, world: &mut World) -> Next {
        let Some(Ports { actions, .. }) = self.ports else { return Next::After(1) };
        if self.protocol.is_strange() {
            self.protocol.on_met(world.shared[self.session].met.get(&self.number).copied().unwrap_or(0));
        }
        let mut arrived = Vec::new();
        while let Some(batch) =
            world.wires[self.session].actions[self.number as usize].receive(actions, &mut world.dice).0
        {
            arrived.push(batch.value.clone());
        }
        if world.dice.once_in(16) {
            self.doing = Doing::Looking(arrived);
            return Next::After(world.dice.between(5, 50));
        }
        self.pass(world, arrived)
    }

    /// The rest of a pass, up to what takes time.
    fn pass(&mut self, world: &mut World, arrived: Vec<Batch>) -> Next {
        let now = world.since(self.begun);
        let number = self.number as usize;
        let Some(Ports { restores, .. }) = self.ports else { return Next::After(1) };
        let mut rebuilt = 0;
        while let Some(restore) = world.wires[self.session].restores[number].receive(restores, &mut world.dice).0 {
            let (header, states) = &restore.value;
            let verdict = self.protocol.on_restore(header, states.len(), now);
            let (header, number) = (*header, self.number);
            world.note(|| format!("actor {number}: restore {header:?}: {verdict:?}"));
            if verdict == Verdict::Accepted {
                rebuilt += 1;
                self.rebuild(states, world.setup.has(Mutation::RestoresTooEarly));
            }
        }
        for (header, actions) in arrived {
            let verdict = self.protocol.on_actions(&header, actions.len());
            let number = self.number;
            world.note(|| format!("actor {number}: actions {header:?}: {verdict:?}"));
            if verdict == Verdict::Accepted {
                self.accepted[header.half as usize].clone_from(&actions);
            }
        }
        if rebuilt > 0 {
            return Next::After(world.dice.spread(MILLISECOND, 30 * MILLISECOND));
        }
        match self.protocol.next(now) {
            Todo::Hello => {
                let header = self.protocol.hello_header();
                self.send((header, Rc::new(vec![self.environments[0].observe(0)])));
                Next::After(10)
            }
            Todo::Act { half } => {
                let times = if world.setup.has(Mutation::ActsTwice) && world.dice.once_in(50) { 2 } else { 1 };
                for (index, &action) in self.protocol.halves().range(half).zip(&self.accepted[half as usize]) {
                    (0..times).for_each(|_| self.environments[index].act(action));
                }
                self.protocol.acted(half, now);
                Next::After(world.dice.spread(500, 8 * MILLISECOND))
            }
            Todo::Send { half } => {
                let header = self.protocol.observation_header(half);
                let seen = self
                    .protocol
                    .halves()
                    .range(half)
                    .map(|index| self.environments[index].observe(index as u32))
                    .collect();
                self.send((header, Rc::new(seen)));
                Next::After(world.dice.spread(200, 2 * MILLISECOND))
            }
            Todo::Wait(longest) => Next::Wait(longest.as_micros() as u64),
        }
    }

    fn rebuild(&mut self, states: &[EnvironmentState], too_early: bool) {
        let task = Config::default().spec();
        let rebuilt = self.ids.iter().zip(states).map(|(&id, state)| {
            let actions = state.actions();
            let kept = if too_early { actions.len().saturating_sub(1) } else { actions.len() };
            FakeEnvironment::rebuild(task, id, MAX_STEPS, &EnvironmentState::after(state.episode, &actions[..kept], 1))
        });
        self.environments = rebuilt.collect();
    }

    fn send(&mut self, sample: Observations) {
        self.doing = Doing::Sending { sample, place: 0, receivers: 0 };
    }

    /// Delivers to one place after the other; a kill can come in between.
    fn deliver(&mut self, world: &mut World, me: TaskId, sample: Observations, places: [usize; 2]) -> Next {
        let [mut place, mut receivers] = places;
        let Some(Ports { observations: port, .. }) = self.ports else { return Next::After(1) };
        let service = &mut world.wires[self.session].observations[self.rank as usize];
        service.update(port);
        while place < service.places() {
            match service.deliver(port, me, place, &sample) {
                Delivery::Blocked => {
                    self.doing = Doing::Sending { sample, place, receivers };
                    return Next::Wait(u64::from(u32::MAX));
                }
                Delivery::Delivered => receivers += 1,
                Delivery::Skipped => {
                    let number = self.number;
                    let step = sample.0.step;
                    if let Some(trace) = &mut world.trace {
                        trace.push(format!(
                            "               actor {number}: exchange {step} does not fit in place {place}"
                        ));
                    }
                }
            }
            place += 1;
            if world.dice.once_in(16) {
                self.doing = Doing::Sending { sample, place, receivers };
                return Next::After(world.dice.between(5, 50));
            }
        }
        self.doing = Doing::Sent { sample, receivers };
        Next::After(if world.dice.once_in(16) { world.dice.between(5, 50) } else { 1 })
    }

    /// Rings, and tells the protocol what became of the sample.
    fn sent(&mut self, world: &mut World, sample: &Observations, receivers: usize) {
        let service = &world.wires[self.session].observations[self.rank as usize];
        let everyone = receivers > 0 && receivers >= service.readers();
        for task in service.listeners() {
            world.ring(task);
        }
        let header = sample.0;
        let number = self.number;
        world.note(|| format!("actor {number}: sent {header:?} to {receivers}, everyone: {everyone}"));
        let now = world.since(self.begun);
        if header.kind == observation_kind::HELLO {
            self.protocol.hello_sent(now);
        } else {
            self.protocol.sent(header.half, everyone, now);
        }
    }
}

impl Program for Actor {
    fn turn(&mut self, world: &mut World, me: TaskId) -> Next {
        match std::mem::replace(&mut self.doing, Doing::Nothing) {
            Doing::Starting => match self.open(world, me) {
                Ok(ports) => {
                    self.ports = Some(ports);
                    Next::After(100)
                }
                Err(NoPlace) => Next::Exit(Exit::Code(1)),
            },
            Doing::Nothing => self.look(world),
            Doing::Looking(arrived) => self.pass(world, arrived),
            Doing::Sending { sample, place, receivers } => self.deliver(world, me, sample, [place, receivers]),
            Doing::Sent { sample, receivers } => {
                self.sent(world, &sample, receivers);
                Next::After(5)
            }
        }
    }

    fn let_go(&mut self) -> Option<Exit> {
        Some(Exit::Code(0))
    }
}
