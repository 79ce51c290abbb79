//! ZeroMQ: a ROUTER socket of the learner's, a DEALER of each actor's, over IPC. Messages are handed over, not copied,
//! where the library allows it.

use crate::end::{ActorEnd, LearnerEnd, Place, actions};
use anyhow::{Context, Result, ensure};
use std::collections::BTreeMap;
use zmq::{Message, Socket};

fn endpoint(place: &Place) -> String {
    format!("ipc://{}", place.folder().join("zeromq").display())
}

pub struct Learner {
    socket: Socket,
    place: Place,
    held: [BTreeMap<u32, Message>; 2],
}

impl Learner {
    pub fn open(place: &Place) -> Result<Self> {
        let socket = zmq::Context::new().socket(zmq::ROUTER)?;
        socket.bind(&endpoint(place)).context("cannot bind")?;
        Ok(Self { socket, place: place.clone(), held: Default::default() })
    }

    fn part(&self) -> Result<Message> {
        let mut part = Message::new();
        self.socket.recv(&mut part, 0)?;
        Ok(part)
    }
}

impl LearnerEnd for Learner {
    fn receive(&mut self, half: u32, each: &mut dyn FnMut(u32, &[u8])) -> Result<()> {
        while self.held[half as usize].len() < self.place.actors as usize {
            let (identity, arrived, payload) = (self.part()?, self.part()?, self.part()?);
            let actor = u32::from_be_bytes(identity[1..].try_into().context("an identity of five bytes")?);
            ensure!(arrived.len() == 1 && payload.len() == self.place.bytes(), "a message of another shape");
            self.held[usize::from(arrived[0])].insert(actor, payload);
        }
        self.held[half as usize].iter().for_each(|(&actor, payload)| each(actor, payload));
        Ok(())
    }

    fn answer(&mut self, half: u32, action: u8) -> Result<()> {
        self.held[half as usize].clear();
        for actor in 0..self.place.actors {
            self.socket.send(&identity(actor)[..], zmq::SNDMORE)?;
            self.socket.send(&[half as u8][..], zmq::SNDMORE)?;
            self.socket.send(actions(&self.place, action), 0)?;
        }
        Ok(())
    }
}

/// An identity must not begin with a zero.
fn identity(actor: u32) -> [u8; 5] {
    let [a, b, c, d] = actor.to_be_bytes();
    [b'a', a, b, c, d]
}

pub struct Actor {
    socket: Socket,
    bytes: usize,
}

impl Actor {
    pub fn open(place: &Place, number: u32) -> Result<Self> {
        let socket = zmq::Context::new().socket(zmq::DEALER)?;
        socket.set_identity(&identity(number))?;
        socket.connect(&endpoint(place)).context("cannot connect")?;
        Ok(Self { socket, bytes: place.bytes() })
    }
}

impl ActorEnd for Actor {
    fn send(&mut self, half: u32, pattern: u8) -> Result<()> {
        let mut payload = Message::with_size(self.bytes);
        payload.fill(pattern);
        self.socket.send(&[half as u8][..], zmq::SNDMORE)?;
        Ok(self.socket.send(payload, 0)?)
    }

    fn wait(&mut self) -> Result<(u32, u8)> {
        let parts = self.socket.recv_multipart(0)?;
        ensure!(parts.len() == 2 && !parts[1].is_empty(), "an answer of another shape");
        Ok((u32::from(parts[0][0]), parts[1][0]))
    }
}
