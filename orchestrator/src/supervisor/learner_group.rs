//! The learners as a group that starts and fails together: their events, and their joint failures. Pure.
//!
//! All take every step of the optimiser together. When one dies, the others' collective operations fail or hang. So one
//! death is a failure of the group: the others are killed, and when the last has ended all start together with one
//! incarnation number, which names their rendezvous. Such a failure counts as one death, whichever learner died first.

use super::event::Exit;
use super::pace::{Pace, Work};
use super::restart::{RestartHistory, RestartPolicy, Verdict};
use proto::exit::EXIT_NON_FINITE;
use std::ops::Range;
use std::time::Duration;

#[derive(Debug, Clone, Copy, Default)]
struct Reported {
    ready: Option<Duration>,
    connected: bool,
    finished: bool,
}

/// A learner that ended because it had lost another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bereaved {
    since: Duration,
    pub rank: u32,
    pub last_words: Vec<String>,
}

#[derive(Default)]
pub struct LearnerGroup {
    reported: Vec<Reported>,
    begun: Duration,
    work: Work,
    since: Duration,
    done: [bool; 4],
    pub pace: Pace,
    last_event_at: Duration,
    pub warned: Option<Duration>,
    held: Duration,
    collected: bool,
    restart_at: Option<Duration>,
    history: RestartHistory,
    /// The first of the present incarnation that ended because it had lost another one, whose end is not known yet.
    pub bereaved: Option<Bereaved>,
    non_finite: bool,
    non_finite_falls: u32,
    late_starts: u32,
}

impl LearnerGroup {
    pub fn new(learners: u32) -> Self {
        Self { reported: vec![Reported::default(); learners as usize], ..Self::default() }
    }

    pub fn size(&self) -> usize {
        self.reported.len()
    }

    pub fn ranks(&self) -> Range<u32> {
        0..self.reported.len() as u32
    }

    pub fn begin(&mut self, now: Duration) {
        self.reported.fill(Reported::default());
        self.begun = now;
        self.begin_work(now, Work::Collect);
        self.done = [false; 4];
        (self.collected, self.non_finite, self.restart_at, self.bereaved) = (false, false, None, None);
    }

    // What they say

    pub fn ready(&mut self, rank: u32, now: Duration) {
        self.reported[rank as usize].ready = Some(now);
        if rank == 0 {
            self.begin_work(now, Work::Collect);
        }
    }

    /// The actors of one have answered; true if with them all have.
    pub fn connected(&mut self, rank: u32) -> bool {
        self.reported[rank as usize].connected = true;
        self.reported.iter().all(|word| word.connected)
    }

    /// A rollout is collected. Whoever had a part in it has its actors; in a short one some have none.
    pub fn collected(&mut self, now: Duration) {
        self.collected = true;
        self.goes_on(now, Work::Update);
    }

    pub fn goes_on(&mut self, now: Duration, next: Work) {
        let first = !std::mem::replace(&mut self.done[self.work as usize], true);
        // The first rollout after a start waits until its actors have been started, too.
        if !first || self.work != Work::Collect {
            self.pace.took(self.work, now.saturating_sub(self.since));
        }
        self.begin_work(now, next);
    }

    fn begin_work(&mut self, now: Duration, work: Work) {
        (self.work, self.since, self.last_event_at, self.warned) = (work, now, now, None);
    }

    /// One says that it waits for an actor: it lives, and it bounds that wait itself.
    pub fn waits(&mut self, now: Duration) {
        (self.last_event_at, self.warned) = (now, None);
    }

    /// One says that it waits for a recorder that stands still: it lives, and that time is neither work nor a delay of
    /// the actors.
    pub fn waits_for_recorder(&mut self, now: Duration) {
        self.waits(now);
        (self.since, self.held) = (now, now);
    }

    pub fn warned(&mut self, silent: Duration) {
        self.warned = Some(silent);
    }

    /// One did not become ready in time; true if that has happened before since the last progress.
    pub fn started_late_again(&mut self) -> bool {
        self.late_starts += 1;
        self.late_starts > 1
    }

    pub fn finished(&mut self, rank: u32) {
        self.reported[rank as usize].finished = true;
    }

    // How they stand

    pub fn is_ready(&self, rank: u32) -> bool {
        self.reported[rank as usize].ready.is_some()
    }

    /// Whether this learner has reported its end: its exit is then no death.
    pub fn has_finished(&self, rank: u32) -> bool {
        self.reported[rank as usize].finished
    }

