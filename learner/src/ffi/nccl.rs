//! NCCL: sums over GPUs. Its C interface, from the library that libtorch brings. Everything happens on the stream
//! that this thread uses, so a sum is in order with what made the numbers and with what uses them.

use super::cuda::{CudaError, stream};
use super::library::{Handle, LibraryError, function, open};
use super::stopwatch::Stopwatch;
use std::ffi::{CStr, c_char, c_int, c_void};
use tch::{Kind, Tensor};

/// What the first member makes and all need to find one another.
pub type Invitation = [u8; 128];

#[derive(Debug, thiserror::Error)]
pub enum NcclError {
    #[error(transparent)]
    Library(#[from] LibraryError),
    #[error(transparent)]
    Driver(#[from] CudaError),
    #[error("{call}: {reason}")]
    Refused { call: &'static str, reason: String },
}

#[repr(C)]
#[derive(Debug, Clone, Copy)]
struct UniqueId(Invitation);

type GetUniqueId = unsafe extern "C" fn(*mut UniqueId) -> c_int;
type InitRank = unsafe extern "C" fn(*mut Handle, c_int, UniqueId, c_int) -> c_int;
type AllReduce = unsafe extern "C" fn(*const c_void, *mut c_void, usize, c_int, c_int, Handle, Handle) -> c_int;
type ErrorString = unsafe extern "C" fn(c_int) -> *const c_char;

/// `ncclFloat32`, `ncclFloat64` and `ncclSum`.
const FLOAT: c_int = 7;
const DOUBLE: c_int = 8;
const SUM: c_int = 0;

#[derive(Debug, Clone, Copy)]
pub struct Nccl {
    get_unique_id: GetUniqueId,
    init_rank: InitRank,
    all_reduce: AllReduce,
    error_string: ErrorString,
}

/// Membership in a group of GPUs. It is left when the process ends: to leave earlier would wait for the others.
#[derive(Debug)]
pub struct Communicator {
    nccl: Nccl,
    handle: Handle,
    stopwatch: Stopwatch,
}

// SAFETY: NCCL takes a communicator from any thread, from one at a time, and so does the driver the stopwatch's events.
unsafe impl Send for Communicator {}

impl Nccl {
    pub fn open() -> Result<Self, NcclError> {
        let library = open(&[c"libnccl.so.2"])?;
        Ok(Self {
            get_unique_id: function!(library, c"ncclGetUniqueId" as GetUniqueId),
            init_rank: function!(library, c"ncclCommInitRank" as InitRank),
            all_reduce: function!(library, c"ncclAllReduce" as AllReduce),
            error_string: function!(library, c"ncclGetErrorString" as ErrorString),
        })
    }

    /// A new group's invitation.
    pub fn invite(self) -> Result<Invitation, NcclError> {
        let mut id = UniqueId([0; 128]);
        // SAFETY: the out-pointer is ours.
        self.succeed("ncclGetUniqueId", unsafe { (self.get_unique_id)(&raw mut id) })?;
        Ok(id.0)
    }

    /// Joins with the device that is current in libtorch, and waits for the others.
    pub fn join(self, invitation: Invitation, rank: u32, size: u32) -> Result<Communicator, NcclError> {
        let mut handle = std::ptr::null_mut();
        // SAFETY: the out-pointer is ours; the invitation is passed by value, as declared.
        let code = unsafe { (self.init_rank)(&raw mut handle, size as c_int, UniqueId(invitation), rank as c_int) };
        self.succeed("ncclCommInitRank", code)?;
        Ok(Communicator { nccl: self, handle, stopwatch: Stopwatch::open()? })
    }

    fn succeed(self, call: &'static str, code: c_int) -> Result<(), NcclError> {
        if code == 0 {
            return Ok(());
        }
        // SAFETY: it gives a constant C string for every number.
        let reason = unsafe { CStr::from_ptr((self.error_string)(code)) }.to_string_lossy().into_owned();
        Err(NcclError::Refused { call, reason })
    }
}

impl Communicator {
    /// Times parts of the work that this thread gives its stream.
    pub fn stopwatch(&self) -> &Stopwatch {
        &self.stopwatch
    }

    /// Replaces a tensor by its sum over all members, on the device. Nobody waits for it here. Panics if it is not
    /// contiguous, not on a GPU, or not of floats or doubles.
    pub fn sum(&self, tensor: &mut Tensor) -> Result<(), NcclError> {
        let kind = match tensor.kind() {
            Kind::Float => FLOAT,
            Kind::Double => DOUBLE,
            other => panic!("no sum over GPUs of {other:?}"),
        };
        assert!(tensor.device().is_cuda() && tensor.is_contiguous());
        let numbers = tensor.data_ptr();
        // SAFETY: the numbers are the tensor's own; libtorch gives their memory to others only later on this stream.
        let code =
            unsafe { (self.nccl.all_reduce)(numbers, numbers, tensor.numel(), kind, SUM, self.handle, stream()) };
        self.nccl.succeed("ncclAllReduce", code)
    }
}
