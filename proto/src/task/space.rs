use super::actions::{ALL, Actions};
use super::spec::Spec;
use serde::{Deserialize, Deserializer, Serialize, de};
use std::fmt;

/// Which of a task's actions a policy may choose from: `large`, all of them, or a subset that the task names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
pub struct ActionSpace(&'static str);

impl ActionSpace {
    /// That of a name; none if no task that is built in has one.
    pub fn named(name: &str) -> Option<Self> {
        Self::all().find(|space| space.0 == name)
    }

    pub fn name(self) -> &'static str {
        self.0
    }

    /// Its actions, in the order of a policy's head, if they have names; none if the task has no such subset.
    pub fn of(self, actions: &Actions) -> Option<Vec<u8>> {
        let all = actions.names();
        let subset = match actions {
            _ if self.0 == ALL => all,
            Actions::Discrete { subsets, .. } => subsets.get(self.0)?,
            Actions::MultiDiscrete { .. } | Actions::Box { .. } => return None,
        };
        let index = |name: &String| all.iter().position(|other| other == name).map(|index| index as u8);
        subset.iter().map(index).collect()
    }

    /// All that tasks which are built in have.
    pub fn all() -> impl Iterator<Item = Self> {
        let subsets = Spec::built_in().iter().flat_map(|spec| match &spec.actions {
            Actions::Discrete { subsets, .. } => subsets.keys().map(|name| Self(name)).collect(),
            Actions::MultiDiscrete { .. } | Actions::Box { .. } => vec![],
        });
        std::iter::once(Self::default()).chain(subsets)
    }
}

impl Default for ActionSpace {
    fn default() -> Self {
        Self(ALL)
    }
}

impl fmt::Display for ActionSpace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

impl<'de> Deserialize<'de> for ActionSpace {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::named(&name).ok_or_else(|| {
            let known: Vec<&str> = Self::all().map(Self::name).collect();
            de::Error::custom(format!("there is no action space `{name}`; there are {}", known.join(", ")))
        })
    }
}
