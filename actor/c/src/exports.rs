//! The functions of `stillroom_actor.h`.

use crate::error::ServeError;
use crate::ffi::{ARGUMENTS_MOST, CSimulator, Simulator, refused};
use crate::serving::serve;
use std::ffi::{CStr, CString, OsString, c_char, c_int};
use std::os::unix::ffi::OsStrExt;
use std::sync::Mutex;

/// Cargo links the library again where this is another one, as it does the programs: `make dist` links for an older glibc.
const _LINKED_FOR: Option<&str> = option_env!("STILLROOM_LINKED_FOR");

/// The last error, for `stillroom_error`.
static ERROR: Mutex<Option<CString>> = Mutex::new(None);

/// The program's arguments.
///
/// # Safety
/// They are those of `main`.
unsafe fn arguments(count: c_int, place: *const *const c_char) -> Result<Vec<OsString>, ServeError> {
    let count = usize::try_from(count).ok().filter(|&count| count <= ARGUMENTS_MOST);
    let Some(count) = count.filter(|_| !place.is_null() && place.is_aligned()) else {
        return refused("stillroom_serve was not given main's argc and argv");
    };
    // SAFETY: not null, aligned, and as many as the caller promises.
    let places = unsafe { std::slice::from_raw_parts(place, count) };
    let argument = |&place: &*const c_char| {
        if place.is_null() {
            return refused("an argument of the program is NULL: argc is too great");
        }
        // SAFETY: not null, and a text, as the caller promises.
        Ok(std::ffi::OsStr::from_bytes(unsafe { CStr::from_ptr(place) }.to_bytes()).to_owned())
    };
    places.iter().map(argument).collect()
}

/// See `stillroom_actor.h`.
///
/// # Safety
/// The pointers are null, or what the header asks for.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn stillroom_serve(
    simulator: *const CSimulator,
    argc: c_int,
    argv: *const *const c_char,
) -> c_int {
    // SAFETY: as the caller promises.
    let served = unsafe { arguments(argc, argv).and_then(|words| Ok((words, Simulator::read(simulator)?))) };
    let Err(error) = served.and_then(|(words, simulator)| serve(&words, simulator)) else { return 0 };
    let text = error.to_string();
    eprintln!("stillroom: error: {text}");
    let kept = CString::new(text.replace('\0', " ")).ok();
    *ERROR.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = kept;
    error.status()
}

#[unsafe(no_mangle)]
pub extern "C" fn stillroom_error() -> *const c_char {
    let error = ERROR.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    error.as_ref().map_or(c"".as_ptr(), |text| text.as_ptr())
}
