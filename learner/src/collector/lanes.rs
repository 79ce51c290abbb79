//! Where every half of every actor stands, and whose turn it is.
//!
//! The observation with step s is answered by the action with step s, which leads to the observation with step s + 1.
//! So everything an actor can send is either expected now or was received before, whatever the others have sent.

use std::fmt;

/// Who acts together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// The first halves of all actors, then all second halves: a batch always has the same rows. All wait for the
    /// slowest.
    Lockstep,
    /// Whoever is there, as soon as they are a share of those who are not through with the rollout. The fast run ahead of
    /// the slow, up to its end. For an agent that gives a row the same result whatever stands beside it.
    Ready,
}

impl Pace {
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Lockstep => Self::Ready,
            Self::Ready => Self::Lockstep,
        }
    }
}

impl fmt::Display for Pace {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Lockstep => "in lockstep",
            Self::Ready => "when they are ready",
        })
    }
}

/// One in so many must be there before [`Pace::Ready`] lets them act: the others have something to do meanwhile, and a
/// batch of a few rows takes nearly as long as one of many.
const READY_SHARE: usize = 4;

/// One actor's half at a row of the rollout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Lane {
    /// The actor's place among its learner's own.
    pub index: u32,
    pub half: u32,
    /// Row of the rollout; as many as it has, when the last action has been taken.
    pub t: usize,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Next {
    /// Observations of these actors, or receipts for them, ascending; it is enough to look when so many have come.
    Await { actors: Vec<u32>, enough: u32 },
    /// These act together, ascending.
    Act(Vec<Lane>),
    /// Nothing: all are through with the rollout.
    Finish,
}

/// One actor's half.
#[derive(Debug)]
struct HalfProgress<S> {
    step: u64,
    sample: Option<S>,
    /// The newest exchange of which the recorder has its observations.
    recorded: Option<u64>,
    /// The outcomes of its last actions are taken in.
    settled: bool,
    /// The observations after the rollout's last action are valued.
    valued: bool,
}

/// All halves of a learner's actors. Actors are named by their place among its own.
#[derive(Debug)]
pub struct Lanes<S> {
    pace: Pace,
    halves: u32,
    /// By actor, then half.
    all: Vec<HalfProgress<S>>,
    /// Which shard each actor is of.
    shards: Vec<usize>,
    /// Exchange that the rollout began with.
    from: u64,
    /// And the first rollout.
    first: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arrival {
    Awaited,
    /// It was received before: sent again by an actor that was restarted.
    Duplicate,
    Ahead,
}

impl<S> Lanes<S> {
    /// All wait for the observations of exchange `from`, and go in lockstep. `shards`: of each actor.
    pub fn new(halves: u32, shards: Vec<usize>, from: u64) -> Self {
        let standing = || HalfProgress { step: from, sample: None, recorded: None, settled: false, valued: false };
        let all = (0..shards.len() * halves as usize).map(|_| standing()).collect();
        Self { pace: Pace::Lockstep, halves, all, shards, from, first: from }
    }

    fn at(&self, index: u32, half: u32) -> &HalfProgress<S> {
        &self.all[(index * self.halves + half) as usize]
    }

    fn at_mut(&mut self, index: u32, half: u32) -> &mut HalfProgress<S> {
        &mut self.all[(index * self.halves + half) as usize]
    }

    /// Halves of an actor: 1 or 2.
    pub fn halves(&self) -> u32 {
        self.halves
    }

    /// The exchange whose observations are expected or here; as many actions have been sent since the run's start.
    pub fn step(&self, index: u32, half: u32) -> u64 {
        self.at(index, half).step
    }

    /// Who acts together from now on.
    pub fn go_at(&mut self, pace: Pace) {
        self.pace = pace;
    }

    pub fn begin(&mut self) {
        self.from = self.boundary();
        self.all.iter_mut().for_each(|lane| lane.valued = false);
    }

