//! The kernels of group normalisation (`norm.cu`).

use super::map::{Affine, Statistics, address, int, launch, map, optional, over_rows, shape};
use crate::ffi::cuda::{CudaError, Kernel, Module};
use std::ffi::CString;
use tch::{Kind, Tensor};

/// Bytes of eight channels of a pixel, the unit that a thread works on.
const OCTET_BYTES: i64 = 16;
const PAIR_BYTES: i64 = 8;

#[derive(Debug)]
pub struct NormKernels {
    /// Forward and backward that keep maps in shared memory, then those that read them twice, for groups of 2, of 4 and
    /// of 8 or more channels.
    kernels: [[[Kernel; 2]; 3]; 2],
    /// A block that keeps its maps takes so much shared memory at most, bytes.
    most_kept_bytes: i64,
}

/// What a norm's result goes through before it is the output.
#[derive(Debug, Clone, Copy)]
pub enum Then<'a> {
    Nothing,
    Relu,
    /// The addition of what goes around the norm, and a ReLU, which made this output.
    AddAndRelu(&'a Tensor),
}

#[derive(Debug)]
pub struct NormGradients {
    /// Of its input, a feature map.
    pub input: Tensor,
    /// Of bias and weight, f32 \[2, channels\].
    pub affine: Tensor,
}

/// How one block works on one row.
struct Work {
    threads: u32,
    kernel: Kernel,
}

impl NormKernels {
    pub(super) fn find(module: &Module) -> Result<Self, CudaError> {
        let most_shared_bytes = module.most_shared_bytes()?;
        // Two blocks a multiprocessor at least: one waits for its maps while another works. Each takes a KiB more.
        let most_kept_bytes = most_shared_bytes / 2 - 1024;
        let find = |direction: &str, maps: &str, group: u8| {
            let name = CString::new(format!("norm_{direction}_{maps}_{group}")).expect("letters and digits");
            module.kernel(&name, most_kept_bytes)
        };
        let pair = |maps, group| -> Result<_, CudaError> {
            Ok([find("forward", maps, group)?, find("backward", maps, group)?])
        };
        let by_group = |maps| -> Result<_, CudaError> { Ok([pair(maps, 2)?, pair(maps, 4)?, pair(maps, 8)?]) };
        Ok(Self { kernels: [by_group("kept")?, by_group("reread")?], most_kept_bytes: most_kept_bytes.into() })
    }

    /// For rows of so many pixels, of which a block keeps so many maps, forward or backward.
    fn work(&self, pixels: i64, channels: i64, groups: i64, maps: i64, backward: bool) -> Work {
        let octets = pixels * channels / 8;
        let threads = threads(octets);
        let sums_of_channels = if backward { channels + 8 } else { 0 };
        let sums_bytes = threads / 32 * (sums_of_channels + groups) * PAIR_BYTES;
        let kept_bytes = maps * octets * OCTET_BYTES + sums_bytes;
        let keep = kept_bytes <= self.most_kept_bytes;
        let [two, four, eight] = &self.kernels[usize::from(!keep)];
        let pair = match channels / groups {
            2 => two,
            4 => four,
            channels => {
                assert!(channels >= 8 && channels & (channels - 1) == 0, "groups of {channels} channels");
                eight
            }
        };
        let bytes = u32::try_from(if keep { kept_bytes } else { sums_bytes }).expect("less than a multiprocessor has");
        Work { threads: threads as u32, kernel: pair[usize::from(backward)].with_shared_bytes(bytes) }
    }

    /// `relu?(norm(x) + around?)`.
    pub fn forward(&self, x: &Tensor, around: Option<&Tensor>, norm: Affine, relu: bool) -> (Tensor, Statistics) {
        let [rows, channels, height, width] = shape(x);
        let y = map(x, shape(x));
        let statistics = norm.statistics(x);
        let work = self.work(height * width, channels, norm.groups, 1 + i64::from(around.is_some()), false);
        launch(
            work.kernel,
            rows,
            work.threads,
            &[
                address(x),
                optional(around, shape(x)),
                address(norm.weight),
                address(norm.bias),
                address(&y),
                address(&statistics),
                int(height * width),
                int(channels),
                int(norm.groups),
                int(relu.into()),
            ],
        );
        (y, Statistics(statistics))
    }

    /// Gradients of [`NormKernels::forward`] for those of its output's users, one or two; where something was added,
    /// also the gradient of that.
    pub fn backward(
        &self,
        dy: [Option<&Tensor>; 2],
        then: Then,
        x: &Tensor,
        statistics: &Statistics,
        norm: Affine,
    ) -> (NormGradients, Option<Tensor>) {
        let shape = shape(x);
        let [rows, channels, height, width] = shape;
        let dx = map(x, shape);
        let affine = Tensor::empty([rows, 2, channels], (Kind::Float, x.device()));
        let [first, second] = dy.map(|dy| optional(dy, shape));
        assert!(dy[0].is_some(), "somebody uses the output");
        let (relu, output) = match then {
            Then::Nothing => (0, None),
            Then::Relu => (1, None),
            Then::AddAndRelu(output) => (2, Some(output)),
        };
        let around = output.map(|_| map(x, shape));
        let maps = 2 + i64::from(dy[1].is_some()) + i64::from(output.is_some());
        let work = self.work(height * width, channels, norm.groups, maps, true);
        launch(
            work.kernel,
            rows,
            work.threads,
            &[
                first,
                second,
                optional(output, shape),
                address(x),
                address(&statistics.0),
                address(norm.weight),
                address(norm.bias),
                address(&dx),
                optional(around.as_ref(), shape),
                address(&affine),
                int(height * width),
                int(channels),
                int(norm.groups),
                int(relu),
            ],
        );
        (NormGradients { input: dx, affine: over_rows(&affine) }, around)
    }
}

/// Threads of a block, one block a row, for so many octets: at least six for each thread, so that many small rows are
/// in work at once, and whole warps. Part of the order of sums, so the same on every device.
fn threads(octets: i64) -> i64 {
    [256, 128, 64].into_iter().find(|threads| octets >= 6 * threads).unwrap_or(32)
}
