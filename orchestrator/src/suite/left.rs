//! What is left of a suite whose other runs are in a table already.

use super::file::Suite;
use std::collections::BTreeSet;

impl Suite {
    pub fn leave_out(&mut self, done: &BTreeSet<&str>) {
        let mut kept = vec![false; self.entries.len()];
        for (index, entry) in self.entries.iter().enumerate().rev() {
            kept[index] |= !done.contains(entry.name.as_str());
            if let (true, Some(from)) = (kept[index], entry.from) {
                kept[from] = true;
            }
        }
        let number = |old: usize| kept[..old].iter().filter(|kept| **kept).count();
        for entry in &mut self.entries {
            entry.from = entry.from.map(number);
        }
        let mut is_kept = kept.iter();
        self.entries.retain(|_| is_kept.next() == Some(&true));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_table_has_is_left_out_unless_another_begins_with_it() {
        let first = "[[runs]]\npreset = \"short-r-only\"\nname = \"stage-1\"\n";
        let second = "[[runs]]\npreset = \"short-scratch\"\nname = \"stage-2\"\nfrom = \"stage-1\"\n";
        let whole = Suite::parse(&format!("seeds = [1, 2]\n{first}{second}")).unwrap();
        let left = |done: &[&str]| {
            let mut suite = whole.clone();
            suite.leave_out(&done.iter().copied().collect());
            suite.entries.into_iter().map(|entry| (entry.name, entry.from)).collect::<Vec<_>>()
        };
        let named = |name: &str, from| (name.to_owned(), from);
        let all = [("stage-1-1", None), ("stage-1-2", None), ("stage-2-1", Some(0)), ("stage-2-2", Some(1))];
        assert_eq!(left(&[]), all.map(|(name, from)| named(name, from)));
        assert_eq!(
            left(&["stage-1-1", "stage-2-1", "stage-1-2"]),
            [named("stage-1-2", None), named("stage-2-2", Some(0))]
        );
        assert_eq!(left(&["stage-1-1", "stage-1-2", "stage-2-1", "stage-2-2"]), []);
    }
}
