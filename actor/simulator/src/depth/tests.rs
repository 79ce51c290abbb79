//! The depth camera against an independent ray caster (parry's, on the same convex solids), against scenes whose
//! depth is known in closed form, and against itself on other machines.

use super::depth_buffer::DEPTH_MAX_MM;
use super::{Backdrop, DepthCamera, NEAR_M, TAN_HALF_FIELD_OF_VIEW};
use crate::kitchen::{Body, BodyRole};
use crate::mesh::triangles_of;
use crate::physics::geometry::rotation_x;
use crate::shape::{Concave, Part, Primitive, Shape};
use proto::camera::{FRAME_SIDE, SUMS_PIXELS, sum_windows};
use proto::random::{Key, Purpose, Random};
use rapier3d::math::{Pose3, Vec3};
use rapier3d::parry::query::{Ray, RayCast};
use rapier3d::parry::shape::{ConvexPolyhedron, Cuboid, TriMesh};
use std::hash::Hasher;
use std::sync::Arc;

fn body(shape: Shape) -> Body {
    Body { name: String::new(), category: String::new(), shape, role: BodyRole::Movable }
}

fn render(bodies: &[Body], poses: &[Pose3], world_from_camera: Pose3, side: usize) -> Vec<u16> {
    let mut depth_mm = vec![7; side * side];
    DepthCamera::new(bodies).render(poses, world_from_camera, side, &mut depth_mm);
    depth_mm
}

fn random(step: u32) -> Random {
    Key { seed: 11, purpose: Purpose::RandomPolicy, kitchen: 0, environment: 0, episode: 0, step }.stream()
}

fn vector(random: &mut Random, low: f32, high: f32) -> Vec3 {
    Vec3::new(random.range(low, high), random.range(low, high), random.range(low, high))
}

fn primitive(random: &mut Random, round: bool) -> Primitive {
    let size = |random: &mut Random| random.range(0.03, 0.4);
    match (round, random.below(3)) {
        (false, 0) => Primitive::Hull { points_m: (0..12).map(|_| vector(random, -0.3, 0.3)).collect() },
        (false, _) => Primitive::Cuboid { half_extents_m: Vec3::new(size(random), size(random), size(random)) },
        (true, 0) => Primitive::Cylinder { radius_m: size(random), half_height_m: size(random) },
        (true, 1) => Primitive::Capsule { radius_m: size(random), half_height_m: size(random) },
        (true, _) => Primitive::Sphere { radius_m: size(random) },
    }
}

/// Parry's own solids, where its ray cast is exact: that on cylinders and capsules is iterative and was off by
/// millimetres.
fn solid(primitive: &Primitive) -> Box<dyn RayCast> {
    match primitive {
        Primitive::Cuboid { half_extents_m } => Box::new(Cuboid::new(*half_extents_m)),
        Primitive::Hull { points_m } => Box::new(ConvexPolyhedron::from_convex_hull(points_m).unwrap()),
        round => panic!("{round:?} is compared with its triangles"),
    }
}

/// The finest triangles that the camera's own geometry stands for.
fn finest(primitive: &Primitive) -> Box<dyn RayCast> {
    let triangles = triangles_of(&Shape::of(primitive.clone()));
    let corners = triangles.iter().flatten().map(|&corner| Vec3::from(corner)).collect();
    let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Box::new(TriMesh::new(corners, indices).unwrap())
}

/// What a ray meets first: depth along the axis, and which part.
#[derive(Clone, Copy)]
struct Hit {
    depth_m: f32,
    part: usize,
}

