//! An episode from any camera: what was displaced is highlighted, and a ghost stands where it stood.

use super::camera::Camera;
use super::canvas::{Canvas, Rgb};
use super::depth_view::{depth_view, mark};
use super::marks::TARGET;
use super::model::Model;
use super::moment::{Moment, Task, is_displaced, moving, points};
use super::robot::shadow;
use super::shade::Exposure;
use super::sky::{Dome, Lit};
use super::view::{PlanFrame, robot_camera};
use super::viewpoint::{self, Orbit};
use super::visible::Visible;
use rapier3d::math::Pose3;
use simulator::depth::DepthCamera;
use simulator::kitchen::Kitchen;
use simulator::robot::links::PartPoses;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Where there is no room: on a light page, and on a dark one.
pub const PAPER: Rgb = [250, 250, 248];
pub const NIGHT: Rgb = [28, 32, 37];
/// Colour of what is not where it stood, and of its ghost: no other thing has it.
pub const DISPLACED: Rgb = [124, 58, 237];
pub const GHOST: [f32; 2] = [0.5, 0.18];
/// A ghost is hidden by what is this much nearer, metres.
const SLACK_M: f32 = 0.005;
const LAMPS: usize = 64;
/// Black is what this share of all that is seen in an episode is nearer than: in frames of this side at so many moments,
/// rounded up to steps.
const FAR_SHARE: f32 = 0.95;
const FAR_SIDE: usize = 28;
const FAR_MOMENTS: usize = 24;
const FAR_STEP_MM: u16 = 500;
/// Light on an upright surface in a draft, as a share of that on a floor.
const DRAFT_SIDE_LIGHT: f32 = 0.6;
/// Light on a floor in a draft, for as bright a picture as the fine one: walls and furniture leave a part of the sky.
const DRAFT_LIGHT: f32 = 0.42;
/// How much a hidden target is seen through what hides it.
const TARGET_THROUGH: f32 = 0.4;

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Standpoint {
    /// The robot's camera, which stands in its body: that is not in the picture.
    Robot,
    Outside(Orbit),
}

pub struct Scene {
    kitchen: Arc<Kitchen>,
    pub task: Task,
    /// Things at the episode's start.
    origins: Vec<Pose3>,
    fixed: Model,
    /// Things whose shadows would stay where they stood.
    moving: Vec<usize>,
    /// Light on the first moment without the robot and what moves. Made with the first fine picture.
    dome: OnceLock<Dome>,
    /// What is as far away is black in depth views, millimetres.
    pub black_mm: u16,
    /// Light on each sample of the last fine picture: most of the next one shows the same.
    last: Mutex<Vec<Option<(Lit, f32)>>>,
    pub frame: PlanFrame,
}

impl Scene {
    /// Panics if there is no moment.
    pub fn new(kitchen: Arc<Kitchen>, task: Task, moments: &[Moment]) -> Self {
        let fixed = Model::fixed_of(&kitchen);
        let origins = moments[0].things.clone();
        let frame = PlanFrame::of(&fixed);
        let moving = moving(&task, moments);
        let mut camera = DepthCamera::new(kitchen.bodies());
        let some = moments.iter().step_by(moments.len().div_ceil(FAR_MOMENTS));
        let mut seen: Vec<u16> = some.flat_map(|moment| frame_mm(&kitchen, moment, &mut camera, FAR_SIDE)).collect();
        seen.sort_unstable();
        let far_mm = seen[(FAR_SHARE * (seen.len() - 1) as f32) as usize];
        let black_mm = far_mm.clamp(1, 60_000).next_multiple_of(FAR_STEP_MM);
        Self { kitchen, task, origins, fixed, moving, dome: OnceLock::new(), black_mm, last: Mutex::default(), frame }
    }

    /// The camera from which the episode is seen best in pictures whose height is `tall`, as a share of their width.
    pub fn best(&self, moments: &[Moment], tall: f32) -> Orbit {
        let mut model = self.at(&self.origins).0;
        for moment in moments.iter().take(1).chain(moments.last()) {
            model.add_robot(&moment.robot, true, moment.is_holding);
        }
        viewpoint::best(&model, &points(&self.task, moments), tall)
    }

