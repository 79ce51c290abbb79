//! Scenes of other programs: glTF 2.0 in.
//!
//! ```text
//! mirror    between glTF's right-handed axes and ours
//! document  a glTF file's nodes as triangles in our axes
//! convex    which convex solid a mesh is
//! decompose a dented mesh as convex pieces
//! solid     which solid a mesh is: convex, or in pieces
//! no_solid  why it is none
//! ```
//!
//! A mesh's primitive becomes one part of a body's shape. Whoever writes our shapes as glTF makes each part one primitive
//! and says of round parts in their `extras` what they are, so that they come back as exact as they went.

mod convex;
mod decompose;
pub mod document;
pub mod mirror;
pub mod no_solid;
pub mod solid;