fn ray_cast(
    solid: fn(&Primitive) -> Box<dyn RayCast>,
    bodies: &[Body],
    poses: &[Pose3],
    world_from_camera: Pose3,
    side: usize,
) -> Vec<Option<Hit>> {
    let parts: Vec<(Box<dyn RayCast>, Pose3)> = bodies
        .iter()
        .zip(poses)
        .flat_map(|(body, pose)| {
            body.shape.parts.iter().map(|part| (solid(&part.primitive), *pose * part.body_from_part))
        })
        .collect();
    let half = side as f32 / 2.0;
    (0..side * side)
        .map(|pixel| {
            let (x, y) = ((pixel % side) as f32 + 0.5 - half, half - (pixel / side) as f32 - 0.5);
            // With z = 1 the parameter of the hit is the depth along the axis.
            let direction = Vec3::new(x, y, 0.0) * (TAN_HALF_FIELD_OF_VIEW / half) + Vec3::Z;
            let ray = Ray::new(world_from_camera.translation, world_from_camera.transform_vector(direction));
            let mut nearest: Option<Hit> = None;
            for (part, (solid, pose)) in parts.iter().enumerate() {
                let limit = nearest.map_or(100.0, |hit| hit.depth_m);
                if let Some(hit_m) = solid.cast_ray(pose, &ray, limit, false)
                    && nearest.is_none_or(|nearest| hit_m < nearest.depth_m)
                {
                    nearest = Some(Hit { depth_m: hit_m, part });
                }
            }
            nearest
        })
        .collect()
}

/// Pixels whose eight neighbours all see the same part: off every silhouette.
fn interior(hits: &[Option<Hit>], side: usize, pixel: usize) -> bool {
    let (x, y) = (pixel % side, pixel / side);
    let part = |pixel: usize| hits[pixel].map(|hit: Hit| hit.part);
    (1..side - 1).contains(&x)
        && (1..side - 1).contains(&y)
        && (y - 1..=y + 1).all(|y| (x - 1..=x + 1).all(|x| part(y * side + x) == part(pixel)))
}

fn random_scene(seed: u32, round: bool) -> (Vec<Body>, Vec<Pose3>) {
    let mut random = random(seed);
    (0..25)
        .map(|_| {
            let parts = (0..=random.below(3))
                .map(|_| Part {
                    primitive: primitive(&mut random, round),
                    body_from_part: Pose3::new(vector(&mut random, -0.3, 0.3), vector(&mut random, -2.0, 2.0)),
                })
                .collect();
            let translation = Vec3::new(random.range(-3.0, 3.0), random.range(-2.0, 2.0), random.range(1.2, 5.0));
            (body(Shape { parts }), Pose3::new(translation, vector(&mut random, -2.0, 2.0)))
        })
        .unzip()
}

/// Compares random scenes with ray casts, to a millimetre.
fn compare(round: bool, solid: fn(&Primitive) -> Box<dyn RayCast>) {
    const SIDE: usize = 112;
    let (mut checked, mut drawn) = (0, 0);
    for seed in 0..6 {
        let (bodies, poses) = random_scene(seed, round);
        let camera = Pose3::new(Vec3::new(0.1, -0.1, 0.0), vector(&mut random(100 + seed), -0.2, 0.2));
        let image = render(&bodies, &poses, camera, SIDE);
        let hits = ray_cast(solid, &bodies, &poses, camera, SIDE);
        for pixel in (0..SIDE * SIDE).filter(|&pixel| interior(&hits, SIDE, pixel)) {
            let drawn_mm = f32::from(image[pixel]);
            let Some(hit) = hits[pixel] else {
                assert_eq!(image[pixel], 0, "scene {seed}, pixel {pixel}: nothing is there");
                continue;
            };
            let error_mm = (drawn_mm - hit.depth_m * 1000.0).abs();
            assert!(error_mm <= 1.0, "scene {seed}, pixel {pixel}: drawn {drawn_mm} mm, cast {} m", hit.depth_m);
            checked += 1;
            drawn += i32::from(drawn_mm > 0.0);
        }
    }
    assert!(checked > 10_000 && drawn == checked, "{checked} pixels were compared");
}

#[test]
fn boxes_and_hulls_agree_with_ray_casts_to_a_millimetre() {
    compare(false, solid);
    compare(false, finest);
}

#[test]
fn round_things_agree_with_their_finest_triangles_to_a_millimetre() {
    compare(true, finest);
}

