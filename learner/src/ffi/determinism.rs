//! Algorithms on a GPU that give the same bits every time (`determinism.cpp`).

unsafe extern "C" {
    fn stillroom_use_deterministic();
}

/// Takes no others from now on. Must be called before the first computation on a GPU.
pub fn use_deterministic() {
    // SAFETY: it sets a variable of the environment, before threads are started that could read it, and fields of
    // libtorch's.
    unsafe { stillroom_use_deterministic() }
}
