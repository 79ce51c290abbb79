//! Weights from elsewhere: a state dict of AllenAct's `ArmPointNavBaselineActorCritic` (its own, or the one of the
//! disturbance-free project that the paper describes), or weights of another run of ours.
//!
//! The correspondence of names is [`CORRESPONDENCES`], which is also the table in ARCHITECTURE.md. Three tensors differ in
//! more than their name:
//!
//! * **Previous action.** Where AllenAct's table has a row an action and none for "no action yet", an episode's first
//!   observation is given the row of the action that ended the episode before. That is Done, unless the step limit ended
//!   it: our row for "none yet" becomes a copy of Done's.
//! * **CPC|A's action embedding** has a row that AllenAct never looks up, after the last action: it is left out.
//! * **The original baseline** gives the belief the goal's embedding first and the visual one second. Ours is the other way
//!   round: the columns of `weight_ih_l0` change places. (AllenAct's own configuration embeds the goal in 512 numbers;
//!   such weights have no place here, where it is 32, as in the disturbance-free project.)

use crate::agent::{AgentState, MODEL};
use crate::network::{OBSERVATION, Unfit, VISUAL, fits};
use proto::action::{Action, ActionSpace};
use std::collections::{BTreeMap, BTreeSet};
use tch::{Kind, Tensor};

/// Our module path and AllenAct's, both up to and including the dot before what they have in common.
pub const CORRESPONDENCES: [(&str, &str); 19] = [
    ("visual_encoder.backbone.", "visual_encoder.backbone."),
    ("visual_encoder.compression.", "visual_encoder.compression."),
    ("visual_encoder.fc.1.", "visual_encoder.head.1."),
    ("visual_encoder.cnn.0.", "visual_encoder.depth_cnn.conv_0."),
    ("visual_encoder.cnn.2.", "visual_encoder.depth_cnn.conv_1."),
    ("visual_encoder.cnn.4.", "visual_encoder.depth_cnn.conv_2."),
    ("visual_encoder.cnn.6.", "visual_encoder.depth_cnn.fc."),
    ("goal_embedder.0.", "goal_embedder.0.0."),
    ("goal_embedder.2.", "goal_embedder.1.0."),
    ("goal_embedder.0.", "relative_dist_embedding.0.0."),
    ("goal_embedder.2.", "relative_dist_embedding.1.0."),
    ("previous_action_embedder.", "prev_action_embedder.fc."),
    ("belief.", "state_encoders.single_belief.rnn."),
    ("belief.", "state_encoder.rnn."),
    ("actor.", "actor.linear."),
    ("critic.", "critic.fc."),
    ("auxiliary.disturb.", "aux_models.Disturb_Pred.classifier."),
    ("auxiliary.inverse_dynamics.", "aux_models.InvDyn.decoder."),
    ("auxiliary.cpca16.", "aux_models.CPCA_16."),
];

/// AllenAct's goal embedding of the original baseline: where it is there, the goal comes first.
const GOAL_FIRST: &str = "relative_dist_embedding.";

/// Ours, in files of ours.
const OWN_WEIGHT: &str = "belief.weight_ih_l0";

/// What an import did besides copying.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Imported {
    /// Weights taken over.
    pub taken: usize,
    /// Ours that the file has nothing for: they start from the seed. Only an auxiliary task's.
    pub fresh: Vec<String>,
    /// The file's that are of an auxiliary task that the configuration does not train.
    pub left_out: Vec<String>,
}

