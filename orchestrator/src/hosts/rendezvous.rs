//! Host 0's door: it waits until all other hosts have come, tells them what the run is, and hands them over to the
//! supervision as its `remote_hosts`.

use super::address;
use super::handshake::{HandshakeError, admit};
use super::link::{Mouth, send, send_bytes, serve};
use super::membership::Membership;
use super::token::Token;
use crate::run::identity::host_name;
use crate::run::scenes;
use crate::supervisor::process::LearnersNetwork;
use crate::supervisor::remote_hosts::{FromHost, HostReport, Obeys, Order, Other, RemoteHosts};
use crate::supervisor::session::Together;
use crate::supervisor::shell::QUEUE;
use anyhow::{Context, Result, bail};
use proto::config::Config;
use proto::hosts::Hosts;
use proto::run_folder::RunFolder;
use serde::{Deserialize, Serialize};
use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use wire::warning_limiter::WarningLimiter;

const PROOF: Duration = Duration::from_secs(5);
const UNPROVED: usize = 32;
const LOOK: Duration = Duration::from_millis(20);
/// Hosts that come only to hear that there is nothing to do are waited for so long.
const FAREWELL: Duration = Duration::from_secs(20);

#[derive(Debug, Clone, Copy)]
pub struct Patience {
    pub joining: Duration,
    /// From the loss of a host to the end of the job on all others.
    pub lost: Duration,
}

impl Patience {
    pub fn silence(self) -> Duration {
        self.lost / 3
    }

    /// Processes that are asked to leave because a host is lost are killed after that.
    pub fn grace(self) -> Duration {
        self.lost / 3
    }
}

#[derive(Debug, Serialize, Deserialize)]
pub enum Reply {
    Invited(Invitation),
    Over { status: u8, text: String },
    Refused(String),
}

#[derive(Debug, Serialize, Deserialize)]
pub struct Invitation {
    pub run_id: String,
    pub incarnation: u32,
    pub hosts: u32,
    pub name: String,
    pub config: String,
    /// Files that the processes read, relative to the run folder, and their sizes. They follow, in this order.
    pub files: Vec<(String, u64)>,
    pub store: SocketAddr,
    pub lost_s: f64,
}

#[derive(Debug, thiserror::Error)]
pub enum Incomplete {
    #[error("{0}")]
    Missing(String),
    #[error("host {0} cannot take part: {1}")]
    Refuses(u32, String),
}

pub struct Rendezvous {
    listener: TcpListener,
    own: IpAddr,
    hosts: u32,
    token: Token,
    patience: Patience,
    /// All have been here before, in a start of this program.
    again: Cell<bool>,
}

impl Rendezvous {
    pub fn open(member: &Membership, token: Token, interface: Option<&str>, patience: Patience) -> Result<Self> {
        let own = address::of_first(&member.rendezvous, interface)?;
        let (name, port) = member.rendezvous.rsplit_once(':').context("a rendezvous has a port")?;
        if own.is_loopback() && interface.is_none() && name != "localhost" && name.parse::<IpAddr>().is_err() {
            tracing::warn!(
                "{name} is {own} here, which no other machine reaches: name host 0's network by --interface"
            );
        }
        let place = (own, port.parse::<u16>().context("a rendezvous has a port")?);
        let listener = TcpListener::bind(place).with_context(|| {
            format!(
                "cannot listen at {}:{}: --rendezvous names another port, --interface another address",
                own, place.1
            )
        })?;
        // Many look at the door at once, and it must not stand open for the time of a slow proof.
        listener.set_nonblocking(true).context("the rendezvous")?;
        Ok(Self { listener, own, hosts: member.hosts, token, patience, again: Cell::new(false) })
    }

    pub fn hosts(&self) -> u32 {
        self.hosts
    }

