//! Where the services of one incarnation live, and how that place is swept.

use crate::error::WireError;
use iceoryx2::config::Config;
use iceoryx2::prelude::{Path as IoxPath, SemanticString};
use std::fmt::Display;
use std::fs::{DirBuilder, Metadata, Permissions};
use std::io::ErrorKind;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Where the services of one orchestrator incarnation live: a prefix of names in /dev/shm and a folder of small files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WireAddress {
    prefix: String,
    root: PathBuf,
}

/// Start of every prefix, so that `orchestrator clean` recognises what is ours.
pub const PREFIX_MARK: &str = "stillroom_";

/// Where all runs of this environment have their folders of small files: what `TMPDIR` names, /tmp without it. Absolute,
/// as other processes are given names in it.
pub fn temporary_folder() -> PathBuf {
    let named = std::env::temp_dir();
    std::path::absolute(&named).unwrap_or_else(|_| if named.as_os_str().is_empty() { "/tmp".into() } else { named })
}

/// Whether this can be a run's id. It becomes part of names that are deleted later, so it holds no slash and no dot.
pub fn is_run_id(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_alphanumeric())
}

impl WireAddress {
    /// The address of incarnation `incarnation` of run `run_id`. Panics if `run_id` holds anything but letters and
    /// digits: see [`is_run_id`].
    pub fn new(run_id: &str, incarnation: u32) -> Self {
        assert!(is_run_id(run_id), "a run's id holds letters and digits only, not `{run_id}`");
        let prefix = format!("{PREFIX_MARK}{run_id}_{incarnation}_");
        let root = temporary_folder().join(prefix.trim_end_matches('_'));
        Self { prefix, root }
    }

    /// The address whose names in shared memory begin as `name` does; none for the name of another program.
    pub fn of_name(name: &str) -> Option<Self> {
        let mut parts = name.strip_prefix(PREFIX_MARK)?.splitn(3, '_');
        let (id, incarnation, _) = (parts.next()?, parts.next()?, parts.next()?);
        let number: u32 = incarnation.parse().ok()?;
        // `007` is not how we write a number: its address would have another prefix.
        (is_run_id(id) && number.to_string() == incarnation).then(|| Self::new(id, number))
    }

    pub fn run_id(&self) -> &str {
        self.parts().0
    }

    /// Number of the orchestrator's start on it.
    pub fn incarnation(&self) -> u32 {
        self.parts().1.parse().unwrap_or(0)
    }

    fn parts(&self) -> (&str, &str) {
        let parts = self.prefix.trim_start_matches(PREFIX_MARK).trim_end_matches('_');
        parts.split_once('_').unwrap_or((parts, ""))
    }

    /// Prefix of all names in /dev/shm.
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    /// Folder of the small files.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// File of the bells' words. It is in memory: a ring must not wait for a disk.
    pub(super) fn bells(&self) -> PathBuf {
        Path::new(SHARED_MEMORY).join(format!("{}bells", self.prefix))
    }

    pub(super) fn receipts(&self) -> PathBuf {
        self.root.join("receipts")
    }

    /// Deletes everything of this user's at this address. To be called when no process uses it any more.
    ///
    /// What belongs to somebody else, and symbolic links, are left alone. Returns the number of files removed.
    pub fn sweep(&self) -> std::io::Result<usize> {
        self.sweep_of(rustix::process::geteuid().as_raw())
    }

    fn sweep_of(&self, uid: u32) -> std::io::Result<usize> {
        let (mut removed, mut failure) = (0, None);
        let mut count = |result: std::io::Result<()>| match result {
            Ok(()) => removed += 1,
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => failure = Some(error),
        };
        for (path, metadata) in self.names()? {
            if metadata.is_file() && metadata.uid() == uid {
                count(std::fs::remove_file(path));
            } else {
                tracing::warn!("{} is left alone: it is not a file of this user's", path.display());
            }
        }
        match std::fs::symlink_metadata(&self.root) {
            Ok(metadata) if metadata.is_dir() && metadata.uid() == uid => count(std::fs::remove_dir_all(&self.root)),
            Ok(_) => tracing::warn!("{} is left alone: it is not a folder of this user's", self.root.display()),
            Err(error) => count(Err(error)),
        }
        failure.map_or(Ok(removed), Err)
    }

