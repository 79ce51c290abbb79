//! The kernels around the encoder when the network acts (`act.cu`).

use super::map::{address, int, launch};
use crate::ffi::cuda::{Argument, CudaError, Kernel, Module};
use proto::camera::{DepthFrame, FRAME_SIDE, SUMS_SIDE};
use tch::{Kind, Tensor};

/// A frame's address is a multiple of this, bytes: the kernel reads it as `uint4`.
const ALIGNMENT: usize = 16;
/// As in `act.cu`.
const BANDS: i64 = 4;
const SUMS: i64 = 1;
const OBSERVE_THREADS: u32 = 256;
/// Blocks that read from the host's memory beside other work: with more, that waits longer for the GPU's own memory.
const OBSERVE_BLOCKS: i64 = 64;
const DECIDE_THREADS: u32 = 256;
/// As in `act.cu`.
const MAX_HIDDEN: i64 = 4096;
const MAX_ACTIONS: i64 = 32;
const MAX_OUTPUTS: i64 = 1024;

#[derive(Debug)]
pub struct ActingKernels {
    observe: Kernel,
    decide: Kernel,
    /// Side of a kept frame, pixels.
    side: i64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chosen {
    pub log_prob: f32,
    pub value: f32,
    pub action: usize,
    /// Whether all of the row's log-probabilities and its value are finite.
    pub finite: bool,
}

/// What decides: biases of the belief's gates \[gates · hidden\], from what is seen and from the belief before; weights
/// and biases of actor \[actions, hidden\] and critic \[1, hidden\]. All f32.
#[derive(Debug)]
pub struct Heads<'a> {
    pub gate_biases: [&'a Tensor; 2],
    pub actor: [&'a Tensor; 2],
    pub critic: [&'a Tensor; 2],
    /// Logarithms of deviations \[actions\] of a policy that draws numbers.
    pub log_std: Option<&'a Tensor>,
}

/// What is decided about: what the gates get from what was seen, and from the belief before, \[rows, gates · hidden\];
/// the state before \[rows, state\], of an LSTM twice as wide as the belief; noise \[rows, actions\]. All f32.
#[derive(Debug)]
pub struct Undecided<'a> {
    pub from_input: &'a Tensor,
    pub from_before: &'a Tensor,
    pub before: &'a Tensor,
    pub noise: &'a Tensor,
}

/// 32-bit numbers of a choice in memory.
pub const CHOSEN_WORDS: usize = 4;

impl Chosen {
    pub fn from_words(words: &[f32]) -> Self {
        Self {
            log_prob: words[0],
            value: words[1],
            action: words[2].to_bits() as usize,
            finite: words[3].to_bits() != 0,
        }
    }
}

impl ActingKernels {
    pub(super) fn find(module: &Module, side: i64) -> Result<Self, CudaError> {
        Ok(Self { observe: module.kernel(c"observe", 0)?, decide: module.kernel(c"decide", 0)?, side })
    }
}

/// Where [`ActingKernels::observe`] finds what it needs of a frame, and how many bytes that is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Source {
    address: usize,
    bytes: usize,
    sums: bool,
}

impl Source {
    /// What lies at one address in the host's memory, and as long.
    pub fn bytes(self) -> (usize, usize) {
        (self.address, self.bytes)
    }

    pub fn word(self) -> i64 {
        self.address as i64 + if self.sums { SUMS } else { 0 }
    }
}

impl ActingKernels {
    /// What is read of a frame: all that is there. Panics if there are sums of other windows than what is kept, or the
    /// frame's address is not a multiple of 16, as it is in an observation.
    pub fn source(&self, frame: &DepthFrame) -> Source {
        let sums = matches!(frame, DepthFrame::Sums(_));
        assert!(!sums || self.side == SUMS_SIDE as i64, "sums are of the windows that are averaged over");
        let numbers = frame.numbers();
        assert!((numbers.as_ptr() as usize).is_multiple_of(ALIGNMENT), "frames are read by 16 bytes");
        Source { address: numbers.as_ptr() as usize, bytes: size_of_val(numbers), sums }
    }

