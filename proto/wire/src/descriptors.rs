//! How many files a process may have open. Shared memory, pipes and sockets count, too: a run's processes have tens of
//! them for each actor, more than the usual soft limit of 1024 allows a large run.

use rustix::process::{Resource, getrlimit, setrlimit};

/// Raises this process's soft limit to its hard one, and returns the limit that then holds; none if there is none.
/// Children inherit it.
pub fn raise_limit() -> Option<u64> {
    let mut limit = getrlimit(Resource::Nofile);
    if limit.current != limit.maximum {
        let raised = rustix::process::Rlimit { current: limit.maximum, ..limit };
        // Where a sandbox forbids it, the old limit holds and is returned.
        if setrlimit(Resource::Nofile, raised).is_ok() {
            limit = raised;
        }
    }
    limit.current
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soft_limit_becomes_the_hard_one() {
        let before = getrlimit(Resource::Nofile);
        let low = rustix::process::Rlimit { current: Some(64), ..before };
        setrlimit(Resource::Nofile, low).unwrap();
        assert_eq!(getrlimit(Resource::Nofile).current, Some(64));
        assert_eq!(raise_limit(), before.maximum);
        assert_eq!(getrlimit(Resource::Nofile).current, before.maximum);
    }
}