    /// What is in shared memory under the prefix. The metadata are those of the entry itself: no link is followed.
    fn names(&self) -> std::io::Result<Vec<(PathBuf, Metadata)>> {
        let mut names = Vec::new();
        for entry in std::fs::read_dir(SHARED_MEMORY)? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(&self.prefix) {
                // An entry without metadata has just gone.
                names.extend(entry.metadata().ok().map(|metadata| (entry.path(), metadata)));
            }
        }
        Ok(names)
    }

    /// Makes the folder of small files, for this user alone. One that somebody else made beforehand is refused: its
    /// owner could replace what is in it.
    pub(super) fn create_root(&self) -> Result<(), WireError> {
        self.create_root_of(rustix::process::geteuid().as_raw())
    }

    fn create_root_of(&self, uid: u32) -> Result<(), WireError> {
        let root = || self.root.display().to_string();
        let failed = |cause: std::io::Error| WireError::Node { root: root(), cause: cause.to_string() };
        match DirBuilder::new().mode(0o700).create(&self.root) {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => return Err(failed(error)),
            _ => {}
        }
        let metadata = std::fs::symlink_metadata(&self.root).map_err(failed)?;
        if !metadata.is_dir() || metadata.uid() != uid {
            return Err(WireError::Foreign { root: root() });
        }
        // The umask may have taken from the mode, and an older folder of ours may have another.
        std::fs::set_permissions(&self.root, Permissions::from_mode(0o700)).map_err(failed)
    }

    /// Takes from all others the right to open what is here: iceoryx2 makes one segment that everybody may write.
    pub(super) fn close_to_others(&self) -> std::io::Result<()> {
        let uid = rustix::process::geteuid().as_raw();
        for (path, metadata) in self.names()? {
            if metadata.is_file() && metadata.uid() == uid && metadata.mode() & 0o077 != 0 {
                std::fs::set_permissions(path, Permissions::from_mode(metadata.mode() & 0o700))?;
            }
        }
        Ok(())
    }

    /// Whether files in the folder of small files can have names at all: iceoryx2 limits their length and their letters.
    pub fn check_root(&self) -> Result<(), WireError> {
        self.config().map(drop)
    }

    pub(super) fn config(&self) -> Result<Config, WireError> {
        let text = || self.root.display().to_string();
        let mut config = Config::default();
        let root = self.root.as_os_str().as_bytes();
        if root.len() > MAX_ROOT_BYTES {
            return Err(WireError::TooLong { root: text() });
        }
        config.global.set_root_path(&IoxPath::new(root).map_err(|_| WireError::Letters { root: text() })?);
        let prefix = SemanticString::new(self.prefix.as_bytes());
        config.global.prefix = prefix.map_err(|_| WireError::Address(self.to_string()))?;
        // Sweeping dead nodes is the orchestrator's task, on SIGCHLD and on a timer: a starting actor must not spend
        // its first milliseconds on its siblings' remains.
        config.global.node.cleanup_dead_nodes_on_creation = false;
        config.global.node.cleanup_dead_nodes_on_destruction = false;
        config.global.service.cleanup_dead_nodes_on_open = false;
        Ok(config)
    }
}

/// Longest root folder: iceoryx2 panics where root, prefix and its own names are longer than one name of a file may be.
/// Roots of 113 bytes were seen to work, of 119 not.
const MAX_ROOT_BYTES: usize = 100;

/// Where POSIX shared memory lives on Linux.
pub const SHARED_MEMORY: &str = "/dev/shm";

impl Display for WireAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}@{}", self.prefix, self.root.display())
    }
}

