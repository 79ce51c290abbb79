//! Pictures of kitchens and of episodes in them for people: shaded, labelled.
//!
//! ```text
//! palette  a colour for each category
//! robot    the robot as people see it
//! model    a kitchen as coloured triangles
//! camera   where a picture is taken from: parallel or central projection
//! visible  which triangle each pixel shows, and how near it is
//! sky      soft light from all over: which of many directions reach a point
//! shade    pixels to colours: light, section fill, edge lines
//! view     the two pictures of a kitchen: floor plan, and what the robot sees
//! canvas   a picture in memory: text, rectangles, PNG
//! outside  from where an episode is seen best
//! marks    lines over a picture: ring about the target, box about the goal
//! declared   what pictures mark and say of a task, by its declaration
//! moment   a moment of an episode: where everything is, what happens
//! depth_view   what the robot's depth camera sees
//! storyboard   a moment of an episode: depth, the room from outside, captions
//! scene    an episode from any camera: what was displaced, with a ghost where it stood
//! ```
//!
//! None of this is part of the simulator: nothing here is fed back, and nothing but the poses comes from it.

mod camera;
mod canvas;
mod declared;
mod depth_view;
mod marks;
mod model;
mod moment;
pub mod palette;
mod robot;
mod scene;
mod shade;
mod sky;
mod storyboard;
mod view;
mod viewpoint;
mod visible;

pub use canvas::{Canvas, PictureError, Rgb};
pub use declared::{action_name, captions, target, target_name, task};
pub use moment::{Captions, Moment, Task};
pub use scene::{Scene, Standpoint};
pub use storyboard::Storyboard;
pub use view::Views;
pub use viewpoint::Orbit;
