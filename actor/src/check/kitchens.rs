//! Everything that a kitchen must satisfy, and `actor check`, which goes through it.

use super::episode;
use anyhow::{Result, ensure};
use proto::config::Config;
use proto::episode::EnvironmentId;
use proto::kitchen::{KitchenId, Split, TargetCategory};
use rapier3d::geometry::Aabb;
use rapier3d::math::Vec3;
use rapier3d::parry::bounding_volume::BoundingVolume;
use simulator::kitchen::layout::Plan;
use simulator::kitchen::overlap::{Overlap, overlaps};
use simulator::kitchen::{CONNECTED_LEAST, Kitchen, SPOTS_LEAST, ithor, likeness};
use simulator::physics::geometry::Solid;
use simulator::robot::action::Action;
use simulator::tasks::arm_point_nav::Environment;
use simulator::tasks::arm_point_nav::episode::Episode;
use simulator::tasks::arm_point_nav::episodes::{self, EpisodesError};
use std::io::Write;
use std::sync::Arc;

const STILL_STEPS: u32 = 200;
/// Sampled episodes of a training kitchen that are checked.
const SAMPLED_EPISODES: u32 = 60;
/// A chair's bounding box is at most this far from its table, metres.
const CHAIR_TO_TABLE_M: f32 = 0.15;
/// Height up to which floor is kept clear, metres: a wall cabinet may hang over it.
const CLEAR_HEIGHT_M: f32 = 1.3;

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    #[error(transparent)]
    Overlap(#[from] Overlap),
    #[error("{0} is awake")]
    Awake(String),
    #[error("episode {episode}: d = {disturbance_m} m after {step} steps in which nothing moved")]
    Restless { episode: u32, step: u32, disturbance_m: f32 },
    #[error("only {:.0}% of the free floor are connected", .0 * 100.0)]
    FloorInParts(f32),
    #[error("{0} stands on floor that is to be kept clear")]
    Obstructed(String),
    #[error("{category} has {spots} valid positions, {SPOTS_LEAST} are wanted")]
    FewSpots { category: &'static str, spots: usize },
    #[error("{0} stands at no table")]
    ChairAlone(String),
    #[error("episode {episode}: {problem}")]
    Episode { episode: usize, problem: episode::Problem },
    #[error("{0}")]
    Episodes(#[from] EpisodesError),
    #[error("only {distance:.3} from kitchen {kitchen}; those of validation and test are {least:.3} from each other")]
    TooNear { kitchen: KitchenId, distance: f32, least: f32 },
    #[error("{0} things; iTHOR's kitchens hold {least} to {most}", least = ithor::THINGS[0], most = ithor::THINGS[2])]
    ThingCount(usize),
}

/// All that is wrong with a kitchen. Whatever else a kitchen must satisfy is to be added here: `actor check` and the
/// tests go through this list.
pub fn problems(kitchen: &Arc<Kitchen>, config: &Config) -> Vec<Problem> {
    let mut found = Vec::new();
    overlapping(kitchen, &mut found);
    awake(kitchen, &mut found);
    restless(kitchen, config, &mut found);
    if kitchen.connected_share() < CONNECTED_LEAST {
        found.push(Problem::FloorInParts(kitchen.connected_share()));
    }
    obstructions(kitchen, &mut found);
    if kitchen.id().split() == Split::Train {
        for category in TargetCategory::ALL {
            let spots = kitchen.target_spots(category).len();
            if spots < SPOTS_LEAST {
                found.push(Problem::FewSpots { category: category.name(), spots });
            }
        }
    }
    lonely_chairs(kitchen, &mut found);
    if kitchen.id().is_procedural()
        && let Some((id, distance)) = likeness::nearest_to_kitchen(kitchen)
        && distance < likeness::least_distance()
    {
        found.push(Problem::TooNear { kitchen: id, distance, least: likeness::least_distance() });
    }
    let things = kitchen.thing_count();
    if !(ithor::THINGS[0]..=ithor::THINGS[2]).contains(&(things as f32)) {
        found.push(Problem::ThingCount(things));
    }
    found
}

/// What is wrong with a kitchen's episodes: all fixed ones of an evaluation kitchen, the first sampled ones of a
/// training kitchen. Not among [`problems`]: it takes seconds a kitchen.
fn episode_problems(kitchen: &Arc<Kitchen>, config: &Config) -> Vec<Problem> {
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    let episodes = if kitchen.id().split() == Split::Train {
        (0..SAMPLED_EPISODES).map(|n| Episode::sample(kitchen, &config.episode, config.seed, id, n)).collect()
    } else {
        match episodes::fixed(kitchen) {
            Ok(fixed) => fixed,
            Err(error) => return vec![error.into()],
        }
    };
    let verdicts = episode::verdicts(kitchen, config, &episodes).into_iter().enumerate();
    verdicts
        .filter_map(|(episode, verdict)| verdict.err().map(|problem| Problem::Episode { episode, problem }))
        .collect()
}

/// What is wrong with a scene of the user's own, of what is wrong in any room.
pub(crate) fn scene_problems(kitchen: &Arc<Kitchen>, config: &Config) -> Vec<Problem> {
    let mut found = Vec::new();
    overlapping(kitchen, &mut found);
    awake(kitchen, &mut found);
    restless(kitchen, config, &mut found);
    found
}

/// Prints a line a kitchen and the totals last; an error if any kitchen has a problem.
pub fn run(kitchens: &[KitchenId], mut out: impl Write) -> Result<()> {
    let config = Config::default();
    let (mut bad, mut total, mut things) = (0, 0, 0);
    for &id in kitchens {
        let (found, summary) = match Kitchen::build(id, &config.simulation) {
            Ok(kitchen) => {
                let kitchen = Arc::new(kitchen);
                things += kitchen.thing_count();
                let least = TargetCategory::ALL.map(|category| kitchen.target_spots(category).len()).into_iter().min();
                let plan = kitchen.plan().map_or("", Plan::name);
                let nearest = likeness::nearest_to_kitchen(&kitchen).filter(|_| id.is_procedural());
                let nearest = nearest.map_or_else(String::new, |(id, far)| format!(", {far:.2} from kitchen {id}"));
                let summary = format!(
                    "{plan:<9} {:3} things, {:2} movable, {:4} robot poses, at least {:4} positions a target{nearest}",
                    kitchen.thing_count(),
                    kitchen.movable_bodies().len(),
                    kitchen.robot_stands().len(),
                    least.unwrap_or(0)
                );
                let mut found = problems(&kitchen, &config);
                found.extend(episode_problems(&kitchen, &config));
                let found: Vec<String> = found.iter().map(ToString::to_string).collect();
                (found, summary)
            }
            Err(error) => (vec![error.to_string()], String::new()),
        };
        bad += usize::from(!found.is_empty());
        total += found.len();
        let verdict = if found.is_empty() { "ok".to_owned() } else { found.join("; ") };
        writeln!(out, "kitchen {:2}  {summary}: {verdict}", id.number())?;
    }
    writeln!(out, "{} kitchens, {things} things, {bad} kitchens with problems, {total} problems", kitchens.len())?;
    ensure!(bad == 0, "{bad} of {} kitchens have problems", kitchens.len());
    Ok(())
}

fn overlapping(kitchen: &Kitchen, found: &mut Vec<Problem>) {
    let overlaps = overlaps(kitchen.bodies(), kitchen.settled_poses(), kitchen.movable_bodies());
    found.extend(overlaps.into_iter().map(Problem::from));
}

fn awake(kitchen: &Kitchen, found: &mut Vec<Problem>) {
    for (index, &handle) in kitchen.movable_bodies().zip(kitchen.movables()) {
        let body = kitchen.world().body(handle);
        if !body.is_sleeping() || body.linvel() != Vec3::ZERO || body.angvel() != Vec3::ZERO {
            found.push(Problem::Awake(kitchen.bodies()[index].name.clone()));
        }
    }
}

/// Looking down and up moves nothing but the camera: the displacement must be exactly zero.
fn restless(kitchen: &Arc<Kitchen>, config: &Config, found: &mut Vec<Problem>) {
    let id = EnvironmentId { kitchen: kitchen.id(), number: 0 };
    // What is refused is another kitchen's id and episode.
    let environment = Environment::new(Arc::clone(kitchen), id, config);
    let mut environment = environment.expect("the id is the kitchen's, and so is the episode drawn in it");
    for step in 0..STILL_STEPS.min(config.episode.max_steps) {
        let action = if step % 2 == 0 { Action::LookDown } else { Action::LookUp };
        let disturbance_m = environment.step(action).disturbance_m;
        if disturbance_m != 0.0 {
            found.push(Problem::Restless { episode: 0, step, disturbance_m });
            return;
        }
    }
}

fn obstructions(kitchen: &Kitchen, found: &mut Vec<Problem>) {
    const FLOOR_M: f32 = 0.01;
    for index in kitchen.static_bodies() {
        let body = &kitchen.bodies()[index];
        if matches!(body.category.as_str(), "Floor" | "Ceiling") {
            continue;
        }
        let solid = Solid::of(&body.shape);
        let pose = &kitchen.settled_poses()[index];
        let in_the_way = kitchen.kept_clear().iter().any(|clear| {
            let room = Aabb::new(clear.low.with_y(FLOOR_M), clear.high.with_y(CLEAR_HEIGHT_M));
            solid.parts.iter().any(|(shape, body_from_part)| {
                let aabb = shape.compute_aabb(&(*pose * *body_from_part));
                room.intersects(&aabb.tightened(0.001))
            })
        });
        if in_the_way {
            found.push(Problem::Obstructed(body.name.clone()));
        }
    }
}

fn lonely_chairs(kitchen: &Kitchen, found: &mut Vec<Problem>) {
    let aabb = |index: usize| Solid::of(&kitchen.bodies()[index].shape).aabb(&kitchen.settled_poses()[index]);
    let with = |category: &str| {
        (0..kitchen.movable_bodies().end).filter(|&index| kitchen.bodies()[index].category == category).collect()
    };
    let (chairs, tables): (Vec<usize>, Vec<usize>) = (with("Chair"), with("DiningTable"));
    for chair in chairs {
        let near = aabb(chair).loosened(CHAIR_TO_TABLE_M);
        if !tables.iter().any(|&table| aabb(table).intersects(&near)) {
            found.push(Problem::ChairAlone(kitchen.bodies()[chair].name.clone()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rapier3d::math::Pose3;
    use simulator::kitchen::draw_room;
    use simulator::kitchen::room::Fixture;
    use simulator::shape::{Primitive, Shape};

    /// The first draw of a room with a chair that comes to rest after `change`.
    fn spoilt(change: impl Fn(&mut Vec<Fixture>, Vec3)) -> Arc<Kitchen> {
        let config = Config::default();
        for id in KitchenId::all() {
            let Ok(mut drawn) = draw_room(id, 0) else { continue };
            if !drawn.room.things.iter().any(|thing| thing.category == "Chair") {
                continue;
            }
            let before_a_run = 0.5 * (drawn.kept_clear[0].low + drawn.kept_clear[0].high);
            change(&mut drawn.room.fixtures, before_a_run);
            if let Ok(kitchen) = drawn.settle(id, config.simulation.timestep_s) {
                return Arc::new(kitchen);
            }
        }
        panic!("no kitchen comes to rest");
    }

    #[test]
    fn faults_are_found() {
        let config = Config::default();
        let kitchen = spoilt(|fixtures, before_a_run| {
            let shape = Shape::of(Primitive::Cuboid { half_extents_m: Vec3::splat(0.1) });
            let pose = Pose3::from_translation(before_a_run.with_y(0.1));
            fixtures.push(Fixture { category: "Pillar".to_owned(), shape, pose });
        });
        assert!(problems(&kitchen, &config).contains(&Problem::Obstructed("Pillar".to_owned())));
        let kitchen = spoilt(|fixtures, _| fixtures.retain(|fixture| fixture.category != "DiningTable"));
        let alone = |problem: &Problem| matches!(problem, Problem::ChairAlone(_));
        assert!(problems(&kitchen, &config).iter().any(alone));
        let bare = ["DiningTable", "Drawer", "Cabinet", "StoveKnob", "Window", "Faucet"];
        let kitchen = spoilt(|fixtures, _| fixtures.retain(|fixture| !bare.contains(&fixture.category.as_str())));
        let few = |problem: &Problem| matches!(problem, Problem::ThingCount(_));
        assert!(problems(&kitchen, &config).iter().any(few), "{} things", kitchen.thing_count());
        // A kitchen of the test split under a procedural number.
        let [test, procedural] = [2, 1000].map(|number| KitchenId::new(number).unwrap());
        let copy = draw_room(test, 0).unwrap().settle(procedural, config.simulation.timestep_s).unwrap();
        let near = |problem: &Problem| matches!(problem, Problem::TooNear { kitchen, .. } if *kitchen == test);
        assert!(problems(&Arc::new(copy), &config).iter().any(near));
    }
}
