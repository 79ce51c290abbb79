use super::camera::{Camera, Projection};
use super::canvas::{Canvas, mix};
use super::marks::{GOAL, Marks, TARGET};
use super::model::Model;
use super::moment::{Moment, Task};
use super::visible::{NOTHING, Visible};
use simulator::depth::{NEAR_M, TAN_HALF_FIELD_OF_VIEW};

pub const TINT: f32 = 0.7;
const RING_M: f32 = 0.09;

/// The picture, side × side, of as many depths in millimetres. `seen`: the scene without the robot's body, and the
/// target's number among its bodies. `depths`: millimetres, and those that are black.
pub fn depth_view(
    task: &Task,
    moment: &Moment,
    seen: (&Model, Option<u32>),
    side: usize,
    depths: (&[u16], u16),
) -> Canvas {
    let ((model, target), (depth_mm, black_mm)) = (seen, depths);
    let projection = Projection::Central { tan_half_width: TAN_HALF_FIELD_OF_VIEW };
    let camera = Camera::new(moment.world_from_camera, projection, NEAR_M);
    let visible = Visible::draw(&camera, side, side, (0..).zip(model.corners()));
    let mut canvas = Canvas::new(side, side, [0; 3]);
    for (pixel, (&depth, &triangle)) in canvas.pixels.iter_mut().zip(depth_mm.iter().zip(&visible.triangle)) {
        let grey = [brightness(depth, black_mm); 3];
        let is_target = triangle != NOTHING && Some(model.triangles[triangle as usize].body) == target;
        *pixel = if is_target { mix(grey, TARGET, TINT) } else { grey };
    }
    mark(&mut canvas, &camera, task, moment, |x, y| match depth_mm[y * side + x] {
        0 => f32::MAX,
        depth => f32::from(depth) / 1000.0,
    });
    canvas
}

/// Marks target and goal in a picture; `depth_m`: of what it shows at a pixel.
pub fn mark(canvas: &mut Canvas, camera: &Camera, task: &Task, moment: &Moment, depth_m: impl Fn(usize, usize) -> f32) {
    let (width, height) = (canvas.width, canvas.height);
    if let Some(place) = task.goal {
        let mut goal = Marks::new(camera, width, height, &depth_m);
        goal.cube(place, task.goal_tolerance_m);
        goal.lay(canvas, 0, 0, GOAL);
    }
    if let Some(thing) = task.target {
        let mut target = Marks::new(camera, width, height, &depth_m);
        target.ring(moment.things[thing].translation, RING_M);
        target.lay(canvas, 0, 0, TARGET);
    }
}

pub fn brightness(depth_mm: u16, black_mm: u16) -> u8 {
    match depth_mm {
        0 => 0,
        depth => (255 * u32::from(black_mm.saturating_sub(depth)) / u32::from(black_mm)) as u8,
    }
}
