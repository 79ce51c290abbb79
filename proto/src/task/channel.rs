//! A channel: one named array of numbers that an environment reports at every step.

use super::error::SpecError;
use serde::{Deserialize, Serialize};
use std::fmt;

/// What a channel is for. What an action did comes before what is seen now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Part of rewards, of the last action: a scalar `f32`.
    Part,
    /// What else the last action led to.
    Outcome,
    /// What the policy may be given.
    Observation,
    /// Numbers that the critic alone is given: nothing that acts needs them.
    Privileged,
    /// Of each option of the actions, whether it may be chosen now: 1 or 0. Of several choices, side by side.
    Mask,
    /// For viewers and recordings alone.
    State,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dtype {
    U8,
    U16,
    I32,
    U32,
    U64,
    F32,
    F64,
}

/// The number of this type that bytes begin with.
macro_rules! number {
    ($type:ty, $bytes:expr) => {
        <$type>::from_ne_bytes($bytes[..size_of::<$type>()].try_into().expect("as long as the type"))
    };
}

/// As `NumPy` calls it.
impl fmt::Display for Dtype {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::I32 => "int32",
            Self::U32 => "uint32",
            Self::U64 => "uint64",
            Self::F32 => "float32",
            Self::F64 => "float64",
        })
    }
}

impl Dtype {
    /// Size of a number, and its alignment.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::U64 | Self::F64 => 8,
        }
    }

    /// The bits of the number in these bytes. A negative whole number has those of an `i64`. Panics if there are fewer
    /// bytes than one number has.
    pub fn bits(self, bytes: &[u8]) -> u64 {
        match self {
            Self::U8 => bytes[0].into(),
            Self::U16 => number!(u16, bytes).into(),
            Self::I32 => i64::from(number!(i32, bytes)).cast_unsigned(),
            Self::U32 | Self::F32 => number!(u32, bytes).into(),
            Self::U64 | Self::F64 => number!(u64, bytes),
        }
    }

    /// Writes the number with these bits; false if this type has none. Panics as [`Self::bits`] does.
    pub fn write(self, bits: u64, bytes: &mut [u8]) -> bool {
        bytes[..self.bytes()].copy_from_slice(&bits.to_le_bytes()[..self.bytes()]);
        self.bits(bytes) == bits
    }

    /// The number in these bytes, as a double: exact but for whole numbers beyond 2^53. Panics if there are fewer bytes
    /// than one number has.
    pub fn read(self, bytes: &[u8]) -> f64 {
        match self {
            Self::U8 => number!(u8, bytes).into(),
            Self::U16 => number!(u16, bytes).into(),
            Self::I32 => number!(i32, bytes).into(),
            Self::U32 => number!(u32, bytes).into(),
            Self::U64 => number!(u64, bytes) as f64,
            Self::F32 => number!(f32, bytes).into(),
            Self::F64 => number!(f64, bytes),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Channel {
    /// Letters, digits and underscores; a unit is its last word.
    pub name: String,
    pub role: Role,
    pub dtype: Dtype,
    /// Empty: a scalar.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shape: Vec<usize>,
    /// SI unit, e.g. `m`; empty: a pure number.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Least and greatest number; others are refused on arrival.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// The only numbers that there are, e.g. `[0, 1]`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<f64>,
    /// Of a whole number that stands for one of these.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
    /// Of an image: a record may hold the sums of its windows of this side in its place, for a network that averages over
    /// them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sums: Option<usize>,
    /// Of a place that is to be reached: how near is enough on each axis, for pictures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f32>,
    /// Of an environment of the user's that observes a dictionary: where it lies there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub key: Option<String>,
    pub doc: String,
}

impl Channel {
    /// Its name without its unit.
    pub fn bare_name(&self) -> &str {
        let unit = self.name.strip_suffix(&*self.unit).filter(|_| !self.unit.is_empty());
        unit.and_then(|name| name.strip_suffix('_')).unwrap_or(&self.name)
    }

    pub fn count(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether it is an image of whole numbers. All of them are sound, so they are not copied before they are read.
    pub fn is_bulk(&self) -> bool {
        matches!(self.dtype, Dtype::U8 | Dtype::U16) && self.shape.len() >= 2
    }

    /// Whether it belongs to the last action, not to what is seen now.
    pub fn is_of_action(&self) -> bool {
        matches!(self.role, Role::Part | Role::Outcome)
    }

    pub(super) fn bounds(&self) -> Option<[f64; 2]> {
        if self.role == Role::Mask {
            return Some([0.0, 1.0]);
        }
        if self.names.is_empty() { self.range } else { Some([0.0, self.names.len() as f64 - 1.0]) }
    }

    /// Where an environment cannot be restored, an action that was lost leaves zeros.
    pub(super) fn check_nothing(&self) -> Result<(), SpecError> {
        let in_range = self.bounds().is_none_or(|[least, most]| least <= 0.0 && most >= 0.0);
        if !self.is_of_action() || in_range && (self.values.is_empty() || self.values.contains(&0.0)) {
            return Ok(());
        }
        let problem =
            "of an environment that cannot be restored, what an action did can be 0: so it is where one is lost";
        Err(SpecError::Channel { name: self.name.clone(), problem })
    }

    pub(super) fn check(&self) -> Result<(), SpecError> {
        let wrong = |problem| Err(SpecError::Channel { name: self.name.clone(), problem });
        let whole = !matches!(self.dtype, Dtype::F32 | Dtype::F64);
        // A gigabyte a step would be a mistake.
        let numbers = self.shape.iter().try_fold(1usize, |product, &side| product.checked_mul(side));
        if !numbers.is_some_and(|numbers| (1..=1 << 27).contains(&numbers)) {
            return wrong("its shape has no numbers, or more than 2^27");
        }
        if self.role == Role::Part && (self.dtype != Dtype::F32 || !self.shape.is_empty()) {
            return wrong("a part of rewards is a scalar f32");
        }
        if self.role == Role::Privileged && self.is_bulk() {
            return wrong("the critic alone is given numbers, and no image");
        }
        if self.is_bulk() && (self.range.is_some() || !self.values.is_empty() || !self.names.is_empty()) {
            return wrong(
                "an image of whole numbers is not checked on arrival: it has neither range, values nor names",
            );
        }
        if !self.names.is_empty() && !whole {
            return wrong("only a whole number stands for one of some names");
        }
        let given = [self.range.is_some(), !self.values.is_empty(), !self.names.is_empty()];
        if self.role == Role::Mask && given.contains(&true) {
            return wrong("the numbers of a mask are 0 and 1: it has neither range, values nor names");
        }
        if given.into_iter().filter(|&given| given).count() > 1 {
            return wrong("range, values and names exclude each other");
        }
        if !whole && !given.contains(&true) {
            return wrong("a floating-point number has a range: no other numbers are trained on");
        }
        // Written so that NaN is refused, too.
        if self.range.is_some_and(|[least, most]| !(least <= most && least.is_finite() && most.is_finite())) {
            return wrong("its range is not two finite numbers, the lower first");
        }
        if self.tolerance.is_some_and(|tolerance| !(tolerance >= 0.0 && tolerance.is_finite())) {
            return wrong("its tolerance is a finite number of 0 or more");
        }
        let windows = |side: usize| {
            let fits = |length: &usize| side > 1 && length.is_multiple_of(side);
            self.dtype == Dtype::U16 && self.shape.len() == 2 && self.shape.iter().all(fits)
        };
        if self.sums.is_some_and(|side| !windows(side)) {
            return wrong("sums are of an image of u16 with two dimensions, which are multiples of the windows' side");
        }
        Ok(())
    }
}
