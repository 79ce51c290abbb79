use super::build::Parameter::{Float, Int, Ints};
use super::build::{Builder, Name};
use super::message::{Graph, tensor::Element};
use crate::policy::{IMAGES, MASK, NORMALIZER, Policy, PolicyError};
use proto::camera::FRAME_SIDE;
use proto::config::{Activation, Encoder, GoalCoordinates, Memory, dqn};
use proto::task::{ActionHead, Dtype, Image};
use std::f32::consts::{FRAC_PI_2, PI};
use std::ops::Range;

type Result<T> = std::result::Result<T, PolicyError>;

/// Millimetres to the network's input: (metres - 0.5) / 0.25.
const SCALE: f32 = 1.0 / 250.0;
const OFFSET: f32 = -2.0;

const GROUPS: usize = 16;
const EPSILON: f32 = 1e-5;
/// In place of the logit of an option that a mask forbids.
const FORBIDDEN_LOGIT: f32 = -1e8;
/// Beside the variance of an observation.
const VARIANCE_EPSILON: f32 = 1e-8;
const VISUAL: usize = 512;
const GOAL: [usize; 2] = [100, 32];
const PREVIOUS_ACTION: usize = 16;
/// (outputs, size, stride) of the small encoder's convolutions.
const CNN: [(usize, usize, usize); 3] = [(32, 8, 4), (64, 4, 2), (32, 3, 1)];

struct Maker<'a> {
    policy: &'a Policy,
    builder: Builder,
}

/// Images \[rows, channels, height, width\].
struct Images {
    name: Name,
    channels: usize,
    sides: [usize; 2],
}

#[derive(Clone, Copy)]
struct Convolution {
    outputs: usize,
    size: usize,
    stride: usize,
    padding: usize,
}

pub(super) fn graph(policy: &Policy) -> Result<Graph> {
    let network = &policy.config.network;
    let head = policy.config.action_head();
    let (hidden, actions) = (network.hidden as usize, head.outputs());
    let mut maker = Maker { policy, builder: Builder::new("policy") };
    let numbers = policy.numbers();
    let side = FRAME_SIDE as i64;
    let depth =
        policy.has_frame().then(|| maker.builder.input("depth", Element::Uint16, &[side, side], "Depth, millimetres."));
    let doc = if depth.is_none() {
        "The task's observations, one behind the other; whole numbers as one-hot."
    } else if network.goal == GoalCoordinates::Plain {
        "The task's numbers beside the frame, one observation behind the other; whole numbers as one-hot."
    } else {
        "Where to go, in the robot's frame (x right, y up, z ahead), metres: from the wrist to the object, and while \
         the object is held between object and goal (see carried_goal)."
    };
    let given =
        (numbers > 0).then(|| maker.builder.input(policy.numbers_name(), Element::Float, &[numbers as i64], doc));
    let images: Vec<(Image, Name)> = policy.inputs().images.into_iter().map(|image| maker.image(image)).collect();
    let previous = network.previous_action.then(|| {
        let doc = "The last action's number; the number of actions where an episode begins.";
        maker.builder.input("previous_action", Element::Int64, &[], doc)
    });
    let doc = "Whether each option may be chosen; of several choices side by side.";
    let masked = policy.is_masked();
    let mask = masked.then(|| maker.builder.input(MASK, Element::Bool, &[actions as i64], doc));
    let before = maker.remembered(hidden);

    // Layers that actor and critic share, and those that each has of its own.
    let (mut shared, mut own) = (&network.mlp[..], &[][..]);
    if depth.is_some() {
        shared = &[];
    } else if before.is_empty() && images.is_empty() {
        std::mem::swap(&mut shared, &mut own);
    }
    let (mut parts, mut width) = match (depth, given) {
        (Some(depth), Some(given)) => {
            let frames = maker.frames(&depth, network.input_pool as usize);
            let given = maker.coordinates(network.goal, &given, numbers);
            let given = maker.normalized_numbers(given, numbers)?;
            let parts = vec![maker.encoder(network.encoder, frames)?, maker.goal(&given, numbers)?];
            (parts, VISUAL + GOAL[1])
        }
        (None, Some(given)) => {
            let given = maker.normalized_numbers(given, numbers)?;
            let (seen, width) = maker.layers("mlp", &given, numbers, shared)?;
            (vec![seen], width)
        }
        (_, None) => (vec![], 0),
    };
    for (image, given) in images {
        parts.push(maker.image_encoder(&image, given)?);
        width += dqn::OUTPUTS;
    }
    if let Some(previous) = previous {
        parts.push(maker.previous_action(&previous, actions)?);
        width += PREVIOUS_ACTION;
    }
    maker.builder.part("embedding");
    let embedding = maker.builder.apply("Concat", &parts.iter().collect::<Vec<_>>(), &[Int("axis", 1)]);
    let after = maker.remember(&embedding, &before, [width, hidden])?;
    // The belief comes first.
    let (seen, width) = after.first().map_or((&embedding, width), |belief| (belief, hidden));
    let mut outputs = maker.head("actor", seen, [width, actions], own)?;
    if let Some(mask) = mask {
        let forbidden = maker.builder.float(FORBIDDEN_LOGIT);
        outputs = maker.builder.apply("Where", &[&mask, &outputs, &forbidden], &[]);
    }
    let given = maker.policy(&head, outputs)?;
    let value = maker.value(seen, width, own)?;
    for (output, name, doc) in given {
        maker.builder.output(&output, name, &[actions as i64], doc);
    }
    if let Some(value) = value {
        maker.builder.output(&value, "value", &[], "The critic's estimate of the discounted return.");
    }
    for (name, state) in policy.states().iter().zip(&after) {
        let (next, doc) = (format!("next_{name}"), format!("The {name} for the next step."));
        maker.builder.output(state, &next, &[hidden as i64], &doc);
    }
    Ok(maker.builder.finish())
}

