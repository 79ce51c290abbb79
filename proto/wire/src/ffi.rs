//! Calls into C that no crate makes for us.

/// Ignores SIGINT for the rest of the process.
pub fn ignore_interrupt() {
    // SAFETY: SIG_IGN installs no handler, so nothing can run at a bad moment; the arguments are valid constants.
    unsafe {
        libc::signal(libc::SIGINT, libc::SIG_IGN);
    }
}
