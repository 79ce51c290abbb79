//! Where the services of one incarnation live, and how that place is swept.

use crate::error::WireError;
use iceoryx2::config::Config;
use iceoryx2::prelude::{Path as IoxPath, SemanticString};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Where the services of one orchestrator incarnation live: a prefix of names in /dev/shm and a folder of small files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WireAddress {
    prefix: String,
    root: PathBuf,
}

/// Start of every prefix, so that `orchestrator clean` recognises what is ours.
pub const PREFIX_MARK: &str = "stillroom_";

impl WireAddress {
    /// The address of incarnation `incarnation` of run `run_id`. `run_id` holds letters and digits only.
    pub fn new(run_id: &str, incarnation: u32) -> Self {
        let prefix = format!("{PREFIX_MARK}{run_id}_{incarnation}_");
        let root = std::env::temp_dir().join(prefix.trim_end_matches('_'));
        Self { prefix, root }
    }

    /// Prefix of all names in /dev/shm.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Folder of the small files.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Deletes everything at this address. To be called when no process uses it any more.
    ///
    /// Returns the number of files removed.
    pub fn sweep(&self) -> std::io::Result<usize> {
        let mut removed = 0;
        for entry in std::fs::read_dir(SHARED_MEMORY)? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                match std::fs::remove_file(entry.path()) {
                    Ok(()) => removed += 1,
                    Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                    Err(error) => return Err(error),
                }
            }
        }
        match std::fs::remove_dir_all(&self.root) {
            Ok(()) => removed += 1,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        Ok(removed)
    }

    /// Settings of a node that lives here.
    pub(super) fn config(&self) -> Result<Config, WireError> {
        let invalid = || WireError::Address(self.to_string());
        let mut config = Config::default();
        let root = self.root.to_str().ok_or_else(invalid)?;
        if root.len() > MAX_ROOT_BYTES {
            return Err(WireError::TooLong { root: root.to_owned() });
        }
        config.global.set_root_path(&IoxPath::new(root.as_bytes()).map_err(|_| invalid())?);
        config.global.prefix = SemanticString::new(self.prefix.as_bytes()).map_err(|_| invalid())?;
        // Sweeping dead nodes is the orchestrator's task, on SIGCHLD and on a timer: a starting actor must not spend
        // its first milliseconds on its siblings' remains.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(config)
    }
}

/// Longest root folder: iceoryx2 puts sockets in it, whose names, prefix included, take the rest of 108 bytes.
const MAX_ROOT_BYTES: usize = 36;

/// Where POSIX shared memory lives on Linux.
pub const SHARED_MEMORY: &str = "/dev/shm";

impl Display for WireAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}@{}", self.prefix, self.root.display())
    }
}

impl std::str::FromStr for WireAddress {
    type Err = WireError;
    fn from_str(text: &str) -> Result<Self, WireError> {
        match text.split_once('@') {
            Some((prefix, root)) if prefix.starts_with(PREFIX_MARK) && root.starts_with('/') => {
                Ok(Self { prefix: prefix.to_owned(), root: PathBuf::from(root) })
            }
            _ => Err(WireError::Address(text.to_owned())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_survives_the_command_line() {
        let address = WireAddress::new("text", 1);
        assert_eq!(address.to_string().parse::<WireAddress>().unwrap(), address);
        assert!("nonsense".parse::<WireAddress>().is_err());
    }
}
