use super::json::Node;
use super::mirror;
use rapier3d::math::{Pose3, Rot3, Vec3};

/// An affine map: columns of the linear part, then the translation. Double precision: nodes may be nested deeply.
#[derive(Debug, Clone, Copy)]
pub struct Affine {
    linear: [[f64; 3]; 3],
    /// What is added, metres.
    pub translation: [f64; 3],
}

/// A 4 × 4 matrix, column after column.
type Matrix = [[f32; 4]; 4];

impl Affine {
    pub fn identity() -> Self {
        Self { linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] }
    }

    /// How a node stands in its parent.
    pub fn of(node: &Node) -> Self {
        let columns = if let Some(matrix) = &node.matrix {
            [0, 4, 8, 12].map(|first| [0, 1, 2, 3].map(|row| matrix[first + row]))
        } else {
            let [x, y, z] = node.translation.unwrap_or_default();
            let [sx, sy, sz] = node.scale.unwrap_or([1.0; 3]);
            let translation = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [x, y, z, 1.0]];
            let scale = [[sx, 0.0, 0.0, 0.0], [0.0, sy, 0.0, 0.0], [0.0, 0.0, sz, 0.0], [0.0, 0.0, 0.0, 1.0]];
            let rotation = turned(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]));
            product(&product(&translation, &rotation), &scale)
        };
        let column = |i: usize| [0, 1, 2].map(|row| f64::from(columns[i][row]));
        Self { linear: [column(0), column(1), column(2)], translation: column(3) }
    }

    fn turn(&self, v: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|row| self.linear[0][row] * v[0] + self.linear[1][row] * v[1] + self.linear[2][row] * v[2])
    }

    /// `self` after `first`.
    pub fn after(&self, first: &Self) -> Self {
        let moved = self.turn(first.translation);
        Self {
            linear: first.linear.map(|column| self.turn(column)),
            translation: [0, 1, 2].map(|i| moved[i] + self.translation[i]),
        }
    }

    pub fn point(&self, p: [f32; 3]) -> Vec3 {
        let moved = self.turn(p.map(f64::from));
        Vec3::from([0, 1, 2].map(|i| (moved[i] + self.translation[i]) as f32))
    }

    /// A pose in our axes, and what comes before it: scale, mirroring, shear. None if the map is flat.
    pub fn split(&self) -> Option<(Pose3, Self)> {
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let less = |a: [f64; 3], b: [f64; 3], share: f64| [0, 1, 2].map(|i| a[i] - share * b[i]);
        let unit = |a: [f64; 3]| {
            let length = dot(a, a).sqrt();
            (length > 1e-9 && length.is_finite()).then(|| a.map(|v| v / length))
        };
        // Gram and Schmidt; the third axis by the right hand, so that a mirror goes into the rest.
        let x = unit(self.linear[0])?;
        let y = unit(less(self.linear[1], x, dot(self.linear[1], x)))?;
        let z = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
        let height = dot(z, self.linear[2]).abs();
        if height < 1e-9 || !height.is_finite() {
            return None;
        }
        let rest = self.linear.map(|column| [dot(x, column), dot(y, column), dot(z, column)]);
        let axis = |v: [f64; 3]| Vec3::from(v.map(|c| c as f32));
        let rotation = Rot3::from_mat3(&rapier3d::math::Mat3::from_cols(axis(x), axis(y), axis(z)));
        let pose = Pose3::from_parts(axis(self.translation), rotation.normalize());
        Some((mirror::pose(pose), Self { linear: rest, translation: [0.0; 3] }))
    }

    pub fn is_identity(&self) -> bool {
        let identity = Self::identity().linear;
        self.linear.as_flattened().iter().zip(identity.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-5)
    }
}

/// `a` after `b`. Every sum is written out: another order would be other bits.
fn product(a: &Matrix, b: &Matrix) -> Matrix {
    b.map(|c| [0, 1, 2, 3].map(|row| a[0][row] * c[0] + a[1][row] * c[1] + a[2][row] * c[2] + a[3][row] * c[3]))
}

/// The matrix of a quaternion.
fn turned([x, y, z, w]: [f32; 4]) -> Matrix {
    let [x2, y2, z2] = [x + x, y + y, z + z];
    let (xx, xy, xz, xw) = (x2 * x, x2 * y, x2 * z, x2 * w);
    let (yy, yz, yw, zz, zw) = (y2 * y, y2 * z, y2 * w, z2 * z, z2 * w);
    [
        [1.0 - yy - zz, xy + zw, xz - yw, 0.0],
        [xy - zw, 1.0 - xx - zz, yz + xw, 0.0],
        [xz + yw, yz - xw, 1.0 - xx - yy, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Recordings hold bits that came of these.
        #[test]
        fn a_node_stands_to_the_bit_as_the_gltf_crate_says(
            translation in prop::array::uniform3(-5.0_f32..5.0),
            rotation in prop::array::uniform4(-1.0_f32..1.0),
            scale in prop::array::uniform3(-2.0_f32..2.0),
        ) {
            let columns = gltf::scene::Transform::Decomposed { translation, rotation, scale }.matrix();
            let by_parts = Node {
                translation: Some(translation), rotation: Some(rotation), scale: Some(scale), ..Node::default()
            };
            let flat: Vec<f32> = columns.as_flattened().to_vec();
            let whole = Node { matrix: flat.try_into().ok(), ..Node::default() };
            prop_assert!(whole.matrix.is_some());
            prop_assert_eq!(format!("{:?}", Affine::of(&by_parts)), format!("{:?}", Affine::of(&whole)));
        }
    }
}
