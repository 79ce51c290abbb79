#![allow(clippy::pedantic, dead_code, reason = "generated")]

include!("../../../schemas/compiled/onnx.rs");
