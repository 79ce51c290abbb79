//! The configuration of a run: data, validated, written whole into every run folder.
//!
//! The effective configuration is: the defaults in this file, overlaid by a named preset (and the preset it extends),
//! overlaid by the user's TOML file, overlaid by single settings (`--set`), overlaid by command-line flags.
//! [`Config::resolve_set`] does all but the last.

mod changes;
mod conditions;
pub mod dqn;
mod environment;
mod episode;
mod error;
mod experiment;
mod kitchens;
mod machine;
mod network;
mod normalize;
mod place;
mod preset;
mod presets;
mod remedy;
mod resolve;
mod reward;
mod setting;
mod task;
mod validate;

pub use changes::{Difference, Lists, differences};
pub use environment::EnvironmentConfig;
pub use episode::EpisodeConfig;
pub use error::{ConfigError, problem_of};
pub use kitchens::{KitchenSource, KitchensConfig};
pub use machine::MachineConfig;
pub use network::{
    Activation, CarriedGoal, Encoder, GoalCoordinates, INPUT_POOLS, InitialWeights, Memory, NetworkConfig,
};
pub use normalize::NormalizeConfig;
pub use preset::{Preset, overlay};
pub use presets::presets;
pub use reward::{LagrangianConfig, RewardConfig};
pub use setting::{Setting, SettingError, check_settings, frames_in};

use crate::evaluation::{EvaluationConfig, ObjectSet, Plan};
use crate::kitchen::Kitchens;
use crate::kitchen_schedule::KitchenSchedule;
use crate::shares::Shares;
use crate::task::Reward;
use serde::{Deserialize, Serialize};

/// Everything that determines a run. The defaults are the paper's constants (`docs/method.md`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Name of the preset this came from.
    pub preset: String,
    /// Seed of everything random.
    pub seed: u64,
    /// What is learned: the name of a task.
    pub task: String,
    /// The environments of a task that is not built in; `orchestrator up --env` writes it.
    pub environment: Option<EnvironmentConfig>,
    /// Scene files (`scene.toml`) to train in instead of the training kitchens: actor i simulates scene i, repeating
    /// after the last. Relative to the working directory; a run folder's configuration names its own copies, relative
    /// to itself.
    pub scenes: Vec<String>,
    /// Procedural kitchens instead of the training kitchens.
    pub kitchens: KitchensConfig,
    /// Processes and environments.
    pub actors: ActorsConfig,
    /// Physics.
    pub simulation: SimulationConfig,
    /// Episodes.
    pub episode: EpisodeConfig,
    /// Network.
    pub network: NetworkConfig,
    /// DD-PPO.
    pub ppo: PpoConfig,
    /// Observations and rewards, normalised by what was met so far.
    pub normalize: NormalizeConfig,
    /// Reward weights.
    #[serde(default)]
    pub reward: RewardConfig,
    /// Rewards beside those of the task, for stages to name (docs/own-parts.md).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rewards: Vec<Reward>,
    /// Auxiliary task.
    pub auxiliary: AuxiliaryConfig,
    /// Settings of the learner processes.
    pub learner: LearnerConfig,
    /// Where processes run.
    pub machine: MachineConfig,
    /// Checkpoints.
    pub checkpoint: CheckpointConfig,
    /// MCAP recording.
    pub recording: RecordingConfig,
    /// Evaluations on the validation kitchens while the run trains.
    pub validation: ValidationConfig,
    /// Set in the configuration of a run that `orchestrator up --from` starts from another's weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from: Option<FromConfig>,
    /// Set in the configuration of an evaluation, which `orchestrator eval` writes; a run has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub evaluation: Option<EvaluationConfig>,
    /// The curriculum, in order.
    pub stages: Vec<StageConfig>,
}

/// How many actor processes and environments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ActorsConfig {
    /// Actor processes. Actor i simulates training kitchen i, repeating after 19; with `scenes` scene i; in an
    /// evaluation kitchen i of the split. With procedural kitchens each environment has its own.
    pub count: u32,
    /// Environments in each.
    pub environments_per_actor: u32,
}

