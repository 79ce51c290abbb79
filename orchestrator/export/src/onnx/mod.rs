//! A policy as an ONNX model: one step of any number of environments, from what they observe to log-probabilities,
//! value and the belief for the next step.

mod build;
mod message;
mod network;

use crate::policy::{Policy, PolicyError};
use prost::Message;

/// Operators of this version: what current runtimes all have.
const OPERATORS: i64 = 17;
/// The oldest format of files that has them.
const FORMAT: i64 = 8;

pub fn onnx(policy: &Policy) -> Result<Vec<u8>, PolicyError> {
    let model = message::Model {
        ir_version: FORMAT,
        producer_name: "stillroom".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        doc_string: format!("One step of a policy for the task {}.", policy.config.task),
        graph: Some(network::graph(policy)?),
        opset_import: vec![message::OperatorSet { domain: String::new(), version: OPERATORS }],
        metadata_props: policy.facts().into_iter().map(|(key, value)| message::Entry { key, value }).collect(),
    };
    Ok(model.encode_to_vec())
}
