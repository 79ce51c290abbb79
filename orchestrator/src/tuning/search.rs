//! What to try next: environments of an actor, cores, and the length of a rollout, one after the other, each with the
//! best of what was found before. Pure.

use proto::event::Timing;

/// More environments, or a longer rollout, must bring at least this much: they make larger batches, of which fewer fit
/// into a run.
const WORTH: f64 = 1.03;
/// Most environments of an actor.
const MOST: u32 = 256;

/// One shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choice {
    /// Environments of an actor.
    pub environments: u32,
    /// Steps of a rollout.
    pub steps: u32,
    /// Whether processes are held to cores.
    pub pinned: bool,
}

/// How fast a shape is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speed {
    /// Frames a second.
    pub frames_per_s: f64,
    /// Where the time went.
    pub timing: Timing,
}

/// A shape that was tried; the reason, where it does not work.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// The shape.
    pub choice: Choice,
    /// What came out.
    pub result: Result<Speed, String>,
}

/// The search.
#[derive(Debug)]
pub struct Search {
    /// Where it begins.
    start: Choice,
    /// Lengths of a rollout to choose from, besides the start's.
    steps: Vec<u32>,
    /// All that was tried, in order.
    pub tried: Vec<Tried>,
}

impl Search {
    /// Begins with the shape of a configuration.
    pub fn new(start: Choice, steps: Vec<u32>) -> Self {
        Self { start, steps, tried: vec![] }
    }

    /// The next shape to try; none when all is known.
    pub fn next(&self) -> Option<Choice> {
        self.walk().err()
    }

    /// The best of what was tried; none if nothing worked.
    pub fn best(&self) -> Option<Choice> {
        let untried = match self.walk() {
            Ok(best) => return self.speed(best).map(|_| best),
            Err(untried) => untried,
        };
        // Cut short: the walk's last good place is the fastest of what was tried on the way to what was not.
        let worked = self.tried.iter().filter(|tried| tried.choice != untried && tried.result.is_ok());
        let rate = |tried: &&Tried| tried.result.as_ref().map_or(0.0, |speed| speed.frames_per_s);
        worked.max_by(|left, right| rate(left).total_cmp(&rate(right))).map(|tried| tried.choice)
    }

    /// How fast a shape is; none if it was not tried or does not work.
    pub fn speed(&self, choice: Choice) -> Option<f64> {
        let tried = self.tried.iter().find(|tried| tried.choice == choice)?;
        tried.result.as_ref().ok().map(|speed| speed.frames_per_s)
    }

    /// The best shape, or the first one on the way to it that was not tried.
    fn walk(&self) -> Result<Choice, Choice> {
        let mut at = self.start;
        self.known(at)?;
        // Environments: twice as many as long as that pays; if it never does, half as many as long as that does.
        let more =
            |at: Choice| Some(Choice { environments: at.environments * 2, ..at }).filter(|it| it.environments <= MOST);
        let fewer = |at: Choice| {
            let half = Choice { environments: at.environments / 2, ..at };
            (at.environments.is_multiple_of(2)).then_some(half)
        };
        at = self.climb(at, more, WORTH)?;
        if at == self.start {
            at = self.climb(at, fewer, 1.0)?;
        }
        let other = Choice { pinned: !at.pinned, ..at };
        at = self.faster(at, other, 1.0)?;
        let here = at;
        for &steps in self.steps.iter().filter(|&&steps| steps != here.steps) {
            let worth = if steps > at.steps { WORTH } else { 1.0 };
            at = self.faster(at, Choice { steps, ..here }, worth)?;
        }
        Ok(at)
    }

    /// Goes on as long as the next shape is faster.
    fn climb(&self, mut at: Choice, next: impl Fn(Choice) -> Option<Choice>, worth: f64) -> Result<Choice, Choice> {
        while let Some(further) = next(at) {
            let better = self.faster(at, further, worth)?;
            if better == at {
                break;
            }
            at = better;
        }
        Ok(at)
    }

    /// The one of two shapes to stay with: the other one if it is `worth` times as fast.
    fn faster(&self, at: Choice, other: Choice, worth: f64) -> Result<Choice, Choice> {
        self.known(other)?;
        let [here, there] = [at, other].map(|choice| self.speed(choice).unwrap_or(0.0));
        Ok(if there > here * worth { other } else { at })
    }

    /// An error with the shape if it was not tried.
    fn known(&self, choice: Choice) -> Result<(), Choice> {
        if self.tried.iter().any(|tried| tried.choice == choice) { Ok(()) } else { Err(choice) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn choice(environments: u32, steps: u32, pinned: bool) -> Choice {
        Choice { environments, steps, pinned }
    }

    /// Tries all that the search wants on a machine of this speed; 0 = it does not work there.
    fn explore(
        start: Choice,
        steps: &[u32],
        most: usize,
        speed: impl Fn(Choice) -> f64,
    ) -> (Vec<Choice>, Option<Choice>) {
        let mut search = Search::new(start, steps.to_vec());
        while let Some(choice) = search.next().filter(|_| search.tried.len() < most) {
            let frames_per_s = speed(choice);
            let timing = Timing::default();
            let result = if frames_per_s > 0.0 { Ok(Speed { frames_per_s, timing }) } else { Err("no".to_owned()) };
            search.tried.push(Tried { choice, result });
        }
        (search.tried.iter().map(|tried| tried.choice).collect(), search.best())
    }

    #[test]
    fn environments_double_while_it_pays_then_cores_then_lengths() {
        let speed = |Choice { environments, steps, pinned }| {
            let base = f64::from(environments.min(32)) * 100.0 + f64::from(environments);
            base * if pinned { 1.01 } else { 1.0 } * if steps == 64 { 1.1 } else { 1.0 }
        };
        let (tried, best) = explore(choice(8, 32, false), &[32, 64, 128], 99, speed);
        let expected = [
            choice(8, 32, false),
            choice(16, 32, false),
            choice(32, 32, false),
            choice(64, 32, false),
            choice(32, 32, true),
            choice(32, 64, true),
            choice(32, 128, true),
        ];
        assert_eq!(tried, expected);
        assert_eq!(best, Some(choice(32, 64, true)));
    }

    #[test]
    fn where_more_does_not_pay_fewer_are_tried() {
        let (tried, best) = explore(choice(4, 16, false), &[], 99, |it| 1000.0 / f64::from(it.environments.max(2)));
        assert_eq!(tried.iter().map(|it| it.environments).collect::<Vec<_>>(), [4, 8, 2, 1, 2]);
        assert_eq!(best, Some(choice(2, 16, false)), "as fast as with one, and not held to cores for nothing");
    }

    #[test]
    fn what_does_not_work_is_not_chosen_and_a_search_can_be_cut_short() {
        let (_, best) = explore(choice(8, 32, true), &[], 99, |it| if it.environments > 8 { 0.0 } else { 100.0 });
        assert_eq!(best, Some(choice(8, 32, true)));
        assert_eq!(explore(choice(8, 32, false), &[], 99, |_| 0.0).1, None);
        let (tried, best) = explore(choice(8, 32, false), &[], 2, |it| f64::from(it.environments));
        assert_eq!((tried.len(), best), (2, Some(choice(16, 32, false))));
        assert_eq!(explore(choice(8, 32, false), &[], 0, |_| 1.0).1, None);
    }
}
