//! Depth images of any scene: what `stillroom.DepthCamera` and `stillroom.Scene` are made of. No kitchens here.

// PyO3 gives arguments by value.
#![allow(clippy::needless_pass_by_value)]

use crate::error::value_error;
use depth::{Camera, Lens, Mesh, Pose, Renderer, Shape};
use numpy::{Element, IntoPyArray, PyArrayMethods, PyReadonlyArray2, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// The tangent of an angle, rad: the same bits on every machine, which Python's own is not.
#[pyfunction]
pub fn tangent(angle_rad: f64) -> f64 {
    libm::tan(angle_rad)
}

/// The sine and cosine of an angle, rad.
#[pyfunction]
pub fn sine_cosine(angle_rad: f64) -> (f64, f64) {
    libm::sincos(angle_rad)
}

/// Triangles that several things can have.
#[pyclass(frozen, module = "stillroom._stillroom")]
#[derive(Debug)]
pub struct DepthMesh(Arc<Mesh>);

#[pymethods]
impl DepthMesh {
    #[new]
    fn new(
        py: Python<'_>,
        vertices: PyReadonlyArray2<'_, f32>,
        triangles: PyReadonlyArray2<'_, u32>,
    ) -> PyResult<Self> {
        let vertices = triples("vertices", &vertices)?;
        let triangles = triples("triangles", &triangles)?;
        let mesh = py.detach(|| Mesh::new(&vertices, &triangles)).map_err(value_error)?;
        Ok(Self(Arc::new(mesh)))
    }

    /// A grid of heights, row by row, over a rectangle, with walls down to `base` and a bottom.
    #[staticmethod]
    fn height_field(heights: PyReadonlyArray2<'_, f32>, half_extents: [f32; 2], base: f32) -> PyResult<Self> {
        let columns = heights.shape()[1];
        let mesh = Mesh::height_field(heights.as_slice()?, columns, half_extents, base).map_err(value_error)?;
        Ok(Self(Arc::new(mesh)))
    }
}

fn triples<T: Element + Copy>(name: &str, array: &PyReadonlyArray2<'_, T>) -> PyResult<Vec<[T; 3]>> {
    if array.shape()[1] != 3 {
        return Err(PyValueError::new_err(format!("{name} has {} columns, not 3", array.shape()[1])));
    }
    Ok(array.as_slice()?.as_chunks().0.to_vec())
}

/// Things that a camera sees. Their poses come with each frame.
#[pyclass(module = "stillroom._stillroom")]
#[derive(Debug, Default)]
pub struct DepthScene {
    scene: depth::Scene,
    /// Poses that a frame has at least.
    poses: usize,
    /// Buffers of threads that draw nothing now.
    renderers: Mutex<Vec<Renderer>>,
}

type Numbers<'py> = PyReadonlyArrayDyn<'py, f64>;
/// Positions and rotations of things, in parts one after the other, and those of the camera.
type Frame<'py> = (Vec<(Numbers<'py>, Numbers<'py>)>, Numbers<'py>, Numbers<'py>);
/// A frame to draw, and where its depth and its numbers go.
type Job<'a, T> = (&'a (Camera, Vec<Pose>), &'a mut [T], Option<&'a mut [i32]>);
/// Width, height, focal lengths, centre, pixels; near and far, metres.
type LensNumbers = (usize, usize, [f64; 2], [f64; 2], f64, f64);

#[pymethods]
impl DepthScene {
    #[new]
    fn new() -> Self {
        Self::default()
    }

    /// Adds a thing with this number among the poses.
    fn add(&mut self, number: u32, kind: &str, size: Vec<f64>) -> PyResult<()> {
        // Only a plane may be without an end.
        let sound = |size: &f64| size.is_finite() && (*size > 0.0 || kind == "plane" && *size == 0.0);
        if let Some(size) = size.iter().find(|size| !sound(size)) {
            return Err(PyValueError::new_err(format!("a {kind} has the size {size}, which must be above 0")));
        }
        let shape = match (kind, size.as_slice()) {
            ("plane", &[x, y]) => Shape::Plane { half_m: [x, y] },
            ("sphere", &[radius_m]) => Shape::Ellipsoid { radii_m: [radius_m; 3] },
            ("ellipsoid", &[x, y, z]) => Shape::Ellipsoid { radii_m: [x, y, z] },
            ("box", &[x, y, z]) => Shape::Cuboid { half_m: [x, y, z] },
            ("cylinder", &[radius_m, half_height_m]) => Shape::Cylinder { radius_m, half_height_m },
            ("capsule", &[radius_m, half_height_m]) => Shape::Capsule { radius_m, half_height_m },
            (_, size) => return Err(PyValueError::new_err(format!("a {kind} has not {} sizes", size.len()))),
        };
        self.enter(number, shape);
        Ok(())
    }

    /// Adds a mesh with this number among the poses.
    fn add_mesh(&mut self, number: u32, mesh: &Bound<'_, DepthMesh>) {
        self.enter(number, Shape::Mesh(mesh.get().0.clone()));
    }

