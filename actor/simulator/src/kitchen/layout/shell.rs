//! The shell of a room: floor, ceiling, walls with real openings, and what fills the openings: door and windows.

use super::draft::Draft;
use super::floor_plan::Rectangle;
use super::frame::{Assembly, Frame, Span};
use super::wall::{Opening, Wall};
use crate::kitchen::room::Fixture;
use rapier3d::math::Vec3;

pub(super) const ROOM_HEIGHT_M: f32 = 2.6;
/// Thickness of walls, floor and ceiling, metres.
const WALL_M: f32 = 0.2;
/// A door's opening and the casing beside it, metres.
const DOOR_WIDTH_M: f32 = 0.88;
const DOOR_HEIGHT_M: f32 = 2.06;
const CASING_M: f32 = 0.07;
const DOOR_SWING_M: f32 = 0.95;
const TRIES: u32 = 30;
/// Height of a window's opening, metres.
pub(super) const WINDOW_M: Span = [1.12, 2.08];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Drapery {
    None,
    Blinds,
    Curtains,
}

/// Floor, walls and ceiling, in this order; the outer box of a wall is the wall's whether or not it has openings.
pub(super) fn shell(walls: &[Wall; 4]) -> Vec<Fixture> {
    let corners = [walls[0].frame.at(0.0, 0.0, 0.0), walls[3].frame.at(walls[3].length_m, 0.0, 0.0)];
    let (low, high) = (corners[0].min(corners[1]), corners[0].max(corners[1]));
    let rim = Vec3::new(WALL_M, 0.0, WALL_M);
    let plate = |from: f32, to: f32| {
        let (low, high) = (low - rim + Vec3::new(0.0, from, 0.0), high + rim + Vec3::new(0.0, to, 0.0));
        Assembly::new(walls[0].frame).block(low, high)
    };
    let mut fixtures = vec![plate(-0.3, 0.0).fixture("Floor")];
    for (index, wall) in walls.iter().enumerate() {
        // The main wall and the one that faces it go round the corners.
        let past = if index == 0 || index == 3 { WALL_M } else { 0.0 };
        fixtures.push(wall_with_openings(wall, [-past, wall.length_m + past]).fixture("Wall"));
    }
    fixtures.push(plate(ROOM_HEIGHT_M, ROOM_HEIGHT_M + WALL_M).fixture("Ceiling"));
    fixtures
}

fn wall_with_openings(wall: &Wall, along: Span) -> Assembly {
    let mut openings = wall.openings.clone();
    openings.sort_by(|a, b| a.along[0].total_cmp(&b.along[0]));
    let mut body = Assembly::new(wall.frame);
    let thick = [-WALL_M, 0.0];
    let mut from = along[0];
    for Opening { along, up } in openings {
        body = body.slab([from, along[0]], [0.0, ROOM_HEIGHT_M], thick).slab(along, [up[1], ROOM_HEIGHT_M], thick);
        if up[0] > 0.0 {
            body = body.slab(along, [0.0, up[0]], thick);
        }
        from = along[1];
    }
    body.slab([from, along[1]], [0.0, ROOM_HEIGHT_M], thick)
}

