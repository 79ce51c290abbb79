use super::camera::Camera;
use super::canvas::{Canvas, Rgb, mix};
use super::depth_view::{depth_view, mark};
use super::marks::{GOAL, TARGET};
use super::model::Model;
use super::moment::{Captions, Moment, Task};
use super::robot::HOLDS;
use super::scene::{DISPLACED, GHOST, PAPER, Scene, shadow_on};
use super::shade::Exposure;
use super::sky::{self, Lit};
use simulator::kitchen::Kitchen;
use std::sync::Arc;

const INK: Rgb = [34, 38, 44];
const FAINT: Rgb = [78, 84, 92];
const GOOD: Rgb = [0, 128, 64];
/// A success that lacks what the task demands most.
const HALF_GOOD: Rgb = [154, 91, 0];
const BAD: Rgb = [196, 40, 28];
const GAP: usize = 4;
pub struct Storyboard {
    scene: Scene,
    pub side: usize,
    outside: Camera,
    /// The first moment without the robot and what moves, and the light on it.
    lit: (Exposure, Vec<f32>),
}

impl Storyboard {
    /// Chooses where to look from, for all `moments`; `side`: width and height of each of the two views, pixels. Panics
    /// if there is no moment.
    pub fn new(kitchen: Arc<Kitchen>, task: Task, moments: &[Moment], side: usize) -> Self {
        let scene = Scene::new(kitchen, task, moments);
        let outside = scene.best(moments, 1.0).camera();
        let model = scene.unmoved();
        let exposure = Exposure::take(&model, &outside, side, side, PAPER);
        let waiting: Vec<Lit> = exposure.waiting().collect();
        let light = sky::light(&model, &waiting);
        Self { scene, side, outside, lit: (exposure, light) }
    }

    /// Width and height of every picture; both even, which video encoders demand.
    pub fn size(side: usize) -> (usize, usize) {
        let (text_px, _) = text(side);
        (2 * side + GAP, (side + 5 * text_px as usize).next_multiple_of(2))
    }

    pub fn draw(&self, moment: &Moment, depth_mm: &[u16]) -> Canvas {
        let (width, height) = Self::size(self.side);
        let mut canvas = Canvas::new(width, height, PAPER);
        let task = &self.scene.task;
        let (mut model, things) = self.scene.at(&moment.things);
        let target = task.target.map(|target| things + target as u32);
        let mut seen = model.clone();
        seen.add_arm(&moment.robot);
        model.add_robot(&moment.robot, true, moment.is_holding);
        let top = height - self.side;
        let depths = (depth_mm, self.scene.black_mm);
        canvas.place(&depth_view(task, moment, (&seen, target), self.side, depths), 0, top);
        self.draw_outside(&mut canvas, top, moment, &model);
        write(&mut canvas, self.side, (task, self.scene.black_mm), &moment.captions);
        canvas
    }

    fn draw_outside(&self, canvas: &mut Canvas, top: usize, moment: &Moment, model: &Model) {
        let exposure = Exposure::take(model, &self.outside, self.side, self.side, PAPER);
        let (before, light) = &self.lit;
        let light = exposure.light_as_in(before, light).zip(exposure.waiting());
        let shadow = shadow_on(&moment.robot);
        let light: Vec<f32> = light.map(|(light, lit)| light * shadow(&lit)).collect();
        let depths_m = exposure.depths_m();
        let mut picture = exposure.develop(&mut light.into_iter());
        self.scene.haunt(&mut picture, moment, &self.outside, &depths_m);
        mark(&mut picture, &self.outside, &self.scene.task, moment, |x, y| depths_m[y * self.side + x]);
        canvas.place(&picture, self.side + GAP, top);
    }
}

