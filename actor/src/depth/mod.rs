//! The depth camera: a software rasteriser for unions of convex parts.
//!
//! ```text
//! mesh     convex polyhedra with planar faces, at several levels of detail
//! view     projection, near plane and view volume
//! raster   convex polygons filled into a buffer of inverse depths
//! camera   culling, choice of detail, and the walk over bodies
//! ```
//!
//! # What is drawn
//! A square image with a horizontal and vertical field of view of 100°. A pixel holds the depth *along the camera's
//! axis* (not along the ray) of the nearest surface on the ray through its centre, in millimetres, rounded; 0 where
//! nothing is hit; at most [`DEPTH_MAX_MM`]. What lies nearer than [`NEAR_M`] is clipped away.
//!
//! # Why it is fast
//! Everything is convex, so a face that looks away is found by one dot product in the part's own frame, before
//! anything is transformed, and no other test for visibility within a part is needed. Inverse depth is affine over
//! the image of a plane, so a face costs one plane equation, and a pixel one multiplication, one addition and one
//! maximum, eight pixels at a time without branches. The maximum does not depend on the order of drawing.
//!
//! # Why it is reproducible
//! Plain single-precision additions, multiplications, divisions and square roots in a fixed order, nothing fused,
//! and no transcendental function at run time: the same bits on every machine.

mod camera;
mod mesh;
mod raster;
mod simd;
#[cfg(test)]
mod tests;
mod view;

pub use camera::DepthCamera;
pub use mesh::triangles_of;
pub use raster::DEPTH_MAX_MM;
pub use view::{NEAR_M, TAN_HALF_FIELD_OF_VIEW};
