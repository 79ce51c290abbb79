//! A batch from a file: a rollout that another program may have collected.

use crate::agent::{ACTING, MODEL};
use crate::checkpoint::TensorsError;
use crate::network::{IMAGES, Kept, Network, Staging, all_finite, coordinates, to_vec};
use crate::ppo::running::STATISTICS;
use crate::rollout::{Outcome, Rollout, Step};
use proto::camera::{DepthFrame, FRAME_SIDE};
use proto::config::Config;
use proto::likeness::nearest;
use proto::stage::RolloutShape;
use proto::task::{ActionHead, PolicyAction};
use std::collections::BTreeMap;
use tch::{Device, Kind, Tensor};

#[derive(Debug)]
pub struct Batch {
    /// What was seen, chosen and got.
    pub rollout: Rollout,
    /// Cell that a contrastive task shows where cell t·N + n was seen; none: drawn.
    pub negatives: Option<Vec<usize>>,
}

const NAMES: [&str; 20] = [
    "frames",
    "goal_m",
    "goal",
    "numbers",
    "previous_action",
    "episode_start",
    "mask",
    "action",
    "log_prob",
    "value",
    "reward",
    "discounted_return",
    "ended",
    "time_limit",
    "last_value",
    "disturbed",
    "bootstrap",
    "beliefs",
    "recorded",
    "negatives",
];

/// What every name may begin with, and most names of a non-finite update's dump do.
const ROLLOUT: &str = "rollout.";

struct Tensors<'a>(&'a BTreeMap<String, Tensor>);

fn wrong(name: &str, problem: String) -> TensorsError {
    TensorsError::Tensor { name: name.to_owned(), problem }
}

impl<'a> Tensors<'a> {
    /// A file's tensors, if each means something here. In a dump the agent's own are beside the batch.
    fn of_batch(file: &'a BTreeMap<String, Tensor>) -> Result<Self, TensorsError> {
        let dump = file.keys().any(|name| name.starts_with(ROLLOUT));
        let of_agent =
            |name: &str| dump && [MODEL, ACTING, "adam.", STATISTICS].iter().any(|own| name.starts_with(own));
        for name in file.keys().filter(|name| !of_agent(name)) {
            let bare = name.strip_prefix(ROLLOUT).unwrap_or(name);
            if !NAMES.contains(&bare) && !bare.starts_with(IMAGES) {
                let near = nearest(bare, NAMES.into_iter());
                let near = near.map_or_else(String::new, |near| format!(" (did you mean `{near}`?)"));
                return Err(wrong(name, format!("means nothing in a batch{near}")));
            }
            if bare != name && file.contains_key(bare) {
                return Err(wrong(name, format!("and {bare} are both there: only one can be meant")));
            }
        }
        Ok(Self(file))
    }

    fn find(&self, name: &str) -> Option<&Tensor> {
        self.0.get(name).or_else(|| self.0.get(&format!("{ROLLOUT}{name}")))
    }

    fn any(&self, name: &str) -> Result<&Tensor, TensorsError> {
        self.find(name).ok_or_else(|| wrong(name, "is missing".to_owned()))
    }

    fn of_size(&self, name: &str, size: &[i64]) -> Result<&Tensor, TensorsError> {
        let tensor = self.any(name)?;
        if tensor.size() == size {
            Ok(tensor)
        } else {
            Err(wrong(name, format!("has shape {:?}, not {size:?}", tensor.size())))
        }
    }

    /// Finite numbers.
    fn floats(&self, name: &str, size: &[i64]) -> Result<Vec<f32>, TensorsError> {
        let values = self.any_floats(name, size)?;
        finite(name, &values, size)?;
        Ok(values)
    }

    fn any_floats(&self, name: &str, size: &[i64]) -> Result<Vec<f32>, TensorsError> {
        let tensor = self.of_size(name, size)?;
        match tensor.kind() {
            Kind::Float => Ok(to_vec(tensor)),
            kind => Err(wrong(name, format!("is {kind:?}, not f32"))),
        }
    }

    /// Whole numbers, each in `range`.
    fn integers(&self, name: &str, size: &[i64], range: std::ops::Range<i64>) -> Result<Vec<i64>, TensorsError> {
        let tensor = self.of_size(name, size)?;
        if !matches!(tensor.kind(), Kind::Int64 | Kind::Int | Kind::Int16 | Kind::Int8 | Kind::Uint8 | Kind::Bool) {
            return Err(wrong(name, format!("is {:?}, not an integer type", tensor.kind())));
        }
        let host = tensor.to_kind(Kind::Int64).contiguous();
        let mut values = vec![0; host.numel()];
        let count = values.len();
        host.copy_data(&mut values, count);
        match values.iter().find(|value| !range.contains(value)) {
            None => Ok(values),
            Some(value) => Err(wrong(name, format!("holds {value}, outside {range:?}"))),
        }
    }

