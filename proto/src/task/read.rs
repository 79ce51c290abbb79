//! Reading declarations: those that are built in, and any text.

use super::actions::Actions;
use super::channel::{Channel, Dtype, Role};
use super::error::SpecError;
use super::figure::{Curve, Figure};
use super::layout::Layout;
use super::metric::Metric;
use super::restore::Restore;
use super::reward::{Cost, Label, Reward};
use super::spec::Spec;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{LazyLock, Mutex, PoisonError, RwLock};

/// What the engine itself says of steps and episodes in recordings, data sets and tables. No channel or metric has such a
/// name, nor one that begins with `reward_` or `return_`.
const RESERVED: &str = "action action_names actor actor_incarnation bulk_recorded end ended environment \
                        environment_index episode exchange fixed_episode incarnation kitchen learner_incarnation \
                        length outcome outside previous_action robot seed stage stage_version state state_hash step \
                        steps terminated truncated";

/// The most of each kind that a task declares.
const DECLARED_MOST: usize = 1000;
/// The most rewards of a task and a configuration together. A chain of bases has no more links.
const REWARDS_MOST: usize = 100;

/// A declaration as it is written, or what adds to one ([`super::Description`]).
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Declaration {
    name: Option<String>,
    headline: Option<String>,
    #[serde(default)]
    formerly: Vec<String>,
    #[serde(default)]
    weights: BTreeMap<String, f32>,
    actions: Option<Actions>,
    channels: Option<Vec<Channel>>,
    #[serde(default)]
    restore: Restore,
    #[serde(default)]
    rewards: Vec<Reward>,
    cost: Option<Cost>,
    label: Option<Label>,
    #[serde(default)]
    metrics: Vec<Metric>,
    #[serde(default)]
    figures: Vec<Figure>,
    #[serde(default)]
    curves: Vec<Curve>,
    #[serde(default)]
    shown: Vec<String>,
}

/// What else a table of episodes and its figures have, whatever the task.
const ENGINES: &str = "kitchen episode category objects end terminated length prediction prediction_hits prediction_misses \
                       prediction_false_alarms prediction_quiet state_hash distribution episodes curves";

static BUILT_IN: LazyLock<Vec<Spec>> = LazyLock::new(|| {
    let texts: &[&str] = include!(concat!(env!("OUT_DIR"), "/tasks.rs"));
    texts.iter().map(|text| Spec::parse(text).expect("a test reads every built-in task")).collect()
});

/// Tasks that this process was given.
static DECLARED: RwLock<Vec<&Spec>> = RwLock::new(Vec::new());

impl Spec {
    /// The task of this name: one that is built in or was declared.
    pub fn named(name: &str) -> Option<&'static Self> {
        let declared = DECLARED.read().unwrap_or_else(PoisonError::into_inner);
        Self::built_in().iter().chain(declared.iter().copied()).find(|spec| spec.name == name)
    }

    /// Reads a declaration that is not built in, so that configurations can name its task. It lasts as long as the process.
    pub fn declare(text: &str) -> Result<&'static Self, SpecError> {
        let spec = Self::parse(text)?;
        let mut declared = DECLARED.write().unwrap_or_else(PoisonError::into_inner);
        let taken = Self::built_in().iter().chain(declared.iter().copied()).find(|other| other.name == spec.name);
        match taken {
            Some(other) if other.text == text => Ok(other),
            Some(_) => Err(SpecError::Taken(spec.name)),
            None => {
                let spec: &Self = Box::leak(Box::new(spec));
                declared.push(spec);
                Ok(spec)
            }
        }
    }

    pub fn is_built_in(&self) -> bool {
        Self::built_in().iter().any(|spec| spec.name == self.name)
    }

    pub fn built_in() -> &'static [Self] {
        &BUILT_IN
    }

    /// Reads the declaration of a task that is not built in. Each text is read once and kept for the rest of the process.
    pub fn kept(text: &str) -> Result<&'static Self, SpecError> {
        static KEPT: Mutex<BTreeMap<String, &'static Spec>> = Mutex::new(BTreeMap::new());
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(spec) = kept.get(text) {
            return Ok(spec);
        }
        let spec: &'static Self = Box::leak(Box::new(Self::parse(text)?));
        kept.insert(text.to_owned(), spec);
        Ok(spec)
    }

    pub fn parse(text: &str) -> Result<Self, SpecError> {
        let declaration: Declaration = toml::from_str(text).map_err(|cause| SpecError::Toml(cause.to_string()))?;
        let Declaration {
            name,
            headline,
            formerly,
            weights,
            actions,
            channels,
            restore,
            rewards,
            cost,
            label,
            metrics,
            figures,
            curves,
            shown,
        } = declaration;
        let (Some(name), Some(actions), Some(channels)) = (name, actions, channels) else {
            return Err(SpecError::Toml("a task has a `name`, `actions` and `channels`".to_owned()));
        };
        let counts = [("channels", channels.len()), ("metrics", metrics.len()), ("figures", figures.len())];
        for (what, count) in counts.into_iter().chain([("curves", curves.len()), ("names in `shown`", shown.len())]) {
            at_most(what, count, DECLARED_MOST)?;
        }
        actions.check()?;
        channels.iter().try_for_each(Channel::check)?;
        check_masks(&actions, &channels)?;
        check_restore(restore, &channels)?;
        let (layout, text) = (Layout::of(&actions, &channels, restore), text.to_owned());
        // Each has a bit of a record's header.
        at_most("images, and sums of them", layout.images.len(), u32::BITS as usize)?;
        let spec = Self {
            name,
            formerly,
            actions,
            channels,
            restore,
            rewards,
            weights,
            metrics,
            figures,
            curves,
            headline,
            shown,
            cost,
            label,
            layout,
            text,
        };
        check_names(std::iter::once(&*spec.name))?;
        check_own_names(spec.channels.iter().map(|channel| &*channel.name))?;
        check_own_names(spec.metrics.iter().map(|metric| &*metric.name))?;
        spec.check_rewards(&[])?;
        for reward in &spec.rewards {
            spec.composition(&reward.name, &[], &BTreeMap::new())?;
        }
        for metric in &spec.metrics {
            spec.measure(metric)?;
        }
        let columns = spec.columns();
        let figures =
            spec.figures.iter().map(|figure| &*figure.name).chain(spec.curves.iter().map(|curve| &*curve.name));
        check_names(ENGINES.split(' ').chain(columns.iter().map(|column| &*column.name)).chain(figures))?;
        spec.check_figures()?;
        if let Some(name) = spec.shown.iter().find(|name| spec.shown_as(name).is_none()) {
            let problem = "it is shown, and is neither a metric of training nor the quotient of two".to_owned();
            return Err(SpecError::Metric { name: name.clone(), problem });
        }
        if let Some(Label { part, at_most, at_least, .. }) = &spec.label {
            spec.threshold(part, *at_most, *at_least).map_err(SpecError::Label)?;
        }
        if let Some(Cost { part, weight }) = &spec.cost {
            spec.part(part).map_err(SpecError::Cost)?;
            if !weight.is_finite() {
                return Err(SpecError::Cost("its weight is not a finite number".to_owned()));
            }
        }
        Ok(spec)
    }

    /// Refuses rewards of a configuration with a name that is none, or that another one has.
    pub(crate) fn check_rewards(&self, own: &[Reward]) -> Result<(), SpecError> {
        at_most("rewards", self.rewards.len() + own.len(), REWARDS_MOST)?;
        for reward in self.rewards.iter().chain(own) {
            at_most("terms in a reward", reward.terms.len(), DECLARED_MOST)?;
        }
        check_names(self.rewards.iter().chain(own).map(|reward| &*reward.name))
    }
}