    /// The room from a free camera.
    pub fn orbit(
        &self,
        moment: &Moment,
        orbit: &Orbit,
        (width, height): (usize, usize),
        fine: bool,
        background: Rgb,
    ) -> Canvas {
        let camera = orbit.camera();
        let mut model = self.at(&moment.things).0;
        model.add_robot(&moment.robot, true, moment.is_holding);
        let exposure = Exposure::take(&model, &camera, width, height, background);
        let depths_m = exposure.depths_m();
        let mut picture = self.develop(exposure, fine, shadow_on(&moment.robot));
        self.haunt(&mut picture, moment, &camera, &depths_m);
        mark(&mut picture, &camera, &self.task, moment, |x, y| depths_m[y * width + x]);
        picture
    }

    pub fn photograph(&self, moment: &Moment, from: &Standpoint, side: usize) -> Canvas {
        let mut model = self.fixed.clone();
        model.add_things(&self.kitchen, &moment.things, |_| None);
        let camera = match from {
            Standpoint::Robot => {
                // As in the depth frame beside it.
                model.add_arm(&moment.robot);
                robot_camera(moment.world_from_camera)
            }
            Standpoint::Outside(orbit) => {
                model.add_robot(&moment.robot, true, moment.is_holding);
                orbit.camera()
            }
        };
        // Soft light would take most of a second a picture, and a data set has thousands.
        let exposure = Exposure::take(&model, &camera, side, side, PAPER);
        let light: Vec<f32> = exposure.waiting().map(|lit| slope(&lit)).collect();
        exposure.develop(&mut light.into_iter())
    }

    pub fn plan(&self, side: usize, background: Rgb) -> Canvas {
        let model = self.at(&self.origins).0;
        self.develop(Exposure::take(&model, &self.frame.camera(), side, side, background), true, |_| 1.0)
    }

    pub fn depth(&self, moment: &Moment, camera: &mut DepthCamera, side: usize) -> Canvas {
        let depth_mm = frame_mm(&self.kitchen, moment, camera, side);
        let (mut model, first) = self.at(&moment.things);
        model.add_arm(&moment.robot);
        let target = self.task.target.map(|target| first + target as u32);
        depth_view(&self.task, moment, (&model, target), side, (&depth_mm, self.black_mm))
    }

    /// Whether a thing, other than the target, is in another place than at first.
    fn is_displaced(&self, thing: usize, things: &[Pose3]) -> bool {
        Some(thing) != self.task.target && is_displaced(self.origins[thing].translation, things[thing].translation)
    }

    /// The kitchen with its things in these poses, and the first thing's number among the bodies.
    pub fn at(&self, things: &[Pose3]) -> (Model, u32) {
        let mut model = self.fixed.clone();
        let colour = |thing: usize| {
            let displaced = self.is_displaced(thing, things).then_some(DISPLACED);
            if Some(thing) == self.task.target { Some(TARGET) } else { displaced }
        };
        let first = model.add_things(&self.kitchen, things, colour);
        (model, first)
    }

    /// The first moment without the robot and what moves.
    pub fn unmoved(&self) -> Model {
        let (mut model, first) = self.at(&self.origins);
        model.take_away(first, &self.moving);
        model
    }

    /// `share`: of the light on a place, what the robot leaves.
    fn develop(&self, exposure: Exposure, fine: bool, share: impl Fn(&Lit) -> f32) -> Canvas {
        let mut light = if fine {
            self.soft_light(&exposure)
        } else {
            exposure.waiting().map(|lit| DRAFT_LIGHT * slope(&lit)).collect()
        };
        light.iter_mut().zip(exposure.waiting()).for_each(|(light, lit)| *light *= share(&lit));
        exposure.develop(&mut light.into_iter())
    }