/// A U of 0.3 m × 0.2 m with walls of 0.05 m, 0.2 m deep, whose only piece for physics is a small box elsewhere.
fn u() -> Primitive {
    let outline =
        [(0.0, 0.0), (0.3, 0.0), (0.3, 0.2), (0.25, 0.2), (0.25, 0.05), (0.05, 0.05), (0.05, 0.2), (0.0, 0.2)];
    let at = |z: f32| outline.map(|(x, y)| Vec3::new(x - 0.15, y - 0.1, z));
    let caps = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [0, 4, 5], [0, 5, 7], [5, 6, 7]];
    let walls = (0..8u32).flat_map(|i| [[i, i + 8, (i + 1) % 8], [(i + 1) % 8, i + 8, (i + 1) % 8 + 8]]);
    let far = caps.map(|[a, b, c]| [a + 8, c + 8, b + 8]);
    let elsewhere = Primitive::Cuboid { half_extents_m: Vec3::splat(0.02) };
    Primitive::Concave(Arc::new(Concave {
        vertices: [at(0.1), at(-0.1)].concat(),
        triangles: caps.into_iter().chain(far).chain(walls).collect(),
        pieces: Shape::of(elsewhere).with(Primitive::Sphere { radius_m: 0.3 }, 0.0, 0.0, 0.0).parts,
    }))
}

#[test]
fn a_dented_mesh_is_seen_as_it_is_from_all_sides() {
    const SIDE: usize = 120;
    let bodies = [body(Shape::of(u()))];
    let (mut compared, mut through) = (0, 0);
    for step in 0..60 {
        let mut random = random(9000 + step);
        // From far away, and from so near that the near plane cuts it; the eye is outside.
        let away_m = if step % 3 == 0 { 0.22 } else { 0.5 };
        let pose = Pose3::new(Vec3::new(0.0, 0.0, away_m), vector(&mut random, -3.0, 3.0));
        let depth_mm = render(&bodies, &[pose], Pose3::identity(), SIDE);
        let hits = ray_cast(finest, &bodies, &[pose], Pose3::identity(), SIDE);
        for (pixel, hit) in hits.iter().enumerate().filter(|&(pixel, _)| interior(&hits, SIDE, pixel)) {
            match hit {
                Some(hit) if hit.depth_m > 2.0 * NEAR_M => {
                    // At an edge a ray may pass on one side of it, and the pixel's centre on the other.
                    let near = |other: usize| hits[other].is_some_and(|h| (h.depth_m - hit.depth_m).abs() < 0.01);
                    if [pixel - 1, pixel + 1, pixel - SIDE, pixel + SIDE].into_iter().all(near) {
                        let difference_mm = f32::from(depth_mm[pixel]) - 1000.0 * hit.depth_m;
                        assert!(difference_mm.abs() < 1.0, "step {step}, pixel {pixel}: {difference_mm} mm");
                        compared += 1;
                    }
                }
                Some(_) => {}
                None => {
                    assert_eq!(depth_mm[pixel], 0, "step {step}, pixel {pixel} sees past it");
                    through += 1;
                }
            }
        }
    }
    assert!(compared > 40_000 && through > 100_000, "{compared} {through}");
    // Into the notch: its floor lies 0.05 m above the underside.
    let above = Pose3::from_parts(Vec3::new(0.0, 0.6, 0.0), rotation_x(std::f32::consts::FRAC_PI_2));
    let depth_mm = render(&bodies, &[Pose3::identity()], above, SIDE);
    assert_eq!(depth_mm[SIDE / 2 * SIDE + SIDE / 2], 650);
}

