//! The head camera: what simulator, learner and recordings must agree on.

/// Width and height of a depth frame in pixels.
pub const FRAME_SIDE: usize = 224;
/// Pixels of a depth frame.
pub const FRAME_PIXELS: usize = FRAME_SIDE * FRAME_SIDE;
/// Field of view, horizontally and vertically, degrees (`ManipulaTHOR`).
pub const FIELD_OF_VIEW_DEG: f64 = 100.0;
/// tan(50°), of half of the field of view: rounded by hand, so that it is the same number everywhere.
pub const TAN_HALF_FIELD_OF_VIEW: f32 = 1.191_753_6;
/// Height over the floor, on the body's axis, metres (`ManipulaTHOR`).
pub const HEIGHT_M: f64 = 1.58;

// The simulator computes with 32 bits: no bit depends on which of the two a number was first written in.
const _: () = assert!(HEIGHT_M as f32 == 1.58);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tangent_is_that_of_half_the_field_of_view() {
        let half_rad = (FIELD_OF_VIEW_DEG / 2.0).to_radians();
        assert!((f64::from(TAN_HALF_FIELD_OF_VIEW) - half_rad.tan()).abs() < 1e-7);
    }
}
