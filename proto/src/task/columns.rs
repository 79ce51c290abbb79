//! The numbers of an episode, and the figures over episodes that are made of them.

use super::error::SpecError;
use super::figure::{Column, Described, Figure, Take};
use super::metric::{Clause, Kind, Limit, Metric};
use super::spec::Spec;
use std::collections::BTreeMap;

impl Spec {
    /// Rewards that need no multiplier: an episode has a return under each.
    pub fn plain_rewards(&self) -> impl Iterator<Item = &str> {
        let plain = |name: &&str| {
            let composition = self.composition(name, &[], &BTreeMap::new());
            !composition.expect("a task is checked when it is read").has_multiplier()
        };
        self.rewards.iter().map(|reward| reward.name.as_str()).filter(plain)
    }

    /// The numbers of an episode beside its length: its returns, then its metrics.
    pub fn columns(&self) -> Vec<Described> {
        let of_reward = |name: &str| {
            let doc = format!("Undiscounted return under {name}.");
            Described::new(&format!("return_{name}"), "", "", Kind::F64, &doc)
        };
        let metrics = self.metrics.iter().map(|metric| self.described_metric(metric));
        self.plain_rewards().map(of_reward).chain(metrics).collect()
    }

    fn described_metric(&self, metric: &Metric) -> Described {
        let Metric { name, label, unit, doc, .. } = metric;
        Described::new(name, label, unit, self.resolved(metric).kind, doc)
    }

    /// A metric with a label: its name, if it has no other.
    pub(super) fn labelled(&self, metric: &Metric) -> Described {
        let mut described = self.described_metric(metric);
        if described.label.is_empty() {
            described.label.clone_from(&metric.name);
        }
        described
    }

    pub fn column(&self, name: &str) -> Option<Column> {
        match name {
            "terminated" => Some(Column::Terminated),
            "length" => Some(Column::Length),
            name => {
                let returns: Vec<&str> = self.plain_rewards().collect();
                let of_reward =
                    name.strip_prefix("return_").and_then(|name| returns.iter().position(|one| *one == name));
                let of_metric = || self.metrics.iter().position(|metric| metric.name == name);
                of_reward.or_else(|| Some(returns.len() + of_metric()?)).map(Column::Number)
            }
        }
    }

    /// All that is known of an evaluation's episodes, in the order in which it is printed.
    pub fn described(&self) -> Vec<Described> {
        let ended = "The task ended the episode, not the limit of steps.";
        let engines = [
            Described::new("terminated", "", "", Kind::Share, ended),
            Described::new("length", "length", "steps", Kind::Count, "Actions."),
        ];
        let mut described: Vec<Described> = engines.into_iter().chain(self.columns()).collect();
        for figure in &self.figures {
            let kind = |name: &str| described.iter().find(|one| one.name == name).map(|one| one.kind);
            let kind = match (figure.take, figure.per.as_deref(), kind(&figure.of)) {
                // Of all steps those that a metric counts.
                (Take::Mean, Some("length"), Some(Kind::Count)) | (Take::Mean, None, Some(Kind::Share)) => Kind::Share,
                _ => Kind::F64,
            };
            let Figure { name, label, unit, doc, .. } = figure;
            described.push(Described::new(name, label, unit, kind, doc));
        }
        described
    }

    /// The metrics by which policies are ranked, the most important first: the headline, then the first one.
    pub fn ranking(&self) -> Vec<&Metric> {
        let is_headline = |metric: &&Metric| self.headline.as_ref() == Some(&metric.name);
        let mut ranking: Vec<&Metric> = self.metrics.iter().find(is_headline).into_iter().collect();
        ranking.extend(self.metrics.first().filter(|first| !is_headline(first)));
        ranking
    }

    /// The channel that the first clause with a number as its limit is about.
    pub fn limited(&self) -> Option<&str> {
        let is_limited = |clause: &&Clause| clause.limits.values().any(|limit| matches!(limit, Limit::Number(_)));
        let clause = self.metrics.iter().flat_map(|metric| &metric.all_of).find(is_limited);
        clause.map(|clause| clause.channel.as_str())
    }

    pub(super) fn check_figures(&self) -> Result<(), SpecError> {
        let wrong = |name: &str, problem: String| Err(SpecError::Figure { name: name.to_owned(), problem });
        let of_figures = self.figures.iter().map(|one| (&one.name, &one.of, one.per.as_ref(), &one.among));
        let of_curves = self.curves.iter().map(|one| (&one.name, &one.of, None, &one.among));
        for (name, of, per, among) in of_figures.chain(of_curves) {
            if let Some(unknown) = [of].into_iter().chain(per).chain(among).find(|name| self.column(name).is_none()) {
                return wrong(name, format!("there is no number `{unknown}` of an episode"));
            }
        }
        if let Some(figure) = self.figures.iter().find(|figure| figure.per.is_some() && figure.take != Take::Mean) {
            return wrong(&figure.name, "`per` is of means alone".to_owned());
        }
        for curve in &self.curves {
            let (limits, _) = curve.limits();
            let ascend = limits.is_sorted_by(|one, next| one < next) && limits.iter().all(|limit| limit.is_finite());
            if limits.is_empty() || !curve.below.is_empty() && !curve.at_most.is_empty() || !ascend {
                return wrong(&curve.name, "its limits are ascending numbers, either below or at_most".to_owned());
            }
        }
        match self.headline.iter().find(|name| !self.metrics.iter().any(|metric| metric.name == **name)) {
            Some(name) => wrong(name, "the headline is no metric".to_owned()),
            None => Ok(()),
        }
    }
}
