//! What is held back of an environment's episode in progress, where only failures are recorded. Pure.
//!
//! Whether an episode is wanted is known at its end. A learner that goes back to its checkpoint plays on from an earlier
//! step, or in an earlier episode: what was held from there on never happened, and is forgotten.

use super::segment::Topic;

pub struct Message {
    pub topic: Topic,
    pub time_ns: u64,
    pub data: Vec<u8>,
}

#[derive(Default)]
pub struct HeldBack {
    episode: u32,
    /// Each with its place in the episode: 0 for the start, step + 1 for a step, one more than the last for the end.
    messages: Vec<(u32, Message)>,
}

impl HeldBack {
    /// Holds a message of this episode back, at its place there. What was held of another episode, or from this place on,
    /// is forgotten.
    pub fn hold(&mut self, episode: u32, place: u32, message: Message) {
        if self.episode != episode {
            self.messages.clear();
        }
        while self.messages.pop_if(|(last, _)| *last >= place).is_some() {}
        self.episode = episode;
        self.messages.push((place, message));
    }

    pub fn take(&mut self) -> impl Iterator<Item = Message> + use<> {
        std::mem::take(&mut self.messages).into_iter().map(|(_, message)| message)
    }
}
