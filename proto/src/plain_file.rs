//! Files that are opened only if they are plain files: no symbolic link, no pipe, no device.
//!
//! A run folder can come from somebody else, or lie where others write. A link in it would have us read or write a file
//! elsewhere, and a pipe would have us wait for ever. What is read in a run folder is opened by [`open_below`], which
//! [`crate::run_folder::RunFolder::open`] calls: it follows no link on the way there either.

use rustix::fs::{AtFlags, FileType, Mode, OFlags, Stat};
use rustix::io::Errno;
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Result};
use std::os::fd::OwnedFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Component, Path};

fn refused() -> Error {
    let text = "it is a link or no plain file, and is not opened: find out who put it there, and remove it";
    Error::new(ErrorKind::InvalidInput, text)
}

/// Opens a file with these options, if what is there is a plain file or nothing. For a folder that is known to be ours.
pub fn open_plain(path: &Path, options: &mut OpenOptions) -> Result<File> {
    // Without O_NONBLOCK the opening of a pipe waits for its other end. A plain file does not care.
    let file = options.custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK).open(path).map_err(|error| {
        match error.raw_os_error() {
            Some(libc::ELOOP | libc::ENXIO) => refused(),
            _ => error,
        }
    })?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(refused()) }
}

/// Opens the plain file at `path` below `base` for reading. Links are followed on the way to `base`, which the user named,
/// and none below it.
pub(crate) fn open_below(base: &Path, path: &Path) -> Result<File> {
    let name = path.file_name().ok_or_else(refused)?;
    let folder = open_folder_below(base, path.parent().unwrap_or(Path::new("")))?;
    let is_plain = |stat: &Stat| FileType::from_raw_mode(stat.st_mode) == FileType::RegularFile;
    // Before it is opened, since to open a device can do something; and after, since it can be another one by then.
    if !is_plain(&rustix::fs::statat(&folder, name, AtFlags::SYMLINK_NOFOLLOW)?) {
        return Err(refused());
    }
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let file = rustix::fs::openat(&folder, name, flags, Mode::empty())
        .map_err(|error| if error == Errno::LOOP { refused() } else { error.into() })?;
    let stat = rustix::fs::fstat(&file)?;
    if is_plain(&stat) && !is_borrowed(&stat, &rustix::fs::fstat(&folder)?) { Ok(file.into()) } else { Err(refused()) }
}

/// Opens the folder at `path` below `base` in the same way: step by step, which every kernel can.
pub(crate) fn open_folder_below(base: &Path, path: &Path) -> Result<OwnedFd> {
    let base = if base.as_os_str().is_empty() { Path::new(".") } else { base };
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let mut folder = rustix::fs::open(base, flags, Mode::empty())?;
    for part in path.components() {
        let Component::Normal(name) = part else { return Err(refused()) };
        folder = rustix::fs::openat(&folder, name, flags | OFlags::NOFOLLOW, Mode::empty()).map_err(
            |error| match error {
                // What is said of a link depends on the kernel.
                Errno::LOOP | Errno::NOTDIR => refused(),
                error => error.into(),
            },
        )?;
    }
    Ok(folder)
}

/// Whether a file has another name elsewhere and another owner than the folder that it is in: whoever owns the folder
/// gave somebody else's file a second name there. A checkpoint that is kept has two names of one owner.
fn is_borrowed(file: &Stat, folder: &Stat) -> bool {
    file.st_nlink > 1 && file.st_uid != folder.st_uid
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

    #[test]
    fn no_link_is_followed_below_the_folder_that_was_named() {
        let temporary = tempfile::tempdir().unwrap();
        let at = |name: &str| temporary.path().join(name);
        std::fs::create_dir_all(at("run/logs/folder")).unwrap();
        std::fs::create_dir(at("private")).unwrap();
        for file in ["run/logs/a", "private/a"] {
            std::fs::write(at(file), "").unwrap();
        }
        for (target, link) in [("run", "named"), ("private", "run/linked"), ("run/logs", "run/inside")] {
            std::os::unix::fs::symlink(at(target), at(link)).unwrap();
        }
        std::os::unix::fs::symlink("a", at("run/logs/link")).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(at("run/pipe")).status().unwrap().success());
        let _socket = std::os::unix::net::UnixListener::bind(at("run/socket")).unwrap();
        let open = |path: &str| open_below(&at("named"), Path::new(path));
        assert!(open("logs/a").is_ok(), "the folder itself may be a link: the user named it");
        let outside = ["../private/a", "logs/../../private/a", "/etc/passwd", ""];
        for path in ["linked/a", "inside/a", "logs/link", "pipe", "socket", "logs/folder"].into_iter().chain(outside) {
            let message = open(path).unwrap_err().to_string();
            assert!(message.contains("a link or no plain file"), "{path}: {message}");
        }
        for path in ["nothing", "nothing/a"] {
            assert_eq!(open(path).unwrap_err().kind(), ErrorKind::NotFound);
        }
    }

    #[test]
    fn a_second_name_of_somebody_elses_file_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a"), "").unwrap();
        std::fs::hard_link(folder.path().join("a"), folder.path().join("b")).unwrap();
        assert!(open_below(folder.path(), Path::new("b")).is_ok(), "a checkpoint that is kept has two names");
        let file = rustix::fs::stat(folder.path().join("b")).unwrap();
        let (mut theirs, mut single) = (file, file);
        (theirs.st_uid, single.st_nlink) = (file.st_uid + 1, 1);
        assert!(is_borrowed(&file, &theirs) && !is_borrowed(&file, &file) && !is_borrowed(&single, &theirs));
    }
}
