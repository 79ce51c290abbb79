//! Figures of one family: SVG written by hand, from which PNG is drawn. A [`Figure`] is a grid of panels under a shared
//! legend; a panel is a line plot, an interval plot or a heat map.

mod heat;
mod interval_plot;
mod line_plot;
pub mod palette;
mod raster;
mod scale;
mod svg;
mod text;

pub use heat::HeatMap;
pub use interval_plot::{IntervalPlot, IntervalRow};
pub use line_plot::{LinePlot, Mark, Markers, Series};
pub use raster::RasterError;
pub use scale::{Axis, Unit};
pub use svg::escape;

use palette::Style;
use svg::{Anchor, Canvas};

/// Width of every figure, pixels.
const WIDTH: f64 = 820.0;
/// Space around everything.
const MARGIN: f64 = 12.0;
/// Space between panels.
const GAP: f64 = 22.0;
/// Size of labels, pixels.
const LABEL: f64 = 12.0;
/// Size of panel titles, pixels.
const TITLE: f64 = 13.0;
const LEGEND_ROW: f64 = 20.0;

/// A rectangle on the canvas, pixels; y grows downwards.
#[derive(Debug, Clone, Copy)]
struct Frame {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
}

impl Frame {
    fn right(self) -> f64 {
        self.left + self.width
    }
    fn bottom(self) -> f64 {
        self.top + self.height
    }
}

/// What a panel shows.
#[derive(Debug, Clone)]
pub enum Content {
    /// Curves.
    Lines(LinePlot),
    /// Points with their intervals, a row each.
    Intervals(IntervalPlot),
    /// A matrix as colours.
    Heat(HeatMap),
}

/// One pair of axes.
#[derive(Debug, Clone)]
pub struct Panel {
    /// Above it.
    pub title: String,
    /// What it shows.
    pub content: Content,
}

/// One figure: a file of its own, and a place in the page.
#[derive(Debug, Clone)]
pub struct Figure {
    /// File name without its ending.
    pub name: String,
    /// What one sees, for the page.
    pub caption: String,
    /// Numbers of styles, and what is drawn in them; empty when the panels say it themselves.
    pub legend: Vec<(usize, String)>,
    /// Panels in a row.
    pub columns: usize,
    /// Height of a panel with its axis labels, pixels.
    pub panel_height: f64,
    /// Panels, row by row.
    pub panels: Vec<Panel>,
}

impl Figure {
    /// The figure as an SVG document.
    pub fn svg(&self) -> String {
        let legend = self.legend_rows();
        let legend_height = if legend.is_empty() { 0.0 } else { legend.len() as f64 * LEGEND_ROW + 8.0 };
        let columns = self.columns.max(1);
        let rows = self.panels.len().div_ceil(columns).max(1);
        let height = 2.0 * MARGIN + legend_height + rows as f64 * self.panel_height + (rows - 1) as f64 * GAP;
        let mut canvas = Canvas::new(WIDTH, height, &self.caption);
        for (row, entries) in legend.iter().enumerate() {
            let middle = MARGIN + (row as f64 + 0.5) * LEGEND_ROW;
            for &(left, index) in entries {
                let (style, name) = &self.legend[index];
                Style::of(*style).key(&mut canvas, left, middle);
                canvas.text(left + 34.0, middle + 4.0, LABEL, Anchor::Start, name);
            }
        }
        let width = (WIDTH - 2.0 * MARGIN - (columns - 1) as f64 * GAP) / columns as f64;
        for (index, panel) in self.panels.iter().enumerate() {
            let (row, column) = (index / columns, index % columns);
            let frame = Frame {
                left: MARGIN + column as f64 * (width + GAP),
                top: MARGIN + legend_height + row as f64 * (self.panel_height + GAP),
                width,
                height: self.panel_height,
            };
            canvas.text(frame.left, frame.top + TITLE, TITLE, Anchor::Start, &panel.title);
            let title = if panel.title.is_empty() { 0.0 } else { TITLE + 10.0 };
            let below = Frame { top: frame.top + title, height: frame.height - title, ..frame };
            match &panel.content {
                Content::Lines(plot) => plot.draw(&mut canvas, below),
                Content::Intervals(plot) => plot.draw(&mut canvas, below),
                Content::Heat(map) => map.draw(&mut canvas, below),
            }
        }
        canvas.finish()
    }

    /// The figure as a PNG file of twice the size in pixels.
    pub fn png(&self) -> Result<Vec<u8>, RasterError> {
        raster::png(&self.svg())
    }

    /// Where each legend entry begins, row by row: (left, index).
    fn legend_rows(&self) -> Vec<Vec<(f64, usize)>> {
        let mut rows: Vec<Vec<(f64, usize)>> = Vec::new();
        let mut left = WIDTH;
        for (index, (_, name)) in self.legend.iter().enumerate() {
            let width = 34.0 + text::width(name, LABEL) + 22.0;
            if rows.is_empty() || left + width > WIDTH - MARGIN {
                rows.push(Vec::new());
                left = MARGIN;
            }
            rows.last_mut().expect("a row was pushed if there was none").push((left, index));
            left += width;
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure() -> Figure {
        let plot = LinePlot {
            x: Axis::new("frames", Unit::Count),
            y: Axis::new("success", Unit::Percent),
            series: vec![Series {
                style: 0,
                points: vec![(0.0, 0.1), (1e6, 0.4)],
                band: vec![(0.0, 0.0, 0.2), (1e6, 0.3, 0.5)],
                markers: Markers::All,
            }],
            marks: vec![Mark { x: 5e5, label: "stage II".into() }],
        };
        Figure {
            name: "test".into(),
            caption: "a <test> & more".into(),
            legend: vec![(0, "ours".into()), (3, "λ = 15, r′".into())],
            columns: 2,
            panel_height: 200.0,
            panels: vec![Panel { title: "success".into(), content: Content::Lines(plot) }],
        }
    }

    #[test]
    fn an_svg_is_a_document_that_reads_back_and_a_png_is_twice_its_size() {
        let svg = figure().svg();
        assert!(svg.contains("a &lt;test&gt; &amp; more") && !svg.contains("NaN"), "{svg}");
        let png = figure().png().unwrap();
        assert_eq!(&png[1..4], b"PNG");
        let width = u32::from_be_bytes([png[16], png[17], png[18], png[19]]);
        assert_eq!(f64::from(width), 2.0 * WIDTH);
    }

    #[test]
    fn a_long_legend_takes_several_rows_and_none_is_cut() {
        let mut figure = figure();
        figure.legend = (0..9).map(|i| (i, format!("a rather long name of a group, number {i}"))).collect();
        let rows = figure.legend_rows();
        assert!(rows.len() > 2);
        for (left, index) in rows.concat() {
            assert!(left + 34.0 + text::width(&figure.legend[index].1, LABEL) <= WIDTH - MARGIN);
        }
    }
}
