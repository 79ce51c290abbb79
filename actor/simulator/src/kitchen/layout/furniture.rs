//! What stands on the floor away from the runs, and what hangs on free walls: tables, shelving unit, side table, wall
//! shelves, mirror, safe.

use super::draft::{Draft, Seat, Worktop, WorktopKind};
use super::floor_plan::Rectangle;
use super::frame::{Assembly, Frame, Span};
use super::shell::ROOM_HEIGHT_M;
use crate::kitchen::room::Surface;
use rapier3d::math::Vec3;

const TABLE_HEIGHT_M: f32 = 0.75;
const TABLE_TOP_M: f32 = 0.03;
/// Thickness of a shelf. With the hand's radius it exceeds the magnet's reach: nothing is picked up through a shelf.
const SHELF_M: f32 = 0.03;
/// A table nearer to a wall than this is pushed against it, metres.
const ALONE_M: f32 = 0.80;
const SEAT_WIDTH_M: f32 = 0.56;
const SEAT_DEPTH_M: f32 = 0.62;
const TRIES: u32 = 60;

impl Draft<'_> {
    /// A dining table where the floor is free, and its seats; none if there is no such place.
    pub fn dining_table(&mut self) -> Option<()> {
        let round = self.random.uniform() < 0.25;
        let size = if round {
            let diameter = self.random.range(0.9, 1.1);
            Vec3::new(diameter, 0.0, diameter)
        } else {
            Vec3::new(self.random.range(1.05, 1.5), 0.0, self.random.range(0.75, 0.9))
        };
        let (frame, [length, depth]) = (self.walls[0].frame, [self.walls[0].length_m, self.walls[1].length_m]);
        for _ in 0..TRIES {
            let turned = self.random.uniform() < 0.5;
            let (along, out) = if turned { (size.z, size.x) } else { (size.x, size.z) };
            if along > length || out > depth {
                continue;
            }
            let mut from = [self.random.uniform() * (length - along), self.random.uniform() * (depth - out)];
            for ((from, own), room) in from.iter_mut().zip([along, out]).zip([length, depth]) {
                // Round tables stand free.
                let alone = if round { 0.0 } else { ALONE_M };
                if *from < alone {
                    *from = 0.02;
                } else if room - own - *from < alone {
                    *from = room - own - 0.02;
                }
            }
            let corners = frame.block([from[0], from[0] + along], [0.0, 0.0], [from[1], from[1] + out]);
            let place = Rectangle::below(corners);
            if round && self.walls_near(&place) || !self.floor_plan.admits(&place) {
                continue;
            }
            self.build_table(place, round);
            return Some(());
        }
        None
    }

    /// Whether a wall is nearer than a chair needs.
    fn walls_near(&self, place: &Rectangle) -> bool {
        !place.grown(ALONE_M).within(&self.room())
    }

    pub fn room(&self) -> Rectangle {
        let (length, depth) = (self.walls[0].length_m, self.walls[1].length_m);
        Rectangle::below(self.walls[0].frame.block([0.0, length], [0.0, 0.0], [0.0, depth]))
    }

    fn build_table(&mut self, place: Rectangle, round: bool) {
        let Rectangle { low, high } = place;
        let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
        let frame = Frame { origin: middle, along: Vec3::X, out: Vec3::Z };
        let up = [TABLE_HEIGHT_M - TABLE_TOP_M, TABLE_HEIGHT_M];
        let mut body = Assembly::new(frame);
        // A square on a round top.
        let usable = if round { half * std::f32::consts::FRAC_1_SQRT_2 } else { half };
        if round {
            body = body
                .drum([0.0, up[0], 0.0], [0.0, up[1], 0.0], half.x)
                .drum([0.0, 0.03, 0.0], [0.0, up[0], 0.0], 0.05)
                .drum([0.0, 0.0, 0.0], [0.0, 0.03, 0.0], 0.28);
        } else {
            body = body.slab([-half.x, half.x], up, [-half.z, half.z]);
            let turned_legs = self.random.uniform() < 0.5;
            for (sign_x, sign_z) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
                let (x, z) = (sign_x * (half.x - 0.06), sign_z * (half.z - 0.06));
                body = if turned_legs {
                    body.drum([x, 0.0, z], [x, up[0], z], 0.03)
                } else {
                    body.slab([x - 0.03, x + 0.03], [0.0, up[0]], [z - 0.03, z + 0.03])
                };
            }
            // Aprons between the legs.
            let (x, z) = (half.x - 0.06, half.z - 0.06);
            for side in [-1.0, 1.0] {
                body = body
                    .slab([-x + 0.03, x - 0.03], [up[0] - 0.07, up[0]], [side * z - 0.01, side * z + 0.01])
                    .slab([side * x - 0.01, side * x + 0.01], [up[0] - 0.07, up[0]], [-z + 0.03, z - 0.03]);
            }
        }
        self.fix("DiningTable", body);
        let (surface_low, surface_high) = (middle - usable, middle + usable);
        let surface = Surface { low: surface_low.with_y(TABLE_HEIGHT_M), high: surface_high.with_y(ROOM_HEIGHT_M) };
        self.worktops.push(Worktop { surface, kind: WorktopKind::Table, back: None });
        for (facing, edge_half, across) in [
            (Vec3::X, half.x, half.z),
            (Vec3::NEG_X, half.x, half.z),
            (Vec3::Z, half.z, half.x),
            (Vec3::NEG_Z, half.z, half.x),
        ] {
            let count = if round { 1.0 } else { libm::floorf(2.0 * (across - 0.05) / SEAT_WIDTH_M) };
            let aside = Vec3::new(facing.z, 0.0, facing.x).abs();
            for index in 0..count as u32 {
                let offset = (index as f32 + 0.5 - 0.5 * count) * SEAT_WIDTH_M;
                self.seat(middle - edge_half * facing + offset * aside, facing, false);
            }
        }
        self.floor_plan.occupied.push(place);
    }

    pub fn seat(&mut self, edge: Vec3, facing: Vec3, at_counter: bool) {
        let aside = Vec3::new(facing.z, 0.0, facing.x).abs() * (0.5 * SEAT_WIDTH_M);
        let corners = [edge - aside, edge + aside - SEAT_DEPTH_M * facing];
        let place = Rectangle::below((corners[0].min(corners[1]), corners[0].max(corners[1])));
        if self.floor_plan.is_free(&place) && place.within(&self.room()) {
            self.seats.push(Seat { edge, facing, at_counter });
        }
    }

    /// A free place at a wall for a piece this wide and deep: the frame whose origin is its left end. `before_m` of
    /// floor in front of it stay free of other furniture.
    fn at_wall(&mut self, width: f32, depth: f32) -> Option<Frame> {
        for _ in 0..TRIES {
            let wall = self.random.below(4) as usize;
            let free = self.walls[wall].free();
            let wide: Vec<Span> = free.into_iter().filter(|span| span[1] - span[0] >= width + 0.06).collect();
            if wide.is_empty() {
                continue;
            }
            let span = wide[self.random.below(wide.len() as u32) as usize];
            let slack = span[1] - span[0] - width - 0.06;
            let share = [0.0, 1.0, self.random.uniform()][self.random.below(3) as usize];
            let from = span[0] + 0.03 + share * slack;
            let frame = self.walls[wall].frame;
            let place = Rectangle::below(frame.block([from, from + width], [0.0, 0.0], [0.0, depth]));
            // Flush with the wall: no way is needed behind, and none beside another piece at the same wall.
            let front = Rectangle::below(frame.block([from, from + width], [0.0, 0.0], [0.0, depth + ALONE_M]));
            let blocked = self.floor_plan.occupied.iter().any(|other| other.overlaps(&front))
                || self.floor_plan.kept_clear.iter().any(|clear| clear.overlaps(&place));
            if !blocked {
                self.walls[wall].taken.push([from - 0.02, from + width + 0.02]);
                self.floor_plan.occupied.push(place);
                return Some(frame.shifted(from, 0.0));
            }
        }
        None
    }

    pub fn shelving_unit(&mut self, shelves: u32) -> Option<()> {
        let (width, depth) = (self.random.range(0.8, 1.0), 0.36);
        let frame = self.at_wall(width, depth)?;
        let height = self.random.range(1.0, 1.25);
        let post = 0.03;
        let mut body = Assembly::new(frame);
        for (x, z) in [(0.0, 0.0), (width - post, 0.0), (0.0, depth - post), (width - post, depth - post)] {
            body = body.slab([x, x + post], [0.0, height], [z, z + post]);
        }
        let brace = 0.5 * height;
        body = body.slab([post, width - post], [brace, brace + 0.03], [0.002, 0.012]).slab(
            [post, width - post],
            [height - 0.03, height],
            [0.002, 0.012],
        );
        self.fix("ShelvingUnit", body);
        let inner = [post, width - post];
        for index in 0..shelves {
            let up = 0.12 + (height - 0.12) * (index + 1) as f32 / shelves as f32 - 0.03;
            let above = if index + 1 == shelves {
                ROOM_HEIGHT_M
            } else {
                0.12 + (height - 0.12) * (index + 2) as f32 / shelves as f32 - 0.03 - SHELF_M
            };
            self.shelf(frame, inner, [up, above], [0.012, depth - 0.002]);
        }
        Some(())
    }

    /// One shelf board whose top is at `up[0]`, below something at `up[1]`.
    fn shelf(&mut self, frame: Frame, along: Span, up: Span, out: Span) {
        self.fix("Shelf", Assembly::new(frame).slab(along, [up[0] - SHELF_M, up[0]], out));
        let (low, high) = frame.block(along, up, out);
        let surface = Surface { low, high };
        self.worktops.push(Worktop { surface, kind: WorktopKind::Shelf, back: Some(-frame.out) });
    }

    pub fn wall_shelves(&mut self, frame: Frame, along: Span, boards: u32) {
        const DEPTH_M: f32 = 0.26;
        const PITCH_M: f32 = 0.34;
        let inset = [along[0] + 0.03, along[1] - 0.03];
        for board in 0..boards {
            let top = self.style.wall_cabinet_m[0] - 0.06 + board as f32 * PITCH_M;
            let above = if board + 1 == boards { ROOM_HEIGHT_M } else { top + PITCH_M - SHELF_M };
            let mut body = Assembly::new(frame).slab(inset, [top - SHELF_M, top], [0.0, DEPTH_M]);
            for bracket in [inset[0] + 0.08, inset[1] - 0.08] {
                body = body.slab([bracket - 0.01, bracket + 0.01], [top - 0.16, top - SHELF_M], [0.0, 0.012]).slab(
                    [bracket - 0.01, bracket + 0.01],
                    [top - 0.045, top - SHELF_M],
                    [0.012, 0.2],
                );
            }
            self.fix("Shelf", body);
            let (low, high) = frame.block(inset, [top, above], [0.0, DEPTH_M]);
            let surface = Surface { low, high };
            self.worktops.push(Worktop { surface, kind: WorktopKind::Shelf, back: Some(-frame.out) });
        }
    }

    pub fn side_table(&mut self) -> Option<()> {
        let (width, depth) = (self.random.range(0.8, 1.1), self.random.range(0.38, 0.45));
        let frame = self.at_wall(width, depth)?;
        let height = self.random.range(0.74, 0.86);
        let leg = 0.04;
        let mut body = Assembly::new(frame).slab([0.0, width], [height - 0.03, height], [0.0, depth]);
        for (x, z) in [
            (0.01, 0.01),
            (width - leg - 0.01, 0.01),
            (0.01, depth - leg - 0.01),
            (width - leg - 0.01, depth - leg - 0.01),
        ] {
            body = body.slab([x, x + leg], [0.0, height - 0.03], [z, z + leg]);
        }
        body = body.slab([0.05, width - 0.05], [0.2, 0.22], [0.02, depth - 0.02]);
        self.fix("SideTable", body);
        let (low, high) = frame.block([0.0, width], [height, ROOM_HEIGHT_M], [0.0, depth]);
        let surface = Surface { low, high };
        self.worktops.push(Worktop { surface, kind: WorktopKind::SideTable, back: Some(-frame.out) });
        Some(())
    }

    pub fn safe(&mut self) -> Option<()> {
        let frame = self.at_wall(0.42, 0.40)?;
        let body = Assembly::new(frame)
            .slab([0.0, 0.42], [0.0, 0.5], [0.0, 0.37])
            .slab([0.02, 0.40], [0.03, 0.48], [0.37, 0.385])
            .drum([0.13, 0.28, 0.385], [0.13, 0.28, 0.41], 0.04)
            .rod([0.30, 0.22, 0.415], [0.30, 0.34, 0.415], 0.01)
            .drum([0.30, 0.28, 0.385], [0.30, 0.28, 0.415], 0.012);
        self.fix("Safe", body);
        Some(())
    }

    pub fn mirror(&mut self) -> Option<()> {
        let width = 0.5;
        for _ in 0..TRIES {
            let wall = 1 + self.random.below(3) as usize;
            let free: Vec<Span> =
                self.walls[wall].free().into_iter().filter(|span| span[1] - span[0] >= width + 0.2).collect();
            if free.is_empty() {
                continue;
            }
            let span = free[self.random.below(free.len() as u32) as usize];
            let from = span[0] + 0.1 + self.random.uniform() * (span[1] - span[0] - width - 0.2);
            let body = Assembly::new(self.walls[wall].frame)
                .slab([from, from + width], [1.25, 1.95], [0.0, 0.012])
                .slab([from - 0.03, from], [1.22, 1.98], [0.0, 0.02])
                .slab([from + width, from + width + 0.03], [1.22, 1.98], [0.0, 0.02])
                .slab([from, from + width], [1.22, 1.25], [0.0, 0.02])
                .slab([from, from + width], [1.95, 1.98], [0.0, 0.02]);
            self.fix("Mirror", body);
            self.walls[wall].taken.push([from - 0.05, from + width + 0.05]);
            return Some(());
        }
        None
    }
}
