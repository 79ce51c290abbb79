//! `actor show`: episodes simulated again, and any moment of them drawn from any camera.
//!
//! Input and output are those of [`proto::show`]. An episode is simulated once, when it is opened; what is kept of it
//! are the poses of each moment, from which every picture is drawn.

use crate::replay::film::moment;
use anyhow::{Context, Result, ensure};
use engine::whereabouts;
use picture::{Captions, Moment, NIGHT, Orbit, PAPER, Rgb, Scene, is_displaced};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::KitchenId;
use proto::replay::{Performance, RecordedEpisode, ReplaySetup, Rules, Seen, play};
use proto::show::{
    SHOWN_SIDE_MAX, ShowAnswer, ShowOrbit, ShowRequest, ShowView, ShownEpisode, ShownMoment, ShownTask, ShownThing,
};
use proto::task::Field;
use rapier3d::math::Vec3;
use simulator::depth::DepthCamera;
use simulator::environment::Base;
use simulator::kitchen::Kitchen;
use simulator::{source, tasks};
use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::sync::Arc;

/// Episodes that are kept; the one that was asked for longest ago gives way.
const KEPT: usize = 6;
const KITCHENS: usize = 4;
/// Bounds of a free camera: radius of what it sees (metres), angle at which it looks down (radians).
const RADIUS_M: (f32, f32) = (0.1, 20.0);
const PITCH_RAD: (f32, f32) = (-0.2, 1.57);
const SIDE_MIN: u32 = 8;
/// Height of the page's picture of the room, as a share of its width.
const PAGE_TALL: f32 = 0.75;
/// What is nearer to its place than this stands there, metres.
const STILL_M: f32 = 0.0005;

pub fn run(input: impl BufRead, mut output: impl Write) -> Result<()> {
    let mut in_use = KitchensInUse::default();
    for line in input.lines() {
        let line = line.context("cannot read a request")?;
        let request: ShowRequest = serde_json::from_str(&line).context("a line is not a request")?;
        let (answer, picture) = match in_use.answer(request) {
            Ok(answered) => answered,
            Err(error) => (ShowAnswer::Failed { problem: format!("{error:#}") }, Vec::new()),
        };
        serde_json::to_writer(&mut output, &answer).context("cannot write an answer")?;
        output
            .write_all(b"\n")
            .and_then(|()| output.write_all(&picture))
            .and_then(|()| output.flush())
            .context("cannot write an answer")?;
    }
    Ok(())
}

struct House {
    config: String,
    /// The run's folder: a configuration names scenes relative to it.
    folder: Option<String>,
    id: KitchenId,
    kitchen: Arc<Kitchen>,
    run: Arc<tasks::Run>,
}

struct Kept {
    name: String,
    scene: Scene,
    moments: Vec<Moment>,
    camera: DepthCamera,
}

/// What is kept, the last used last.
#[derive(Default)]
struct KitchensInUse {
    houses: Vec<House>,
    kept: Vec<Kept>,
}

impl KitchensInUse {
    fn answer(&mut self, request: ShowRequest) -> Result<(ShowAnswer, Vec<u8>)> {
        match request {
            ShowRequest::Open { name, setup, episode } => {
                let shown = self.open(name, &setup, &episode)?;
                Ok((ShowAnswer::Opened(Box::new(shown)), Vec::new()))
            }
            ShowRequest::Draw { name, step, view, width, height, fine, dark } => {
                let sides = SIDE_MIN..=SHOWN_SIDE_MAX;
                ensure!(
                    sides.contains(&width) && sides.contains(&height),
                    "pictures are {SIDE_MIN} to {SHOWN_SIDE_MAX} pixels wide and high, not {width} by {height}"
                );
                let Some(kept) = self.kept(&name) else { return Ok((ShowAnswer::NotOpen, Vec::new())) };
                let background = if dark { NIGHT } else { PAPER };
                let picture = kept.draw(step as usize, &view, (width as usize, height as usize), fine, background)?;
                Ok((ShowAnswer::Picture { bytes: picture.len() as u64 }, picture))
            }
        }
    }

