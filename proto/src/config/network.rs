use serde::{Deserialize, Serialize};
use std::fmt;

/// Visual encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoder {
    /// ResNet18 with GroupNorm, base 32 planes.
    Resnet,
    /// The original three-layer network.
    Cnn,
}

impl Encoder {
    /// About how many weights it has behind this input pooling: what the size of a checkpoint is estimated from.
    pub fn weights(self, input_pool: u32) -> u64 {
        match self {
            Self::Resnet => 4_200_000,
            Self::Cnn => 20_000_000 / u64::from(input_pool).pow(2),
        }
    }

    /// What autograd keeps of one frame behind such a pooling, both directions, bytes; as measured.
    pub fn autograd_bytes(self, input_pool: u32) -> u64 {
        let full_frame: u64 = match self {
            Self::Resnet => 16 << 20,
            Self::Cnn => 3 << 20,
        };
        full_frame / u64::from(input_pool).pow(2)
    }
}

/// How the goal vector is given to the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalCoordinates {
    /// (rho, elevation / (pi/2), azimuth / pi).
    Polar,
    /// (|x|, |y|, |z|), the original baseline.
    Cartesian,
    /// As they are, however many there are.
    Plain,
}

/// What the policy remembers of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Memory {
    /// A gated recurrent unit; actor and critic are one layer each behind it.
    Gru,
    /// An LSTM in its place; its cell is part of the state.
    Lstm,
    /// Nothing. In a task of numbers alone actor and critic have layers of their own.
    None,
}

impl Memory {
    /// Gates of a unit.
    pub fn gates(self) -> u32 {
        match self {
            Self::Gru => 3,
            Self::Lstm => 4,
            Self::None => 0,
        }
    }

    /// Numbers of the state for each number of the belief.
    pub fn states(self) -> u32 {
        match self {
            Self::Gru => 1,
            Self::Lstm => 2,
            Self::None => 0,
        }
    }
}

/// Function after each layer of `mlp`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// Hyperbolic tangent.
    Tanh,
    /// What is below 0 becomes 0.
    Relu,
}

/// Initial weights of `mlp`, actor and critic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum InitialWeights {
    /// Orthogonal; biases are 0.
    Orthogonal,
    /// Uniform within ±1/√inputs, biases too: PyTorch's own.
    Uniform,
}

/// The goal vector while the target is held. Before that it always leads from the wrist to the object.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CarriedGoal {
    /// From the goal to the object, object − goal: the reference's.
    #[default]
    GoalToObject,
    /// From the object to the goal, goal − object.
    ObjectToGoal,
}

impl fmt::Display for CarriedGoal {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::GoalToObject => "goal_to_object",
            Self::ObjectToGoal => "object_to_goal",
        })
    }
}

impl fmt::Display for GoalCoordinates {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Polar => "polar",
            Self::Cartesian => "cartesian",
            Self::Plain => "plain",
        })
    }
}

/// Sides of the squares of pixels that the network can see as one: `network.input_pool`.
pub const INPUT_POOLS: [u32; 3] = [1, 2, 4];

/// The network's shape and inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// Visual encoder, of a task with a frame.
    pub encoder: Encoder,
    /// Side of the average pooling before the encoder: 2 for the paper's resnet, 1 for its cnn.
    pub input_pool: u32,
    /// How the numbers beside the frame are given: `polar` and `cartesian` change the first three, a vector; a task without
    /// a frame needs `plain`.
    pub goal: GoalCoordinates,
    /// Sign of the goal vector while the target is held. A policy trained with one sign is useless with the other.
    pub carried_goal: CarriedGoal,
    /// Feed the previous action's embedding to the belief.
    pub previous_action: bool,
    /// Widths of the layers that see the numbers of a task without a frame. With a memory or images there is one stack of
    /// them, else one for the actor and one for the critic.
    pub mlp: Vec<u32>,
    /// Function after each layer of `mlp`.
    pub activation: Activation,
    /// First weights of these layers, of the actor and of the critic.
    pub initial: InitialWeights,
    /// Logarithm of the standard deviations that a box's numbers begin with.
    pub log_std: f64,
    /// What the policy remembers.
    pub memory: Memory,
    /// Width of the belief (GRU or LSTM).
    pub hidden: u32,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self {
            encoder: Encoder::Resnet,
            input_pool: 2,
            goal: GoalCoordinates::Polar,
            carried_goal: CarriedGoal::GoalToObject,
            previous_action: true,
            mlp: vec![64, 64],
            activation: Activation::Tanh,
            initial: InitialWeights::Orthogonal,
            log_std: 0.0,
            memory: Memory::Gru,
            hidden: 512,
        }
    }
}

impl NetworkConfig {
    /// The sign that the policy sees; none with cartesian coordinates, which are absolute values, or plain numbers.
    pub fn sign_seen(&self) -> Option<CarriedGoal> {
        match self.goal {
            GoalCoordinates::Polar => Some(self.carried_goal),
            GoalCoordinates::Cartesian | GoalCoordinates::Plain => None,
        }
    }
}
