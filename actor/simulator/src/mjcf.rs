//! A kitchen as MJCF, the scene format of `MuJoCo`: the same bodies, masses and collision geometry.
//!
//! What differs, because the engines do:
//! * **Friction** of two bodies is the mean of theirs in rapier and the larger one in `MuJoCo`. Fixed things and the
//!   robot therefore get none here, and a thing the mean of its own and theirs: the same number between a thing and
//!   what it stands on or is pushed by; between two things the larger of two such means.
//! * **Angular damping** is a rate in rapier; as `MuJoCo`'s is a torque, whoever loads the file sets it from the
//!   inertia that `MuJoCo` computes.
//! * **The robot** consists of mocap bodies, which go where they are told, as kinematic bodies do in rapier. They touch
//!   things and nothing else: what stops the robot at fixed things is not physics in either engine.
//!
//! World axes are used as they are, y up: rigid-body physics does not know left-handed from right-handed axes. A
//! picture does: it comes out mirrored.

use crate::depth::NEAR_M;
use crate::kitchen::{Body, BodyRole, Kitchen};
use crate::physics::world::FRICTION;
use crate::robot::links::part_shapes;
use crate::shape::{Primitive, Shape};
use proto::camera::{FIELD_OF_VIEW_DEG, FRAME_SIDE};
use rapier3d::math::{Pose3, Rot3, Vec3};
use std::f32::consts::FRAC_1_SQRT_2;
use std::fmt::Write;

/// Name of the robot's body, which is no body of the kitchen: the camera sits inside of it.
pub const ROBOT_BODY: &str = "RobotBody";
/// Geom group of what the camera sees, and of what it does not.
const SEEN_GROUP: u32 = 0;
const UNSEEN_GROUP: u32 = 4;
/// Sides and rings of round geoms as `MuJoCo` draws them. It divides a cylinder's mantle into rings as well, so that
/// the depth camera's numbers would give it several times as many triangles; with these it has fewer, and is still
/// within a millimetre of the depth camera nearly everywhere.
const SLICES: u32 = 20;
const STACKS: u32 = 4;
/// Vertical field of view: tan of its half is the depth camera's constant.
/// Farther than anything in a room, metres.
const FAR_M: f32 = 30.0;
const STRINGS_TAKE_ALL: &str = "writing to a string does not fail";

/// The kitchen in its settled state.
///
/// Bodies carry the names they have in the kitchen; the robot's links and last [`ROBOT_BODY`] are mocap bodies. The
/// camera `head` has the depth camera's field of view; its pose is left to whoever renders.
pub fn mjcf(kitchen: &Kitchen, timestep_s: f32) -> String {
    let mut file = MjcfFile::default();
    let fixed = Matter { kind: Kind::Fixed, mass_kg: 0.0, friction: 0.0 };
    let robot = Matter { kind: Kind::Robot, mass_kg: 0.0, friction: 0.0 };
    let mut movables = kitchen.movables().iter();
    for (body, pose) in kitchen.bodies().iter().zip(kitchen.settled_poses()) {
        match body.role {
            BodyRole::Static => {
                for (index, part) in body.shape.convex_parts().iter().enumerate() {
                    let name = format!("{}/{index}", body.name);
                    file.geom(&name, &part.primitive, &(*pose * part.body_from_part), fixed, SEEN_GROUP);
                }
            }
            BodyRole::Movable => {
                let handle = *movables.next().expect("one rigid body for each movable body");
                let colliders = kitchen.world().colliders(handle);
                let matter: Vec<Matter> = colliders
                    .map(|collider| Matter {
                        kind: Kind::Thing,
                        mass_kg: collider.mass(),
                        friction: f32::midpoint(collider.friction(), FRICTION),
                    })
                    .collect();
                assert_eq!(matter.len(), body.shape.convex_parts().len(), "one collider for each part");
                file.open_body(&body.name, pose, "");
                file.world.push_str("      <freejoint/>\n");
                file.parts(body, &matter);
                file.close_body();
            }
            BodyRole::Robot => file.mocap(&body.name, &body.shape, pose, robot, SEEN_GROUP),
        }
    }
    let [shape, ..] = part_shapes();
    let parked = kitchen.settled_poses().last().expect("the robot's links are bodies");
    file.mocap(ROBOT_BODY, &shape, parked, robot, UNSEEN_GROUP);
    format!(
        r#"<mujoco model="kitchen-{id}">
  <option timestep="{timestep_s}" gravity="0 -9.81 0"/>
  <statistic extent="1" center="0 1 0"/>
  <visual>
    <global offwidth="{FRAME_SIDE}" offheight="{FRAME_SIDE}"/>
    <quality shadowsize="0" offsamples="0" numslices="{SLICES}" numstacks="{STACKS}"/>
    <map znear="{NEAR_M}" zfar="{FAR_M}"/>
  </visual>
  <asset>
{meshes}  </asset>
  <worldbody>
    <camera name="head" fovy="{FIELD_OF_VIEW_DEG}"/>
{world}  </worldbody>
</mujoco>
"#,
        id = kitchen.id(),
        meshes = file.assets,
        world = file.world,
    )
}

