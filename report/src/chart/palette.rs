//! Colours that stay apart for colour-blind readers and in grey: the eight of Okabe and Ito (2008) for lines, with
//! dashes and markers that differ too, and cividis (Nuñez, Anderton and Renslow 2018) for heat maps.

use super::svg::{Canvas, Stroke};

/// Okabe and Ito's, the yellow left out, which is too pale for lines.
const COLOURS: [&str; 7] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];
/// The same for a dark page, as the pages of `orchestrator view` have them.
const DARK: [&str; 7] = ["#4aa8e0", "#f0884a", "#35c79a", "#e09cc4", "#f0b93a", "#9fd4f4", "#e6e4df"];
const DASHES: [&str; 3] = ["", "7 3", "2 2.5"];

/// Styles from here on are of measures, not of groups: no colour of a group, so that one colour is one group wherever
/// it is seen.
pub const MEASURES: usize = usize::MAX - DASHES.len();
/// Colour of measures, on a light page and on a dark one.
const MEASURE: (&str, &str) = ("#4d5561", "#b4bac2");

/// Cividis at eighths of its range.
const CIVIDIS: [[f64; 3]; 9] = [
    [0.0, 34.0, 78.0],
    [26.0, 56.0, 111.0],
    [67.0, 78.0, 108.0],
    [97.0, 101.0, 111.0],
    [125.0, 124.0, 120.0],
    [155.0, 148.0, 118.0],
    [188.0, 174.0, 108.0],
    [222.0, 201.0, 88.0],
    [254.0, 232.0, 56.0],
];

/// Styles that can be distinguished in one figure.
pub const STYLES: usize = COLOURS.len();

/// How one of several curves is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Style {
    index: usize,
}

impl Style {
    /// The style with this number; they repeat only after 21.
    pub fn of(index: usize) -> Self {
        Self { index }
    }

    /// CSS colour.
    pub fn colour(self) -> &'static str {
        if self.index >= MEASURES { MEASURE.0 } else { COLOURS[self.index % COLOURS.len()] }
    }

    /// Its line.
    pub fn stroke(self) -> Stroke<'static> {
        let dashes = self.index.checked_sub(MEASURES).unwrap_or(self.index / COLOURS.len());
        Stroke { colour: self.colour(), width: 2.0, dashes: DASHES[dashes % DASHES.len()] }
    }

    /// Outline of its marker around the origin, pixels.
    pub fn marker(self) -> Vec<(f64, f64)> {
        match self.index % 5 {
            0 => polygon(12, 3.4, 0.0),
            1 => polygon(4, 4.4, std::f64::consts::FRAC_PI_4),
            2 => polygon(3, 4.8, -std::f64::consts::FRAC_PI_2),
            3 => polygon(4, 4.6, 0.0),
            _ => polygon(3, 4.8, std::f64::consts::FRAC_PI_2),
        }
    }

    /// A piece of its line with its marker, 28 pixels wide, for a legend.
    pub fn key(self, canvas: &mut Canvas, left: f64, middle: f64) {
        canvas.line(&[(left, middle), (left + 28.0, middle)], self.stroke());
        canvas.shape(&self.marker(), (left + 14.0, middle), self.colour(), self.colour());
    }
}

/// Every colour of curves, and what it is on a dark page.
pub fn in_the_dark() -> impl Iterator<Item = (&'static str, &'static str)> {
    COLOURS.into_iter().zip(DARK).chain([MEASURE])
}

fn polygon(corners: u32, radius: f64, first_rad: f64) -> Vec<(f64, f64)> {
    (0..corners)
        .map(|corner| {
            let angle_rad = first_rad + std::f64::consts::TAU * f64::from(corner) / f64::from(corners);
            (radius * angle_rad.cos(), radius * angle_rad.sin())
        })
        .collect()
}

/// Colour of a share 0..=1, dark for little.
pub fn heat(share: f64) -> String {
    let place = share.clamp(0.0, 1.0) * (CIVIDIS.len() - 1) as f64;
    let below = (place as usize).min(CIVIDIS.len() - 2);
    let t = place - below as f64;
    let [r, g, b] =
        std::array::from_fn(|i| (CIVIDIS[below][i] + (CIVIDIS[below + 1][i] - CIVIDIS[below][i]) * t).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twenty_one_styles_differ() {
        let all: std::collections::HashSet<_> =
            (0..21).map(|index| (Style::of(index).colour(), Style::of(index).stroke().dashes)).collect();
        assert_eq!(all.len(), 21);
    }

    #[test]
    fn no_measure_looks_like_a_group() {
        let groups: Vec<&str> = (0..50).map(|index| Style::of(index).colour()).collect();
        let measures = [MEASURES, MEASURES + 1].map(Style::of);
        assert!(measures.iter().all(|measure| !groups.contains(&measure.colour())));
        assert_ne!(measures[0].stroke().dashes, measures[1].stroke().dashes);
        let dark: std::collections::HashSet<_> = in_the_dark().map(|(_, dark)| dark).collect();
        assert_eq!(dark.len(), 8, "what differs on a light page differs on a dark one");
    }

    #[test]
    fn more_heat_is_brighter() {
        let luminance = |share: f64| {
            let text = heat(share);
            let part = |at: usize| f64::from(u8::from_str_radix(&text[at..at + 2], 16).unwrap());
            0.2126 * part(1) + 0.7152 * part(3) + 0.0722 * part(5)
        };
        for step in 0..50 {
            assert!(luminance(f64::from(step) / 50.0) < luminance(f64::from(step + 1) / 50.0), "{step}");
        }
        assert_eq!(heat(-1.0), "#00224e");
        assert_eq!(heat(2.0), "#fee838");
    }
}
