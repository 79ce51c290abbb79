//! The other hosts of a run, as supervision knows them: who has which process, what is ordered there, what is received from
//! there. How it crosses is not its business ([`crate::hosts`]).

use super::event::{Exit, Process};
use proto::event::LearnerEvent;
use proto::hosts::Hosts;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;
use tokio::sync::mpsc;
use wire::message::StageAnnouncement;

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    Spawn {
        process: Process,
        incarnation: u32,
    },
    CloseLifeline(Process),
    Kill(Process),
    Announce(Announced),
    /// All processes have ended: complete the recording, and report. `frames`: those of the run that were saved.
    Finish {
        frames: Option<u64>,
    },
    /// This start is over; come again, the next follows at once, with another number of actors.
    Again,
    Dismiss {
        status: u8,
        text: String,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Announced {
    version: u64,
    rollout: u64,
    stage: u32,
    directive: u32,
}

impl From<StageAnnouncement> for Announced {
    fn from(StageAnnouncement { version, rollout, stage, directive }: StageAnnouncement) -> Self {
        Self { version, rollout, stage, directive }
    }
}

impl From<Announced> for StageAnnouncement {
    fn from(Announced { version, rollout, stage, directive }: Announced) -> Self {
        Self { version, rollout, stage, directive }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum HostReport {
    Ready,
    AsksOtherwise(String),
    Refused(String),
    Exited { process: Process, incarnation: u32, exit: Exit, last_words: Vec<String> },
    Learner { incarnation: u32, event: LearnerEvent },
    CannotWrite(String),
    Stop { requeue: bool },
    Interrupt,
    Recorded(Result<(), String>),
}

#[derive(Debug, Clone, PartialEq)]
pub enum FromHost {
    Reported(HostReport),
    Lost(String),
}

pub trait Obeys {
    /// Sends an order. That it did not arrive is received as [`FromHost::Lost`].
    fn order(&self, order: Order);
}

pub struct Other {
    pub name: String,
    pub way: Box<dyn Obeys>,
    pub lost: bool,
}

pub struct RemoteHosts {
    hosts: Hosts,
    others: Vec<Other>,
    early: VecDeque<(u32, FromHost)>,
    inbox: mpsc::Receiver<(u32, FromHost)>,
}

impl RemoteHosts {
    /// Those that have come. `early`: what was received before all of them were ready, and is still to be answered. `inbox`:
    /// what is received, by host.
    pub fn new(
        hosts: Hosts,
        others: Vec<Other>,
        early: VecDeque<(u32, FromHost)>,
        inbox: mpsc::Receiver<(u32, FromHost)>,
    ) -> Self {
        assert_eq!(others.len() as u32 + 1, hosts.count(), "all have come");
        Self { hosts, others, early, inbox }
    }

    pub fn host_of(&self, process: Process) -> u32 {
        match process {
            Process::Learner(rank) => self.hosts.of_learner(rank),
            Process::Actor(actor) => self.hosts.of_actor(actor),
        }
    }

    pub fn processes_of(&self, host: u32) -> Vec<Process> {
        let learners = self.hosts.ranks_of(host).map(Process::Learner);
        learners.chain(self.hosts.actors_of(host).map(Process::Actor)).collect()
    }

    pub fn name(&self, host: u32) -> String {
        match self.others.get(host as usize - 1) {
            Some(other) => format!("host {host} ({})", other.name),
            None => format!("host {host}"),
        }
    }

    pub fn order(&self, host: u32, order: Order) {
        self.others[host as usize - 1].way.order(order);
    }

    pub fn order_all(&self, order: &Order) {
        self.others.iter().for_each(|other| other.way.order(order.clone()));
    }

    pub async fn received(&mut self) -> (u32, FromHost) {
        if let Some(early) = self.early.pop_front() {
            return early;
        }
        let Some((host, received)) = self.inbox.recv().await else { return std::future::pending().await };
        if matches!(received, FromHost::Lost(_)) {
            self.others[host as usize - 1].lost = true;
        }
        (host, received)
    }

    pub fn is_short(&self) -> bool {
        self.others.iter().any(|other| other.lost)
    }

    /// Has all complete their recordings, for which they have `patience`; what is missing, by host.
    pub async fn finish(&mut self, frames: Option<u64>, patience: Duration) -> Vec<String> {
        self.order_all(&Order::Finish { frames });
        let mut open: Vec<u32> = (1..self.hosts.count()).filter(|&host| !self.others[host as usize - 1].lost).collect();
        let mut missing: Vec<String> = (1..self.hosts.count())
            .filter(|host| !open.contains(host))
            .map(|host| format!("{} is lost, and what it recorded last with it", self.name(host)))
            .collect();
        let deadline = tokio::time::Instant::now() + patience;
        while !open.is_empty() {
            let Ok((host, received)) = tokio::time::timeout_at(deadline, self.received()).await else { break };
            match received {
                FromHost::Reported(HostReport::Recorded(Ok(()))) => open.retain(|other| *other != host),
                FromHost::Reported(HostReport::Recorded(Err(reason))) | FromHost::Lost(reason) => {
                    if open.contains(&host) {
                        missing.push(format!("{}: {reason}", self.name(host)));
                    }
                    open.retain(|other| *other != host);
                }
                // Late words of processes that have ended. A host that asks for a stop asks again in the next start.
                FromHost::Reported(_) => {}
            }
        }
        missing.extend(
            open.into_iter().map(|host| {
                format!("{} did not complete its recording within {} s", self.name(host), patience.as_secs())
            }),
        );
        missing
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::shares::Shares;
    use std::sync::{Arc, Mutex};

    #[derive(Debug, Clone, Default)]
    struct Way(Arc<Mutex<Vec<Order>>>);

    impl Obeys for Way {
        fn order(&self, order: Order) {
            self.0.lock().unwrap().push(order);
        }
    }

    #[tokio::test]
    async fn every_host_completes_its_recording_or_is_named() {
        let (sender, inbox) = mpsc::channel(8);
        let ways: Vec<Way> = (0..4).map(|_| Way::default()).collect();
        let other = |(number, way): (usize, &Way)| Other {
            name: format!("n{}", number + 1),
            way: Box::new(way.clone()),
            lost: number == 3,
        };
        let others = ways.iter().enumerate().map(other).collect();
        let early = VecDeque::from([(3, FromHost::Reported(HostReport::Interrupt))]);
        let mut remote_hosts = RemoteHosts::new(Hosts::new(5, Shares::new(10, 5)), others, early, inbox);
        assert_eq!(
            remote_hosts.received().await,
            (3, FromHost::Reported(HostReport::Interrupt)),
            "before all that came later"
        );
        assert_eq!(remote_hosts.processes_of(1), [Process::Learner(1), Process::Actor(2), Process::Actor(3)]);
        assert_eq!([Process::Learner(4), Process::Actor(3)].map(|process| remote_hosts.host_of(process)), [4, 1]);
        for received in [
            (1, FromHost::Reported(HostReport::Recorded(Ok(())))),
            (2, FromHost::Reported(HostReport::Interrupt)),
            (2, FromHost::Reported(HostReport::Recorded(Err("its disk is full".into())))),
        ] {
            sender.send(received).await.unwrap();
        }
        let missing = remote_hosts.finish(Some(7), Duration::from_millis(50)).await;
        assert_eq!(missing.len(), 3, "{missing:?}");
        assert!(missing[0].starts_with("host 4 (n4) is lost"), "{missing:?}");
        assert_eq!(missing[1], "host 2 (n2): its disk is full");
        assert!(missing[2].contains("host 3 (n3) did not complete its recording within 0 s"), "{missing:?}");
        assert_eq!(*ways[2].0.lock().unwrap(), [Order::Finish { frames: Some(7) }]);
    }
}