    fn soft_light(&self, exposure: &Exposure) -> Vec<f32> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let samples: Vec<Option<Lit>> = exposure.lit().collect();
        last.resize(samples.len(), None);
        for (before, here) in last.iter_mut().zip(&samples) {
            *before = before.filter(|(lit, _)| Some(*lit) == *here);
        }
        let is_new = |(before, _): &(&Option<_>, &Option<Lit>)| before.is_none();
        let new: Vec<Lit> = last.iter().zip(&samples).filter(is_new).filter_map(|(_, here)| *here).collect();
        let mut light = self.dome.get_or_init(|| Dome::over(&self.unmoved(), LAMPS)).light(&new).into_iter();
        for (before, here) in last.iter_mut().zip(samples).filter(|(before, _)| before.is_none()) {
            *before = here.zip(here.and_then(|_| light.next()));
        }
        last.iter().flatten().map(|(_, light)| *light).collect()
    }

    /// Gives back the memory of the last picture's light.
    pub fn forget(&mut self) {
        self.last = Mutex::default();
    }

    /// Draws what is displaced where it stood, and the target through what hides it, such as a wall that is cut.
    pub fn haunt(&self, picture: &mut Canvas, moment: &Moment, camera: &Camera, depths_m: &[f32]) {
        let (width, height) = (picture.width, picture.height);
        let bodies = &self.kitchen.bodies()[self.kitchen.movable_bodies()];
        // How much of it is seen, open and through what hides it.
        let mut lay = |model: &Model, colour: Rgb, shares: [f32; 2]| {
            let visible = Visible::draw(camera, width, height, (0..).zip(model.corners()));
            for (index, &nearness) in visible.nearness.iter().enumerate().filter(|(_, nearness)| nearness.is_finite()) {
                let is_hidden = 1.0 / nearness > depths_m[index] + SLACK_M;
                picture.blend(index % width, index / width, colour, shares[usize::from(is_hidden)]);
            }
        };
        let mut ghosts = Model::default();
        for thing in (0..self.origins.len()).filter(|&thing| self.is_displaced(thing, &moment.things)) {
            ghosts.add(&bodies[thing].shape, &self.origins[thing], DISPLACED, true);
        }
        lay(&ghosts, DISPLACED, GHOST);
        if let Some(target) = self.task.target {
            let mut model = Model::default();
            model.add(&bodies[target].shape, &moment.things[target], TARGET, true);
            lay(&model, TARGET, [0.0, TARGET_THROUGH]);
        }
    }
}

fn frame_mm(kitchen: &Kitchen, moment: &Moment, camera: &mut DepthCamera, side: usize) -> Vec<u16> {
    let mut bodies = Vec::new();
    moment.world_from_bodies(kitchen, &mut bodies);
    let mut depth_mm = vec![0; side * side];
    camera.render(&bodies, moment.world_from_camera, side, &mut depth_mm);
    depth_mm
}

/// Share of the light that the robot leaves; on itself all.
pub fn shadow_on(robot: &PartPoses) -> impl Fn(&Lit) -> f32 + use<> {
    let shadow = shadow(robot);
    move |lit| if lit.open { 1.0 } else { shadow(lit.point, lit.normal) }
}

