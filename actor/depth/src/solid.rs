//! Solids drawn by their formula: planes, boxes, ellipsoids, cylinders and capsules.
//!
//! With `eye + ray / s` for the point of inverse depth `s` on a ray, each half-space that bounds a solid is entered or
//! left at an `s` that is affine over the image. So a box needs neither corners nor a near plane to cut it: it is seen
//! where each entry is nearer than each exit, which are at most six edges, and its inverse depth is that of its farthest
//! entry. All of it is set up in double precision.

use crate::affine::Affine;
use crate::camera::{Lens, Placed, Rectangle, dot};
use crate::image::Image;
use crate::simd::{LANES, Lanes};
use crate::surface::{Cylinder, Ellipsoid, Form, Planes};

/// A few of at most `N`.
struct Few<const N: usize> {
    all: [Affine; N],
    count: usize,
}

impl<const N: usize> Few<N> {
    fn new() -> Self {
        Self { all: [Affine::default(); N], count: 0 }
    }

    fn push(&mut self, affine: Affine) {
        self.all[self.count] = affine;
        self.count += 1;
    }

    fn as_slice(&self) -> &[Affine] {
        &self.all[..self.count]
    }
}

/// The slab -`half_m` to `half_m` along an axis, on which the eye is at `eye_m` and a ray moves by `ray`: where the ray
/// enters, unless the eye is inside, and where it leaves.
fn slab(half_m: f64, eye_m: f64, ray: Affine) -> (Option<Affine>, [Affine; 2]) {
    let [below, above] = [-half_m, half_m].map(|face_m| ray * (1.0 / (face_m - eye_m)));
    if eye_m > half_m {
        (Some(above), [below; 2])
    } else if eye_m < -half_m {
        (Some(below), [above; 2])
    } else {
        (None, [below, above])
    }
}

/// Notes for each row which of the pixels in the rectangle lie where none of these is negative.
fn mark_where_positive(image: &mut Image, at: Rectangle, conditions: &[Affine]) {
    let (least, most) = (Lanes::splat(at.left as f32), Lanes::splat(at.right as f32));
    // From which x on, or up to which, as a condition is met: `at_zero + per_y · y`.
    let mut edges = [(0.0f32, 0.0f32, false); 6];
    let mut level = Few::<6>::new();
    let mut count = 0;
    for &condition in conditions {
        let Affine { at_origin, per_x, per_y } = condition;
        if per_x == 0.0 {
            level.push(condition);
        } else {
            edges[count] = ((-at_origin / per_x) as f32, (-per_y / per_x) as f32, per_x > 0.0);
            count += 1;
        }
    }
    for row in (at.top..at.bottom).step_by(LANES) {
        let y_px = Lanes::splat(row as f32 + 0.5) + Lanes::ramp();
        let (mut left, mut right) = (least, most);
        for &(at_zero, per_y, from) in &edges[..count] {
            let first = (Lanes::splat(at_zero - 0.5) + Lanes::splat(per_y) * y_px).ceil();
            if from {
                left = first.max(left);
            } else {
                right = first.min(right);
            }
        }
        for condition in level.as_slice() {
            let value = Lanes::splat(condition.at_origin as f32) + Lanes::splat(condition.per_y as f32) * y_px;
            right = right.only(Lanes::splat(0.0).less(value));
        }
        left.store(image.left[row..].first_chunk_mut().expect("there is room for LANES rows from any row on"));
        right.store(image.right[row..].first_chunk_mut().expect("there is room for LANES rows from any row on"));
    }
}

fn sweep_planes(image: &mut Image, at: Rectangle, planes: &[Affine], [least, largest]: [f32; 2], number: u32) {
    let (top, bottom) = (at.top, at.bottom);
    let form = |i: usize| Form::from(planes[i]);
    match planes.len() {
        1 => image.sweep(top, bottom, &mut Planes { forms: [form(0)], least, largest }, number),
        2 => image.sweep(top, bottom, &mut Planes { forms: [form(0), form(1)], least, largest }, number),
        _ => image.sweep(top, bottom, &mut Planes { forms: [form(0), form(1), form(2)], least, largest }, number),
    }
}