    /// Waits for all other hosts and has them prepare. They can be gathered again for another start.
    pub fn gather(&self, folder: &RunFolder, run_id: &str, incarnation: u32, config: &Config) -> Result<Together> {
        let hosts = Hosts::new(self.hosts, config.shares());
        // Who has just been here comes soon or is lost.
        let joining = if self.again.replace(true) { self.patience.lost } else { self.patience.joining };
        let listener = TcpListener::bind((self.own, 0)).with_context(|| format!("cannot listen at {}", self.own))?;
        let store = listener.local_addr().context("the learners' store")?;
        tracing::info!(
            "host 0 of {} at {}: waiting up to {} s for the others",
            self.hosts,
            self.listener.local_addr().context("the rendezvous")?,
            joining.as_secs()
        );
        let files = files_of(folder)?;
        let reply = Reply::Invited(Invitation {
            run_id: run_id.to_owned(),
            incarnation,
            hosts: self.hosts,
            name: host_name(),
            config: config.to_toml(),
            files: files.iter().map(|(name, bytes)| (name.clone(), bytes.len() as u64)).collect(),
            store,
            lost_s: self.patience.lost.as_secs_f64(),
        });
        let (sender, mut inbox) = mpsc::channel(QUEUE);
        let mut others = Vec::new();
        for (host, mut stream) in self.admit_all(joining)? {
            let name = stream.peer_addr().map_or_else(|_| "unknown".to_owned(), |address| address.ip().to_string());
            let gone = |error| Incomplete::Missing(format!("host {host} ({name}) was lost at the start: {error}"));
            stream.set_write_timeout(Some(self.patience.silence())).map_err(gone)?;
            send(&mut stream, &reply).map_err(gone)?;
            files.iter().try_for_each(|(_, bytes)| send_bytes(&stream, bytes)).map_err(gone)?;
            let way = Box::new(Way(serve(stream, self.patience.silence(), ear(host, sender.clone())).map_err(gone)?));
            others.push(Other { name, way, lost: false });
        }
        let early = self.await_ready(&others, &mut inbox)?;
        let interface = address::interface_of(self.own);
        let network = LearnersNetwork {
            hosts: self.hosts,
            store,
            key: self.token.meeting_key(run_id, incarnation),
            own: self.own,
            interface,
            listener: Some(Arc::new(listener)),
        };
        tracing::info!("all {} hosts are here", self.hosts);
        Ok(Together { hosts, remote_hosts: RemoteHosts::new(hosts, others, early, inbox), network })
    }

    pub fn turn_away(&self, status: u8, text: &str) {
        let reply = Reply::Over { status, text: text.to_owned() };
        match self.admit_all(FAREWELL) {
            Ok(guests) => guests.into_values().for_each(|mut stream| drop(send(&mut stream, &reply))),
            Err(error) => tracing::debug!("{error:#}"),
        }
    }

