//! What can fail in the shared-memory layer.

/// A failure of the shared-memory layer. The text names the service and, where there is a remedy, the remedy.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    /// The node could not be created.
    #[error(
        "cannot join the run's shared memory at {root}: {cause}; check that /dev/shm and {root} exist and are writable"
    )]
    Node {
        /// Root folder of the incarnation.
        root: String,
        /// iceoryx2's error text.
        cause: String,
    },
    /// The folder of small files was there already, and is not ours.
    #[error(
        "{root} was made by somebody else, or is a link: have it removed, or set TMPDIR to a folder that only you can \
         write, then start again"
    )]
    Foreign {
        /// Root folder of the incarnation.
        root: String,
    },
    /// A service could not be created or opened.
    #[error("cannot {verb} service `{service}`: {cause}")]
    Service {
        /// `create` or `open`.
        verb: &'static str,
        service: String,
        /// iceoryx2's error text.
        cause: String,
    },
    /// The other end's records are laid out otherwise.
    #[error(
        "service `{service}` carries records of another task, or of another version of it: start all processes of a run \
         from one version and with one configuration"
    )]
    Unlike { service: String },
    /// A port could not be made.
    #[error(
        "cannot make a port on service `{service}`: {cause}; if /dev/shm is full, `orchestrator clean` frees what dead runs left"
    )]
    Port {
        service: String,
        /// iceoryx2's error text.
        cause: String,
    },
    /// iceoryx2 builds names of files from the folder's, and their length is limited.
    #[error("the temporary folder {root} has too long a name: set TMPDIR to a shorter one, such as /tmp")]
    TooLong {
        /// Root folder of the incarnation.
        root: String,
    },
    /// Nor does it take every letter in them.
    #[error(
        "the temporary folder {root} has a letter in its name that cannot be used there (only ASCII can, and none of \
         < > \" | ? *): set TMPDIR to another one, such as /tmp"
    )]
    Letters {
        /// Root folder of the incarnation.
        root: String,
    },
    /// The file of the recorder's receipts could not be made or mapped.
    #[error("cannot use the recorder's receipts in {path}: {cause}")]
    Receipts { path: String, cause: std::io::Error },
    /// The file of the bells could not be made or mapped.
    #[error("cannot use the bells in {path}: {cause}{}", remedy(.cause))]
    Bells { path: String, cause: std::io::Error },
    /// An announcement could not be made.
    #[error("a stage announcement cannot be published: {0}")]
    Announcement(String),
    /// The address is not one that iceoryx2 accepts.
    #[error("`{0}` is not a wire address (expected PREFIX@FOLDER)")]
    Address(String),
}

fn remedy(cause: &std::io::Error) -> &'static str {
    if cause.kind() == std::io::ErrorKind::StorageFull {
        "; `orchestrator clean` frees what dead runs left"
    } else {
        ""
    }
}
