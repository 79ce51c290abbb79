//! The tensor file of a checkpoint: safetensors, so that any tool can read the weights out of it.
//!
//! | name | what |
//! |---|---|
//! | whatever [`crate::agent::AgentState`] names | weights, with `ppo.overlap` also those that act, moments, beliefs |
//! | `environment.episode` | u32 (N): episode number of each column |
//! | `environment.action_count` | u32 (N): actions taken in it |
//! | `environment.actions` | u8: bytes of those actions, one column's behind the other's; of older versions (N, 512), those actions, then zeros |
//! | `environment.action_bytes` | u32 (1): bytes of an action, if they are not 1 |
//! | `environment.states` | u8: the same as a restore holds it, with hashes and snapshots, where there are some |
//! | `running.return` | f64 (N): return of the episode in progress |
//! | `running.discounted_disturbance_m` | f64 (N): Σ `γ^t` cost of the episode in progress, by its name of older versions |
//! | `running.discounted_return` | f64 (N): sum of its rewards, each discounted by its age; of older versions 0 |
//! | `running.metrics` | f64 (N, M): its metrics, in the task's order; 0 in checkpoints of older versions |

use crate::collector::{Boundary, RunningEpisode};
use crate::network::Unfit;
use proto::episode::MAX_EPISODE_STEPS;
use proto::record::HOLD;
use proto::task::NUMBERS_MOST;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::BTreeMap;
use tch::{Kind, Tensor};
use wire::message::EnvironmentState;

const EPISODE: &str = "environment.episode";
const ACTION_COUNT: &str = "environment.action_count";
const ACTIONS: &str = "environment.actions";
const ACTION_BYTES: &str = "environment.action_bytes";
const STATES: &str = "environment.states";
const RETURN: &str = "running.return";
const DISCOUNTED_RETURN: &str = "running.discounted_return";
const METRICS: &str = "running.metrics";
/// Of older versions.
const PICKED_UP: &str = "running.picked_up";
const DISCOUNTED_DISTURBANCE: &str = "running.discounted_disturbance_m";
const ACTION_BYTES_MOST: usize = 4 * NUMBERS_MOST as usize;
const EPISODE_MOST: u32 = u32::MAX / 2;
const OWN: [&str; 10] = [
    EPISODE,
    ACTION_COUNT,
    ACTIONS,
    ACTION_BYTES,
    STATES,
    RETURN,
    DISCOUNTED_RETURN,
    DISCOUNTED_DISTURBANCE,
    METRICS,
    PICKED_UP,
];

