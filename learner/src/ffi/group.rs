//! A process group of libtorch's (`group.cpp`): several processes that meet, at a file of their machine or in the first
//! one's store, and add numbers up.
//!
//! Everybody makes the same calls in the same order, or all wait until their patience is over. A group in which a
//! member dies is dead.

use super::guarded;
use std::ffi::{CString, c_char, c_int, c_void};
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;
use tch::{TchError, Tensor};
use torch_sys::C_tensor;

type Handle = *mut c_void;

unsafe extern "C" {
    fn stillroom_group_open(
        path: *const c_char,
        rank: c_int,
        size: c_int,
        joining_ms: i64,
        patience_ms: i64,
        group: *mut Handle,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_group_meet(
        host: *const c_char,
        port: u16,
        listener: c_int,
        key: *const c_char,
        address: *const c_char,
        rank: c_int,
        size: c_int,
        joining_ms: i64,
        patience_ms: i64,
        group: *mut Handle,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_group_broadcast(
        group: Handle,
        tensor: *const C_tensor,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_group_close(group: Handle);
    fn stillroom_group_sum(group: Handle, tensor: *const C_tensor, message: *mut c_char, capacity: usize) -> c_int;
    fn stillroom_group_send(
        group: Handle,
        tensor: *const C_tensor,
        to: c_int,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_group_receive(
        group: Handle,
        tensor: *const C_tensor,
        from: c_int,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_group_note(
        group: Handle,
        key: *const c_char,
        bytes: *const u8,
        length: usize,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_group_noted(
        group: Handle,
        key: *const c_char,
        noted: *mut bool,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
    fn stillroom_group_read(
        group: Handle,
        key: *const c_char,
        bytes: *mut u8,
        length: usize,
        message: *mut c_char,
        capacity: usize,
    ) -> c_int;
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Meeting {
    /// At a new file of their machine.
    File(PathBuf),
    /// In the first member's store, over a network.
    Network {
        store: SocketAddr,
        /// The first member's descriptor of the socket that listens there.
        listener: Option<i32>,
        /// This machine's own address: Gloo listens nowhere else.
        own: IpAddr,
        /// What all keys in the store begin with.
        key: String,
    },
}

#[derive(Debug)]
pub struct ProcessGroup(Handle);

// SAFETY: c10d's group is used from any thread, from one at a time.
unsafe impl Send for ProcessGroup {}

impl ProcessGroup {
    /// Joins a group of `size` members; each has its own rank. Fails if not all members join within `joining`, or if a
    /// later operation takes longer than `patience`.
    pub fn join(
        meeting: &Meeting,
        [rank, size]: [u32; 2],
        [joining, patience]: [Duration; 2],
    ) -> Result<Self, TchError> {
        let [rank, size] = [rank, size].map(|number| number as c_int);
        let [joining, patience] = [joining, patience].map(|time| time.as_millis().min(i64::MAX as u128) as i64);
        let mut group = std::ptr::null_mut();
        let out = &raw mut group;
        match meeting {
            Meeting::File(path) => {
                let path = text(&path.to_string_lossy())?;
                guarded(|message, capacity| {
                    // SAFETY: a C string that outlives the call; the out-pointer and the message's room are ours.
                    unsafe {
                        stillroom_group_open(path.as_ptr(), rank, size, joining, patience, out, message, capacity)
                    }
                })?;
            }
            Meeting::Network { store, listener, own, key } => {
                let (host, own, key) = (text(&store.ip().to_string())?, text(&own.to_string())?, text(key)?);
                let (host, own, key) = (host.as_ptr(), own.as_ptr(), key.as_ptr());
                let (port, listener) = (store.port(), listener.unwrap_or(-1));
                guarded(|message, capacity| {
                    // SAFETY: C strings that outlive the call; the out-pointer and the message's room are ours. The
                    // store takes the descriptor over: nobody else in this process uses it.
                    unsafe {
                        stillroom_group_meet(
                            host, port, listener, key, own, rank, size, joining, patience, out, message, capacity,
                        )
                    }
                })?;
            }
        }
        Ok(Self(group))
    }

    /// Replaces a contiguous tensor on the CPU by its sum over all members: the same bits everywhere.
    pub fn sum(&self, tensor: &mut Tensor) -> Result<(), TchError> {
        // SAFETY: the group lives as long as `self`, the tensor through the call; the message's room is ours.
        guarded(|message, capacity| unsafe { stillroom_group_sum(self.0, tensor.as_ptr(), message, capacity) })
    }

    /// Replaces a contiguous tensor on the CPU by the first member's, of the same size and kind.
    pub fn broadcast(&self, tensor: &mut Tensor) -> Result<(), TchError> {
        // SAFETY: as in `sum`.
        guarded(|message, capacity| unsafe { stillroom_group_broadcast(self.0, tensor.as_ptr(), message, capacity) })
    }

    /// Sends a contiguous tensor on the CPU to another member, who receives one of the same size and kind.
    pub fn send(&self, tensor: &Tensor, to: u32) -> Result<(), TchError> {
        guarded(|message, capacity| {
            // SAFETY: as in `sum`.
            unsafe { stillroom_group_send(self.0, tensor.as_ptr(), to as c_int, message, capacity) }
        })
    }

    pub fn receive(&self, tensor: &mut Tensor, from: u32) -> Result<(), TchError> {
        guarded(|message, capacity| {
            // SAFETY: as in `sum`.
            unsafe { stillroom_group_receive(self.0, tensor.as_ptr(), from as c_int, message, capacity) }
        })
    }

    /// Writes a note that all can read.
    pub fn note(&self, key: &str, bytes: &[u8]) -> Result<(), TchError> {
        let key = text(key)?;
        guarded(|message, capacity| {
            // SAFETY: the group lives as long as `self`, key and bytes through the call; the message's room is ours.
            unsafe { stillroom_group_note(self.0, key.as_ptr(), bytes.as_ptr(), bytes.len(), message, capacity) }
        })
    }

    /// Whether a note has been written. Waits for nothing.
    pub fn noted(&self, key: &str) -> Result<bool, TchError> {
        let (key, mut noted) = (text(key)?, false);
        guarded(|message, capacity| {
            // SAFETY: as in `note`; the out-pointer is ours.
            unsafe { stillroom_group_noted(self.0, key.as_ptr(), &raw mut noted, message, capacity) }
        })?;
        Ok(noted)
    }

    /// Waits for a note that fills `bytes`, and reads it.
    pub fn read(&self, key: &str, bytes: &mut [u8]) -> Result<(), TchError> {
        let key = text(key)?;
        guarded(|message, capacity| {
            // SAFETY: as in `note`; the buffer has the requested size.
            unsafe { stillroom_group_read(self.0, key.as_ptr(), bytes.as_mut_ptr(), bytes.len(), message, capacity) }
        })
    }
}

impl Drop for ProcessGroup {
    fn drop(&mut self) {
        // SAFETY: it was opened in `join` and is not used afterwards.
        unsafe { stillroom_group_close(self.0) }
    }
}

fn text(text: &str) -> Result<CString, TchError> {
    CString::new(text).map_err(|_| TchError::Torch(format!("`{text}` holds a zero byte")))
}
