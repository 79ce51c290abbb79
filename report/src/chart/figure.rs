//! A figure: a grid of panels under a shared legend.

use super::data::Sheet;
use super::frame_strip::FrameStrip;
use super::heat_map::HeatMap;
use super::interval_plot::IntervalPlot;
use super::line_plot::LinePlot;
use super::palette::Style;
use super::place::{LABEL, Rect};
use super::scale::Axis;
use super::svg::{Anchor, Canvas};
use super::text;

/// Width of every figure, pixels.
const WIDTH: f64 = 820.0;
/// Space around everything.
const MARGIN: f64 = 12.0;
/// Space between panels.
const GAP: f64 = 22.0;
/// Size of panel titles, pixels.
const TITLE: f64 = 13.0;
const LEGEND_ROW: f64 = 20.0;

/// What a panel shows.
#[derive(Debug, Clone)]
pub enum Content {
    /// Curves.
    Lines(LinePlot),
    /// Points with their intervals, a row each.
    Intervals(IntervalPlot),
    /// A matrix as colours.
    Heat(HeatMap),
    /// Pictures of an episode.
    Frames(FrameStrip),
}

impl Content {
    /// Its axes, each with the lowest and the highest value that is drawn there. The colours of heat maps have an axis
    /// that is the same for all.
    fn axes(&mut self) -> Vec<(&mut Axis, Option<(f64, f64)>)> {
        match self {
            Self::Lines(plot) => {
                let (across, up) = (plot.x.range(plot.across()), plot.y.range(plot.up()));
                vec![(&mut plot.x, across), (&mut plot.y, up)]
            }
            Self::Intervals(plot) => {
                let values = plot.axis.range(plot.values());
                vec![(&mut plot.axis, values)]
            }
            Self::Heat(_) | Self::Frames(_) => Vec::new(),
        }
    }
}

/// Gives the axes of one quantity the same range in all panels of these figures, which are side by side.
pub fn share_axes(figures: &mut [Figure]) {
    let mut ranges: Vec<(Axis, (f64, f64))> = Vec::new();
    let mut axes: Vec<_> =
        figures.iter_mut().flat_map(|figure| &mut figure.panels).flat_map(|panel| panel.content.axes()).collect();
    for (axis, range) in &axes {
        let Some((low, high)) = *range else { continue };
        match ranges.iter_mut().find(|(known, _)| known == *axis) {
            Some((_, range)) => *range = (range.0.min(low), range.1.max(high)),
            None => ranges.push(((*axis).clone(), (low, high))),
        }
    }
    for (axis, _) in &mut axes {
        axis.reach = ranges.iter().find(|(known, _)| known == *axis).map(|(_, range)| *range);
    }
}

/// One pair of axes.
#[derive(Debug, Clone)]
pub struct Panel {
    /// Above it.
    pub title: String,
    /// What it shows.
    pub content: Content,
}

impl Panel {
    fn draw(&self, canvas: &mut Canvas, rect: Rect) {
        canvas.text(rect.left, rect.top + TITLE, TITLE, Anchor::Start, &self.title);
        let below = self.below(rect);
        match &self.content {
            Content::Lines(plot) => plot.draw(canvas, below),
            Content::Intervals(plot) => plot.draw(canvas, below),
            Content::Heat(map) => map.draw(canvas, below),
            Content::Frames(strip) => strip.draw(canvas, below),
        }
    }

    /// What the title leaves.
    fn below(&self, rect: Rect) -> Rect {
        let title = if self.title.is_empty() { 0.0 } else { TITLE + 10.0 };
        Rect { top: rect.top + title, height: rect.height - title, ..rect }
    }
}

/// One figure: a file of its own, and a place in the page.
#[derive(Debug, Clone)]
pub struct Figure {
    /// File name without its ending.
    pub name: String,
    /// What one sees, for the page.
    pub(crate) caption: String,
    /// Numbers of styles, and what is drawn in them; empty when the panels need none.
    pub(crate) legend: Vec<(usize, String)>,
    /// Panels in a row.
    pub(crate) columns: usize,
    /// Height of a panel with its axis labels, pixels.
    pub(crate) panel_height: f64,
    /// Panels, row by row.
    pub(crate) panels: Vec<Panel>,
}

impl Figure {
    /// The figure as an SVG document.
    pub fn svg(&self) -> String {
        let legend = self.legend_rows();
        let rows = self.panels.len().div_ceil(self.columns.max(1)).max(1);
        let height = 2.0 * MARGIN + self.legend_height() + rows as f64 * self.panel_height + (rows - 1) as f64 * GAP;
        let mut canvas = Canvas::new(WIDTH, height, &self.caption);
        for (row, entries) in legend.iter().enumerate() {
            let middle = MARGIN + (row as f64 + 0.5) * LEGEND_ROW;
            for &(left, index) in entries {
                let (style, name) = &self.legend[index];
                Style::of(*style).key(&mut canvas, left, middle);
                canvas.text(left + 34.0, middle + 4.0, LABEL, Anchor::Start, name);
            }
        }
        for (panel, rect) in self.placed() {
            panel.draw(&mut canvas, rect);
        }
        canvas.finish()
    }