#[derive(Debug, thiserror::Error)]
pub enum TensorsError {
    #[error("not a safetensors file: {0}")]
    Format(#[from] safetensors::SafeTensorError),
    #[error("libtorch: {0}")]
    Torch(#[from] tch::TchError),
    #[error("tensor `{name}` {problem}")]
    Tensor { name: String, problem: String },
}

impl From<Unfit> for TensorsError {
    fn from(Unfit { name, problem }: Unfit) -> Self {
        Self::Tensor { name, problem }
    }
}

fn wrong(name: &str, problem: impl Into<String>) -> TensorsError {
    TensorsError::Tensor { name: name.to_owned(), problem: problem.into() }
}

struct StoredTensor {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

pub fn encode_tensors(tensors: &BTreeMap<String, Tensor>) -> Result<Vec<u8>, TensorsError> {
    serialize(&entries(tensors)?)
}

/// The tensors of a safetensors file by name; of a checkpoint, those that are the agent's.
pub fn decode_tensors(bytes: &[u8]) -> Result<BTreeMap<String, Tensor>, TensorsError> {
    agents_tensors(&SafeTensors::deserialize(bytes)?)
}

fn agents_tensors(file: &SafeTensors) -> Result<BTreeMap<String, Tensor>, TensorsError> {
    let mut tensors = BTreeMap::new();
    for (name, view) in file.iter().filter(|(name, _)| !OWN.contains(name)) {
        let kind = kind_of(view.dtype()).ok_or_else(|| wrong(name, format!("has type {:?}", view.dtype())))?;
        let size: Vec<i64> = view.shape().iter().map(|&side| side as i64).collect();
        tensors.insert(name.to_owned(), Tensor::f_from_data_size(view.data(), &size, kind)?);
    }
    Ok(tensors)
}

/// The whole state as the bytes of a safetensors file. Numbers are little-endian.
pub fn encode(tensors: &BTreeMap<String, Tensor>, boundary: &Boundary) -> Result<Vec<u8>, TensorsError> {
    let mut entries = entries(tensors)?;
    let columns = boundary.environments.len();
    let mut own =
        |name: &str, dtype, shape, bytes| match entries.insert(name.to_owned(), StoredTensor { dtype, shape, bytes }) {
            None => Ok(()),
            Some(_) => Err(wrong(name, "is the agent's: the name is taken")),
        };
    let states = &boundary.environments;
    let running = &boundary.running;
    own(EPISODE, Dtype::U32, vec![columns], states.iter().flat_map(|state| state.episode.to_le_bytes()).collect())?;
    let counts = states.iter().flat_map(|state| state.action_count().to_le_bytes());
    own(ACTION_COUNT, Dtype::U32, vec![columns], counts.collect())?;
    let actions: Vec<u8> = states.iter().flat_map(EnvironmentState::actions).copied().collect();
    own(ACTIONS, Dtype::U8, vec![actions.len()], actions)?;
    let bytes = states.iter().map(|state| state.last_action().len()).max().unwrap_or(0);
    if bytes > 1 {
        own(ACTION_BYTES, Dtype::U32, vec![1], (bytes as u32).to_le_bytes().to_vec())?;
    }
    if states.iter().any(|state| state.hash_before().is_some()) {
        let bytes = EnvironmentState::encode(states);
        own(STATES, Dtype::U8, vec![bytes.len()], bytes)?;
    }
    let mut column_of = |name: &str, figure: fn(&RunningEpisode) -> f64| {
        own(name, Dtype::F64, vec![columns], running.iter().flat_map(|episode| figure(episode).to_le_bytes()).collect())
    };
    column_of(RETURN, |episode| episode.episode_return)?;
    column_of(DISCOUNTED_RETURN, |episode| episode.discounted_return)?;
    column_of(DISCOUNTED_DISTURBANCE, |episode| episode.discounted_cost)?;
    // An episode without a step has none yet.
    let count = running.iter().map(|episode| episode.metrics.len()).max().unwrap_or(0);
    let metric = |episode: &RunningEpisode, index: usize| episode.metrics.get(index).copied().unwrap_or(0.0);
    let metrics = running.iter().flat_map(|episode| (0..count).map(move |index| metric(episode, index)));
    own(METRICS, Dtype::F64, vec![columns, count], metrics.flat_map(f64::to_le_bytes).collect())?;
    serialize(&entries)
}

/// Actions of each column, by how many it has, and bytes of an action: all have as many.
fn split_actions<'a>(file: &SafeTensors<'a>, counts: &[u32]) -> Result<(Vec<&'a [u8]>, usize), TensorsError> {
    let mut bytes = own_bytes(file, ACTIONS, Dtype::U8)?;
    // Of older versions: room for as many as an episode could have then.
    let room = match file.tensor(ACTIONS)?.shape() {
        [_, room] => Some(*room),
        _ => None,
    };
    let each = match file.tensor(ACTION_BYTES) {
        Ok(_) => u32s(own_bytes(file, ACTION_BYTES, Dtype::U32)?)[..].try_into().map_or(0, |[each]: [u32; 1]| each),
        Err(_) => 1,
    };
    let each = Some(each as usize).filter(|each| (1..=ACTION_BYTES_MOST).contains(each));
    let each = each.ok_or_else(|| wrong(ACTION_BYTES, "is no number of bytes that actions have"))?;
    let count = |count: &u32| usize::try_from(*count).ok().filter(|&count| count <= MAX_EPISODE_STEPS);
    let mut split = Vec::with_capacity(counts.len());
    for claimed in counts {
        let too_many = || wrong(ACTION_COUNT, format!("has {claimed} actions in one episode"));
        let count = count(claimed).ok_or_else(too_many)?;
        let own = bytes.split_off(..room.unwrap_or(count * each));
        let own = own.ok_or_else(|| wrong(ACTIONS, "is not of as many actions as are counted"))?;
        split.push(own.get(..count * each).ok_or_else(too_many)?);
    }
    if bytes.is_empty() { Ok((split, each)) } else { Err(wrong(ACTIONS, "is not of as many actions as are counted")) }
}

/// What [`encode`] wrote, of environments that stood at `exchange`.
pub fn decode(bytes: &[u8], exchange: u64) -> Result<(BTreeMap<String, Tensor>, Boundary), TensorsError> {
    let file = SafeTensors::deserialize(bytes)?;
    let episodes = u32s(own_bytes(&file, EPISODE, Dtype::U32)?);
    let columns = episodes.len();
    let counts = u32s(own_bytes(&file, ACTION_COUNT, Dtype::U32)?);
    let returns = own_bytes(&file, RETURN, Dtype::F64)?;
    let disturbances = own_bytes(&file, DISCOUNTED_DISTURBANCE, Dtype::F64)?;
    // Older versions have none.
    let or_none = |name: &str| file.tensor(name).map_or(Ok(&[][..]), |_| own_bytes(&file, name, Dtype::F64));
    let (metrics, discounted) = (or_none(METRICS)?, or_none(DISCOUNTED_RETURN)?);
    let without = vec![0; columns * 8];
    let discounted = if discounted.is_empty() { &without } else { discounted };
    let metrics: Vec<f64> = metrics.as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect();
    let count = metrics.len().checked_div(columns).unwrap_or(0);
    for (name, found, expected) in [
        (ACTION_COUNT, counts.len(), columns),
        (RETURN, returns.len(), columns * 8),
        (DISCOUNTED_RETURN, discounted.len(), columns * 8),
        (DISCOUNTED_DISTURBANCE, disturbances.len(), columns * 8),
        (METRICS, metrics.len(), columns * count),
    ] {
        if found != expected {
            return Err(wrong(name, format!("is not of {columns} environments")));
        }
    }
    let (split, each) = split_actions(&file, &counts)?;
    let states = match file.tensor(STATES) {
        Ok(_) => EnvironmentState::decode(own_bytes(&file, STATES, Dtype::U8)?, each),
        Err(_) => Ok(vec![]),
    };
    let states = states.map_err(|cause| wrong(STATES, cause.to_string()))?;
    if !states.is_empty() && states.len() != columns {
        return Err(wrong(STATES, format!("is not of {columns} environments")));
    }
    let mut boundary = Boundary { exchange, environments: vec![], running: vec![] };
    for (column, actions) in split.into_iter().enumerate() {
        let state = EnvironmentState::after(episodes[column], actions, each);
        // The next episode's number must exist, too.
        if state.episode > EPISODE_MOST {
            return Err(wrong(EPISODE, format!("has an episode {}, and no run gets so far", state.episode)));
        }
        // The actor refuses what its task has not.
        if let Some(action) = actions.iter().find(|&&action| each == 1 && action >= HOLD) {
            return Err(wrong(ACTIONS, format!("has an action {action}: there is none")));
        }
        match states.get(column) {
            Some(whole) if (whole.episode, whole.actions()) == (state.episode, actions) => {
                boundary.environments.push(whole.clone());
            }
            None if states.is_empty() => boundary.environments.push(state),
            _ => return Err(wrong(STATES, format!("is of other episodes than {EPISODE} and {ACTIONS}"))),
        }
        let figure = |bytes: &[u8]| {
            let mut value = [0; 8];
            value.copy_from_slice(&bytes[column * 8..][..8]);
            f64::from_le_bytes(value)
        };
        let figures @ [episode_return, discounted_return, discounted_cost] =
            [returns, discounted, disturbances].map(figure);
        if !figures.into_iter().all(f64::is_finite) {
            return Err(wrong(RETURN, "or the cost is not finite"));
        }
        let metrics = metrics[column * count..][..count].to_vec();
        if !metrics.iter().all(|metric| metric.is_finite()) {
            return Err(wrong(METRICS, "has one that is not finite"));
        }
        boundary.running.push(RunningEpisode { episode_return, discounted_cost, discounted_return, metrics });
    }
    Ok((agents_tensors(&file)?, boundary))
}

fn entries(tensors: &BTreeMap<String, Tensor>) -> Result<BTreeMap<String, StoredTensor>, TensorsError> {
    let mut entries = BTreeMap::new();
    for (name, tensor) in tensors {
        let kind = tensor.f_kind()?;
        let dtype = dtype_of(kind).ok_or_else(|| wrong(name, format!("has type {kind:?}, which has no place here")))?;
        let tensor = tensor.f_to_device(tch::Device::Cpu)?.f_contiguous()?;
        let mut bytes = vec![0; tensor.numel() * kind.elt_size_in_bytes()];
        tensor.f_copy_data_u8(&mut bytes, tensor.numel())?;
        let shape = tensor.size().into_iter().map(|side| side as usize).collect();
        entries.insert(name.clone(), StoredTensor { dtype, shape, bytes });
    }
    Ok(entries)
}

fn serialize(entries: &BTreeMap<String, StoredTensor>) -> Result<Vec<u8>, TensorsError> {
    let views = entries
        .iter()
        .map(|(name, entry)| Ok((name, TensorView::new(entry.dtype, entry.shape.clone(), &entry.bytes)?)))
        .collect::<Result<Vec<_>, safetensors::SafeTensorError>>()?;
    Ok(safetensors::serialize(views, None)?)
}

fn own_bytes<'a>(file: &SafeTensors<'a>, name: &str, dtype: Dtype) -> Result<&'a [u8], TensorsError> {
    let view = file.tensor(name).map_err(|_| wrong(name, "is missing"))?;
    if view.dtype() == dtype { Ok(view.data()) } else { Err(wrong(name, format!("has type {:?}", view.dtype()))) }
}

fn u32s(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]])).collect()
}

fn dtype_of(kind: Kind) -> Option<Dtype> {
    KINDS.iter().find(|(known, _)| *known == kind).map(|(_, dtype)| *dtype)
}

fn kind_of(dtype: Dtype) -> Option<Kind> {
    KINDS.iter().find(|(_, known)| *known == dtype).map(|(kind, _)| *kind)
}

const KINDS: [(Kind, Dtype); 9] = [
    (Kind::Float, Dtype::F32),
    (Kind::Double, Dtype::F64),
    (Kind::Half, Dtype::F16),
    (Kind::BFloat16, Dtype::BF16),
    (Kind::Int64, Dtype::I64),
    (Kind::Int, Dtype::I32),
    (Kind::Int16, Dtype::I16),
    (Kind::Uint8, Dtype::U8),
    (Kind::Bool, Dtype::BOOL),
];