/// The upper side of the rectangle that its half extents span about z = 0; without an end along an axis where that is 0.
pub(crate) fn plane(image: &mut Image, lens: &Lens, placed: &Placed, half_m: [f64; 2], at: Rectangle, number: u32) {
    let eye_m = placed.eye_m();
    if eye_m[2] <= 0.0 {
        return;
    }
    let ray = [0, 1, 2].map(|j| lens.along_rays(placed.column(j)));
    let inverse_m = ray[2] * (-1.0 / eye_m[2]);
    let mut inside = Few::<6>::new();
    for axis in [0, 1] {
        if half_m[axis] > 0.0 {
            // |eye · s + ray| ≤ half · s
            let position = inverse_m * eye_m[axis] + ray[axis];
            inside.push(inverse_m * half_m[axis] - position);
            inside.push(inverse_m * half_m[axis] + position);
        }
    }
    mark_where_positive(image, at, inside.as_slice());
    sweep_planes(image, at, &[inverse_m], [0.0, f32::MAX], number);
}

pub(crate) fn cuboid(image: &mut Image, lens: &Lens, placed: &Placed, half_m: [f64; 3], at: Rectangle, number: u32) {
    let Some(planes) = mark_cuboid(image, lens, placed, half_m, at) else { return };
    let (mut nearest_m, mut farthest_m) = (f64::MAX, 0.0f64);
    for corner in 0..8 {
        let sign = |axis: usize| if corner >> axis & 1 == 0 { half_m[axis] } else { -half_m[axis] };
        let z = placed.point([sign(0), sign(1), sign(2)])[2];
        (nearest_m, farthest_m) = (nearest_m.min(z), farthest_m.max(z));
    }
    let inverse = |depth_m: f64| if depth_m > 0.0 { (1.0 / depth_m) as f32 } else { f32::MAX };
    sweep_planes(image, at, planes.as_slice(), [inverse(farthest_m), inverse(nearest_m)], number);
}

/// Marks the pixels that show a box; the planes that look at the eye. None if the eye is inside.
fn mark_cuboid(image: &mut Image, lens: &Lens, placed: &Placed, half_m: [f64; 3], at: Rectangle) -> Option<Few<3>> {
    let eye_m = placed.eye_m();
    let slabs = [0, 1, 2].map(|i| slab(half_m[i], eye_m[i], lens.along_rays(placed.column(i))));
    let mut planes = Few::new();
    let mut inside = Few::<6>::new();
    for (i, (enters, _)) in slabs.iter().enumerate() {
        let Some(enters) = *enters else { continue };
        planes.push(enters);
        for (j, (enters_too, leaves)) in slabs.iter().enumerate() {
            if i != j {
                let leaves = if enters_too.is_some() { &leaves[..1] } else { &leaves[..] };
                for &leaves in leaves {
                    inside.push(enters - leaves);
                }
            }
        }
    }
    if planes.count == 0 {
        return None;
    }
    mark_where_positive(image, at, inside.as_slice());
    Some(planes)
}

