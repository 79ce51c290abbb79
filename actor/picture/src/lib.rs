//! Pictures of kitchens and of episodes in them for people: shaded, labelled.
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
mod walls;

pub use canvas::{Canvas, PictureError, Rgb};
pub use declared::{action_name, captions, target, target_name, task};
pub use moment::{Captions, Moment, Task, is_displaced};
pub use scene::{NIGHT, PAPER, Scene, Standpoint};
pub use storyboard::Storyboard;
pub use view::Views;
pub use viewpoint::Orbit;