/// The physics of a step.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SimulationConfig {
    /// Length of a physics sub-step, seconds.
    pub timestep_s: f32,
    /// Sub-steps of one action.
    pub substeps: u32,
}

/// DD-PPO.
// Independent settings, not a state machine.
#[allow(clippy::struct_excessive_bools)]
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PpoConfig {
    /// Steps of a rollout.
    pub rollout_steps: u32,
    /// Passes over each rollout.
    pub epochs: u32,
    /// Clip range of the policy ratio and of the value at a stage's start.
    pub clip: f64,
    /// What it falls to, as a share of itself, as the learning rate does.
    pub clip_end: f64,
    /// Clip the value's change in its loss, too.
    pub clip_value: bool,
    /// No further epoch of an update begins after one whose last minibatch has an approximate KL divergence from the
    /// policy that acted above this. 0 = all epochs.
    pub target_kl: f64,
    /// Weight of the value loss.
    pub value_coefficient: f64,
    /// Weight of the entropy bonus at a stage's start.
    pub entropy_coefficient: f64,
    /// What that weight falls to, as a share of itself, as the learning rate does.
    pub entropy_coefficient_end: f64,
    /// Adam's learning rate at a stage's start.
    pub learning_rate: f64,
    /// What the learning rate falls to, as a share of the one at a stage's start; linear in between.
    pub learning_rate_end: f64,
    /// Frames of a stage after which it has fallen to that; it stays there. 0 = the stage's own frames. `--frames` leaves
    /// it as it is.
    pub learning_rate_frames: u64,
    /// What Adam adds to the root of the second moment.
    pub adam_epsilon: f64,
    /// Global gradient norm is clipped at this.
    pub max_gradient_norm: f64,
    /// Discount per step.
    pub gamma: f64,
    /// Lambda of generalised advantage estimation.
    pub gae_lambda: f64,
    /// Normalise advantages over the rollout ("Original" in the paper's tables).
    pub normalize_advantages: bool,
    /// With `normalize_advantages`: over each minibatch alone. `false`: over the whole rollout.
    pub normalize_by_minibatch: bool,
    /// Treat an end by the step limit as a truncation: the last action's advantage contains the value of the observation
    /// after it (in a task with images: before it). The paper's code treats such an end as any other.
    pub bootstrap_time_limits: bool,
    /// Environments that go through forward and backward at once; gradients add up to those of the whole batch.
    /// 0 = all, or with `learner.shards` all of a shard. A smaller number bounds memory.
    pub environments_per_pass: u32,
    /// Minibatches of a rollout, each a step of the optimiser: every learner, or shard, deals its frames out among
    /// them. 1 = all in one, as in the paper.
    pub minibatches: u32,
    /// What is dealt out among minibatches.
    pub shuffle: Shuffle,
    /// With several learners: share of them that must have finished a rollout for the others to end theirs early (0.6
    /// in DD-PPO). Results then depend on timing, and a stage's last rollouts may have few frames. 0 = all learners
    /// finish.
    pub preemption_share: f64,
    /// Collect the next rollout while the update of the last one runs: always with the weights from before that update,
    /// so results still do not depend on timing. Faster, above all on a GPU; but a rollout is one update older than in
    /// the paper's DD-PPO.
    pub overlap: bool,
}

/// What is dealt out among minibatches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shuffle {
    /// Whole environments, anew for each rollout.
    Environments,
    /// Single frames, anew for each epoch; whole environments with one minibatch, and where memory or an auxiliary task
    /// needs what follows on one another.
    Rows,
}

/// Which auxiliary task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AuxiliaryTask {
    /// None.
    None,
    /// Disturbance prediction with focal loss, the paper's.
    Disturb,
    /// Which action led from one observation to the next.
    InverseDynamics,
    /// CPC|A: contrastive prediction of the next 16 observations.
    Cpca16,
}