    /// The other hosts, once all have come and proved the token. Of two that call themselves the same the later counts:
    /// the earlier may have died.
    fn admit_all(&self, patience: Duration) -> Result<BTreeMap<u32, TcpStream>> {
        let deadline = Instant::now() + patience;
        let (sender, proved) = channel();
        let (unproved, limiter) = (Arc::new(()), Arc::new(WarningLimiter::default()));
        let mut guests: BTreeMap<u32, TcpStream> = BTreeMap::new();
        loop {
            for (host, mut stream) in proved.try_iter() {
                if (1..self.hosts).contains(&host) {
                    tracing::info!("host {host} is here");
                    guests.insert(host, stream);
                } else {
                    let text = format!("it calls itself host {host}, and here are hosts 0 to {}", self.hosts - 1);
                    limiter.warn("hosts refused", format_args!("a host is refused: {text}"));
                    let _ = send(&mut stream, &Reply::Refused(text));
                }
            }
            guests.retain(|_, stream| is_there(stream));
            if guests.len() as u32 + 1 == self.hosts {
                return Ok(guests);
            }
            if Instant::now() >= deadline {
                let missing: Vec<_> = (1..self.hosts).filter(|host| !guests.contains_key(host)).collect();
                let missing = missing.iter().map(|host| format!("host {host}")).collect::<Vec<_>>().join(", ");
                bail!(Incomplete::Missing(format!(
                    "{missing} of {} hosts did not come within {} s (--join-deadline)",
                    self.hosts,
                    patience.as_secs()
                )));
            }
            match self.listener.accept() {
                Ok((stream, address)) if Arc::strong_count(&unproved) <= UNPROVED => {
                    let busy = Arc::clone(&unproved);
                    self.prove((stream, address), sender.clone(), busy, Arc::clone(&limiter));
                }
                Ok((_, address)) => limiter.warn(
                    "connections refused at once",
                    format_args!("{address} is refused: too many connections prove nothing"),
                ),
                Err(error) if error.kind() == ErrorKind::WouldBlock => std::thread::sleep(LOOK),
                Err(error) => {
                    limiter.warn("connections lost", format_args!("the rendezvous: {error}"));
                    std::thread::sleep(LOOK);
                }
            }
        }
    }

    fn prove(
        &self,
        (mut stream, address): (TcpStream, SocketAddr),
        sender: Sender<(u32, TcpStream)>,
        busy: Arc<()>,
        limiter: Arc<WarningLimiter>,
    ) {
        let (token, here) = (self.token.clone(), Arc::clone(&limiter));
        let prove = move || {
            let proved = stream
                .set_nonblocking(false)
                .and_then(|()| stream.set_write_timeout(Some(PROOF)))
                .map_err(Into::into)
                .and_then(|()| admit(&mut stream, &token, Instant::now() + PROOF));
            match proved {
                Ok(host) => drop(sender.send((host, stream))),
                Err(error) => {
                    // A host of this run with another version or token is not lost among strangers.
                    let kind = match error {
                        HandshakeError::Version { .. } => "connections of another version",
                        HandshakeError::Stranger => "connections without the token",
                        HandshakeError::Connection(_) | HandshakeError::Source(_) => "connections that prove nothing",
                    };
                    limiter.warn(kind, format_args!("a connection from {address} is refused: {error}"));
                }
            }
            drop(busy);
        };
        if let Err(error) = std::thread::Builder::new().name("proof".into()).spawn(prove) {
            here.warn("connections not received", format_args!("{address} cannot be received: {error}"));
        }
    }

    fn await_ready(
        &self,
        others: &[Other],
        inbox: &mut mpsc::Receiver<(u32, FromHost)>,
    ) -> Result<VecDeque<(u32, FromHost)>> {
        let deadline = Instant::now() + self.patience.joining;
        let mut early = VecDeque::new();
        let mut ready = 0;
        while ready < others.len() {
            match inbox.try_recv() {
                Ok((_, FromHost::Reported(HostReport::Ready))) => ready += 1,
                Ok((host, FromHost::Reported(HostReport::Refused(reason)))) => {
                    bail!(Incomplete::Refuses(host, reason))
                }
                Ok((host, FromHost::Lost(reason))) => {
                    bail!(Incomplete::Missing(format!("host {host} was lost at the start: {reason}")))
                }
                Ok((host, asked @ FromHost::Reported(HostReport::Stop { .. } | HostReport::Interrupt))) => {
                    early.push_back((host, asked));
                }
                Ok((host, FromHost::Reported(HostReport::AsksOtherwise(what)))) => {
                    tracing::warn!("host {host} was started with {what}: the settings of this host count");
                }
                Ok((_, FromHost::Reported(_))) => {}
                Err(_) if Instant::now() >= deadline => {
                    bail!(Incomplete::Missing("not all hosts are ready in time".to_owned()))
                }
                Err(_) => std::thread::sleep(LOOK),
            }
        }
        Ok(early)
    }
}

struct Way(Mouth<Order>);

