//! What `--version` prints: the version, and the commit where it is known.

use std::sync::OnceLock;

/// The version of this program, and in brackets the commit that it was built from: `0.1.0 (e2b2dc2)`, with `+changes`
/// behind it where the sources were not those of the commit. The Makefile passes the commit in `STILLROOM_COMMIT`;
/// without that, the version alone.
///
/// A macro, for each program's `main.rs`: it is then only that file which depends on the commit, and after a commit
/// cargo links the programs again and compiles no library.
#[macro_export]
macro_rules! version {
    () => {{
        // Cargo does not see that `make dist` links otherwise. It sees that this has changed.
        let _linked_for: Option<&str> = option_env!("STILLROOM_LINKED_FOR");
        $crate::version::with_commit(env!("CARGO_PKG_VERSION"), option_env!("STILLROOM_COMMIT"))
    }};
}

/// Which sources of this crate and of `proto` a program is made of. Processes of one run have the same.
pub const BUILD: &str = env!("STILLROOM_BUILD");

/// `version`, and `commit` in brackets behind it if there is one. The first call in a process decides.
pub fn with_commit(version: &str, commit: Option<&str>) -> &'static str {
    static TEXT: OnceLock<String> = OnceLock::new();
    TEXT.get_or_init(|| compose(version, commit))
}

fn compose(version: &str, commit: Option<&str>) -> String {
    match commit.map(str::trim).filter(|commit| !commit.is_empty()) {
        Some(commit) => format!("{version} ({commit})"),
        None => version.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_commit_stands_behind_the_version_where_there_is_one() {
        assert_eq!(compose("0.1.0", Some("e2b2dc2+changes")), "0.1.0 (e2b2dc2+changes)");
        // Outside of a repository the Makefile passes an empty text; plain cargo passes none.
        assert_eq!(compose("0.1.0", Some("")), "0.1.0");
        assert_eq!(compose("0.1.0", None), "0.1.0");
    }
}