/// Things touch everything; fixed things and the robot touch things alone.
#[derive(Clone, Copy)]
enum Kind {
    Fixed,
    Robot,
    Thing,
}

impl Kind {
    /// `MuJoCo`'s masks, `contype` and `conaffinity`: two geoms touch if the one's first meets the other's second. The
    /// robot has a bit of its own, so that what it holds can be made to pass through it.
    fn masks(self) -> (u32, u32) {
        match self {
            Self::Fixed => (1, 0),
            Self::Robot => (2, 0),
            Self::Thing => (1, 3),
        }
    }
}

/// What a geom adds to its body, and what it touches.
#[derive(Clone, Copy)]
struct Matter {
    kind: Kind,
    mass_kg: f32,
    friction: f32,
}

#[derive(Default)]
struct MjcfFile {
    assets: String,
    hulls: Vec<Vec<Vec3>>,
    world: String,
}

impl MjcfFile {
    fn open_body(&mut self, name: &str, pose: &Pose3, attributes: &str) {
        self.line(format_args!("    <body name=\"{name}\" {}{attributes}>", placement(pose)));
    }

    fn close_body(&mut self) {
        self.world.push_str("    </body>\n");
    }

    fn mocap(&mut self, name: &str, shape: &Shape, pose: &Pose3, matter: Matter, group: u32) {
        self.open_body(name, pose, " mocap=\"true\"");
        for (index, part) in shape.parts.iter().enumerate() {
            self.geom(&format!("{name}/{index}"), &part.primitive, &part.body_from_part, matter, group);
        }
        self.close_body();
    }

    fn parts(&mut self, body: &Body, matter: &[Matter]) {
        for (index, (part, &matter)) in body.shape.convex_parts().iter().zip(matter).enumerate() {
            self.geom(&format!("{}/{index}", body.name), &part.primitive, &part.body_from_part, matter, SEEN_GROUP);
        }
    }

    fn geom(&mut self, name: &str, primitive: &Primitive, pose: &Pose3, matter: Matter, group: u32) {
        // MuJoCo's round solids lie along z, ours stand along y: a quarter turn about x brings one onto the other.
        let quarter_turn = Pose3::from_parts(Vec3::ZERO, Rot3::from_xyzw(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2));
        let upright = || placement(&(*pose * quarter_turn));
        let solid = match primitive {
            Primitive::Cuboid { half_extents_m: half } => {
                format!("type=\"box\" size=\"{} {} {}\" {}", half.x, half.y, half.z, placement(pose))
            }
            Primitive::Cylinder { radius_m, half_height_m } => {
                format!("type=\"cylinder\" size=\"{radius_m} {half_height_m}\" {}", upright())
            }
            Primitive::Capsule { radius_m, half_height_m } => {
                format!("type=\"capsule\" size=\"{radius_m} {half_height_m}\" {}", upright())
            }
            Primitive::Sphere { radius_m } => format!("type=\"sphere\" size=\"{radius_m}\" {}", placement(pose)),
            Primitive::Hull { points_m } => {
                format!("type=\"mesh\" mesh=\"hull-{}\" {}", self.hull(points_m), placement(pose))
            }
            Primitive::Concave(_) => unreachable!("its convex pieces are written"),
        };
        let Matter { kind, mass_kg, friction } = matter;
        let (is, touches) = kind.masks();
        self.line(format_args!(
            "      <geom name=\"{name}\" {solid} mass=\"{mass_kg}\" friction=\"{friction} 0 0\" contype=\"{is}\" \
             conaffinity=\"{touches}\" group=\"{group}\"/>"
        ));
    }

