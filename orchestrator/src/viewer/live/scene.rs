//! A moment as Foxglove's scene entities: each body by its triangles, the goal, and the way that the target still has.

use crate::recording::recorder::camera::ros_from_world;
use crate::recording::schema::foxglove::line_primitive::Type as LineType;
use crate::recording::schema::foxglove::scene_entity_deletion::Type as DeletionType;
use crate::recording::schema::foxglove::{
    Color, LinePrimitive, Point3, Pose, Quaternion, SceneEntity, SceneEntityDeletion, SceneUpdate, SpherePrimitive,
    TriangleListPrimitive, Vector3,
};
use prost_types::{Duration as Lifetime, Timestamp};
use proto::show::{ShownEpisode, ShownSolid, ShownSolids};
use std::collections::HashMap;

/// What is not told of again for so long is gone: a ghost whose thing was put back, or a viewer that ended.
const GHOST_S: i64 = 3;
const GHOST_ALPHA: f64 = 0.35;
const GOAL: [u8; 3] = [46, 160, 67];

/// The scene of an episode's newest moment; `whole`: what was shown before is taken away first.
pub fn scene_of(
    timestamp: Timestamp,
    frame_id: &str,
    shown: &ShownEpisode,
    solids: &ShownSolids,
    whole: bool,
) -> SceneUpdate {
    let timestamp = Some(timestamp);
    let entity = |id: &str, fleeting: bool| SceneEntity {
        timestamp,
        frame_id: frame_id.to_owned(),
        id: id.to_owned(),
        lifetime: fleeting.then_some(Lifetime { seconds: GHOST_S, nanos: 0 }),
        ..SceneEntity::default()
    };
    let all_of_them = SceneEntityDeletion { timestamp, r#type: DeletionType::All.into(), id: String::new() };
    let of_solid =
        |solid: &ShownSolid| SceneEntity { triangles: vec![triangles(solid)], ..entity(&solid.name, solid.ghost) };
    let mut entities: Vec<SceneEntity> = solids.solids.iter().map(of_solid).collect();
    let moment = shown.moments.last();
    let place = |name: &str| moment?.numbers(name);
    if let Some(goal_m) = place("goal_position_m") {
        let size = 2.0 * f64::from(shown.goal_tolerance_m);
        // From what is to be brought there; else from the robot.
        let on_floor = || moment?.numbers("base_position_m").map(|[x, z]| [x, 0.0, z]);
        let from_m = place("target_position_m").or_else(on_floor).unwrap_or(goal_m);
        entities.push(SceneEntity {
            spheres: vec![SpherePrimitive {
                pose: Some(Pose { position: Some(ros_from_world(goal_m)), ..at_rest() }),
                size: Some(Vector3 { x: size, y: size, z: size }),
                color: Some(colour(GOAL, GHOST_ALPHA)),
            }],
            lines: vec![LinePrimitive {
                r#type: LineType::LineStrip.into(),
                pose: Some(at_rest()),
                thickness: 2.0,
                scale_invariant: true,
                points: vec![point(from_m), point(goal_m)],
                color: Some(colour(GOAL, 1.0)),
                ..LinePrimitive::default()
            }],
            ..entity("goal", false)
        });
    }
    SceneUpdate { deletions: if whole { vec![all_of_them] } else { Vec::new() }, entities }
}

fn triangles(solid: &ShownSolid) -> TriangleListPrimitive {
    let (mut points, mut numbers) = (Vec::new(), HashMap::new());
    let mut number = |corner: [f32; 3]| {
        *numbers.entry(corner.map(f32::to_bits)).or_insert_with(|| {
            points.push(point(corner));
            points.len() as u32 - 1
        })
    };
    // The way from the simulator's axes to Foxglove's is a mirror: it turns triangles round, and this turns them back.
    let corners = solid.corners_m.chunks_exact(3).flat_map(|corners| [corners[0], corners[2], corners[1]]);
    let indices = corners.map(&mut number).collect();
    let alpha = if solid.ghost { GHOST_ALPHA } else { 1.0 };
    TriangleListPrimitive {
        pose: Some(at_rest()),
        points,
        color: Some(colour(solid.colour, alpha)),
        indices,
        ..TriangleListPrimitive::default()
    }
}

fn point(place_m: [f32; 3]) -> Point3 {
    let place = ros_from_world(place_m);
    Point3 { x: place.x, y: place.y, z: place.z }
}

pub fn at_rest() -> Pose {
    let orientation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 };
    Pose { position: Some(Vector3 { x: 0.0, y: 0.0, z: 0.0 }), orientation: Some(orientation) }
}

