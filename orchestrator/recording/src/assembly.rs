use super::declared::Declared;
use super::form::Told;
use proto::episode::EnvironmentId;
use proto::replay::RecordedEpisode;
use proto::task::Sums;
use std::cmp::Ordering;

/// Incarnations of orchestrator and learner: the higher one is the newer.
pub type Generation = (u32, u32);

/// The messages of an episode's steps, and that of its start.
#[derive(Debug, Default)]
pub struct Kept {
    pub start: Option<Told>,
    pub steps: Vec<Told>,
}

#[derive(Debug, Default)]
pub struct Assembly {
    pub generation: Generation,
    pub config: usize,
    pub start_hash: Option<u64>,
    pub start: Vec<u32>,
    pub actions: Vec<u8>,
    pub hashes: Vec<u64>,
    pub digests: Vec<u32>,
    /// The first step that is not there though later ones are.
    pub gap: Option<usize>,
    /// A file under another configuration goes on with it: the one, from this step on.
    pub moved_to: Option<(usize, usize)>,
    /// Its messages, where they are asked for.
    pub kept: Option<Kept>,
    last: Option<Told>,
    /// What all steps add up to, if one start of the programs recorded them all.
    sums: Option<Sums>,
    end: Option<Told>,
}

impl Assembly {
    /// One that keeps the messages, too.
    pub fn keeping() -> Self {
        Self { kept: Some(Kept::default()), ..Self::default() }
    }

    pub fn step(&mut self, declared: &Declared, told: Told) {
        let (generation, step) = (told.engine.whose().1, told.engine.step as usize);
        if !self.is_current(declared, generation, step) {
            return;
        }
        match step.cmp(&self.hashes.len()) {
            Ordering::Equal => {
                if step == 0 {
                    self.sums = Some(declared.nothing());
                }
                if let Some(sums) = &mut self.sums {
                    declared.add(sums, &told);
                }
                self.actions.extend_from_slice(&told.record[declared.spec.layout().action.range()]);
                self.hashes.push(told.engine.state_hash);
                let seen = told.seen.then_some(&*told.record);
                declared.compared.step(seen, &told.record, &told.rewards, told.engine.end(), &mut self.digests);
                if let Some(kept) = &mut self.kept {
                    kept.steps.push(told.clone());
                }
                self.last = Some(told);
            }
            Ordering::Greater => drop(self.gap.get_or_insert(self.hashes.len())),
            // Recorded twice under the same learner: a segment was given twice.
            Ordering::Less => {}
        }
    }

    pub fn recorded(self, environment: EnvironmentId, episode: u32) -> RecordedEpisode {
        let Self { start_hash, start, actions, hashes, digests, .. } = self;
        RecordedEpisode { environment, episode, start_hash, actions, hashes, digests, start }
    }

    pub fn begin(&mut self, declared: &Declared, start: &Told) {
        self.start_hash = Some(start.engine.state_hash);
        self.start = declared.compared.start(&start.record);
        if let Some(kept) = &mut self.kept {
            kept.start = Some(start.clone());
        }
    }

    pub fn end(&mut self, declared: &Declared, end: Told) {
        if self.is_current(declared, end.engine.whose().1, end.engine.length as usize) {
            self.end = Some(end);
        }
    }

    /// Whether a step counts: not if a newer learner has gone on from an earlier point, and that has been read already.
    /// A newer one voids what an older one did from here on.
    fn is_current(&mut self, declared: &Declared, generation: Generation, step: usize) -> bool {
        if generation > self.generation {
            self.generation = generation;
            if self.hashes.len() > step {
                self.last = None;
            }
            self.actions.truncate(step * declared.spec.layout().action.range().len());
            self.hashes.truncate(step);
            if let Some(kept) = &mut self.kept {
                kept.steps.truncate(step);
            }
            self.digests.truncate(step * declared.compared.count());
            (self.gap, self.moved_to, self.end, self.sums) = (None, None, None, None);
        }
        generation == self.generation
    }

    pub fn has_ended(&self) -> bool {
        self.end.is_some() || self.last.as_ref().is_some_and(|last| last.engine.end().is_some())
    }

    /// What is missing of the episode, or contradicts itself. `goes_on`: a later one of its environment was recorded.
    pub fn fault(&self, declared: &Declared, goes_on: bool) -> Option<String> {
        let got = self.hashes.len();
        if let Some(gap) = self.gap {
            return Some(format!("step {gap} is missing, and what comes after it cannot be replayed"));
        }
        let Some(end) = &self.end else {
            return match (self.has_ended(), goes_on) {
                (true, _) => Some("its message on /episode/end is missing".to_owned()),
                (false, true) => Some(format!("its steps from {got} on and its end are missing")),
                (false, false) => None,
            };
        };
        let length = end.engine.length as usize;
        match got.cmp(&length) {
            Ordering::Less => {
                return Some(format!("{} of its {length} steps are missing at its end", length - got));
            }
            Ordering::Greater => return Some(format!("it has {got} steps, but /episode/end says {length}")),
            Ordering::Equal => {}
        }
        let last = self.last.as_ref()?;
        let differing = differing(declared, end, last, self.sums.as_ref());
        (!differing.is_empty()).then(|| format!("/episode/end contradicts its steps: {}", differing.join(", ")))
    }
}

