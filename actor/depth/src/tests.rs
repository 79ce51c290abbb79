//! The rasteriser against an independent ray caster in double precision, and against itself.

use crate::{Camera, DEPTH_MAX_MM, Lens, Mesh, MeshError, Pose, Renderer, Scene, Shape};
use std::sync::Arc;

const SIDE: usize = 90;
const NEAR_M: f64 = 0.05;
const FAR_M: f64 = 20.0;

/// A small generator of random numbers.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn pose(&mut self, reach_m: f64) -> Pose {
        let [w, x, y, z] = loop {
            let q = [0; 4].map(|_| self.between(-1.0, 1.0));
            let length = q.iter().map(|q| q * q).sum::<f64>().sqrt();
            if (0.1..1.0).contains(&length) {
                break q.map(|q| q / length);
            }
        };
        Pose {
            rotation: [
                [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
            ],
            position_m: [0; 3].map(|_| self.between(-reach_m, reach_m)),
        }
    }
}

fn camera(width: usize, height: usize) -> Camera {
    // Looks along -z, from two metres above the origin.
    let world_from_camera =
        Pose { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], position_m: [0.0, 0.0, 2.0] };
    // The height spans 69 degrees.
    let focal_px = [height as f64 / 2.0 / 0.684; 2];
    let centre_px = [width as f64 / 2.0, height as f64 / 2.0];
    Camera { world_from_camera, lens: Lens { width, height, focal_px, centre_px, near_m: NEAR_M, far_m: FAR_M } }
}

fn render(scene: &Scene, camera: &Camera, poses: &[Pose]) -> (Vec<f32>, Vec<i32>) {
    let mut renderer = Renderer::default();
    renderer.render(scene, camera, |number| poses[number as usize]);
    let pixels = camera.lens.width * camera.lens.height;
    let (mut depth_m, mut numbers) = (vec![0.0; pixels], vec![0; pixels]);
    renderer.metres(&mut depth_m);
    renderer.numbers(&mut numbers);
    (depth_m, numbers)
}

type Vector = [f64; 3];

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn along(origin: Vector, t: f64, ray: Vector) -> Vector {
    [0, 1, 2].map(|i| origin[i] + t * ray[i])
}

/// What the ray caster has: the triangles of a mesh, or a shape.
enum Solid {
    Shape(Shape),
    Triangles(Vec<[Vector; 3]>),
}

/// Where a ray enters a solid from outside, in lengths of the ray.
fn enters(solid: &Solid, origin: Vector, ray: Vector) -> Option<f64> {
    // Roots of a t² + 2 b t + c.
    let roots = |a: f64, b: f64, c: f64| {
        let root = (b * b - a * c).sqrt();
        (!root.is_nan()).then(|| [(-b - root) / a, (-b + root) / a])
    };
    match solid {
        Solid::Triangles(triangles) => triangles
            .iter()
            .filter_map(|&[a, b, c]| {
                let between = |p: Vector, q: Vector| [0, 1, 2].map(|i| q[i] - p[i]);
                let normal = cross(between(a, b), between(a, c));
                let towards = dot(normal, ray);
                let t = dot(normal, between(origin, a)) / towards;
                let hit = along(origin, t, ray);
                let inside = [(a, b), (b, c), (c, a)]
                    .iter()
                    .all(|&(p, q)| dot(cross(between(p, q), between(p, hit)), normal) >= 0.0);
                (towards < 0.0 && inside && t > 0.0).then_some(t)
            })
            .min_by(f64::total_cmp),
        Solid::Shape(Shape::Plane { half_m }) => {
            let t = -origin[2] / ray[2];
            let hit = along(origin, t, ray);
            let inside = (0..2).all(|i| half_m[i] == 0.0 || hit[i].abs() <= half_m[i]);
            (ray[2] < 0.0 && t > 0.0 && inside).then_some(t)
        }
        Solid::Shape(Shape::Ellipsoid { radii_m }) => {
            let (o, d) = ([0, 1, 2].map(|i| origin[i] / radii_m[i]), [0, 1, 2].map(|i| ray[i] / radii_m[i]));
            let [t, _] = roots(dot(d, d), dot(o, d), dot(o, o) - 1.0)?;
            (t > 0.0).then_some(t)
        }
        Solid::Shape(Shape::Cuboid { half_m }) => {
            let mut span = [f64::MIN, f64::MAX];
            for i in 0..3 {
                let mut ends = [-1.0, 1.0].map(|side| (side * half_m[i] - origin[i]) / ray[i]);
                ends.sort_by(f64::total_cmp);
                span = [span[0].max(ends[0]), span[1].min(ends[1])];
            }
            (span[0] > 0.0 && span[0] < span[1]).then_some(span[0])
        }
        &Solid::Shape(Shape::Cylinder { radius_m, half_height_m }) => {
            let flat = |v: Vector| [v[0], v[1], 0.0];
            let (o, d) = (flat(origin), flat(ray));
            let mantle = roots(dot(d, d), dot(o, d), dot(o, o) - radius_m * radius_m)?;
            let mut caps = [-1.0, 1.0].map(|side| (side * half_height_m - origin[2]) / ray[2]);
            caps.sort_by(f64::total_cmp);
            let span = [mantle[0].max(caps[0]), mantle[1].min(caps[1])];
            (span[0] > 0.0 && span[0] < span[1]).then_some(span[0])
        }
        &Solid::Shape(Shape::Capsule { radius_m, half_height_m }) => {
            let ends = [-half_height_m, half_height_m].map(|end| [origin[0], origin[1], origin[2] - end]);
            let inside = |p: Vector| dot(p, p) < radius_m * radius_m;
            let middle = [origin[0], origin[1], 0.0];
            if ends.into_iter().any(inside) || inside(middle) && origin[2].abs() < half_height_m {
                return None;
            }
            let ball = Solid::Shape(Shape::Ellipsoid { radii_m: [radius_m; 3] });
            let cylinder = Solid::Shape(Shape::Cylinder { radius_m, half_height_m });
            let parts = ends.map(|end| enters(&ball, end, ray));
            parts.into_iter().chain([enters(&cylinder, origin, ray)]).flatten().min_by(f64::total_cmp)
        }
        Solid::Shape(Shape::Mesh(_)) => unreachable!("a mesh is given by its triangles"),
    }
}

