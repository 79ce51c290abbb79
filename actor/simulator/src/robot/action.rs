//! What the robot can be told to do: `ManipulaTHOR`'s actions, in the order of the reference implementation
//! (`docs/method.md`, Actions), which is `ArmPointNav`'s.

/// One action of `A_large`. The discriminant is its index there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Action {
    /// Raise the arm's base by 0.05 of its normalised height range.
    MoveArmHeightP = 0,
    /// Lower the arm's base by 0.05 of its normalised height range.
    MoveArmHeightM = 1,
    /// Move the wrist 0.05 m to the robot's right.
    MoveArmXP = 2,
    /// Move the wrist 0.05 m to the robot's left.
    MoveArmXM = 3,
    /// Move the wrist 0.05 m up.
    MoveArmYP = 4,
    /// Move the wrist 0.05 m down.
    MoveArmYM = 5,
    /// Move the wrist 0.05 m ahead.
    MoveArmZP = 6,
    /// Move the wrist 0.05 m back.
    MoveArmZM = 7,
    /// Pitch the wrist by +15 degrees.
    RotateArmWristPitchP = 8,
    /// Pitch the wrist by -15 degrees.
    RotateArmWristPitchM = 9,
    /// Yaw the wrist by +15 degrees.
    RotateArmWristYawP = 10,
    /// Yaw the wrist by -15 degrees.
    RotateArmWristYawM = 11,
    /// Turn the elbow about the shoulder-wrist line by +15 degrees.
    RotateArmElbowP = 12,
    /// Turn the elbow about the shoulder-wrist line by -15 degrees.
    RotateArmElbowM = 13,
    /// Pitch the head camera 30 degrees up.
    LookUp = 14,
    /// Pitch the head camera 30 degrees down.
    LookDown = 15,
    /// Drive 0.2 m ahead.
    MoveAheadContinuous = 16,
    /// Turn the body 45 degrees to the right.
    RotateRightContinuous = 17,
    /// Turn the body 45 degrees to the left.
    RotateLeftContinuous = 18,
    /// Switch the magnet on: attaches the target if it touches the magnet sphere.
    PickUpMidLevel = 19,
    /// Declare the task done; ends the episode.
    DoneMidLevel = 20,
}

impl Action {
    /// All actions of `A_large` in policy-head order.
    pub const ALL: [Self; 21] = [
        Self::MoveArmHeightP,
        Self::MoveArmHeightM,
        Self::MoveArmXP,
        Self::MoveArmXM,
        Self::MoveArmYP,
        Self::MoveArmYM,
        Self::MoveArmZP,
        Self::MoveArmZM,
        Self::RotateArmWristPitchP,
        Self::RotateArmWristPitchM,
        Self::RotateArmWristYawP,
        Self::RotateArmWristYawM,
        Self::RotateArmElbowP,
        Self::RotateArmElbowM,
        Self::LookUp,
        Self::LookDown,
        Self::MoveAheadContinuous,
        Self::RotateRightContinuous,
        Self::RotateLeftContinuous,
        Self::PickUpMidLevel,
        Self::DoneMidLevel,
    ];

    /// The action with this `A_large` index, if there is one.
    pub fn from_index(index: u8) -> Option<Self> {
        Self::ALL.get(usize::from(index)).copied()
    }

    /// The `A_large` index, which is also the wire value.
    pub fn index(self) -> u8 {
        self as u8
    }
}