    fn flags(&self, name: &str, size: &[i64]) -> Result<Vec<bool>, TensorsError> {
        Ok(self.integers(name, size, 0..2)?.into_iter().map(|value| value == 1).collect())
    }
}

/// Refuses a number that is not finite; the error contains its position.
fn finite(name: &str, values: &[f32], size: &[i64]) -> Result<(), TensorsError> {
    let Some(place) = values.iter().position(|value| !value.is_finite()) else { return Ok(()) };
    let mut rest = place as i64;
    let mut indices: Vec<i64> = size
        .iter()
        .rev()
        .map(|side| {
            let index = rest % side;
            rest /= side;
            index
        })
        .collect();
    indices.reverse();
    Err(wrong(name, format!("holds {} at {indices:?}: all numbers must be finite", values[place])))
}

/// Warns where an end and the next start do not go together: advantages follow the one, beliefs the other.
fn warn_of_contradictions(ended: &[bool], start: &[bool], columns: usize) {
    // Every cell but those of the last step has a next one.
    let next = start.iter().skip(columns);
    let mut differing = ended.iter().zip(next).enumerate().filter(|(_, (ended, start))| ended != start);
    if let Some((cell, (ended, start))) = differing.next() {
        let (t, n) = (cell / columns, cell % columns);
        tracing::warn!(
            "`ended` contradicts the next step's `episode_start` in {} of the cells, first at step {t} of environment {n}: \
             ended[{t}, {n}] is {ended}, episode_start[{}, {n}] is {start}. Advantages follow `ended`, beliefs \
             `episode_start`",
            1 + differing.count(),
            t + 1,
        );
    }
}

impl Batch {
    pub fn read(file: &BTreeMap<String, Tensor>, config: &Config, network: &Network) -> Result<Self, TensorsError> {
        let file = Tensors::of_batch(file)?;
        let state = network.belief.state();
        let (cells, shape, recorded) = shape(&file)?;
        let [steps, columns] = cells;

        let beliefs = match file.find("beliefs") {
            Some(_) => Tensor::from_slice(&file.floats("beliefs", &[columns, state])?).view([columns, state]),
            None => network.belief.blank(columns, Device::Cpu),
        };
        let device = network.parameters.flat().device();
        let kept = Kept { frames: kept_frames(&file, cells, network)?, images: images(&file, cells, network)? };
        let store = network.store(steps * columns);
        let mut rollout = Rollout::new(shape, columns as usize, store, beliefs.to_device(device));

        let (seen, outcomes) = rows(&file, cells, config)?;
        let every_column: Vec<usize> = (0..columns as usize).collect();
        for (t, seen) in seen.chunks_exact(every_column.len()).enumerate() {
            let kept = kept.map(|part| part.narrow(0, t as i64 * columns, columns));
            rollout.store(t, &every_column, &kept, seen);
        }
        for (cell, outcome) in outcomes.into_iter().enumerate().filter(|&(cell, _)| recorded[cell]) {
            rollout.record(cell / every_column.len(), cell % every_column.len(), outcome);
        }
        if file.find("last_value").is_some() {
            let values = file.any_floats("last_value", &cells)?;
            for (cell, value) in values.into_iter().enumerate().filter(|(_, value)| !value.is_nan()) {
                finite("last_value", &[value], &[1])?;
                rollout.set_last_value(cell / every_column.len(), cell % every_column.len(), value);
            }
        }
        // The last step of a column that held contains the observation after its last action.
        let last = shape.environments_in_last_step;
        let bootstrap = file.any_floats("bootstrap", &[columns])?;
        finite("bootstrap", &bootstrap[..last], &[last as i64])?;
        for (n, value) in bootstrap.into_iter().enumerate().take(last) {
            rollout.set_bootstrap(n, value);
        }

        let frames = shape.frames as i64;
        let negatives = file.find("negatives").map(|_| file.integers("negatives", &cells, 0..frames)).transpose()?;
        let negatives = negatives.map(|shown| shown.into_iter().map(|cell| cell as usize).collect());
        Ok(Self { rollout, negatives })
    }
}