fn differing(declared: &Declared, end: &Told, last: &Told, sums: Option<&Sums>) -> Vec<String> {
    let mut own = end.clone();
    declared.close(sums, last, &mut own);
    let returns = declared.compared.rewards().map(|name| format!("return_{name}"));
    let metrics = declared.spec.metrics.iter().map(|metric| metric.name.clone());
    let numbers = end.returns.iter().zip(&own.returns).chain(end.metrics.iter().zip(&own.metrics));
    // A recorder or reader that did not see all of the episode knows some of them alone.
    let is_whole = sums.is_some() && end.returns.first().is_some_and(Option::is_some);
    let differ = |(recorded, own): (&Option<f64>, &Option<f64>)| match (recorded, own) {
        (Some(recorded), Some(own)) => recorded.to_bits() != own.to_bits(),
        (recorded, own) => is_whole && recorded.is_some() != own.is_some(),
    };
    let ends = [
        ("terminated", end.engine.terminated != last.engine.terminated),
        ("truncated", end.engine.truncated != last.engine.truncated),
    ];
    let ends = ends.into_iter().filter(|(_, differ)| *differ).map(|(name, _)| name.to_owned());
    let numbers = returns.chain(metrics).zip(numbers).filter(|(_, pair)| differ(*pair)).map(|(name, _)| name);
    ends.chain(numbers).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proto::config::Config;
    use std::sync::LazyLock;

    static ARM: LazyLock<Declared> = LazyLock::new(|| Declared::of(&Config::default()).unwrap());

    fn taken(learner: u32, step: usize, action: u8, hash: u64) -> Told {
        let mut told = ARM.forms.step.empty.clone();
        told.record[ARM.spec.layout().action.offset] = action;
        (told.engine.learner_incarnation, told.engine.step, told.engine.state_hash) = (learner, step as u32, hash);
        // What was seen tells steps apart by their digests, too.
        told.seen = true;
        told.record[ARM.spec.layout().seen.start] = action;
        told
    }

    proptest! {
        /// A reference by brute force: of every step, the newest generation counts, and nothing older lies beyond
        /// the newest generation's last step.
        #[test]
        fn rewinds_leave_what_the_newest_learner_did(
            runs in prop::collection::vec((0usize..12, 1usize..12), 1..6),
        ) {
            let mut assembly = Assembly::default();
            let mut reference: Vec<Told> = Vec::new();
            for (generation, (back, length)) in runs.iter().enumerate() {
                let from = reference.len().saturating_sub(*back);
                reference.truncate(from);
                for step in from..from + length {
                    let (action, hash) = ((generation * 3 + step) as u8, (generation * 1000 + step) as u64);
                    let told = taken(generation as u32 + 1, step, action, hash);
                    reference.push(told.clone());
                    assembly.step(&ARM, told);
                }
            }
            prop_assert!(assembly.gap.is_none());
            let mut alone = Assembly::default();
            for mut told in reference {
                told.engine.learner_incarnation = 0;
                alone.step(&ARM, told);
            }
            prop_assert_eq!((assembly.actions, assembly.hashes), (alone.actions, alone.hashes));
            prop_assert_eq!(assembly.digests, alone.digests);
        }
    }

    #[test]
    fn a_hole_ends_an_episode_and_a_rewind_mends_it() {
        let mut assembly = Assembly::default();
        for step in [0, 1, 3, 4] {
            assembly.step(&ARM, taken(1, step, step as u8, 0));
        }
        assert_eq!(assembly.gap, Some(2));
        assert!(assembly.fault(&ARM, false).unwrap().starts_with("step 2 is missing"));
        assert_eq!(assembly.actions, [0, 1]);
        for step in [1, 2, 3] {
            assembly.step(&ARM, taken(2, step, 10 + step as u8, 0));
        }
        assert!(assembly.gap.is_none());
        assert_eq!(assembly.actions, [0, 11, 12, 13]);
    }

    /// An episode of three steps and its end, all in agreement.
    fn ended() -> (Vec<Told>, Told) {
        let mut sums = ARM.nothing();
        let steps: Vec<Told> = [0.25f32, -0.5, 10.0]
            .into_iter()
            .enumerate()
            .map(|(step, reward)| {
                let mut told = taken(1, step, 0, 0);
                told.rewards.iter_mut().for_each(|one| *one = reward);
                told.engine.terminated = step == 2;
                ARM.add(&mut sums, &told);
                told
            })
            .collect();
        let mut end = ARM.forms.end.empty.clone();
        (end.engine.learner_incarnation, end.engine.length, end.engine.terminated) = (1, 3, true);
        ARM.close(Some(&sums), &steps[2], &mut end);
        assert!(end.returns.iter().all(|&sum| sum == Some(9.75)));
        // The target is never picked up.
        let unknown = ARM.spec.metrics.iter().zip(&end.metrics).filter(|(_, number)| number.is_none());
        assert_eq!(unknown.map(|(metric, _)| &*metric.name).collect::<Vec<_>>(), ["pickup_step"]);
        (steps, end)
    }

    #[test]
    fn every_field_of_an_end_is_compared_with_the_steps() {
        let (steps, end) = ended();
        let fault_of = |end: Told| {
            let mut assembly = Assembly::default();
            for told in &steps {
                assembly.step(&ARM, told.clone());
            }
            assembly.end(&ARM, end);
            assembly.fault(&ARM, true)
        };
        assert_eq!(fault_of(end.clone()), None);
        let fault = |wrong: Told, names: &str| {
            assert_eq!(fault_of(wrong), Some(format!("/episode/end contradicts its steps: {names}")));
        };
        for (at, name) in ARM.compared.rewards().enumerate() {
            let mut wrong = end.clone();
            wrong.returns[at] = Some(9.5);
            fault(wrong, &format!("return_{name}"));
        }
        for (at, metric) in ARM.spec.metrics.iter().enumerate() {
            let mut wrong = end.clone();
            wrong.metrics[at] = Some(wrong.metrics[at].map_or(0.5, |number| 0.5 - number));
            fault(wrong, &metric.name);
        }
        let mut wrong = end.clone();
        (wrong.engine.terminated, wrong.engine.truncated) = (false, true);
        fault(wrong, "terminated, truncated");
    }
}