impl Obeys for Way {
    fn order(&self, order: Order) {
        self.0.say(order);
    }
}

fn ear(
    host: u32,
    sender: mpsc::Sender<(u32, FromHost)>,
) -> impl FnMut(Result<HostReport, String>) -> bool + Send + 'static {
    move |received| {
        let received = received.map_or_else(FromHost::Lost, FromHost::Reported);
        sender.blocking_send((host, received)).is_ok()
    }
}

fn is_there(stream: &TcpStream) -> bool {
    if stream.set_nonblocking(true).is_err() {
        return false;
    }
    let there = match stream.peek(&mut [0]) {
        Ok(count) => count > 0,
        Err(error) => matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
    };
    stream.set_nonblocking(false).is_ok() && there
}

fn files_of(folder: &RunFolder) -> Result<Vec<(String, Vec<u8>)>> {
    scenes::files_below(folder, folder.root(), &folder.scenes())
        .with_context(|| format!("cannot read {}", folder.scenes().display()))
}

#[cfg(test)]
mod tests {
    use super::super::handshake::ask;
    use super::super::link::receive;
    use super::super::membership::Launcher;
    use super::*;

    fn door(hosts: u32) -> (Rendezvous, SocketAddr) {
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let member = Membership { hosts, host: 0, rendezvous: format!("127.0.0.1:{free}"), by: Launcher::Flags };
        let patience = Patience { joining: Duration::from_millis(300), lost: Duration::from_secs(3) };
        let door = Rendezvous::open(&member, Token::new(b"the token of a run").unwrap(), None, patience).unwrap();
        let address = door.listener.local_addr().unwrap();
        assert!(address.ip().is_loopback(), "it listens on its own address alone");
        (door, address)
    }

    fn guest(address: SocketAddr, token: &'static [u8], host: u32) -> std::thread::JoinHandle<Option<Reply>> {
        std::thread::spawn(move || {
            let deadline = Instant::now() + Duration::from_secs(20);
            let mut stream = TcpStream::connect(address).unwrap();
            ask(&mut stream, &Token::new(token).unwrap(), host, deadline).ok()?;
            receive(&mut stream, 1 << 20, deadline).ok()
        })
    }

    #[test]
    fn strangers_and_hosts_beyond_are_refused_and_those_that_do_not_come_are_named() {
        let (door, address) = door(3);
        let stranger = guest(address, b"another token, as long", 1);
        let beyond = guest(address, b"the token of a run", 3);
        let second = guest(address, b"the token of a run", 2);
        let error = door.admit_all(Duration::from_millis(600)).unwrap_err();
        assert!(error.is::<Incomplete>());
        assert!(error.to_string().starts_with("host 1 of 3 hosts did not come within 0 s"), "{error}");
        assert!(stranger.join().unwrap().is_none());
        let refused = beyond.join().unwrap();
        assert!(matches!(&refused, Some(Reply::Refused(why)) if why.contains("hosts 0 to 2")), "{refused:?}");
        assert!(second.join().unwrap().is_none(), "the door is closed");
    }

    #[test]
    fn many_that_say_nothing_keep_nobody_out_for_long() {
        let (door, address) = door(2);
        let mute: Vec<_> = (0..2 * UNPROVED).map(|_| TcpStream::connect(address).unwrap()).collect();
        let late = std::thread::spawn(move || {
            // After those that were mute have used up their time.
            std::thread::sleep(PROOF + Duration::from_secs(1));
            guest(address, b"the token of a run", 1).join().unwrap()
        });
        let guests = door.admit_all(Duration::from_secs(20)).unwrap();
        for mut stream in guests.into_values() {
            send(&mut stream, &Reply::Over { status: 0, text: "done".into() }).unwrap();
        }
        assert!(matches!(late.join().unwrap(), Some(Reply::Over { status: 0, .. })));
        drop(mute);
    }
}