/// Steps and columns, the rollout's shape, and which cells have an outcome.
fn shape(file: &Tensors) -> Result<([i64; 2], RolloutShape, Vec<bool>), TensorsError> {
    let cells = match file.any("action")?.size()[..] {
        [steps, columns] | [steps, columns, _] if steps > 0 && columns > 0 => [steps, columns],
        ref size => return Err(wrong("action", format!("has shape {size:?}, not [T, N]"))),
    };
    let [steps, columns] = cells;
    let recorded = match file.find("recorded") {
        Some(_) => file.flags("recorded", &cells)?,
        None => vec![true; (steps * columns) as usize],
    };
    let frames = recorded.iter().filter(|&&acted| acted).count();
    let last = frames as i64 - (steps - 1) * columns;
    // Recorded cells come first and missing ones last, so their number gives their positions.
    if last < 1 || recorded.iter().take(frames).any(|&acted| !acted) {
        return Err(wrong("recorded", "may be false only for the last environments in the last step".to_owned()));
    }
    let shape = RolloutShape { steps: steps as usize, environments_in_last_step: last as usize, frames: frames as u64 };
    Ok((cells, shape, recorded))
}

/// What was seen and chosen in each cell, and what it led to.
fn rows(file: &Tensors, cells: [i64; 2], config: &Config) -> Result<(Vec<Step>, Vec<Outcome>), TensorsError> {
    let named = config.policy_actions().len() as i64;
    let numbers = numbers(file, cells, config)?;
    let previous = file.integers("previous_action", &cells, 0..named + 1)?;
    let start = file.flags("episode_start", &cells)?;
    let masks = masks(file, cells, config)?;
    let mut actions = actions(file, cells, &config.action_head())?;
    let [log_prob, value, reward] =
        [file.floats("log_prob", &cells)?, file.floats("value", &cells)?, file.floats("reward", &cells)?];
    let [ended, time_limit, disturbed] =
        [file.flags("ended", &cells)?, file.flags("time_limit", &cells)?, file.flags("disturbed", &cells)?];
    warn_of_contradictions(&ended, &start, cells[1] as usize);
    let seen = (0..start.len()).map(|cell| Step {
        numbers: numbers[cell].clone(),
        previous_action: previous[cell],
        episode_start: start[cell],
        mask: masks.get(cell).cloned().unwrap_or_default(),
        action: actions.next(),
        log_prob: log_prob[cell],
        value: value[cell],
        ..Step::default()
    });
    let outcomes = (0..start.len()).map(|cell| Outcome {
        reward: reward[cell],
        ended: ended[cell],
        time_limit: time_limit[cell],
        label: disturbed[cell],
        ..Outcome::default()
    });
    Ok((seen.collect(), outcomes.collect()))
}

/// Which options could be chosen in each cell; nothing in a task without masks.
fn masks(file: &Tensors, [steps, columns]: [i64; 2], config: &Config) -> Result<Vec<Vec<bool>>, TensorsError> {
    let (name, options) = ("mask", config.action_head().outputs());
    if config.spec().mask().is_none() {
        let told = file.find(name).map(|_| wrong(name, "is there, but the task declares none".to_owned()));
        return told.map_or(Ok(vec![]), Err);
    }
    let flags = file.flags(name, &[steps, columns, options as i64])?;
    Ok(flags.chunks_exact(options).map(<[bool]>::to_vec).collect())
}

/// The actions of each cell: of one choice a number, otherwise a row of some.
fn actions(
    file: &Tensors,
    [steps, columns]: [i64; 2],
    head: &ActionHead,
) -> Result<std::vec::IntoIter<PolicyAction>, TensorsError> {
    let choices: Vec<usize> = head.choices().collect();
    let (width, name) = (if head.is_gaussian() { head.outputs() } else { choices.len() }, "action");
    let size = [steps, columns, width as i64];
    let size = if choices.len() == 1 { &size[..2] } else { &size[..] };
    let actions: Vec<PolicyAction> = if head.is_gaussian() {
        let numbers = file.floats(name, size)?;
        numbers.chunks_exact(width).map(|drawn| PolicyAction::Numbers(drawn.to_vec())).collect()
    } else {
        let most = choices.iter().max().copied().unwrap_or(0) as i64;
        let options = file.integers(name, size, 0..most)?;
        let beyond = |(at, &option): (usize, &i64)| option >= choices[at % width] as i64;
        if let Some((at, option)) = options.iter().enumerate().find(|&pair| beyond(pair)) {
            let count = choices[at % width];
            return Err(wrong(name, format!("has {option} as choice {}, which has {count} options", at % width)));
        }
        options.chunks_exact(width).map(|chosen| PolicyAction::Options(chosen.to_vec())).collect()
    };
    Ok(actions.into_iter())
}

