//! All weights in one flat buffer, and by name.
//!
//! Each parameter is a leaf of the autograd graph whose storage is a stretch of one flat tensor. So the optimiser,
//! the gradient norm and the all-reduce between learners are each one operation over one tensor instead of a
//! hundred small ones, and a snapshot of the network is one copy.

use super::initialize::Initial;
use proto::digest::hex;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::ops::Index;
use tch::{Device, Kind, Tensor};

/// Which parameter: modules hold these, the tensors live in [`Parameters`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ParameterId(usize);

#[derive(Debug, Clone)]
struct Declared {
    name: String,
    shape: Vec<i64>,
    initial: Initial,
    offset: i64,
}

impl Declared {
    fn count(&self) -> i64 {
        self.shape.iter().product()
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` {problem}")]
pub struct Unfit {
    pub name: String,
    pub problem: String,
}

impl Unfit {
    fn new(name: &str, problem: impl Into<String>) -> Self {
        Self { name: name.to_owned(), problem: problem.into() }
    }

    pub(crate) fn no_place(name: &str) -> Self {
        Self::new(name, "has no place in this network")
    }

    pub fn missing(name: &str) -> Self {
        Self::new(name, "is missing")
    }

    pub fn not_finite(name: &str) -> Self {
        Self::new(name, "is not finite")
    }
}

/// The tensor saved as `name`, if it is there, of this size, of 32-bit numbers, and all of them finite.
pub(crate) fn fits<'a>(name: &str, saved: Option<&'a Tensor>, size: &[i64]) -> Result<&'a Tensor, Unfit> {
    let saved = saved.ok_or_else(|| Unfit::missing(name))?;
    let (kind, found) = (saved.kind(), saved.size());
    if found != size || kind != Kind::Float {
        return Err(Unfit::new(name, format!("is {kind:?} {found:?}, not Float {size:?}")));
    }
    if all_finite(saved) { Ok(saved) } else { Err(Unfit::not_finite(name)) }
}

#[derive(Debug, Default)]
pub struct Layout {
    entries: Vec<Declared>,
    count: i64,
}

impl Layout {
    /// Declares a parameter. Names follow PyTorch's module paths, e.g. `belief.weight_ih_l0`. Panics if the name is
    /// taken.
    pub fn add(&mut self, name: impl Into<String>, shape: &[i64], initial: Initial) -> ParameterId {
        let entry = Declared { name: name.into(), shape: shape.to_vec(), initial, offset: self.count };
        assert!(self.entries.iter().all(|other| other.name != entry.name), "{} is declared twice", entry.name);
        self.count += entry.count();
        self.entries.push(entry);
        ParameterId(self.entries.len() - 1)
    }
}

#[derive(Debug)]
pub struct Parameters {
    entries: Vec<Declared>,
    flat: Tensor,
    leaves: Vec<Tensor>,
}

impl Index<ParameterId> for Parameters {
    type Output = Tensor;

    fn index(&self, id: ParameterId) -> &Tensor {
        &self.leaves[id.0]
    }
}

impl Parameters {
    pub fn new(layout: Layout, seed: u64, device: Device) -> Self {
        let mut values = Vec::with_capacity(layout.count as usize);
        for entry in &layout.entries {
            values.extend(entry.initial.draw(seed, &entry.name, &entry.shape));
        }
        let flat = Tensor::from_slice(&values).to_device(device);
        let leaves = layout
            .entries
            .iter()
            .map(|entry| {
                let view = flat.narrow(0, entry.offset, entry.count()).view(entry.shape.as_slice());
                view.detach().set_requires_grad(true)
            })
            .collect();
        Self { entries: layout.entries, flat, leaves }
    }

    /// Takes all weights from saved ones with their names. After an error nothing has changed.
    pub fn load(&mut self, saved: &BTreeMap<String, Tensor>) -> Result<(), Unfit> {
        let found = self.entries.iter().map(|entry| fits(&entry.name, saved.get(&entry.name), &entry.shape));
        let found = found.collect::<Result<Vec<&Tensor>, Unfit>>()?;
        let has_place = |name: &str| self.entries.iter().any(|entry| entry.name == name);
        if let Some(name) = saved.keys().find(|name| !has_place(name)) {
            return Err(Unfit::no_place(name));
        }
        tch::no_grad(|| {
            for (leaf, saved) in self.leaves.iter().zip(found) {
                leaf.detach().copy_(saved);
            }
        });
        Ok(())
    }

    pub fn count(&self) -> i64 {
        self.flat.numel() as i64
    }

    /// The flat buffer: writing to it changes the weights. Only between a backward and the next forward.
    pub(crate) fn flat(&self) -> Tensor {
        self.flat.shallow_clone()
    }

    /// A number that changes whenever the weights do.
    pub fn version(&self) -> i64 {
        self.flat.internal_version()
    }

    /// Gradient of a loss, flat, in the order of [`Parameters::flat`]. Nothing is accumulated anywhere.
    pub fn gradient_of(&self, loss: &Tensor) -> Tensor {
        self.flatten(Tensor::run_backward(&[loss], &self.leaves, false, false))
    }

    /// The same for parameters that the loss reaches only through `tensor`: `elsewhere` gets the gradient of `tensor`
    /// and returns theirs.
    pub(crate) fn gradient_through(
        &self,
        loss: &Tensor,
        tensor: &Tensor,
        elsewhere: impl FnOnce(&Tensor) -> Vec<(ParameterId, Tensor)>,
    ) -> Tensor {
        let inputs: Vec<&Tensor> = self.leaves.iter().chain([tensor]).collect();
        let mut gradients = Tensor::run_backward(&[loss], &inputs, false, false);
        let through = gradients.pop().expect("one gradient for each input");
        for (id, gradient) in elsewhere(&through) {
            gradients[id.0] = gradient;
        }
        self.flatten(gradients)
    }

    /// One gradient a parameter, undefined where the loss does not depend on it → flat.
    fn flatten(&self, gradients: Vec<Tensor>) -> Tensor {
        let flattened: Vec<Tensor> = gradients
            .into_iter()
            .zip(&self.leaves)
            .map(|(gradient, leaf)| if gradient.defined() { gradient } else { leaf.zeros_like() }.reshape(-1))
            .collect();
        Tensor::cat(&flattened, 0)
    }

    /// Name of the first parameter for which a flat tensor (weights, gradient) holds a non-finite number.
    pub(crate) fn first_non_finite(&self, flat: &Tensor) -> Option<&str> {
        // One wait for a GPU where all are finite, which is the rule, instead of one for each parameter.
        if all_finite(flat) {
            return None;
        }
        self.entries
            .iter()
            .find(|entry| !all_finite(&flat.narrow(0, entry.offset, entry.count())))
            .map(|entry| entry.name.as_str())
    }

    /// Names and weights, in order of declaration. The tensors share the network's storage.
    pub fn named(&self) -> impl Iterator<Item = (&str, Tensor)> {
        self.entries.iter().zip(&self.leaves).map(|(entry, leaf)| (entry.name.as_str(), leaf.detach()))
    }

    /// All parameters, in order of declaration.
    pub fn ids(&self) -> impl Iterator<Item = ParameterId> + use<> {
        (0..self.leaves.len()).map(ParameterId)
    }

    /// SHA-256 over (name, 0, dimensions as little-endian u64, little-endian f32 values) in name order, as 64 hex
    /// digits.
    pub fn digest(&self) -> String {
        let values = to_vec(&self.flat);
        let mut entries: Vec<&Declared> = self.entries.iter().collect();
        entries.sort_by(|a, b| a.name.cmp(&b.name));
        let mut hash = Sha256::new();
        for entry in entries {
            hash.update(entry.name.as_bytes());
            hash.update([0]);
            for dimension in &entry.shape {
                hash.update(dimension.to_le_bytes());
            }
            let stretch = &values[entry.offset as usize..(entry.offset + entry.count()) as usize];
            let bytes: Vec<u8> = stretch.iter().flat_map(|value| value.to_le_bytes()).collect();
            hash.update(&bytes);
        }
        hex(hash.finalize())
    }
}

pub(crate) fn all_finite(tensor: &Tensor) -> bool {
    // One pass and one number read back: the sum of x·0 is 0 only when all x are finite.
    (tensor.detach() * 0.0).sum(Kind::Float).double_value(&[]) == 0.0
}

/// The elements of an f32 tensor, row-major, on the host.
pub fn to_vec(tensor: &Tensor) -> Vec<f32> {
    let host = tensor.detach().to_device(Device::Cpu).to_kind(Kind::Float).contiguous();
    let mut values = vec![0.0; host.numel()];
    let count = values.len();
    host.copy_data(&mut values, count);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> (Parameters, ParameterId, ParameterId) {
        let mut layout = Layout::default();
        let a = layout.add("b.weight", &[2, 3], Initial::Normal { deviation: 1.0 });
        let b = layout.add("a.bias", &[4], Initial::Constant(2.0));
        (Parameters::new(layout, 1, Device::Cpu), a, b)
    }

    #[test]
    fn the_digest_sees_every_bit_of_every_weight() {
        let (parameters, ..) = two();
        let (same, ..) = two();
        assert_eq!(parameters.digest(), same.digest());
        assert_eq!(parameters.digest().len(), 64);
        for index in 0..10 {
            let (changed, ..) = two();
            let old = changed.flat().double_value(&[index]) as f32;
            let _ = tch::no_grad(|| changed.flat().get(index).fill_(f64::from(f32::from_bits(old.to_bits() ^ 1))));
            assert_ne!(parameters.digest(), changed.digest(), "weight {index}");
        }
    }

    #[test]
    fn non_finite_numbers_are_found_and_named() {
        let (parameters, ..) = two();
        assert!(all_finite(&parameters.flat()));
        assert_eq!(parameters.first_non_finite(&parameters.flat()), None);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let flat = parameters.flat().copy();
            let _ = flat.get(7).fill_(bad);
            assert!(!all_finite(&flat));
            assert_eq!(parameters.first_non_finite(&flat), Some("a.bias"));
        }
    }
}