    /// Reads frames where `frames` (i64 \[rows\], [`Source::word`]) says, pools them, and writes them to `kept` f32
    /// \[rows, side, side\] and to the rows `places` (i64 \[rows\]) of `store`. `alone`: nothing else of the step runs
    /// beside it.
    ///
    /// # Safety
    /// When this runs, the addresses must be those of frames in memory that the device may read, and the places rows of
    /// the store.
    pub unsafe fn observe(&self, frames: &Tensor, places: &Tensor, kept: &Tensor, store: &Tensor, alone: bool) {
        let (rows, side, _) = kept.size3().expect("frames have three dimensions");
        let raw = side == FRAME_SIDE as i64;
        assert!(kept.kind() == Kind::Float && side == self.side && kept.is_contiguous());
        assert!(store.kind() == if raw { Kind::Int16 } else { Kind::Float } && store.size()[1..] == [side, side]);
        for tensor in [frames, places] {
            assert!(tensor.kind() == Kind::Int64 && tensor.size() == [rows] && tensor.is_contiguous());
        }
        let arguments = [address(frames), address(places), address(kept), address(store), int(rows)];
        let most = if alone { i64::MAX } else { OBSERVE_BLOCKS };
        launch(self.observe, (rows * BANDS).min(most), OBSERVE_THREADS, &arguments);
    }

    /// Whether [`Self::decide`] chooses among so many options.
    pub fn can_choose(options: usize) -> bool {
        options <= MAX_ACTIONS as usize
    }

    /// Belief, policy and value of each row, and the action that is chosen: [`CHOSEN_WORDS`] numbers a row at
    /// `choices`, which may be pinned memory of the host. States go to the rows `to` (i64 \[rows\]) of a table \[..,
    /// state\]; several may go to a row that nobody reads.
    ///
    /// # Safety
    /// When this runs, `to` must hold rows of the table.
    pub unsafe fn decide(&self, heads: &Heads, row: &Undecided, to: &Tensor, table: &Tensor, choices: &Tensor) {
        let [rows, actions] = [row.before, heads.actor[0]].map(|tensor| tensor.size()[0]);
        assert!(actions <= MAX_ACTIONS, "other actions are chosen elsewhere");
        assert!(choices.size() == [rows, CHOSEN_WORDS as i64]);
        self.launch_decide(heads, row, (to, table), choices, [address(choices), Argument::Address(0)]);
    }

    /// The same without a choice: at `outputs` a row has what the actor gives, the logarithms of standard deviations if there are
    /// some, and the value.
    ///
    /// # Safety
    /// As [`Self::decide`].
    pub unsafe fn answer(&self, heads: &Heads, row: &Undecided, to: &Tensor, table: &Tensor, outputs: &Tensor) {
        let [rows, actions] = [row.before, heads.actor[0]].map(|tensor| tensor.size()[0]);
        let each = if heads.log_std.is_some() { 2 } else { 1 };
        assert!(outputs.size() == [rows, each * actions + 1]);
        self.launch_decide(heads, row, (to, table), outputs, [Argument::Address(0), address(outputs)]);
    }

    /// `addresses`: where choices go, and where outputs do; one of them is none.
    fn launch_decide(
        &self,
        heads: &Heads,
        row: &Undecided,
        (to, table): (&Tensor, &Tensor),
        written: &Tensor,
        [choices, outputs]: [Argument; 2],
    ) {
        let (rows, state) = row.before.size2().expect("a row for each observation");
        let (actions, hidden) = heads.actor[0].size2().expect("a row for each output");
        assert!(state == hidden || state == 2 * hidden, "a GRU's state, or an LSTM's");
        let gates = if state == hidden { 3 } else { 4 } * hidden;
        assert!(hidden <= MAX_HIDDEN && actions <= MAX_OUTPUTS, "the configuration admits no more");
        let log_std = heads.log_std.map_or(Argument::Address(0), |tensor| {
            assert!(tensor.kind() == Kind::Float && tensor.size() == [actions] && tensor.is_contiguous());
            address(tensor)
        });
        let floats = [
            (row.from_input, vec![rows, gates]),
            (row.from_before, vec![rows, gates]),
            (row.before, vec![rows, state]),
            (heads.gate_biases[0], vec![gates]),
            (heads.gate_biases[1], vec![gates]),
            (heads.actor[0], vec![actions, hidden]),
            (heads.actor[1], vec![actions]),
            (heads.critic[0], vec![1, hidden]),
            (heads.critic[1], vec![1]),
            (row.noise, vec![rows, actions]),
        ];
        for (tensor, size) in &floats {
            assert!(tensor.kind() == Kind::Float && tensor.size() == *size && tensor.is_contiguous());
        }
        assert!(to.kind() == Kind::Int64 && to.size() == [rows] && to.is_contiguous());
        assert!(table.kind() == Kind::Float && table.size()[1..] == [state] && table.is_contiguous());
        assert!(written.kind() == Kind::Float && written.is_contiguous(), "a row after the other");
        let mut arguments: Vec<Argument> = floats.iter().map(|(tensor, _)| address(tensor)).collect();
        arguments.extend([
            address(to),
            address(table),
            choices,
            int(hidden),
            int(state),
            int(actions),
            outputs,
            log_std,
        ]);
        launch(self.decide, rows, DECIDE_THREADS, &arguments);
    }
}
