use super::camera::{Camera, Pixel};
use super::canvas::{Canvas, Rgb};
use super::model::Model;
use super::palette::linear;
use super::sky::Lit;
use super::visible::{NOTHING, Visible};
use rapier3d::math::Vec3;

/// Samples along each side of a pixel.
const SAMPLES: usize = 2;
/// Light that is everywhere, as a share of the open sky's.
const AMBIENT: f32 = 0.34;
/// Share of light that depends on how much of the sky is seen.
const SKY: f32 = 0.86;
/// Light from the beholder, so that faces of a box differ.
const HEAD_LAMP: f32 = 0.10;
/// Shades that a channel has: few enough that flat faces stay flat, which a PNG packs well.
const LEVELS: f32 = 85.0;
/// The inner side of a cut body is drawn this much nearer, metres.
const SECTION_LIFT_M: f32 = 0.01;
/// A step in depth is an edge if it is this much, metres, ...
const STEP_M: f32 = 0.02;
/// ... and this share of the distance.
const STEP_SHARE: f32 = 0.01;
/// Darkness of a line between bodies, and of a line along a body's own edge.
const OUTLINE: f32 = 0.42;
const CREASE: f32 = 0.72;
/// Faces whose normals' cosine is below this meet in an edge.
const CREASE_COSINE: f32 = 0.87;

/// Light on an upright surface that is not looked up, as a share of that on a floor.
const SIDE_LIGHT: f32 = 0.55;
/// Surfaces of one body that are this near to each other are the same, metres.
const SAME_SURFACE_M: f32 = 0.004;

pub struct Exposure {
    width: usize,
    height: usize,
    samples: Vec<Sample>,
}

/// The model's colours as linear light: worked out once, not for every sample.
struct Inks {
    bodies: Vec<[f32; 3]>,
    sections: Vec<[f32; 3]>,
    background: [f32; 3],
}

#[derive(Clone, Copy)]
struct Sample {
    /// Linear colour; of what waits for light, under full light.
    colour: [f32; 3],
    body: u32,
    normal: Vec3,
    depth_m: f32,
    /// Where light falls on it; none where a section or nothing is shown.
    lit: Option<Vec3>,
    open: bool,
    /// Cosine between the surface's normal and the ray back to the camera.
    facing: f32,
}

impl Exposure {
    pub fn take(model: &Model, camera: &Camera, width: usize, height: usize, background: Rgb) -> Self {
        let (columns, rows) = (width * SAMPLES, height * SAMPLES);
        let visible = Visible::draw(camera, columns, rows, cut(model, camera));
        let linear_of = |colours: &[Rgb]| colours.iter().map(|colour| colour.map(linear)).collect();
        let inks = Inks {
            bodies: linear_of(&model.colours),
            sections: linear_of(&model.sections),
            background: background.map(linear),
        };
        let samples = (0..columns * rows).map(|index| sample(model, camera, &visible, index, &inks)).collect();
        Self { width, height, samples }
    }

    /// Of each sample whether it waits for its light, and where: one of each surface in each pixel, whose light the others
    /// take.
    pub fn lit(&self) -> impl Iterator<Item = Option<Lit>> + '_ {
        (0..self.samples.len()).map(|index| {
            let sample = &self.samples[index];
            let point = sample.lit.filter(|_| self.first(index) == index)?;
            Some(Lit { point, normal: sample.normal, open: sample.open })
        })
    }

    pub fn waiting(&self) -> impl Iterator<Item = Lit> + '_ {
        self.lit().flatten()
    }

    /// The first sample of a sample's pixel that shows the same surface.
    fn first(&self, index: usize) -> usize {
        let columns = self.width * SAMPLES;
        let (x, y) = (index % columns / SAMPLES * SAMPLES, index / columns / SAMPLES * SAMPLES);
        let here = &self.samples[index];
        let same = |&at: &usize| {
            let other = &self.samples[at];
            other.lit.is_some() && (other.body, other.normal) == (here.body, here.normal)
        };
        (0..SAMPLES * SAMPLES).map(|at| (y + at / SAMPLES) * columns + x + at % SAMPLES).find(same).unwrap_or(index)
    }

    /// The light of each sample, of those that wait for it.
    fn spread(&self, light: &mut impl Iterator<Item = f32>) -> Vec<f32> {
        let mut all = vec![0.0; self.samples.len()];
        for index in (0..all.len()).filter(|&index| self.samples[index].lit.is_some()) {
            let first = self.first(index);
            all[index] = if first == index { light.next().unwrap_or(0.0) } else { all[first] };
        }
        all
    }

    /// What falls onto each waiting point, in order: as in an earlier picture by the same camera where that shows the
    /// same surface, else by the surface's slope alone. The soft light of a whole picture takes a second; this takes
    /// none, and what moves is small.
    pub fn light_as_in<'a>(&'a self, earlier: &'a Self, light: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
        let known = earlier.spread(&mut light.iter().copied());
        (0..self.samples.len()).filter(|&index| self.first(index) == index).filter_map(move |index| {
            let (here, before) = (&self.samples[index], &earlier.samples[index]);
            here.lit?;
            let same = here.body == before.body && (here.depth_m - before.depth_m).abs() < SAME_SURFACE_M;
            let slope_light = SIDE_LIGHT + (1.0 - SIDE_LIGHT) * here.normal.y.max(0.0);
            Some(if same && before.lit.is_some() { known[index] } else { slope_light })
        })
    }

    /// Depth of what is shown at the middle of each pixel, metres; where nothing is shown, far beyond everything.
    pub fn depths_m(&self) -> Vec<f32> {
        let middle =
            |x: usize, y: usize| (y * SAMPLES + SAMPLES / 2) * self.width * SAMPLES + x * SAMPLES + SAMPLES / 2;
        (0..self.width * self.height)
            .map(|index| self.samples[middle(index % self.width, index / self.width)].depth_m)
            .collect()
    }

    /// The picture; `light` yields what falls onto each of the waiting points, in order.
    pub fn develop(mut self, light: &mut impl Iterator<Item = f32>) -> Canvas {
        for (index, sky) in self.spread(light).into_iter().enumerate() {
            let sample = &mut self.samples[index];
            if sample.lit.is_some() {
                let light = AMBIENT + SKY * sky + HEAD_LAMP * sample.facing;
                sample.colour = sample.colour.map(|channel| channel * light);
            }
        }
        let (columns, rows) = (self.width * SAMPLES, self.height * SAMPLES);
        let mut canvas = Canvas::new(self.width, self.height, [0; 3]);
        for (index, pixel) in canvas.pixels.iter_mut().enumerate() {
            let (x, y) = (index % self.width * SAMPLES, index / self.width * SAMPLES);
            let mut sum = [0.0; 3];
            for at in 0..SAMPLES * SAMPLES {
                let (x, y) = (x + at % SAMPLES, y + at / SAMPLES);
                let here = &self.samples[y * columns + x];
                let right = &self.samples[y * columns + (x + 1).min(columns - 1)];
                let below = &self.samples[(y + 1).min(rows - 1) * columns + x];
                let line = edge(here, right).min(edge(here, below));
                for (sum, channel) in sum.iter_mut().zip(here.colour) {
                    *sum += channel * line;
                }
            }
            *pixel = sum.map(|sum| encode(sum / (SAMPLES * SAMPLES) as f32));
        }
        canvas
    }
}

