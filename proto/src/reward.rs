//! Constants of `ArmPointNav` (`docs/method.md`, Reward).

/// An episode with less total displacement than this is "without disturbance" (`SRwoD`), metres.
pub const UNDISTURBED_THRESHOLD_M: f32 = 0.01;
/// Displacement of one object counts at most this much, metres.
pub const OBJECT_DISPLACEMENT_CAP_M: f32 = 10.0;
