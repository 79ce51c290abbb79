//! Shared libraries that are loaded when they are first wanted, for the rest of the process.

use std::ffi::{CStr, c_void};

/// A library, or something of one, as C sees it.
pub type Handle = *mut c_void;

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LibraryError {
    #[error("{library} cannot be loaded: {reason}")]
    Missing { library: &'static str, reason: String },
    #[error("{function} is missing from its library")]
    Function { function: &'static str },
}

/// Loads one of several names of a library, its symbols visible to all others. The library's initialisers run here: the
/// caller names libraries that are meant to be loaded this way.
pub fn open(names: &[&'static CStr]) -> Result<Handle, LibraryError> {
    let mut reason = String::new();
    for name in names {
        // SAFETY: a C string; the library's initialisers run, as the caller wants.
        let library = unsafe { libc::dlopen(name.as_ptr(), libc::RTLD_NOW | libc::RTLD_GLOBAL) };
        if !library.is_null() {
            return Ok(library);
        }
        // SAFETY: after a failed dlopen, dlerror gives a C string that lives until the next call of this thread.
        reason = unsafe { CStr::from_ptr(libc::dlerror()) }.to_string_lossy().into_owned();
    }
    Err(LibraryError::Missing { library: names[0].to_str().unwrap_or("a library"), reason })
}

/// Looks a function up. The type that the caller gives it must be its C declaration's.
macro_rules! function {
    ($library:expr, $name:literal as $declaration:ty) => {{
        // SAFETY: an open library and a C string.
        let address = unsafe { libc::dlsym($library, $name.as_ptr()) };
        if address.is_null() {
            let function = $name.to_str().unwrap_or("a function");
            return Err($crate::ffi::library::LibraryError::Function { function }.into());
        }
        // SAFETY: the type is the function's declaration in its library's header.
        unsafe { std::mem::transmute::<$crate::ffi::library::Handle, $declaration>(address) }
    }};
}
pub(super) use function;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_library_is_an_error_and_the_second_name_is_tried() {
        assert!(open(&[c"libm.so.6"]).is_ok());
        assert!(open(&[c"libthere-is-no-such-thing.so", c"libm.so.6"]).is_ok());
        let error = open(&[c"libthere-is-no-such-thing.so"]).unwrap_err().to_string();
        assert!(error.contains("libthere-is-no-such-thing.so cannot be loaded"), "{error}");
    }
}
