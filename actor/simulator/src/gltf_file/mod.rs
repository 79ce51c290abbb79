//! Scenes of other programs: glTF 2.0 in.
//!
//! ```text
//! json        what is read of a file
//! uri         where its buffers are
//! extensions  which of them it may use
//! accessor    corners and vertices in its buffers
//! mirror      between glTF's right-handed axes and ours
//! affine      how a node stands
//! piece       a primitive of a mesh as triangles
//! document    a file's nodes, and their pieces
//! convex      which convex solid a mesh is
//! decompose   a dented mesh as convex pieces
//! solid       which solid a mesh is: convex, or in pieces
//! no_solid    why it is none
//! ```
//!
//! A primitive of a mesh becomes one part of a body's shape. The export makes each part one primitive and writes into
//! the `extras` of round parts what they are, so that they come back as exact as they went.

mod accessor;
mod affine;
mod convex;
mod decompose;
pub(crate) mod document;
mod extensions;
mod json;
pub mod mirror;
pub(crate) mod no_solid;
pub(crate) mod piece;
pub(crate) mod solid;
#[cfg(test)]
mod tests;
pub(crate) mod uri;
