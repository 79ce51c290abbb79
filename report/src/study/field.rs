use proto::evaluation::{Conditions, Distribution, ObjectSet};
use proto::kitchen::Split;

/// Which kind of episodes. Only the fixed ones are the paper's kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    Fixed,
    /// Drawn within the run's distances, in the kitchens of a split.
    Drawn,
    Scenes,
    Procedural,
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

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    pub split: Split,
    pub objects: ObjectSet,
    pub source: Source,
    /// Of the best checkpoint by the run's own validation instead of the newest one.
    pub best: bool,
    /// With the most probable action in each step, not a sampled one.
    pub deterministic: bool,
}

impl Field {
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
        newest.flat_map(|field| [field, field.of_best()]).flat_map(|field| [field, field.of_most_probable()])
    }

    pub(crate) const fn new(split: Split, objects: ObjectSet, source: Source) -> Self {
        Self { split, objects, source, best: false, deterministic: false }
    }

    pub(crate) const fn of_best(self) -> Self {
        Self { best: true, ..self }
    }

    pub(crate) const fn of_most_probable(self) -> Self {
        Self { deterministic: true, ..self }
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
        let how = if self.deterministic { ", deterministic" } else { "" };
        format!("{}{objects}{how}{drawn}{best}", self.place())
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
        let how = if self.deterministic { "-deterministic" } else { "" };
        format!("{}{objects}{how}{drawn}{best}", self.place())
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
