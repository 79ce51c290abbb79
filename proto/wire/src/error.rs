/// A failure of the shared-memory layer. The text names the service and, where there is a remedy, the remedy.
#[derive(Debug, thiserror::Error)]
pub enum WireError {
    #[error(
        "cannot join the run's shared memory at {root}: {cause}; check that /dev/shm and {root} exist and are writable"
    )]
    Node { root: String, cause: String },
    #[error(
        "{root} was made by somebody else, or is a link: have it removed, or set TMPDIR to a folder that only you can \
         write, then start again"
    )]
    Foreign { root: String },
    #[error("cannot {verb} service `{service}`: {cause}")]
    Service { verb: &'static str, service: String, cause: String },
    #[error(
        "service `{service}` carries records of another task, or of another version of it: start all processes of a run \
         from one version and with one configuration"
    )]
    Unlike { service: String },
    #[error(
        "cannot make a port on service `{service}`: {cause}; if /dev/shm is full, `orchestrator clean` frees what dead runs left"
    )]
    Port { service: String, cause: String },
    #[error("the temporary folder {root} has too long a name: set TMPDIR to a shorter one, such as /tmp")]
    TooLong { root: String },
    #[error(
        "the temporary folder {root} has a letter in its name that cannot be used there (only ASCII can, and none of \
         < > \" | ? *): set TMPDIR to another one, such as /tmp"
    )]
    Letters { root: String },
    #[error("cannot use the recorder's receipts in {path}: {cause}")]
    Receipts { path: String, cause: std::io::Error },
    #[error("cannot use the bells in {path}: {cause}{}", remedy(.cause))]
    Bells { path: String, cause: std::io::Error },
    #[error("a stage announcement cannot be published: {0}")]
    Announcement(String),
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