fn slope(lit: &Lit) -> f32 {
    DRAFT_SIDE_LIGHT + (1.0 - DRAFT_SIDE_LIGHT) * lit.normal.y.max(0.0)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::super::moment::{Captions, Point};
    use super::super::visible::NOTHING;
    use super::*;
    use proto::config::{Config, SimulationConfig};
    use proto::episode::EnvironmentId;
    use proto::evaluation::{EvaluationConfig, ObjectSet};
    use proto::kitchen::{KitchenId, Split, TargetCategory};
    use proto::replay::{RecordedEpisode, Rules, play};
    use rapier3d::math::Vec3;
    use simulator::environment::DISTURBED_AXIS_M;
    use simulator::robot::configuration::Configuration;
    use simulator::robot::links::{part_poses, world_from_camera};
    use simulator::tasks;

    const EPISODES: u32 = 2;

    fn scene() -> (Scene, Moment, usize) {
        let kitchen = Arc::new(Kitchen::build(KitchenId::new(1).unwrap(), &SimulationConfig::default()).unwrap());
        let stand = kitchen.robot_stands()[0];
        let configuration = Configuration::start(stand.x_m, stand.z_m, stand.yaw_ticks);
        let things = kitchen.settled_poses()[kitchen.movable_bodies()].to_vec();
        let target = kitchen.target_movable(TargetCategory::Bread);
        let moment = Moment {
            robot: part_poses(&configuration.posture()).unwrap(),
            world_from_camera: world_from_camera(&configuration.posture(), configuration.camera_pitch_rad()),
            captions: Captions::default(),
            is_holding: false,
            things,
        };
        let goal = Some(Vec3::new(0.0, 1.0, 0.0));
        let task = Task { target: Some(target), goal, goal_tolerance_m: 0.1, title: String::new() };
        let other = usize::from(target == 0);
        (Scene::new(kitchen, task, std::slice::from_ref(&moment)), moment, other)
    }

    pub(crate) fn violet(picture: &Canvas) -> usize {
        picture.pixels.iter().filter(|[r, g, b]| *b > 90 && *g < *b / 2 && *r < *b).count()
    }

    #[test]
    fn what_was_displaced_is_highlighted_and_its_ghost_stands_where_it_stood() {
        let (scene, mut moment, thing) = scene();
        let stood = moment.things[thing].translation;
        let orbit = Orbit { centre: stood, radius_m: 0.6, yaw_rad: 0.3, pitch_rad: 0.9 };
        let draw = |moment: &Moment| scene.orbit(moment, &orbit, (160, 120), false, PAPER);
        let before = draw(&moment);
        // A scene in which the thing has always been there has no ghost of it.
        let task = &scene.task;
        let always = |moment: &Moment| {
            let scene = Scene::new(Arc::clone(&scene.kitchen), task.clone(), std::slice::from_ref(moment));
            scene.orbit(moment, &orbit, (160, 120), false, PAPER)
        };
        // Far away: only its ghost is left in the picture.
        moment.things[thing].translation += Vec3::new(0.0, 40.0, 0.0);
        let changed = |a: &Canvas, b: &Canvas| a.pixels.iter().zip(&b.pixels).filter(|(a, b)| a != b).count();
        assert!(changed(&before, &always(&moment)) > 20, "the thing was in the picture");
        assert!(changed(&always(&moment), &draw(&moment)) > 20, "its ghost is not");
        // Lifted a little: highlighted itself.
        moment.things[thing].translation = stood + Vec3::new(0.0, 0.15, 0.0);
        assert!(violet(&draw(&moment)) > violet(&always(&moment)) + 20);
        // No further than what counts as disturbed.
        moment.things[thing].translation = stood + Vec3::new(0.0, 0.9 * DISTURBED_AXIS_M, 0.0);
        assert!(violet(&draw(&moment)) < violet(&before) + 20);
    }

    #[test]
    fn the_picture_holds_the_place_where_a_displaced_thing_ends() {
        let (scene, first, thing) = scene();
        let mut last = first.clone();
        let end = first.things[thing].translation + Vec3::new(1.3, -0.4, 1.1);
        last.things[thing].translation = end;
        let Vec3 { x, y, z } = scene.best(&[first, last], 0.75).camera().camera_from_world * end;
        assert!(z > 0.0 && x.abs() < 0.42 * z && y.abs() < 0.32 * z, "it is at {x}, {y}, {z}");
    }

    /// The first moment of an episode of this kitchen, and of some steps that nobody chose: one of training, or a fixed
    /// one.
    fn episode(kitchen: &Arc<Kitchen>, number: u32) -> (Task, Vec<Moment>) {
        let split = kitchen.id().split();
        let evaluation = (split != Split::Train).then(|| EvaluationConfig::fixed(split, ObjectSet::All, 5));
        let mut config = Config { evaluation, ..Config::default() };
        (config.actors.count, config.actors.environments_per_actor) = (5, 1);
        let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
        let mut environment = tasks::open(&tasks::Run::of(&config), kitchen, id, number).unwrap();
        let actions: Vec<u8> = (0..40u32).map(|step| ((step * 7 + number) % 19) as u8).collect();
        let (hashes, digests, start) = (vec![0; actions.len()], vec![], vec![]);
        let recorded =
            RecordedEpisode { environment: id, episode: number, start_hash: None, actions, hashes, digests, start };
        let (rules, mut moments, mut task) = (Rules::of(&config).unwrap(), Vec::new(), None);
        play(&rules, &mut *environment, &recorded, |environment, seen| {
            let base = environment.base();
            task.get_or_insert_with(|| crate::task(rules.spec, base, seen.record, String::new()));
            moments.push(Moment::of(base.simulation(), base.world_from_camera(), Captions::default()));
            Ok::<(), proto::replay::PlayError>(())
        })
        .unwrap();
        (task.unwrap(), moments)
    }

    /// Why a person would not find robot and goal in the first picture of an episode, if so.
    fn hidden(kitchen: &Arc<Kitchen>, number: u32) -> Option<String> {
        let (task, moments) = episode(kitchen, number);
        let scene = Scene::new(Arc::clone(kitchen), task, &moments);
        let camera = scene.best(&moments, 0.75).camera();
        let furnished = scene.at(&moments[0].things).0;
        let (mut whole, mut alone) = (furnished.clone(), Model::default());
        whole.add_robot(&moments[0].robot, true, false);
        alone.add_robot(&moments[0].robot, true, false);
        let draw = |model: &Model| {
            let corners = model.before(&camera).map(|(number, triangle)| (number, triangle.corners));
            Visible::draw(&camera, 160, 120, corners)
        };
        let first = furnished.triangles.len() as u32;
        let count = |model: &Model, least: u32| {
            draw(model).triangle.iter().filter(|&&triangle| triangle != NOTHING && triangle >= least).count()
        };
        let (shown, all) = (count(&whole, first), count(&alone, 0));
        let shows = |place: Vec3| draw(&furnished).shows(&camera, &Point { place, weight: 1.0, slack_m: 0.1 });
        let (goal, target) = (scene.task.goal.unwrap(), moments[0].things[scene.task.target.unwrap()].translation);
        let [goal_shown, target_shown] = [goal, target].map(shows);
        // Nothing is cut off: the arm, the goal and the target have room around them.
        let places = moments[0].robot.iter().map(|part| part.translation).chain([goal, target]);
        let edge = |place: Vec3| {
            let pixel = camera.project(camera.camera_from_world * place, 160, 120);
            (pixel.x / 80.0 - 1.0).abs().max((pixel.y / 60.0 - 1.0).abs())
        };
        let farthest = places.map(edge).fold(0.0, f32::max);
        let is_hidden = 3 * shown < all || all < 60 || !goal_shown || !target_shown || farthest > 0.77;
        is_hidden.then(|| {
            format!(
                "{}, episode {number}: {shown} of {all} pixels, goal {goal_shown}, target {target_shown}, {farthest}",
                kitchen.id()
            )
        })
    }

    #[test]
    fn robot_and_goal_are_seen_at_the_start_in_every_kitchen() {
        let mut found = Vec::new();
        for id in KitchenId::all() {
            let kitchen = Arc::new(Kitchen::build(id, &SimulationConfig::default()).unwrap());
            found.extend((0..EPISODES).filter_map(|number| hidden(&kitchen, number)));
        }
        assert!(found.is_empty(), "{found:#?}");
    }

    #[test]
    fn no_shadow_stays_where_the_target_was_taken_away() {
        let (scene, first, _) = scene();
        let target = scene.task.target.unwrap();
        let orbit = Orbit { centre: first.things[target].translation, radius_m: 0.6, yaw_rad: 0.3, pitch_rad: 0.9 };
        let mut gone = first.clone();
        gone.things[target].translation.y += 40.0;
        let of = |moments: &[Moment]| {
            let scene = Scene::new(Arc::clone(&scene.kitchen), scene.task.clone(), moments);
            scene.orbit(&gone, &orbit, (120, 90), true, PAPER)
        };
        assert_eq!(of(&[first, gone.clone()]), of(std::slice::from_ref(&gone)), "as if it had never stood there");
    }

    #[test]
    fn turning_the_camera_changes_the_picture_and_soft_light_does_not_change_its_shape() {
        let (scene, moment, thing) = scene();
        let mut orbit = Orbit { centre: moment.things[thing].translation, radius_m: 1.2, yaw_rad: 0.3, pitch_rad: 0.8 };
        let size = (120, 90);
        let draft = scene.orbit(&moment, &orbit, size, false, PAPER);
        let fine = scene.orbit(&moment, &orbit, size, true, PAPER);
        assert_eq!((fine.width, fine.height), size);
        assert_ne!(fine, draft);
        orbit.yaw_rad += 0.5;
        let turned = scene.orbit(&moment, &orbit, size, false, PAPER);
        let changed = turned.pixels.iter().zip(&draft.pixels).filter(|(a, b)| a != b).count();
        assert!(changed > 120 * 90 / 4, "{changed} pixels changed");
    }
}
