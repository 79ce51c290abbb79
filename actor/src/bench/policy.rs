//! Where the actions of a measurement come from.

use crate::environment::Environment;
use proto::action::{Action, ActionSpace};
use proto::episode::EnvironmentId;
use proto::random::{Key, Purpose};
use std::fmt;
use std::str::FromStr;

/// Seed of the random policy.
const SEED: u64 = 1;

/// Who plays.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PolicyKind {
    /// Every action equally likely but Done, so that episodes last.
    Random,
}

impl PolicyKind {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 1] = [Self::Random];

    /// Its name, on the command line and in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Random => "random",
        }
    }
}

impl fmt::Display for PolicyKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for PolicyKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|kind| kind.name()).collect();
            format!("there is no policy `{text}`; there is {}", names.join(", "))
        })
    }
}

/// A source of actions for one environment.
pub trait Policy {
    /// The next action in this state; `episode` and `step` count from 0.
    fn next(&mut self, environment: &Environment, episode: u32, step: u32) -> Action;
}

/// A source of actions of this kind for the environment with this identity.
pub fn policy(kind: PolicyKind, id: EnvironmentId) -> Box<dyn Policy> {
    match kind {
        PolicyKind::Random => Box::new(Random { id }),
    }
}

/// Actions from counter-based noise: the same on every machine, whatever happens in the kitchen.
struct Random {
    id: EnvironmentId,
}

impl Policy for Random {
    fn next(&mut self, _: &Environment, episode: u32, step: u32) -> Action {
        let key = Key {
            seed: SEED,
            purpose: Purpose::RandomPolicy,
            kitchen: self.id.kitchen.number(),
            environment: self.id.number,
            episode,
            step,
        };
        let actions = ActionSpace::Large.actions();
        let lasting = actions.iter().filter(|&&action| action != Action::DoneMidLevel).count();
        let action = actions[key.stream().below(lasting as u32) as usize];
        assert!(action != Action::DoneMidLevel, "Done is the last of all actions");
        action
    }
}
