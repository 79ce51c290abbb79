//! One primitive of a mesh as triangles.

use super::accessor::Data;
use super::affine::Affine;
use super::json::Primitive;
use super::mirror;
use rapier3d::math::Vec3;

/// Vertices, and corners of triangles, that are read of a scene at most. A mesh counts for each node that has it.
pub const VERTICES_MOST: usize = 4_000_000;
/// What is farther from the scene's origin, or from its node's, was not made in metres.
pub const FARTHEST_M: f64 = 1000.0;
pub const TOO_FAR: &str = "lies or reaches more than 1 km away: glTF counts in metres; scale the scene or move it to its \
                           origin";
/// The first mode that has a surface: loose edges and points have none.
const TRIANGLES: u32 = 4;
const TRIANGLE_STRIP: u32 = 5;
const TRIANGLE_FAN: u32 = 6;

/// One primitive of a mesh, in its node's frame and our axes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Piece {
    /// Vertices of its triangles, metres; the same place may occur more than once.
    pub vertices: Vec<Vec3>,
    /// Corners of its triangles. Which way round says nothing: a mirroring scale turns it over.
    pub triangles: Vec<[u32; 3]>,
    /// What its `extras` say, as JSON.
    pub extras: Option<String>,
}

pub fn has_surface(primitive: &Primitive) -> bool {
    primitive.mode.unwrap_or(TRIANGLES) >= TRIANGLES
}

/// Reads a primitive: `weights` are those of its morph targets, `scale` what comes before its node's pose. What it reads
/// is taken off `left`.
pub fn read(
    primitive: &Primitive,
    weights: &[f32],
    scale: &Affine,
    data: &Data,
    left: &mut usize,
) -> Result<Piece, &'static str> {
    const TOO_MANY: &str = "makes more than 4000000 vertices or corners in all: simplify the scene";
    let mut take = |count: usize| left.checked_sub(count).map(|rest| *left = rest).ok_or(TOO_MANY);
    let positions = *primitive.attributes.get("POSITION").ok_or("has a mesh without positions")?;
    let [count, sparse] = data.counts(primitive.indices.unwrap_or(positions))?;
    take(count)?;
    take(sparse)?;
    let corners = match primitive.indices {
        Some(indices) => data.corners(indices)?,
        None => (0..count as u32).collect(),
    };
    let triangles = triangles(&corners, primitive.mode.unwrap_or(TRIANGLES))?;
    // Primitives may share vertices, of which each uses some.
    let mut used = triangles.as_flattened().to_vec();
    used.sort_unstable();
    used.dedup();
    take(data.counts(positions)?[1])?;
    take(weights.len())?;
    let mut vectors = data.vectors(positions, &used)?;
    for (target, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
        let target = primitive.targets.get(target).ok_or("has a mesh with more morph weights than morph targets")?;
        let Some(&added) = target.get("POSITION") else { continue };
        take(used.len())?;
        take(data.counts(added)?[1])?;
        for (vector, added) in vectors.iter_mut().zip(data.vectors(added, &used)?) {
            *vector = [0, 1, 2].map(|i| vector[i] + weight * added[i]);
        }
    }
    if !vectors.as_flattened().iter().all(|value| value.is_finite()) {
        return Err("has a mesh with a position that is not a number");
    }
    let vertices: Vec<Vec3> = vectors.into_iter().map(|vector| scale.point(vector)).collect();
    if vertices.iter().any(|vertex| vertex.abs().max_element() > FARTHEST_M as f32) {
        return Err(TOO_FAR);
    }
    let place = |corner: u32| used.partition_point(|&other| other < corner) as u32;
    // What the extras say of a solid holds only for the mesh as it was written.
    let unchanged = scale.is_identity() && weights.iter().all(|&weight| weight == 0.0);
    Ok(Piece {
        vertices: vertices.into_iter().map(mirror::vector).collect(),
        triangles: triangles.into_iter().map(|corners| corners.map(place)).collect(),
        extras: primitive.extras.as_ref().filter(|_| unchanged).map(|extras| extras.get().to_owned()),
    })
}

fn triangles(corners: &[u32], mode: u32) -> Result<Vec<[u32; 3]>, &'static str> {
    let three = corners.windows(3);
    match mode {
        TRIANGLES if corners.len().is_multiple_of(3) => {
            Ok(corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect())
        }
        TRIANGLES => Err("has a mesh whose corners are not three for each triangle"),
        // Every second one is the other way round.
        TRIANGLE_STRIP => Ok(three.enumerate().map(|(i, c)| [c[0], c[1 + i % 2], c[2 - i % 2]]).collect()),
        TRIANGLE_FAN => Ok(three.enumerate().map(|(i, _)| [corners[0], corners[i + 1], corners[i + 2]]).collect()),
        _ => Err("has a mesh of a mode that glTF has not"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_are_triangles_that_look_the_same_way() {
        assert_eq!(triangles(&[0, 1, 2, 3, 4], TRIANGLE_STRIP).unwrap(), [[0, 1, 2], [1, 3, 2], [2, 3, 4]]);
        assert_eq!(triangles(&[0, 1, 2, 3, 4], TRIANGLE_FAN).unwrap(), [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        assert_eq!(triangles(&[5, 6], TRIANGLE_FAN).unwrap(), [[0; 3]; 0]);
        assert!(triangles(&[0, 1, 2, 3], TRIANGLES).unwrap_err().contains("three for each"));
        assert!(triangles(&[0, 1, 2], 7).unwrap_err().contains("mode"));
    }
}
