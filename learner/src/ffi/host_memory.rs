//! Shared memory that a GPU reads itself: mappings of actors' frames, registered with the driver.
//!
//! iceoryx2 maps a publisher's segment when it connects and keeps it as long as the publisher lives. There is no public
//! base address, so the mapping is looked up in the kernel's list. A mapping that is gone stays registered until
//! [`HostMemory::recheck`]: it must be called before frames of an actor that has started again are read, because their
//! segment may lie where another one lay.
//!
//! The driver refuses to register memory twice in one process: of two [`HostMemory`], the second cannot register what the
//! first has registered (CUDA error 712). Memory may be registered while another thread records a graph, because a
//! recording is of its own thread alone (`graph.cpp`).

use super::cuda::{CudaError, succeed};
use super::library::{Handle, function, open};
use proto::fault;
use std::ffi::{c_int, c_uint};
use std::ops::Range;
use std::path::Path;
use wire::SHARED_MEMORY;

/// `CU_MEMHOSTREGISTER_DEVICEMAP` and `CU_MEMHOSTREGISTER_READ_ONLY`: a subscriber's mapping cannot be written.
const READ_BY_DEVICE: c_uint = 2 | 8;

type Register = unsafe extern "C" fn(Handle, usize, c_uint) -> c_int;
type Unregister = unsafe extern "C" fn(Handle) -> c_int;
type DevicePointer = unsafe extern "C" fn(*mut u64, Handle, c_uint) -> c_int;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unreadable {
    #[error("no file is mapped there")]
    NoFile,
    #[error("they lie in {file}, not in {SHARED_MEMORY}")]
    NotShared { file: String },
    #[error("{file}: {error}")]
    Refused { file: String, error: CudaError },
    #[error("{file} has address {on_device:#x} on the GPU and {here:#x} in this process")]
    Elsewhere {
        file: String,
        on_device: u64,
        /// The mapping's address.
        here: u64,
    },
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Mapping {
    addresses: Range<usize>,
    device_inode: String,
    file: String,
}

impl Mapping {
    fn covers(&self, address: usize, bytes: usize) -> bool {
        self.addresses.start <= address && address + bytes <= self.addresses.end
    }
}

#[derive(Debug)]
pub struct HostMemory {
    register: Register,
    unregister: Unregister,
    device_pointer: DevicePointer,
    registered: Vec<Mapping>,
    /// Mappings that cannot be registered, so that they are not tried again.
    refused: Vec<(Mapping, Unreadable)>,
}

impl HostMemory {
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

    /// Lets the device read these bytes, and registers their mapping if necessary. The error says why it cannot.
    pub fn admit(&mut self, address: usize, bytes: usize) -> Result<(), Unreadable> {
        if self.registered.iter().any(|mapping| mapping.covers(address, bytes)) {
            return Ok(());
        }
        if let Some((_, why)) = self.refused.iter().find(|(mapping, _)| mapping.covers(address, bytes)) {
            return Err(why.clone());
        }
        let mapping = mapping_of(address, bytes)?;
        let admitted = shared(&mapping).and_then(|()| self.register(&mapping));
        match &admitted {
            Ok(()) => self.registered.push(mapping),
            Err(why) => {
                tracing::debug!("the GPU cannot read frames where they are: {why}");
                self.refused.push((mapping, why.clone()));
            }
        }
        admitted
    }

    fn register(&self, Mapping { addresses, file, .. }: &Mapping) -> Result<(), Unreadable> {
        let start = addresses.start as Handle;
        // With 0 bytes the driver refuses (CUDA error 1, as seen on an H100).
        let bytes = if fault::fails("learner.host_memory") { 0 } else { addresses.len() };
        // SAFETY: a mapping of this process; the driver checks it. It is unregistered when it is gone, or with the
        // process.
        let code = unsafe { (self.register)(start, bytes, READ_BY_DEVICE) };
        let refused = |error| Unreadable::Refused { file: file.clone(), error };
        succeed("cuMemHostRegister", code).map_err(refused)?;
        let mut on_device = 0;
        // SAFETY: registered above; the out-pointer is ours.
        let code = unsafe { (self.device_pointer)(&raw mut on_device, start, 0) };
        let here = addresses.start as u64;
        let found = succeed("cuMemHostGetDevicePointer", code).map_err(refused).and_then(|()| {
            let same = on_device == here;
            same.then_some(()).ok_or_else(|| Unreadable::Elsewhere { file: file.clone(), on_device, here })
        });
        if found.is_err() {
            // SAFETY: registered above.
            let _ = unsafe { (self.unregister)(start) };
        }
        found
    }

    /// Forgets mappings that are not there any more, or are of another file now.
    pub fn recheck(&mut self) {
        let present = mappings();
        self.refused.clear();
        let unregister = self.unregister;
        self.registered.retain(|mapping| {
            let kept = present.contains(mapping);
            if !kept {
                // SAFETY: registered once, and not used afterwards.
                let code = unsafe { unregister(mapping.addresses.start as Handle) };
                if let Err(error) = succeed("cuMemHostUnregister", code) {
                    tracing::debug!("{}: {error}", mapping.file);
                }
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

/// The mapping in which these bytes lie.
fn mapping_of(address: usize, bytes: usize) -> Result<Mapping, Unreadable> {
    mappings().into_iter().find(|mapping| mapping.covers(address, bytes)).ok_or(Unreadable::NoFile)
}

fn shared(mapping: &Mapping) -> Result<(), Unreadable> {
    // The kernel's list has paths without links.
    let folder = std::fs::canonicalize(SHARED_MEMORY).unwrap_or_else(|_| SHARED_MEMORY.into());
    let file = &mapping.file;
    let shared = Path::new(file).starts_with(folder);
    shared.then_some(()).ok_or_else(|| Unreadable::NotShared { file: file.clone() })
}

fn mappings() -> Vec<Mapping> {
    let list = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    list.lines().filter_map(parse).collect()
}

/// A line: `START-END permissions offset device inode path`, numbers in hexadecimal.
fn parse(line: &str) -> Option<Mapping> {
    let (columns, path) = line.split_once('/')?;
    let mut columns = columns.split_whitespace();
    let (start, end) = columns.next()?.split_once('-')?;
    let address = |text| usize::from_str_radix(text, 16).ok();
    let device_inode = columns.skip(2).collect::<Vec<_>>().join(" ");
    Some(Mapping { addresses: address(start)?..address(end)?, device_inode, file: format!("/{path}") })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::Frames;
    use proto::camera::DepthFrame;
    use proto::config::Config;

    #[test]
    fn a_line_of_the_kernels_list() {
        let mapping =
            parse("7f5e9c000000-7f5e9c021000 r--s 00001000 00:19 4242   /dev/shm/some  thing (deleted)").unwrap();
        assert_eq!(mapping.addresses, 0x7f5e_9c00_0000..0x7f5e_9c02_1000);
        assert_eq!([mapping.device_inode, mapping.file], ["00:19 4242", "/dev/shm/some  thing (deleted)"]);
        assert_eq!(parse("7ffd0000-7ffd1000 rw-p 00000000 00:00 0"), None);
        assert_eq!(parse("nonsense"), None);
    }

    #[test]
    fn this_program_is_mapped_and_is_no_shared_memory() {
        let address = parse as *const () as usize;
        let mapping = mapping_of(address, 1).unwrap();
        assert_eq!(shared(&mapping), Err(Unreadable::NotShared { file: mapping.file.clone() }));
        let stack = [0u8; 16];
        assert_eq!(mapping_of(stack.as_ptr() as usize, stack.len()), Err(Unreadable::NoFile));
    }

    #[test]
    fn frames_lie_in_a_mapping_of_shared_memory_for_each_actor() {
        let mut config = Config::resolve("recipe", None).unwrap();
        (config.actors.count, config.actors.environments_per_actor) = (2, 4);
        let frames = Frames::new(&config).unwrap();
        let mut found = vec![];
        for half in [0, 1] {
            let batch = frames.batch(half, 0, vec![]);
            let bytes = |frame: &DepthFrame| {
                let numbers = frame.numbers();
                (numbers.as_ptr() as usize, size_of_val(numbers))
            };
            found.extend(batch.input().frames.iter().map(bytes).map(|(at, size)| mapping_of(at, size).unwrap()));
        }
        assert!(found.iter().all(|mapping| shared(mapping).is_ok()), "{found:#?}");
        assert_eq!(found.len(), 8);
        found.sort_by_key(|mapping| mapping.addresses.start);
        found.dedup();
        assert_eq!(found.len(), 2, "{found:#?}");
    }
}