    pub fn all_seen(&self) -> bool {
        self.all.iter().all(|lane| lane.sample.is_some() || lane.step > self.first)
    }

    /// The exchange of all between two rollouts. Panics if they are not all at the same.
    pub fn boundary(&self) -> u64 {
        let step = self.all[0].step;
        assert!(self.all.iter().all(|lane| lane.step == step), "between rollouts all stand at the same exchange");
        step
    }

    pub fn arrival(&self, index: u32, half: u32, step: u64) -> Arrival {
        let lane = self.at(index, half);
        match step.cmp(&lane.step) {
            std::cmp::Ordering::Less => Arrival::Duplicate,
            std::cmp::Ordering::Equal if lane.sample.is_some() => Arrival::Duplicate,
            std::cmp::Ordering::Equal => Arrival::Awaited,
            std::cmp::Ordering::Greater => Arrival::Ahead,
        }
    }

    /// Keeps an expected sample. Panics if there is one already.
    pub fn keep(&mut self, index: u32, half: u32, sample: S) {
        let slot = &mut self.at_mut(index, half).sample;
        assert!(slot.is_none(), "only an awaited sample is kept");
        *slot = Some(sample);
    }

    /// Whether a lane is at this row and its observations are here.
    pub fn stands(&self, lane: Lane) -> bool {
        let standing = self.at(lane.index, lane.half);
        standing.sample.is_some() && self.row(standing) == lane.t
    }

    /// The observations of a lane whose turn it is. Panics if they are not here.
    pub fn sample(&self, lane: Lane) -> &S {
        self.at(lane.index, lane.half).sample.as_ref().expect("who acts has been seen")
    }

    /// The recorder has the observations up to those of exchange `step`.
    pub fn recorded(&mut self, index: u32, half: u32, step: u64) {
        let newest = &mut self.at_mut(index, half).recorded;
        *newest = (*newest).max(Some(step));
    }

    /// Whether the recorder has the observations that are waited for or here.
    pub fn is_recorded(&self, index: u32, half: u32) -> bool {
        let lane = self.at(index, half);
        lane.recorded >= Some(lane.step)
    }

    fn row(&self, lane: &HalfProgress<S>) -> usize {
        (lane.step - self.from) as usize
    }

    /// Lanes that are not through with the rollout, ascending.
    fn open(&self) -> impl Iterator<Item = (Lane, &HalfProgress<S>)> {
        let open = (0..).zip(&self.all).filter(|(_, lane)| !lane.valued);
        open.map(|(place, lane): (u32, _)| {
            (Lane { index: place / self.halves, half: place % self.halves, t: self.row(lane) }, lane)
        })
    }

    /// Rows of the rollout whose outcomes are taken in from every lane.
    pub fn settled_rows(&self) -> usize {
        let of = |lane: &HalfProgress<S>| self.row(lane).saturating_sub(usize::from(!lane.settled));
        self.all.iter().map(of).min().unwrap_or(0)
    }

    /// The row that all are at, if they are at one and nobody is through.
    pub fn common_row(&self) -> Option<usize> {
        let row = self.row(&self.all[0]);
        self.all.iter().all(|lane| !lane.valued && self.row(lane) == row).then_some(row)
    }

    /// Whose turn it is. `recorded`: there is a recorder.
    pub fn next(&self, recorded: bool) -> Next {
        if self.all.iter().all(|lane| lane.valued) {
            return Next::Finish;
        }
        match self.pace {
            Pace::Lockstep => self.next_half(),
            Pace::Ready => self.next_ready(recorded),
        }
    }

    /// The half that is furthest behind.
    fn next_half(&self) -> Next {
        let due = self.open().map(|(lane, _)| (lane.t, lane.half)).min();
        let of_it = || self.open().filter(|(lane, _)| Some((lane.t, lane.half)) == due);
        let missing = of_it().filter(|(_, standing)| standing.sample.is_none());
        let actors: Vec<u32> = missing.map(|(lane, _)| lane.index).collect();
        if actors.is_empty() {
            return Next::Act(of_it().map(|(lane, _)| lane).collect());
        }
        // Few wakes, and little is left to do when the last comes.
        let enough = (actors.len() as u32).div_ceil(2);
        Next::Await { actors, enough }
    }

