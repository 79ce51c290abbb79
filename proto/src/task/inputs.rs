//! What the network is given of a record: the task's observations.

use super::channel::{Channel, Dtype, Role};
use super::error::SpecError;
use super::layout::Field;
use super::spec::Spec;
use crate::camera::{FRAME_SIDE, WINDOW};

/// Numbers of the vector.
pub const VECTOR_NUMBERS: usize = 3;

/// Places of the observations.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Inputs {
    /// The frame.
    pub image: Field,
    /// The vector, [`VECTOR_NUMBERS`] of `f32`: one observation behind the other, as the task declares them.
    pub vector: Vec<Field>,
}

impl Spec {
    /// Its observations, if networks can take them.
    pub fn inputs(&self) -> Result<Inputs, SpecError> {
        let refuse = |what: String| Err(SpecError::Input { task: self.name.clone(), what });
        let (mut images, mut vector) = (vec![], vec![]);
        let pairs = self.channels.iter().zip(&self.layout.fields);
        for (channel, &field) in pairs.filter(|(channel, _)| channel.role == Role::Observation) {
            let Channel { name, dtype, shape, sums, .. } = channel;
            match dtype {
                Dtype::U16 if *shape == [FRAME_SIDE; 2] && *sums == Some(WINDOW) && images.is_empty() => {
                    images.push(field);
                }
                Dtype::F32 => vector.push(field),
                _ => return refuse(format!("its observation `{name}`")),
            }
        }
        let numbers: usize = vector.iter().map(|field| field.count).sum();
        match images.pop() {
            Some(image) if numbers == VECTOR_NUMBERS => Ok(Inputs { image, vector }),
            Some(_) => refuse(format!("its observations: {numbers} numbers of f32")),
            None => refuse("its observations: there is no image".to_owned()),
        }
    }
}
