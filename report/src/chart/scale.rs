//! From numbers to places on an axis, and which of them are written there.

/// What an axis counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Whole things, thousands as k, millions as M.
    Count,
    /// Shares 0..=1, written as percentages.
    Percent,
    /// Any number.
    Number,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it is, with its unit.
    pub label: String,
    /// How its ticks are written.
    pub unit: Unit,
    /// Logarithmic instead of linear.
    pub logarithmic: bool,
    /// Begins at zero whatever the data.
    pub from_zero: bool,
    /// Lowest and highest value that have to have a place on it, besides those that are drawn.
    pub reach: Option<(f64, f64)>,
}

impl Axis {
    /// A linear axis from zero.
    pub fn new(label: &str, unit: Unit) -> Self {
        Self { label: label.to_owned(), unit, logarithmic: false, from_zero: true, reach: None }
    }

    /// A linear axis over the range of the data.
    pub fn free(label: &str, unit: Unit) -> Self {
        Self { from_zero: false, ..Self::new(label, unit) }
    }

    /// A logarithmic axis over the range of the data.
    pub fn logarithmic(label: &str, unit: Unit) -> Self {
        Self { logarithmic: true, from_zero: false, ..Self::new(label, unit) }
    }

    /// The lowest and the highest of these values that the axis can show; none where it can show none.
    pub(super) fn range(&self, values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
        values
            .filter(|value| value.is_finite() && (!self.logarithmic || *value > 0.0))
            .map(|value| (value, value))
            .reduce(|(low, high), (value, _)| (low.min(value), high.max(value)))
    }

    /// The scale that holds all `values`. `tight`: ends at the last value instead of at the next tick.
    pub fn scale(&self, values: impl Iterator<Item = f64>, tight: bool) -> Scale {
        let reach = self.reach.into_iter().flat_map(|(low, high)| [low, high]);
        let nothing = if self.logarithmic { (1.0, 10.0) } else { (0.0, 1.0) };
        let (mut low, mut high) = self.range(values.chain(reach)).unwrap_or(nothing);
        if self.logarithmic {
            return Scale::logarithmic(low, high, self.unit);
        }
        if self.from_zero {
            low = low.min(0.0);
            high = high.max(0.0);
        }
        if high - low < 1e-9 * high.abs().max(1e-3) {
            // Nothing varies: room on both sides, or above zero.
            let room = if high == 0.0 { 1.0 } else { high.abs() * 0.1 };
            high += room;
            low -= if self.from_zero && low == 0.0 { 0.0 } else { room };
        }
        Scale::linear(low, high, self.unit, tight)
    }
}

/// An axis fitted to its data.
#[derive(Debug, Clone, PartialEq)]
pub struct Scale {
    low: f64,
    high: f64,
    logarithmic: bool,
    ticks: Vec<(f64, String)>,
}

impl Scale {
    fn linear(low: f64, high: f64, unit: Unit, tight: bool) -> Self {
        let step = nice((high - low) / 5.0);
        let first = if tight { (low / step - 1e-9).ceil() } else { (low / step + 1e-9).floor() };
        let last = if tight { (high / step + 1e-9).floor() } else { (high / step - 1e-9).ceil() };
        let count = (last - first).round() as usize;
        let ticks: Vec<f64> = (0..=count).map(|i| (first + i as f64) * step).collect();
        let (low, high) = if tight { (low, high) } else { (first * step, last * step) };
        let ticks = ticks.into_iter().map(|tick| (tick, write(tick, step, unit))).collect();
        Self { low, high, logarithmic: false, ticks }
    }

    fn logarithmic(low: f64, high: f64, unit: Unit) -> Self {
        let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
        let inside = |tick: &f64| *tick >= low * (1.0 - 1e-9) && *tick <= high * (1.0 + 1e-9);
        let mut ticks: Vec<f64> = (first..=last).map(|power| 10f64.powi(power)).filter(inside).collect();
        if ticks.len() < 2 {
            ticks = vec![low, high];
        }
        let high = if high > low { high } else { low * 10.0 };
        let ticks = ticks.into_iter().map(|tick| (tick, write(tick, tick, unit))).collect();
        Self { low, high, logarithmic: true, ticks }
    }