    /// The kept episode of this name, which is the last used from now on.
    fn kept(&mut self, name: &str) -> Option<&mut Kept> {
        let at = self.kept.iter().position(|kept| kept.name == name)?;
        let kept = self.kept.remove(at);
        self.kept.push(kept);
        // Two are looked at side by side.
        let others = self.kept.len().saturating_sub(2);
        self.kept[..others].iter_mut().for_each(|kept| kept.scene.forget());
        self.kept.last_mut()
    }

    fn open(&mut self, name: String, setup: &ReplaySetup, recorded: &RecordedEpisode) -> Result<ShownEpisode> {
        whereabouts::enter(recorded.environment, recorded.episode);
        let config = Config::from_toml(&setup.config, "the recording's configuration")?;
        let house = self.house(setup, &config, recorded.environment)?;
        let kitchen = Arc::clone(&house.kitchen);
        let (id, number) = (recorded.environment, recorded.episode);
        let mut environment = tasks::open(&house.run, &kitchen, id, number)?;
        let rules = Rules::of(&config)?;
        let mut telling = Telling::of(environment.base());
        let Performance { verdict, outcome, metrics } =
            play(&rules, &mut *environment, recorded, |environment, seen| {
                telling.keep(&rules, environment.base(), seen);
                anyhow::Ok(())
            })?;
        let Telling { moments, shown, things, record, .. } = telling;
        let task = picture::task(rules.spec, environment.base(), &record, String::new());
        let goal_tolerance_m = task.goal_tolerance_m;
        let figures = rules.spec.metrics.iter().zip(metrics);
        let scene = Scene::new(Arc::clone(&kitchen), task, &moments);
        let (frame, black_mm) = (scene.frame, scene.black_mm);
        let Orbit { centre, radius_m, yaw_rad, pitch_rad } = scene.best(&moments, PAGE_TALL);
        let camera = DepthCamera::new(kitchen.bodies());
        self.kept.retain(|kept| kept.name != name);
        if self.kept.len() >= KEPT {
            self.kept.remove(0);
        }
        self.kept.push(Kept { name, scene, moments, camera });
        Ok(ShownEpisode {
            task: ShownTask::of(&config),
            target: picture::target_name(rules.spec, &record).map(str::to_owned),
            outcome,
            figures: figures.filter_map(|(metric, number)| Some((metric.name.clone(), number?))).collect(),
            goal_tolerance_m,
            orbit: ShowOrbit { centre_m: centre.into(), radius_m, yaw_rad, pitch_rad },
            plan_centre_m: [frame.centre.x, frame.centre.z],
            plan_half_m: frame.half_m,
            black_m: f32::from(black_mm) / 1000.0,
            moments: shown,
            things,
            compared: verdict.compared,
            first_difference: verdict.first_difference,
        })
    }

    /// The environment's kitchen under this configuration.
    fn house(&mut self, setup: &ReplaySetup, config: &Config, id: EnvironmentId) -> Result<&House> {
        let is_it =
            |house: &House| house.id == id.kitchen && house.config == setup.config && house.folder == setup.folder;
        if let Some(at) = self.houses.iter().position(is_it) {
            let house = self.houses.remove(at);
            self.houses.push(house);
        } else {
            let folder = PathBuf::from(setup.folder.clone().unwrap_or_default());
            let kitchen = source::of_run(id.kitchen, config, &folder)?;
            if self.houses.len() >= KITCHENS {
                self.houses.remove(0);
            }
            let (kitchen, run) = (Arc::new(kitchen), tasks::Run::of(config));
            let (config, folder) = (setup.config.clone(), setup.folder.clone());
            self.houses.push(House { config, folder, id: id.kitchen, kitchen, run });
        }
        self.houses.last().context("the kitchen was just put there")
    }
}

impl Kept {
    fn draw(
        &mut self,
        step: usize,
        view: &ShowView,
        size: (usize, usize),
        fine: bool,
        background: Rgb,
    ) -> Result<Vec<u8>> {
        let moment = moment_of(&self.moments, step)?;
        let picture = match view {
            ShowView::Orbit(orbit) => {
                let orbit = checked(orbit)?;
                self.scene.orbit(moment, &orbit, size, fine, background)
            }
            ShowView::Depth => self.scene.depth(moment, &mut self.camera, size.0),
            ShowView::Plan => self.scene.plan(size.0, background),
        };
        Ok(picture.png()?)
    }
}

