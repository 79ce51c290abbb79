//! Where a run's processes run on the machine. Nothing of it changes what a run computes.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Settings of the machine.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MachineConfig {
    /// Cores of learners and actors.
    pub pin: Pin,
}

/// Which cores learners and actors are held to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected true, false or a list of core numbers, for example [0, 1, 2, 3]")]
pub enum Pin {
    /// `false`: none, the kernel chooses. `true`: each learner and its actors have the cores near the learner's GPU,
    /// divided where several GPUs have the same; without GPUs all cores are divided among the learners.
    Automatic(bool),
    /// Of these cores, those that `true` would choose.
    Cores(Vec<u32>),
}

impl fmt::Display for Pin {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Automatic(choice) => write!(formatter, "{choice}"),
            Self::Cores(cores) => write!(formatter, "{cores:?}"),
        }
    }
}

impl Default for Pin {
    fn default() -> Self {
        Self::Automatic(false)
    }
}

/// The highest number of a core that can be named: what the kernel's plain calls know.
const MAX_CORE: u32 = 1023;

impl Pin {
    /// Why it can be of no machine, if so.
    pub(super) fn problem(&self) -> Option<&'static str> {
        let Self::Cores(cores) = self else { return None };
        if cores.is_empty() {
            return Some("must name at least one core, or be true or false");
        }
        if cores.iter().any(|&core| core > MAX_CORE) {
            return Some("cores are numbered 0 to 1023");
        }
        let twice = cores.iter().enumerate().any(|(index, core)| cores[..index].contains(core));
        twice.then_some("names a core twice")
    }
}

#[cfg(test)]
mod tests {
    use super::super::Config;
    use super::*;

    fn pin(setting: &str) -> Result<Pin, String> {
        let setting = setting.parse().map_err(|error| format!("{error}"))?;
        let config = Config::resolve_set("demo", None, &[setting]).map_err(|error| error.to_string())?;
        let again = Config::from_toml(&config.to_toml(), "the same").map_err(|error| error.to_string())?;
        assert_eq!(again, config);
        Ok(config.machine.pin)
    }

    #[test]
    fn a_pin_is_a_choice_or_a_list_of_cores() {
        assert_eq!(Config::default().machine.pin, Pin::Automatic(false));
        assert_eq!(pin("machine.pin=true"), Ok(Pin::Automatic(true)));
        assert_eq!(pin("machine.pin=[4, 2]"), Ok(Pin::Cores(vec![4, 2])));
        for (wrong, why) in [
            ("machine.pin=[]", "at least one core"),
            ("machine.pin=[1, 1]", "twice"),
            ("machine.pin=[1024]", "0 to 1023"),
            ("machine.pin=near", "a list of core numbers"),
            ("machine.pin=2", "a list of core numbers"),
        ] {
            let message = pin(wrong).expect_err(wrong);
            assert!(message.contains(why), "{wrong}: {message}");
        }
    }
}
