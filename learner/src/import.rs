//! Imported weights: a state dict of AllenAct's `ArmPointNavBaselineActorCritic` (its own, or the one of the
//! disturbance-free project that the paper describes), or weights of another run of ours.
//!
//! The correspondence of names is [`correspondences`], which is the table in docs/probe.md. Three tensors differ
//! in more than their names:
//!
//! * **Previous action.** Where AllenAct's table has a row an action and none for "no action yet", an episode's first
//!   observation is given the row of the action that ended the episode before. That is Done, unless the step limit
//!   ended it: our row for "none yet" becomes a copy of Done's.
//! * **CPC|A's action embedding** has a row that AllenAct never looks up, after the last action: it is left out.
//! * **The original baseline** gives the belief the goal's embedding first and the visual one second. Ours is the other
//!   way round: the columns of `weight_ih_l0` change places. (AllenAct's own configuration embeds the goal in 512
//!   numbers; such weights have no place here, where it is 32, as in the disturbance-free project.)
//!
//! Names may be wrapped, all by the same prefix, or by what `DataParallel` and `torch.compile` add: see [`Names`].
//!
//! The goal vector of AllenAct's sensors is object − goal while the object is held (`network.carried_goal`), which no
//! tensor shows. The caller refuses a configuration with the other sign.

use crate::agent::{AgentState, MODEL};
use crate::auxiliary::TASKS;
use crate::network::{ENCODERS, OBSERVATION, Unfit, VISUAL, fits};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;
use tch::{Kind, Tensor};

/// Our module path and AllenAct's, both up to and including the dot before their common part. Those of an encoder or an
/// auxiliary task are in its own file: see [`correspondences`].
const COMMON: [(&str, &str); 9] = [
    ("goal_embedder.0.", "goal_embedder.0.0."),
    ("goal_embedder.2.", "goal_embedder.1.0."),
    ("goal_embedder.0.", "relative_dist_embedding.0.0."),
    ("goal_embedder.2.", "relative_dist_embedding.1.0."),
    ("previous_action_embedder.", "prev_action_embedder.fc."),
    ("belief.", "state_encoders.single_belief.rnn."),
    ("belief.", "state_encoder.rnn."),
    ("actor.", "actor.linear."),
    ("critic.", "critic.fc."),
];

/// Every correspondence of module paths, ours and AllenAct's.
fn correspondences() -> impl Iterator<Item = (Cow<'static, str>, &'static str)> {
    let encoders = ENCODERS.into_iter().flat_map(|entry| entry.allenact).chain(&COMMON);
    let tasks = TASKS.into_iter().filter_map(|task| Some((format!("auxiliary.{}.", task.name).into(), task.allenact?)));
    encoders.map(|&(ours, theirs)| (ours.into(), theirs)).chain(tasks)
}

/// AllenAct's goal embedding of the original baseline: where it is there, the goal comes first.
const GOAL_FIRST: &str = "relative_dist_embedding.";

/// What all encoders' weights are below, here and there.
const ENCODER: &str = "visual_encoder.";

/// The weight that the belief is given embeddings by.
const BELIEF_INPUT: &str = "belief.weight_ih_l0";

/// Ours, in files of ours: each network has one of them, and AllenAct calls it otherwise.
const OWN_WEIGHTS: [&str; 2] = ["critic.weight", "critic.0.weight"];

/// What `DataParallel` and `torch.compile` put around a network or around parts of it. No weight of ours is called so.
const WRAPPERS: [&str; 2] = ["module", "_orig_mod"];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Naming {
    AllenAct,
    /// A checkpoint's: ours, behind `model.`, among other tensors.
    Checkpoint,
    Ours,
}

#[derive(Debug, Clone)]
pub(crate) struct Names {
    pub naming: Naming,
    /// What stands before them, besides [`WRAPPERS`].
    prefix: String,
}

impl Names {
    pub fn of(state_dict: &BTreeMap<String, Tensor>, agent: &AgentState) -> Self {
        let own = |name: &str| agent.tensors.contains_key(&format!("{MODEL}{name}"));
        let is_known = |name: &str| own(name) || our_name(name).is_some();
        let names: Vec<String> = state_dict.keys().map(|name| unwrapped(name)).collect();
        let is_own = |name: &str| name.strip_prefix(MODEL).is_some_and(|name| OWN_WEIGHTS.contains(&name));
        if names.iter().any(|name| is_own(name)) {
            return Self { naming: Naming::Checkpoint, prefix: String::new() };
        }
        let prefix = prefix_of(&names, is_known);
        // Some parts are called the same by both.
        let is_ours = |name: &str| own(name) && our_name(name).is_none();
        let ours = names.iter().any(|name| name.strip_prefix(prefix).is_some_and(is_ours));
        Self { naming: if ours { Naming::Ours } else { Naming::AllenAct }, prefix: prefix.to_owned() }
    }

    /// A name without what stands before it.
    fn bare(&self, theirs: &str) -> String {
        let unwrapped = unwrapped(theirs);
        unwrapped.strip_prefix(&self.prefix).map(str::to_owned).unwrap_or(unwrapped)
    }

