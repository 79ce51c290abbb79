//! Figures of one family, as SVG. A [`Figure`] is a grid of panels under a shared legend; a panel
//! is a line plot, an interval plot, a heat map or a strip of pictures.
//!
//! By hand: a plotting crate has neither strokes across single curves nor ranges that panels share, and would bring
//! fonts and back-ends of its own.

mod data;
mod figure;
mod frame_strip;
mod heat_map;
mod interval_plot;
mod line_plot;
mod palette;
mod place;
mod scale;
mod svg;
mod text;
mod theme;

pub use figure::Figure;
pub(crate) use figure::{Content, Panel, share_axes, style_key};
pub use frame_strip::Frame;
pub(crate) use frame_strip::FrameStrip;
pub(crate) use heat_map::HeatMap;
pub(crate) use interval_plot::{IntervalPlot, IntervalRow};
pub(crate) use line_plot::{LinePlot, Mark, Markers, Series};
pub(crate) use palette::{MEASURES, STYLES};
pub(crate) use scale::{Axis, Unit};
pub(crate) use theme::rules as theme_rules;
