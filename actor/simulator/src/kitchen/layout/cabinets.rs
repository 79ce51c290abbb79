//! Cabinets and drawers, below the counter and on the wall: carcass, toe kick, fronts with gaps, handles or knobs.

use super::draft::Draft;
use super::frame::{Assembly, Frame, Span};

/// Depth of a base cabinet without and with its front, metres.
const CARCASS_DEPTH_M: f32 = 0.56;
pub(super) const FRONT_DEPTH_M: f32 = 0.58;
/// Depth of a toe kick's face, metres.
const TOE_DEPTH_M: f32 = 0.50;
const GAP_M: f32 = 0.003;
/// Depth of a wall cabinet's carcass; its door lies before it, metres.
pub(super) const WALL_CABINET_DEPTH_M: f32 = 0.33;
const DOOR_M: f32 = 0.02;
/// Wider openings have two doors, metres.
const DOOR_WIDEST_M: f32 = 0.56;
const WALL_CABINET_WIDEST_M: f32 = 1.05;
/// Narrowest, metres; what is narrower stays open wall.
const WALL_CABINET_NARROWEST_M: f32 = 0.22;
/// Height of a top drawer's front, metres.
const DRAWER_M: f32 = 0.16;

#[derive(Debug, Clone, Copy)]
enum Grip {
    Across,
    /// Upright at the left or right edge, high up (base cabinets) or low down (wall cabinets).
    Upright {
        right: bool,
        high: bool,
    },
}

