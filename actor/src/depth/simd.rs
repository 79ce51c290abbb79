//! The unsafe code of the depth camera.

use std::mem::MaybeUninit;

/// Declares a frame written. The caller has written every element: it is `Raster::finish`, whose loops cover rows
/// and columns without remainder.
pub fn assume_written(frame: &mut [MaybeUninit<u16>]) -> &[u16] {
    // SAFETY: MaybeUninit<u16> has the layout of u16, and every element was written.
    unsafe { &*(std::ptr::from_mut(frame) as *const [u16]) }
}

/// Written memory as memory that need not be.
pub fn as_unwritten(frame: &mut [u16]) -> &mut [MaybeUninit<u16>] {
    // SAFETY: MaybeUninit<u16> has the layout of u16. This module's callers only write initialised values to it.
    unsafe { &mut *(std::ptr::from_mut(frame) as *mut [MaybeUninit<u16>]) }
}
