use super::error::{ConfigError, parse};
use crate::task::Declaration;
use serde::{Deserialize, Serialize};
use std::process::Command;

/// The environments of a task that is not built in.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentConfig {
    /// Program and arguments of an actor's process, which simulates them.
    pub command: Vec<String>,
    /// The task's declaration.
    pub declaration: String,
}

impl EnvironmentConfig {
    /// Refuses a text that adds to an environment's description, by its own lines. `origin` names it.
    pub fn check_addition(text: &str, origin: &str) -> Result<(), ConfigError> {
        parse::<Declaration>(text, origin).map(drop)
    }

    /// The program with its arguments, to which others can be added. The configuration was validated: there is a program.
    pub fn program(&self) -> Command {
        let mut command = Command::new(self.command.first().map_or("", String::as_str));
        command.args(self.command.iter().skip(1));
        // Whoever starts it starts several, and they share the cores already.
        command.envs(["OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"].map(|name| (name, "1")));
        command
    }
}
