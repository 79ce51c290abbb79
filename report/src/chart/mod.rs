//! Figures of one family: SVG, from which PNG is drawn. A [`Figure`] is a grid of panels under a shared legend; a panel
//! is a line plot, an interval plot or a heat map.
//!
//! By hand: a plotting crate has neither strokes across single curves nor ranges that panels share, and would bring
//! fonts and back-ends of its own.

mod figure;
mod heat_map;
mod interval_plot;
mod line_plot;
mod palette;
mod place;
mod png;
mod scale;
mod svg;
mod text;

pub use figure::Figure;
pub(crate) use figure::{Content, Panel, share_axes};
pub(crate) use heat_map::HeatMap;
pub(crate) use interval_plot::{IntervalPlot, IntervalRow};
pub(crate) use line_plot::{LinePlot, Mark, Markers, Series};
pub(crate) use palette::STYLES;
pub use png::PngError;
pub(crate) use scale::{Axis, Unit};
