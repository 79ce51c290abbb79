//! The head camera: what simulator, learner and recordings must agree on.

/// Width and height of a depth frame in pixels.
pub const FRAME_SIDE: usize = 224;
pub const FRAME_PIXELS: usize = FRAME_SIDE * FRAME_SIDE;
/// Side of the windows that [`sum_windows`] adds up, pixels: the paper's input pooling.
pub const WINDOW: usize = 2;
pub const SUMS_SIDE: usize = FRAME_SIDE / WINDOW;
pub const SUMS_PIXELS: usize = SUMS_SIDE * SUMS_SIDE;
/// Field of view, horizontally and vertically, degrees (`ManipulaTHOR`).
pub const FIELD_OF_VIEW_DEG: f64 = 100.0;
/// tan(50°), of half of the field of view: rounded by hand, so that it is the same number everywhere.
pub const TAN_HALF_FIELD_OF_VIEW: f32 = 1.191_753_6;
/// Height over the floor, on the body's axis, metres (`ManipulaTHOR`).
pub const HEIGHT_M: f64 = 1.58;

// The simulator computes with 32 bits: no bit depends on which of the two a number was first written in.
const _: () = assert!(HEIGHT_M as f32 == 1.58);

/// A depth frame as a network gets it, row-major from the top left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthFrame<'a> {
    /// Every pixel, millimetres; 0 where nothing was hit.
    Whole(&'a [u16; FRAME_PIXELS]),
    /// What [`sum_windows`] makes of it, for a network that averages over such windows.
    Sums(&'a [u16; SUMS_PIXELS]),
}

impl<'a> DepthFrame<'a> {
    pub fn numbers(self) -> &'a [u16] {
        match self {
            Self::Whole(depth_mm) => depth_mm,
            Self::Sums(sums_mm) => sums_mm,
        }
    }
}

/// Writes the sum of each window of [`WINDOW`] × [`WINDOW`] pixels of a frame, millimetres, row-major, every one of
/// them. Returns whether all fit into 16 bits: a window's mean must be less than 16.384 m for that.
///
/// A network that averages its input over such windows needs no more of the frame, and a GPU that reads it from the
/// host's memory reads a quarter of the bytes. The sums are exact, and so are their quarters as 32-bit floating point.
pub fn sum_windows(depth_mm: &[u16; FRAME_PIXELS], sums_mm: &mut [u16; SUMS_PIXELS]) -> bool {
    let mut bits = 0;
    let bands = depth_mm.chunks_exact(WINDOW * FRAME_SIDE).zip(sums_mm.chunks_exact_mut(SUMS_SIDE));
    for (band, sums_mm) in bands {
        let (upper, lower) = band.split_at(FRAME_SIDE);
        let windows = upper.as_chunks::<WINDOW>().0.iter().zip(lower.as_chunks::<WINDOW>().0);
        for (([a, b], [c, d]), sum_mm) in windows.zip(sums_mm) {
            let sum = u32::from(*a) + u32::from(*b) + u32::from(*c) + u32::from(*d);
            bits |= sum;
            *sum_mm = sum as u16;
        }
    }
    u16::try_from(bits).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every window by its definition, for depths that fit and for one that does not.
    #[test]
    fn sums_are_those_of_each_window() {
        let mut depth_mm: Box<[u16; FRAME_PIXELS]> = vec![0; FRAME_PIXELS].try_into().unwrap();
        for (pixel, depth_mm) in depth_mm.iter_mut().enumerate() {
            *depth_mm = (pixel * 7919 % 16_384) as u16;
        }
        for (far_mm, fits) in [(16_383, true), (32_766, false)] {
            depth_mm[3 * FRAME_SIDE + 7] = far_mm;
            let mut sums_mm: Box<[u16; SUMS_PIXELS]> = vec![0; SUMS_PIXELS].try_into().unwrap();
            assert_eq!(sum_windows(&depth_mm, &mut sums_mm), fits);
            for (place, sum_mm) in sums_mm.iter().enumerate() {
                let corner = place / SUMS_SIDE * 2 * FRAME_SIDE + place % SUMS_SIDE * 2;
                let window = [0, 1, FRAME_SIDE, FRAME_SIDE + 1].map(|offset| u32::from(depth_mm[corner + offset]));
                assert_eq!(u32::from(*sum_mm), window.iter().sum::<u32>() & 0xffff);
            }
        }
    }
}
