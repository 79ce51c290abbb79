//! What this program is on every host but the first: it does there what host 0's supervisor orders, and reports. It
//! decides one thing by itself: when host 0 is lost, its processes end, and so does it.

use super::address;
use super::handshake::{HandshakeError, ask};
use super::host_folder::{HostFolder, prepare};
use super::link::{Mouth, receive, receive_bytes, serve};
use super::membership::Membership;
use super::rendezvous::{Invitation, Patience, Reply};
use super::token::Token;
use crate::environment;
use crate::output::format::counted;
use crate::output::terminal;
use crate::run::remains;
use crate::supervisor::event::{Event, Exit, Process};
use crate::supervisor::process::{LearnersNetwork, Processes};
use crate::supervisor::remote_hosts::{HostReport, Order};
use crate::supervisor::session::{Part, Session, begin_log, recorded};
use crate::supervisor::shell::{QUEUE, SWEEPS_AFTER_DEATH, Signals, TICK};
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::event::LearnerEvent;
use proto::exit::EXIT_HOST_LOST;
use proto::run_folder::RunFolder;
use recording::recorder::Recorder;
use std::collections::BTreeSet;
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use wire::{Announcer, WireHost};

const ATTEMPT: Duration = Duration::from_secs(5);
const PAUSE: Duration = Duration::from_millis(500);
const REPLY: usize = 64 << 20;
const FILE: usize = 1 << 30;
const KEYS_SHOWN: usize = 16;
const KILLED: Duration = Duration::from_secs(5);

/// What a host's command asks for otherwise than the run in this folder does, by key.
pub type Otherwise<'a> = &'a dyn Fn(&Config, &RunFolder) -> Result<Vec<String>>;

pub struct Agent {
    pub member: Membership,
    pub token: Token,
    pub interface: Option<String>,
    pub run: PathBuf,
    pub patience: Patience,
    pub lost_s: Option<u64>,
}

enum Ended {
    Over(u8, String),
    Again(Patience),
}

type Received = Result<Order, String>;

impl Agent {
    pub fn run(self, otherwise: Otherwise<'_>) -> Result<ExitCode> {
        let mut signals = None;
        // Sent once: a later start has what was ordered meanwhile.
        let mut otherwise = Some(otherwise);
        let mut found = self.knock(self.patience.joining)?;
        // Host 0 replies when all others have come.
        let mut reply = 2 * self.patience.joining;
        loop {
            let (status, text) = match self.take_part(found, reply, otherwise.take(), &mut signals)? {
                Ended::Over(status, text) => (status, text),
                Ended::Again(patience) => match self.knock(patience.lost) {
                    Ok(again) => {
                        found = again;
                        reply = patience.lost + patience.silence();
                        continue;
                    }
                    Err(error) => (EXIT_HOST_LOST as u8, format!("host 0 was lost between two starts: {error:#}")),
                },
            };
            terminal::note(&text);
            return Ok(ExitCode::from(status));
        }
    }

