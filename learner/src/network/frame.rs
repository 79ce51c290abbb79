//! Depth frames on their way into the network: 16-bit millimetres → average pooling → normalised metres.
//!
//! Pooling comes first and its result is what a rollout keeps: with the paper's 2 × 2 pooling that is half the bytes of
//! the raw frame and saves pooling again in every epoch. Without pooling the raw 16-bit frame is kept. The mean of
//! 16-bit numbers over 1, 4 or 16 pixels is exact in f32, so the CPU's and the GPU's way give the same bits.

use crate::ffi::{self, FrameRoom};
use proto::camera::{DepthFrame, FRAME_PIXELS, FRAME_SIDE, WINDOW};
use proto::config::Config;
use tch::{Device, Kind, Tensor};

/// Subtracted from a depth in metres before the division (`docs/method.md`, Observation).
const MEAN_M: f64 = 0.5;
/// Divides a depth in metres.
const DEVIATION_M: f64 = 0.25;

/// Millimetres · scale + offset = the network's input.
const SCALE: f64 = 1.0 / (1000.0 * DEVIATION_M);
const OFFSET: f64 = -MEAN_M / DEVIATION_M;

/// Share of a pixel in the mean of a window of which there is a sum.
const WINDOW_SHARE: f32 = 1.0 / (WINDOW * WINDOW) as f32;

/// Threads that copy frames, and the fewest frames (2.4 MB) that are worth one.
const COPY_THREADS: usize = 4;
const COPY_SHARE: usize = 24;

/// A raw frame: millimetres, row-major.
pub type RawFrame = [u16; FRAME_PIXELS];

/// Turns raw frames into kept ones and kept ones into the network's input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FramePreparation {
    /// Side of the pooling window, pixels.
    pool: usize,
    /// Side of a prepared frame, pixels.
    side: usize,
    device: Device,
}

impl FramePreparation {
    /// Scale and offset of [`FramePreparation::input`]: input = kept · scale + offset.
    pub(crate) const SCALE_OFFSET: [f32; 2] = [SCALE as f32, OFFSET as f32];

    pub fn of(config: &Config, device: Device) -> Self {
        let inputs = config.spec().inputs().expect("a validated configuration's task has what networks take");
        match inputs.frame {
            Some(_) => Self::new(config.network.input_pool, device),
            None => Self { pool: FRAME_SIDE, side: 0, device },
        }
    }

    /// Pooling over `pool` × `pool` pixels, computing on `device`. Panics if `pool` does not divide the frame's side.
    pub fn new(pool: u32, device: Device) -> Self {
        let pool = pool as usize;
        assert!(pool > 0 && FRAME_SIDE.is_multiple_of(pool), "the configuration admits 1, 2 and 4");
        Self { pool, side: FRAME_SIDE / pool, device }
    }

    /// Side of a prepared frame, pixels; 0 in a task without a frame.
    pub fn side(self) -> i64 {
        self.side as i64
    }

    /// An empty store of `rows` kept frames: 16-bit or pooled millimetres.
    pub fn store(self, rows: i64) -> Tensor {
        let kind = if self.pool == 1 { Kind::Int16 } else { Kind::Float };
        Tensor::zeros([rows, self.side(), self.side()], (kind, self.device))
    }

    /// Frames → kept frames \[rows, side, side\], millimetres, on the device.
    ///
    /// On a GPU the work may go on after the call: `staging` must not be given to another call before something has
    /// been read back from the device. Panics if there are sums of other windows than are averaged over.
    pub fn keep(self, frames: &[DepthFrame], staging: &mut Staging) -> Tensor {
        let whole: Option<Vec<&RawFrame>> = frames.iter().map(whole).collect();
        let Some(whole) = whole.filter(|_| self.pool == 1 || self.device.is_cuda()) else {
            return self.average(frames).to_device(self.device);
        };
        let raw = staging.upload(&whole, self.device);
        if self.pool == 1 {
            return raw;
        }
        let pool = [self.pool as i64; 2];
        raw.to_kind(Kind::Float).unsqueeze(1).avg_pool2d(pool, pool, [0, 0], false, true, None).squeeze_dim(1)
    }

