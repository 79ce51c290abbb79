#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SpecError {
    #[error("it is no task: {0}")]
    Toml(String),
    #[error("name `{0}`: a name has lower-case letters, digits and underscores, and begins with a letter")]
    Name(String),
    #[error("there are two of the name `{0}`")]
    Double(String),
    #[error("`{0}` is a name of the engine's own")]
    Reserved(String),
    #[error("there are {count} {what}: at most {most} can be declared")]
    TooMany { what: &'static str, count: usize, most: usize },
    #[error("task `{0}` is known already, and declared otherwise")]
    Taken(String),
    #[error("channel `{name}`: {problem}")]
    Channel { name: String, problem: &'static str },
    #[error("restore: a snapshot of {bytes} bytes; it has 1 to {most}", most = super::Restore::SNAPSHOT_BYTES_MOST)]
    Snapshot { bytes: u32 },
    #[error("actions: {problem}")]
    Actions { problem: String },
    #[error("reward `{name}`: {problem}")]
    Reward { name: String, problem: String },
    #[error("metric `{name}`: {problem}")]
    Metric { name: String, problem: String },
    #[error("figure `{name}`: {problem}")]
    Figure { name: String, problem: String },
    #[error("label: {0}")]
    Label(String),
    #[error("cost: {0}")]
    Cost(String),
    #[error(
        "task `{task}`: networks cannot take {what}: an image has 36 to 512 pixels each way, and 1 to 12 channels first or \
         last; make numbers of a smaller one (gymnasium.wrappers.FlattenObservation, then DtypeObservation to float32). \
         Numbers are f32, or whole numbers of a declared range, at most 65536 in all"
    )]
    Input { task: String, what: String },
    #[error("the environment has {now}, but the run was begun with {then}: serve the environment that began it")]
    OtherSpaces { now: String, then: String },
    #[error("task `{task}` has no reward `{name}`, and neither has the configuration{known}")]
    UnknownReward { name: String, task: String, known: String },
}
