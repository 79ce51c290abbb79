//! Draws meshes: eight triangles at a time up to where each covers pixels, then one by one.
//!
//! Corners are rounded to 1/128 of a pixel, so that what decides whether a pixel's centre lies inside is exact: whole
//! numbers of less than 2²⁴ in single precision for small triangles, double precision for others. A centre exactly on
//! an edge belongs to the side to its right (or below). So triangles that share an edge leave no gap. Depth is that of
//! the plane through the corners, between the least and the greatest of theirs.

use crate::affine::Affine;
use crate::camera::{Lens, Placed, Rectangle};
use crate::image::Image;
use crate::mesh::{Block, Mesh, Node, Parts};
use crate::simd::{LANES, Lanes, Mask};
use crate::surface::Planes;

/// Parts of a pixel that corners are rounded to.
const UNITS: f32 = 128.0;
const HALF: f32 = UNITS / 2.0;
/// Rows that a small triangle may have, and columns.
const SMALL: f32 = 16.0;

/// How far from its own bounds a part may be seen, in units: corners are rounded, and so are the bounds.
const MARGIN: f32 = 4.0;

struct View<'a> {
    image: &'a mut Image,
    mesh: &'a Mesh,
    /// Rows of the matrix to the camera's frame, those of x and y in units per slope, and what is added; twice.
    matrix: [[f32; 4]; 3],
    rows: [[Lanes; 4]; 3],
    /// Factors of those rows, and the image's centre, units from the top left.
    factors: [f32; 2],
    centre: [f32; 2],
    eye_m: [f32; 3],
    near_m: f32,
    far_m: f32,
    number: u32,
}

/// Eight corners in the image, in units, with their inverse depths and depths.
#[derive(Clone, Copy)]
struct Corners {
    x: Lanes,
    y: Lanes,
    /// The same before rounding.
    exact: [Lanes; 2],
    inverse_m: Lanes,
    z: Lanes,
}

/// A corner in the image, in units, and its inverse depth.
#[derive(Debug, Clone, Copy, Default)]
struct Corner {
    x: f64,
    y: f64,
    inverse_m: f64,
}

pub(crate) fn mesh(image: &mut Image, lens: &Lens, placed: &Placed, mesh: &Mesh, number: u32) {
    let factors = lens.focal_px.map(|px| px * f64::from(UNITS));
    let matrix = [0, 1, 2].map(|i| {
        let [x, y, z] = placed.rotation[i];
        let factor = if i < 2 { factors[i] } else { 1.0 };
        [x, y, z, placed.position_m[i]].map(|value| (value * factor) as f32)
    });
    let mut view = View {
        image,
        mesh,
        matrix,
        rows: matrix.map(|row| row.map(Lanes::splat)),
        factors: factors.map(|factor| factor as f32),
        centre: lens.centre_px.map(|px| (px * f64::from(UNITS)) as f32),
        eye_m: placed.eye_m().map(|m| m as f32),
        near_m: lens.near_m as f32,
        far_m: lens.far_m as f32,
        number,
    };
    if !mesh.nodes.is_empty() {
        view.node(0);
    }
}

/// First pixel whose centre lies at or beyond a position in units.
#[inline(always)]
fn first_centre(position: Lanes, most: usize) -> Lanes {
    let first = ((position - Lanes::splat(HALF)) * Lanes::splat(1.0 / UNITS)).ceil();
    first.max(Lanes::splat(0.0)).min(Lanes::splat(most as f32))
}

