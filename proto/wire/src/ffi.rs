/// Ignores signals that ask a process to end, or to save, for the rest of the process.
pub fn ignore_requests() {
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGUSR1] {
        // SAFETY: SIG_IGN installs no handler, so nothing can run at a bad moment; the arguments are valid constants.
        unsafe {
            libc::signal(signal, libc::SIG_IGN);
        }
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
