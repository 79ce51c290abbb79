//! The depth camera: a software rasteriser for unions of parts, convex ones above all.
//!
//! ```text
//! model         what a solid looks like, shared by all that have it
//! placed_bodies all parts placed in the world, side by side for the vector unit
//! view          projection, near plane and view volume
//! centres       which pixel's centre comes first
//! outline       which pixels of a row a convex figure covers
//! surface       inverse depth within an outline: planes, mantles, balls
//! depth_buffer  the image while it is drawn
//! polyhedron    boxes and hulls
//! round         spheres and cylinders
//! camera        the walk over what is in view
//! backdrop      what stays the same while the camera stands still
//! ```
//!
//! # What is drawn
//! A square image with a horizontal and vertical field of view of 100°. A pixel holds the depth *along the camera's
//! axis* (not along the ray) of the nearest surface on the ray through its centre, in millimetres, rounded; 0 where
//! nothing is hit; at most [`depth_buffer::DEPTH_MAX_MM`]. What lies nearer than [`NEAR_M`] is clipped away.
//!
//! # Why it is fast
//! Nearly everything is convex (dented meshes of users' scenes are drawn face by face). A ray enters a convex solid
//! where it has entered all of its half-spaces, so within the solid's outline its inverse depth is the least of those
//! of the planes that look at the eye: a box is one figure with six sides and not three faces, and no edge inside of
//! an outline is ever computed. Inverse depth is affine over the image of a plane. A cylinder's mantle and a sphere
//! have inverse depths with one square root a pixel, so that round things need neither many faces nor levels of
//! detail, and are exact at any distance. All of it works on eight vertices, faces, rows or pixels at a time. The
//! nearest surface is the maximum of inverse depths, which does not depend on the order of drawing.
//!
//! # Why it is reproducible
//! Plain single-precision additions, multiplications, divisions and square roots in a fixed order, nothing fused,
//! and no transcendental function at run time: the same bits on every machine.

// The vector code is written in small functions that must become one loop; without this they became calls.
#![allow(clippy::inline_always)]

mod backdrop;
mod camera;
mod centres;
mod depth_buffer;
mod model;
mod outline;
mod placed_bodies;
mod polyhedron;
mod round;
mod surface;
#[cfg(test)]
mod tests;
mod view;

pub(crate) use backdrop::Backdrop;
pub use camera::{DepthCamera, Scenery};
pub use view::{NEAR_M, TAN_HALF_FIELD_OF_VIEW};
