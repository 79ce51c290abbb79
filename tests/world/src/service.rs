//! One publish-subscribe service as iceoryx2 0.10 keeps it, without its memory.
//!
//! What matters here and is easy to forget:
//!
//! * A channel between a publisher and a subscriber has two ends, and each side makes its own: the publisher when it
//!   sends or updates, the subscriber when it receives. What is sent before the subscriber has made its end waits in
//!   the channel, as far as there is room.
//! * A blocking publisher waits at a full channel only while the subscriber has its end. One that has not is skipped,
//!   and does not count among the receivers.
//! * Of a dead process the ports stay, and block, until somebody sweeps them. A channel that only a dead publisher had
//!   made goes with it, and what is in it; one that the subscriber had made, too, is read to its end.

use crate::dice::Dice;
use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;

/// A task, by its number in the process table.
pub type TaskId = u32;

/// What happens at a full channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Full {
    /// The publisher waits.
    Block,
    /// What is sent is lost.
    Discard,
    /// The oldest gives way.
    Replace,
}

#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Samples that wait for one subscriber.
    pub buffer: usize,
    /// Samples of one publisher that a subscriber holds at once.
    pub borrowed: u32,
    /// At a full channel.
    pub full: Full,
    /// Whether the last sample is given to subscribers that come later.
    pub history: bool,
    /// Most publishers, the dead that are not swept included.
    pub publishers: usize,
    /// Most subscribers.
    pub subscribers: usize,
}

#[derive(Debug)]
struct Port {
    id: u32,
    task: TaskId,
    /// From when on it can be known to be dead.
    dead_at: Option<u64>,
}

#[derive(Debug)]
struct Channel<T> {
    publisher: u32,
    subscriber: u32,
    queue: VecDeque<T>,
    /// The publisher has made its end.
    open: bool,
    /// The subscriber has made its end.
    joined: bool,
    /// The publisher is swept: what is here is the rest.
    ended: bool,
    borrowed: Rc<Cell<u32>>,
}

/// A received sample, which holds its place until it is dropped.
#[derive(Debug)]
pub struct Borrowed<T> {
    pub value: T,
    held: Rc<Cell<u32>>,
}

impl<T> Drop for Borrowed<T> {
    fn drop(&mut self) {
        self.held.set(self.held.get() - 1);
    }
}

/// What became of a sample at one place in the list of subscribers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// It is in the channel.
    Delivered,
    /// Nobody is at this place, or it has not joined and its channel is full.
    Skipped,
    /// The publisher has to wait.
    Blocked,
}

#[derive(Debug)]
pub struct Service<T> {
    settings: Settings,
    publishers: Vec<Option<Port>>,
    subscribers: Vec<Option<Port>>,
    channels: Vec<Channel<T>>,
    last: Option<T>,
    next_port: u32,
    waiting: Vec<TaskId>,
}

/// A service has no place left for a port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoPlace;

fn take_place(ports: &mut Vec<Option<Port>>, most: usize, port: Port) -> Result<u32, NoPlace> {
    let id = port.id;
    match ports.iter().position(Option::is_none) {
        Some(place) => ports[place] = Some(port),
        None if ports.len() < most => ports.push(Some(port)),
        None => return Err(NoPlace),
    }
    Ok(id)
}