    /// The means of windows, on the CPU.
    fn average(self, frames: &[DepthFrame]) -> Tensor {
        let side = self.side();
        ffi::floats(&[frames.len() as i64, side, side], |kept| {
            for (frame, means) in frames.iter().zip(kept.chunks_exact_mut((side * side) as usize)) {
                match frame {
                    DepthFrame::Whole(depth_mm) => pool_frame(depth_mm, self.pool, means),
                    DepthFrame::Sums(sums_mm) => {
                        assert_eq!(self.pool, WINDOW, "sums are of the windows that are averaged over");
                        means.iter_mut().zip(*sums_mm).for_each(|(mean, &sum)| *mean = f32::from(sum) * WINDOW_SHARE);
                    }
                }
            }
        })
    }

    /// Kept frames \[rows, side, side\] → the network's input \[rows, 1, side, side\].
    pub fn input(self, kept: &Tensor) -> Tensor {
        (kept.to_kind(Kind::Float) * SCALE + OFFSET).unsqueeze(1)
    }
}

/// Pinned memory in which frames are gathered before they are copied to a device. A GPU reads it by DMA, several times
/// as fast as other memory.
#[derive(Debug, Default)]
pub struct Staging(Option<FrameRoom>);

impl Staging {
    /// Frames → i16 \[rows, 224, 224\] on the device. libtorch has no 16-bit unsigned arithmetic; depths end below
    /// 32.767 m, where both kinds agree.
    fn upload(&mut self, frames: &[&RawFrame], device: Device) -> Tensor {
        let mut room = self.room(frames.len(), device);
        let whole: Vec<_> = frames.iter().map(|frame| DepthFrame::Whole(frame)).collect();
        copy_frames(&mut room.frames_mut()[..frames.len()], &whole);
        if !device.is_cuda() {
            return room.into_tensor();
        }
        let raw = room.copy_to(device, frames.len() as i64);
        self.0 = Some(room);
        raw
    }

    /// Frames → where they are copied to, each at the beginning of the room for a whole one, for a GPU to read. They lie
    /// there until the next call.
    pub(crate) fn gather<'a>(&'a mut self, frames: &[DepthFrame], device: Device) -> Vec<DepthFrame<'a>> {
        let mut room = self.room(frames.len(), device);
        copy_frames(&mut room.frames_mut()[..frames.len()], frames);
        let places = self.0.insert(room).frames_mut().iter();
        let gathered = places.zip(frames).map(|(place, frame)| match frame {
            DepthFrame::Whole(_) => DepthFrame::Whole(place),
            DepthFrame::Sums(_) => DepthFrame::Sums(place.first_chunk().expect("sums are fewer than pixels")),
        });
        gathered.collect()
    }

    /// Takes out the room, if there is enough, or makes it.
    fn room(&mut self, rows: usize, device: Device) -> FrameRoom {
        let rows = rows as i64;
        let kept = self.0.take().filter(|room| room.rows() >= rows && device.is_cuda());
        kept.unwrap_or_else(|| FrameRoom::new(rows, device))
    }
}

/// Copies frames, with several threads if there are many: one core uses only a part of the memory bandwidth, and GPU
/// and actors wait for the copy.
fn copy_frames(to: &mut [RawFrame], from: &[DepthFrame]) {
    let share = from.len().div_ceil(COPY_THREADS).max(COPY_SHARE);
    let copy = |(to, from): (&mut [RawFrame], &[DepthFrame])| {
        for (to, from) in to.iter_mut().zip(from) {
            let numbers = from.numbers();
            to[..numbers.len()].copy_from_slice(numbers);
        }
    };
    std::thread::scope(|scope| {
        let mut shares = to.chunks_mut(share).zip(from.chunks(share));
        let own = shares.next();
        for share in shares {
            scope.spawn(move || copy(share));
        }
        own.map(copy);
    });
}

