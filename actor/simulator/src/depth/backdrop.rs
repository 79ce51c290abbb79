//! What stays the same from one frame to the next while the camera stands still.
//!
//! Most actions of an episode move the arm or nothing at all. A [`Backdrop`] keeps the finished picture of everything
//! that has not moved since the camera stopped; what moves is drawn over it. That gives exactly the frame that a full
//! redraw gives: of two surfaces the nearer one is seen, and rounding to millimetres keeps their order.

use super::placed_bodies::pose_bits;
use crate::kitchen::{Body, BodyRole};
use rapier3d::math::Pose3;

/// The unmoving part of one environment's picture: about 0.1 MB at 224 × 224, a quarter more with its sums, nothing until
/// the first.
#[derive(Debug, Clone, Default)]
pub struct Backdrop {
    /// The camera's pose, and the image's side, that it was drawn for.
    drawn_for: Option<([u32; 7], usize)>,
    pub(super) frame_mm: Vec<u16>,
    /// The sums of its windows, and whether all fit into 16 bits; none before they are asked for.
    pub(super) sums: Option<(Vec<u16>, bool)>,
    /// Triangles of the bodies in it that are in view.
    pub(super) view_set_triangles: usize,
    bodies: Vec<DrawnBody>,
}

#[derive(Debug, Clone, Copy)]
struct DrawnBody {
    pose: [u32; 7],
    in_backdrop: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Redraw {
    Everything,
    Foreground,
}

impl Backdrop {
    pub(super) fn holds(&self, body: usize) -> bool {
        self.bodies[body].in_backdrop
    }

    /// Decides what belongs to the backdrop of the next frame: what stands where it stood in the last frame and is no
    /// part of the robot; but what has been taken out of it stays out until the camera moves.
    pub(super) fn prepare(
        &mut self,
        roles: &[BodyRole],
        world_from_bodies: &[Pose3],
        world_from_camera: &Pose3,
        side: usize,
    ) -> Redraw {
        let drawn_for = Some((pose_bits(world_from_camera), side));
        let first = self.bodies.len() != world_from_bodies.len();
        if first {
            let body = |pose| DrawnBody { pose: pose_bits(pose), in_backdrop: false };
            self.bodies = world_from_bodies.iter().map(body).collect();
        }
        let same_view = !first && self.drawn_for == drawn_for;
        let mut redraw = if same_view { Redraw::Foreground } else { Redraw::Everything };
        for ((body, pose), role) in self.bodies.iter_mut().zip(world_from_bodies).zip(roles) {
            let pose = pose_bits(pose);
            let moved = body.pose != pose;
            body.pose = pose;
            if same_view {
                if moved && body.in_backdrop {
                    body.in_backdrop = false;
                    redraw = Redraw::Everything;
                }
            } else {
                body.in_backdrop = !moved && *role != BodyRole::Robot;
            }
        }
        self.drawn_for = drawn_for;
        self.frame_mm.resize(side * side, 0);
        redraw
    }
}

pub(super) fn roles(bodies: &[Body]) -> Vec<BodyRole> {
    bodies.iter().map(|body| body.role).collect()
}
