//! What is found.

use std::fmt;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// No circle between the files of one crate.
    Circle,
    /// No circle between the rooms of one crate: the folders and files beside its root.
    RoomCircle,
    /// No way to open a file of a run folder but `RunFolder`'s.
    Opening,
    /// No Rust source that the other rules cannot read.
    Unreadable,
}

impl Rule {
    fn advice(self) -> &'static str {
        match self {
            Self::Circle => "move what both sides need into a file that uses neither",
            Self::RoomCircle => "move a file into the room that needs it, or what both need into a third room",
            Self::Opening => "open it by a method of `RunFolder`; what is in no run folder stands in openings.rs",
            Self::Unreadable => "mend the syntax",
        }
    }
}

/// One breach of a rule.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Finding {
    /// The file, relative to the root of the tree.
    pub path: String,
    /// The line, counted from 1.
    pub line: usize,
    pub rule: Rule,
    pub what: String,
    /// More of it, for the reader.
    pub detail: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {} ({}){}", self.path, self.line, self.what, self.rule.advice(), self.detail)
    }
}
