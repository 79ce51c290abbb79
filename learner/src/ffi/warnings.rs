use std::ffi::{CStr, c_char};
use std::sync::OnceLock;

unsafe extern "C" {
    fn stillroom_hear_warnings();
}

static LISTENER: OnceLock<fn(&str)> = OnceLock::new();

/// Sends libtorch's warnings on this thread to `listener` instead of standard error. Only the first listener of the
/// process is used.
pub fn hear(listener: fn(&str)) {
    LISTENER.get_or_init(|| listener);
    // SAFETY: it only sets a pointer to an object that lives as long as the process.
    unsafe { stillroom_hear_warnings() }
}

/// Called from C++.
#[unsafe(no_mangle)]
extern "C" fn stillroom_warned(text: *const c_char) {
    // SAFETY: a C string that lives through the call.
    let text = unsafe { CStr::from_ptr(text) }.to_string_lossy();
    if let Some(listener) = LISTENER.get() {
        listener(&text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use tch::{Device, Kind, Tensor};

    static HEARD: Mutex<Vec<String>> = Mutex::new(vec![]);

    #[test]
    fn a_warning_is_told() {
        hear(|text| HEARD.lock().unwrap().push(text.to_owned()));
        // A result of the wrong size is resized, and warned of.
        let (result, ones) =
            (Tensor::zeros([3], (Kind::Float, Device::Cpu)), Tensor::ones([2], (Kind::Float, Device::Cpu)));
        let _ = ones.abs_out(&result);
        let heard = HEARD.lock().unwrap();
        assert!(heard.iter().any(|text| text.contains("resize")), "{heard:?}");
    }
}
