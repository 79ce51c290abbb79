//! Curves with bands over two axes.

use super::palette::Style;
use super::place::{LABEL, Rect};
use super::scale::{Axis, Scale};
use super::svg::{AXIS, Anchor, Canvas, GRID, Stroke};
use super::text;

/// One curve.
#[derive(Debug, Clone, Default)]
pub struct Series {
    /// Number of its style, which the legend names.
    pub style: usize,
    /// (x, y), x ascending.
    pub points: Vec<(f64, f64)>,
    /// (x, low, high), x ascending; empty = no band.
    pub band: Vec<(f64, f64, f64)>,
    pub markers: Markers,
    /// What a smoothed curve was made of, drawn faint behind all curves.
    pub raw: Vec<Vec<(f64, f64)>>,
    /// What happens on this curve alone: a stroke across it, with a name.
    pub marks: Vec<Mark>,
}

/// Where a curve has markers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Markers {
    /// At every point: each is a measurement.
    #[default]
    All,
    /// At a few, so that curves can be distinguished without colour.
    Some,
}

/// Markers on a curve that has [`Markers::Some`].
const FEW: usize = 6;

/// How much of a raw curve is seen.
const RAW_OPACITY: f64 = 0.25;
/// Half of the length of a stroke across a curve, pixels.
const STROKE: f64 = 8.0;

/// A vertical line, or a stroke across a curve, with a name.
#[derive(Debug, Clone, PartialEq)]
pub struct Mark {
    pub x: f64,
    /// What happens there.
    pub label: String,
}

/// Curves over two axes.
#[derive(Debug, Clone)]
pub struct LinePlot {
    /// Across.
    pub x: Axis,
    pub y: Axis,
    /// Curves, drawn in this order.
    pub series: Vec<Series>,
    /// Vertical lines.
    pub marks: Vec<Mark>,
}

impl LinePlot {
    /// Values that have to have a place across.
    pub(super) fn across(&self) -> impl Iterator<Item = f64> {
        self.series.iter().flat_map(|series| series.points.iter().map(|point| point.0))
    }

    /// Values that have to have a place up. Of what is drawn faint, all but the outermost hundredth at either end.
    pub(super) fn up(&self) -> impl Iterator<Item = f64> {
        self.series.iter().flat_map(|series| {
            let points = series.points.iter().map(|point| point.1);
            let band = series.band.iter().flat_map(|&(_, low, high)| [low, high]);
            let mut raw: Vec<f64> = series.raw.iter().flatten().map(|point| point.1).collect();
            raw.sort_by(f64::total_cmp);
            let cut = raw.len() / 100;
            points.chain(band).chain(raw.into_iter().skip(cut).rev().skip(cut)).collect::<Vec<f64>>()
        })
    }

