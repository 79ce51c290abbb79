//! Triangle meshes of any shape and size, as trees.
//!
//! Triangles are kept in blocks of eight, side by side for the vector unit, and blocks in a tree whose nodes have eight
//! parts, with a ball about each and a cone about its normals. A frame walks the tree from the eye outwards. It leaves
//! out parts that are not in the image or hold no pixel's centre, that face away, and that lie behind what is drawn
//! already. So the cost grows with what is seen and with the image, hardly with the number of triangles behind a pixel.

use crate::simd::LANES;

/// Most triangles of a node whose parts are blocks.
const CLUSTER: usize = LANES * LANES;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    #[error("triangle {triangle} has vertex {vertex}, and there are {count} vertices")]
    NoSuchVertex { triangle: usize, vertex: u32, count: usize },
    #[error("vertex {0} is not finite: every coordinate must be a number")]
    NotFinite(usize),
    #[error("{heights} heights are no grid of {columns} columns: there must be at least two rows and two columns")]
    NoGrid { heights: usize, columns: usize },
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Ball {
    pub centre_m: [f32; 3],
    pub radius_m: f32,
}

/// Eight triangles: by corner, by axis, in metres. Corners run clockwise as seen from outside.
pub(crate) type Block = [[[f32; LANES]; 3]; 3];

/// Up to eight parts of a mesh. Unused ones are where nobody looks.
#[derive(Debug, Clone, Default)]
pub(crate) struct Node {
    /// A ball about each part.
    pub centre_m: [[f32; LANES]; 3],
    pub radius_m: [f32; LANES],
    /// A cone about its normals, as the cosine and sine of its angle.
    pub axis: [[f32; LANES]; 3],
    pub cos: [f32; LANES],
    pub sin: [f32; LANES],
    pub count: u32,
    pub parts: Parts,
}

#[derive(Debug, Clone)]
pub(crate) enum Parts {
    Nodes([u32; LANES]),
    Blocks(u32),
}

impl Default for Parts {
    fn default() -> Self {
        Self::Blocks(0)
    }
}

#[derive(Debug, Clone)]
pub struct Mesh {
    /// The first is the whole mesh; none if it has no triangles.
    pub(crate) nodes: Vec<Node>,
    pub(crate) blocks: Vec<Block>,
    pub(crate) ball: Ball,
    triangles: usize,
}

#[derive(Debug, Clone, Copy)]
struct Triangle {
    corners_m: [[f32; 3]; 3],
    middle_m: [f32; 3],
    /// Of length 1, outwards.
    normal: [f32; 3],
}

impl Mesh {
    /// Triangles run counterclockwise as seen from outside; from behind they are not seen. Those without an area are
    /// left out.
    pub fn new(vertices_m: &[[f32; 3]], triangles: &[[u32; 3]]) -> Result<Self, MeshError> {
        if let Some(vertex) = vertices_m.iter().position(|vertex| vertex.iter().any(|m| !m.is_finite())) {
            return Err(MeshError::NotFinite(vertex));
        }
        let mut list = Vec::with_capacity(triangles.len());
        for (number, triangle) in triangles.iter().enumerate() {
            let corner = |vertex: u32| {
                let missing = MeshError::NoSuchVertex { triangle: number, vertex, count: vertices_m.len() };
                vertices_m.get(vertex as usize).copied().ok_or(missing)
            };
            let [a, b, c] = *triangle;
            list.extend(Triangle::new([corner(a)?, corner(b)?, corner(c)?]));
        }
        let mut mesh = Self { nodes: Vec::new(), blocks: Vec::new(), ball: ball_about(&list), triangles: list.len() };
        if !list.is_empty() {
            mesh.add(&mut list);
        }
        Ok(mesh)
    }