fn colour([r, g, b]: [u8; 3], a: f64) -> Color {
    let share = |part: u8| f64::from(part) / 255.0;
    Color { r: share(r), g: share(g), b: share(b), a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::show::{ShowOrbit, ShownMoment, ShownTask};

    #[test]
    fn bodies_stand_where_they_are_and_face_outwards() {
        // A triangle on a floor at x 1, z 2, whose normal points up in the simulator's axes.
        let corners_m = vec![[1.0, 0.0, 2.0], [1.0, 0.0, 3.0], [2.0, 0.0, 2.0]];
        let body = ShownSolid { name: "thing/3 Mug".into(), colour: [255, 0, 51], ghost: false, corners_m };
        let ghost = ShownSolid { name: "ghost/3 Mug".into(), ghost: true, ..body.clone() };
        let solids = ShownSolids { solids: vec![body, ghost], camera_pitch_rad: 0.0, depth_mm: Vec::new() };
        let places = [("target_position_m", vec![0.5, 1.0, 0.0]), ("goal_position_m", vec![0.0, 1.0, 0.0])];
        let channels = places.map(|(name, place)| (name.to_owned(), place)).into();
        let moment = ShownMoment { channels, ..ShownMoment::default() };
        let orbit = ShowOrbit { centre_m: [0.0; 3], radius_m: 1.0, yaw_rad: 0.0, pitch_rad: 0.0 };
        let config = proto::config::Config::default();
        let shown = ShownEpisode {
            task: ShownTask::of(config.spec(), &config.reward.weights),
            target: Some("Mug".into()),
            outcome: String::new(),
            goal_tolerance_m: 0.1,
            orbit,
            plan_centre_m: [0.0; 2],
            plan_half_width_m: 1.0,
            moments: vec![moment],
            things: Vec::new(),
            compared: 0,
            first_difference: None,
        };
        let update = scene_of(Timestamp::default(), "watch/world", &shown, &solids, true);
        assert_eq!((update.deletions.len(), update.entities.len()), (1, 3));
        let [body, ghost, goal] = &update.entities[..] else { panic!("three") };
        assert_eq!((body.id.as_str(), body.frame_id.as_str()), ("thing/3 Mug", "watch/world"));
        assert!(body.lifetime.is_none() && ghost.lifetime.is_some_and(|lifetime| lifetime.seconds == GHOST_S));
        let list = &body.triangles[0];
        let corner = |number: usize| {
            let Point3 { x, y, z } = list.points[list.indices[number] as usize];
            [x, y, z]
        };
        assert_eq!(corner(0), [2.0, -1.0, 0.0], "ahead is x, left y");
        let side = |to: usize| [corner(to)[0] - corner(0)[0], corner(to)[1] - corner(0)[1]];
        assert!(side(1)[0] * side(2)[1] - side(1)[1] * side(2)[0] > 0.0, "up is up");
        assert_eq!(list.color, Some(Color { r: 1.0, g: 0.0, b: 0.2, a: 1.0 }));
        assert!(goal.spheres[0].size.as_ref().is_some_and(|size| (size.x - 0.2).abs() < 1e-6));
        assert_eq!(goal.lines[0].points[0], Point3 { x: 0.0, y: -0.5, z: 1.0 });
        assert!(scene_of(Timestamp::default(), "w", &shown, &solids, false).deletions.is_empty());
    }
}