fn write(canvas: &mut Canvas, side: usize, (task, black_mm): (&Task, u16), captions: &Captions) {
    let (text_px, left) = text(side);
    let line = |number: f32| 1.15 * text_px * number;
    let space = 1.2 * text_px;
    let end = canvas.text(&task.title, text_px, left, line(1.0), INK);
    if let Some((outcome, place)) = &captions.outcome {
        let color = place.map_or(BAD, |place| if place == 0 { GOOD } else { HALF_GOOD });
        canvas.text(outcome, text_px, end + space, line(1.0), color);
    }
    let mut end = canvas.text(&captions.action, text_px, left, line(2.0), INK);
    for (remark, is_good) in &captions.remarks {
        end = canvas.text(remark, text_px, end + 0.8 * text_px, line(2.0), if *is_good { GOOD } else { BAD });
    }
    canvas.text_within(&captions.measures, text_px, left, line(3.0), FAINT);
    // What each view is, and what its colours stand for.
    let (mut at, small_px) = ((side + GAP) as f32, 0.8 * text_px);
    let depth = format!("what the robot sees (depth): white 0 m, black {:.1} m or more", f32::from(black_mm) / 1000.0);
    canvas.text(&depth, small_px, left, line(4.0), FAINT);
    let signs = [
        ("target", TARGET, task.target.is_some()),
        ("goal", GOAL, task.goal.is_some()),
        ("holding", HOLDS, task.target.is_some()),
        ("displaced", DISPLACED, true),
        ("where it stood", mix(PAPER, DISPLACED, GHOST[0]), true),
    ];
    for (word, colour, _) in signs.into_iter().filter(|(.., is_there)| *is_there) {
        let [x, y, size] = [at, line(4.0) - 0.6 * small_px, 0.6 * small_px].map(|px| px as usize);
        canvas.fill(x, y, size, size, colour);
        at = canvas.text(word, small_px, at + small_px, line(4.0), FAINT) + 0.5 * text_px;
    }
}

fn text(side: usize) -> (f32, f32) {
    let text_px = (side as f32 / 21.0).round().clamp(11.0, 40.0);
    (text_px, 0.5 * text_px)
}

#[cfg(test)]
mod tests {
    use super::super::depth_view::{TINT, brightness};
    use super::super::scene::tests::violet;
    use super::*;
    use proto::config::SimulationConfig;
    use proto::kitchen::{KitchenId, TargetCategory};
    use rapier3d::math::{Pose3, Vec3};
    use simulator::depth::TAN_HALF_FIELD_OF_VIEW;
    use simulator::robot::configuration::Configuration;
    use simulator::robot::links::{part_poses, world_from_camera};

    const SIDE: usize = 120;
    /// Where the target is in the camera's frame: before all furniture.
    const AHEAD_M: f32 = 0.45;
    const ASIDE_M: f32 = 0.25;

    /// The pictures of a target to the right of the middle of the depth view, where the arm does not hide it, and of
    /// one to the left, with another thing displaced, for one place of the goal; and the depth that is black.
    fn pictures(goal: Vec3) -> ([Canvas; 2], u16) {
        let kitchen = Kitchen::build(KitchenId::new(1).unwrap(), &SimulationConfig::default()).unwrap();
        let kitchen = Arc::new(kitchen);
        let stand = kitchen.robot_stands()[0];
        let configuration = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
        let camera = world_from_camera(&configuration.posture(), configuration.camera_pitch_rad());
        let target = kitchen.target_movable(TargetCategory::Bread);
        let moments = [ASIDE_M, -ASIDE_M].map(|aside_m| {
            let mut things = kitchen.settled_poses()[kitchen.movable_bodies()].to_vec();
            things[target] = camera * Pose3::translation(aside_m, 0.0, AHEAD_M);
            if aside_m < 0.0 {
                things[usize::from(target == 0)] = camera * Pose3::translation(0.0, 0.25, AHEAD_M);
            }
            let robot = part_poses(&configuration.posture()).unwrap();
            Moment { things, robot, is_holding: false, world_from_camera: camera, captions: Captions::default() }
        });
        let goal = Some(camera * goal);
        let task = Task { target: Some(target), goal, goal_tolerance_m: 0.1, title: "bring the Bread".to_owned() };
        let story = Storyboard::new(Arc::clone(&kitchen), task, &moments, SIDE);
        (moments.map(|moment| story.draw(&moment, &vec![2_000; SIDE * SIDE])), story.scene.black_mm)
    }

