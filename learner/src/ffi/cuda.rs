//! Kernels of our own: CUDA C++ compiled at run time by NVRTC and launched through the driver. Both libraries are
//! loaded at first use. Neither building nor running needs a CUDA toolkit, because libtorch ships NVRTC.
//!
//! Everything happens in the context and on the stream that libtorch uses: the device's primary context, and its
//! default stream, except while a graph is recorded ([`super::graph`]) and on threads that have taken another one
//! ([`super::stream`]). So launches are ordered with libtorch's. Dropping a tensor while a kernel uses it is safe: the
//! allocator reuses the memory only for later work on the same stream.
//!
//! By hand, because cudarc (0.19) does not fit. It loads NVRTC by a list of names that begins with `libnvrtc.so`,
//! whichever the machine has, and panics without one; we need the one beside libtorch, and an error. It compiles to
//! PTX, which the driver compiles once more and refuses where it is older than NVRTC; we load machine code. A launch is
//! unsafe there too.

use super::library::{Handle, LibraryError, function, open};
use std::cell::Cell;
use std::ffi::{CStr, CString, c_char, c_int, c_uint, c_void};
use std::ptr::{null, null_mut};

thread_local! {
    /// The stream that launches go to; null = the default stream.
    static STREAM: Cell<Handle> = const { Cell::new(null_mut()) };
}

/// Runs `body` with its launches on another stream than the default one; libtorch must use the same one meanwhile.
pub(super) fn on_stream<T>(stream: Handle, body: impl FnOnce() -> T) -> T {
    let before = STREAM.replace(stream);
    let result = body();
    STREAM.set(before);
    result
}

/// The stream that this thread's launches go to; null = the default stream.
pub(super) fn stream() -> Handle {
    STREAM.get()
}

