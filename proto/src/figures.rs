//! Figures by name, small in memory: many rollouts have the same names, and keep them once.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

#[derive(Debug, Clone, PartialEq, Default)]
pub struct Figures {
    names: Names,
    values: Box<[f64]>,
}

/// A rollout has a few dozen, and so has a run.
const NAMES_MOST: usize = 512;

/// Names of figures, sorted.
type Names = Arc<[String]>;

impl Figures {
    pub fn get(&self, name: &str) -> Option<f64> {
        let index = self.names.binary_search_by(|own| own.as_str().cmp(name)).ok()?;
        Some(self.values[index])
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.names.iter().map(String::as_str)
    }

    pub fn iter(&self) -> impl Iterator<Item = (&str, f64)> {
        self.names().zip(self.values.iter().copied())
    }
}

impl From<BTreeMap<String, f64>> for Figures {
    fn from(map: BTreeMap<String, f64>) -> Self {
        let (names, values): (Vec<String>, Vec<f64>) = map.into_iter().unzip();
        Self { names: names.into(), values: values.into() }
    }
}

impl Serialize for Figures {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.iter())
    }
}

impl<'de> Deserialize<'de> for Figures {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let map = BTreeMap::deserialize(deserializer)?;
        let is_plausible = map.len() <= NAMES_MOST;
        is_plausible.then(|| Self::from(map)).ok_or_else(|| Error::custom("no rollout has so many figures"))
    }
}

#[derive(Debug, Clone, Default)]
pub(crate) struct KnownNames {
    /// Sets of them that were seen last, for figures to share.
    sets: Vec<Names>,
    all: BTreeSet<String>,
}

/// Rollouts have a few sets of names: with episodes that ended or without, with a Lagrangian multiplier or without.
const KNOWN_MAX: usize = 8;

impl KnownNames {
    /// Makes the figures share their names with earlier ones that have the same; whether the run has not too many names
    /// with them.
    pub fn share(&mut self, figures: &mut Figures) -> bool {
        if let Some(index) = self.sets.iter().position(|known| *known == figures.names) {
            figures.names = Arc::clone(&self.sets[index]);
            return true;
        }
        let new: Vec<&str> = figures.names().filter(|name| !self.all.contains(*name)).collect();
        if self.all.len() + new.len() > NAMES_MOST {
            return false;
        }
        self.all.extend(new.into_iter().map(str::to_owned));
        if self.sets.len() == KNOWN_MAX {
            self.sets.remove(0);
        }
        self.sets.push(Arc::clone(&figures.names));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures(names: &[&str]) -> Figures {
        names
            .iter()
            .zip(1..)
            .map(|(name, value)| ((*name).to_owned(), f64::from(value)))
            .collect::<BTreeMap<_, _>>()
            .into()
    }

    #[test]
    fn they_are_a_map_in_json_and_found_by_name() {
        let own = figures(&["loss/value", "loss/policy", "SR"]);
        let text = serde_json::to_string(&own).unwrap();
        assert_eq!(text, r#"{"SR":3.0,"loss/policy":2.0,"loss/value":1.0}"#);
        assert_eq!(serde_json::from_str::<Figures>(&text).unwrap(), own);
        assert_eq!((own.get("loss/policy"), own.get("loss"), own.get("z")), (Some(2.0), None, None));
        assert_eq!(own.names().collect::<Vec<_>>(), ["SR", "loss/policy", "loss/value"]);
    }

    #[test]
    fn the_same_names_are_kept_once_and_few_sets_are_remembered() {
        let mut known = KnownNames::default();
        let mut all: Vec<Figures> = (0..20).map(|_| figures(&["a", "b"])).collect();
        assert!(all.iter_mut().all(|figures| known.share(figures)));
        assert!(all.iter().all(|figures| Arc::ptr_eq(&figures.names, &all[0].names)));
        let accepted = (0..1_000).filter(|number| known.share(&mut figures(&[&number.to_string()]))).count();
        assert_eq!((accepted, known.sets.len()), (NAMES_MOST - 2, KNOWN_MAX), "no run has so many names");
        let mut late = figures(&["a", "b"]);
        assert!(known.share(&mut late));
        assert!(!Arc::ptr_eq(&late.names, &all[0].names));
        assert_eq!(late, all[0]);
    }
}
