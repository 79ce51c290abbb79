//! Calls into C that no crate makes for us.

use std::ffi::CStr;

/// Loads a shared library for the rest of the process, its symbols visible to all others. False if it is not found.
pub fn load_library_globally(file: &CStr) -> bool {
    // SAFETY: `file` is a C string that outlives the call. The library's initialisers run here: the caller names
    // libraries that are meant to be loaded this way.
    let handle = unsafe { libc::dlopen(file.as_ptr(), libc::RTLD_NOW | libc::RTLD_GLOBAL) };
    !handle.is_null()
}

/// Ignores SIGINT for the rest of the process.
pub fn ignore_interrupt() {
    // SAFETY: SIG_IGN installs no handler, so nothing can run at a bad moment; the arguments are valid constants.
    unsafe {
        libc::signal(libc::SIGINT, libc::SIG_IGN);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_library_is_no_crash() {
        assert!(load_library_globally(c"libm.so.6"));
        assert!(!load_library_globally(c"libthere-is-no-such-thing.so"));
    }
}