    /// Those that are there, if there are enough of them: the furthest behind first, and no more of a shard than a half
    /// of its actors' environments.
    fn next_ready(&self, recorded: bool) -> Next {
        // What the recorder has not seen cannot be answered, and the others need not wait for that.
        let is_there = |lane: &Lane, standing: &HalfProgress<S>| {
            standing.sample.is_some() && (!recorded || self.is_recorded(lane.index, lane.half))
        };
        let open = self.open().count();
        let mut ready: Vec<Lane> =
            self.open().filter(|(lane, standing)| is_there(lane, standing)).map(|(lane, _)| lane).collect();
        let needed = open.div_ceil(READY_SHARE);
        if ready.len() < needed {
            let missing = self.open().filter(|(lane, standing)| !is_there(lane, standing));
            let mut actors: Vec<u32> = missing.map(|(lane, _)| lane.index).collect();
            actors.dedup();
            // A recorder's receipts ring once for several.
            let enough = if recorded { 1 } else { (needed - ready.len()) as u32 };
            return Next::Await { actors, enough };
        }
        ready.sort_by_key(|lane| (lane.t, lane.index, lane.half));
        let mut room = vec![0; self.shards.iter().max().map_or(0, |last| last + 1)];
        self.shards.iter().for_each(|&shard| room[shard] += 1);
        ready.retain(|lane| {
            let room: &mut usize = &mut room[self.shards[lane.index as usize]];
            let fits = *room > 0;
            *room -= usize::from(fits);
            fits
        });
        ready.sort_unstable();
        Next::Act(ready)
    }

    /// True at the first call for an exchange, so that its outcomes are recorded once.
    pub fn begin_settling(&mut self, lane: Lane) -> bool {
        !std::mem::replace(&mut self.at_mut(lane.index, lane.half).settled, true)
    }

    /// The actions of this exchange are sent: lets go of its observations and waits for the next.
    pub fn advance(&mut self, lane: Lane) {
        let lane = self.at_mut(lane.index, lane.half);
        lane.step += 1;
        lane.settled = false;
        lane.sample = None;
    }