/// The nearest of what rays meet: depth and number.
fn cast(solids: &[Solid], camera: &Camera, poses: &[Pose]) -> Vec<Option<(f64, usize)>> {
    let lens = &camera.lens;
    let mut out = Vec::new();
    for pixel in 0..lens.width * lens.height {
        let [column, row] = [pixel % lens.width, pixel / lens.width].map(|i| i as f64 + 0.5);
        let x = (column - lens.centre_px[0]) / lens.focal_px[0];
        let y = (row - lens.centre_px[1]) / lens.focal_px[1];
        let view = &camera.world_from_camera;
        let ray = view.rotation.map(|axis| dot(axis, [x, -y, -1.0]));
        let hits = solids.iter().zip(poses).enumerate().filter_map(|(number, (solid, pose))| {
            let between = [0, 1, 2].map(|i| view.position_m[i] - pose.position_m[i]);
            let into = |v: Vector| [0, 1, 2].map(|j| (0..3).map(|i| pose.rotation[i][j] * v[i]).sum::<f64>());
            let depth_m = enters(solid, into(between), into(ray))?;
            (NEAR_M..FAR_M).contains(&depth_m).then_some((depth_m, number))
        });
        out.push(hits.min_by(|a, b| a.0.total_cmp(&b.0)));
    }
    out
}

/// Away from silhouettes, where a pixel and its eight neighbours show the same thing.
fn interior(shown: &[Option<(f64, usize)>], width: usize, pixel: usize) -> bool {
    let height = shown.len() / width;
    let number = |pixel: usize| shown[pixel].map(|(_, number)| number);
    let (column, row) = (pixel % width, pixel / width);
    (row.max(1) - 1..=(row + 1).min(height - 1))
        .all(|y| (column.max(1) - 1..=(column + 1).min(width - 1)).all(|x| number(y * width + x) == number(pixel)))
}

/// A dented ball of this many rings, its triangles with it.
fn dented(random: &mut Random, rings: usize) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let across = 2 * rings;
    let mut vertices = Vec::new();
    for ring in 0..=rings {
        for i in 0..across {
            let (up, around) = (ring as f64 / rings as f64, i as f64 / across as f64);
            let (sin, cos) = libm::sincos(std::f64::consts::PI * up);
            let (sin_around, cos_around) = libm::sincos(2.0 * std::f64::consts::PI * around);
            // One point at each pole.
            let radius = if ring % rings == 0 { 0.4 } else { random.between(0.25, 0.5) };
            vertices.push([radius * sin * cos_around, radius * sin * sin_around, radius * cos].map(|m| m as f32));
        }
    }
    let mut triangles = Vec::new();
    for ring in 0..rings {
        for i in 0..across {
            let [a, b] = [i, (i + 1) % across].map(|i| (ring * across + i) as u32);
            let [c, d] = [a + across as u32, b + across as u32];
            triangles.extend([[a, c, d], [a, d, b]]);
        }
    }
    (vertices, triangles)
}