#[inline(always)]
fn dot(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Which parts of a node may be seen, where at most, and how near.
struct Seen {
    parts: u32,
    left: [f32; LANES],
    right: [f32; LANES],
    top: [f32; LANES],
    bottom: [f32; LANES],
    nearest_m: [f32; LANES],
}

impl Seen {
    fn at(&self, part: usize) -> Rectangle {
        let [left, right, top, bottom] =
            [&self.left, &self.right, &self.top, &self.bottom].map(|edge| edge[part] as i32 as usize);
        Rectangle { left, right, top, bottom }
    }
}

impl<'a> View<'a> {
    /// Draws a node, its nearest part first.
    fn node(&mut self, number: u32) {
        let mesh: &'a Mesh = self.mesh;
        let node = &mesh.nodes[number as usize];
        let seen = self.seen(node);
        let mut parts = seen.parts & ((1 << node.count) - 1);
        match &node.parts {
            Parts::Blocks(first) => {
                let (mut from, mut to) = ([usize::MAX; 2], [0; 2]);
                while parts != 0 {
                    let part = parts.trailing_zeros();
                    parts &= parts - 1;
                    let at = seen.at(part as usize);
                    from = [from[0].min(at.left), from[1].min(at.top)];
                    to = [to[0].max(at.right), to[1].max(at.bottom)];
                    self.block(&mesh.blocks[(first + part) as usize]);
                }
                if from[0] < to[0] {
                    self.image.touch(Rectangle { left: from[0], right: to[0], top: from[1], bottom: to[1] });
                }
            }
            Parts::Nodes(nodes) => {
                let mut order = [(0.0f32, 0usize); LANES];
                let mut count = 0;
                while parts != 0 {
                    let part = parts.trailing_zeros() as usize;
                    parts &= parts - 1;
                    order[count] = (seen.nearest_m[part], part);
                    count += 1;
                }
                order[..count].sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                for &(nearest_m, part) in &order[..count] {
                    if nearest_m <= self.near_m || !self.image.hides(seen.at(part), 1.0 / nearest_m) {
                        self.node(nodes[part]);
                    }
                }
            }
        }
    }

    /// Which parts of a node may have a triangle that is seen.
    #[inline(always)]
    fn seen(&self, node: &Node) -> Seen {
        let centre = [0, 1, 2].map(|i| Lanes::load(&node.centre_m[i]));
        let radius = Lanes::load(&node.radius_m);
        // Those that look away: away is where the middle is, as the eye sees it.
        let away = [0, 1, 2].map(|i| centre[i] - Lanes::splat(self.eye_m[i]));
        let axis = [0, 1, 2].map(|i| Lanes::load(&node.axis[i]));
        let along = dot(away, axis);
        let across = (dot(away, away) - along * along).max(Lanes::splat(0.0)).sqrt();
        let least = along * Lanes::load(&node.cos) - across * Lanes::load(&node.sin);
        // A little more than the radius, for what is lost in rounding.
        let facing = least.less(radius + along.max(Lanes::splat(0.0)) * Lanes::splat(1e-5));

        let [x, y, z] = [0, 1, 2].map(|i| {
            let row = &self.rows[i];
            row[0] * centre[0] + row[1] * centre[1] + (row[2] * centre[2] + row[3])
        });
        let (nearest, farthest) = (z - radius, z + radius);
        let between = Lanes::splat(self.near_m).less(farthest).and(nearest.less(Lanes::splat(self.far_m)));
        let whole = Lanes::splat(self.near_m).less(nearest);
        let one = Lanes::splat(1.0);
        let per_depth = [one / nearest, one / farthest];
        let [left, right] = self.bounds(0, x, radius, per_depth, whole, self.image.width());
        let [top, bottom] = self.bounds(1, y, radius, per_depth, whole, self.image.height());
        Seen {
            parts: facing.and(between).and(left.less(right)).and(top.less(bottom)).bits(),
            left: left.to_array(),
            right: right.to_array(),
            top: top.to_array(),
            bottom: bottom.to_array(),
            nearest_m: nearest.to_array(),
        }
    }

    /// The pixels along an axis whose centres may lie within balls; all if a ball reaches the near plane.
    #[inline(always)]
    fn bounds(
        &self,
        axis: usize,
        middle: Lanes,
        radius_m: Lanes,
        [per_nearest, per_farthest]: [Lanes; 2],
        whole: Mask,
        most: usize,
    ) -> [Lanes; 2] {
        let zero = Lanes::splat(0.0);
        let radius = radius_m * Lanes::splat(self.factors[axis]);
        let (low, high) = (middle - radius, middle + radius);
        let low = low * per_nearest.or_else(low.less(zero), per_farthest);
        let high = high * per_farthest.or_else(high.less(zero), per_nearest);
        let centre = self.centre[axis];
        let first = first_centre(low + Lanes::splat(centre - MARGIN), most).or_else(whole, zero);
        let end = first_centre(high + Lanes::splat(centre + MARGIN), most).or_else(whole, Lanes::splat(most as f32));
        [first, end]
    }

    #[inline(always)]
    fn corners(&self, corner: &[[f32; LANES]; 3]) -> Corners {
        // Below 2²², adding and taking away leaves a whole number, the nearest.
        let round = Lanes::splat(12_582_912.0);
        let (x, y, z) = (Lanes::load(&corner[0]), Lanes::load(&corner[1]), Lanes::load(&corner[2]));
        let [across, down, ahead] = &self.rows;
        let across = across[0] * x + across[1] * y + (across[2] * z + across[3]);
        let down = down[0] * x + down[1] * y + (down[2] * z + down[3]);
        let ahead = ahead[0] * x + ahead[1] * y + (ahead[2] * z + ahead[3]);
        let inverse_m = Lanes::splat(1.0) / ahead;
        let x = across * inverse_m + Lanes::splat(self.centre[0]);
        let y = down * inverse_m + Lanes::splat(self.centre[1]);
        Corners { x: x + round - round, y: y + round - round, exact: [x, y], inverse_m, z: ahead }
    }

    #[inline(always)]
    fn block(&mut self, block: &Block) {
        let (a, b, c) = (self.corners(&block[0]), self.corners(&block[1]), self.corners(&block[2]));
        let mut cut = a.z.min(b.z).min(c.z).less(Lanes::splat(self.near_m)).bits();
        let zero = Lanes::splat(0.0);
        let area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
        let (left, right) = (a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
        let (top, bottom) = (a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
        let (width, height) = (self.image.width(), self.image.height());
        let (first_column, end_column) = (first_centre(left, width), first_centre(right, width));
        let (first_row, end_row) = (first_centre(top, height), first_centre(bottom, height));
        let some = first_column.less(end_column).and(first_row.less(end_row));
        let seen = zero.less(area).and(some).bits() & !cut;
        if seen | cut == 0 {
            return;
        }
        let most = Lanes::splat(SMALL * UNITS + HALF);
        let fits = (end_column - first_column).less(Lanes::splat(SMALL + 0.5));
        let small = fits.and((right - left).less(most)).and((bottom - top).less(most)).bits();
        if seen & small != 0 {
            let nearest = Lanes::splat(self.image.nearest);
            let triangles = Small::new([a, b, c], [first_column, first_row], [end_column, end_row], nearest);
            let mut left = seen & small;
            while left != 0 {
                triangles.draw(left.trailing_zeros() as usize, self.image, self.number);
                left &= left - 1;
            }
        }
        let mut others = seen & !small;
        if others != 0 {
            let corners = [a, b, c].map(|at| (at.x.to_array(), at.y.to_array(), at.inverse_m.to_array()));
            while others != 0 {
                let lane = others.trailing_zeros() as usize;
                let corners = corners.map(|(x, y, inverse_m)| Corner {
                    x: x[lane].into(),
                    y: y[lane].into(),
                    inverse_m: inverse_m[lane].into(),
                });
                fill(self.image, corners, self.number);
                others &= others - 1;
            }
        }
        while cut != 0 {
            self.clip(block, cut.trailing_zeros() as usize);
            cut &= cut - 1;
        }
    }

    /// Draws what of a triangle lies beyond the near plane.
    #[inline(never)]
    fn clip(&mut self, block: &Block, lane: usize) {
        let mut corners = [[0.0; 3]; 3];
        for (corner, from) in corners.iter_mut().zip(block) {
            let [x, y, z] = [from[0][lane], from[1][lane], from[2][lane]];
            for (value, row) in corner.iter_mut().zip(&self.matrix) {
                *value = row[0] * x + row[1] * y + (row[2] * z + row[3]);
            }
        }
        if corners.iter().all(|corner| corner[2] < self.near_m) {
            return;
        }
        let mut polygon = [[0.0; 3]; 4];
        let mut count = 0;
        for i in 0..3 {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            let [in_front, next_in_front] = [a, b].map(|corner| corner[2] >= self.near_m);
            if in_front {
                polygon[count] = a;
                count += 1;
            }
            if in_front != next_in_front {
                // From the end that is behind, whichever way the edge runs.
                let (behind, ahead) = if in_front { (b, a) } else { (a, b) };
                let share = (self.near_m - behind[2]) / (ahead[2] - behind[2]);
                polygon[count] = [0, 1, 2].map(|k| behind[k] + (ahead[k] - behind[k]) * share);
                polygon[count][2] = self.near_m;
                count += 1;
            }
        }
        let corner = |[x, y, z]: [f32; 3]| {
            let inverse_m = 1.0 / z;
            let at = |value: f32, centre: f32| f64::from((value * inverse_m + centre).round_ties_even());
            Corner { x: at(x, self.centre[0]), y: at(y, self.centre[1]), inverse_m: inverse_m.into() }
        };
        let polygon = polygon.map(corner);
        for i in 2..count {
            fill(self.image, [polygon[0], polygon[i - 1], polygon[i]], self.number);
        }
    }
}

/// Eight triangles, of which some are small.
struct Small {
    /// Of each edge, and of inverse depth: at the first pixel, per column, per row.
    edges: [[[f32; LANES]; 3]; 3],
    plane: [[f32; LANES]; 3],
    least: [f32; LANES],
    largest: [f32; LANES],
    first_column: [f32; LANES],
    first_row: [f32; LANES],
    end_row: [f32; LANES],
    end_column: [f32; LANES],
}

impl Small {
    #[inline(always)]
    fn new([a, b, c]: [Corners; 3], first: [Lanes; 2], end: [Lanes; 2], nearest: Lanes) -> Self {
        let x = first[0] * Lanes::splat(UNITS) + Lanes::splat(HALF);
        let y = first[1] * Lanes::splat(UNITS) + Lanes::splat(HALF);
        // Of a sliver rounding makes another plane: that is found without.
        let ([ax, ay], [bx, by], [cx, cy]) = (a.exact, b.exact, c.exact);
        let (bx, by, cx, cy) = (bx - ax, by - ay, cx - ax, cy - ay);
        let scale = Lanes::splat(1.0) / (bx * cy - cx * by);
        let (b_before, c_before) = (b.inverse_m - a.inverse_m, c.inverse_m - a.inverse_m);
        let per_x = (b_before * cy - c_before * by) * scale;
        let per_y = (c_before * bx - b_before * cx) * scale;
        let at_first = a.inverse_m + per_x * (x - ax) + per_y * (y - ay);
        let units = Lanes::splat(UNITS);
        Self {
            edges: [edge(a, b, x, y), edge(b, c, x, y), edge(c, a, x, y)],
            plane: [at_first.to_array(), (per_x * units).to_array(), (per_y * units).to_array()],
            least: a.inverse_m.min(b.inverse_m).min(c.inverse_m).to_array(),
            largest: a.inverse_m.max(b.inverse_m).max(c.inverse_m).min(nearest).to_array(),
            first_column: first[0].to_array(),
            first_row: first[1].to_array(),
            end_column: end[0].to_array(),
            end_row: end[1].to_array(),
        }
    }

    #[inline(always)]
    fn draw(&self, lane: usize, image: &mut Image, number: u32) {
        let lane = lane & (LANES - 1);
        let number = Lanes::splat(f32::from_bits(number));
        let (least, largest) = (Lanes::splat(self.least[lane]), Lanes::splat(self.largest[lane]));
        let outside = Lanes::splat(-0.5);
        let pixels = |from: &[f32; LANES], to: &[f32; LANES]| from[lane] as i32 as usize..to[lane] as i32 as usize;
        let rows = pixels(&self.first_row, &self.end_row);
        let mut x = Lanes::ramp();
        for column in pixels(&self.first_column, &self.end_column).step_by(LANES) {
            let start = |form: &[[f32; LANES]; 3]| Lanes::splat(form[0][lane]) + Lanes::splat(form[1][lane]) * x;
            let (mut a, mut b, mut c) = (start(&self.edges[0]), start(&self.edges[1]), start(&self.edges[2]));
            let mut value = start(&self.plane);
            for row in rows.clone() {
                let inside = outside.less(a.min(b).min(c));
                image.put(row, column, value.min(largest).max(least).only(inside), number);
                a = a + Lanes::splat(self.edges[0][2][lane]);
                b = b + Lanes::splat(self.edges[1][2][lane]);
                c = c + Lanes::splat(self.edges[2][2][lane]);
                value = value + Lanes::splat(self.plane[2][lane]);
            }
            x = x + Lanes::splat(LANES as f32);
        }
    }
}

/// An edge: positive at pixels on its right, where a centre on it counts if it runs up, or level to the right.
#[inline(always)]
fn edge(from: Corners, to: Corners, x: Lanes, y: Lanes) -> [[f32; LANES]; 3] {
    let zero = Lanes::splat(0.0);
    let (per_x, per_y) = (from.y - to.y, to.x - from.x);
    let at = per_y * (y - from.y) + per_x * (x - from.x);
    // Whole numbers: a level edge is less than this part of one long.
    let counts = zero.less(per_x + per_y * Lanes::splat(1.0 / 4096.0));
    let at = at - zero.or_else(counts, Lanes::splat(1.0));
    let units = Lanes::splat(UNITS);
    [at.to_array(), (per_x * units).to_array(), (per_y * units).to_array()]
}

fn fill(image: &mut Image, corners: [Corner; 3], number: u32) {
    let [a, b, c] = corners;
    let (dx1, dy1, dx2, dy2) = (b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
    let area = dx1 * dy2 - dx2 * dy1;
    if area <= 0.0 {
        return;
    }
    let (ds1, ds2) = (b.inverse_m - a.inverse_m, c.inverse_m - a.inverse_m);
    let units = f64::from(UNITS);
    let (per_x, per_y) = ((ds1 * dy2 - ds2 * dy1) / area, (ds2 * dx1 - ds1 * dx2) / area);
    let at_origin = a.inverse_m - per_x * a.x - per_y * a.y;
    let plane = Affine { at_origin, per_x: per_x * units, per_y: per_y * units };
    let [s0, s1, s2] = corners.map(|corner| corner.inverse_m as f32);
    let mut surface =
        Planes { forms: [plane.into()], least: s0.min(s1).min(s2), largest: s0.max(s1).max(s2).min(image.nearest) };

    let mut sorted = corners;
    sorted.sort_unstable_by(|a, b| a.y.total_cmp(&b.y));
    let [upper, middle, lower] = sorted;
    let [top, knee, bottom] = sorted.map(|corner| first_centre_of(corner.y, image.height()) as usize);
    if top == bottom {
        return;
    }
    let long = Edge::new(upper, lower);
    let (above, below) = (Edge::new(upper, middle), Edge::new(middle, lower));
    // The long edge is on the left if the middle corner is on its right.
    let long_is_left = (lower.x - upper.x) * (middle.y - upper.y) < (middle.x - upper.x) * (lower.y - upper.y);
    let width = image.width();
    let (long_side, short_side) =
        if long_is_left { (&mut image.left, &mut image.right) } else { (&mut image.right, &mut image.left) };
    long.mark(long_side, top, bottom, width);
    // Eight rows at a time, so that the lower edge overwrites what is too much of the upper one.
    above.mark(short_side, top, knee, width);
    below.mark(short_side, knee, bottom, width);
    image.sweep(top, bottom, &mut surface, number);
}

fn first_centre_of(position: f64, most: usize) -> f64 {
    ((position - f64::from(HALF)) / f64::from(UNITS)).ceil().clamp(0.0, most as f64)
}

/// An edge that runs down.
struct Edge {
    upper: Corner,
    lower: Corner,
}

impl Edge {
    fn new(upper: Corner, lower: Corner) -> Self {
        Self { upper, lower }
    }

    /// Notes for these rows the first pixel whose centre lies at the edge or on its right.
    fn mark(&self, side: &mut [f32], top: usize, bottom: usize, width: usize) {
        // In single precision it is known but where the edge passes close to a centre, or far from the image.
        const CLOSE: f32 = 1.0 / 64.0;
        const FAR_PX: f64 = 4096.0;
        let Self { upper, lower } = self;
        let units = f64::from(UNITS);
        let slope = (lower.x - upper.x) / (lower.y - upper.y);
        let near = [upper.x, upper.y, lower.x, lower.y].iter().all(|position| position.abs() < FAR_PX * units);
        let at_zero = (upper.x - upper.y * slope) / units;
        if !near || at_zero.abs() > FAR_PX {
            (top..bottom).for_each(|row| side[row] = self.crossing(row, width));
            return;
        }
        let (at_zero, slope, most) = (Lanes::splat(at_zero as f32 - 0.5), Lanes::splat(slope as f32), width as f32);
        for row in (top..bottom).step_by(LANES) {
            let y = Lanes::splat(row as f32 + 0.5) + Lanes::ramp();
            let position = at_zero + slope * y;
            let first = position.ceil();
            let below = first - position;
            let close = below.less(Lanes::splat(CLOSE)).bits() | Lanes::splat(1.0 - CLOSE).less(below).bits();
            let limited = first.max(Lanes::splat(0.0)).min(Lanes::splat(most));
            limited.store(side[row..].first_chunk_mut().expect("there is room for LANES rows from any row on"));
            let mut close = close;
            while close != 0 {
                let row = row + close.trailing_zeros() as usize;
                if row < bottom {
                    side[row] = self.crossing(row, width);
                }
                close &= close - 1;
            }
        }
    }

    /// The same of one row, exactly.
    fn crossing(&self, row: usize, width: usize) -> f32 {
        let Self { upper, lower } = self;
        let y = row as f64 * f64::from(UNITS) + f64::from(HALF);
        let x = upper.x + (y - upper.y) * (lower.x - upper.x) / (lower.y - upper.y);
        first_centre_of(x, width) as f32
    }
}