impl std::str::FromStr for WireAddress {
    type Err = WireError;
    fn from_str(text: &str) -> Result<Self, WireError> {
        let parsed = text.split_once('@').and_then(|(prefix, root)| {
            let root = PathBuf::from(root);
            let address = Self::of_name(prefix).filter(|address| address.prefix == prefix)?;
            // The folder of this address, wherever the temporary folder is, and no other.
            (root.is_absolute() && root.file_name() == address.root.file_name()).then_some(Self { root, ..address })
        });
        parsed.ok_or_else(|| WireError::Address(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(test: &str) -> WireAddress {
        WireAddress::new(&format!("test{test}{}", std::process::id()), 1)
    }

    fn me() -> u32 {
        rustix::process::geteuid().as_raw()
    }

    /// They were called no addresses.
    #[test]
    fn a_temporary_folder_whose_letters_iceoryx2_does_not_take_is_named() {
        let rooted = |folder: &[u8]| {
            let address = WireAddress::new("text", 1);
            let root = Path::new(std::ffi::OsStr::from_bytes(folder)).join(address.root.file_name().unwrap());
            WireAddress { root, ..address }.check_root().map_err(|error| error.to_string())
        };
        for folder in ["/tmp/zwei Worte", "/tmp/a@b:c'd"] {
            rooted(folder.as_bytes()).unwrap();
        }
        for folder in ["/tmp/Küche".as_bytes(), b"/tmp/\xff", b"/tmp/a\nb", b"/tmp/a?b"] {
            let message = rooted(folder).unwrap_err();
            assert!(message.contains("has a letter in its name that cannot be used"), "{message}");
        }
        assert!(rooted(&[b'/'; 101]).unwrap_err().contains("too long a name"));
    }

    #[test]
    fn an_address_survives_the_command_line() {
        let address = WireAddress::new("text", 1);
        assert_eq!(address.to_string().parse::<WireAddress>().unwrap(), address);
        assert_eq!((address.run_id(), address.incarnation()), ("text", 1));
        for wrong in [
            "nonsense",
            "stillroom_@/home/me",
            "stillroom_text_1_@/home/me",
            "stillroom_text_1_@stillroom_text_1",
            "stillroom_text_1_more@/tmp/stillroom_text_1",
            "stillroom_text_01_@/tmp/stillroom_text_1",
        ] {
            assert!(wrong.parse::<WireAddress>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn names_are_taken_apart_and_strangers_left_alone() {
        for name in ["stillroom_0a1b_12_x.y", "stillroom_0a1b_12_"] {
            assert_eq!(WireAddress::of_name(name), Some(WireAddress::new("0a1b", 12)));
        }
        for stranger in
            ["stillroom_", "stillroom_0a1b_12", "stillroom_0a-b_12_", "stillroom_0a1b_x_", "stillroom_a_07_", "o_a_1_"]
        {
            assert_eq!(WireAddress::of_name(stranger), None, "{stranger}");
        }
        assert!(!is_run_id("../../home/me") && !is_run_id("") && is_run_id("0a1b"));
    }

    #[test]
    fn a_sweep_removes_nothing_of_other_users_and_follows_no_link() {
        let address = address("sweep");
        let precious = tempfile::tempdir().unwrap();
        let file = precious.path().join("file");
        std::fs::write(&file, "precious").unwrap();
        let name = |end: &str| Path::new(SHARED_MEMORY).join(format!("{}{end}", address.prefix()));
        std::fs::write(name("data"), "").unwrap();
        std::fs::create_dir(name("folder")).unwrap();
        std::os::unix::fs::symlink(&file, name("link")).unwrap();
        std::os::unix::fs::symlink(precious.path(), address.root()).unwrap();
        // As another user would see it, all is somebody else's.
        assert_eq!(address.sweep_of(me() + 1).unwrap(), 0);
        assert!(name("data").exists());
        assert_eq!(address.sweep().unwrap(), 1);
        assert!(!name("data").exists() && name("folder").is_dir() && name("link").is_symlink());
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "precious");

        std::fs::remove_file(address.root()).unwrap();
        std::fs::create_dir(address.root()).unwrap();
        assert_eq!(address.sweep_of(me() + 1).unwrap(), 0);
        assert!(address.root().is_dir());
        std::fs::remove_dir(name("folder")).unwrap();
        std::fs::remove_file(name("link")).unwrap();
        assert_eq!(address.sweep().unwrap(), 1);
        assert!(!address.root().exists());
    }

    #[test]
    fn a_folder_that_somebody_else_made_is_refused_and_ours_is_closed() {
        let address = address("root");
        let elsewhere = tempfile::tempdir().unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), address.root()).unwrap();
        let message = address.create_root().unwrap_err().to_string();
        assert!(message.contains("somebody else"), "{message}");
        std::fs::remove_file(address.root()).unwrap();

        std::fs::create_dir(address.root()).unwrap();
        std::fs::set_permissions(address.root(), Permissions::from_mode(0o777)).unwrap();
        assert!(matches!(address.create_root_of(me() + 1), Err(WireError::Foreign { .. })));
        address.create_root().unwrap();
        assert_eq!(std::fs::metadata(address.root()).unwrap().mode() & 0o777, 0o700);
        address.sweep().unwrap();
    }
}