    #[test]
    fn target_and_goal_are_marked_in_both_views_where_they_are() {
        let ([right, left], black_mm) = pictures(Vec3::new(-0.6, 0.0, 0.8));
        let (width, height) = Storyboard::size(SIDE);
        assert_eq!((right.width, right.height, width % 2, height % 2), (width, height, 0, 0));
        let depth_at = |canvas: &Canvas, x: usize| canvas.pixels[(height - SIDE / 2) * width + x];
        let grey = [brightness(2_000, black_mm); 3];
        let offset_px = (ASIDE_M / AHEAD_M / TAN_HALF_FIELD_OF_VIEW * SIDE as f32 / 2.0) as usize;
        let (at_left, at_right) = (SIDE / 2 - offset_px, SIDE / 2 + offset_px);
        assert_eq!([at_left, at_right].map(|x| depth_at(&right, x)), [grey, mix(grey, TARGET, TINT)]);
        assert_eq!([at_left, at_right].map(|x| depth_at(&left, x)), [mix(grey, TARGET, TINT), grey]);
        let coloured = |canvas: &Canvas, view: usize, colour: Rgb| {
            let in_view = |index: &usize| index / width >= height - SIDE && (index % width > SIDE) == (view == 1);
            (0..canvas.pixels.len()).filter(in_view).filter(|&index| canvas.pixels[index] == colour).count()
        };
        for view in [0, 1] {
            for colour in [TARGET, GOAL] {
                assert!(coloured(&right, view, colour) > 10, "view {view} lacks {colour:?}");
            }
            let changed = (height - SIDE..height).any(|y| {
                let row = y * width + view * (SIDE + GAP);
                right.pixels[row..row + SIDE] != left.pixels[row..row + SIDE]
            });
            assert!(changed, "view {view} does not follow the target");
        }
        assert!(violet(&left) > violet(&right) + 4, "what is displaced is not violet");
        // The goal behind the robot: no box in the depth view.
        let ([behind, _], _) = pictures(Vec3::new(0.0, 0.0, -0.8));
        assert_eq!(coloured(&behind, 0, GOAL), 0);
    }

    #[test]
    fn a_caption_shows_its_words_in_their_colours() {
        let (width, height) = Storyboard::size(448);
        let mut canvas = Canvas::new(width, height, PAPER);
        let captions = Captions {
            remarks: vec![("failed".to_owned(), false)],
            measures: "goal 1.00 m".to_owned(),
            ..Captions::default()
        };
        let mut task = Task { target: None, goal: None, goal_tolerance_m: 0.1, title: "Kitchen 26".to_owned() };
        write(&mut canvas, 448, (&task, 5_000), &captions);
        let has = |canvas: &Canvas, colours: &[Rgb]| colours.iter().all(|colour| canvas.pixels.contains(colour));
        assert!(has(&canvas, &[INK, BAD, FAINT, DISPLACED]) && !has(&canvas, &[GOOD]));
        // A success has another colour than a failed action.
        let mut success = Canvas::new(width, height, PAPER);
        let captions = Captions { remarks: vec![("goal success".to_owned(), true)], ..Captions::default() };
        write(&mut success, 448, (&task, 5_000), &captions);
        assert!(has(&success, &[GOOD]) && !has(&success, &[BAD]));
        assert!([TARGET, GOAL, HOLDS].iter().all(|&one| !has(&canvas, &[one])), "explains what this task has not");
        (task.target, task.goal) = (Some(0), Some(Vec3::ZERO));
        write(&mut canvas, 448, (&task, 5_000), &captions);
        assert!(has(&canvas, &[TARGET, GOAL, HOLDS]), "does not explain its colours");
        let below = &canvas.pixels[(height - 448) * width..];
        assert!(below.iter().all(|pixel| *pixel == PAPER), "captions reach into the views");
        let mut long = Canvas::new(width, height, PAPER);
        let captions = Captions { measures: "goal 1.00 m, ".repeat(20), ..Captions::default() };
        write(&mut long, 448, (&task, 5_000), &captions);
        let at_the_edge = long.pixels.chunks_exact(width).flat_map(|row| &row[width - 4..]);
        assert!(at_the_edge.copied().all(|pixel| pixel == PAPER), "what is long ends before the edge");
    }
}