/// The auxiliary task.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AuxiliaryConfig {
    /// Which auxiliary task.
    pub task: AuxiliaryTask,
    /// Its weight in the loss.
    pub weight: f64,
    /// Focusing parameter of the focal loss of `disturb`.
    pub focal_gamma: f64,
    /// Share of the valid samples that `inverse_dynamics` and `cpca16` use in an epoch.
    pub subsample: f64,
}

/// Where the learner computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DeviceChoice {
    /// CUDA if there is a device, else the CPU.
    Auto,
    /// The CPU.
    Cpu,
    /// CUDA; an error if there is none.
    Cuda,
}

/// Arithmetic on the CPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CpuArithmetic {
    /// To the same last bit on every x86-64 processor with AVX2.
    Reproducible,
    /// As fast as this processor can. Another processor gives other last bits.
    Fastest,
}

/// Number format of the visual encoder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EncoderPrecision {
    /// `bfloat16` for resnet on a CUDA device, else `float32`.
    Auto,
    /// 32 bits throughout, as libtorch computes them.
    Float32,
    /// 16-bit bfloat numbers with 32-bit sums, on a CUDA device: resnet by kernels of our own, and images beside a frame.
    /// Weights, gradients and everything after the encoder keep 32 bits.
    Bfloat16,
}

/// Settings of the learner processes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LearnerConfig {
    /// Learner processes, each with its part of the actors. At every step of the optimiser they sum their gradients, so
    /// all have the same weights (DD-PPO). Without `shards` these differ from the weights of one learner with all
    /// actors: in the last bits, with `cpca16` in more. On CUDA learner i computes on device i.
    pub count: u32,
    /// In how many parts the actors are computed, one after another. With 8 parts 1, 2, 4 and 8 learners train the same
    /// weights, bit for bit (on GPUs of one kind). `count` must then be a power of two, and at most this. Smaller parts
    /// take longer. 0 = each learner computes its actors as one part.
    pub shards: u32,
    /// Where it computes.
    pub device: DeviceChoice,
    /// Whether the CPU's results are the same on every processor.
    pub cpu: CpuArithmetic,
    /// What the visual encoder computes in.
    pub encoder_precision: EncoderPrecision,
    /// On CUDA: only algorithms that give the same bits every time, so that the same seed gives the same weights on the
    /// same kind of GPU with the same number of learners (or the same `shards`), killed or not.
    pub deterministic: bool,
    /// Threads of libtorch on the CPU, of each learner. Results differ in the last bits between thread counts.
    pub threads: u32,
    /// An actor that gives no answer for this long, seconds, is killed and starts again. In the kitchens it is killed
    /// after ten times the longest of the last rollouts, if that is less.
    pub actor_deadline_s: f64,
    /// Learners that finish neither a rollout nor an update are killed and start again: after ten times as long as the
    /// last ones took, but not before this time, seconds. An actor in the kitchens has at least half of this time for an
    /// answer.
    pub progress_deadline_s: f64,
}

/// Checkpoints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// At the first rollout boundary after this many seconds, and at every stage's end and stop.
    pub interval_s: f64,
    /// Newest checkpoints to keep, besides one at each stage's end.
    pub keep: u32,
}

/// MCAP recording.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// Whether to record.
    pub enabled: bool,
    /// Share of episodes whose depth frames are kept.
    pub depth_share: f64,
    /// Only episodes that end without success: each is held back until its end is known. Without depth frames.
    pub failures_only: bool,
    /// A new segment is begun after this many bytes.
    pub segment_bytes: u64,
    /// Whether the figures of rollouts and validations are written as TensorBoard event files, too; also where
    /// `enabled` is not set.
    pub tensorboard: bool,
}

/// Evaluations on the validation kitchens while the run trains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ValidationConfig {
    /// At the first rollout boundary after each multiple of this many frames; 0 = never.
    pub every_frames: u64,
    /// How many episodes of each kitchen and object set, from the first; 0 = all.
    pub episodes: u32,
    /// Which targets.
    pub objects: ObjectSet,
    /// Actor processes.
    pub actors: u32,
}