    /// The observations are valued. They stay: they are the next rollout's first.
    pub fn value(&mut self, lane: Lane) {
        self.at_mut(lane.index, lane.half).valued = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEPS: usize = 3;

    fn lane(index: u32, half: u32, t: usize) -> Lane {
        Lane { index, half, t }
    }

    /// Everybody that is not slow sends as soon as it is answered, until nothing goes on.
    fn run(lanes: &mut Lanes<()>, slow: &[(u32, u32)]) -> Vec<Vec<Lane>> {
        let mut turns = vec![];
        loop {
            for lane in lanes.open().map(|(lane, _)| lane).collect::<Vec<_>>() {
                let is_slow = slow.contains(&(lane.index, lane.half));
                if !is_slow
                    && lanes.arrival(lane.index, lane.half, lanes.step(lane.index, lane.half)) == Arrival::Awaited
                {
                    lanes.keep(lane.index, lane.half, ());
                }
            }
            let Next::Act(due) = lanes.next(false) else { return turns };
            for &lane in &due {
                if lane.t == STEPS { lanes.value(lane) } else { lanes.advance(lane) }
            }
            turns.push(due);
        }
    }

    #[test]
    fn in_lockstep_the_halves_take_turns_and_wait_for_the_slowest() {
        let mut lanes = Lanes::new(2, vec![0; 2], 7);
        lanes.begin();
        assert_eq!(run(&mut lanes, &[(1, 1)]), [[lane(0, 0, 0), lane(1, 0, 0)]]);
        assert_eq!(lanes.next(false), Next::Await { actors: vec![1], enough: 1 });
        let turns = run(&mut lanes, &[]);
        assert_eq!(turns.len(), 2 * (STEPS + 1) - 1);
        assert!(turns.iter().zip([1, 0].iter().cycle()).all(|(turn, &half)| turn.iter().all(|lane| lane.half == half)));
        assert_eq!(lanes.next(false), Next::Finish);
    }

    #[test]
    fn who_is_ready_goes_on_to_the_end_of_the_rollout_while_another_is_slow() {
        let mut lanes = Lanes::new(2, vec![0; 4], 7);
        lanes.go_at(Pace::Ready);
        lanes.begin();
        let turns = run(&mut lanes, &[(2, 0), (2, 1)]);
        let acted: usize = turns.iter().map(Vec::len).sum();
        assert_eq!(acted, 6 * (STEPS + 1), "the others are through");
        assert!(turns.iter().all(|turn| turn.len() <= 4 && turn.is_sorted()), "a batch is as large as in lockstep");
        assert_eq!(lanes.next(false), Next::Await { actors: vec![2], enough: 1 });
        assert_eq!((lanes.settled_rows(), lanes.common_row()), (0, None));
        run(&mut lanes, &[]);
        assert_eq!(lanes.next(false), Next::Finish);
        assert_eq!(lanes.boundary(), 7 + STEPS as u64);
    }

    #[test]
    fn a_batch_has_the_furthest_behind_and_of_each_shard_what_fits() {
        let mut lanes = Lanes::new(2, vec![0, 0, 1, 1], 0);
        lanes.go_at(Pace::Ready);
        lanes.begin();
        lanes.keep(0, 0, ());
        assert_eq!(lanes.next(false), Next::Await { actors: vec![0, 1, 2, 3], enough: 1 });
        lanes.advance(lane(0, 0, 0));
        for (index, half) in [(0, 0), (0, 1), (1, 0), (3, 0)] {
            lanes.keep(index, half, ());
        }
        assert_eq!(lanes.next(false), Next::Act(vec![lane(0, 1, 0), lane(1, 0, 0), lane(3, 0, 0)]));
        assert_eq!(lanes.next(true), Next::Await { actors: vec![0, 1, 2, 3], enough: 1 });
        lanes.recorded(0, 0, 1);
        lanes.recorded(1, 0, 0);
        assert_eq!(lanes.next(true), Next::Act(vec![lane(0, 0, 1), lane(1, 0, 0)]), "what the recorder has");
    }

    #[test]
    fn a_rollout_of_no_steps_values_all_at_once_and_the_next_begins_where_it_ended() {
        for pace in [Pace::Lockstep, Pace::Ready] {
            let mut lanes = Lanes::new(1, vec![0; 3], 4);
            lanes.go_at(pace);
            assert!(!lanes.all_seen());
            (0..3).for_each(|index| lanes.keep(index, 0, ()));
            assert!(lanes.all_seen());
            for _ in 0..2 {
                lanes.begin();
                assert_eq!((lanes.common_row(), lanes.settled_rows()), (Some(0), 0));
                let Next::Act(due) = lanes.next(false) else { panic!("{pace:?}") };
                assert_eq!(due, [0, 1, 2].map(|index| lane(index, 0, 0)));
                for lane in due {
                    lanes.value(lane);
                }
                assert_eq!((lanes.next(false), lanes.boundary()), (Next::Finish, 4));
            }
            lanes.begin();
            let turns = run(&mut lanes, &[1].map(|index| (index, 0)));
            assert_eq!(turns.iter().flatten().filter(|lane| lane.index == 1).count(), 1, "its observation was here");
            run(&mut lanes, &[]);
            assert_eq!((lanes.next(false), lanes.boundary()), (Next::Finish, 4 + STEPS as u64));
        }
    }
}
