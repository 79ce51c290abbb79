//! A matrix as colours on a logarithmic scale, with a bar that explains them. Shares of actions differ by orders
//! of magnitude: on a linear scale nearly all of a map is dark.

use super::palette::heat;
use super::place::{LABEL, Rect};
use super::scale::{Axis, Unit};
use super::svg::{AXIS, Anchor, BLANK, Canvas, Stroke};
use super::text;

/// Shares by row and column.
#[derive(Debug, Clone)]
pub struct HeatMap {
    /// Under the columns.
    pub x_label: String,
    /// Beside the bar.
    pub scale_label: String,
    /// Names of the rows, from the top.
    pub rows: Vec<String>,
    /// \[rows\]\[columns\] shares 0..=1; none where nothing can be said.
    pub values: Vec<Vec<Option<f64>>>,
}

const BAR_STEPS: u32 = 64;
/// Shares from here down have the darkest colour.
const LEAST: f64 = 0.001;

impl HeatMap {
    /// Height of a map of this many rows, pixels.
    pub fn height(rows: usize) -> f64 {
        rows as f64 * 15.0 + 70.0
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, rect: Rect) {
        let size = LABEL - 1.0;
        let names = self.rows.iter().map(|name| text::width(name, size)).fold(0.0, f64::max);
        let plot = Rect {
            left: rect.left + names + 10.0,
            top: rect.top + 2.0,
            width: rect.width - names - 10.0 - 92.0,
            height: rect.height - 2.0 - 38.0,
        };
        let columns = self.values.iter().map(Vec::len).max().unwrap_or(0).max(1);
        // The same for every map, so that colours mean the same on all of them.
        let scale = Axis::logarithmic(&self.scale_label, Unit::Percent).scale([LEAST, 1.0].into_iter(), true);
        // In steps: neighbours of nearly one share have one colour.
        let place = |value: f64| (scale.place(value) * f64::from(BAR_STEPS)).round() / f64::from(BAR_STEPS);
        let (cell_width, cell_height) = (plot.width / columns as f64, plot.height / self.rows.len().max(1) as f64);
        canvas.rectangle((plot.left, plot.top), (plot.width, plot.height), BLANK);
        for (row, (name, values)) in self.rows.iter().zip(&self.values).enumerate() {
            let top = plot.top + row as f64 * cell_height;
            canvas.text(plot.left - 6.0, top + cell_height / 2.0 + 4.0, size, Anchor::End, name);
            let mut column = 0;
            while column < values.len() {
                // Neighbours of one colour are one rectangle: the file is a fraction of the size.
                let Some(colour) = values[column].map(|value| heat(place(value))) else {
                    column += 1;
                    continue;
                };
                let same = |value: &Option<f64>| value.map(|value| heat(place(value))).as_ref() == Some(&colour);
                let length = values[column..].iter().take_while(|value| same(value)).count();
                let left = plot.left + column as f64 * cell_width;
                // A hair wider than it is: no seams between cells.
                canvas.rectangle((left, top), (length as f64 * cell_width + 0.3, cell_height + 0.3), &colour);
                column += length;
            }
        }
        let axis = Stroke { colour: AXIS, width: 1.0, dashes: "" };
        let across = Axis::new(&self.x_label, Unit::Count).scale([columns as f64].into_iter(), true);
        for (tick, label) in across.ticks() {
            let x = plot.left + across.place(*tick) * plot.width;
            canvas.line(&[(x, plot.bottom()), (x, plot.bottom() + 4.0)], axis);
            canvas.text(x, plot.bottom() + 17.0, LABEL, Anchor::Middle, label);
        }
        canvas.text(plot.left + plot.width / 2.0, plot.bottom() + 34.0, LABEL, Anchor::Middle, &self.x_label);

        let bar = Rect { left: plot.right() + 18.0, width: 14.0, ..plot };
        let step = bar.height / f64::from(BAR_STEPS);
        for level in 0..BAR_STEPS {
            let share = (f64::from(level) + 0.5) / f64::from(BAR_STEPS);
            let top = bar.bottom() - f64::from(level + 1) * step;
            canvas.rectangle((bar.left, top), (bar.width, step + 0.3), &heat(share));
        }
        for (tick, label) in scale.ticks() {
            let height = bar.bottom() - scale.place(*tick) * bar.height;
            canvas.text(bar.right() + 4.0, height + 4.0, size, Anchor::Start, label);
        }
        let middle = bar.top + bar.height / 2.0;
        canvas.rotated_text(rect.right() - 3.0, middle, size, Anchor::Middle, -90.0, &self.scale_label);
    }
}