    pub(super) fn draw(&self, canvas: &mut Canvas, rect: Rect) {
        let x = self.x.scale(self.across(), true);
        let y = self.y.scale(self.up(), false);
        let plot = axes(canvas, rect, (&self.x, &x), (&self.y, &y));
        let at = |(a, b): (f64, f64)| (plot.left + x.place(a) * plot.width, plot.bottom() - y.place(b) * plot.height);
        for mark in &self.marks {
            let (across, _) = at((mark.x, 0.0));
            let stroke = Stroke { colour: AXIS, width: 1.0, dashes: "3 3" };
            canvas.line(&[(across, plot.top), (across, plot.bottom())], stroke);
        }
        for series in &self.series {
            let stroke = Stroke { width: 1.0, dashes: "", ..Style::of(series.style).stroke() };
            for line in series.raw.iter().filter(|line| line.len() > 1) {
                let line = line.iter().map(|&point| at(point));
                let inside: Vec<_> = line.map(|(a, b)| (a, b.clamp(plot.top, plot.bottom()))).collect();
                canvas.faint_line(&inside, stroke, RAW_OPACITY);
            }
        }
        for series in &self.series {
            let style = Style::of(series.style);
            if series.band.len() > 1 {
                let upper = series.band.iter().map(|&(a, _, high)| at((a, high)));
                let lower = series.band.iter().rev().map(|&(a, low, _)| at((a, low)));
                canvas.area(&upper.chain(lower).collect::<Vec<_>>(), style.colour(), 0.16);
            }
            let line: Vec<_> = series.points.iter().map(|&point| at(point)).collect();
            if line.len() > 1 {
                canvas.line(&line, style.stroke());
            }
            let every = match series.markers {
                Markers::All => 1,
                Markers::Some => line.len().div_ceil(FEW).max(1),
            };
            // Each curve's begin somewhere else, so that they do not hide one another.
            let first = series.style % every.min(line.len().max(1));
            for &point in line.iter().skip(first).step_by(every) {
                canvas.shape(&style.marker(), point, style.colour(), style.colour());
            }
        }
        let mut named: Vec<&Mark> = Vec::new();
        for series in &self.series {
            let style = Style::of(series.style);
            for mark in &series.marks {
                let Some(height) = height_at(&series.points, mark.x) else { continue };
                let (left, middle) = at((mark.x, height));
                let stroke = Stroke { dashes: "", ..style.stroke() };
                canvas.line(&[(left, middle - STROKE), (left, middle + STROKE)], stroke);
                // Named once, however many curves have it.
                if !named.contains(&mark) {
                    named.push(mark);
                    canvas.text(left + 4.0, middle - STROKE, LABEL - 2.0, Anchor::Start, &mark.label);
                }
            }
        }
        for mark in &self.marks {
            let (across, _) = at((mark.x, 0.0));
            canvas.text(across + 4.0, plot.top + 11.0, LABEL - 1.0, Anchor::Start, &mark.label);
        }
        if self.series.iter().all(|series| series.points.is_empty()) {
            let middle = (plot.left + plot.width / 2.0, plot.top + plot.height / 2.0);
            canvas.text(middle.0, middle.1, LABEL, Anchor::Middle, "nothing was recorded");
        }
    }
}

/// Height of a curve at a place between two of its points.
fn height_at(points: &[(f64, f64)], x: f64) -> Option<f64> {
    let [before, after] = points.array_windows().find(|[before, after]| before.0 <= x && x <= after.0)?;
    let share = if after.0 > before.0 { (x - before.0) / (after.0 - before.0) } else { 0.0 };
    Some(before.1 + share * (after.1 - before.1))
}

/// Grid, ticks and labels; returns the place that is left for what is plotted.
fn axes(canvas: &mut Canvas, rect: Rect, (x, x_scale): (&Axis, &Scale), (y, y_scale): (&Axis, &Scale)) -> Rect {
    let widest = y_scale.ticks().iter().map(|(_, label)| text::width(label, LABEL)).fold(0.0, f64::max);
    let left = 18.0 + widest + 8.0;
    let plot = Rect {
        left: rect.left + left,
        // Half a tick label is above the topmost grid line, and half of one beside the last.
        top: rect.top + 6.0,
        width: rect.width - left - 16.0,
        height: rect.height - 6.0 - 38.0,
    };
    let grid = Stroke { colour: GRID, width: 1.0, dashes: "" };
    for (tick, label) in y_scale.ticks() {
        let height = plot.bottom() - y_scale.place(*tick) * plot.height;
        canvas.line(&[(plot.left, height), (plot.right(), height)], grid);
        canvas.text(plot.left - 7.0, height + 4.0, LABEL, Anchor::End, label);
    }
    for (tick, label) in x_scale.ticks() {
        let across = plot.left + x_scale.place(*tick) * plot.width;
        canvas.line(&[(across, plot.top), (across, plot.bottom())], grid);
        canvas.text(across, plot.bottom() + 16.0, LABEL, Anchor::Middle, label);
    }
    let axis = Stroke { colour: AXIS, width: 1.2, dashes: "" };
    canvas.line(&[(plot.left, plot.top), (plot.left, plot.bottom()), (plot.right(), plot.bottom())], axis);
    canvas.text(plot.left + plot.width / 2.0, plot.bottom() + 34.0, LABEL, Anchor::Middle, &x.label);
    let middle = plot.top + plot.height / 2.0;
    canvas.rotated_text(rect.left + 11.0, middle, LABEL, Anchor::Middle, -90.0, &y.label);
    plot
}
