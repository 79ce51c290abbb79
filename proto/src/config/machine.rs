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
    /// A list: as `true`, but with these cores alone.
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
    /// Whether it can be of some machine.
    pub(super) fn is_possible(&self) -> bool {
        let Self::Cores(cores) = self else { return true };
        let twice = cores.iter().enumerate().any(|(index, core)| cores[..index].contains(core));
        !cores.is_empty() && cores.iter().all(|&core| core <= MAX_CORE) && !twice
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