fn moment_of(moments: &[Moment], step: usize) -> Result<&Moment> {
    let last = moments.len() - 1;
    moments.get(step).with_context(|| format!("the episode has {last} steps, not {step}"))
}

/// The camera within its bounds; an error if it is nowhere.
fn checked(orbit: &ShowOrbit) -> Result<Orbit> {
    let ShowOrbit { centre_m, radius_m, yaw_rad, pitch_rad } = *orbit;
    let numbers = [radius_m, yaw_rad, pitch_rad];
    ensure!(centre_m.into_iter().chain(numbers).all(f32::is_finite), "a camera's place is of finite numbers");
    let centre = Vec3::from(centre_m).clamp(Vec3::splat(-50.0), Vec3::splat(50.0));
    Ok(Orbit {
        centre,
        radius_m: radius_m.clamp(RADIUS_M.0, RADIUS_M.1),
        yaw_rad: yaw_rad % std::f32::consts::TAU,
        pitch_rad: pitch_rad.clamp(PITCH_RAD.0, PITCH_RAD.1),
    })
}

struct Telling {
    origins: Vec<Vec3>,
    moments: Vec<Moment>,
    shown: Vec<ShownMoment>,
    /// Of each movable thing its number among `things`.
    listed: Vec<Option<u32>>,
    things: Vec<ShownThing>,
    /// The last moment's.
    record: Vec<u8>,
}

impl Telling {
    fn of(environment: &Base) -> Self {
        let poses = environment.simulation().things().poses();
        Self {
            origins: poses.iter().map(|pose| pose.translation).collect(),
            moments: Vec::new(),
            shown: Vec::new(),
            listed: vec![None; poses.len()],
            things: Vec::new(),
            record: Vec::new(),
        }
    }

    fn keep(&mut self, rules: &Rules, environment: &Base, seen: &Seen) {
        let target = picture::target(rules.spec, environment, seen.record);
        let poses = environment.simulation().things().poses();
        let kitchen = environment.kitchen();
        let category = |thing: usize| kitchen.bodies()[kitchen.movable_bodies()][thing].category.clone();
        let (mut moved, mut nearly) = (Vec::new(), (STILL_M, None));
        for (thing, (origin, pose)) in self.origins.iter().zip(poses).enumerate() {
            let way = pose.translation - *origin;
            if Some(thing) == target {
                continue;
            }
            if !is_displaced(*origin, pose.translation) {
                nearly = if way.length() > nearly.0 { (way.length(), Some(thing)) } else { nearly };
                continue;
            }
            let number = *self.listed[thing].get_or_insert_with(|| {
                self.things.push(ShownThing { category: category(thing), stood_m: [origin.x, origin.z] });
                self.things.len() as u32 - 1
            });
            moved.push((number, way.length(), pose.translation.to_array()));
        }
        let nearly = nearly.1.map(|thing| (category(thing), nearly.0));
        self.shown.push(ShownMoment { moved, nearly, ..shown(rules, seen) });
        self.moments.push(moment(environment, Captions::default()));
        seen.record.clone_into(&mut self.record);
    }
}

fn shown(rules: &Rules, seen: &Seen) -> ShownMoment {
    let acted = seen.rewards.is_some();
    let channels = rules.spec.channels.iter().zip(&rules.spec.layout().fields);
    let channels = channels.filter(|(channel, _)| !channel.is_bulk() && (acted || !channel.is_of_action()));
    let numbers = |field: &Field| field.numbers(seen.record).map(|number| number as f32).collect();
    let rewards = rules.compared.rewards().map(str::to_owned).zip(seen.rewards.into_iter().flatten().copied());
    let part = |index| rules.spec.layout().part(seen.record, index);
    let own = rules.own_rewards.iter().filter(|_| acted).map(|(name, reward)| (name.clone(), reward.of(part, 0.0)));
    ShownMoment {
        action: picture::action_name(rules.spec, seen.record).filter(|_| acted).map(str::to_owned),
        channels: channels.map(|(channel, field)| (channel.name.clone(), numbers(field))).collect(),
        rewards: rewards.chain(own).collect(),
        ..ShownMoment::default()
    }
}

#[cfg(test)]
mod tests;
