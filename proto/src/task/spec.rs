use super::actions::Actions;
use super::channel::{Channel, Role};
use super::figure::{Curve, Described, Figure};
use super::layout::{Field, HEADER_BYTES, Layout};
use super::metric::Metric;
use super::restore::Restore;
use super::reward::{Cost, Label, Reward};
use crate::digest::sha256;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write as _;

#[derive(Debug, Clone, PartialEq)]
pub struct Spec {
    /// Lower-case, e.g. `arm_point_nav`.
    pub name: String,
    /// SHA-256 of texts that declared it before, under which a run goes on with the same bits.
    pub formerly: Vec<String>,
    pub actions: Actions,
    pub channels: Vec<Channel>,
    /// How its environments are brought back. Kitchens are by replay.
    pub restore: Restore,
    /// Rewards that stages can name, beside those of a configuration.
    pub rewards: Vec<Reward>,
    /// Weights that rewards name, and that a configuration can set.
    pub weights: BTreeMap<String, f32>,
    pub metrics: Vec<Metric>,
    /// Figures over episodes beside the means of metrics.
    pub figures: Vec<Figure>,
    pub curves: Vec<Curve>,
    pub(super) headline: Option<String>,
    /// The metrics, and quotients of their means, that screens and tables of a run show, in this order; empty: all of
    /// training.
    pub(super) shown: Vec<String>,
    pub(super) cost: Option<Cost>,
    pub(super) label: Option<Label>,
    pub(super) layout: Layout,
    pub(super) text: String,
}

impl Spec {
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    pub fn channel(&self, name: &str) -> Option<(&Channel, Field)> {
        let index = self.channels.iter().position(|channel| channel.name == name)?;
        Some((&self.channels[index], self.layout.fields[index]))
    }

    /// Where a record says which options may be chosen; none of a task without a mask.
    pub fn mask(&self) -> Option<Field> {
        let index = self.channels.iter().position(|channel| channel.role == Role::Mask)?;
        Some(self.layout.fields[index])
    }

    pub fn metric(&self, name: &str) -> Option<&Metric> {
        self.metrics.iter().find(|metric| metric.name == name)
    }

    /// The metrics that screens and tables of a run show. Each has a label.
    pub fn shown(&self) -> Vec<Described> {
        if self.shown.is_empty() {
            return self.metrics.iter().filter(|metric| metric.curve).map(|metric| self.labelled(metric)).collect();
        }
        self.shown.iter().filter_map(|name| self.shown_as(name)).collect()
    }

    /// A metric of training, or a figure that is the quotient of two, as screens and tables show it.
    pub(super) fn shown_as(&self, name: &str) -> Option<Described> {
        let of_training = |name: &str| self.metric(name).filter(|metric| metric.curve);
        let quotient = || self.figures.iter().find(|figure| figure.name == name)?.shown();
        let is_known = |one: &Described| one.quotient.iter().flatten().all(|name| of_training(name).is_some());
        of_training(name).map(|metric| self.labelled(metric)).or_else(quotient).filter(is_known)
    }

    /// Adds the quotients that are shown to means of metrics.
    pub fn with_quotients(&self, mut means: BTreeMap<String, f64>) -> BTreeMap<String, f64> {
        for metric in self.shown() {
            if let Some(mean) = metric.mean(&means) {
                means.insert(metric.name, mean);
            }
        }
        means
    }

    /// The metrics among them, then the others of training: a learning curve is drawn of each.
    pub fn charted(&self) -> Vec<Described> {
        let is_other = |metric: &&Metric| metric.curve && !self.shown.is_empty() && !self.shown.contains(&metric.name);
        let others = self.metrics.iter().filter(is_other).map(|metric| self.labelled(metric));
        self.shown().into_iter().filter(|metric| metric.quotient.is_none()).chain(others).collect()
    }

    /// The declaration as it was written, for the run folder.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether a run that began under this text goes on with the same bits: it is a former one, or says the same but for
    /// docs.
    pub(crate) fn continues(&self, text: &str) -> bool {
        self.formerly.contains(&sha256(text.as_bytes())) || Self::parse(text).is_ok_and(|written| written.means(self))
    }

    pub(super) fn means(&self, other: &Self) -> bool {
        let bare = |spec: &Self| {
            let mut spec = spec.clone();
            spec.text.clear();
            spec.formerly.clear();
            for Channel { tolerance, key, doc, .. } in &mut spec.channels {
                (*tolerance, *key) = (None, None);
                doc.clear();
            }
            spec.metrics.retain(|metric| metric.curve);
            for Metric { label, unit, doc, .. } in &mut spec.metrics {
                [label, unit, doc].into_iter().for_each(String::clear);
            }
            (spec.figures, spec.curves) = (vec![], vec![]);
            spec.shown.clear();
            spec
        };
        bare(self) == bare(other)
    }

    /// Hash of where everything lies in a record: processes of unlike layouts cannot talk.
    pub fn layout_hash(&self) -> u64 {
        let mut text = String::new();
        let (dtype, count) = self.actions.numbers();
        let _ = writeln!(text, "header {HEADER_BYTES}\naction {dtype:?} {count}");
        for (channel, field) in self.channels.iter().zip(&self.layout.fields) {
            let Channel { name, dtype, shape, sums, .. } = channel;
            let _ = writeln!(text, "{name} {dtype:?} {shape:?} {sums:?} {}", field.offset);
        }
        if !self.layout.last_seen.is_empty() {
            let _ = writeln!(text, "last {}", self.layout.last_seen.start);
        }
        if !self.layout.snapshot.is_empty() {
            let _ = writeln!(text, "snapshot {:?}", self.layout.snapshot);
        }
        let digest = Sha256::digest(text);
        u64::from_le_bytes(digest[..8].try_into().expect("a digest has 32 bytes"))
    }
}
