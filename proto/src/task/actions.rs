use super::channel::Dtype;
use super::error::SpecError;
use crate::record::HOLD;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

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
    /// A choice in each of several places: 32-bit numbers in a record, each from 0 to below its count.
    MultiDiscrete { counts: Vec<u32> },
    /// Numbers within bounds: 32-bit ones in a record.
    Box { bounds: Vec<[f32; 2]> },
}

impl Actions {
    /// Type and count of an action's numbers.
    pub fn numbers(&self) -> (Dtype, usize) {
        match self {
            Self::Discrete { .. } => (Dtype::U8, 1),
            Self::MultiDiscrete { counts } => (Dtype::I32, counts.len()),
            Self::Box { bounds } => (Dtype::F32, bounds.len()),
        }
    }

    pub fn bytes(&self) -> usize {
        let (dtype, count) = self.numbers();
        dtype.bytes() * count
    }

    /// Names of the actions; none of numbers.
    pub fn names(&self) -> &[String] {
        match self {
            Self::Discrete { names, .. } => names,
            Self::MultiDiscrete { .. } | Self::Box { .. } => &[],
        }
    }

    /// The bytes in place of an action for an environment that stands still: see [`HOLD`]. No action has them: as numbers
    /// they are -1, or none.
    pub fn hold(&self) -> Vec<u8> {
        match self {
            Self::Discrete { .. } => vec![HOLD],
            Self::MultiDiscrete { .. } | Self::Box { .. } => vec![u8::MAX; self.bytes()],
        }
    }

    /// Options of each choice; none of numbers.
    pub fn choices(&self) -> Vec<usize> {
        match self {
            Self::Discrete { names, .. } => vec![names.len()],
            Self::MultiDiscrete { counts } => counts.iter().map(|&count| count as usize).collect(),
            Self::Box { .. } => vec![],
        }
    }

    /// Whether a mask, one byte an option, allows an action that is one of them.
    pub fn allows(&self, mask: &[u8], action: &[u8]) -> bool {
        let (dtype, _) = self.numbers();
        let mut rest = mask;
        self.choices().into_iter().zip(action.chunks_exact(dtype.bytes())).all(|(options, option)| {
            let own = rest.split_off(..options).unwrap_or_default();
            own.get(dtype.read(option) as usize) == Some(&1)
        })
    }

    /// Whether these bytes are one of them.
    pub fn has(&self, action: &[u8]) -> bool {
        let (dtype, _) = self.numbers();
        let mut numbers = action.chunks_exact(dtype.bytes()).map(|bytes| dtype.read(bytes));
        action.len() == self.bytes()
            && match self {
                Self::Discrete { names, .. } => numbers.all(|number| number < names.len() as f64),
                Self::MultiDiscrete { counts } => {
                    numbers.zip(counts).all(|(number, &count)| (0.0..f64::from(count)).contains(&number))
                }
                Self::Box { bounds } => numbers.zip(bounds).all(|(number, &[least, most])| {
                    // False of NaN, too.
                    (f64::from(least)..=f64::from(most)).contains(&number)
                }),
            }
    }

    /// These bytes for people: a number, or a list of some.
    pub fn text(&self, action: &[u8]) -> String {
        let (dtype, _) = self.numbers();
        let numbers: Vec<f64> = action.chunks_exact(dtype.bytes()).map(|bytes| dtype.read(bytes)).collect();
        match (self, &numbers[..]) {
            (Self::Discrete { .. }, [number]) => number.to_string(),
            (_, numbers) => format!("{numbers:?}"),
        }
    }

    /// What there is, as a few words; equal for those that an environment of a run may have.
    pub fn summary(&self) -> String {
        match self {
            Self::Discrete { names, .. } => format!("{} actions", names.len()),
            Self::MultiDiscrete { counts } => format!("actions of choices among {counts:?}"),
            Self::Box { bounds } => format!("actions of {} numbers within {bounds:?}", bounds.len()),
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
            Self::MultiDiscrete { counts } => {
                let options = counts.iter().try_fold(0u32, |sum, &count| sum.checked_add(count));
                if counts.is_empty() || counts.contains(&0) || options.is_none_or(|options| options > NUMBERS_MOST) {
                    return wrong(format!("each choice has options, 1 to {NUMBERS_MOST} in all"));
                }
                Ok(())
            }
            Self::Box { bounds } if !(1..=NUMBERS_MOST as usize).contains(&bounds.len()) => {
                wrong(format!("a box has 1 to {NUMBERS_MOST} numbers"))
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

/// Options of all choices of an action, or numbers of a box, at most: so many outputs has a policy.
pub const NUMBERS_MOST: u32 = 1024;

/// Name of the space of all actions.
pub(super) const ALL: &str = "large";
