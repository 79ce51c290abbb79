//! What a data set is of, and how large it is.

/// What a data set is of.
#[derive(Debug, Clone)]
pub struct Source {
    /// Names of the actions, in the order of their numbers.
    pub actions: Vec<&'static str>,
    /// Configurations of the run, TOML.
    pub configs: Vec<String>,
}

/// How large a data set is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Size {
    /// Episodes.
    pub episodes: u64,
    /// Steps.
    pub steps: u64,
    /// Bytes of all files.
    pub bytes: u64,
}