fn solid(random: &mut Random, kind: u64) -> (Shape, Solid) {
    let size = |random: &mut Random| random.between(0.04, 0.5);
    let shape = match kind {
        0 => Shape::Plane { half_m: [size(random), size(random)] },
        1 => Shape::Cuboid { half_m: [0; 3].map(|_| size(random)) },
        2 => Shape::Ellipsoid { radii_m: [0; 3].map(|_| size(random)) },
        3 => Shape::Cylinder { radius_m: size(random), half_height_m: size(random) },
        4 => Shape::Capsule { radius_m: size(random), half_height_m: size(random) },
        _ => {
            let rings = 3 + (random.next() % 12) as usize;
            let (vertices, triangles) = dented(random, rings);
            let list = triangles.iter().map(|t| t.map(|i| vertices[i as usize].map(f64::from))).collect();
            let mesh = Mesh::new(&vertices, &triangles).unwrap();
            return (Shape::Mesh(Arc::new(mesh)), Solid::Triangles(list));
        }
    };
    (shape.clone(), Solid::Shape(shape))
}

#[test]
fn random_scenes_agree_with_rays() {
    let camera = camera(SIDE + 7, SIDE);
    let (mut of_each, mut at_dents) = ([0; 6], 0);
    for seed in 0..24 {
        let random = &mut Random(seed);
        let (mut scene, mut solids, mut poses) = (Scene::default(), Vec::new(), Vec::new());
        for number in 0..12 {
            let (shape, solid) = solid(random, (u64::from(number) + seed) % 6);
            scene.add(number, shape);
            solids.push(solid);
            // Some reach the near plane, some have the eye inside.
            poses.push(random.pose(1.9));
        }
        let (depth_m, numbers) = render(&scene, &camera, &poses);
        let shown = cast(&solids, &camera, &poses);
        for (pixel, expected) in shown.iter().enumerate() {
            if !interior(&shown, camera.lens.width, pixel) {
                continue;
            }
            let (expected_m, number) = expected.map_or((0.0, -1), |(depth_m, number)| (depth_m, number as i32));
            let off = (f64::from(depth_m[pixel]) - expected_m).abs();
            let tolerance = 1e-3f64.max(1e-3 * expected_m);
            let is_dented = expected.is_some_and(|(_, number)| matches!(solids[number], Solid::Triangles(_)));
            if is_dented && off > tolerance {
                // A dent has silhouettes in its middle.
                at_dents += 1;
                continue;
            }
            assert_eq!(numbers[pixel], number, "seed {seed}, pixel {pixel}: {expected:?}");
            assert!(off <= tolerance, "seed {seed}, pixel {pixel}: {} m, {expected:?}", depth_m[pixel]);
            if let Some((_, number)) = expected {
                of_each[(number + seed as usize) % 6] += 1;
            }
        }
    }
    assert!(of_each.iter().all(|&pixels| pixels > 1_000) && at_dents * 50 < of_each[5], "{of_each:?}, {at_dents}");
}

/// A wall of triangles without order that covers the image, from before the near plane to far away.
#[test]
fn a_mesh_has_no_gaps() {
    for seed in 0..40 {
        let random = &mut Random(seed);
        let count = 2 + (random.next() % 60) as usize;
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for i in 0..count * count {
            let [x, y] = [i % count, i / count].map(|i| 16.0 * (i as f64 / (count - 1) as f64 - 0.5));
            let inside = |i: usize| !i.is_multiple_of(count) && i % count != count - 1;
            let off = if inside(i) && inside(i / count) { 4.0 / count as f64 } else { 0.0 };
            let [x, y] = [x, y].map(|at| at + random.between(-off, off));
            vertices.push([x, y, random.between(-0.2, 0.2)].map(|m| m as f32));
        }
        for i in 0..count * count {
            if i % count != count - 1 && i / count != count - 1 {
                let [a, b, c, d] = [i, i + 1, i + count, i + count + 1].map(|i| i as u32);
                triangles.extend([[a, b, d], [a, d, c]]);
            }
        }
        let mut scene = Scene::default();
        scene.add(0, Shape::Mesh(Arc::new(Mesh::new(&vertices, &triangles).unwrap())));
        // A steep wall: some of its corners are behind the eye.
        let tilt = random.between(-0.6, 0.6);
        let (sin, cos) = libm::sincos(tilt);
        let rotation = [[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]];
        let mut camera = camera(64, 48);
        camera.lens.near_m = 1e-3;
        camera.lens.far_m = 1e3;
        let (_, numbers) = render(&scene, &camera, &[Pose { rotation, position_m: [0.0; 3] }]);
        let holes = numbers.iter().filter(|&&number| number != 0).count();
        assert_eq!(holes, 0, "seed {seed}: {count} × {count} corners, tilted by {tilt}");
    }
}

