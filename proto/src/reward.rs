//! Constants of `ArmPointNav` (`docs/method.md`, Reward).

/// An episode with less total displacement than this is "without disturbance" (`SRwoD`), metres.
pub const UNDISTURBED_THRESHOLD_M: f32 = 0.01;
