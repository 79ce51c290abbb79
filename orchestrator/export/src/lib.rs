//! What leaves a run for other programs: a policy as a file of its own (safetensors) or as an ONNX model, without
//! libtorch.

mod file;
mod guide;
mod onnx;
mod policy;
mod program;

pub use file::{Precision, open, save};
pub use guide::guide;
pub use onnx::onnx;
pub use policy::{Policy, PolicyError};