    /// Number of the mesh with these corners, each of which is written once. `MuJoCo` takes the hull by itself.
    fn hull(&mut self, points_m: &[Vec3]) -> usize {
        if let Some(known) = self.hulls.iter().position(|known| known == points_m) {
            return known;
        }
        self.hulls.push(points_m.to_vec());
        let number = self.hulls.len() - 1;
        let corners: Vec<String> = points_m.iter().map(|p| format!("{} {} {}", p.x, p.y, p.z)).collect();
        let corners = corners.join("  ");
        writeln!(self.assets, "    <mesh name=\"hull-{number}\" vertex=\"{corners}\"/>").expect(STRINGS_TAKE_ALL);
        number
    }

    fn line(&mut self, text: std::fmt::Arguments<'_>) {
        self.world.write_fmt(text).expect(STRINGS_TAKE_ALL);
        self.world.push('\n');
    }
}

/// A pose as attributes; `MuJoCo` writes quaternions with the real part first.
fn placement(pose: &Pose3) -> String {
    let (t, r) = (pose.translation, pose.rotation);
    format!("pos=\"{} {} {}\" quat=\"{} {} {} {}\"", t.x, t.y, t.z, r.w, r.x, r.y, r.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proto::config::SimulationConfig;
    use proto::kitchen::KitchenId;

    fn attribute(line: &str, name: &str) -> Option<String> {
        let (_, rest) = line.split_once(&format!(" {name}=\""))?;
        Some(rest.split_once('"')?.0.to_owned())
    }

    #[test]
    fn the_file_holds_every_part_and_every_kilogram() {
        let settings = SimulationConfig::default();
        let kitchen = Kitchen::build(KitchenId::new(1).unwrap(), &settings).unwrap();
        let text = mjcf(&kitchen, settings.timestep_s);
        let geoms: Vec<&str> = text.lines().filter(|line| line.trim_start().starts_with("<geom ")).collect();
        let parts: usize = kitchen.bodies().iter().map(|body| body.shape.parts.len()).sum();
        assert_eq!(geoms.len(), parts + part_shapes()[0].parts.len());
        let movables = kitchen.bodies().iter().filter(|body| body.role == BodyRole::Movable);
        for (body, &handle) in movables.zip(kitchen.movables()) {
            let own = format!("{}/", body.name);
            let mut mass_kg = 0.0;
            for geom in geoms.iter().filter(|geom| attribute(geom, "name").unwrap().starts_with(&own)) {
                assert_eq!(
                    (attribute(geom, "contype").unwrap(), attribute(geom, "conaffinity").unwrap()),
                    ("1".into(), "3".into())
                );
                mass_kg += attribute(geom, "mass").unwrap().parse::<f32>().unwrap();
            }
            let expected_kg = kitchen.world().body(handle).mass();
            assert!((mass_kg / expected_kg - 1.0).abs() < 1e-4, "{}: {mass_kg} for {expected_kg} kg", body.name);
        }
        let unseen = geoms.iter().filter(|geom| attribute(geom, "group").unwrap() == UNSEEN_GROUP.to_string());
        assert!(unseen.count() > 0, "the camera does not see the robot's own body");
    }

    #[test]
    fn names_are_unique() {
        let settings = SimulationConfig::default();
        let kitchen = Kitchen::build(KitchenId::new(2).unwrap(), &settings).unwrap();
        let text = mjcf(&kitchen, settings.timestep_s);
        for kind in ["<geom ", "<body ", "<mesh "] {
            let lines = text.lines().filter(|line| line.trim_start().starts_with(kind));
            let mut names: Vec<String> = lines.map(|line| attribute(line, "name").unwrap()).collect();
            let count = names.len();
            names.sort();
            names.dedup();
            assert!(count > 0 && names.len() == count, "{kind}: {count} names, {} of them different", names.len());
        }
    }
}