/// Every pixel of it, if that is there.
fn whole<'a>(frame: &DepthFrame<'a>) -> Option<&'a RawFrame> {
    match *frame {
        DepthFrame::Whole(depth_mm) => Some(depth_mm),
        DepthFrame::Sums(_) => None,
    }
}

fn pool_frame(frame: &RawFrame, pool: usize, pooled: &mut [f32]) {
    let side = FRAME_SIDE / pool;
    let share = 1.0 / (pool * pool) as f32;
    let mut column_sums = [0u32; FRAME_SIDE];
    for (band, out) in frame.chunks_exact(FRAME_SIDE * pool).zip(pooled.chunks_exact_mut(side)) {
        column_sums.fill(0);
        for row in band.chunks_exact(FRAME_SIDE) {
            for (sum, &depth_mm) in column_sums.iter_mut().zip(row) {
                *sum += u32::from(depth_mm);
            }
        }
        for (out, window) in out.iter_mut().zip(column_sums.chunks_exact(pool)) {
            *out = window.iter().sum::<u32>() as f32 * share;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::parameters::to_vec;
    use super::*;
    use proto::camera::{SUMS_PIXELS, sum_windows};

    fn frame(seed: u32) -> Box<RawFrame> {
        let mut state = seed;
        let mut frame: Box<RawFrame> = vec![0; FRAME_PIXELS].try_into().unwrap();
        for depth_mm in frame.iter_mut() {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *depth_mm = (state >> 17) as u16;
        }
        frame
    }

    #[test]
    fn own_pooling_equals_torchs_bit_for_bit() {
        let frames = [frame(1), frame(2)];
        let views: Vec<_> = frames.iter().map(|frame| DepthFrame::Whole(frame)).collect();
        let raw = FramePreparation::new(1, Device::Cpu).keep(&views, &mut Staging::default());
        for pool in [2u32, 4] {
            let kept = FramePreparation::new(pool, Device::Cpu).keep(&views, &mut Staging::default());
            let window = [i64::from(pool); 2];
            let expected = raw.to_kind(Kind::Float).unsqueeze(1).avg_pool2d(window, window, [0, 0], false, true, None);
            assert_eq!(to_vec(&kept), to_vec(&expected));
        }
    }

    #[test]
    fn sums_give_the_bits_of_whole_frames_beside_them_or_alone() {
        let frames = [frame(1), frame(2)].map(|mut frame| {
            frame.iter_mut().for_each(|depth_mm| *depth_mm /= 2);
            frame
        });
        let sums = frames.each_ref().map(|frame| {
            let mut sums_mm: Box<[u16; SUMS_PIXELS]> = vec![0; SUMS_PIXELS].try_into().unwrap();
            assert!(sum_windows(frame, &mut sums_mm));
            sums_mm
        });
        let preparation = FramePreparation::new(2, Device::Cpu);
        let kept = |frames: [DepthFrame; 2]| to_vec(&preparation.keep(&frames, &mut Staging::default()));
        let expected = kept(frames.each_ref().map(|frame| DepthFrame::Whole(frame)));
        assert_eq!(kept(sums.each_ref().map(|sums_mm| DepthFrame::Sums(sums_mm))), expected);
        assert_eq!(kept([DepthFrame::Whole(&frames[0]), DepthFrame::Sums(&sums[1])]), expected);
        // What a GPU would read where it cannot reach the frames.
        let mut staging = Staging::default();
        let mixed = [DepthFrame::Sums(&sums[0]), DepthFrame::Whole(&frames[1])];
        assert_eq!(staging.gather(&mixed, Device::Cpu), mixed);
    }
}