    pub fn all_ready_since(&self) -> Option<Duration> {
        let ready = |word: &Reported| word.ready.or(word.finished.then_some(self.begun));
        self.reported.iter().map(ready).try_fold(self.begun, |latest, ready| Some(latest.max(ready?)))
    }

    pub fn late_to_be_ready(&self, now: Duration, patience: Duration) -> Option<u32> {
        let late = now.saturating_sub(self.begun) > patience;
        self.ranks().filter(|_| late).find(|&rank| !self.is_ready(rank) && !self.has_finished(rank))
    }

    /// One whose actors have not all answered though more than `patience` has passed since all were ready, and no
    /// rollout has been collected.
    pub fn late_to_be_connected(&self, now: Duration, patience: Duration) -> Option<u32> {
        let waited = |ready: Duration| now.saturating_sub(ready.max(self.held));
        let late = !self.collected && self.all_ready_since().is_some_and(|ready| waited(ready) > patience);
        let unconnected = |word: Reported| !word.connected && !word.finished;
        self.ranks().filter(|_| late).find(|&rank| unconnected(self.reported[rank as usize]))
    }

    pub fn silent_for(&self, now: Duration) -> Option<Duration> {
        self.all_ready_since().map(|_| now.saturating_sub(self.last_event_at))
    }

    pub fn starting_for(&self, now: Duration) -> Option<Duration> {
        self.all_ready_since().is_none().then(|| now.saturating_sub(self.begun))
    }

    pub fn work(&self) -> (Work, bool) {
        (self.work, !self.done[self.work as usize])
    }

    // How they fall

    pub fn progress(&mut self) {
        self.history.progress();
        (self.non_finite_falls, self.late_starts) = (0, 0);
    }

    pub fn fell(&mut self, now: Duration, deadlines: &RestartPolicy) -> Verdict {
        let verdict = self.history.died(now, deadlines);
        if let Verdict::RestartAt(at) = verdict {
            self.restart_at = Some(at);
        }
        verdict
    }

    /// Records the cause of a death. True if the cause is a number that is not finite and the group has already failed
    /// for that cause since its last progress. All learners meet such numbers together and any may die first, so they
    /// count once per failure.
    pub fn met_non_finite_again(&mut self, exit: &Exit) -> bool {
        if *exit != Exit::Code(EXIT_NON_FINITE) || std::mem::replace(&mut self.non_finite, true) {
            return false;
        }
        self.non_finite_falls += 1;
        self.non_finite_falls > 1
    }

    /// A learner ended because it lost another: we wait for the death of that one, which is the cause.
    pub fn bereaved(&mut self, now: Duration, rank: u32, last_words: &[String]) {
        self.bereaved.get_or_insert_with(|| Bereaved { since: now, rank, last_words: last_words.to_vec() });
    }

    pub fn take_bereaved(&mut self, now: Duration, patience: Duration) -> Option<Bereaved> {
        self.bereaved.take_if(|bereaved| now.saturating_sub(bereaved.since) >= patience)
    }

    /// From the first death on until all are started again.
    pub fn is_falling(&self) -> bool {
        self.restart_at.is_some()
    }

    pub fn is_due(&self, now: Duration) -> bool {
        self.restart_at.is_some_and(|at| at <= now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(second: u64) -> Duration {
        Duration::from_secs(second)
    }

    #[test]
    fn their_work_is_timed_but_for_the_first_rollout_of_a_start() {
        let mut learner_group = LearnerGroup::new(1);
        let longest = |learner_group: &LearnerGroup| {
            [Work::Collect, Work::Update, Work::Save].map(|work| learner_group.pace.longest(work))
        };
        for start in 0..2 {
            let begin = 1000 * start;
            learner_group.begin(at(begin));
            learner_group.ready(0, at(begin + 5));
            assert_eq!(learner_group.work(), (Work::Collect, true));
            learner_group.collected(at(begin + 50));
            assert_eq!(learner_group.work(), (Work::Update, true));
            if start == 0 {
                assert_eq!(longest(&learner_group), [None; 3], "actors are started meanwhile");
            }
            learner_group.waits(at(begin + 51));
            learner_group.goes_on(at(begin + 52), Work::Collect);
            assert_eq!(learner_group.work(), (Work::Collect, false));
            learner_group.collected(at(begin + 55));
            learner_group.goes_on(at(begin + 56), Work::Save);
            learner_group.goes_on(at(begin + 63), Work::Collect);
            assert_eq!(longest(&learner_group), [Some(at(3)), Some(at(2)), Some(at(7))]);
        }
    }
}
