//! The one C call this process needs.

/// Makes Ctrl-C pass this process by. The terminal sends it to every process in the foreground; what happens then is
/// the orchestrator's decision, which reaches this process through its lifeline.
pub fn ignore_interrupt() {
    // SAFETY: SIG_IGN installs no handler, so no code of ours ever runs in signal context.
    unsafe { libc::signal(libc::SIGINT, libc::SIG_IGN) };
}
