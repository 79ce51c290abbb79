//! Files that are opened only if they are plain files: no symbolic link, no pipe, no device.
//!
//! A run folder can come from somebody else, or lie where others write. A link in it would have us write to a file
//! elsewhere, and a pipe would have us wait for ever.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Result};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Opens a file with these options, if what is there is a plain file or nothing.
pub fn open_plain(path: &Path, options: &mut OpenOptions) -> Result<File> {
    let refused = || {
        let text = "it is a link or no plain file, and is not opened: remove it, or look who put it there";
        Error::new(ErrorKind::InvalidInput, text)
    };
    // Without O_NONBLOCK the opening of a pipe waits for its other end. A plain file does not care.
    let file = options.custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path).map_err(|error| {
        match error.raw_os_error() {
            Some(libc::ELOOP | libc::ENXIO) => refused(),
            _ => error,
        }
    })?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(refused()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_file_is_opened_and_a_link_or_pipe_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        open_plain(&at("new"), OpenOptions::new().append(true).create(true)).unwrap();
        assert!(at("new").is_file());

        std::fs::write(at("precious"), "precious").unwrap();
        std::os::unix::fs::symlink(at("precious"), at("link")).unwrap();
        std::os::unix::fs::symlink(at("nothing"), at("dangling")).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(at("pipe")).status().unwrap().success());
        for name in ["link", "dangling", "pipe"] {
            for options in [
                OpenOptions::new().write(true).create(true).truncate(true),
                OpenOptions::new().append(true).create(true).read(true),
                OpenOptions::new().read(true),
            ] {
                let message = open_plain(&at(name), options).unwrap_err().to_string();
                assert!(message.contains("a link or no plain file"), "{name}: {message}");
            }
        }
        assert_eq!(std::fs::read_to_string(at("precious")).unwrap(), "precious");
        assert!(!at("nothing").exists());
        assert_eq!(open_plain(&at("none"), OpenOptions::new().read(true)).unwrap_err().kind(), ErrorKind::NotFound);
    }
}