impl Draft<'_> {
    /// A base cabinet: doors, or a drawer over doors, or a stack of drawers.
    pub fn cabinet_below(&mut self, frame: Frame, along: Span) {
        let top = self.style.counter_height_m - self.style.slab_m;
        let toe = self.style.toe_kick_m;
        let mut body = Assembly::new(frame).slab(along, [0.0, toe], [0.0, TOE_DEPTH_M]).slab(
            along,
            [toe, top],
            [0.0, CARCASS_DEPTH_M],
        );
        let front = [toe, top - 0.01];
        let stack = self.drawers >= 3 && self.random.uniform() < 0.6;
        if stack {
            self.drawers -= 3;
            let below = 0.5 * (front[1] - DRAWER_M - front[0]);
            let (low, middle) = (front[0] + below, front[0] + 2.0 * below);
            self.fix("DrawerUnit", body);
            for up in [[front[0], low], [low, middle], [middle, front[1]]] {
                self.drawer(frame, along, up);
            }
            return;
        }
        let mut door_top = front[1];
        if self.drawers > 0 {
            self.drawers -= 1;
            door_top -= DRAWER_M;
            self.drawer(frame, along, [door_top, front[1]]);
        }
        body = self.doors(body, along, [front[0], door_top], CARCASS_DEPTH_M, true);
        self.fix("Cabinet", body);
    }

    /// The cabinet in a corner, which two runs cover: only a filler beside the other run shows.
    pub fn corner_below(&mut self, frame: Frame, along: Span) {
        let top = self.style.counter_height_m - self.style.slab_m;
        let toe = self.style.toe_kick_m;
        let body = Assembly::new(frame).slab(along, [0.0, toe], [0.0, TOE_DEPTH_M]).slab(
            along,
            [toe, top],
            [0.0, FRONT_DEPTH_M],
        );
        self.fix("CornerUnit", body);
    }

    /// A blind panel that closes a narrow rest of a run.
    pub fn filler(&mut self, frame: Frame, along: Span) {
        let top = self.style.counter_height_m - self.style.slab_m;
        self.fix("Filler", Assembly::new(frame).slab(along, [0.0, top], [0.0, FRONT_DEPTH_M]));
    }

    /// The low cabinet below a sink's basin: doors before, pipes behind.
    pub fn cabinet_below_sink(&mut self, frame: Frame, along: Span, basin_bottom: f32) {
        let top = self.style.counter_height_m - self.style.slab_m;
        let toe = self.style.toe_kick_m;
        let body = Assembly::new(frame)
            .slab(along, [0.0, toe], [0.0, TOE_DEPTH_M])
            .slab(along, [toe, basin_bottom - 0.02], [0.0, CARCASS_DEPTH_M])
            .slab(along, [basin_bottom - 0.02, top], [CARCASS_DEPTH_M - 0.015, CARCASS_DEPTH_M]);
        let body = self.doors(body, along, [toe, top - 0.01], CARCASS_DEPTH_M, true);
        self.fix("Cabinet", body);
    }

    /// Wall cabinets that fill a length, evenly.
    pub fn cabinets_above(&mut self, frame: Frame, along: Span) {
        let length = along[1] - along[0];
        if length < WALL_CABINET_NARROWEST_M {
            return;
        }
        let count = libm::ceilf(length / WALL_CABINET_WIDEST_M);
        let width = length / count;
        for index in 0..count as u32 {
            let from = along[0] + index as f32 * width;
            self.cabinet_above(frame, [from, from + width], self.style.wall_cabinet_m, WALL_CABINET_DEPTH_M);
        }
    }

    pub fn cabinet_above(&mut self, frame: Frame, along: Span, up: Span, depth: f32) {
        let body = Assembly::new(frame).slab(along, up, [0.0, depth]);
        let body = self.doors(body, along, up, depth, false);
        self.fix("Cabinet", body);
    }

    fn doors(&self, mut body: Assembly, along: Span, up: Span, depth: f32, high: bool) -> Assembly {
        let middle = 0.5 * (along[0] + along[1]);
        let leaves = if along[1] - along[0] > DOOR_WIDEST_M {
            vec![([along[0], middle], true), ([middle, along[1]], false)]
        } else {
            vec![(along, true)]
        };
        for (leaf, right) in leaves {
            body = self.front(body, leaf, up, depth, Grip::Upright { right, high });
        }
        body
    }

    fn drawer(&mut self, frame: Frame, along: Span, up: Span) {
        let body = self.front(Assembly::new(frame), along, up, CARCASS_DEPTH_M, Grip::Across);
        self.fix("Drawer", body);
    }

    fn front(&self, body: Assembly, along: Span, up: Span, depth: f32, grip: Grip) -> Assembly {
        let face = depth + DOOR_M;
        let panel = body.slab([along[0] + GAP_M, along[1] - GAP_M], [up[0] + GAP_M, up[1] - GAP_M], [depth, face]);
        let (middle, mid_up) = (0.5 * (along[0] + along[1]), 0.5 * (up[0] + up[1]));
        let (at, bar_up, bar_along) = match grip {
            Grip::Across => {
                let half = (0.5 * (along[1] - along[0]) - 0.05).clamp(0.03, 0.08);
                ([middle, mid_up], [mid_up, mid_up], [middle - half, middle + half])
            }
            Grip::Upright { right, high } => {
                let edge = if right { along[1] - 0.045 } else { along[0] + 0.045 };
                let length = (up[1] - up[0] - 0.1).clamp(0.06, 0.14);
                let from = if high { up[1] - 0.04 - length } else { up[0] + 0.04 };
                ([edge, from + 0.5 * length], [from, from + length], [edge, edge])
            }
        };
        if self.style.knobs {
            let knob = face + 0.022;
            return panel.drum([at[0], at[1], face], [at[0], at[1], knob], 0.006).drum(
                [at[0], at[1], knob],
                [at[0], at[1], knob + 0.01],
                0.016,
            );
        }
        let bar = face + 0.026;
        let ends = [[bar_along[0], bar_up[0]], [bar_along[1], bar_up[1]]];
        let posts = [0.12, 0.88].map(|t| [0, 1].map(|axis| ends[0][axis] + t * (ends[1][axis] - ends[0][axis])));
        let mut panel = panel.drum([ends[0][0], ends[0][1], bar], [ends[1][0], ends[1][1], bar], 0.006);
        for [along, up] in posts {
            panel = panel.drum([along, up, face], [along, up, bar], 0.005);
        }
        panel
    }
}