/// Why a state dict is not one for this network.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A name that means nothing here.
    #[error("`{0}` is no weight of a network of ours (ARCHITECTURE.md has the table of names)")]
    Unknown(String),
    /// Two names for the same weight.
    #[error("`{0}` is there twice, under two names")]
    Twice(String),
    /// A weight of ours that nothing is there for.
    #[error("nothing is there for `{0}`{1}")]
    Missing(String, &'static str),
    /// A weight that the configured network does not have.
    #[error("there is no place for `{0}`: the configuration's network has no such weight")]
    NoPlace(String),
    /// Another shape, or a number that is not finite.
    #[error(transparent)]
    Unfit(#[from] Unfit),
    /// Not floating-point numbers.
    #[error("`{0}` does not hold floating-point numbers")]
    Kind(String),
}

/// Puts a state dict's weights into an agent's state. The optimiser and the beliefs stay as they are.
pub fn import(
    state_dict: &BTreeMap<String, Tensor>,
    space: ActionSpace,
    state: &mut AgentState,
) -> Result<Imported, ImportError> {
    let theirs = by_our_names(state_dict)?;
    let goal_first = state_dict.keys().any(|name| name.starts_with(GOAL_FIRST));
    let mut imported = Imported::default();
    let own: BTreeSet<String> =
        state.tensors.keys().filter_map(|name| name.strip_prefix(MODEL)).map(str::to_owned).collect();
    for name in &own {
        let place = state.tensors.get_mut(&format!("{MODEL}{name}")).expect("the name was taken from there");
        let Some(tensor) = theirs.get(name) else {
            if !is_auxiliary(name) {
                let hint = if name.starts_with("previous_action_embedder") {
                    ": these weights are of a network without the previous action (network.previous_action = false)"
                } else {
                    ""
                };
                return Err(ImportError::Missing(name.clone(), hint));
            }
            imported.fresh.push(name.clone());
            continue;
        };
        if !matches!(tensor.kind(), Kind::Float | Kind::Double | Kind::Half | Kind::BFloat16) {
            return Err(ImportError::Kind(name.clone()));
        }
        let tensor = adapt(name, &tensor.to_kind(Kind::Float), &place.size(), space, goal_first);
        *place = fits(name, Some(&tensor), &place.size())?.contiguous();
        imported.taken += 1;
    }
    for name in theirs.keys().filter(|name| !own.contains(*name)) {
        if !is_auxiliary(name) {
            return Err(ImportError::NoPlace(name.clone()));
        }
        imported.left_out.push(name.clone());
    }
    Ok(imported)
}

fn is_auxiliary(name: &str) -> bool {
    name.starts_with("auxiliary.")
}

/// The state dict under our names; a file of ours as it is, a checkpoint without what is not its model.
fn by_our_names(state_dict: &BTreeMap<String, Tensor>) -> Result<BTreeMap<String, Tensor>, ImportError> {
    let mut renamed = BTreeMap::new();
    let checkpoint = state_dict.contains_key(&format!("{MODEL}{OWN_WEIGHT}"));
    let ours = state_dict.contains_key(OWN_WEIGHT);
    for (name, tensor) in state_dict {
        let own = if checkpoint {
            let Some(own) = name.strip_prefix(MODEL) else { continue };
            own.to_owned()
        } else if ours {
            name.clone()
        } else {
            our_name(name).ok_or_else(|| ImportError::Unknown(name.clone()))?
        };
        if renamed.insert(own, tensor.shallow_clone()).is_some() {
            return Err(ImportError::Twice(name.clone()));
        }
    }
    Ok(renamed)
}

/// Our name of one of AllenAct's.
pub fn our_name(theirs: &str) -> Option<String> {
    let (ours, rest) = CORRESPONDENCES.iter().find_map(|(ours, prefix)| Some((ours, theirs.strip_prefix(prefix)?)))?;
    // An embedding is wrapped in a module of its own there.
    Some(format!("{ours}{}", rest.replace("action_embedder.fc.", "action_embedder.")))
}

/// What differs in more than the name; see the module's text.
fn adapt(name: &str, tensor: &Tensor, size: &[i64], space: ActionSpace, goal_first: bool) -> Tensor {
    let found = tensor.size();
    match name {
        "previous_action_embedder.weight" if found.first().is_some_and(|&rows| rows + 1 == size[0]) => {
            let done = space.actions().iter().position(|&action| action == Action::DoneMidLevel);
            let done = done.expect("every action space has Done") as i64;
            Tensor::cat(&[tensor.narrow(0, done, 1), tensor.shallow_clone()], 0)
        }
        "auxiliary.cpca16.action_embedder.weight" if found.first().is_some_and(|&rows| rows == size[0] + 1) => {
            tensor.narrow(0, 0, size[0])
        }
        OWN_WEIGHT if goal_first && found == size && size[1] == OBSERVATION => {
            let goal = OBSERVATION - VISUAL;
            Tensor::cat(&[tensor.narrow(1, goal, VISUAL), tensor.narrow(1, 0, goal)], 1)
        }
        _ => tensor.shallow_clone(),
    }
}