impl Draft<'_> {
    /// A doorway with a closed door, in a free length of some wall; the light switch beside it. The floor before it, or
    /// none if there is no such length.
    pub fn doorway(&mut self) -> Option<Rectangle> {
        let width = DOOR_WIDTH_M + 2.0 * CASING_M;
        let needed = width + 0.15;
        let spots: Vec<(usize, Span)> = (0..4)
            .flat_map(|wall| self.walls[wall].free().into_iter().map(move |span| (wall, span)))
            .filter(|(_, span)| span[1] - span[0] >= needed)
            .collect();
        if spots.is_empty() {
            return None;
        }
        let (wall, from) = (0..TRIES).find_map(|_| {
            let (wall, span) = spots[self.random.below(spots.len() as u32) as usize];
            // A door stands near a corner more often than in the middle of a wall.
            let slack = span[1] - span[0] - needed;
            let share = [0.0, self.random.uniform(), 1.0][self.random.below(3) as usize];
            let from = span[0] + 0.075 + share * slack + CASING_M;
            let clear = self.walls[wall].frame.block([from, from + DOOR_WIDTH_M], [0.0, 0.0], [0.0, DOOR_SWING_M]);
            let clear = Rectangle::below(clear);
            (!self.floor_plan.occupied.iter().any(|other| other.overlaps(&clear))).then_some((wall, from))
        })?;
        let to = from + DOOR_WIDTH_M;
        let frame = self.walls[wall].frame;
        let knob_up = 1.0;
        let up = [0.0, DOOR_HEIGHT_M];
        let jamb = 0.03;
        let body = Assembly::new(frame)
            .slab([from, from + jamb], up, [-WALL_M, 0.0])
            .slab([to - jamb, to], up, [-WALL_M, 0.0])
            .slab([from + jamb, to - jamb], [DOOR_HEIGHT_M - jamb, DOOR_HEIGHT_M], [-WALL_M, 0.0])
            .slab([from - CASING_M, from], [0.0, DOOR_HEIGHT_M + CASING_M], [0.0, 0.015])
            .slab([to, to + CASING_M], [0.0, DOOR_HEIGHT_M + CASING_M], [0.0, 0.015])
            .slab([from, to], [DOOR_HEIGHT_M, DOOR_HEIGHT_M + CASING_M], [0.0, 0.015])
            .slab([from + jamb, to - jamb], [0.005, DOOR_HEIGHT_M - jamb], [-0.07, -0.03])
            .drum([to - jamb - 0.07, knob_up, -0.03], [to - jamb - 0.07, knob_up, 0.02], 0.012)
            .rod([to - jamb - 0.17, knob_up, 0.02], [to - jamb - 0.07, knob_up, 0.02], 0.010);
        self.fix("Door", body);
        // The handle and the casing stand out a little themselves.
        let clear = frame.block([from, to], [0.0, 0.0], [0.05, DOOR_SWING_M]);
        let clear = Rectangle::below(clear);
        self.floor_plan.kept_clear.push(clear);
        let wall = &mut self.walls[wall];
        wall.openings.push(Opening { along: [from, to], up });
        wall.taken.push([from - CASING_M - 0.04, to + CASING_M + 0.22]);
        // The switch is on the side of the handle, or behind the door where a corner leaves no room.
        let length = wall.length_m;
        let switch = if to + CASING_M + 0.2 < length { to + CASING_M + 0.12 } else { from - CASING_M - 0.12 };
        self.light_switch(frame, switch);
        Some(clear)
    }

    fn light_switch(&mut self, frame: Frame, along: f32) {
        let up = self.random.range(1.15, 1.35);
        let body = Assembly::new(frame).slab([along - 0.04, along + 0.04], [up - 0.06, up + 0.06], [0.0, 0.008]).slab(
            [along - 0.018, along + 0.018],
            [up - 0.035, up + 0.035],
            [0.008, 0.013],
        );
        self.fix("LightSwitch", body);
    }

    /// A window with frame, mullions, pane and sill, and what hangs at it.
    pub fn window(&mut self, wall: usize, along: Span, drapery: Drapery) {
        let wall = &mut self.walls[wall];
        wall.openings.push(Opening { along, up: WINDOW_M });
        wall.taken.push(along);
        let frame = wall.frame;
        let [from, to] = along;
        let [bottom, top] = WINDOW_M;
        let (bar, deep) = (0.05, [-0.13, -0.07]);
        let inner = [from + bar, to - bar];
        let middle = 0.5 * (from + to);
        let mut body = Assembly::new(frame)
            .slab([from, from + bar], WINDOW_M, deep)
            .slab([to - bar, to], WINDOW_M, deep)
            .slab(inner, [bottom, bottom + bar], deep)
            .slab(inner, [top - bar, top], deep)
            .slab(inner, [bottom + bar, top - bar], [-0.106, -0.094])
            .slab([from - 0.03, to + 0.03], [bottom - 0.025, bottom], [-0.07, 0.04]);
        if to - from > 0.8 {
            body = body.slab([middle - 0.025, middle + 0.025], [bottom + bar, top - bar], deep);
        }
        let cross = bottom + 0.62 * (top - bottom);
        if self.random.uniform() < 0.5 {
            body = body.slab(inner, [cross - 0.015, cross + 0.015], [-0.12, -0.08]);
        }
        self.fix("Window", body);
        match drapery {
            Drapery::None => {}
            Drapery::Blinds => self.blinds(frame, along),
            Drapery::Curtains => self.curtains(frame, along),
        }
    }

    fn blinds(&mut self, frame: Frame, along: Span) {
        const SLAT_PITCH_M: f32 = 0.05;
        let top = WINDOW_M[1] + 0.06;
        let lowered = self.random.range(0.2, 0.6) * (WINDOW_M[1] - WINDOW_M[0]);
        let span = [along[0] - 0.02, along[1] + 0.02];
        let mut body = Assembly::new(frame).slab(span, [top - 0.04, top], [0.0, 0.05]);
        let mut at = top - 0.04 - SLAT_PITCH_M;
        while at > WINDOW_M[1] - lowered {
            body = body.slab(span, [at, at + 0.003], [0.008, 0.042]);
            at -= SLAT_PITCH_M;
        }
        let strings = [along[0] + 0.1, along[1] - 0.1];
        for string in strings {
            body = body.slab([string, string + 0.002], [at + SLAT_PITCH_M, top - 0.04], [0.024, 0.026]);
        }
        self.fix("Blinds", body);
    }

    fn curtains(&mut self, frame: Frame, along: Span) {
        const FOLD_M: f32 = 0.028;
        let top = WINDOW_M[1] + 0.12;
        let out = 0.06;
        let mut body = Assembly::new(frame).rod([along[0] - 0.12, top, out], [along[1] + 0.12, top, out], 0.010);
        for (start, step) in [(along[0] - 0.08, 1.6 * FOLD_M), (along[1] + 0.08, -1.6 * FOLD_M)] {
            for fold in 0..5 {
                let at = start + fold as f32 * step;
                body = body.drum([at, WINDOW_M[0] + 0.05, out], [at, top - 0.012, out], FOLD_M);
            }
        }
        self.fix("Curtains", body);
    }
}
