//! The floor seen from above: where furniture stands, and where it must not, so that people, doors and the robot have
//! room.

use rapier3d::math::Vec3;

/// Room in front of a run of counters, for whoever works at it and for open doors and drawers, metres.
pub(crate) const WORKING_DEPTH_M: f32 = 0.95;
pub(super) const WALKWAY_M: f32 = 0.80;

/// A rectangle on the floor: corners with the smaller and the larger x and z; y means nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Corner with the smaller x and z, metres.
    pub low: Vec3,
    /// Corner with the larger x and z, metres.
    pub high: Vec3,
}

#[derive(Debug, Clone, Default)]
pub(super) struct FloorPlan {
    pub occupied: Vec<Rectangle>,
    /// Before fronts and doors.
    pub kept_clear: Vec<Rectangle>,
}

impl Rectangle {
    pub fn below((low, high): (Vec3, Vec3)) -> Self {
        Self { low: low.with_y(0.0), high: high.with_y(0.0) }
    }

    /// Larger by this much on each side.
    #[must_use]
    pub(super) fn grown(self, by_m: f32) -> Self {
        let by = Vec3::new(by_m, 0.0, by_m);
        Self { low: self.low - by, high: self.high + by }
    }

    /// Whether two overlap in more than an edge.
    pub fn overlaps(&self, other: &Self) -> bool {
        const EDGE_M: f32 = 1e-4;
        self.low.x < other.high.x - EDGE_M
            && other.low.x < self.high.x - EDGE_M
            && self.low.z < other.high.z - EDGE_M
            && other.low.z < self.high.z - EDGE_M
    }

    pub fn within(&self, other: &Self) -> bool {
        self.low.x >= other.low.x
            && self.low.z >= other.low.z
            && self.high.x <= other.high.x
            && self.high.z <= other.high.z
    }
}

impl FloorPlan {
    /// Whether furniture may stand here: nothing does, nothing has to be kept clear, and ways around it stay open.
    pub(crate) fn admits(&self, place: &Rectangle) -> bool {
        let around = place.grown(WALKWAY_M);
        !self.kept_clear.iter().any(|clear| clear.overlaps(place))
            && !self.occupied.iter().any(|other| other.overlaps(&around))
    }

    /// Whether a place is free of furniture and of what is to be kept clear.
    pub(crate) fn is_free(&self, place: &Rectangle) -> bool {
        !self.kept_clear.iter().chain(&self.occupied).any(|other| other.overlaps(place))
    }
}
