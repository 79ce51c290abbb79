//! Pictures of kitchens for people: shaded, labelled, on one sheet.
//!
//! ```text
//! palette  a colour for each category
//! model    a kitchen as coloured triangles
//! camera   where a picture is taken from: parallel or central projection
//! raster   which triangle each pixel shows, and how near it is
//! sky      soft light from all over: which of many directions reach a point
//! shade    pixels to colours: light, section fill, edge lines
//! view     the two pictures of a kitchen: floor plan, and what the robot sees
//! canvas   a picture in memory: text, rectangles, PNG
//! sheet    all kitchens side by side
//! ```
//!
//! None of this is part of the simulator: nothing here is fed back, and nothing but the poses comes from it.

mod camera;
mod canvas;
mod model;
pub mod palette;
mod raster;
mod shade;
mod sheet;
mod sky;
mod view;

pub use sheet::{SheetOptions, Subject, sheet};
