//! The lockstep of one half: its current exchange, and which actors' observations of it have arrived.

/// One half of the environments of every actor of a learner. Actors are named by their place among its own.
///
/// The observation with step s is answered by the action with step s, which leads to the observation with step s + 1;
/// all actors answer before the half goes on. So everything an actor can send is either expected now or was received
/// before.
#[derive(Debug)]
pub struct Half<S> {
    step: u64,
    samples: Vec<Option<S>>,
    /// The newest exchange of which the recorder has each actor's observations.
    recorded: Vec<Option<u64>>,
    settled: bool,
}

/// Meaning of a sample's step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    /// The half waits for it.
    Awaited,
    /// It was received before: sent again by an actor that was restarted.
    Duplicate,
    /// It answers an action that was never sent.
    Ahead,
}

impl<S> Half<S> {
    /// A half that waits for the observations of exchange `step` from every actor.
    pub fn new(actors: u32, step: u64) -> Self {
        let recorded = vec![None; actors as usize];
        Self { step, samples: (0..actors).map(|_| None).collect(), recorded, settled: false }
    }

    /// The exchange whose observations are expected or here; as many actions have been sent since the run's start.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Where a sample of `actor` with this step belongs.
    pub fn arrival(&self, actor: u32, step: u64) -> Arrival {
        match step.cmp(&self.step) {
            std::cmp::Ordering::Less => Arrival::Duplicate,
            std::cmp::Ordering::Equal if self.samples[actor as usize].is_some() => Arrival::Duplicate,
            std::cmp::Ordering::Equal => Arrival::Awaited,
            std::cmp::Ordering::Greater => Arrival::Ahead,
        }
    }

    /// Keeps an expected sample.
    ///
    /// # Panics
    /// If that actor's is here already.
    pub fn keep(&mut self, actor: u32, sample: S) {
        let slot = &mut self.samples[actor as usize];
        assert!(slot.is_none(), "only an awaited sample is kept");
        *slot = Some(sample);
    }

    /// Actors whose observations are missing, ascending.
    pub fn missing(&self) -> impl Iterator<Item = u32> {
        self.samples.iter().enumerate().filter(|(_, sample)| sample.is_none()).map(|(actor, _)| actor as u32)
    }

    /// The recorder has an actor's observations up to those of exchange `step`.
    pub fn recorded(&mut self, actor: u32, step: u64) {
        let newest = &mut self.recorded[actor as usize];
        *newest = (*newest).max(Some(step));
    }

    /// Actors whose observations of this exchange the recorder does not have yet, ascending.
    pub fn unrecorded(&self) -> impl Iterator<Item = u32> {
        self.recorded.iter().enumerate().filter(|(_, newest)| **newest < Some(self.step)).map(|(actor, _)| actor as u32)
    }

    /// The observations of all actors in order, once they are complete.
    pub fn complete(&self) -> Option<Vec<&S>> {
        self.samples.iter().map(Option::as_ref).collect()
    }

    /// True at the first call for an exchange, so that its outcomes are recorded once.
    pub fn begin_settling(&mut self) -> bool {
        !std::mem::replace(&mut self.settled, true)
    }

    /// The actions of this exchange are sent: lets go of its observations and waits for the next.
    pub fn advance(&mut self) {
        self.step += 1;
        self.settled = false;
        for sample in &mut self.samples {
            *sample = None;
        }
    }
}
