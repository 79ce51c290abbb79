//! What has happened so far.

use crate::fault::{Fate, Fault};
use std::collections::BTreeMap;

/// Counts of faults by class and fate.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    counts: BTreeMap<(&'static str, Fate), u64>,
}

impl Tally {
    pub fn add(&mut self, fault: Fault, fate: Fate) {
        *self.counts.entry((fault.class(), fate)).or_default() += 1;
    }

    /// Counts all of another one.
    pub fn absorb(&mut self, other: &Self) {
        for (&key, count) in &other.counts {
            *self.counts.entry(key).or_default() += count;
        }
    }

    pub fn total(&self, fate: Fate) -> u64 {
        self.counts.iter().filter(|((_, one), _)| *one == fate).map(|(_, count)| count).sum()
    }

    /// A line for each class.
    pub fn lines(&self) -> Vec<String> {
        let mut classes: Vec<&str> = self.counts.keys().map(|(class, _)| *class).collect();
        classes.dedup();
        let of = |class, fate| self.counts.get(&(class, fate)).copied().unwrap_or(0);
        let line = |class: &&'static str| {
            let [landed, missed, skipped] = [Fate::Landed, Fate::Missed, Fate::Skipped].map(|fate| of(*class, fate));
            format!("{class:28} {landed:4} happened  {missed:4} missed  {skipped:4} skipped")
        };
        classes.iter().map(line).collect()
    }
}
