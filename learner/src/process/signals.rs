//! Ctrl-C in a terminal reaches every process in the foreground; only the orchestrator acts on it.

/// Ignores SIGINT: the orchestrator decides when this process stops.
pub fn ignore_interrupt() {
    // SAFETY: SIG_IGN installs no handler, so nothing can run at a bad moment; the arguments are valid constants.
    unsafe {
        libc::signal(libc::SIGINT, libc::SIG_IGN);
    }
}
