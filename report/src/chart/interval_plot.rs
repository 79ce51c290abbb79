//! Points with their intervals, one row each, over a common axis: what rliable's interval plots show.

use super::palette::Style;
use super::place::{LABEL, Rect};
use super::scale::Axis;
use super::svg::{AXIS, Anchor, Canvas, GRID, PAPER, Stroke};
use super::text;

#[derive(Debug, Clone)]
pub struct IntervalRow {
    /// Name at the left.
    pub name: String,
    pub style: usize,
    /// The figure.
    pub point: Option<f64>,
    pub interval: Option<(f64, f64)>,
    /// A published figure to compare with, an open diamond.
    pub published: Option<f64>,
}

/// Rows over a common axis of shares.
#[derive(Debug, Clone)]
pub struct IntervalPlot {
    /// What is measured.
    pub axis: Axis,
    /// From the top.
    pub rows: Vec<IntervalRow>,
}

/// Outline of a published figure.
const DIAMOND: [(f64, f64); 4] = [(0.0, -5.0), (5.0, 0.0), (0.0, 5.0), (-5.0, 0.0)];

impl IntervalPlot {
    /// Height of a plot of this many rows, pixels.
    pub fn height(rows: usize) -> f64 {
        rows as f64 * 24.0 + 74.0
    }

    /// Values that have to have a place.
    pub(super) fn values(&self) -> impl Iterator<Item = f64> {
        self.rows.iter().flat_map(|row| {
            let ends = row.interval.map(|(low, high)| [low, high]).into_iter().flatten();
            row.point.into_iter().chain(row.published).chain(ends)
        })
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, rect: Rect) {
        let most = rect.width * 0.46;
        let names = self.rows.iter().map(|row| text::width(&row.name, LABEL)).fold(0.0, f64::max).min(most);
        let plot = Rect {
            left: rect.left + names + 12.0,
            top: rect.top + 2.0,
            width: rect.width - names - 12.0 - 18.0,
            height: rect.height - 2.0 - 38.0,
        };
        let scale = self.axis.scale(self.values(), false);
        let across = |value: f64| plot.left + scale.place(value) * plot.width;
        for (tick, label) in scale.ticks() {
            let stroke = Stroke { colour: GRID, width: 1.0, dashes: "" };
            canvas.line(&[(across(*tick), plot.top), (across(*tick), plot.bottom())], stroke);
            canvas.text(across(*tick), plot.bottom() + 16.0, LABEL, Anchor::Middle, label);
        }
        let axis = Stroke { colour: AXIS, width: 1.2, dashes: "" };
        canvas.line(&[(plot.left, plot.top), (plot.left, plot.bottom()), (plot.right(), plot.bottom())], axis);
        canvas.text(plot.left + plot.width / 2.0, plot.bottom() + 34.0, LABEL, Anchor::Middle, &self.axis.label);
        let row_height = plot.height / self.rows.len().max(1) as f64;
        for (index, row) in self.rows.iter().enumerate() {
            let middle = plot.top + (index as f64 + 0.5) * row_height;
            let style = Style::of(row.style);
            let name = text::fitted(&row.name, LABEL, names + 1.0);
            canvas.text(plot.left - 8.0, middle + 4.0, LABEL, Anchor::End, &name);
            if let Some((low, high)) = row.interval {
                let half = (row_height * 0.28).min(8.0);
                let corners = [(low, -half), (high, -half), (high, half), (low, half)];
                let bar: Vec<_> = corners.into_iter().map(|(value, up)| (across(value), middle + up)).collect();
                canvas.area(&bar, style.colour(), 0.32);
            }
            if let Some(published) = row.published {
                canvas.shape(&DIAMOND, (across(published), middle), PAPER, AXIS);
            }
            if let Some(point) = row.point {
                canvas.shape(&style.marker(), (across(point), middle), style.colour(), style.colour());
            }
        }
    }
}
