//! The simulator: kitchens, robot, physics, a depth camera, and the environments of the tasks. A library without
//! processes: the rollout actor is one user of it, what proves, shows and measures is another.
//!
//! [`environment::Environment`] is what an actor needs of a task, [`tasks`] are those that there are. An environment is
//! made in a kitchen, begins episodes, takes actions, returns what they did, and renders what the head camera sees:
//!
//! ```
//! use proto::{camera::FRAME_SIDE, config::Config, episode::EnvironmentId, kitchen::KitchenId};
//! use simulator::{depth::DepthCamera, kitchen::Kitchen, robot::action::Action, tasks::arm_point_nav::Environment};
//!
//! let config = Config::default();
//! let id = EnvironmentId { kitchen: KitchenId::new(7)?, number: 0 };
//! let kitchen = std::sync::Arc::new(Kitchen::build(id.kitchen, &config.simulation)?);
//! let mut camera = DepthCamera::new(kitchen.bodies());
//! let mut environment = Environment::new(kitchen, id, &config)?;
//! environment.start_episode(3);
//! let transition = environment.step(Action::RotateRightContinuous);
//! let mut depth_mm = vec![0; FRAME_SIDE * FRAME_SIDE];
//! environment.look(&mut camera, FRAME_SIDE, &mut depth_mm);
//! let nearest_mm = depth_mm.into_iter().filter(|&pixel_mm| pixel_mm > 0).min();
//! assert!(!transition.failed() && nearest_mm.is_some_and(|mm| mm < 5000), "a kitchen is not empty");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The same kitchen, episode and actions give the same state at each step and the same frame, bit for bit, on every
//! x86-64 machine.

mod arc_cosine;
pub mod depth;
pub mod environment;
pub mod gltf_file;
pub mod kitchen;
pub mod mesh;
pub mod mjcf;
pub mod physics;
pub mod robot;
pub mod scene_file;
pub mod shape;
pub mod simulation;
pub mod source;
pub mod tasks;
