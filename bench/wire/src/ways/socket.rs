//! Unix stream sockets, one for each actor; the learner polls them all.

use crate::end::{ActorEnd, LearnerEnd, Place, actions};
use anyhow::{Context, Result, ensure};
use rustix::event::{PollFd, PollFlags, poll};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;

fn path(place: &Place) -> PathBuf {
    place.folder().join("socket")
}

/// Before the observations: the half, and the actor for the first time.
const HEADER: usize = 8;

fn header(actor: u32, half: u32) -> [u8; HEADER] {
    let mut bytes = [0; HEADER];
    bytes[..4].copy_from_slice(&actor.to_ne_bytes());
    bytes[4..].copy_from_slice(&half.to_ne_bytes());
    bytes
}

fn parts(header: &[u8]) -> (u32, u32) {
    let number = |range: std::ops::Range<usize>| u32::from_ne_bytes(header[range].try_into().expect("four bytes"));
    (number(0..4), number(4..8))
}

/// One actor's connection: a message is a header and a half.
struct Connection {
    stream: UnixStream,
    header: [u8; HEADER],
    /// Bytes of the message that have arrived.
    arrived: usize,
    /// The observations of each half.
    halves: [Vec<u8>; 2],
    complete: [bool; 2],
}

impl Connection {
    /// Reads what is there, up to the end of the other half if this one is complete.
    fn read(&mut self) -> Result<()> {
        loop {
            let room = if self.arrived < HEADER {
                &mut self.header[self.arrived..]
            } else {
                let half = parts(&self.header).1 as usize;
                if self.complete[half] {
                    // Its bytes are not given back yet: a later message of the same half cannot come.
                    return Ok(());
                }
                &mut self.halves[half][self.arrived - HEADER..]
            };
            match self.stream.read(room) {
                Ok(0) => anyhow::bail!("an actor has gone"),
                Ok(count) => self.arrived += count,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
            let half = parts(&self.header).1 as usize;
            if self.arrived == HEADER + self.halves[0].len() {
                self.complete[half] = true;
                self.arrived = 0;
            }
        }
    }
}

pub struct Learner {
    listener: UnixListener,
    place: Place,
    connections: Vec<Connection>,
}

impl Learner {
    pub fn open(place: &Place) -> Result<Self> {
        let listener = UnixListener::bind(path(place)).context("cannot listen")?;
        Ok(Self { listener, place: place.clone(), connections: vec![] })
    }

    fn connect(&mut self) -> Result<()> {
        while self.connections.len() < self.place.actors as usize {
            let (stream, _) = self.listener.accept()?;
            stream.set_nonblocking(true)?;
            let halves = [(); 2].map(|()| vec![0; self.place.bytes()]);
            self.connections.push(Connection { stream, header: [0; HEADER], arrived: 0, halves, complete: [false; 2] });
        }
        Ok(())
    }
}

impl LearnerEnd for Learner {
    fn receive(&mut self, half: u32, each: &mut dyn FnMut(u32, &[u8])) -> Result<()> {
        self.connect()?;
        let half = half as usize;
        while self.connections.iter().any(|connection| !connection.complete[half]) {
            let waiting: Vec<usize> =
                (0..self.connections.len()).filter(|&index| !self.connections[index].complete[half]).collect();
            let mut polled: Vec<PollFd> =
                waiting.iter().map(|&index| PollFd::new(&self.connections[index].stream, PollFlags::IN)).collect();
            poll(&mut polled, None)?;
            let readable: Vec<bool> = polled.iter().map(|polled| !polled.revents().is_empty()).collect();
            for (index, _) in waiting.into_iter().zip(readable).filter(|(_, readable)| *readable) {
                self.connections[index].read()?;
            }
        }
        for connection in &self.connections {
            each(parts(&connection.header).0, &connection.halves[half]);
        }
        Ok(())
    }

    fn answer(&mut self, half: u32, action: u8) -> Result<()> {
        let message = [&[half as u8][..], &actions(&self.place, action)].concat();
        for connection in &mut self.connections {
            connection.complete[half as usize] = false;
            // A few bytes, for which there is always room.
            connection.stream.write_all(&message)?;
        }
        Ok(())
    }
}

pub struct Actor {
    stream: UnixStream,
    number: u32,
    message: Vec<u8>,
    answer: Vec<u8>,
}

impl Actor {
    pub fn open(place: &Place, number: u32) -> Result<Self> {
        let stream = UnixStream::connect(path(place)).context("cannot connect")?;
        Ok(Self {
            stream,
            number,
            message: vec![0; HEADER + place.bytes()],
            answer: vec![0; 1 + place.frames as usize],
        })
    }
}

impl ActorEnd for Actor {
    fn send(&mut self, half: u32, pattern: u8) -> Result<()> {
        let (head, body) = self.message.split_at_mut(HEADER);
        head.copy_from_slice(&header(self.number, half));
        body.fill(pattern);
        Ok(self.stream.write_all(&self.message)?)
    }

    fn wait(&mut self) -> Result<(u32, u8)> {
        self.stream.read_exact(&mut self.answer)?;
        ensure!(self.answer.len() > 1, "an answer holds at least one action");
        Ok((u32::from(self.answer[0]), self.answer[1]))
    }
}
