//! What to type in place of what another program would have understood.

use clap::error::{ContextKind, ContextValue, ErrorKind};
use proto::config::presets;

const COMMANDS: [(&str, &[&str]); 6] = [
    ("up", &["train", "start", "run", "launch", "learn"]),
    ("eval", &["evaluate", "test", "enjoy", "validate"]),
    ("view", &["tensorboard", "ui", "dashboard", "watch"]),
    ("stop", &["kill", "down", "cancel"]),
    ("resume", &["continue", "restart"]),
    ("status", &["ps", "info", "show"]),
];

pub fn with_tip(mut error: clap::Error) -> clap::Error {
    let text = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.clone()),
        Some(ContextValue::StyledStr(text)) => Some(text.to_string()),
        _ => None,
    };
    let tip = match error.kind() {
        ErrorKind::InvalidSubcommand => text(ContextKind::InvalidSubcommand).and_then(|word| {
            let (ours, _) = COMMANDS.iter().find(|(_, theirs)| theirs.contains(&word.as_str()))?;
            Some(format!("`orchestrator {ours}` does that"))
        }),
        ErrorKind::UnknownArgument => {
            let usage = text(ContextKind::Usage).unwrap_or_default();
            text(ContextKind::InvalidArg).and_then(|word| {
                match word.as_str() {
                word if presets().iter().any(|preset| preset.name == word) => {
                    Some(format!("a preset is given as `--preset {word}`"))
                }
                word if usage.contains("orchestrator up") && !word.starts_with('-') => {
                    Some("a preset is given as `--preset NAME`; `orchestrator presets` lists them".to_owned())
                }
                "--preset" | "--config" | "--set" | "--seed" if usage.contains("orchestrator resume") => Some(
                    "a run keeps its settings, but for --frames, --actors and --learners; `orchestrator up --from RUN` \
                     begins another run with its weights"
                        .to_owned(),
                ),
                _ => None,
            }
            })
        }
        _ => None,
    };
    if let Some(tip) = tip {
        error.remove(ContextKind::SuggestedSubcommand);
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

#[cfg(test)]
mod tests {
    use crate::CommandLine;
    use clap::CommandFactory;

    #[test]
    fn what_others_understand_is_answered_with_what_we_do() {
        for (words, tip) in [
            (&["up", "demo"][..], "tip: a preset is given as `--preset demo`"),
            (&["up", "recepie"], "tip: a preset is given as `--preset NAME`; `orchestrator presets` lists them"),
            (&["train"], "tip: `orchestrator up` does that"),
            (&["evaluate", "runs/a"], "tip: `orchestrator eval` does that"),
            (&["resume", "runs/a", "--preset", "demo"], "tip: a run keeps its settings"),
            (&["upp"], "'up'"),
        ] {
            let line = std::iter::once("orchestrator").chain(words.iter().copied());
            let error = super::with_tip(CommandLine::command().try_get_matches_from(line).unwrap_err()).to_string();
            assert!(error.contains(tip) && error.matches("tip:").count() == 1, "{words:?}: {error}");
        }
    }
}