    fn take_part(
        &self,
        (mut stream, own): (TcpStream, IpAddr),
        reply: Duration,
        otherwise: Option<Otherwise<'_>>,
        signals: &mut Option<Signals>,
    ) -> Result<Ended> {
        let deadline = Instant::now() + 2 * self.patience.joining;
        let reply = match receive(&mut stream, REPLY, Instant::now() + reply) {
            Ok(reply) => reply,
            Err(error) => {
                return Ok(Ended::Over(EXIT_HOST_LOST as u8, format!("host 0 did not begin: {error}")));
            }
        };
        let invitation: Invitation = match reply {
            Reply::Invited(invitation) => invitation,
            Reply::Refused(reason) => bail!("host 0 refuses this host: {reason}"),
            Reply::Over { status, text } => return Ok(Ended::Over(status, text)),
        };
        let read = |(_, size): &(String, u64)| {
            receive_bytes(&mut stream, usize::try_from(*size).map_or(FILE, |size| size.min(FILE)), deadline)
        };
        let files: Vec<Vec<u8>> =
            invitation.files.iter().map(read).collect::<Result<_, _>>().context("host 0's files")?;
        let patience = Patience { lost: Duration::try_from_secs_f64(invitation.lost_s)?, ..self.patience };
        let (sender, orders) = mpsc::channel(QUEUE);
        let ear = move |received: Received| sender.blocking_send(received).is_ok();
        let mouth: Mouth<HostReport> = serve(stream, patience.silence(), ear).context("the link to host 0")?;
        let prepared = prepare(&self.run, self.member.host, &invitation, &files, patience.lost)
            .and_then(|place| begin_log(&place.folder).map(|()| place));
        let place = match prepared {
            Ok(place) => place,
            Err(error) => {
                mouth.say(HostReport::Refused(format!("{error:#}")));
                return Err(error);
            }
        };
        tracing::info!(
            "host {} of {} of run {}, start {}, in {}",
            self.member.host,
            invitation.hosts,
            invitation.run_id,
            invitation.incarnation,
            place.folder.root().display()
        );
        if let Some(otherwise) = otherwise {
            self.compare(&place, &invitation, otherwise, &mouth)?;
        }
        let network = LearnersNetwork {
            hosts: invitation.hosts,
            store: invitation.store,
            key: self.token.meeting_key(&invitation.run_id, invitation.incarnation),
            own,
            interface: address::interface_of(own),
            listener: None,
        };
        let address = place.address.clone();
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context("tokio")?;
        let ended = runtime.block_on(self.work(place, &invitation, network, (&mouth, orders), (patience, signals)));
        if let Err(error) = &ended {
            mouth.say(HostReport::Refused(format!("{error:#}")));
        }
        // In any case no process and no shared memory of this start remains.
        drop(runtime);
        if let Err(error) = remains::sweep(&address, Duration::from_secs(2)) {
            tracing::warn!("{error:#}");
        }
        ended
    }

    /// Says on both hosts what this one's command asks for otherwise. Host 0 decides what the run is, so it is not done.
    fn compare(
        &self,
        place: &HostFolder,
        invitation: &Invitation,
        otherwise: Otherwise<'_>,
        mouth: &Mouth<HostReport>,
    ) -> Result<()> {
        let mut found = otherwise(&place.config, &place.folder)?;
        if self.member.hosts != invitation.hosts {
            found.push(format!("--hosts {} instead of {}", self.member.hosts, invitation.hosts));
        }
        if let Some(asked) = self.lost_s.filter(|&asked| asked as f64 != invitation.lost_s) {
            found.push(format!("--host-deadline {asked} instead of {}", invitation.lost_s));
        }
        let beyond = found.len().saturating_sub(KEYS_SHOWN);
        found.truncate(KEYS_SHOWN);
        if beyond > 0 {
            found.push(format!("{} more", counted(beyond as u64, "setting")));
        }
        if !found.is_empty() {
            let what = found.join(", ");
            tracing::warn!("this host was started with {what}: the settings of host 0 count");
            mouth.say(HostReport::AsksOtherwise(what));
        }
        Ok(())
    }

    fn knock(&self, patience: Duration) -> Result<(TcpStream, IpAddr)> {
        let rendezvous = &self.member.rendezvous;
        let deadline = Instant::now() + patience;
        let host = self.member.host;
        tracing::info!("host {host} of {}: looking for host 0 at {rendezvous}", self.member.hosts);
        let mut warned = false;
        loop {
            let last = match self.attempt() {
                Ok((mut stream, own)) => match ask(&mut stream, &self.token, host, Instant::now() + ATTEMPT) {
                    Ok(()) => return Ok((stream, own)),
                    Err(error) => {
                        let is_refusal = matches!(error, HandshakeError::Stranger | HandshakeError::Version { .. });
                        if is_refusal && !std::mem::replace(&mut warned, true) {
                            tracing::warn!("host 0 at {rendezvous}: {error}; trying again");
                        }
                        anyhow::Error::new(error)
                    }
                },
                Err(error) => error,
            };
            tracing::debug!("host 0 at {rendezvous}: {last:#}");
            if Instant::now() >= deadline {
                let waited = patience.as_secs();
                return Err(last.context(format!("host 0 was not reached at {rendezvous} within {waited} s")));
            }
            std::thread::sleep(PAUSE);
        }
    }