    /// What stands before a name in the file.
    fn before<'a>(&self, theirs: &'a str) -> &'a str {
        theirs.strip_suffix(&self.bare(theirs)).unwrap_or_default()
    }

    fn taken_off<'a>(&self, names: impl Iterator<Item = &'a String>) -> Vec<String> {
        let taken_off = names.filter(|name| self.bare(name) != **name).map(|name| match self.before(name) {
            "" => WRAPPERS.map(|wrapper| format!("{wrapper}.")).into_iter().filter(|it| name.contains(it)).collect(),
            before => vec![before.to_owned()],
        });
        taken_off.flatten().collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Our name of one of the file's; none where it is no weight.
    fn our_name(&self, theirs: &str) -> Option<String> {
        let name = self.bare(theirs);
        match self.naming {
            Naming::AllenAct => our_name(&name),
            Naming::Checkpoint => name.strip_prefix(MODEL).map(str::to_owned),
            Naming::Ours => Some(name),
        }
    }
}

/// What stands before the first name that is known behind it; nothing where one is known as it is.
fn prefix_of(names: &[String], is_known: impl Fn(&str) -> bool) -> &str {
    if names.iter().any(|name| is_known(name)) {
        return "";
    }
    let mut cuts = names.iter().flat_map(|name| name.match_indices('.').map(|(dot, _)| name.split_at(dot + 1)));
    cuts.find(|(_, rest)| is_known(rest)).map_or("", |(prefix, _)| prefix)
}

/// A name without the modules that wrap others.
fn unwrapped(name: &str) -> String {
    name.split('.').filter(|part| !WRAPPERS.contains(part)).collect::<Vec<_>>().join(".")
}

