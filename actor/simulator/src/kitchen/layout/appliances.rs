use super::cabinets::{FRONT_DEPTH_M, WALL_CABINET_DEPTH_M};
use super::draft::{Draft, Worktop, WorktopKind};
use super::frame::{Assembly, Frame, Span};
use super::run::{BASIN_OUT_M, BASIN_SIDE_M, COUNTER_DEPTH_M};
use crate::kitchen::room::Surface;

const BASIN_DEPTH_M: f32 = 0.17;
/// Depth of a fridge without its handles, metres.
pub(super) const FRIDGE_DEPTH_M: f32 = 0.68;
/// Radius of a burner and height of its plate above the counter's top, metres.
const BURNER_RADIUS_M: f32 = 0.095;
pub(super) const GRATE_M: f32 = 0.022;
const MICROWAVE_M: [f32; 3] = [0.50, 0.29, 0.38];

impl Draft<'_> {
    /// A sink: rim and basin in the counter's hole, faucet behind, cabinet below.
    pub fn sink(&mut self, frame: Frame, along: Span) {
        const STEEL_M: f32 = 0.008;
        const RIM_M: f32 = 0.018;
        let top = self.style.counter_height_m;
        let bottom = top - BASIN_DEPTH_M;
        let inner = [along[0] + BASIN_SIDE_M, along[1] - BASIN_SIDE_M];
        let [back, front] = BASIN_OUT_M;
        let rim = [top, top + 0.004];
        let sink = Assembly::new(frame)
            .slab([inner[0] - RIM_M, inner[1] + RIM_M], rim, [back - RIM_M, back])
            .slab([inner[0] - RIM_M, inner[1] + RIM_M], rim, [front, front + RIM_M])
            .slab([inner[0] - RIM_M, inner[0]], rim, [back, front])
            .slab([inner[1], inner[1] + RIM_M], rim, [back, front]);
        self.fix("Sink", sink);
        let up = [bottom, top];
        let middle = 0.5 * (along[0] + along[1]);
        let basin = Assembly::new(frame)
            .slab(inner, [bottom - STEEL_M, bottom], [back, front])
            .slab([inner[0], inner[0] + STEEL_M], up, [back, front])
            .slab([inner[1] - STEEL_M, inner[1]], up, [back, front])
            .slab([inner[0] + STEEL_M, inner[1] - STEEL_M], up, [back, back + STEEL_M])
            .slab([inner[0] + STEEL_M, inner[1] - STEEL_M], up, [front - STEEL_M, front]);
        self.fix("SinkBasin", basin);
        let (low, high) = frame.block(
            [inner[0] + STEEL_M, inner[1] - STEEL_M],
            [bottom, top + 0.25],
            [back + STEEL_M, front - STEEL_M],
        );
        let surface = Surface { low, high };
        self.worktops.push(Worktop { surface, kind: WorktopKind::Basin, back: Some(-frame.out) });
        self.sink = Some(frame.at(middle, top, 0.5 * (back + front)));
        self.cabinet_below_sink(frame, along, bottom - STEEL_M);
        self.faucet(frame, middle);
    }

    fn faucet(&mut self, frame: Frame, along: f32) {
        let top = self.style.counter_height_m;
        let rise = self.random.range(0.24, 0.32);
        let reach = self.random.range(0.24, 0.30);
        let out = 0.075;
        let body = Assembly::new(frame)
            .drum([along, top, out], [along, top + 0.03, out], 0.024)
            .rod([along, top + 0.03, out], [along, top + rise, out], 0.013)
            .rod([along, top + rise, out], [along, top + rise, reach], 0.012)
            .rod([along, top + rise - 0.06, reach], [along, top + rise, reach], 0.012)
            .rod([along, top + 0.10, out], [along + 0.075, top + 0.10, out], 0.008);
        self.fix("Faucet", body);
    }

    /// A range: oven below, burners on top, knobs on the front.
    pub fn stove(&mut self, frame: Frame, along: Span) {
        let top = self.style.counter_height_m;
        let face = COUNTER_DEPTH_M;
        let panel = top - 0.09;
        let toe = 0.08;
        let bar = [along[0] + 0.08, along[1] - 0.08];
        let oven = Assembly::new(frame)
            .slab(along, [0.0, toe], [0.0, face - 0.08])
            .slab(along, [toe, top], [0.0, face - 0.03])
            .slab([along[0] + 0.005, along[1] - 0.005], [toe + 0.01, toe + 0.16], [face - 0.03, face])
            .slab([along[0] + 0.005, along[1] - 0.005], [toe + 0.17, panel - 0.01], [face - 0.03, face])
            .slab(along, [panel, top], [face - 0.03, face])
            .slab(along, [top, top + 0.05], [0.0, 0.03])
            .drum([bar[0], panel - 0.05, face + 0.035], [bar[1], panel - 0.05, face + 0.035], 0.009)
            .drum([bar[0] + 0.03, panel - 0.05, face], [bar[0] + 0.03, panel - 0.05, face + 0.035], 0.007)
            .drum([bar[1] - 0.03, panel - 0.05, face], [bar[1] - 0.03, panel - 0.05, face + 0.035], 0.007);
        self.fix("StoveOven", oven);
        let middle = 0.5 * (along[0] + along[1]);
        let corners = [[-0.15, 0.19], [0.15, 0.19], [-0.15, 0.46], [0.15, 0.46], [0.0, 0.325]];
        for &[aside, out] in &corners[..self.burner_count as usize] {
            let radius = if out == 0.325 { 0.05 } else { BURNER_RADIUS_M };
            let [x, z] = [middle + aside, out];
            // One thick plate: a pan's thin floor would sink in between bars.
            let burner = Assembly::new(frame).drum([x, top, z], [x, top + 0.006, z], radius).drum(
                [x, top, z],
                [x, top + GRATE_M, z],
                0.93 * radius,
            );
            self.fix("StoveBurner", burner);
            if radius == BURNER_RADIUS_M {
                self.burners.push(frame.at(x, top + GRATE_M, z));
            }
        }
        for knob in 0..self.burner_count {
            let share = (knob as f32 + 0.5) / self.burner_count as f32;
            let x = along[0] + 0.06 + share * (along[1] - along[0] - 0.12);
            let up = 0.5 * (panel + top);
            let body = Assembly::new(frame).drum([x, up, face], [x, up, face + 0.006], 0.026).drum(
                [x, up, face + 0.006],
                [x, up, face + 0.03],
                0.019,
            );
            self.fix("StoveKnob", body);
        }
    }

    /// A fridge with the freezer below or above: two doors with bars.
    pub fn fridge(&mut self, frame: Frame, along: Span) {
        let height = self.random.range(1.72, 1.84);
        let split = if self.random.uniform() < 0.5 { 0.66 } else { height - 0.55 };
        let [from, to] = [along[0] + 0.01, along[1] - 0.01];
        let (body_depth, face) = (FRIDGE_DEPTH_M - 0.06, FRIDGE_DEPTH_M);
        let bar = face + 0.04;
        let mut fridge = Assembly::new(frame)
            .slab([from, to], [0.0, 0.04], [0.02, body_depth - 0.04])
            .slab([from, to], [0.04, height], [0.02, body_depth])
            .slab([from, to], [0.05, split - 0.004], [body_depth, face])
            .slab([from, to], [split + 0.004, height], [body_depth, face]);
        let low = [(split - 0.5).max(0.15), split - 0.06];
        let high = [split + 0.06, (split + 0.6).min(height - 0.1)];
        for [bottom, top] in [low, high] {
            fridge = fridge
                .drum([to - 0.05, bottom, bar], [to - 0.05, top, bar], 0.010)
                .drum([to - 0.05, bottom + 0.04, face], [to - 0.05, bottom + 0.04, bar], 0.008)
                .drum([to - 0.05, top - 0.04, face], [to - 0.05, top - 0.04, bar], 0.008);
        }
        self.fix("Fridge", fridge);
        if self.random.uniform() < 0.5 {
            return;
        }
        let up = [height + 0.06, self.style.wall_cabinet_m[1].max(height + 0.36)];
        self.cabinet_above(frame, along, up, COUNTER_DEPTH_M - 0.06);
    }

    pub fn dishwasher(&mut self, frame: Frame, along: Span) {
        let top = self.style.counter_height_m - self.style.slab_m;
        let toe = self.style.toe_kick_m;
        let (depth, face) = (FRONT_DEPTH_M - 0.03, FRONT_DEPTH_M);
        let bar = [along[0] + 0.08, along[1] - 0.08];
        let body = Assembly::new(frame)
            .slab(along, [0.0, toe], [0.0, 0.5])
            .slab(along, [toe, top], [0.0, depth])
            .slab([along[0] + 0.004, along[1] - 0.004], [toe, top - 0.13], [depth, face])
            .slab([along[0] + 0.004, along[1] - 0.004], [top - 0.125, top - 0.01], [depth, face])
            .drum([bar[0], top - 0.16, face + 0.03], [bar[1], top - 0.16, face + 0.03], 0.009)
            .drum([bar[0] + 0.02, top - 0.16, face], [bar[0] + 0.02, top - 0.16, face + 0.03], 0.007)
            .drum([bar[1] - 0.02, top - 0.16, face], [bar[1] - 0.02, top - 0.16, face + 0.03], 0.007);
        self.fix("Dishwasher", body);
    }

    pub fn above_stove(&mut self, frame: Frame, along: Span, microwave: bool) {
        let [bottom, top] = self.style.wall_cabinet_m;
        if microwave {
            let split = (bottom + 0.40).min(top - 0.22);
            self.microwave(frame, along, [bottom, split], [0.0, 0.38]);
            self.cabinet_above(frame, along, [split, top], WALL_CABINET_DEPTH_M);
            return;
        }
        let middle = 0.5 * (along[0] + along[1]);
        let lower = bottom + 0.08;
        let hood = Assembly::new(frame)
            .slab(along, [lower, lower + 0.06], [0.0, 0.48])
            .slab([along[0] + 0.08, along[1] - 0.08], [lower + 0.06, lower + 0.13], [0.0, 0.36])
            .slab([middle - 0.15, middle + 0.15], [lower + 0.13, 2.55], [0.0, 0.26]);
        self.fix("RangeHood", hood);
    }

    /// A microwave on a counter, where its left side is at `from`.
    pub fn microwave_on_counter(&mut self, frame: Frame, from: f32) {
        let top = self.style.counter_height_m;
        let [width, height, depth] = MICROWAVE_M;
        self.microwave(frame, [from, from + width], [top, top + height], [0.04, 0.04 + depth]);
    }

    fn microwave(&mut self, frame: Frame, along: Span, up: Span, out: Span) {
        let face = out[1];
        let door = along[1] - 0.13;
        let body = Assembly::new(frame)
            .slab(along, [up[0] + 0.008, up[1]], [out[0], face - 0.03])
            .slab([along[0] + 0.02, along[1] - 0.02], [up[0], up[0] + 0.008], [out[0] + 0.03, face - 0.06])
            .slab([along[0], door - 0.003], [up[0] + 0.01, up[1] - 0.003], [face - 0.03, face])
            .slab([door, along[1]], [up[0] + 0.01, up[1] - 0.003], [face - 0.03, face - 0.004])
            .drum([door - 0.035, up[0] + 0.06, face + 0.03], [door - 0.035, up[1] - 0.05, face + 0.03], 0.008)
            .drum([door - 0.035, up[0] + 0.08, face], [door - 0.035, up[0] + 0.08, face + 0.03], 0.006)
            .drum([door - 0.035, up[1] - 0.07, face], [door - 0.035, up[1] - 0.07, face + 0.03], 0.006)
            .drum([door + 0.065, up[0] + 0.07, face - 0.004], [door + 0.065, up[0] + 0.07, face + 0.012], 0.022);
        self.fix("Microwave", body);
    }
}

pub(super) const MICROWAVE_WIDTH_M: f32 = MICROWAVE_M[0];