fn check_restore(restore: Restore, channels: &[Channel]) -> Result<(), SpecError> {
    match restore {
        Restore::Snapshot { bytes } if !(1..=Restore::SNAPSHOT_BYTES_MOST).contains(&bytes) => {
            Err(SpecError::Snapshot { bytes })
        }
        Restore::None => channels.iter().try_for_each(Channel::check_nothing),
        _ => Ok(()),
    }
}

fn check_masks(actions: &Actions, channels: &[Channel]) -> Result<(), SpecError> {
    let mut masks = channels.iter().filter(|channel| channel.role == Role::Mask);
    let Some(mask) = masks.next() else { return Ok(()) };
    let wrong = |channel: &Channel, problem| Err(SpecError::Channel { name: channel.name.clone(), problem });
    if let Some(second) = masks.next() {
        return wrong(second, "a task has one mask: of several choices the options stand side by side");
    }
    let options = actions.choices().iter().sum();
    if options == 0 || matches!(actions, Actions::Discrete { subsets, .. } if !subsets.is_empty()) {
        return wrong(mask, "a mask is of discrete or multi_discrete actions without subsets");
    }
    if (mask.dtype, &mask.shape[..]) != (Dtype::U8, &[options]) {
        return wrong(mask, "a mask is u8, and its shape is how many options the actions have in all");
    }
    Ok(())
}

/// A declaration may be anybody's, and each name is looked up among all.
fn at_most(what: &'static str, count: usize, most: usize) -> Result<(), SpecError> {
    if count <= most { Ok(()) } else { Err(SpecError::TooMany { what, count, most }) }
}

/// Whether a channel or a metric may not have this name.
pub fn is_reserved(name: &str) -> bool {
    RESERVED.split(' ').any(|own| own == name) || name.starts_with("reward_") || name.starts_with("return_")
}

/// The same as [`check_names`], and refuses those that the engine has.
fn check_own_names<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Result<(), SpecError> {
    match names.clone().find(|name| is_reserved(name)) {
        Some(name) => Err(SpecError::Reserved(name.to_owned())),
        None => check_names(names),
    }
}

/// Refuses a name that is none, and one that is there twice.
fn check_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), SpecError> {
    let letter = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
    let mut seen = BTreeSet::new();
    for name in names {
        if name.len() > 64 || !name.starts_with(|first: char| first.is_ascii_lowercase()) || !name.bytes().all(letter) {
            return Err(SpecError::Name(name.to_owned()));
        }
        if !seen.insert(name) {
            return Err(SpecError::Double(name.to_owned()));
        }
    }
    Ok(())
}
