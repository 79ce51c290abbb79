//! Depth images of any scene on a CPU: a software rasteriser without GPU, display or library.
//!
//! ```text
//! affine     what is affine over the image
//! camera     pose, lens, and where a ball is seen
//! solid      planes, boxes, ellipsoids, cylinders and capsules by their formula
//! mesh       triangles as a tree
//! triangles  draws meshes
//! surface    inverse depth over the image of a solid's visible side
//! image      the image while it is drawn
//! scene      what there is to see, and the walk over it
//! simd       eight numbers at once
//! ```
//!
//! # What is drawn
//! A pixel holds the depth *along the camera's axis* (not along the ray) of the nearest surface on the ray through its
//! centre, and that thing's number. Surfaces are seen from outside only, as in `OpenGL` with culled back faces. What is
//! nearer than the near plane or beyond the far plane is not seen.
//!
//! # Why it is fast
//! Solids are convex, and within their outline a few planes or one square root give the depth of eight pixels. Meshes
//! of any shape are trees: a part that is not in the image, looks away, holds no pixel's centre or lies behind what is
//! drawn already costs one test for all that is in it. Things are drawn from the eye outwards.
//!
//! # Why it is reproducible
//! Plain additions, multiplications, divisions and square roots in a fixed order, nothing fused, and no transcendental
//! function while drawing: the same bits on every machine. Of two surfaces at the same depth the first drawn is seen,
//! and the order of drawing depends on nothing else.

// The vector code is written in small functions that must become one loop; without this they became calls.
#![allow(clippy::inline_always)]

mod affine;
mod camera;
mod image;
mod mesh;
mod scene;
pub mod simd;
mod solid;
mod surface;
#[cfg(test)]
mod tests;
mod triangles;

pub use camera::{Camera, Lens, Pose};
pub use image::DEPTH_MAX_MM;
pub use mesh::{Mesh, MeshError};
pub use scene::{Renderer, Scene, Shape};