#[test]
fn what_hides_changes_no_pixel() {
    let camera = camera(SIDE, SIDE);
    let random = &mut Random(5);
    let shapes: Vec<_> = (0..40).map(|kind| solid(random, kind % 6).0).collect();
    let poses: Vec<_> = shapes.iter().map(|_| random.pose(1.2)).collect();
    let scene_of = |numbers: &[usize]| {
        let mut scene = Scene::default();
        for &number in numbers {
            scene.add(number as u32, shapes[number].clone());
        }
        scene
    };
    let all: Vec<usize> = (0..shapes.len()).collect();
    let (together_m, numbers) = render(&scene_of(&all), &camera, &poses);
    let alone: Vec<_> = all.iter().map(|&number| render(&scene_of(&[number]), &camera, &poses).0).collect();
    for (pixel, &depth_m) in together_m.iter().enumerate() {
        let nearest = alone.iter().map(|image| image[pixel]).filter(|&m| m > 0.0).fold(f32::MAX, f32::min);
        assert_eq!(depth_m, if nearest == f32::MAX { 0.0 } else { nearest }, "pixel {pixel}");
        if let Ok(number) = usize::try_from(numbers[pixel]) {
            assert_eq!(alone[number][pixel], depth_m, "pixel {pixel}");
        }
    }
}

#[test]
fn millimetres_are_rounded_metres() {
    let camera = camera(33, 21);
    let random = &mut Random(8);
    let mut scene = Scene::default();
    (0..12).for_each(|number| scene.add(number, solid(random, u64::from(number) % 6).0));
    scene.add(12, Shape::Plane { half_m: [0.0; 2] });
    let mut poses: Vec<_> = (0..13).map(|_| random.pose(1.0)).collect();
    poses[12].rotation = [[1.0, 0.0, 0.0], [0.0, 0.1, -0.995], [0.0, 0.995, 0.1]];
    let mut renderer = Renderer::default();
    renderer.render(&scene, &camera, |number| poses[number as usize]);
    let (mut depth_m, mut depth_mm) = (vec![0.0; 33 * 21], vec![0; 33 * 21]);
    renderer.metres(&mut depth_m);
    renderer.millimetres(&mut depth_mm);
    for (m, mm) in depth_m.iter().zip(depth_mm) {
        assert!((m * 1000.0 - f32::from(mm)).abs() <= 0.51 && mm <= DEPTH_MAX_MM, "{m} m, {mm} mm");
    }
}

/// The same bits on every machine.
#[test]
fn golden_hash() {
    let camera = camera(SIDE, SIDE);
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    for seed in 0..10 {
        let random = &mut Random(seed + 100);
        let mut scene = Scene::default();
        (0..18).for_each(|number| scene.add(number, solid(random, u64::from(number) % 6).0));
        let poses: Vec<_> = (0..18).map(|_| random.pose(1.5)).collect();
        let (depth_m, numbers) = render(&scene, &camera, &poses);
        for bits in depth_m.iter().map(|m| m.to_bits()).chain(numbers.iter().map(|n| n.cast_unsigned())) {
            hash = (hash ^ u64::from(bits)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    assert_eq!(format!("{hash:016x}"), "9bab17609b3fdfdc");
}

#[test]
fn a_height_field_stands_on_its_base() {
    let heights_m = [0.0, 0.1, 0.2, 0.1, 0.2, 0.3];
    let mesh = Mesh::height_field(&heights_m, 3, [0.5, 0.4], 0.1).unwrap();
    // Two of each cell, two of each wall's part, and a bottom.
    assert_eq!(mesh.triangles(), 2 * 2 + 6 * 2 + 3);
    let mut scene = Scene::default();
    scene.add(0, Shape::Mesh(Arc::new(mesh)));
    let camera = camera(65, 65);
    let middle = 32 * 65 + 32;
    let level = Pose { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], position_m: [0.0; 3] };
    let upside_down = Pose { rotation: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]], ..level };
    let (above_m, _) = render(&scene, &camera, &[level]);
    let (below_m, _) = render(&scene, &camera, &[upside_down]);
    assert!((above_m[middle] - 1.85).abs() < 1e-4, "{}", above_m[middle]);
    assert!((below_m[middle] - 1.9).abs() < 1e-4, "{}", below_m[middle]);
    assert_eq!(
        Mesh::height_field(&heights_m, 4, [1.0; 2], 0.0).unwrap_err(),
        MeshError::NoGrid { heights: 6, columns: 4 }
    );
}

#[test]
fn a_mesh_that_cannot_be_is_refused() {
    let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, f32::NAN]];
    assert_eq!(Mesh::new(&vertices, &[]).unwrap_err(), MeshError::NotFinite(2));
    let error = Mesh::new(&vertices[..2], &[[0, 1, 2]]).unwrap_err();
    assert_eq!(error, MeshError::NoSuchVertex { triangle: 0, vertex: 2, count: 2 });
    assert_eq!(Mesh::new(&vertices[..2], &[[0, 1, 1]]).unwrap().triangles(), 0);
}
