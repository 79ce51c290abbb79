//! Why a mesh is no solid, and the limits that it may exceed.

/// Corners of a hull at most: each costs time at every contact.
pub const CORNERS_MOST: usize = 512;
/// Triangles of a mesh that is decomposed, at most: with three vertices each, their numbers still fit into 16 bits.
pub const TRIANGLES_MOST: usize = 20_000;

#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoSolid {
    #[error("is flat: give it thickness")]
    Flat,
    #[error(
        "is not convex (dented by {dent_mm:.0} mm): split it into convex meshes, or say `convex = \"decompose\"` to have it \
         cut into convex pieces, or `convex = \"hull\"` to take its hull instead"
    )]
    Dented { dent_mm: f32 },
    #[error("has {corners} corners on its hull, more than {CORNERS_MOST}: simplify it")]
    TooDetailed { corners: usize },
    #[error(
        "has {edges} edges without a face on either side, or between faces that do not both look outwards, so that it \
         has no inside to decompose: fill its holes and recalculate its normals, or say `convex = \"hull\"`"
    )]
    Open { edges: usize },
    #[error("has {triangles} triangles, more than the {TRIANGLES_MOST} that can be decomposed: simplify it")]
    TooManyTriangles { triangles: usize },
}