/// Frames as the rollout keeps them, \[T · N, side, side\].
fn kept_frames(file: &Tensors, [steps, columns]: [i64; 2], network: &Network) -> Result<Tensor, TensorsError> {
    if network.preparation.side() == 0 {
        return Ok(network.preparation.store(steps * columns));
    }
    let name = "frames";
    let (raw, pooled) = (FRAME_SIDE as i64, network.preparation.side());
    let frames = file.any(name)?;
    let side = frames.size().last().copied().unwrap_or_default();
    if side != raw && side != pooled {
        return Err(wrong(name, format!("has sides of {side} pixels; this network takes {raw}, or {pooled} pooled")));
    }
    let frames = file.of_size(name, &[steps, columns, side, side])?;
    let device = network.parameters.flat().device();
    if side == pooled && pooled < raw {
        let frames = frames.to_kind(Kind::Float);
        if !all_finite(&frames) {
            return Err(wrong(name, "is not finite".to_owned()));
        }
        return Ok(frames.view([-1, side, side]).to_device(device));
    }
    let whole = frames.to_kind(Kind::Int);
    let exact = whole.to_kind(frames.kind()).equal(frames);
    let bounds = [whole.min().int64_value(&[]), whole.max().int64_value(&[])];
    if !exact || bounds[0] < 0 || bounds[1] > i64::from(i16::MAX) {
        return Err(wrong(name, format!("must be whole millimetres from 0 to {}", i16::MAX)));
    }
    let whole = whole.to_kind(Kind::Int16).contiguous();
    let mut pixels = vec![0i16; whole.numel()];
    let count = pixels.len();
    whole.copy_data(&mut pixels, count);
    let depths_mm: Vec<u16> = pixels.into_iter().map(i16::cast_unsigned).collect();
    let (frames, _) = depths_mm.as_chunks::<{ FRAME_SIDE * FRAME_SIDE }>();
    let frames: Vec<_> = frames.iter().map(DepthFrame::Whole).collect();
    Ok(network.preparation.keep(&frames, &mut Staging::default()))
}

/// Images but the frame as the rollout keeps them, \[T · N, bytes\].
fn images(file: &Tensors, [steps, columns]: [i64; 2], network: &Network) -> Result<Tensor, TensorsError> {
    let of_network = |name: &String| {
        let image = name.strip_prefix(ROLLOUT).unwrap_or(name).strip_prefix(IMAGES);
        image.is_none_or(|image| network.images().names().any(|known| known == image))
    };
    if let Some(name) = file.0.keys().find(|name| !of_network(name)) {
        return Err(wrong(name, "is no image of this task".to_owned()));
    }
    let rows = network.images().rows(steps * columns, |name, shape, kind| {
        let name = format!("{IMAGES}{name}");
        let image = file.of_size(&name, &[&[steps, columns], &shape[..]].concat())?;
        if image.kind() != kind {
            return Err(wrong(&name, format!("is {:?}, not {kind:?}", image.kind())));
        }
        if kind == Kind::Float && !all_finite(image) {
            return Err(wrong(&name, "is not finite".to_owned()));
        }
        Ok(image.shallow_clone())
    })?;
    Ok(rows.to_device(network.parameters.flat().device()))
}

/// What the network is given for each cell's numbers. Those beside a frame are the goal.
fn numbers(file: &Tensors, [steps, columns]: [i64; 2], config: &Config) -> Result<Vec<Vec<f32>>, TensorsError> {
    let inputs = config.spec().inputs().expect("a validated configuration's task has what networks take");
    let size = [steps, columns, inputs.width() as i64];
    let rows = |given: &[f32]| -> Vec<_> { given.chunks_exact(inputs.width()).map(<[f32]>::to_vec).collect() };
    if inputs.width() == 0 {
        return Ok(vec![vec![]; (steps * columns) as usize]);
    }
    if inputs.frame.is_none() {
        return Ok(rows(&file.floats("numbers", &size)?));
    }
    match (file.find("goal"), file.find("goal_m")) {
        (Some(_), Some(_)) => Err(wrong("goal", "and goal_m are both there: only one can be meant".to_owned())),
        (Some(_), None) => Ok(rows(&file.floats("goal", &size)?)),
        (None, _) => {
            let given = rows(&file.floats("goal_m", &size)?);
            Ok(given.iter().map(|row| coordinates(config.network.goal, row)).collect())
        }
    }
}