/// The weights that a run begins with. Optimiser, environments and frame count start from zero.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FromConfig {
    /// Absolute path of the checkpoint's manifest.
    pub checkpoint: String,
    /// Frames that the weights were trained on.
    pub frames: u64,
    /// SHA-256 of the weights, 64 hex digits.
    pub weights: String,
    /// Stages that the weights were trained in, in order; none in runs of older versions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stages: Vec<StageConfig>,
}

impl Config {
    /// Every stage that the weights have behind them at the run's end, those of the run it began from included.
    pub fn whole_curriculum(&self) -> Vec<StageConfig> {
        let before = self.from.iter().flat_map(|from| &from.stages);
        before.chain(&self.stages).cloned().collect()
    }
}

/// One stage of the curriculum.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageConfig {
    /// Name, as it appears in logs and figures.
    pub name: String,
    /// Reward to optimise: one of the task's, or of `rewards`.
    pub reward: String,
    /// Frames to train on.
    pub frames: u64,
}

impl Default for Config {
    fn default() -> Self {
        let mut config = Self {
            preset: "paper".into(),
            seed: 1,
            task: "arm_point_nav".into(),
            environment: None,
            scenes: Vec::new(),
            kitchens: KitchensConfig::default(),
            actors: ActorsConfig::default(),
            simulation: SimulationConfig::default(),
            episode: EpisodeConfig::default(),
            network: NetworkConfig::default(),
            ppo: PpoConfig::default(),
            normalize: NormalizeConfig::default(),
            reward: RewardConfig::default(),
            rewards: Vec::new(),
            auxiliary: AuxiliaryConfig::default(),
            learner: LearnerConfig::default(),
            machine: MachineConfig::default(),
            checkpoint: CheckpointConfig::default(),
            recording: RecordingConfig::default(),
            validation: ValidationConfig::default(),
            from: None,
            evaluation: None,
            stages: vec![
                StageConfig { name: "I".into(), reward: "r".into(), frames: 20_000_000 },
                StageConfig { name: "II".into(), reward: "r_prime".into(), frames: 25_000_000 },
            ],
        };
        config.complete_weights();
        config
    }
}

impl Default for ActorsConfig {
    fn default() -> Self {
        Self { count: 19, environments_per_actor: 1 }
    }
}

impl Default for SimulationConfig {
    fn default() -> Self {
        Self { timestep_s: 1.0 / 60.0, substeps: 10 }
    }
}

impl Default for PpoConfig {
    fn default() -> Self {
        Self {
            rollout_steps: 200,
            epochs: 4,
            clip: 0.1,
            clip_end: 1.0,
            clip_value: true,
            target_kl: 0.0,
            value_coefficient: 0.5,
            entropy_coefficient: 0.01,
            entropy_coefficient_end: 1.0,
            learning_rate: 3e-4,
            learning_rate_end: 1.0 / 3.0,
            learning_rate_frames: 30_000_000,
            adam_epsilon: 1e-8,
            max_gradient_norm: 0.5,
            gamma: 0.99,
            gae_lambda: 0.95,
            normalize_advantages: false,
            normalize_by_minibatch: false,
            bootstrap_time_limits: false,
            environments_per_pass: 0,
            minibatches: 1,
            shuffle: Shuffle::Environments,
            preemption_share: 0.0,
            overlap: false,
        }
    }
}

impl Default for AuxiliaryConfig {
    fn default() -> Self {
        Self { task: AuxiliaryTask::Disturb, weight: 0.1, focal_gamma: 2.0, subsample: 0.2 }
    }
}

