//! The kernels around the network when it acts (`act.cu`).

use super::map::{address, int, launch};
use crate::ffi::cuda::{Argument, CudaError, Kernel, Module};
use proto::camera::{DepthFrame, FRAME_SIDE, SUMS_SIDE};
use tch::{Kind, Tensor};

/// As in `act.cu`.
const BANDS: i64 = 4;
const SUMS: i64 = 1;
const OBSERVE_THREADS: u32 = 256;
/// Blocks that read from the host's memory beside other work: with more, that waits longer for the GPU's own memory.
const OBSERVE_BLOCKS: i64 = 64;
const CHOOSE_THREADS: u32 = 64;
const KEEP_THREADS: u32 = 128;

/// The kernels.
#[derive(Debug)]
pub struct ActingKernels {
    observe: Kernel,
    choose: Kernel,
    keep: Kernel,
    /// Side of a kept frame, pixels.
    side: i64,
}

/// What was chosen for a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Chosen {
    /// Log-probability of the action.
    pub log_prob: f32,
    /// Value of the observation.
    pub value: f32,
    /// Policy index of the action.
    pub action: usize,
    /// Whether all of the row's log-probabilities and its value are finite.
    pub finite: bool,
}

/// 32-bit numbers of a choice in memory.
pub const CHOSEN_WORDS: usize = 4;

impl Chosen {
    /// From the words that the kernel writes.
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
        Ok(Self {
            observe: module.kernel(c"observe", 0)?,
            choose: module.kernel(c"choose", 0)?,
            keep: module.kernel(c"keep", 0)?,
            side,
        })
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

    /// As the kernel takes it.
    pub fn word(self) -> i64 {
        self.address as i64 + if self.sums { SUMS } else { 0 }
    }
}

impl ActingKernels {
    /// What is read of a frame: its sums where those are what is kept, else all of it.
    pub fn source(&self, frame: &DepthFrame) -> Source {
        match frame.sums_mm.filter(|_| self.side == SUMS_SIDE as i64) {
            Some(sums_mm) => Source { address: sums_mm.as_ptr() as usize, bytes: size_of_val(sums_mm), sums: true },
            None => {
                Source { address: frame.depth_mm.as_ptr() as usize, bytes: size_of_val(frame.depth_mm), sums: false }
            }
        }
    }

    /// Reads frames where `frames` (i64 \[rows\], [`Source::word`]) says, pools them, and writes them to `kept` f32 \[rows, side,
    /// side\] and to the rows `places` (i64 \[rows\]) of `store`. `alone`: nothing else of the step
    /// runs beside it.
    ///
    /// # Safety
    /// When this runs, the addresses must be those of frames in memory that the device may read, on 16 bytes, and the
    /// places rows of the store.
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

    /// Samples actions: log-probabilities and noise \[rows, actions\], values \[rows\] → [`CHOSEN_WORDS`] numbers a row
    /// at `choices`, which may be pinned memory of the host.
    pub fn choose(&self, log_probs: &Tensor, values: &Tensor, noise: &Tensor, choices: &Tensor) {
        let (rows, actions) = log_probs.size2().expect("a row for each observation");
        for (tensor, size) in [(log_probs, vec![rows, actions]), (noise, vec![rows, actions]), (values, vec![rows])] {
            assert!(tensor.kind() == Kind::Float && tensor.size() == size && tensor.is_contiguous());
        }
        assert!(choices.kind() == Kind::Float && choices.size() == [rows, CHOSEN_WORDS as i64]);
        assert!(choices.is_contiguous(), "a row after the other");
        let arguments: [Argument; 6] =
            [address(log_probs), address(values), address(noise), address(choices), int(rows), int(actions)];
        launch(self.choose, rows.div_euclid(i64::from(CHOOSE_THREADS)) + 1, CHOOSE_THREADS, &arguments);
    }

    /// Copies beliefs \[rows, hidden\] to the rows `to` (i64 \[rows\]) of a table. Several may go to a row that nobody
    /// reads.
    ///
    /// # Safety
    /// When this runs, the numbers must be rows of the table.
    pub unsafe fn keep(&self, beliefs: &Tensor, to: &Tensor, table: &Tensor) {
        let (rows, hidden) = beliefs.size2().expect("a row for each observation");
        for tensor in [beliefs, table] {
            assert!(tensor.kind() == Kind::Float && tensor.size()[1..] == [hidden] && tensor.is_contiguous());
        }
        assert!(to.kind() == Kind::Int64 && to.size() == [rows] && to.is_contiguous());
        let arguments = [address(beliefs), address(to), address(table), int(hidden)];
        launch(self.keep, rows, KEEP_THREADS, &arguments);
    }
}
