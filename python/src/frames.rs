//! Depth frames of all environments in one array of numpy, in either of two units.

use numpy::{PyArray3, PyArrayMethods, PyReadwriteArray3};
use pyo3::prelude::*;
use simulator::depth::DepthCamera;
use simulator::environment::Base;

/// The frames' array: environments, rows, columns.
pub enum Frames {
    /// 16-bit millimetres, 0 where nothing is seen.
    Millimetres(Py<PyArray3<u16>>),
    /// Metres, 0 where nothing is seen.
    Metres(Py<PyArray3<f32>>),
}

pub enum Writing<'py> {
    Millimetres(PyReadwriteArray3<'py, u16>),
    Metres(PyReadwriteArray3<'py, f32>),
}

pub enum Frame<'a> {
    Millimetres(&'a mut [u16]),
    Metres(&'a mut [f32]),
}

impl Frames {
    pub fn new(py: Python<'_>, count: usize, side: usize, in_metres: bool) -> Self {
        let shape = [count, side, side];
        if in_metres {
            Self::Metres(PyArray3::zeros(py, shape, false).unbind())
        } else {
            Self::Millimetres(PyArray3::zeros(py, shape, false).unbind())
        }
    }

    pub fn array(&self, py: Python<'_>) -> Py<PyAny> {
        match self {
            Self::Millimetres(array) => array.clone_ref(py).into_any(),
            Self::Metres(array) => array.clone_ref(py).into_any(),
        }
    }

    pub fn write<'py>(&self, py: Python<'py>) -> PyResult<Writing<'py>> {
        Ok(match self {
            Self::Millimetres(array) => Writing::Millimetres(array.bind(py).try_readwrite()?),
            Self::Metres(array) => Writing::Metres(array.bind(py).try_readwrite()?),
        })
    }
}

impl Writing<'_> {
    /// A frame for each environment, in order.
    pub fn frames(&mut self, pixels: usize) -> PyResult<Vec<Frame<'_>>> {
        Ok(match self {
            Self::Millimetres(array) => {
                array.as_slice_mut()?.chunks_exact_mut(pixels).map(Frame::Millimetres).collect()
            }
            Self::Metres(array) => array.as_slice_mut()?.chunks_exact_mut(pixels).map(Frame::Metres).collect(),
        })
    }
}

impl Frame<'_> {
    /// Renders what the environment's head camera sees. `scratch` is memory that is used in passing.
    pub fn take(&mut self, environment: &mut Base, camera: &mut DepthCamera, side: usize, scratch: &mut Vec<u16>) {
        match self {
            Frame::Millimetres(depth_mm) => environment.look(camera, side, depth_mm),
            Frame::Metres(depth_m) => {
                scratch.resize(side * side, 0);
                environment.look(camera, side, scratch);
                for (metres, &millimetres) in depth_m.iter_mut().zip(scratch.iter()) {
                    *metres = f32::from(millimetres) / 1000.0;
                }
            }
        }
    }
}