impl<T: Clone> Service<T> {
    /// A service without ports.
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            publishers: vec![],
            subscribers: vec![],
            channels: vec![],
            last: None,
            next_port: 0,
            waiting: vec![],
        }
    }

    /// Opens a publisher's port.
    pub fn publish(&mut self, task: TaskId) -> Result<u32, NoPlace> {
        self.next_port += 1;
        take_place(&mut self.publishers, self.settings.publishers, Port { id: self.next_port, task, dead_at: None })
    }

    /// Opens a subscriber's port.
    pub fn subscribe(&mut self, task: TaskId) -> Result<u32, NoPlace> {
        self.next_port += 1;
        take_place(&mut self.subscribers, self.settings.subscribers, Port { id: self.next_port, task, dead_at: None })
    }

    /// Subscribers now, the dead that are not swept included.
    pub fn readers(&self) -> usize {
        self.subscribers.iter().flatten().count()
    }

    /// Places in the list of subscribers, in the order in which a sample is delivered.
    pub fn places(&self) -> usize {
        self.subscribers.len()
    }

    /// The tasks behind the subscribers.
    pub fn listeners(&self) -> Vec<TaskId> {
        self.subscribers.iter().flatten().map(|port| port.task).collect()
    }

    fn channel(&mut self, publisher: u32, subscriber: u32) -> &mut Channel<T> {
        let same = |channel: &Channel<T>| (channel.publisher, channel.subscriber) == (publisher, subscriber);
        let at = self.channels.iter().position(same).unwrap_or_else(|| {
            let borrowed = Rc::default();
            let (queue, ended) = (VecDeque::new(), false);
            self.channels.push(Channel { publisher, subscriber, queue, open: false, joined: false, ended, borrowed });
            self.channels.len() - 1
        });
        &mut self.channels[at]
    }

    /// The publisher makes its ends of channels to subscribers that have come since; they get the last sample where
    /// there is a history.
    pub fn update(&mut self, publisher: u32) {
        let ids: Vec<u32> = self.subscribers.iter().flatten().map(|port| port.id).collect();
        let last = self.last.clone().filter(|_| self.settings.history);
        for id in ids {
            let channel = self.channel(publisher, id);
            if !std::mem::replace(&mut channel.open, true) {
                channel.queue.extend(last.clone());
            }
        }
    }

    /// A sample is kept for later subscribers.
    pub fn remember(&mut self, sample: &T) {
        if self.settings.history {
            self.last = Some(sample.clone());
        }
    }

    /// Delivers a sample to the subscriber at one place; `task` waits if it is blocked.
    pub fn deliver(&mut self, publisher: u32, task: TaskId, place: usize, sample: &T) -> Delivery {
        let Some(id) = self.subscribers.get(place).and_then(|port| port.as_ref().map(|port| port.id)) else {
            return Delivery::Skipped;
        };
        let Settings { buffer, full, .. } = self.settings;
        let channel = self.channel(publisher, id);
        channel.open = true;
        if channel.queue.len() >= buffer {
            match full {
                Full::Block if channel.joined => {
                    self.waiting.push(task);
                    return Delivery::Blocked;
                }
                Full::Block | Full::Discard => return Delivery::Skipped,
                Full::Replace => drop(channel.queue.pop_front()),
            }
        }
        channel.queue.push_back(sample.clone());
        Delivery::Delivered
    }

    /// The next sample of any publisher, if one waits and may be held. The second result are tasks that have room now.
    pub fn receive(&mut self, subscriber: u32, dice: &mut Dice) -> (Option<Borrowed<T>>, Vec<TaskId>) {
        let publishers: Vec<u32> = self.publishers.iter().flatten().map(|port| port.id).collect();
        for publisher in publishers {
            self.channel(publisher, subscriber).joined = true;
        }
        self.channels.retain(|channel| !(channel.ended && channel.queue.is_empty() && channel.borrowed.get() == 0));
        let borrowed = self.settings.borrowed;
        let ready: Vec<usize> = (0..self.channels.len())
            .filter(|&at| {
                let channel = &self.channels[at];
                let may = channel.joined && channel.borrowed.get() < borrowed;
                channel.subscriber == subscriber && may && !channel.queue.is_empty()
            })
            .collect();
        if ready.is_empty() {
            return (None, vec![]);
        }
        // Channels are served in any order.
        let channel = &mut self.channels[dice.one_of(&ready)];
        let Some(value) = channel.queue.pop_front() else { return (None, vec![]) };
        channel.borrowed.set(channel.borrowed.get() + 1);
        let held = Rc::clone(&channel.borrowed);
        (Some(Borrowed { value, held }), std::mem::take(&mut self.waiting))
    }

    /// A task is dead; from `at` on that can be known.
    pub fn died(&mut self, task: TaskId, at: u64) {
        for port in self.publishers.iter_mut().chain(&mut self.subscribers).flatten().filter(|port| port.task == task) {
            port.dead_at.get_or_insert(at);
        }
    }

    /// Removes ports of those who are known to be dead; the tasks that need not wait for them any more.
    pub fn sweep(&mut self, now: u64) -> Vec<TaskId> {
        let dead = |port: &Option<Port>| port.as_ref().is_some_and(|port| port.dead_at.is_some_and(|at| at <= now));
        let mut gone = vec![];
        for place in self.publishers.iter_mut().chain(&mut self.subscribers).filter(|place| dead(place)) {
            gone.extend(place.take().map(|port| port.id));
        }
        if gone.is_empty() {
            return vec![];
        }
        self.channels.retain_mut(|channel| {
            channel.ended |= gone.contains(&channel.publisher);
            !gone.contains(&channel.subscriber) && (!channel.ended || channel.joined)
        });
        std::mem::take(&mut self.waiting)
    }
}