    /// A height field: a grid of heights, row by row along y, over the rectangle of these half extents about z = 0,
    /// with walls down to `base_m` below, and a bottom.
    pub fn height_field(heights_m: &[f32], columns: usize, half_m: [f32; 2], base_m: f32) -> Result<Self, MeshError> {
        let rows = heights_m.len().checked_div(columns).unwrap_or(0);
        if rows < 2 || columns < 2 || rows * columns != heights_m.len() {
            return Err(MeshError::NoGrid { heights: heights_m.len(), columns });
        }
        let place = |i: usize, count: usize, half_m: f32| half_m * (2.0 * i as f32 / (count - 1) as f32 - 1.0);
        let at = |i: usize, z: f32| [place(i % columns, columns, half_m[0]), place(i / columns, rows, half_m[1]), z];
        let mut vertices: Vec<_> = heights_m.iter().enumerate().map(|(i, &height_m)| at(i, height_m)).collect();
        let mut triangles = Vec::new();
        let number = |row: usize, column: usize| row * columns + column;
        for row in 0..rows - 1 {
            for column in 0..columns - 1 {
                let [a, b] = [0, 1].map(|right| number(row, column + right) as u32);
                let [c, d] = [0, 1].map(|right| number(row + 1, column + right) as u32);
                triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
        // Once around, counterclockwise as seen from above.
        let around = (0..columns - 1)
            .map(|column| number(0, column))
            .chain((0..rows - 1).map(|row| number(row, columns - 1)))
            .chain((1..columns).rev().map(|column| number(rows - 1, column)))
            .chain((1..rows).rev().map(|row| number(row, 0)));
        let around: Vec<usize> = around.collect();
        let first_below = vertices.len() as u32;
        vertices.extend(around.iter().map(|&i| at(i, -base_m)));
        for i in 0..around.len() {
            let next = (i + 1) % around.len();
            let [a, b] = [around[i] as u32, around[next] as u32];
            let [c, d] = [first_below + i as u32, first_below + next as u32];
            triangles.extend([[c, d, b], [c, b, a]]);
            if i > 0 {
                triangles.push([first_below, d, c]);
            }
        }
        Self::new(&vertices, &triangles)
    }

    pub fn triangles(&self) -> usize {
        self.triangles
    }

    /// Adds a node with all that is in it, and returns its number.
    fn add(&mut self, triangles: &mut [Triangle]) -> u32 {
        let number = self.nodes.len();
        self.nodes.push(Node::default());
        let mut node = Node::default();
        if triangles.len() <= CLUSTER {
            let radius_m = ball_about(triangles).radius_m;
            sort_into_blocks(triangles, radius_m);
            node.parts = Parts::Blocks(self.blocks.len() as u32);
            for triangles in triangles.chunks(LANES) {
                node.push(triangles);
                self.blocks.push(block_of(triangles));
            }
        } else {
            let mut parts = vec![triangles];
            for _ in 0..LANES.ilog2() {
                parts = parts.into_iter().flat_map(halves).collect();
            }
            let mut numbers = [0; LANES];
            for (triangles, number) in parts.into_iter().zip(&mut numbers) {
                node.push(triangles);
                *number = self.add(triangles);
            }
            node.parts = Parts::Nodes(numbers);
        }
        self.nodes[number] = node;
        number as u32
    }
}

impl Triangle {
    fn new([a, b, c]: [[f32; 3]; 3]) -> Option<Self> {
        let [u, v] = [b, c].map(|end| [0, 1, 2].map(|i| f64::from(end[i]) - f64::from(a[i])));
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        let length = (normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]).sqrt();
        (length > 0.0).then(|| Self {
            // The image's y runs down: there they run clockwise.
            corners_m: [a, c, b],
            middle_m: [0, 1, 2].map(|i| (a[i] + b[i] + c[i]) / 3.0),
            normal: normal.map(|n| (n / length) as f32),
        })
    }
}

impl Node {
    /// Adds what it has to say about a part.
    fn push(&mut self, triangles: &[Triangle]) {
        let lane = self.count as usize;
        self.count += 1;
        let ball = ball_about(triangles);
        let sum = [0, 1, 2].map(|i| triangles.iter().map(|t| f64::from(t.normal[i])).sum::<f64>());
        let length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt().max(f64::MIN_POSITIVE);
        let axis = sum.map(|s| s / length);
        let cos = |t: &Triangle| (0..3).map(|i| f64::from(t.normal[i]) * axis[i]).sum::<f64>();
        // A little wider than it is, for what is lost in rounding.
        let cos = triangles.iter().map(cos).fold(1.0, f64::min) - 1e-5;
        // Where normals differ by a right angle or more, it faces away from nowhere.
        let (cos, sin) = if cos > 0.0 { (cos, (1.0 - cos * cos).sqrt()) } else { (0.0, 1.0) };
        for (row, value) in self.centre_m.iter_mut().zip(ball.centre_m) {
            row[lane] = value;
        }
        for (row, value) in self.axis.iter_mut().zip(axis) {
            row[lane] = value as f32;
        }
        self.radius_m[lane] = ball.radius_m;
        (self.cos[lane], self.sin[lane]) = (cos as f32, sin as f32);
    }
}

/// Eight triangles side by side. What is left of the last block repeats a corner: such triangles have no area.
fn block_of(triangles: &[Triangle]) -> Block {
    let mut block = Block::default();
    for lane in 0..LANES {
        let corners = triangles.get(lane).map_or([triangles[0].corners_m[0]; 3], |triangle| triangle.corners_m);
        for (rows, corner) in block.iter_mut().zip(corners) {
            for (row, value) in rows.iter_mut().zip(corner) {
                row[lane] = value;
            }
        }
    }
    block
}

/// Two halves that lie apart, the first of whole clusters; one if it is no more than a cluster.
fn halves(triangles: &mut [Triangle]) -> Vec<&mut [Triangle]> {
    if triangles.len() <= CLUSTER {
        return vec![triangles];
    }
    let half = triangles.len().div_ceil(2).next_multiple_of(CLUSTER);
    let (a, b) = split(triangles, half, |triangle| triangle.middle_m);
    [a, b].into_iter().filter(|half| !half.is_empty()).collect()
}

/// Brings the triangles of a cluster into an order in which each eight lie together and look into similar directions.
fn sort_into_blocks(triangles: &mut [Triangle], radius_m: f32) {
    if triangles.len() > LANES {
        let half = triangles.len().div_ceil(2).next_multiple_of(LANES);
        let (a, b) = split(triangles, half, |triangle| {
            let [x, y, z] = triangle.middle_m.map(|m| m / radius_m);
            let [u, v, w] = triangle.normal;
            [x, y, z, u, v, w]
        });
        sort_into_blocks(a, radius_m);
        sort_into_blocks(b, radius_m);
    }
}

/// Splits at `half` along the axis in which they differ most.
fn split<const N: usize>(
    triangles: &mut [Triangle],
    half: usize,
    by: impl Fn(&Triangle) -> [f32; N],
) -> (&mut [Triangle], &mut [Triangle]) {
    let (mut low, mut high) = ([f32::MAX; N], [f32::MIN; N]);
    for triangle in &*triangles {
        for (i, value) in by(triangle).into_iter().enumerate() {
            (low[i], high[i]) = (low[i].min(value), high[i].max(value));
        }
    }
    let widest = (0..N).max_by(|&a, &b| (high[a] - low[a]).total_cmp(&(high[b] - low[b]))).unwrap_or(0);
    triangles.sort_by(|a, b| by(a)[widest].total_cmp(&by(b)[widest]));
    triangles.split_at_mut(half.min(triangles.len()))
}

/// A ball about the middle of their bounds.
fn ball_about(triangles: &[Triangle]) -> Ball {
    let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
    let corners = || triangles.iter().flat_map(|triangle| &triangle.corners_m);
    for corner in corners() {
        for i in 0..3 {
            (low[i], high[i]) = (low[i].min(corner[i]), high[i].max(corner[i]));
        }
    }
    let centre_m = [0, 1, 2].map(|i| low[i] + (high[i] - low[i]) / 2.0);
    let distance = |corner: &[f32; 3]| (0..3).map(|i| f64::from(corner[i] - centre_m[i]).powi(2)).sum::<f64>();
    let square = corners().map(distance).fold(0.0, f64::max);
    // A little larger than it is, for what is lost in rounding.
    Ball { centre_m, radius_m: (square.sqrt() * (1.0 + 1e-6)) as f32 }
}
