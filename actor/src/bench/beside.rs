//! The actor's own environments, driven by another program that measures itself beside them: `make bench-python`.
//!
//! Both take the same actions in the same episodes, in turns of a fraction of a second. So the load of the machine is
//! the same for both, and what they did can be compared.
//!
//! One turn: bytes come in, for each step an action of each environment, or HOLD, which leaves an environment out. A
//! line goes out: processor time of the turn in nanoseconds, and the sum of the state hashes that its actions led to.
//! As in an actor the action that ends an episode begins the next one, and an environment is observed once a step.

use super::clock::processor_time;
use crate::process::kitchens::{Kitchens, homes};
use crate::process::prefetcher::KitchenPrefetcher;
use anyhow::{Context, Result, ensure};
use engine::Environments;
use proto::config::Config;
use proto::kitchen::KitchenId;
use proto::record::HOLD;
use proto::record::RecordHeader;
use std::hint::black_box;
use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use wire::message::{Halves, Line};

/// What is driven, and how.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Where all environments are.
    pub kitchen: KitchenId,
    pub environments: u32,
    pub seed: u64,
    pub steps: u32,
}

/// Takes turns until the input ends.
pub fn run(options: Options, mut input: impl Read, mut output: impl Write) -> Result<()> {
    let Options { kitchen, environments: count, seed, steps } = options;
    let mut config = Config { seed, ..Config::default() };
    config.actors.environments_per_actor = count;
    // Whole frames, as those beside it give.
    config.network.input_pool = 1;
    config.validate()?;
    ensure!(steps > 0, "a turn has a step at least");
    // The kitchens of these environments are not kept in a folder.
    let prefetcher = KitchenPrefetcher::without_thread(&config, Path::new(""));
    let kitchens = Kitchens::of(prefetcher, &config)?;
    let mut environments = Environments::new(kitchens, &homes(Some(kitchen), 0, &config), &config)?;
    let record = vec![Line([0; 64]); config.spec().layout().bytes / size_of::<Line>()];
    let mut slots = vec![record; count as usize];
    let mut actions = vec![0; count as usize * steps as usize];
    loop {
        match input.read_exact(&mut actions) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(()),
            Err(error) => return Err(error).context("cannot read the actions of a turn"),
        }
        let begun = processor_time();
        let mut sum = 0u64;
        for actions in actions.chunks_exact(count as usize) {
            sum = sum.wrapping_add(step(&mut environments, Halves::of(count), actions, &mut slots)?);
        }
        let spent = processor_time().saturating_sub(begun);
        writeln!(output, "{} {sum}", spent.as_nanos())?;
        output.flush()?;
    }
}

/// A step of all environments, half after half as an actor takes it; the sum of the state hashes.
fn step(
    environments: &mut Environments<Kitchens>,
    halves: Halves,
    actions: &[u8],
    slots: &mut [Vec<Line>],
) -> Result<u64> {
    let mut sum = 0u64;
    for half in 0..halves.count() {
        let range = halves.range(half);
        environments.act(range.clone(), &actions[range.clone()], &mut [])?;
        for index in range {
            if actions[index] != HOLD {
                let record = Line::bytes_mut(&mut slots[index]);
                environments.observe(index, record)?;
                sum = sum.wrapping_add(RecordHeader::of(black_box(record)).outcome_hash);
            }
        }
    }
    Ok(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use simulator::robot::action::Action;

    fn sums(actions: &[u8], steps: u32) -> Vec<u64> {
        let kitchen = KitchenId::new(1).unwrap();
        let mut lines = Vec::new();
        run(Options { kitchen, environments: 3, seed: 5, steps }, actions, &mut lines).unwrap();
        let lines = String::from_utf8(lines).unwrap();
        lines.lines().map(|line| line.split_once(' ').unwrap().1.parse().unwrap()).collect()
    }

    #[test]
    fn turns_add_up_and_a_held_environment_counts_nothing() {
        let (turn, done) = (Action::RotateLeftContinuous.index(), Action::DoneMidLevel.index());
        let (first, second, held) = ([turn, turn, done], [turn, done, turn], [turn, HOLD, turn]);
        let apart = sums(&[first, second].concat(), 1);
        assert_eq!(apart.len(), 2);
        assert_eq!(sums(&[first, second].concat(), 2), [apart[0].wrapping_add(apart[1])]);
        let without = sums(&[first, held].concat(), 1);
        assert_eq!(without[0], apart[0]);
        assert_ne!(without[1], apart[1]);
        // Half a turn at the end is none.
        assert_eq!(sums(&[first, second].concat()[..5], 1), apart[..1]);
    }
}
