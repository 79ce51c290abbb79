use std::mem::MaybeUninit;

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

/// Holds requests to end (Ctrl-C, SIGTERM, SIGHUP) back from the thread that makes it, and from threads that this one
/// starts, until it is dropped there: for work that has something to undo. A request that was not taken then takes
/// effect. Start no process meanwhile, since it would inherit this.
pub struct HeldRequests {
    before: libc::sigset_t,
    held: libc::sigset_t,
}

impl HeldRequests {
    /// Begins to hold back the requests that would end this process; not those that it ignores.
    #[must_use]
    pub fn hold() -> Self {
        let (mut held, mut before) = (MaybeUninit::uninit(), MaybeUninit::uninit());
        // SAFETY: `sigemptyset` fills `held` in before it is used, `pthread_sigmask` fills `before` in. Neither can fail,
        // and `sigaddset` cannot either: the pointers are valid, and the signals valid constants.
        unsafe {
            libc::sigemptyset(held.as_mut_ptr());
            for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
                if !is_ignored(signal) {
                    libc::sigaddset(held.as_mut_ptr(), signal);
                }
            }
            libc::pthread_sigmask(libc::SIG_BLOCK, held.as_ptr(), before.as_mut_ptr());
            Self { before: before.assume_init(), held: held.assume_init() }
        }
    }

    /// Takes a request, if one has come.
    #[must_use]
    pub fn take(&self) -> bool {
        let at_once = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: the set and the time are valid for the call, and a null pointer asks for no details.
        unsafe { libc::sigtimedwait(&raw const self.held, std::ptr::null_mut(), &raw const at_once) > 0 }
    }
}

impl Drop for HeldRequests {
    fn drop(&mut self) {
        // SAFETY: the set was filled in by `hold`, and a null pointer asks for no former one.
        unsafe {
            libc::pthread_sigmask(libc::SIG_SETMASK, &raw const self.before, std::ptr::null_mut());
        }
    }
}

fn is_ignored(signal: libc::c_int) -> bool {
    let mut found = MaybeUninit::<libc::sigaction>::uninit();
    // SAFETY: without a new action `sigaction` only fills `found` in, for a valid signal always.
    unsafe {
        libc::sigaction(signal, std::ptr::null(), found.as_mut_ptr());
        found.assume_init().sa_sigaction == libc::SIG_IGN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_held_back_and_taken_once() {
        let requests = HeldRequests::hold();
        assert!(!requests.take());
        // SAFETY: the signal goes to this thread, which holds it back.
        unsafe {
            libc::pthread_kill(libc::pthread_self(), libc::SIGTERM);
        }
        assert!(requests.take());
        assert!(!requests.take());
    }
}
