//! What leaves a run for other programs: a policy as a file of its own (safetensors) or as an ONNX model, without
//! libtorch.
//!
//! ```no_run
//! let run = proto::run_folder::RunFolder::new("runs/a");
//! let manifest = run.checkpoints().join("rollout-00000012.json");
//! let policy = export::Policy::read(&run, &manifest, proto::config::Config::of_run(&run)?)?;
//! std::fs::write("policy.onnx", export::onnx(&policy)?)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod file;
mod guide;
mod onnx;
mod policy;

pub use file::{Precision, open, save};
pub use guide::guide;
pub use onnx::onnx;
pub use policy::{Policy, PolicyError};