    /// Depth [frames, rows, columns], and numbers of things if they are wanted. Python's lock is free meanwhile.
    fn render<'py>(
        &self,
        py: Python<'py>,
        frames: Vec<Frame<'py>>,
        lens: LensNumbers,
        in_metres: bool,
        with_numbers: bool,
        threads: usize,
    ) -> PyResult<(Bound<'py, PyAny>, Option<Bound<'py, PyAny>>)> {
        let (width, height, focal_px, centre_px, near_m, far_m) = lens;
        let lens = Lens { width, height, focal_px, centre_px, near_m, far_m };
        let frames = frames.iter().map(|frame| self.read(frame, lens)).collect::<PyResult<Vec<_>>>()?;
        let shape = [frames.len(), height, width];
        let pixels = frames.len() * width * height;
        let mut numbers = vec![0i32; if with_numbers { pixels } else { 0 }];
        let depth = if in_metres {
            let mut depth_m = vec![0f32; pixels];
            py.detach(|| self.draw(&frames, &mut depth_m, &mut numbers, threads, Renderer::metres));
            depth_m.into_pyarray(py).reshape(shape)?.into_any()
        } else {
            let mut depth_mm = vec![0u16; pixels];
            py.detach(|| self.draw(&frames, &mut depth_mm, &mut numbers, threads, Renderer::millimetres));
            depth_mm.into_pyarray(py).reshape(shape)?.into_any()
        };
        let numbers = if with_numbers { Some(numbers.into_pyarray(py).reshape(shape)?.into_any()) } else { None };
        Ok((depth, numbers))
    }
}

impl DepthScene {
    fn enter(&mut self, number: u32, shape: Shape) {
        self.scene.add(number, shape);
        self.poses = self.poses.max(number as usize + 1);
    }

    /// A frame's camera and the poses of its things.
    fn read(&self, (parts, position, rotation): &Frame<'_>, lens: Lens) -> PyResult<(Camera, Vec<Pose>)> {
        let mut poses = Vec::with_capacity(self.poses);
        for (positions, rotations) in parts {
            poses.extend(poses_of(positions, rotations)?);
        }
        if poses.len() < self.poses {
            return Err(PyValueError::new_err(format!(
                "the scene needs {} poses, and the frame has {}",
                self.poses,
                poses.len()
            )));
        }
        let camera: Vec<_> = poses_of(position, rotation)?.collect();
        let [world_from_camera] = camera[..] else {
            return Err(PyValueError::new_err("the camera's position is not 3 numbers, or its rotation not 3 × 3"));
        };
        Ok((Camera { world_from_camera, lens }, poses))
    }

    /// Draws frames into their parts of `depth` and, unless it is empty, `numbers`.
    fn draw<T: Send>(
        &self,
        frames: &[(Camera, Vec<Pose>)],
        depth: &mut [T],
        numbers: &mut [i32],
        threads: usize,
        finish: fn(&Renderer, &mut [T]),
    ) {
        if frames.is_empty() {
            return;
        }
        let pixels = depth.len() / frames.len();
        let mut numbers = numbers.chunks_mut(pixels);
        let mut jobs: Vec<Job<'_, T>> =
            frames.iter().zip(depth.chunks_mut(pixels)).map(|(frame, depth)| (frame, depth, numbers.next())).collect();
        let work = |jobs: &mut [Job<'_, T>]| {
            let renderers = || self.renderers.lock().unwrap_or_else(PoisonError::into_inner);
            let mut renderer = renderers().pop().unwrap_or_default();
            for ((camera, poses), depth, numbers) in jobs {
                renderer.render(&self.scene, camera, |number| poses[number as usize]);
                finish(&renderer, depth);
                if let Some(numbers) = numbers {
                    renderer.numbers(numbers);
                }
            }
            renderers().push(renderer);
        };
        let share = jobs.len().div_ceil(threads.max(1));
        let (own, others) = jobs.split_at_mut(share);
        std::thread::scope(|scope| {
            others.chunks_mut(share).for_each(|jobs| {
                scope.spawn(|| work(jobs));
            });
            work(own);
        });
    }
}

fn poses_of<'a>(
    positions: &'a Numbers<'_>,
    rotations: &'a Numbers<'_>,
) -> PyResult<impl Iterator<Item = Pose> + use<'a>> {
    let (positions, rotations) = (positions.as_slice()?, rotations.as_slice()?);
    if positions.len() % 3 != 0 || rotations.len() != 3 * positions.len() {
        let (positions, rotations) = (positions.len(), rotations.len());
        return Err(PyValueError::new_err(format!(
            "{positions} numbers of positions and {rotations} of rotations: a pose has 3, and 9"
        )));
    }
    let (positions, rotations) = (positions.as_chunks::<3>().0, rotations.as_chunks::<9>().0);
    Ok(positions.iter().zip(rotations).map(|(&position_m, &[a, b, c, d, e, f, g, h, i])| Pose {
        rotation: [[a, b, c], [d, e, f], [g, h, i]],
        position_m,
    }))
}
