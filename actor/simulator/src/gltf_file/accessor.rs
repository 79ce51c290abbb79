//! What accessors say of buffers: which bytes are corners and vertices. Nothing in a file is trusted: what reaches
//! beyond its data is an error.

use super::extensions;
use super::json::{Accessor, Root, SparsePart};
use std::collections::BTreeMap;

const OUTSIDE: &str = "has a mesh whose data reach beyond their buffer";
const FLOAT: u32 = 5126;

#[derive(Debug)]
pub struct Data {
    pub root: Root,
    pub buffers: Vec<Vec<u8>>,
}

struct Values<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

impl<'a> Values<'a> {
    fn get(&self, index: usize) -> &'a [u8] {
        &self.bytes[index * self.stride..][..self.size]
    }
}

impl Data {
    pub fn counts(&self, accessor: usize) -> Result<[usize; 2], &'static str> {
        let accessor = self.accessor(accessor)?;
        Ok([accessor.count, accessor.sparse.as_ref().map_or(0, |sparse| sparse.count)])
    }

    pub fn corners(&self, accessor: usize) -> Result<Vec<u32>, &'static str> {
        let accessor = self.accessor(accessor)?;
        let size = whole_number_size(accessor.component_type).filter(|_| accessor.shape == "SCALAR");
        let size = size.ok_or("has a mesh whose corners are not whole numbers")?;
        let every: Vec<u32> = (0..accessor.count as u32).collect();
        Ok(self.values(accessor, size, &every)?.into_iter().map(whole_number).collect())
    }

    /// Some of the vectors of three: positions, or what is added to them.
    pub fn vectors(&self, accessor: usize, wanted: &[u32]) -> Result<Vec<[f32; 3]>, &'static str> {
        let accessor = self.accessor(accessor)?;
        let kind = accessor.component_type;
        let quantised = extensions::quantises(&self.root);
        let (size, most) = match kind {
            FLOAT => (4, None),
            5120 if quantised => (1, Some(127.0)),
            5121 if quantised => (1, Some(255.0)),
            5122 if quantised => (2, Some(32767.0)),
            5123 if quantised => (2, Some(65535.0)),
            _ => return Err("has a mesh whose positions are not three 32-bit floating-point numbers each"),
        };
        if accessor.shape != "VEC3" {
            return Err("has a mesh whose positions are not three 32-bit floating-point numbers each");
        }
        let number = |bytes: &[u8]| {
            let number = match (kind, bytes) {
                (FLOAT, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
                (5120, &[a]) => f32::from(a as i8),
                (5122, &[a, b]) => f32::from(i16::from_le_bytes([a, b])),
                _ => whole_number(bytes) as f32,
            };
            most.filter(|_| accessor.normalized).map_or(number, |most| (number / most).max(-1.0))
        };
        let vectors = self.values(accessor, 3 * size, wanted)?;
        Ok(vectors.into_iter().map(|bytes| [0, 1, 2].map(|i| number(&bytes[i * size..][..size]))).collect())
    }

    fn accessor(&self, index: usize) -> Result<&Accessor, &'static str> {
        self.root.accessors.get(index).ok_or("has a mesh that names an accessor which is not there")
    }

    /// The bytes of some of an accessor's values.
    fn values(&self, accessor: &Accessor, size: usize, wanted: &[u32]) -> Result<Vec<&[u8]>, &'static str> {
        const ZERO: [u8; 12] = [0; 12];
        let count = accessor.count;
        let plain = accessor.buffer_view.map(|view| self.range(view, accessor.byte_offset, count, size)).transpose()?;
        let mut sparse = BTreeMap::new();
        if let Some(own) = &accessor.sparse {
            if own.count == 0 || own.count > count {
                return Err("has a mesh with more sparse values than values, or none");
            }
            let index_size = whole_number_size(own.indices.component_type);
            let index_size = index_size.ok_or("has a mesh whose sparse indices are not whole numbers")?;
            let part = |part: &SparsePart, size| self.range(part.buffer_view, part.byte_offset, own.count, size);
            let (indices, values) = (part(&own.indices, index_size)?, part(&own.values, size)?);
            sparse.extend((0..own.count).map(|i| (whole_number(indices.get(i)), values.get(i))));
        } else if plain.is_none() {
            return Err("has a mesh whose data are nowhere, or compressed: export it again without compression");
        }
        let value = |&index: &u32| {
            if index as usize >= count {
                return Err("has a mesh with a corner that is no vertex");
            }
            let plain = || plain.as_ref().map_or(&ZERO[..size], |plain| plain.get(index as usize));
            Ok(sparse.get(&index).copied().unwrap_or_else(plain))
        };
        wanted.iter().map(value).collect()
    }

    /// `count` values of `size` bytes in a view.
    fn range(&self, view: usize, offset: usize, count: usize, size: usize) -> Result<Values<'_>, &'static str> {
        let view = self.root.buffer_views.get(view).ok_or(OUTSIDE)?;
        let stride = view.byte_stride.unwrap_or(size);
        if stride < size || stride > 252 {
            return Err("has a mesh whose values overlap, or lie more than 252 bytes apart (byteStride)");
        }
        let last = count.checked_sub(1).ok_or("has a mesh with nothing in it")?;
        let end = view.byte_offset.checked_add(view.byte_length).ok_or(OUTSIDE)?;
        let bytes = self.buffers.get(view.buffer).and_then(|buffer| buffer.get(view.byte_offset..end)?.get(offset..));
        let bytes = bytes.ok_or(OUTSIDE)?;
        let needed = last.checked_mul(stride).and_then(|last| last.checked_add(size)).ok_or(OUTSIDE)?;
        if bytes.len() >= needed { Ok(Values { bytes, stride, size }) } else { Err(OUTSIDE) }
    }
}

fn whole_number_size(component_type: u32) -> Option<usize> {
    match component_type {
        5121 => Some(1),
        5123 => Some(2),
        5125 => Some(4),
        _ => None,
    }
}

/// One of up to four bytes.
fn whole_number(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u32::from(byte))
}