#[test]
fn a_frame_over_a_backdrop_has_the_same_bits_as_a_full_redraw() {
    let (mut bodies, poses) = random_scene(40, false);
    let (round_bodies, round_poses) = random_scene(41, true);
    bodies.extend(round_bodies);
    let settled: Vec<Pose3> = poses.into_iter().chain(round_poses).collect();
    let robot = bodies.len() - 4..bodies.len();
    for body in &mut bodies[robot.clone()] {
        body.role = BodyRole::Robot;
    }
    let (mut camera, mut reference) = (DepthCamera::new(&bodies), DepthCamera::new(&bodies));
    // Two environments with one camera, in turn.
    let mut environments: Vec<_> = (0..2).map(|_| (Backdrop::default(), settled.clone(), Pose3::identity())).collect();
    let (mut frame, mut expected) = (vec![], vec![0; 224 * 224]);
    let room = || -> Box<[u16; SUMS_PIXELS]> { vec![0; SUMS_PIXELS].try_into().unwrap() };
    let (mut sums, mut expected_sums, mut summed) = (room(), room(), 0);
    for step in 0..300 {
        let mut random = random(5000 + step);
        let (backdrop, poses, world_from_camera) = &mut environments[step as usize % 2];
        let nudge = |random: &mut Random, pose: &mut Pose3| {
            *pose *= Pose3::new(vector(random, -0.1, 0.1), vector(random, -0.2, 0.2));
        };
        match random.below(6) {
            0 => nudge(&mut random, world_from_camera),
            1 => poses.iter_mut().zip(&settled).for_each(|(pose, settled)| *pose = *settled),
            2 => {
                // A few things, one of them perhaps to where nobody sees it.
                for _ in 0..3 {
                    let moved = random.below(bodies.len() as u32) as usize;
                    nudge(&mut random, &mut poses[moved]);
                    if random.below(3) == 0 {
                        poses[moved].translation = Vec3::new(0.0, -20.0, 0.0);
                    }
                }
            }
            _ => robot.clone().for_each(|part| nudge(&mut random, &mut poses[part])),
        }
        let side = if step % 50 < 40 { 224 } else { 60 };
        frame.resize(side * side, 0);
        expected.resize(side * side, 0);
        reference.render(poses, *world_from_camera, side, &mut expected);
        // Each way alone, and one after the other.
        if side == FRAME_SIDE && step % 3 != 0 {
            let fit = sum_windows(expected.as_slice().try_into().unwrap(), &mut expected_sums);
            let given = camera.render_sums_over(backdrop, poses, *world_from_camera, &mut sums);
            assert!(!given || fit && sums == expected_sums, "sums of step {step}");
            summed += usize::from(given);
        }
        if side != FRAME_SIDE || step % 3 != 1 {
            camera.render_over(backdrop, poses, *world_from_camera, side, &mut frame);
            assert!(frame == expected, "step {step}");
        }
        assert_eq!(camera.view_set_triangles(), reference.view_set_triangles(), "step {step}");
    }
    assert!(summed > 100, "{summed}");
}

#[test]
fn sums_that_16_bits_do_not_hold_are_refused() {
    let mut sums: Box<[u16; SUMS_PIXELS]> = vec![0; SUMS_PIXELS].try_into().unwrap();
    // In the backdrop, and before it.
    for role in [BodyRole::Movable, BodyRole::Robot] {
        let shape = Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(50.0, 50.0, 0.5) });
        let mut camera = DepthCamera::new(&[Body { role, ..body(shape) }]);
        let mut backdrop = Backdrop::default();
        for (depth_m, fit) in [(16.383, true), (16.384, false), (2.0, true)] {
            let wall = Pose3::translation(0.0, 0.0, depth_m + 0.5);
            // Twice: whatever moves is no part of the backdrop.
            for _ in 0..2 {
                let given = camera.render_sums_over(&mut backdrop, &[wall], Pose3::identity(), &mut sums);
                assert_eq!(given, fit, "{depth_m} m");
                assert!(!fit || sums.iter().all(|&sum| u32::from(sum) == (4000.0 * depth_m).round() as u32));
            }
        }
    }
}

#[test]
fn the_view_set_is_what_is_ahead() {
    let cube = || body(Shape::of(Primitive::Cuboid { half_extents_m: Vec3::splat(0.1) }));
    let ball = body(Shape::of(Primitive::Sphere { radius_m: 0.1 }));
    let ball_triangles = triangles_of(&ball.shape).len();
    let mut camera = DepthCamera::new(&[cube(), cube(), ball]);
    assert_eq!(camera.triangles(), 24 + ball_triangles);
    let at = |x, z| Pose3::translation(x, 0.0, z);
    let mut frame = vec![0; 64 * 64];
    camera.render(&[at(0.0, 2.0), at(0.0, -2.0), at(1.0, 2.0)], Pose3::identity(), 64, &mut frame);
    assert_eq!(camera.view_set_triangles(), 12 + ball_triangles);
    camera.render(&[at(0.0, 2.0), at(0.0, -2.0), at(9.0, 2.0)], Pose3::identity(), 64, &mut frame);
    assert_eq!(camera.view_set_triangles(), 12);
}

