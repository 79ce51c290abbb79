//! Kinds of episodes that are never averaged together.

use proto::evaluation::{Conditions, Distribution, ObjectSet};
use proto::kitchen::Split;

/// Which kind of episodes. Only the fixed ones are the paper's kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// The fixed ones of validation and test kitchens.
    Fixed,
    /// Drawn within the run's distances, in the kitchens of a split.
    Drawn,
    /// Drawn within the run's distances, in scenes of the run's own.
    Scenes,
    /// Drawn within the run's distances, in procedural kitchens.
    Procedural,
}

impl Source {
    pub(super) fn of(conditions: &Conditions) -> Self {
        match conditions.distribution {
            _ if conditions.procedural.is_some() => Self::Procedural,
            _ if !conditions.scenes.is_empty() => Self::Scenes,
            Distribution::Fixed => Self::Fixed,
            Distribution::Run => Self::Drawn,
        }
    }
}

/// Which episodes a table is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// Kitchens.
    pub split: Split,
    /// Targets: novel or seen.
    pub objects: ObjectSet,
    /// Fixed or drawn.
    pub source: Source,
    /// Of the best checkpoint by the run's own validation instead of the newest one.
    pub best: bool,
}

/// Kinds of episodes.
const KINDS: usize = 14;

impl Field {
    /// All that can be evaluated, the paper's first table first.
    pub(crate) const ALL: [Self; 2 * KINDS] = {
        let mut all = [Self::NEWEST[0]; 2 * KINDS];
        let mut index = 0;
        while index < KINDS {
            all[2 * index] = Self::NEWEST[index];
            all[2 * index + 1] = Self::NEWEST[index].of_best();
            index += 1;
        }
        all
    };

    const NEWEST: [Self; KINDS] = [
        Self::new(Split::Test, ObjectSet::Novel, Source::Fixed),
        Self::new(Split::Test, ObjectSet::Seen, Source::Fixed),
        Self::new(Split::Validation, ObjectSet::Novel, Source::Fixed),
        Self::new(Split::Validation, ObjectSet::Seen, Source::Fixed),
        Self::new(Split::Test, ObjectSet::Novel, Source::Drawn),
        Self::new(Split::Test, ObjectSet::Seen, Source::Drawn),
        Self::new(Split::Validation, ObjectSet::Novel, Source::Drawn),
        Self::new(Split::Validation, ObjectSet::Seen, Source::Drawn),
        Self::new(Split::Train, ObjectSet::Novel, Source::Drawn),
        Self::new(Split::Train, ObjectSet::Seen, Source::Drawn),
        Self::new(Split::Train, ObjectSet::Novel, Source::Scenes),
        Self::new(Split::Train, ObjectSet::Seen, Source::Scenes),
        Self::new(Split::Train, ObjectSet::Novel, Source::Procedural),
        Self::new(Split::Train, ObjectSet::Seen, Source::Procedural),
    ];

    /// These episodes.
    pub(crate) const fn new(split: Split, objects: ObjectSet, source: Source) -> Self {
        Self { split, objects, source, best: false }
    }

    /// The same episodes, played by the best checkpoint.
    pub(crate) const fn of_best(self) -> Self {
        Self { best: true, ..self }
    }

    /// `test, novel objects`, or `test, novel objects, drawn episodes`
    pub(crate) fn name(self) -> String {
        let drawn = if self.source == Source::Fixed { "" } else { ", drawn episodes" };
        let best = if self.best { ", best checkpoint" } else { "" };
        format!("{}, {} objects{drawn}{best}", self.place(), self.objects.name())
    }

    /// `test-novel`, `test-novel-drawn` or `test-novel-best`, for file names.
    pub(crate) fn key(self) -> String {
        let drawn = if self.source == Source::Drawn { "-drawn" } else { "" };
        let best = if self.best { "-best" } else { "" };
        format!("{}-{}{drawn}{best}", self.place(), self.objects.name())
    }

    fn place(self) -> &'static str {
        match self.split {
            _ if self.source == Source::Scenes => "scenes",
            _ if self.source == Source::Procedural => "procedural",
            Split::Train => "training",
            Split::Validation => "validation",
            Split::Test => "test",
        }
    }
}