    fn attempt(&self) -> Result<(TcpStream, IpAddr)> {
        let mut last = None;
        for address in address::resolve(&self.member.rendezvous)? {
            let own = address::of_other(address, self.interface.as_deref())?;
            match connect(own, address) {
                Ok(stream) => {
                    stream.set_write_timeout(Some(ATTEMPT))?;
                    return Ok((stream, own));
                }
                Err(error) => last = Some(error),
            }
        }
        Err(last.context("no address")?.into())
    }

    async fn work(
        &self,
        place: HostFolder,
        invitation: &Invitation,
        network: LearnersNetwork,
        (mouth, orders): (&Mouth<HostReport>, mpsc::Receiver<Received>),
        (patience, signals): (Patience, &mut Option<Signals>),
    ) -> Result<Ended> {
        let HostFolder { folder, config, address, hosts, tools, mut lock } = place;
        let signals = Signals::kept(signals, true)?;
        environment::demand(&config, folder.root())?;
        lock.sign(invitation.incarnation)?;
        let incarnation = invitation.incarnation;
        let (config, tools, address, folder) = (&config, &tools, &address, &folder);
        let session = Session { folder, config, incarnation, address, tools, launched: true };
        let begun = Part::begin(&session, &invitation.run_id, hosts, self.member.host, Some(network))?;
        let Part { _claim, host, recorder, launch } = begun;
        let (sender, inbox) = mpsc::channel(QUEUE);
        let announcer = host.wire().announcer()?;
        mouth.say(HostReport::Ready);
        let work = Work {
            host: &host,
            announcer,
            processes: Processes::new(launch, sender),
            running: BTreeSet::new(),
            inbox,
            orders,
            mouth,
            signals,
            recorder,
            learner_incarnation: 0,
            sweeps: 0,
            recording_failed: false,
        };
        work.until_the_end(patience, invitation).await
    }
}

fn connect(own: IpAddr, to: SocketAddr) -> std::io::Result<TcpStream> {
    use rustix::net::sockopt::{Timeout, set_socket_timeout};
    use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, connect, socket_with};
    if address::of_other(to, None).is_ok_and(|usual| usual == own) {
        return TcpStream::connect_timeout(&to, ATTEMPT);
    }
    let family = if own.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let socket = socket_with(family, SocketType::STREAM, SocketFlags::CLOEXEC, None)?;
    // On Linux this bounds the connecting, too.
    set_socket_timeout(&socket, Timeout::Send, Some(ATTEMPT))?;
    bind(&socket, &SocketAddr::from((own, 0)))?;
    connect(&socket, &to)?;
    Ok(socket.into())
}

struct Work<'a> {
    host: &'a WireHost,
    announcer: Announcer,
    processes: Processes,
    running: BTreeSet<Process>,
    inbox: mpsc::Receiver<Event>,
    orders: mpsc::Receiver<Received>,
    mouth: &'a Mouth<HostReport>,
    signals: &'a mut Signals,
    recorder: Option<Recorder>,
    learner_incarnation: u32,
    /// Ticks on which dead processes' ports are still to be swept.
    sweeps: u32,
    recording_failed: bool,
}