#[test]
fn a_closed_room_has_no_hole() {
    // Walls, floor and ceiling of many pieces, each meeting its neighbours edge to edge.
    let mut bodies = vec![];
    let mut poses = vec![];
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            for i in -2..=2 {
                for j in -2..=2 {
                    let mut half = [0.5; 3];
                    half[axis] = 0.05;
                    let mut centre = [i as f32; 3];
                    centre[axis] = sign * 2.55;
                    centre[(axis + 1) % 3] = j as f32;
                    bodies.push(body(Shape::of(Primitive::Cuboid { half_extents_m: Vec3::from(half) })));
                    poses.push(Pose3::from_translation(Vec3::from(centre)));
                }
            }
        }
    }
    let mut camera = DepthCamera::new(&bodies);
    let mut image = vec![0; 224 * 224];
    for seed in 0..60 {
        let mut random = random(1000 + seed);
        let pose = Pose3::new(vector(&mut random, -2.3, 2.3), vector(&mut random, -3.0, 3.0));
        camera.render(&poses, pose, 224, &mut image);
        let holes = image.iter().filter(|&&depth| depth == 0).count();
        assert_eq!(holes, 0, "view {seed}");
        assert!(image.iter().all(|&depth| depth < 9000), "view {seed}: nobody sees through a wall");
    }
}

#[test]
fn what_crosses_the_near_plane_is_cut_not_lost() {
    // A long bar that begins behind the camera and ends ahead: its upper side is 0.3 m below the axis.
    let bar = body(Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(0.2, 0.05, 5.0) }));
    let image = render(&[bar], &[Pose3::translation(0.0, -0.35, 0.0)], Pose3::identity(), 224);
    let bottom = image[223 * 224 + 112];
    let expected = 300.0 / (111.5 * TAN_HALF_FIELD_OF_VIEW / 112.0);
    assert!((f32::from(bottom) - expected).abs() <= 1.0, "{bottom}, expected {expected}");

    // A wall within the near plane is not there; just beyond it, it is.
    let wall = || body(Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(5.0, 5.0, 0.01) }));
    let at = |z| render(&[wall()], &[Pose3::translation(0.0, 0.0, z + 0.01)], Pose3::identity(), 16)[100];
    assert_eq!(at(NEAR_M - 0.002), 0);
    assert_eq!(at(NEAR_M + 0.002), 52);
    // Far away it is limited.
    assert_eq!(at(2.5), 2500);
    let far = body(Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(100.0, 100.0, 0.01) }));
    assert_eq!(render(&[far], &[Pose3::translation(0.0, 0.0, 60.0)], Pose3::identity(), 16)[100], DEPTH_MAX_MM);
}

#[test]
fn a_camera_inside_a_solid_sees_through_it() {
    let shell = body(Shape::of(Primitive::Sphere { radius_m: 0.5 }));
    let wall = body(Shape::of(Primitive::Cuboid { half_extents_m: Vec3::new(50.0, 50.0, 0.5) }));
    let poses = [Pose3::identity(), Pose3::translation(0.0, 0.0, 3.5)];
    assert!(render(&[shell, wall], &poses, Pose3::identity(), 64).iter().all(|&depth| depth == 3000));
}

/// The same bits on every machine and after every change that is not meant to change the picture. If the picture is
/// meant to change, say so in the change log: recorded depth frames will differ.
#[test]
fn the_picture_of_one_scene_never_changes() {
    let mut hash = xxhash_rust::xxh3::Xxh3::new();
    for round in [false, true] {
        let (bodies, poses) = random_scene(3, round);
        for depth in render(&bodies, &poses, Pose3::translation(0.0, 0.0, 0.6), 224) {
            hash.write(&depth.to_le_bytes());
        }
    }
    assert_eq!(hash.finish(), GOLDEN, "{:#x}", hash.finish());
}

const GOLDEN: u64 = 0x95f3_ef4a_55ec_612d;
