//! Walls between a camera outside and the room, which pictures leave out with what hangs on them.

use rapier3d::math::Vec3;

/// The thickest wall, metres.
const THICK_MOST_M: f32 = 0.4;
/// What hangs on a wall: windows, doors and switches, which reach this far into the room, ...
const FLAT_M: f32 = 0.15;
/// ... and cabinets and hoods, which reach this far and begin above this height, metres.
const DEEP_M: f32 = 0.6;
const HIGH_M: f32 = 1.2;

/// A wall along x or z.
#[derive(Debug, Clone)]
pub struct Wall {
    /// Out of the room, horizontal.
    outward: Vec3,
    /// Where its inner side is along `outward`, metres.
    inner_m: f32,
    /// The wall and what hangs on it, as bodies of the model.
    pub bodies: Vec<u32>,
}

impl Wall {
    /// The walls among bodies, and what hangs on each; `bounds`: the lowest and highest corner of each body, metres.
    pub fn of(bounds: &[(Vec3, Vec3)], is_wall: impl Fn(u32) -> bool) -> Vec<Self> {
        let begin = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
        let (low, high) = bounds.iter().fold(begin, |(low, high), body| (low.min(body.0), high.max(body.1)));
        let middle = 0.5 * (low + high);
        let bodies = || (0..).zip(bounds);
        let of = |(_, (low, high)): (u32, &(Vec3, Vec3))| {
            let size = *high - *low;
            let along = if size.x < size.z { Vec3::X } else { Vec3::Z };
            let outward = along * (0.5 * (*low + *high) - middle).dot(along).signum();
            let reach_m = |(low, high): &(Vec3, Vec3)| low.dot(outward).min(high.dot(outward));
            let inner_m = reach_m(&(*low, *high));
            let hangs = |(_, body): &(u32, &(Vec3, Vec3))| {
                let into_room_m = inner_m - reach_m(body);
                into_room_m < if body.0.y > HIGH_M { DEEP_M } else { FLAT_M }
            };
            let bodies = bodies().filter(hangs).map(|(body, _)| body).collect();
            (size.dot(along) < THICK_MOST_M).then_some(Self { outward, inner_m, bodies })
        };
        bodies().filter(|(body, _)| is_wall(*body)).filter_map(of).collect()
    }

    /// Whether it stands between this place and the room.
    pub fn hides_from(&self, eye: Vec3) -> bool {
        eye.dot(self.outward) > self.inner_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_before_the_room_is_left_out_with_what_hangs_on_it() {
        let mut bounds = Vec::new();
        let mut block = |at: Vec3, half_m: Vec3| bounds.push((at - half_m, at + half_m));
        block(Vec3::new(2.0, 1.25, 0.0), Vec3::new(0.05, 1.25, 2.0)); // a wall towards +x,
        block(Vec3::new(1.97, 1.0, 0.5), Vec3::new(0.02, 1.0, 0.4)); // its door,
        block(Vec3::new(1.75, 1.8, -0.5), Vec3::new(0.2, 0.4, 0.4)); // a cabinet on it,
        block(Vec3::new(1.75, 0.5, -0.5), Vec3::new(0.2, 0.5, 0.4)); // and one under it;
        block(Vec3::new(0.0, 1.25, -2.0), Vec3::new(2.0, 1.25, 0.05)); // a wall towards -z.
        block(Vec3::new(0.0, -0.1, 0.0), Vec3::new(2.1, 0.1, 2.1));
        let walls = Wall::of(&bounds, |body| [0, 4].contains(&body));
        let left_out = |x: f32, z: f32| {
            let eye = Vec3::new(x, 2.0, z);
            walls.iter().filter(|wall| wall.hides_from(eye)).flat_map(|wall| wall.bodies.clone()).collect::<Vec<_>>()
        };
        assert_eq!(left_out(5.0, 0.0), [0, 1, 2]);
        assert_eq!(left_out(0.0, -5.0), [4]);
        assert_eq!(left_out(1.0, 5.0), [0; 0]);
    }
}