impl Work<'_> {
    async fn until_the_end(mut self, patience: Patience, invitation: &Invitation) -> Result<Ended> {
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        // Had it been received in the last start, this one would not be.
        if let Some(asked) = self.signals.asked() {
            self.ask_for_stop(&asked);
        }
        loop {
            tokio::select! {
                received = self.orders.recv() => match received {
                    Some(Ok(Order::Dismiss { status, text })) => return Ok(Ended::Over(status, text)),
                    Some(Ok(Order::Again)) => return Ok(Ended::Again(patience)),
                    Some(Ok(order)) => self.obey(&order)?,
                    lost => {
                        let why = lost.and_then(Result::err).unwrap_or_else(|| "the link has ended".to_owned());
                        let text = format!("host 0 ({}) was lost: {why}", invitation.name);
                        tracing::error!("{text}");
                        self.abandon(patience).await;
                        return Ok(Ended::Over(EXIT_HOST_LOST as u8, text));
                    }
                },
                Some(event) = self.inbox.recv() => self.report(event),
                asked = self.signals.next() => self.ask_for_stop(&asked),
                _ = tick.tick() => self.look(),
            }
        }
    }

    fn ask_for_stop(&self, asked: &Event) {
        tracing::info!("a stop is asked for here: host 0 is told");
        self.mouth.say(match asked {
            Event::Interrupt => HostReport::Interrupt,
            _ => HostReport::Stop { requeue: self.signals.ask_for_requeue() },
        });
    }

    fn obey(&mut self, order: &Order) -> Result<()> {
        match *order {
            Order::Spawn { process, incarnation } => {
                if matches!(process, Process::Learner(_)) {
                    self.learner_incarnation = incarnation;
                }
                match self.processes.spawn(process, incarnation) {
                    Ok(()) => drop(self.running.insert(process)),
                    Err(cause) => {
                        let exit = Exit::NotStarted(cause);
                        self.mouth.say(HostReport::Exited { process, incarnation, exit, last_words: vec![] });
                    }
                }
            }
            Order::CloseLifeline(process) => self.processes.close_lifeline(process),
            Order::Kill(process) => self.processes.kill(process),
            Order::Announce(announced) => self.announcer.announce(announced.into())?,
            Order::Finish { frames } => {
                let complete = self.recorder.take().map_or(Ok(()), |recorder| recorded(recorder, frames));
                self.mouth.say(HostReport::Recorded(complete.map_err(|error| format!("{error:#}"))));
            }
            Order::Dismiss { .. } | Order::Again => {}
        }
        Ok(())
    }

    /// Tells host 0 what happened to a process, and what its learners say of themselves. Of a rollout only the recorder
    /// here is told: rank 0 reports it for all.
    fn report(&mut self, event: Event) {
        match event {
            Event::Exited { process, incarnation, exit, last_words } => {
                self.processes.forget(process);
                self.running.remove(&process);
                self.host.sweep_dead();
                self.sweeps = SWEEPS_AFTER_DEATH;
                self.mouth.say(HostReport::Exited { process, incarnation, exit, last_words });
            }
            Event::Learner { incarnation, event } => {
                if incarnation == self.learner_incarnation
                    && let Some(recorder) = &self.recorder
                {
                    recorder.learner(incarnation, &event);
                }
                if !matches!(event, LearnerEvent::RolloutCollected { .. }) {
                    self.mouth.say(HostReport::Learner { incarnation, event });
                }
            }
            _ => {}
        }
    }

    fn look(&mut self) {
        if let Err(error) = self.announcer.update() {
            tracing::debug!("{error}");
        }
        if self.sweeps > 0 {
            self.sweeps -= 1;
            self.host.sweep_dead();
        }
        if !self.recording_failed
            && let Some(failure) = self.recorder.as_ref().and_then(Recorder::failure)
        {
            self.recording_failed = true;
            self.mouth.say(HostReport::CannotWrite(failure));
        }
    }

    /// Ends all processes, host 0 being gone. First they may leave by themselves: if only its orchestrator died, the
    /// learners of all hosts save together.
    async fn abandon(&mut self, patience: Patience) {
        for &process in &self.running {
            self.processes.close_lifeline(process);
        }
        self.await_ends(patience.grace()).await;
        for &process in &self.running {
            tracing::warn!("{process} does not leave and is killed");
            self.processes.kill(process);
        }
        self.await_ends(KILLED).await;
        if let Some(Err(error)) = self.recorder.take().map(|recorder| recorded(recorder, None)) {
            tracing::error!("the recording is incomplete: {error:#}");
        }
    }

    async fn await_ends(&mut self, patience: Duration) {
        let deadline = tokio::time::Instant::now() + patience;
        while !self.running.is_empty() {
            match tokio::time::timeout_at(deadline.min(tokio::time::Instant::now() + TICK), self.inbox.recv()).await {
                Ok(Some(event)) => self.report(event),
                Ok(None) => return,
                Err(_) if tokio::time::Instant::now() >= deadline => return,
                Err(_) => self.look(),
            }
        }
    }
}
