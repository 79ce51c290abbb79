//! What a profiler is to look at: `ncu --profile-from-start off` begins and ends where it is told to here.

use super::cuda::{CudaError, succeed};
use super::library::{function, open};
use std::ffi::c_int;

type Mark = unsafe extern "C" fn() -> c_int;

/// Does something that a profiler looks at. Without a profiler it is just done. libtorch must have made a tensor on the
/// device before.
pub fn profiled<T>(work: impl FnOnce() -> T) -> Result<T, CudaError> {
    let library = open(&[c"libcuda.so.1"])?;
    let start = function!(library, c"cuProfilerStart" as Mark);
    let stop = function!(library, c"cuProfilerStop" as Mark);
    // SAFETY: the driver is initialised and has a context, because libtorch has made a tensor there.
    succeed("cuProfilerStart", unsafe { start() })?;
    let result = work();
    // SAFETY: as above.
    succeed("cuProfilerStop", unsafe { stop() })?;
    Ok(result)
}
