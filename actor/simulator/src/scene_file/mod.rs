//! Users' own scenes: a glTF file for the geometry, and a small TOML file for what glTF does not say.
//!
//! ```text
//! file      what stands in `scene.toml`
//! roles     which node is what: entries and nodes brought together
//! tops      where things can stand on a surface
//! read      a scene's files as a furnished room, and as a kitchen
//! problem   everything that can be wrong, in words that say what to do
//! ```
//!
//! ```toml
//! gltf = "studio.glb"          # beside this file or below it
//!
//! [[node]]                     # a node takes the first entry that fits its name
//! name = "Floor"               # `*` and `?` stand for anything
//! role = "floor"               # its extent is where the robot drives; its top becomes height 0
//!
//! [[node]]
//! name = "Table"
//! role = "surface"             # fixed, and its level tops are where targets can stand
//!
//! [[node]]
//! name = "Mug"
//! role = "movable"
//! mass_kg = 0.35
//! friction = 0.6               # Coulomb coefficient; 0.6 if left out
//! category = "Mug"             # left out: the node's name without its number
//! convex = "hull"              # of a mesh that is not convex take the hull, or "decompose" it into convex pieces
//!
//! [[node]]
//! name = "Wall*"
//! role = "fixed"
//!
//! [[node]]
//! name = "Lamp"
//! role = "ignore"
//! ```
//!
//! A node that an entry names is one body, together with the nodes below it that no entry names. Each primitive of its
//! meshes is one part ([`crate::gltf_file::solid`]). A name is the same however its accents are written (NFC, NFD).
//! Metres, y up; the axes are glTF's ([`crate::gltf_file`]). `actor kitchens categories` lists the categories.
//!
//! Physics takes convex parts only, so a mesh with a dent is an error unless its entry says what to do:
//!
//! * `convex = "hull"` fills the dent: nothing can stand in it, and the camera sees it filled, too.
//! * `convex = "decompose"` cuts the mesh into at most 32 convex pieces with parry's VHACD. The mesh must be closed.
//!   The camera sees the mesh itself, and mass and inertia are those of the mesh; what touches it touches the pieces,
//!   which differ from it by about 1/64 of its longest side where two of them meet in a dent. Loading takes longer, by
//!   some tenths of a second a mesh. The same file gives the same pieces on every machine.
//!
//! Meshes that are already split into convex ones are simulated faster and exactly.

mod file;
mod problem;
mod read;
mod roles;
pub mod tops;

pub use crate::gltf_file::solid::Convex;
pub use file::{NodeEntry, Role, SceneFile};
pub use problem::{Problem, SceneError, Size};
pub use read::{Scene, load, name_of, read};
pub use tops::NoTop;