impl Maker<'_> {
    fn policy(&mut self, head: &ActionHead, outputs: Name) -> Result<Vec<(Name, &'static str, &'static str)>> {
        if head.is_gaussian() {
            let log_stds = self.weight("log_std", &[head.outputs()])?;
            let shape = self.builder.apply("Shape", &[&outputs], &[]);
            let log_stds = self.builder.apply("Expand", &[&log_stds, &shape], &[]);
            return Ok(vec![
                (outputs, "means", "Means of the numbers, which environments are given within the bounds."),
                (log_stds, "log_stds", "Logarithms of their standard deviations."),
            ]);
        }
        let (axis, choices) = ([Int("axis", -1)], head.choices().collect::<Vec<_>>());
        let mut log_probs = vec![];
        let mut begin = 0;
        for options in &choices {
            let end = begin + *options as i64;
            let logits = if choices.len() == 1 {
                outputs.clone()
            } else {
                let [from, to, columns] = [begin, end, 1].map(|number| self.builder.integers(&[number]));
                self.builder.apply("Slice", &[&outputs, &from, &to, &columns], &[])
            };
            log_probs.push(self.builder.apply("LogSoftmax", &[&logits], &axis));
            begin = end;
        }
        let beside = match &log_probs[..] {
            [alone] => return Ok(vec![(alone.clone(), "log_probs", "Log-probabilities of the actions.")]),
            several => self.builder.apply("Concat", &several.iter().collect::<Vec<_>>(), &[Int("axis", 1)]),
        };
        Ok(vec![(beside, "log_probs", "Log-probabilities of the options of each choice, side by side.")])
    }

    /// Raw depth \[rows, 224, 224\] to the encoder's input: averaged over `pool` pixels each way, normalised.
    fn frames(&mut self, depth: &Name, pool: usize) -> Images {
        let builder = &mut self.builder;
        builder.part("frames");
        let depth = builder.apply("Cast", &[depth], &[Int("to", Element::Float as i64)]);
        let channel = builder.integers(&[1]);
        let mut frames = builder.apply("Unsqueeze", &[&depth, &channel], &[]);
        if pool > 1 {
            let size = [pool as i64; 2];
            frames = builder.apply("AveragePool", &[&frames], &[Ints("kernel_shape", &size), Ints("strides", &size)]);
        }
        let (scale, offset) = (builder.float(SCALE), builder.float(OFFSET));
        let scaled = builder.apply("Mul", &[&frames, &scale], &[]);
        let name = builder.apply("Add", &[&scaled, &offset], &[]);
        Images { name, channels: 1, sides: [FRAME_SIDE / pool; 2] }
    }

    /// Declares the input of an image, as it was declared.
    fn image(&mut self, image: Image) -> (Image, Name) {
        let (element, doc) = match image.field.dtype {
            Dtype::U16 => (Element::Uint16, "An image of the task's, as it is: 65535 is the brightest."),
            Dtype::F32 => (Element::Float, "An image of the task's, as it is."),
            _ => (Element::Uint8, "An image of the task's, as it is: 255 is the brightest."),
        };
        let shape = image.shape().map(|side| side as i64);
        let name = self.builder.input(&format!("{IMAGES}{}", image.name), element, &shape, doc);
        (image, name)
    }

    /// An image → \[rows, 512\].
    fn image_encoder(&mut self, image: &Image, given: Name) -> Result<Name> {
        let path = format!("{IMAGES}{}", image.name);
        let builder = &mut self.builder;
        builder.part(&path);
        let mut name = given;
        let most = match image.field.dtype {
            Dtype::U16 => Some(f32::from(u16::MAX)),
            Dtype::F32 => None,
            _ => Some(f32::from(u8::MAX)),
        };
        if let Some(most) = most {
            let (numbers, most) =
                (builder.apply("Cast", &[&name], &[Int("to", Element::Float as i64)]), builder.float(most));
            name = builder.apply("Div", &[&numbers, &most], &[]);
        }
        if image.channels_last {
            name = builder.apply("Transpose", &[&name], &[Ints("perm", &[0, 3, 1, 2])]);
        }
        let mut x = Images { name, channels: image.channels, sides: [image.height, image.width] };
        for (index, (outputs, size, stride)) in dqn::CONVOLUTIONS.into_iter().enumerate() {
            let convolution = Convolution { outputs, size, stride, padding: 0 };
            x = self.convolution(&format!("{path}.{}", 2 * index), &x, convolution, true)?;
            x.name = self.builder.apply("Relu", &[&x.name], &[]);
        }
        let flat = self.builder.apply("Flatten", &[&x.name], &[Int("axis", 1)]);
        let inputs = x.channels * x.sides[0] * x.sides[1];
        let seen = self.linear(&format!("{path}.7"), &flat, [inputs, dqn::OUTPUTS])?;
        Ok(self.builder.apply("Relu", &[&seen], &[]))
    }

    /// \[rows, 1, side, side\] → \[rows, 512\].
    fn encoder(&mut self, encoder: Encoder, frames: Images) -> Result<Name> {
        let (linear, features) = match encoder {
            Encoder::Resnet => ("visual_encoder.fc.1", self.resnet(&frames)?),
            Encoder::Cnn => ("visual_encoder.cnn.6", self.cnn(frames)?),
        };
        let flat = self.builder.apply("Flatten", &[&features.name], &[Int("axis", 1)]);
        let inputs = features.channels * features.sides[0] * features.sides[1];
        let visual = self.linear(linear, &flat, [inputs, VISUAL])?;
        Ok(self.builder.apply("Relu", &[&visual], &[]))
    }

    fn cnn(&mut self, frames: Images) -> Result<Images> {
        let mut x = frames;
        for (index, (outputs, size, stride)) in CNN.into_iter().enumerate() {
            // Every second entry of PyTorch's Sequential is a rectifier; none follows the third convolution.
            let path = format!("visual_encoder.cnn.{}", 2 * index);
            x = self.convolution(&path, &x, Convolution { outputs, size, stride, padding: 0 }, true)?;
            if index < 2 {
                x.name = self.builder.apply("Relu", &[&x.name], &[]);
            }
        }
        Ok(x)
    }

    fn resnet(&mut self, frames: &Images) -> Result<Images> {
        let path = "visual_encoder.backbone";
        let stem = Convolution { outputs: 32, size: 7, stride: 2, padding: 3 };
        let mut x = self.normalised(&format!("{path}.conv1"), 0, frames, stem, GROUPS)?;
        x.name = self.builder.apply("Relu", &[&x.name], &[]);
        let parameters = [Ints("kernel_shape", &[3, 3]), Ints("strides", &[2, 2]), Ints("pads", &[1; 4])];
        x.name = self.builder.apply("MaxPool", &[&x.name], &parameters);
        x.sides = x.sides.map(|side| side.div_ceil(2));
        for stage in 0..4 {
            for index in 0..2 {
                let stride = if stage > 0 && index == 0 { 2 } else { 1 };
                x = self.block(&format!("{path}.layer{}.{index}", stage + 1), &x, 32 << stage, stride)?;
            }
        }
        let compression = Convolution { outputs: 128, size: 3, stride: 1, padding: 1 };
        let mut x = self.normalised("visual_encoder.compression", 0, &x, compression, 1)?;
        x.name = self.builder.apply("Relu", &[&x.name], &[]);
        Ok(x)
    }

    fn block(&mut self, path: &str, x: &Images, outputs: usize, stride: usize) -> Result<Images> {
        let convolution = |size, stride| Convolution { outputs, size, stride, padding: size / 2 };
        let mut through = self.normalised(&format!("{path}.convs"), 0, x, convolution(3, stride), GROUPS)?;
        through.name = self.builder.apply("Relu", &[&through.name], &[]);
        let mut through = self.normalised(&format!("{path}.convs"), 3, &through, convolution(3, 1), GROUPS)?;
        let around = if stride != 1 || x.channels != outputs {
            self.normalised(&format!("{path}.downsample"), 0, x, convolution(1, stride), GROUPS)?.name
        } else {
            x.name.clone()
        };
        let sum = self.builder.apply("Add", &[&through.name, &around], &[]);
        through.name = self.builder.apply("Relu", &[&sum], &[]);
        Ok(through)
    }

    /// A convolution without bias, entry `index` of a Sequential, and the group normalisation that follows it.
    fn normalised(
        &mut self,
        path: &str,
        index: usize,
        x: &Images,
        convolution: Convolution,
        groups: usize,
    ) -> Result<Images> {
        let x = self.convolution(&format!("{path}.{index}"), x, convolution, false)?;
        self.group_norm(&format!("{path}.{}", index + 1), &x, groups)
    }

    fn convolution(&mut self, path: &str, x: &Images, of: Convolution, bias: bool) -> Result<Images> {
        self.builder.part(path);
        let shape = [of.outputs, x.channels, of.size, of.size];
        let weight = self.weight(&format!("{path}.weight"), &shape)?;
        let bias = bias.then(|| self.weight(&format!("{path}.bias"), &[of.outputs])).transpose()?;
        let inputs: Vec<&Name> = [&x.name, &weight].into_iter().chain(&bias).collect();
        let parameters = [
            Ints("kernel_shape", &[of.size as i64; 2]),
            Ints("strides", &[of.stride as i64; 2]),
            Ints("pads", &[of.padding as i64; 4]),
        ];
        let name = self.builder.apply("Conv", &inputs, &parameters);
        let sides = x.sides.map(|side| (side + 2 * of.padding - of.size) / of.stride + 1);
        Ok(Images { name, channels: of.outputs, sides })
    }

    /// Group normalisation out of instance normalisation, which more runtimes have: each group is one instance.
    fn group_norm(&mut self, path: &str, x: &Images, groups: usize) -> Result<Images> {
        self.builder.part(path);
        let (channels, [height, width]) = (x.channels as i64, x.sides.map(|side| side as i64));
        // 0 keeps the number of rows.
        let grouped = self.builder.integers(&[0, groups as i64, -1]);
        let back = self.builder.integers(&[0, channels, height, width]);
        let ones = self.builder.floats(&format!("ones.{groups}"), &[groups as i64], &vec![1.0; groups]);
        let zeros = self.builder.floats(&format!("zeros.{groups}"), &[groups as i64], &vec![0.0; groups]);
        let groups = self.builder.apply("Reshape", &[&x.name, &grouped], &[]);
        let parameters = [Float("epsilon", EPSILON)];
        let normal = self.builder.apply("InstanceNormalization", &[&groups, &ones, &zeros], &parameters);
        let normal = self.builder.apply("Reshape", &[&normal, &back], &[]);
        let of_channel = [channels, 1, 1];
        let mut name = normal;
        for (kind, operator) in [("weight", "Mul"), ("bias", "Add")] {
            let weight = format!("{path}.{kind}");
            let values = self.policy.weight(&weight, &[x.channels])?;
            let weight = self.builder.floats(&weight, &of_channel, values);
            name = self.builder.apply(operator, &[&name, &weight], &[]);
        }
        Ok(Images { name, ..*x })
    }

    /// A vector in space comes first, and what is behind it stays.
    fn coordinates(&mut self, coordinates: GoalCoordinates, given: &Name, numbers: usize) -> Name {
        self.builder.part("goal");
        if coordinates == GoalCoordinates::Plain {
            return given.clone();
        }
        let goal = if numbers == 3 { given.clone() } else { self.columns(given, 0..3) };
        let goal = match coordinates {
            GoalCoordinates::Cartesian => self.builder.apply("Abs", &[&goal], &[]),
            GoalCoordinates::Polar | GoalCoordinates::Plain => self.polar(&goal),
        };
        if numbers == 3 {
            return goal;
        }
        let rest = self.columns(given, 3..numbers as i64);
        self.builder.apply("Concat", &[&goal, &rest], &[Int("axis", 1)])
    }

    fn columns(&mut self, of: &Name, range: Range<i64>) -> Name {
        let builder = &mut self.builder;
        let [from, to, axis] = [range.start, range.end, 1].map(|number| builder.integers(&[number]));
        builder.apply("Slice", &[of, &from, &to, &axis], &[])
    }

    /// Less their mean, divided by their deviation and clipped, if the network does so.
    fn normalized_numbers(&mut self, given: Name, numbers: usize) -> Result<Name> {
        let normalize = self.policy.config.normalize;
        if !normalize.observations {
            return Ok(given);
        }
        // Behind those of the policy are those of the critic alone.
        let all = [self.policy.inputs().width()];
        let mean = &self.policy.weight(&format!("{NORMALIZER}running_mean"), &all)?[..numbers];
        let variance = &self.policy.weight(&format!("{NORMALIZER}running_var"), &all)?[..numbers];
        let deviation: Vec<f32> = variance.iter().map(|variance| (variance + VARIANCE_EPSILON).sqrt()).collect();
        let builder = &mut self.builder;
        builder.part("observation_norm");
        let mean = builder.floats("observation_norm.mean", &[numbers as i64], mean);
        let deviation = builder.floats("observation_norm.deviation", &[numbers as i64], &deviation);
        let (least, most) =
            (builder.float(-normalize.observation_clip as f32), builder.float(normalize.observation_clip as f32));
        let apart = builder.apply("Sub", &[&given, &mean], &[]);
        let normal = builder.apply("Div", &[&apart, &deviation], &[]);
        let clipped = builder.apply("Max", &[&normal, &least], &[]);
        Ok(builder.apply("Min", &[&clipped, &most], &[]))
    }

    /// Goal as the network is given it \[rows, numbers\] → \[rows, 32\].
    fn goal(&mut self, given: &Name, numbers: usize) -> Result<Name> {
        let first = self.linear("goal_embedder.0", given, [numbers, GOAL[0]])?;
        let rectified = self.builder.apply("LeakyRelu", &[&first], &[Float("alpha", 0.01)]);
        self.linear("goal_embedder.2", &rectified, GOAL)
    }

    /// (ρ, elevation / (π/2), azimuth / π) with elevation = atan2(z, hypot(x, y)) and azimuth = atan2(y, x).
    fn polar(&mut self, goal: &Name) -> Name {
        let [x, y, z] = [0, 1, 2].map(|index| self.columns(goal, index..index + 1));
        let builder = &mut self.builder;
        let mut norm = |of: &[&Name]| {
            let squares: Vec<Name> = of.iter().map(|axis| builder.apply("Mul", &[axis, axis], &[])).collect();
            let sum = builder.apply("Sum", &squares.iter().collect::<Vec<_>>(), &[]);
            builder.apply("Sqrt", &[&sum], &[])
        };
        let (distance, level) = (norm(&[&x, &y, &z]), norm(&[&x, &y]));
        let (elevation, azimuth) = (self.atan2(&z, &level), self.atan2(&y, &x));
        let builder = &mut self.builder;
        let (quarter, half) = (builder.float(FRAC_PI_2), builder.float(PI));
        let elevation = builder.apply("Div", &[&elevation, &quarter], &[]);
        let azimuth = builder.apply("Div", &[&azimuth, &half], &[]);
        builder.apply("Concat", &[&distance, &elevation, &azimuth], &[Int("axis", 1)])
    }

    /// ONNX has no atan2: the arc tangent of the smaller part by the larger one, in the right eighth of the circle.
    fn atan2(&mut self, y: &Name, x: &Name) -> Name {
        let builder = &mut self.builder;
        let (across, along) = (builder.apply("Abs", &[y], &[]), builder.apply("Abs", &[x], &[]));
        let small = builder.apply("Min", &[&across, &along], &[]);
        let large = builder.apply("Max", &[&across, &along], &[]);
        // Nothing by nothing is nothing.
        let least = builder.float(f32::MIN_POSITIVE);
        let large = builder.apply("Max", &[&large, &least], &[]);
        let ratio = builder.apply("Div", &[&small, &large], &[]);
        let angle = builder.apply("Atan", &[&ratio], &[]);
        let (quarter, half, zero) = (builder.float(FRAC_PI_2), builder.float(PI), builder.float(0.0));
        let steep = builder.apply("Greater", &[&across, &along], &[]);
        let other = builder.apply("Sub", &[&quarter, &angle], &[]);
        let angle = builder.apply("Where", &[&steep, &other, &angle], &[]);
        let behind = builder.apply("Less", &[x, &zero], &[]);
        let other = builder.apply("Sub", &[&half, &angle], &[]);
        let angle = builder.apply("Where", &[&behind, &other, &angle], &[]);
        let below = builder.apply("Less", &[y, &zero], &[]);
        let other = builder.apply("Neg", &[&angle], &[]);
        builder.apply("Where", &[&below, &other, &angle], &[])
    }

    /// The last action's number → \[rows, 16\].
    fn previous_action(&mut self, previous: &Name, actions: usize) -> Result<Name> {
        let path = "previous_action_embedder.weight";
        self.builder.part(path);
        let table = self.policy.weight(path, &[actions + 1, PREVIOUS_ACTION])?;
        // In the table "none yet" is the first row, in observations the last number.
        let (none, rows) = table.split_at(PREVIOUS_ACTION);
        let table = [rows, none].concat();
        let table = self.builder.floats(path, &[actions as i64 + 1, PREVIOUS_ACTION as i64], &table);
        Ok(self.builder.apply("Gather", &[&table, previous], &[Int("axis", 0)]))
    }

    /// Inputs of what is remembered, each \[rows, hidden\]: the belief first.
    fn remembered(&mut self, hidden: usize) -> Vec<Name> {
        let input = |name: &&str| {
            let doc =
                format!("Of what is remembered: zeros where an episode begins, then next_{name} of the step before.");
            self.builder.input(name, Element::Float, &[hidden as i64], &doc)
        };
        self.policy.states().iter().map(input).collect()
    }

    /// The critic's value \[rows\], unless it is given more than the model is.
    fn value(&mut self, seen: &Name, width: usize, own: &[u32]) -> Result<Option<Name>> {
        if !self.policy.has_value() {
            return Ok(None);
        }
        let value = self.head("critic", seen, [width, 1], own)?;
        let last = self.builder.integers(&[1]);
        Ok(Some(self.builder.apply("Squeeze", &[&value, &last], &[])))
    }

    /// One step of a GRU or LSTM: embedding \[rows, inputs\] and states \[rows, hidden\] → states, the belief first; none
    /// without memory.
    fn remember(&mut self, embedding: &Name, before: &[Name], [inputs, hidden]: [usize; 2]) -> Result<Vec<Name>> {
        self.builder.part("belief");
        // As in PyTorch the reset gate works on the product, bias included.
        let parameters = [Int("hidden_size", hidden as i64), Int("linear_before_reset", 1)];
        // PyTorch's gates (reset, update, new; input, forget, cell, output) in ONNX's order (update, reset, new; input,
        // output, forget, cell).
        let (operator, parameters, order) = match self.policy.config.network.memory {
            Memory::Gru => ("GRU", &parameters[..], &[1, 0, 2][..]),
            Memory::Lstm => ("LSTM", &parameters[..1], &[0, 3, 1, 2][..]),
            Memory::None => return Ok(vec![]),
        };
        let rows = order.len() * hidden;
        let in_order = |gates: &[f32]| -> Vec<f32> {
            let each: Vec<&[f32]> = gates.chunks_exact(gates.len() / order.len()).collect();
            order.iter().flat_map(|&gate: &usize| each[gate]).copied().collect()
        };
        let mut matrix = |name: &str, columns: usize| -> Result<Name> {
            let path = format!("belief.{name}");
            let values = in_order(self.policy.weight(&path, &[rows, columns])?);
            Ok(self.builder.floats(&path, &[1, rows as i64, columns as i64], &values))
        };
        let (input, recurrent) = (matrix("weight_ih_l0", inputs)?, matrix("weight_hh_l0", hidden)?);
        let bias: Vec<f32> = ["bias_ih_l0", "bias_hh_l0"]
            .map(|name| Ok(in_order(self.policy.weight(&format!("belief.{name}"), &[rows])?)))
            .into_iter()
            .collect::<Result<Vec<_>>>()?
            .concat();
        let builder = &mut self.builder;
        let bias = builder.floats("belief.bias", &[1, 2 * rows as i64], &bias);
        let first = builder.integers(&[0]);
        let sequence = builder.apply("Unsqueeze", &[embedding, &first], &[]);
        let before: Vec<Name> = before.iter().map(|state| builder.apply("Unsqueeze", &[state, &first], &[])).collect();
        let none = Builder::none();
        let inputs: Vec<&Name> = [&sequence, &input, &recurrent, &bias, &none].into_iter().chain(&before).collect();
        let after = builder.apply_rest(operator, &inputs, parameters, &["", ".cell"][..before.len()]);
        Ok(after.iter().map(|state| builder.apply("Squeeze", &[state, &first], &[])).collect())
    }

    /// Layers with an activation behind each, and the width of what comes out: every second entry of a Sequential.
    fn layers(&mut self, path: &str, x: &Name, inputs: usize, widths: &[u32]) -> Result<(Name, usize)> {
        let activation = match self.policy.config.network.activation {
            Activation::Tanh => "Tanh",
            Activation::Relu => "Relu",
        };
        let mut end = (x.clone(), inputs);
        for (index, &width) in widths.iter().enumerate() {
            let layer = self.linear(&format!("{path}.{}", 2 * index), &end.0, [end.1, width as usize])?;
            end = (self.builder.apply(activation, &[&layer], &[]), width as usize);
        }
        Ok(end)
    }

    /// A linear layer behind such layers, if it has some of its own.
    fn head(&mut self, path: &str, x: &Name, [inputs, outputs]: [usize; 2], own: &[u32]) -> Result<Name> {
        let (x, inputs) = self.layers(path, x, inputs, own)?;
        let path = if own.is_empty() { path.to_owned() } else { format!("{path}.{}", 2 * own.len()) };
        self.linear(&path, &x, [inputs, outputs])
    }

    fn linear(&mut self, path: &str, x: &Name, [inputs, outputs]: [usize; 2]) -> Result<Name> {
        self.builder.part(path);
        let weight = self.weight(&format!("{path}.weight"), &[outputs, inputs])?;
        let bias = self.weight(&format!("{path}.bias"), &[outputs])?;
        Ok(self.builder.apply("Gemm", &[x, &weight, &bias], &[Int("transB", 1)]))
    }

    fn weight(&mut self, name: &str, shape: &[usize]) -> Result<Name> {
        let values = self.policy.weight(name, shape)?;
        let shape: Vec<i64> = shape.iter().map(|&size| size as i64).collect();
        Ok(self.builder.floats(name, &shape, values))
    }
}