/// Sends this thread's launches there from now on; libtorch must use the same stream.
pub(super) fn set_stream(stream: Handle) {
    STREAM.set(stream);
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CudaError {
    #[error(transparent)]
    Library(#[from] LibraryError),
    #[error("NVRTC: {0}")]
    Compilation(String),
    #[error("{call}: CUDA error {code}")]
    Driver {
        call: &'static str,
        /// The driver's number, see `CUresult`.
        code: c_int,
    },
}

#[derive(Debug, Clone, Copy)]
pub enum Argument {
    /// An address on the device; 0 = none.
    Address(u64),
    Int(i32),
    Float(f32),
}

/// Compiled source, in the device's memory for as long as the process lives.
#[derive(Debug)]
pub struct Module {
    driver: Driver,
    module: Handle,
}

#[derive(Debug, Clone, Copy)]
pub struct Kernel {
    launch: LaunchKernel,
    function: Handle,
    /// Shared memory that a block gets besides what the source declares, bytes.
    shared_bytes: u32,
}

// SAFETY: a function of a module that is never unloaded; the driver launches it from any thread.
unsafe impl Send for Kernel {}

type LaunchKernel = unsafe extern "C" fn(
    Handle,
    c_uint,
    c_uint,
    c_uint,
    c_uint,
    c_uint,
    c_uint,
    c_uint,
    Handle,
    *mut *mut c_void,
    *mut *mut c_void,
) -> c_int;

#[derive(Debug, Clone, Copy)]
struct Driver {
    attribute: DeviceAttribute,
    load: ModuleLoad,
    function: ModuleFunction,
    launch: LaunchKernel,
    set: SetFunctionAttribute,
}

type DeviceAttribute = unsafe extern "C" fn(*mut c_int, c_int, c_int) -> c_int;
type ModuleLoad = unsafe extern "C" fn(*mut Handle, *const c_void) -> c_int;
type ModuleFunction = unsafe extern "C" fn(*mut Handle, Handle, *const c_char) -> c_int;
type SetFunctionAttribute = unsafe extern "C" fn(Handle, c_int, c_int) -> c_int;

#[derive(Debug, Clone, Copy)]
struct Nvrtc {
    create: CreateProgram,
    compile: CompileProgram,
    log_size: ResultSize,
    log: ReadResult,
    cubin_size: ResultSize,
    cubin: ReadResult,
    destroy: DestroyProgram,
}

type CreateProgram = unsafe extern "C" fn(
    *mut Handle,
    *const c_char,
    *const c_char,
    c_int,
    *const *const c_char,
    *const *const c_char,
) -> c_int;
type CompileProgram = unsafe extern "C" fn(Handle, c_int, *const *const c_char) -> c_int;
type ResultSize = unsafe extern "C" fn(Handle, *mut usize) -> c_int;
type ReadResult = unsafe extern "C" fn(Handle, *mut c_char) -> c_int;
type DestroyProgram = unsafe extern "C" fn(*mut Handle) -> c_int;

impl Driver {
    fn open() -> Result<Self, CudaError> {
        let library = open(&[c"libcuda.so.1"])?;
        Ok(Self {
            attribute: function!(library, c"cuDeviceGetAttribute" as DeviceAttribute),
            load: function!(library, c"cuModuleLoadData" as ModuleLoad),
            function: function!(library, c"cuModuleGetFunction" as ModuleFunction),
            launch: function!(library, c"cuLaunchKernel" as LaunchKernel),
            set: function!(library, c"cuFuncSetAttribute" as SetFunctionAttribute),
        })
    }

    /// A number that the first device says of itself, see `CUdevice_attribute`.
    fn attribute(self, attribute: c_int) -> Result<c_int, CudaError> {
        let mut value = 0;
        // SAFETY: the driver is initialised, because libtorch has made a tensor there; the out-pointer is ours.
        succeed("cuDeviceGetAttribute", unsafe { (self.attribute)(&raw mut value, attribute, 0) }).map(|()| value)
    }

    /// Compute capability of the first device, as NVRTC names it: `sm_90`.
    fn architecture(self) -> Result<CString, CudaError> {
        const MAJOR: c_int = 75;
        const MINOR: c_int = 76;
        let name = format!("--gpu-architecture=sm_{}{}", self.attribute(MAJOR)?, self.attribute(MINOR)?);
        Ok(CString::new(name).expect("digits have no zero byte"))
    }
}

impl Nvrtc {
    fn open() -> Result<Self, CudaError> {
        // The first library is beside libtorch and loads NVRTC; NVRTC's symbols are found through it.
        let library = open(&[c"libcaffe2_nvrtc.so", c"libnvrtc.so.13", c"libnvrtc.so.12"])?;
        Ok(Self {
            create: function!(library, c"nvrtcCreateProgram" as CreateProgram),
            compile: function!(library, c"nvrtcCompileProgram" as CompileProgram),
            log_size: function!(library, c"nvrtcGetProgramLogSize" as ResultSize),
            log: function!(library, c"nvrtcGetProgramLog" as ReadResult),
            cubin_size: function!(library, c"nvrtcGetCUBINSize" as ResultSize),
            cubin: function!(library, c"nvrtcGetCUBIN" as ReadResult),
            destroy: function!(library, c"nvrtcDestroyProgram" as DestroyProgram),
        })
    }

    fn compile(self, source: &str, name: &str, architecture: &CStr) -> Result<Vec<u8>, CudaError> {
        let text = |text: &str| {
            CString::new(text).map_err(|_| CudaError::Compilation("the source holds a zero byte".to_owned()))
        };
        let (source, name) = (text(source)?, text(name)?);
        let mut program = null_mut();
        // SAFETY: C strings that outlive the call; no headers.
        let code = unsafe { (self.create)(&raw mut program, source.as_ptr(), name.as_ptr(), 0, null(), null()) };
        if code != 0 {
            return Err(CudaError::Compilation(format!("nvrtcCreateProgram: error {code}")));
        }
        let options = [architecture.as_ptr(), c"--std=c++17".as_ptr()];
        // SAFETY: the program is alive until the end; options are C strings.
        let code = unsafe { (self.compile)(program, options.len() as c_int, options.as_ptr()) };
        let result = if code == 0 {
            bytes(program, self.cubin_size, self.cubin)
        } else {
            let log = bytes(program, self.log_size, self.log).unwrap_or_default();
            Err(CudaError::Compilation(format!(
                "error {code}: {}",
                String::from_utf8_lossy(&log).trim_end_matches('\0')
            )))
        };
        // SAFETY: created above and not used afterwards.
        unsafe { (self.destroy)(&raw mut program) };
        result
    }
}

/// A result of a program: first query its size, then copy the bytes.
fn bytes(program: Handle, size: ResultSize, read: ReadResult) -> Result<Vec<u8>, CudaError> {
    let mut count = 0;
    // SAFETY: a live program; the out-pointer is ours.
    let code = unsafe { size(program, &raw mut count) };
    let mut bytes = vec![0u8; count];
    // SAFETY: the buffer has the size that the library reported.
    let code = if code == 0 { unsafe { read(program, bytes.as_mut_ptr().cast()) } } else { code };
    if code == 0 { Ok(bytes) } else { Err(CudaError::Compilation(format!("no result: error {code}"))) }
}

pub(super) fn succeed(call: &'static str, code: c_int) -> Result<(), CudaError> {
    if code == 0 { Ok(()) } else { Err(CudaError::Driver { call, code }) }
}

impl Module {
    /// Compiles CUDA C++ for the first device and loads it into the current context. libtorch must have made a tensor
    /// there before. `name` is what error messages call the source.
    pub fn compile(source: &str, name: &str) -> Result<Self, CudaError> {
        let driver = Driver::open()?;
        let code = Nvrtc::open()?.compile(source, name, &driver.architecture()?)?;
        let mut module = null_mut();
        // SAFETY: machine code that NVRTC made for this device; the driver copies it.
        succeed("cuModuleLoadData", unsafe { (driver.load)(&raw mut module, code.as_ptr().cast()) })?;
        Ok(Self { driver, module })
    }

    pub fn most_shared_bytes(&self) -> Result<u32, CudaError> {
        /// `CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK_OPTIN`.
        const MOST_SHARED_BYTES: c_int = 97;
        Ok(self.driver.attribute(MOST_SHARED_BYTES)?.cast_unsigned())
    }

    /// One of its `extern "C" __global__` functions, whose blocks get so much shared memory besides what the source
    /// declares.
    pub fn kernel(&self, name: &CStr, shared_bytes: u32) -> Result<Kernel, CudaError> {
        /// `CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES`: more than 48 KiB in all must be asked for.
        const LARGEST_SHARED_BYTES: c_int = 8;
        let mut function = null_mut();
        // SAFETY: a loaded module and a C string.
        let code = unsafe { (self.driver.function)(&raw mut function, self.module, name.as_ptr()) };
        succeed("cuModuleGetFunction", code)?;
        let bytes = c_int::try_from(shared_bytes).unwrap_or(c_int::MAX);
        // SAFETY: a function of that module.
        let code = unsafe { (self.driver.set)(function, LARGEST_SHARED_BYTES, bytes) };
        succeed("cuFuncSetAttribute", code)?;
        Ok(Kernel { launch: self.driver.launch, function, shared_bytes })
    }
}

impl Kernel {
    /// The same with less shared memory for a block than it was found with.
    pub fn with_shared_bytes(self, shared_bytes: u32) -> Self {
        assert!(shared_bytes <= self.shared_bytes, "{shared_bytes} of {} bytes", self.shared_bytes);
        Self { shared_bytes, ..self }
    }

    /// Launches `blocks` blocks of `threads` threads each.
    ///
    /// # Safety
    /// The arguments must be the kernel's parameters, in number, order and kind, and every address must point to as
    /// much device memory as the kernel reads or writes there.
    pub unsafe fn launch(self, blocks: usize, threads: u32, arguments: &[Argument]) -> Result<(), CudaError> {
        let Ok(blocks) = c_uint::try_from(blocks) else {
            return Err(CudaError::Driver { call: "cuLaunchKernel (too many blocks)", code: 1 });
        };
        // A parameter is read from the first bytes of its slot: x86-64 is little-endian.
        let mut slots: Vec<u64> = arguments
            .iter()
            .map(|argument| match *argument {
                Argument::Address(address) => address,
                Argument::Int(value) => u64::from(value.cast_unsigned()),
                Argument::Float(value) => u64::from(value.to_bits()),
            })
            .collect();
        let mut pointers: Vec<*mut c_void> = slots.iter_mut().map(|slot| std::ptr::from_mut(slot).cast()).collect();
        // SAFETY: the slots outlive the call, which copies them; the rest is the caller's promise.
        let code = unsafe {
            (self.launch)(
                self.function,
                blocks,
                1,
                1,
                threads,
                1,
                1,
                self.shared_bytes,
                STREAM.get(),
                pointers.as_mut_ptr(),
                null_mut(),
            )
        };
        succeed("cuLaunchKernel", code)
    }
}
