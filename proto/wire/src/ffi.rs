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

/// One heap for all threads, for a process that runs for days and keeps a little of much that it handles: with a heap for
/// each thread, what is kept lies scattered among what is free in all of them.
pub fn share_one_heap() {
    // SAFETY: it sets a number in the allocator.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}
