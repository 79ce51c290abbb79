//! Scenes of other programs: glTF 2.0 in.
//!
//! ```text
//! mirror    between glTF's right-handed axes and ours
//! sound     a file is checked before it is read
//! document  a glTF file's nodes as triangles in our axes
//! convex    which convex solid a mesh is
//! decompose a dented mesh as convex pieces
//! solid     which solid a mesh is: convex, or in pieces
//! no_solid  why it is none
//! ```
//!
//! A primitive of a mesh becomes one part of a body's shape. The export makes each part one primitive and writes into
//! the `extras` of round parts what they are, so that they come back as exact as they went.

mod convex;
mod decompose;
pub(crate) mod document;
#[cfg(test)]
mod hostile;
pub mod mirror;
pub(crate) mod no_solid;
pub(crate) mod solid;
mod sound;
