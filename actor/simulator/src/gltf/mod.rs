//! Scenes of other programs: glTF 2.0 out and in.
//!
//! ```text
//! mirror    between glTF's right-handed axes and ours
//! export    a settled kitchen as a binary glTF file
//! document  a glTF file's nodes as triangles in our axes
//! solid     which solid a mesh is
//! decompose a dented mesh as convex pieces
//! ```
//!
//! What a body looks like to other programs is what it is here: each part of a shape is one primitive of the mesh, and a
//! mesh's primitive becomes one part again. Round parts also say in their `extras` what they are,
//! so that they come back as exact as they went.

mod decompose;
pub mod document;
pub mod export;
mod mirror;
pub mod solid;
