//! Calls into C that no crate makes for us.

/// Ignores SIGINT for the rest of the process.
pub fn ignore_interrupt() {
    // SAFETY: SIG_IGN installs no handler, so nothing can run at a bad moment; the arguments are valid constants.
    unsafe {
        libc::signal(libc::SIGINT, libc::SIG_IGN);
    }
}

/// Gives memory that is free back to the system: after work that needs much of it for a moment. The allocator alone keeps
/// what lies below a block that is still in use.
pub fn give_memory_back() {
    // SAFETY: it takes no pointer and moves nothing that is in use.
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Keeps large blocks out of the heap for good, for a process that runs for days: each is mapped on its own and goes back
/// when it is freed. The allocator alone raises its limit with every large block that is freed; then they come to lie
/// among small ones that stay, and leave holes.
pub fn map_large_blocks() {
    /// The allocator's own limit at the start, bytes.
    const LARGE: libc::c_int = 128 << 10;
    // SAFETY: it sets a number in the allocator.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, LARGE);
    }
}