/// Corners of the model's triangles. Where the near plane cuts a body its inner side is seen, which is what a section
/// is recognised by; it is drawn a little nearer, since it may lie on what the body stands on.
fn cut<'a>(model: &'a Model, camera: &'a Camera) -> impl Iterator<Item = (u32, [Vec3; 3])> + 'a {
    let mut cut = vec![false; model.colours.len()];
    for triangle in &model.triangles {
        let nearer = |corner: &Vec3| (camera.camera_from_world * *corner).z < camera.near_m;
        cut[triangle.body as usize] |= triangle.corners.iter().any(nearer);
    }
    let back = camera.camera_from_world.inverse_transform_vector(Vec3::NEG_Z);
    model.before(camera).map(move |(number, triangle)| {
        let inner = cut[triangle.body as usize] && triangle.normal.dot(back) < 0.0;
        let lift = if inner { back * SECTION_LIFT_M } else { Vec3::ZERO };
        (number, triangle.corners.map(|corner| corner + lift))
    })
}

fn sample(model: &Model, camera: &Camera, visible: &Visible, index: usize, inks: &Inks) -> Sample {
    let number = visible.triangle[index];
    let nothing = Sample {
        colour: [0.0; 3],
        body: NOTHING,
        normal: Vec3::ZERO,
        depth_m: f32::MAX,
        lit: None,
        open: false,
        facing: 1.0,
    };
    if number == NOTHING {
        return Sample { colour: inks.background, ..nothing };
    }
    let triangle = &model.triangles[number as usize];
    let body = triangle.body;
    let pixel = Pixel {
        x: (index % visible.width) as f32 + 0.5,
        y: (index / visible.width) as f32 + 0.5,
        nearness: visible.nearness[index],
    };
    let in_camera = camera.unproject(pixel, visible.width, visible.height);
    let facing = -(camera.camera_from_world.rotation * triangle.normal).dot(camera.ray(in_camera));
    if facing < 0.0 {
        // The inner side of a solid: a section cuts it here. Filled flat, as in a floor plan.
        let colour = inks.sections[body as usize];
        return Sample { colour, body, depth_m: camera.near_m, ..nothing };
    }
    Sample {
        colour: inks.bodies[body as usize],
        body,
        normal: triangle.normal,
        depth_m: in_camera.z,
        lit: Some(camera.camera_from_world.inverse_transform_point(in_camera)),
        open: model.open[body as usize],
        facing,
    }
}

fn edge(a: &Sample, b: &Sample) -> f32 {
    let step = (a.depth_m - b.depth_m).abs();
    let far = step > STEP_M + STEP_SHARE * a.depth_m.min(b.depth_m);
    if a.body != b.body {
        OUTLINE
    } else if a.lit.is_none() || b.lit.is_none() {
        1.0
    } else if far && a.normal.dot(b.normal) < 0.999 || a.normal.dot(b.normal) < CREASE_COSINE {
        CREASE
    } else {
        1.0
    }
}

fn encode(light: f32) -> u8 {
    let c = light.clamp(0.0, 1.0);
    let c = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * libm::powf(c, 1.0 / 2.4) - 0.055 };
    ((c * LEVELS).round() * (255.0 / LEVELS)).round() as u8
}