    /// The figure's data as CSV.
    pub fn csv(&self) -> String {
        let mut sheet = Sheet::new();
        for Panel { title, content } in &self.panels {
            match content {
                Content::Lines(plot) => sheet.lines(title, &self.legend, plot),
                Content::Intervals(plot) => sheet.intervals(title, plot),
                Content::Heat(map) => sheet.heat(title, map),
                Content::Frames(strip) => sheet.frames(title, strip),
            }
        }
        sheet.finish()
    }

    fn placed(&self) -> impl Iterator<Item = (&Panel, Rect)> {
        let (columns, width, height) = (self.columns.max(1), self.panel_width(), self.panel_height);
        let first = MARGIN + self.legend_height();
        self.panels.iter().enumerate().map(move |(index, panel)| {
            let (row, column) = (index / columns, index % columns);
            let left = MARGIN + column as f64 * (width + GAP);
            (panel, Rect { left, top: first + row as f64 * (height + GAP), width, height })
        })
    }

    fn legend_height(&self) -> f64 {
        let rows = self.legend_rows().len();
        if rows == 0 { 0.0 } else { rows as f64 * LEGEND_ROW + 8.0 }
    }

    /// Each panel as an SVG document of its own: a page places them as its width allows.
    pub(crate) fn panel_svgs(&self) -> Vec<String> {
        let (width, height) = (self.panel_width(), self.panel_height);
        let panel = |panel: &Panel| {
            let mut canvas = Canvas::new(width + GAP, height + GAP, &panel.title);
            let rect = Rect { left: 0.5 * GAP, top: 0.5 * GAP, width, height };
            panel.draw(&mut canvas, rect);
            canvas.finish()
        };
        self.panels.iter().map(panel).collect()
    }

    /// The legend for a page: the sample of each style as an SVG document, and its name.
    pub(crate) fn legend_keys(&self) -> Vec<(String, &str)> {
        self.legend.iter().map(|(style, name)| (style_key(*style, name), name.as_str())).collect()
    }

    fn panel_width(&self) -> f64 {
        let columns = self.columns.max(1) as f64;
        (WIDTH - 2.0 * MARGIN - (columns - 1.0) * GAP) / columns
    }

    /// A panel of the whole width that shows this strip, and its height.
    pub(crate) fn strip_panel(title: String, strip: FrameStrip) -> (Panel, f64) {
        let height = strip.height(WIDTH - 2.0 * MARGIN) + TITLE + 10.0;
        (Panel { title, content: Content::Frames(strip) }, height)
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

/// A sample of a style as an SVG document that is described as `name`.
pub(crate) fn style_key(style: usize, name: &str) -> String {
    let mut canvas = Canvas::new(28.0, 14.0, name);
    Style::of(style).key(&mut canvas, 0.0, 7.0);
    canvas.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::{Mark, Markers, Series, Unit};

    fn figure() -> Figure {
        let plot = LinePlot {
            x: Axis::new("frames", Unit::Count),
            y: Axis::new("success", Unit::Percent),
            series: vec![Series {
                style: 0,
                points: vec![(0.0, 0.1), (1e6, 0.4)],
                band: vec![(0.0, 0.0, 0.2), (1e6, 0.3, 0.5)],
                markers: Markers::All,
                raw: vec![vec![(0.0, 0.2), (5e5, 0.1), (1e6, 0.6)]],
                marks: vec![Mark { x: 5e5, label: "II".into() }],
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
    fn texts_of_an_svg_are_escaped_and_its_numbers_finite() {
        let svg = figure().svg();
        assert!(svg.contains("a &lt;test&gt; &amp; more") && !svg.contains("NaN"), "{svg}");
    }

    /// What is written beside the ticks of each panel.
    fn ticks(figure: &Figure) -> Vec<Vec<String>> {
        let texts = |svg: String| {
            let pieces = svg.split("</text>").filter_map(|piece| Some(piece.rsplit_once('>')?.1.to_owned()));
            pieces.filter(|text| text.ends_with('%')).collect()
        };
        figure.panel_svgs().into_iter().map(texts).collect()
    }

    #[test]
    fn one_quantity_has_one_range_in_all_panels_of_all_figures() {
        let higher = |axis: &str| {
            let mut figure = figure();
            let Content::Lines(plot) = &mut figure.panels[0].content else { panic!("a line plot") };
            plot.series[0].points[1].1 = 0.9;
            plot.y = Axis::new(axis, Unit::Percent);
            figure
        };
        let mut figures = [figure(), higher("success")];
        figures[0].panels.extend(higher("success").panels);
        share_axes(&mut figures);
        let [first, second] = figures.each_ref().map(ticks);
        assert!(first[0] == first[1] && first[0] == second[0], "{first:?} {second:?}");
        assert!(first[0].contains(&"90%".to_owned()) || first[0].contains(&"100%".to_owned()), "{first:?}");
        // Another quantity has its own.
        let mut figures = [figure(), higher("precision")];
        share_axes(&mut figures);
        assert_ne!(ticks(&figures[0]), ticks(&figures[1]));
    }

    #[test]
    fn a_curve_lies_before_what_it_was_made_of_and_is_marked_alone() {
        let svg = figure().panel_svgs().remove(0);
        let faint = svg.find("stroke-opacity=\"0.25\"").expect("the raw curve");
        assert!(faint < svg.find("stroke-width=\"2\"").expect("the curve"));
        assert_eq!(svg.matches(">II</text>").count(), 1, "{svg}");
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
