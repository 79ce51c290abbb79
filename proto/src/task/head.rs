//! How a policy chooses an action.

use super::actions::Actions;
use super::space::ActionSpace;

/// What a policy's actor gives for an observation, and which action is made of what is chosen from that.
#[derive(Debug, Clone, PartialEq)]
pub enum ActionHead {
    /// Logits of one choice: which of the task's actions each option is.
    Discrete(Vec<u8>),
    /// Logits of several choices, side by side: options of each.
    MultiDiscrete(Vec<usize>),
    /// Means of Gaussians, one a number. What is drawn is kept as it is; an environment is given the nearest number within
    /// these bounds.
    Box(Vec<[f32; 2]>),
}

#[derive(Debug, Clone, PartialEq)]
pub enum PolicyAction {
    /// The option of each choice.
    Options(Vec<i64>),
    /// Numbers, whatever the bounds.
    Numbers(Vec<f32>),
}

impl ActionHead {
    /// That of a policy which may choose from this space; none if the task has no such subset.
    pub fn of(space: ActionSpace, actions: &Actions) -> Option<Self> {
        let named = space.of(actions)?;
        Some(match actions {
            Actions::Discrete { .. } => Self::Discrete(named),
            Actions::MultiDiscrete { .. } => Self::MultiDiscrete(actions.choices()),
            Actions::Box { bounds } => Self::Box(bounds.clone()),
        })
    }

    /// Options of each choice; none where numbers are drawn.
    pub fn choices(&self) -> impl Iterator<Item = usize> {
        let (one, several): (_, &[usize]) = match self {
            Self::Discrete(named) => (Some(named.len()), &[]),
            Self::MultiDiscrete(counts) => (None, counts),
            Self::Box(_) => (None, &[]),
        };
        one.into_iter().chain(several.iter().copied())
    }

    pub fn is_gaussian(&self) -> bool {
        matches!(self, Self::Box(_))
    }

    /// How many numbers the actor gives; as many draws of noise choose an action.
    pub fn outputs(&self) -> usize {
        match self {
            Self::Box(bounds) => bounds.len(),
            Self::Discrete(_) | Self::MultiDiscrete(_) => self.choices().sum(),
        }
    }

    /// Appends the bytes of an action for an environment. Panics if another head chose it.
    pub fn write(&self, chosen: &PolicyAction, bytes: &mut Vec<u8>) {
        match (self, chosen) {
            (Self::Discrete(named), PolicyAction::Options(chosen)) => {
                bytes.extend(chosen.iter().map(|&option| named[option as usize]));
            }
            (Self::MultiDiscrete(_), PolicyAction::Options(chosen)) => {
                // A declaration has fewer options than an i32 can count.
                bytes.extend(chosen.iter().flat_map(|&option| (option as i32).to_ne_bytes()));
            }
            (Self::Box(bounds), PolicyAction::Numbers(drawn)) => {
                let clipped = drawn.iter().zip(bounds).map(|(number, &[least, most])| number.clamp(least, most));
                bytes.extend(clipped.flat_map(f32::to_ne_bytes));
            }
            (head, chosen) => panic!("{head:?} does not choose {chosen:?}"),
        }
    }
}