    /// Place of a value: 0 at the lower end, 1 at the upper.
    pub fn place(&self, value: f64) -> f64 {
        if self.logarithmic {
            let value = value.max(self.low);
            (value / self.low).log10() / (self.high / self.low).log10()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// Values that are written on the axis.
    pub fn ticks(&self) -> &[(f64, String)] {
        &self.ticks
    }
}

/// The smallest 1, 2 or 5 times a power of ten that is not below `step`.
fn nice(step: f64) -> f64 {
    let power = 10f64.powf(step.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|factor| factor * power >= step * (1.0 - 1e-9)).unwrap_or(10.0);
    factor * power
}

/// A value with as many decimals as its step needs.
fn write(value: f64, step: f64, unit: Unit) -> String {
    let (value, step, suffix) = match unit {
        Unit::Percent => (value * 100.0, step * 100.0, "%"),
        Unit::Count if step >= 1e6 || value.abs() >= 1e6 => (value / 1e6, step / 1e6, "M"),
        Unit::Count if step >= 1e3 || value.abs() >= 1e4 => (value / 1e3, step / 1e3, "k"),
        Unit::Count | Unit::Number => (value, step, ""),
    };
    // 1e-9: a step of 0.1 has a logarithm just above -1.
    let decimals = (-(step.log10() + 1e-9).floor()).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    if value == 0.0 { format!("0{}", if suffix == "%" { suffix } else { "" }) } else { format!("{text}{suffix}") }
        .replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn labels(scale: &Scale) -> Vec<&str> {
        scale.ticks().iter().map(|(_, label)| label.as_str()).collect()
    }

    #[test]
    fn ticks_are_round() {
        let frames = Axis::new("frames", Unit::Count).scale([0.0, 45e6].into_iter(), true);
        assert_eq!(labels(&frames), ["0", "10M", "20M", "30M", "40M"]);
        assert_eq!(frames.place(45e6), 1.0);
        let small = Axis::new("frames", Unit::Count).scale([0.0, 360_000.0].into_iter(), true);
        assert_eq!(labels(&small), ["0", "100k", "200k", "300k"]);
        let rate = Axis::new("success", Unit::Percent).scale([0.03, 0.471].into_iter(), false);
        assert_eq!(labels(&rate), ["0%", "10%", "20%", "30%", "40%", "50%"]);
        let mixed = Axis::free("return", Unit::Number).scale([-0.42, 1.98].into_iter(), false);
        assert_eq!(labels(&mixed), ["−0.5", "0", "0.5", "1.0", "1.5", "2.0"]);
        let metres = Axis::logarithmic("threshold", Unit::Number).scale([0.001, 10.0].into_iter(), true);
        assert_eq!(labels(&metres), ["0.001", "0.01", "0.1", "1", "10"]);
        assert_eq!(metres.place(0.1), 0.5);
    }

    #[test]
    fn nothing_at_all_and_nothing_that_varies_have_a_scale() {
        for values in [vec![], vec![0.0], vec![3.0, 3.0], vec![f64::NAN]] {
            for axis in
                [Axis::new("a", Unit::Number), Axis::free("a", Unit::Number), Axis::logarithmic("a", Unit::Number)]
            {
                let scale = axis.scale(values.iter().copied(), false);
                assert!(scale.place(3.0).is_finite() && scale.ticks().len() > 1, "{axis:?} {values:?} {scale:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn every_value_has_its_place_on_a_loose_axis(values in prop::collection::vec(-1e6f64..1e6, 1..20)) {
            let scale = Axis::free("a", Unit::Number).scale(values.iter().copied(), false);
            for value in values {
                prop_assert!((-1e-9..=1.0 + 1e-9).contains(&scale.place(value)));
            }
            prop_assert!((3..=12).contains(&scale.ticks().len()), "{:?}", scale.ticks());
        }
    }
}