/// An ellipsoid; a ball is one with three equal radii.
pub(crate) fn ellipsoid(
    image: &mut Image,
    lens: &Lens,
    placed: &Placed,
    radii_m: [f64; 3],
    at: Rectangle,
    number: u32,
) {
    // In the frame in which it is the unit ball.
    let eye_m = placed.eye_m();
    let eye = [0, 1, 2].map(|i| eye_m[i] / radii_m[i]);
    let outside = dot(eye, eye) - 1.0;
    if outside <= 0.0 {
        return;
    }
    let ray = [0, 1, 2].map(|i| lens.along_rays(placed.column(i)) * (1.0 / radii_m[i]));
    let [x, y, z] = placed.position_m;
    let seen_at = |across: f64, axis: usize, size: usize| {
        let position_px = lens.centre_px[axis] + lens.focal_px[axis] * across / z.max(lens.near_m);
        position_px.clamp(0.0, size as f64).floor()
    };
    let middle_px = [seen_at(x, 0, lens.width), seen_at(y, 1, lens.height)];
    // s² (eye² - 1) + 2 s eye·ray + ray² = 0, and the discriminant is ray² - (eye × ray)².
    let scale = 1.0 / outside;
    let towards = (ray[0] * eye[0] + ray[1] * eye[1] + ray[2] * eye[2]) * -scale;
    let ray = ray.map(|ray| ray.about(middle_px) * scale);
    let mut square = [0.0; 6];
    for i in 0..3 {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let across = ray[k] * eye[j] - ray[j] * eye[k];
        let (plus, minus) = (ray[i].times(ray[i]), across.times(across));
        for (square, (plus, minus)) in square.iter_mut().zip(plus.into_iter().zip(minus)) {
            *square += plus - minus;
        }
    }
    let mut surface = Ellipsoid {
        outside: towards.into(),
        middle_px: middle_px.map(|px| px as f32),
        square: square.map(|factor| factor as f32),
        in_row: [0.0; 2],
    };
    let (least, most) = (Lanes::splat(at.left as f32), Lanes::splat(at.right as f32));
    let half = Lanes::splat(0.5);
    for row in (at.top..at.bottom).step_by(LANES) {
        let [left, right] = surface.interval(row as f32 + 0.5);
        let room = "there is room for LANES rows from any row on";
        (left - half).ceil().max(least).store(image.left[row..].first_chunk_mut().expect(room));
        (right - half).ceil().min(most).store(image.right[row..].first_chunk_mut().expect(room));
    }
    image.sweep(at.top, at.bottom, &mut surface, number);
}

/// A cylinder along z.
pub(crate) fn cylinder(
    image: &mut Image,
    lens: &Lens,
    placed: &Placed,
    radius_m: f64,
    half_height_m: f64,
    at: Rectangle,
    number: u32,
) {
    let eye_m = placed.eye_m();
    let outside_m2 = eye_m[0] * eye_m[0] + eye_m[1] * eye_m[1] - radius_m * radius_m;
    // On the mantle itself the ray neither enters nor leaves it: taken as a hair inside.
    let outside_m2 = if outside_m2.abs() < 1e-12 { -1e-12 } else { outside_m2 };
    let ray = [0, 1, 2].map(|i| lens.along_rays(placed.column(i)));
    let (enters, leaves) = slab(half_height_m, eye_m[2], ray[2]);
    if outside_m2 <= 0.0 && enters.is_none() {
        return;
    }
    if mark_cuboid(image, lens, placed, [radius_m, radius_m, half_height_m], at).is_none() {
        mark_where_positive(image, at, &[]);
    }
    // s² (eye² - r²) + 2 s eye·ray + ray² = 0 in x and y; the discriminant is r² ray² - (eye × ray)².
    let scale = 1.0 / outside_m2;
    let mut surface = Cylinder {
        outside: ((ray[0] * eye_m[0] + ray[1] * eye_m[1]) * -scale).into(),
        across: [0, 1].map(|i| (ray[i] * (radius_m * scale)).into()),
        beside: ((ray[1] * eye_m[0] - ray[0] * eye_m[1]) * scale).into(),
        enters_mantle: outside_m2 > 0.0,
        enters: enters.map(Form::from),
        leaves: leaves.map(Form::from),
    };
    image.sweep(at.top, at.bottom, &mut surface, number);
}

/// A capsule along z: a cylinder and two balls, of which the nearest is seen.
pub(crate) fn capsule(
    image: &mut Image,
    lens: &Lens,
    placed: &Placed,
    radius_m: f64,
    half_height_m: f64,
    at: Rectangle,
    number: u32,
) {
    let [x, y, z] = placed.eye_m();
    let beyond_m = (z.abs() - half_height_m).max(0.0);
    if x * x + y * y + beyond_m * beyond_m <= radius_m * radius_m {
        return;
    }
    cylinder(image, lens, placed, radius_m, half_height_m, at, number);
    for along_m in [-half_height_m, half_height_m] {
        let end = Placed { position_m: placed.point([0.0, 0.0, along_m]), ..*placed };
        if let Some(at) = lens.rectangle(end.position_m, radius_m) {
            ellipsoid(image, lens, &end, [radius_m; 3], at, number);
        }
    }
}
