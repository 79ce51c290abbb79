//! The actions of a task.

use super::channel::Dtype;
use super::error::SpecError;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The actions, as a task declares them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Actions {
    /// One of these: a byte in a record, the index of the name.
    Discrete {
        names: Vec<String>,
        /// Parts of them that a policy may be restricted to, by name, in the order of its head.
        #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
        subsets: BTreeMap<String, Vec<String>>,
    },
    /// Numbers within bounds: 32-bit ones in a record.
    Box {
        /// Least and greatest of each.
        bounds: Vec<[f32; 2]>,
    },
}

impl Actions {
    /// Type and count of an action's numbers.
    pub fn numbers(&self) -> (Dtype, usize) {
        match self {
            Self::Discrete { .. } => (Dtype::U8, 1),
            Self::Box { bounds } => (Dtype::F32, bounds.len()),
        }
    }

    /// Names of the actions; none of numbers.
    pub fn names(&self) -> &[String] {
        match self {
            Self::Discrete { names, .. } => names,
            Self::Box { .. } => &[],
        }
    }

    pub(super) fn check(&self) -> Result<(), SpecError> {
        let wrong = |problem: String| Err(SpecError::Actions { problem });
        match self {
            // 254 is HOLD.
            Self::Discrete { names, .. } if !(1..=254).contains(&names.len()) => {
                wrong("there are 1 to 254 of them".to_owned())
            }
            Self::Discrete { names, subsets } => {
                let is_double = |index: usize| names[..index].contains(&names[index]);
                if let Some(index) = (0..names.len()).find(|&index| is_double(index)) {
                    return wrong(format!("`{}` is there twice", names[index]));
                }
                if subsets.contains_key(ALL) {
                    return wrong(format!("a subset is named `{ALL}`, as all of them are"));
                }
                let strange = subsets.values().flatten().find(|name| !names.contains(name));
                strange.map_or(Ok(()), |name| wrong(format!("a subset has `{name}`, which is none of them")))
            }
            Self::Box { bounds } if !(1..=1024).contains(&bounds.len()) => {
                wrong("a box has 1 to 1024 numbers".to_owned())
            }
            Self::Box { bounds } => {
                let sound = |[least, most]: &[f32; 2]| least < most && least.is_finite() && most.is_finite();
                if bounds.iter().all(sound) {
                    Ok(())
                } else {
                    wrong("a box's bounds are finite, the lower first".to_owned())
                }
            }
        }
    }
}

/// Name of the space of all actions.
pub(super) const ALL: &str = "large";
