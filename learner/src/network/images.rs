//! Images but the frame, as they came: a row has the bytes of all of them, one behind the other. They become numbers on
//! the device, whole numbers as shares of their type's greatest, and each goes through an encoder of its own.

use super::encoder::Dqn;
use super::parameters::{Layout, Parameters};
use crate::ffi;
use crate::ffi::kernels::channels_last;
use proto::config::{Config, dqn};
use proto::task::{Dtype, Image};
use std::ops::Range;
use tch::{Device, Kind, Tensor};

/// What the names of their weights begin with, and in a batch of `learner probe` those of images.
pub(crate) const PATH: &str = "images.";

#[derive(Debug)]
pub(crate) struct Images {
    each: Vec<(Image, Dqn)>,
    /// Bytes of a row.
    bytes: i64,
    /// What encoders compute in.
    kind: Kind,
}

impl Images {
    pub fn new(layout: &mut Layout, config: &Config) -> Self {
        let inputs = config.spec().inputs().expect("a validated configuration's task has what networks take");
        let bytes = inputs.image_bytes() as i64;
        let encoded = |image: Image| {
            let encoder = Dqn::new(layout, &format!("{PATH}{}", image.name), &image);
            (image, encoder)
        };
        Self { each: inputs.images.into_iter().map(encoded).collect(), bytes, kind: Kind::Float }
    }

    pub fn are_none(&self) -> bool {
        self.each.is_empty()
    }

    /// From now on encoders compute in bfloat16, on a GPU.
    pub fn use_bfloat16(&mut self) {
        self.kind = Kind::BFloat16;
    }

    pub fn are_in_bfloat16(&self) -> bool {
        self.kind == Kind::BFloat16
    }

    pub fn outputs(&self) -> i64 {
        (self.each.len() * dqn::OUTPUTS) as i64
    }

    pub fn store(&self, rows: i64, device: Device) -> Tensor {
        Tensor::zeros([rows, self.bytes], (Kind::Uint8, device))
    }

    /// Whether any bytes are sound, so that they may be read from memory that others write to.
    pub fn are_whole_numbers(&self) -> bool {
        self.each.iter().all(|(image, _)| image.field.dtype != Dtype::F32)
    }

    /// Where each lies in a row.
    pub fn places(&self) -> impl ExactSizeIterator<Item = Range<usize>> {
        self.each.iter().map(|(image, _)| image.bytes())
    }

    /// Images of so many rows, row-major → rows of bytes on the CPU.
    pub fn gather(&self, images: &[&[u8]], rows: usize) -> Tensor {
        let mut gathered = self.store(rows as i64, Device::Cpu);
        // SAFETY: the tensor was made above.
        let bytes = unsafe { ffi::bytes_mut(&mut gathered) };
        let rows = bytes.chunks_exact_mut(self.bytes.max(1) as usize);
        for (row, images) in rows.zip(images.chunks_exact(self.each.len().max(1))) {
            self.places().zip(images).for_each(|(place, image)| row[place].copy_from_slice(image));
        }
        gathered
    }

    /// Rows of bytes \[rows, bytes\] → what each encoder makes of them, \[rows, 512\].
    pub fn forward(&self, parameters: &Parameters, rows: &Tensor) -> Vec<Tensor> {
        let see = |(image, encoder): &(Image, Dqn)| {
            let seen = input(image, rows).to_kind(self.kind);
            // cuDNN's convolutions of bfloat16 take channels last.
            let seen = if self.are_in_bfloat16() { channels_last(seen) } else { seen };
            encoder.forward(parameters, &seen).to_kind(Kind::Float)
        };
        self.each.iter().map(see).collect()
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.each.iter().map(|(image, _)| &*image.name)
    }

    /// Each image of some rows, by name: as it was declared, but numbers of 16 bits with a sign.
    pub fn named(&self, rows: &Tensor) -> Vec<(&str, Tensor)> {
        self.each.iter().map(|(image, _)| (&*image.name, numbers(image, rows))).collect()
    }

    /// Rows of images that are given by name. `find` gets name, shape of a row, and kind of each.
    pub fn rows<E>(
        &self,
        rows: i64,
        mut find: impl FnMut(&str, [i64; 3], Kind) -> Result<Tensor, E>,
    ) -> Result<Tensor, E> {
        let store = self.store(rows, Device::Cpu);
        for (image, _) in &self.each {
            let found = find(&image.name, image.shape().map(|side| side as i64), kind(image.field.dtype))?;
            let bytes = found.contiguous().view([rows, -1]).view_dtype(Kind::Uint8);
            place(image, &store).copy_(&bytes);
        }
        Ok(store)
    }
}

/// Where an image lies in rows.
fn place(image: &Image, rows: &Tensor) -> Tensor {
    let bytes = image.bytes();
    rows.narrow(1, bytes.start as i64, bytes.len() as i64)
}

fn kind(dtype: Dtype) -> Kind {
    match dtype {
        Dtype::U16 => Kind::Int16,
        Dtype::F32 => Kind::Float,
        _ => Kind::Uint8,
    }
}

/// \[rows\] of an image's shape.
fn numbers(image: &Image, rows: &Tensor) -> Tensor {
    let [first, second, third] = image.shape().map(|side| side as i64);
    place(image, rows).contiguous().view_dtype(kind(image.field.dtype)).view([-1, first, second, third])
}

/// An encoder's input \[rows, channels, height, width\].
fn input(image: &Image, rows: &Tensor) -> Tensor {
    let numbers = numbers(image, rows);
    let numbers = if image.channels_last { numbers.permute([0, 3, 1, 2]) } else { numbers };
    match image.field.dtype {
        // libtorch has no arithmetic of 16 bits without a sign.
        Dtype::U16 => {
            numbers.to_kind(Kind::Int).bitwise_and(0xffff).to_kind(Kind::Float).g_div_scalar_(f64::from(u16::MAX))
        }
        Dtype::F32 => numbers,
        _ => numbers.to_kind(Kind::Float).g_div_scalar_(f64::from(u8::MAX)),
    }
}
