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
    /// Of fixed seeds, in environments that are not built in.
    Seeds,
}

impl Source {
    pub(super) fn of(conditions: &Conditions) -> Self {
        match conditions.distribution {
            _ if conditions.procedural.is_some() => Self::Procedural,
            _ if !conditions.scenes.is_empty() => Self::Scenes,
            Distribution::Fixed => Self::Fixed,
            Distribution::Seeds => Self::Seeds,
            Distribution::Run => Self::Drawn,
        }
    }
}

/// Which episodes a table is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    pub split: Split,
    /// Targets: novel or seen, or that there are none.
    pub objects: ObjectSet,
    /// Fixed, drawn, or of fixed seeds.
    pub source: Source,
    /// Of the best checkpoint by the run's own validation instead of the newest one.
    pub best: bool,
}

impl Field {
    /// All that can be evaluated, the paper's first table first.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        let places = [
            (Split::Test, Source::Fixed),
            (Split::Validation, Source::Fixed),
            (Split::Test, Source::Drawn),
            (Split::Validation, Source::Drawn),
            (Split::Train, Source::Drawn),
            (Split::Train, Source::Scenes),
            (Split::Train, Source::Procedural),
            (Split::Test, Source::Seeds),
            (Split::Validation, Source::Seeds),
        ];
        let sets = [ObjectSet::Novel, ObjectSet::Seen, ObjectSet::NoTargets];
        let newest = places.into_iter().flat_map(move |(split, source)| sets.map(|set| Self::new(split, set, source)));
        newest.flat_map(|field| [field, field.of_best()])
    }

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
        let drawn = match self.source {
            Source::Fixed => "",
            Source::Seeds => ", episodes of fixed seeds",
            Source::Drawn | Source::Scenes | Source::Procedural => ", drawn episodes",
        };
        let best = if self.best { ", best checkpoint" } else { "" };
        let objects = match self.objects {
            ObjectSet::NoTargets => String::new(),
            objects => format!(", {} objects", objects.name()),
        };
        format!("{}{objects}{drawn}{best}", self.place())
    }

    /// `test-novel`, `test-novel-drawn` or `test-novel-best`, `test` without targets, for file names.
    pub(crate) fn key(self) -> String {
        let drawn = match self.source {
            Source::Drawn => "-drawn",
            Source::Seeds => "-seeds",
            Source::Fixed | Source::Scenes | Source::Procedural => "",
        };
        let best = if self.best { "-best" } else { "" };
        let objects = match self.objects {
            ObjectSet::NoTargets => String::new(),
            objects => format!("-{}", objects.name()),
        };
        format!("{}{objects}{drawn}{best}", self.place())
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