impl Naming {
    /// What one of ours may be called: the first name is the disturbance-free project's.
    fn their_names(self, ours: &str) -> Vec<String> {
        match self {
            Self::AllenAct => correspondences()
                .filter_map(|(own, theirs)| Some(format!("{theirs}{}", ours.strip_prefix(&*own)?)))
                .map(|theirs| theirs.replace("action_embedder.weight", "action_embedder.fc.weight"))
                .collect(),
            Self::Checkpoint => vec![format!("{MODEL}{ours}")],
            Self::Ours => vec![ours.to_owned()],
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Imported {
    pub taken: usize,
    /// Ours that the file has nothing for: they start from the seed. Only an auxiliary task's.
    pub fresh: Vec<String>,
    /// The file's that are of an auxiliary task that the configuration does not train.
    pub left_out: Vec<String>,
    /// What the file's names begin with, or have in between, and what is no part of a weight's name.
    pub taken_off: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Named {
    pub theirs: String,
    pub ours: String,
}

impl fmt::Display for Named {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { theirs, ours } = self;
        if theirs == ours { write!(formatter, "`{theirs}`") } else { write!(formatter, "`{theirs}` (here `{ours}`)") }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    #[error("the file holds no weights")]
    Empty,
    #[error("`{0}` is no weight of a network of ours (docs/probe.md has the table of names)")]
    Unknown(String),
    #[error("{0} is there twice: also as `{1}`")]
    Twice(Named, String),
    #[error("nothing is there for `{ours}`: the file has no {}{hint}", alternatives(.theirs))]
    Missing {
        ours: String,
        /// What it could be called in the file.
        theirs: Vec<String>,
        hint: &'static str,
    },
    #[error("there is no place for {0}: the configuration's network has no such weight")]
    NoPlace(Named),
    #[error("{name} {problem}")]
    Unfit { name: Named, problem: String },
    #[error("{0} does not hold floating-point numbers")]
    Kind(Named),
}

fn alternatives(names: &[String]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(" or ")
}

/// Puts a state dict's weights into an agent's state. The optimiser and the beliefs stay as they are. First all names are
/// judged, then all shapes, then all values.
pub fn import(state_dict: &BTreeMap<String, Tensor>, state: &mut AgentState) -> Result<Imported, ImportError> {
    let names = Names::of(state_dict, state);
    let theirs = by_our_names(state_dict, &names)?;
    let goal_first = state_dict.keys().any(|name| names.bare(name).starts_with(GOAL_FIRST));
    let own: BTreeSet<String> =
        state.tensors.keys().filter_map(|name| name.strip_prefix(MODEL)).map(str::to_owned).collect();
    let mut imported = Imported { taken_off: names.taken_off(state_dict.keys()), ..Imported::default() };
    let before = state_dict.keys().next().map(|name| names.before(name)).ok_or(ImportError::Empty)?;
    for ours in own.iter().filter(|ours| !theirs.contains_key(*ours)) {
        if !is_auxiliary(ours) {
            let alternatives = names.naming.their_names(ours).into_iter().map(|name| format!("{before}{name}"));
            let hint = hint(ours, theirs.keys().any(|name| name.starts_with(ENCODER) && !own.contains(name)));
            return Err(ImportError::Missing { ours: ours.clone(), theirs: alternatives.collect(), hint });
        }
        imported.fresh.push(ours.clone());
    }
    for (ours, (theirs, _)) in theirs.iter().filter(|(ours, _)| !own.contains(*ours)) {
        if !is_auxiliary(ours) {
            return Err(ImportError::NoPlace(Named { theirs: theirs.clone(), ours: ours.clone() }));
        }
        imported.left_out.push(ours.clone());
    }
    let mut value = None;
    for (ours, (theirs, tensor)) in theirs.iter().filter(|(ours, _)| own.contains(*ours)) {
        let place = state.tensors.get_mut(&format!("{MODEL}{ours}")).expect("it is one of ours");
        let name = || Named { theirs: theirs.clone(), ours: ours.clone() };
        if !matches!(tensor.kind(), Kind::Float | Kind::Double | Kind::Half | Kind::BFloat16) {
            return Err(ImportError::Kind(name()));
        }
        let tensor = adapt(ours, &tensor.to_kind(Kind::Float), &place.size(), goal_first);
        let (found, wanted) = (tensor.size(), place.size());
        match fits(ours, Some(&tensor), &wanted) {
            Ok(tensor) => *place = tensor.contiguous(),
            Err(Unfit { problem, .. }) if found == wanted => {
                value.get_or_insert(ImportError::Unfit { name: name(), problem });
            }
            Err(Unfit { problem, .. }) => {
                let turned = if found.iter().rev().eq(&wanted) { ": it is transposed" } else { "" };
                return Err(ImportError::Unfit { name: name(), problem: problem + turned });
            }
        }
        imported.taken += 1;
    }
    value.map_or(Ok(imported), Err)
}

fn hint(ours: &str, has_another_encoder: bool) -> &'static str {
    if ours.starts_with("previous_action_embedder") {
        ". These weights are of a network without the previous action (network.previous_action = false)"
    } else if ours.starts_with(ENCODER) && has_another_encoder {
        ". These weights are of another encoder (network.encoder)"
    } else {
        ""
    }
}

fn is_auxiliary(name: &str) -> bool {
    name.starts_with("auxiliary.")
}

/// Pairs of our name and the original name for every tensor; of a checkpoint only the model's tensors.
fn by_our_names(
    state_dict: &BTreeMap<String, Tensor>,
    names: &Names,
) -> Result<BTreeMap<String, (String, Tensor)>, ImportError> {
    let mut renamed: BTreeMap<String, (String, Tensor)> = BTreeMap::new();
    for (theirs, tensor) in state_dict {
        let Some(ours) = names.our_name(theirs) else {
            if names.naming == Naming::Checkpoint {
                continue;
            }
            return Err(ImportError::Unknown(theirs.clone()));
        };
        if let Some((first, _)) = renamed.get(&ours) {
            return Err(ImportError::Twice(Named { theirs: first.clone(), ours }, theirs.clone()));
        }
        renamed.insert(ours, (theirs.clone(), tensor.shallow_clone()));
    }
    Ok(renamed)
}

fn our_name(theirs: &str) -> Option<String> {
    let (ours, rest) = correspondences().find_map(|(ours, prefix)| Some((ours, theirs.strip_prefix(prefix)?)))?;
    // An embedding is wrapped in a module of its own there.
    Some(format!("{ours}{}", rest.replace("action_embedder.fc.", "action_embedder.")))
}

/// What differs in more than the name; see the module's text.
fn adapt(name: &str, tensor: &Tensor, size: &[i64], goal_first: bool) -> Tensor {
    let found = tensor.size();
    match name {
        "previous_action_embedder.weight" if found.first() == Some(&(size[0] - 1)) => {
            // That of Done, the last action of either space.
            Tensor::cat(&[tensor.narrow(0, size[0] - 2, 1), tensor.shallow_clone()], 0)
        }
        "auxiliary.cpca16.action_embedder.weight" if found.first() == Some(&(size[0] + 1)) => {
            tensor.narrow(0, 0, size[0])
        }
        BELIEF_INPUT if goal_first && found == size && size[1] == OBSERVATION => {
            let goal = OBSERVATION - VISUAL;
            Tensor::cat(&[tensor.narrow(1, goal, VISUAL), tensor.narrow(1, 0, goal)], 1)
        }
        _ => tensor.shallow_clone(),
    }
}

/// Advice for a file that is not a safetensors file but one of `torch.save`; none for other files.
pub(crate) fn how_to_convert(file: &Path, bytes: &[u8]) -> Option<String> {
    // A zip archive, or of old versions a bare pickle.
    if !(bytes.starts_with(b"PK\x03\x04") || matches!(bytes, [0x80, 2..=5, ..])) {
        return None;
    }
    let (from, to) = (file.display(), file.with_extension("safetensors"));
    Some(format!(
        "this is a file of torch.save, not safetensors. To convert it (needs the Python packages torch and safetensors): \
         python3 -c \"import torch, safetensors.torch as s; w = torch.load('{from}', map_location='cpu'); \
         s.save_file({{k: v.clone().contiguous() for k, v in w.get('model_state_dict', w.get('state_dict', w)).items()}}, '{}')\"",
        to.display()
    ))
}