impl Default for LearnerConfig {
    fn default() -> Self {
        Self {
            count: 1,
            shards: 0,
            device: DeviceChoice::Auto,
            cpu: CpuArithmetic::Reproducible,
            encoder_precision: EncoderPrecision::Auto,
            deterministic: true,
            threads: 1,
            actor_deadline_s: 60.0,
            progress_deadline_s: 60.0,
        }
    }
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { interval_s: 300.0, keep: 2 }
    }
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self { enabled: true, depth_share: 0.001, failures_only: false, segment_bytes: 256 << 20, tensorboard: true }
    }
}

impl Default for ValidationConfig {
    fn default() -> Self {
        Self { every_frames: 0, episodes: 60, objects: ObjectSet::Novel, actors: 5 }
    }
}

impl ValidationConfig {
    /// Whether an evaluation is due when the frame count goes from `before` to `after`.
    pub fn is_due(&self, before: u64, after: u64) -> bool {
        self.every_frames > 0 && before / self.every_frames < after / self.every_frames
    }
}

impl Config {
    /// Kitchens that the actors simulate. Environments that are not built in are in none.
    pub fn kitchens(&self) -> Kitchens {
        if self.environment.is_some() {
            return Kitchens::Elsewhere;
        }
        match (&self.evaluation, self.kitchens.range(), self.scenes.len()) {
            (Some(evaluation), _, _) => evaluation.kitchens(),
            (None, Some(range), _) => Kitchens::Procedural(range),
            (None, None, 0) => Kitchens::TRAINING,
            (None, None, scenes) => Kitchens::Scenes(scenes),
        }
    }

    /// Which kitchen every environment plays each of its episodes in.
    pub fn kitchen_schedule(&self) -> KitchenSchedule {
        match (self.kitchens(), self.evaluation_plan()) {
            (Kitchens::Procedural(_), Some(plan)) => KitchenSchedule::planned(plan),
            (Kitchens::Procedural(range), None) => {
                KitchenSchedule::drawn(self.seed, range, self.kitchens.episodes_each)
            }
            (Kitchens::Split(_) | Kitchens::One(_) | Kitchens::Scenes(_) | Kitchens::Elsewhere, _) => {
                KitchenSchedule::settled()
            }
        }
    }

    /// How an evaluation's episodes are dealt out; none of a run.
    pub fn evaluation_plan(&self) -> Option<Plan> {
        let ActorsConfig { count, environments_per_actor } = self.actors;
        self.evaluation.as_ref().map(|evaluation| Plan::new(evaluation, count, environments_per_actor))
    }

    /// Environments of the whole run.
    pub fn environments(&self) -> usize {
        self.actors.count as usize * self.actors.environments_per_actor as usize
    }

    /// An upper bound of an update's time, seconds. It assumes ten frames a second and epoch, a tenth of the speed of
    /// one old core with the larger network.
    pub fn longest_update_s(&self) -> f64 {
        let rollout_frames = self.environments() as f64 * f64::from(self.ppo.rollout_steps);
        (rollout_frames * f64::from(self.ppo.epochs) / 10.0).max(600.0)
    }

    /// What is dealt out among minibatches in a run of this network.
    pub fn shuffle(&self) -> Shuffle {
        let alone = self.network.memory == Memory::None && self.auxiliary.task == AuxiliaryTask::None;
        // All that is there is in the only minibatch, whatever is dealt.
        if alone && self.ppo.minibatches > 1 { self.ppo.shuffle } else { Shuffle::Environments }
    }

    /// The actors, divided among the learners. Panics if the configuration was not validated.
    pub fn shares(&self) -> Shares {
        self.shares_among(self.actors.count)
    }

    /// The same if there were so many actors. Panics if that were too few, or the configuration was not validated.
    pub fn shares_among(&self, actors: u32) -> Shares {
        match self.learner.shards {
            0 => Shares::new(actors, self.learner.count),
            shards => Shares::in_shards(actors, self.learner.count, shards),
        }
    }

    /// The fewest actors that its learners can have.
    pub fn fewest_actors(&self) -> u32 {
        self.learner.count.max(self.learner.shards)
    }
}
