//! Nothing. iceoryx2's platform layer has bindgen as a build dependency on every system, and calls it on QNX alone
//! (`#[cfg(target_os = "nto")]` in its build script). The real one and the nine crates that only it needs would be
//! compiled, and never run.
