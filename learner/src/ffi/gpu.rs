//! What the driver and its management library tell of a GPU: where it is on the bus, how busy it is, how much of its
//! memory is taken. Both are loaded when they are first asked; nothing is computed.

use super::library::{Handle, LibraryError, function, open};
use std::ffi::{CString, c_char, c_int, c_uint};

type GetPciBusId = unsafe extern "C" fn(*mut c_char, c_int, c_int) -> c_int;
type Initialise = unsafe extern "C" fn() -> c_int;
type HandleByPciBusId = unsafe extern "C" fn(*const c_char, *mut Handle) -> c_int;
type UtilisationRates = unsafe extern "C" fn(Handle, *mut Rates) -> c_int;
type MemoryInfo = unsafe extern "C" fn(Handle, *mut Memory) -> c_int;

/// `nvmlUtilization_t`: percent of the last sampling period.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
struct Rates {
    gpu: c_uint,
    memory: c_uint,
}

/// `nvmlMemory_t`, bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default)]
struct Memory {
    total: u64,
    free: u64,
    used: u64,
}

#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    #[error(transparent)]
    Library(#[from] LibraryError),
    #[error("{call}: error {code}")]
    Refused {
        call: &'static str,
        /// Its number, see `nvmlReturn_t` and `CUresult`.
        code: c_int,
    },
}

/// Address of a CUDA device on the PCI bus, as sysfs names it: `0000:0f:00.0`. None if the driver does not tell.
pub fn pci_address(device: usize) -> Option<String> {
    ask_pci_address(device).inspect_err(|error| tracing::debug!("GPU {device} has no address: {error}")).ok()
}

fn ask_pci_address(device: usize) -> Result<String, WatchError> {
    let library = open(&[c"libcuda.so.1"])?;
    let get = function!(library, c"cuDeviceGetPCIBusId" as GetPciBusId);
    let mut text: [c_char; 32] = [0; 32];
    // SAFETY: the driver writes at most so many characters, the last one 0.
    let code = unsafe { get(text.as_mut_ptr(), text.len() as c_int, device as c_int) };
    if code != 0 {
        return Err(WatchError::Refused { call: "cuDeviceGetPCIBusId", code });
    }
    let bytes: Vec<u8> = text.iter().map(|&byte| byte as u8).take_while(|&byte| byte != 0).collect();
    Ok(String::from_utf8_lossy(&bytes).to_lowercase())
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Share of the last fraction of a second in which a kernel ran, 0..1.
    pub busy: f64,
    /// Memory taken by all processes, bytes.
    pub memory: u64,
}

/// A GPU that is watched through NVML, from any thread: the library is thread-safe.
#[derive(Debug)]
pub struct Watch {
    device: usize,
    rates: UtilisationRates,
    memory: MemoryInfo,
}

impl Watch {
    pub fn open(pci: &str) -> Result<Self, WatchError> {
        let library = open(&[c"libnvidia-ml.so.1"])?;
        let initialise = function!(library, c"nvmlInit_v2" as Initialise);
        let find = function!(library, c"nvmlDeviceGetHandleByPciBusId_v2" as HandleByPciBusId);
        let address = CString::new(pci).unwrap_or_default();
        let mut device: Handle = std::ptr::null_mut();
        // SAFETY: as the header declares it. It is never shut down: the process ends soon.
        check("nvmlInit_v2", unsafe { initialise() })?;
        // SAFETY: a C string, and room for the handle.
        check("nvmlDeviceGetHandleByPciBusId_v2", unsafe { find(address.as_ptr(), &raw mut device) })?;
        Ok(Self {
            // As a number: it only goes back to the library, maybe from another thread.
            device: device.expose_provenance(),
            rates: function!(library, c"nvmlDeviceGetUtilizationRates" as UtilisationRates),
            memory: function!(library, c"nvmlDeviceGetMemoryInfo" as MemoryInfo),
        })
    }

    pub fn read(&self) -> Result<Reading, WatchError> {
        let device = std::ptr::with_exposed_provenance_mut(self.device);
        let (mut rates, mut memory) = (Rates::default(), Memory::default());
        // SAFETY: the library's own handle, and room for its structures.
        check("nvmlDeviceGetUtilizationRates", unsafe { (self.rates)(device, &raw mut rates) })?;
        // SAFETY: the same.
        check("nvmlDeviceGetMemoryInfo", unsafe { (self.memory)(device, &raw mut memory) })?;
        Ok(Reading { busy: f64::from(rates.gpu) / 100.0, memory: memory.used })
    }
}

fn check(call: &'static str, code: c_int) -> Result<(), WatchError> {
    if code == 0 { Ok(()) } else { Err(WatchError::Refused { call, code }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_driver_there_is_no_address_and_nothing_to_watch() {
        if crate::ffi::library::open(&[c"libnvidia-ml.so.1"]).is_ok() {
            assert!(Watch::open("ffff:ff:1f.7").is_err());
            return;
        }
        assert_eq!(pci_address(0), None);
        let message = Watch::open("0000:0f:00.0").unwrap_err().to_string();
        assert!(message.contains("libnvidia-ml.so.1 cannot be loaded"), "{message}");
    }
}
