//! Shared memory that a GPU reads itself: mappings of actors' frames, registered with the driver.
//!
//! iceoryx2 maps a publisher's segment when it connects and keeps it as long as the publisher lives. There is no public
//! base address, so the mapping is looked up in the kernel's list. A mapping that is gone stays registered until
//! [`HostMemory::recheck`]: it must be called before frames of an actor that has started again are read, because their
//! segment may lie where another one lay.

use super::cuda::{CudaError, succeed};
use super::library::{Handle, function, open};
use std::ffi::{c_int, c_uint};
use std::ops::Range;

/// `CU_MEMHOSTREGISTER_DEVICEMAP` and `CU_MEMHOSTREGISTER_READ_ONLY`: a subscriber's mapping cannot be written.
const READ_BY_DEVICE: c_uint = 2 | 8;

/// Only files in this folder are registered.
const SHARED_MEMORY: &str = "/dev/shm/";

type Register = unsafe extern "C" fn(Handle, usize, c_uint) -> c_int;
type Unregister = unsafe extern "C" fn(Handle) -> c_int;
type DevicePointer = unsafe extern "C" fn(*mut u64, Handle, c_uint) -> c_int;

/// A mapping as the kernel lists it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Mapping {
    addresses: Range<usize>,
    /// Device, inode and path of the file.
    file: String,
}

/// What is registered.
#[derive(Debug)]
pub struct HostMemory {
    register: Register,
    unregister: Unregister,
    device_pointer: DevicePointer,
    registered: Vec<Mapping>,
    /// Mappings that the driver refused, so that they are not tried again.
    refused: Vec<Mapping>,
}

impl HostMemory {
    /// Finds the driver's functions.
    pub fn open() -> Result<Self, CudaError> {
        let library = open(&[c"libcuda.so.1"])?;
        Ok(Self {
            register: function!(library, c"cuMemHostRegister_v2" as Register),
            unregister: function!(library, c"cuMemHostUnregister" as Unregister),
            device_pointer: function!(library, c"cuMemHostGetDevicePointer_v2" as DevicePointer),
            registered: vec![],
            refused: vec![],
        })
    }

    /// Whether the device may read these bytes; their mapping is registered if necessary.
    pub fn covers(&mut self, address: usize, bytes: usize) -> bool {
        let within = |mapping: &Mapping| mapping.addresses.start <= address && address + bytes <= mapping.addresses.end;
        if self.registered.iter().any(within) {
            return true;
        }
        if self.refused.iter().any(within) {
            return false;
        }
        let Some(mapping) = mappings().into_iter().find(within) else { return false };
        let admitted = mapping.file.contains(SHARED_MEMORY) && self.admit(&mapping);
        if admitted { &mut self.registered } else { &mut self.refused }.push(mapping);
        admitted
    }

    fn admit(&self, mapping: &Mapping) -> bool {
        let start = mapping.addresses.start as Handle;
        // SAFETY: a mapping of this process; the driver checks it. It is unregistered when it is gone, or with the
        // process.
        let code = unsafe { (self.register)(start, mapping.addresses.len(), READ_BY_DEVICE) };
        let mut on_device = 0;
        let same = succeed("cuMemHostRegister", code).and_then(|()| {
            // SAFETY: registered above; the out-pointer is ours.
            let code = unsafe { (self.device_pointer)(&raw mut on_device, start, 0) };
            succeed("cuMemHostGetDevicePointer", code).map(|()| on_device == mapping.addresses.start as u64)
        });
        match same {
            Ok(true) => true,
            Ok(false) => {
                // SAFETY: registered above.
                let _ = unsafe { (self.unregister)(start) };
                false
            }
            Err(error) => {
                tracing::debug!("{} cannot be read by the GPU itself: {error}", mapping.file);
                false
            }
        }
    }

    /// Forgets mappings that are not there any more, or are of another file now.
    pub fn recheck(&mut self) {
        let present = mappings();
        self.refused.clear();
        let unregister = self.unregister;
        self.registered.retain(|mapping| {
            let kept = present.contains(mapping);
            if !kept {
                // An error means that the driver has let it go by itself.
                // SAFETY: registered once, and not used afterwards.
                let _ = unsafe { unregister(mapping.addresses.start as Handle) };
            }
            kept
        });
    }
}

impl Drop for HostMemory {
    fn drop(&mut self) {
        for mapping in &self.registered {
            // SAFETY: registered once, and not used afterwards.
            let _ = unsafe { (self.unregister)(mapping.addresses.start as Handle) };
        }
    }
}

/// This process's mappings of files.
fn mappings() -> Vec<Mapping> {
    let list = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    list.lines().filter_map(parse).collect()
}

/// A line: `START-END permissions offset device inode path`, numbers in hexadecimal.
fn parse(line: &str) -> Option<Mapping> {
    let (addresses, rest) = line.split_once(' ')?;
    let (start, end) = addresses.split_once('-')?;
    let address = |text| usize::from_str_radix(text, 16).ok();
    let file = rest.split_whitespace().skip(2).collect::<Vec<_>>().join(" ");
    file.contains('/').then_some(Mapping { addresses: address(start)?..address(end)?, file })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_kernels_list() {
        let mapping =
            parse("7f5e9c000000-7f5e9c021000 r--s 00001000 00:19 4242   /dev/shm/some thing (deleted)").unwrap();
        assert_eq!(mapping.addresses, 0x7f5e_9c00_0000..0x7f5e_9c02_1000);
        assert_eq!(mapping.file, "00:19 4242 /dev/shm/some thing (deleted)");
        assert_eq!(parse("7ffd0000-7ffd1000 rw-p 00000000 00:00 0"), None);
        assert_eq!(parse("nonsense"), None);
    }

    #[test]
    fn this_program_is_mapped() {
        let address = parse as *const () as usize;
        assert!(mappings().iter().any(|mapping| mapping.addresses.contains(&address)));
    }
}
