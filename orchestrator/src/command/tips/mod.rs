//! What to type in place of what another program would have understood.

mod words;

use super::list::RUNS;
use crate::viewer::RunReaders;
use crate::wrong;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use proto::config::{Config, ConfigError, Setting, SettingError, presets};
use proto::likeness::{likeness, nearest};
use proto::shell::quoted;
use std::path::Path;
use view::data::{Card, Runs};
use words::{ALL_KEYS, COMMANDS, MISSING, OPTIONS};

/// What the standard library says of a word in a number's place, and what we say.
const NO_NUMBERS: [(&str, &str); 2] =
    [("invalid digit found in string", "expected a whole number"), ("invalid float literal", "expected a number")];

/// What says the same here as an option of another program, or as a setting of it: of the table, or the key with this
/// last part.
fn ours(command: &str, word: &str) -> Option<String> {
    let typed = command;
    let command = if ["config", "doctor", "import"].contains(&command) { "up" } else { command };
    let name = word.trim_start_matches('-').replace('_', "-");
    let same = |(of, _, theirs): &&(&str, &str, &str)| {
        (of.is_empty() || [typed, command].contains(of)) && theirs.split(' ').any(|one| one == name)
    };
    let known = OPTIONS.iter().find(same).map(|(_, ours, _)| format!("here {ours}"));
    known.or_else(|| {
        let key = name.replace('-', "_");
        match format!("{key}=0").parse::<Setting>() {
            Err(SettingError::UnknownKey { nearest: Some(nearest), .. })
                if command == "up" && word.starts_with('-') && nearest.ends_with(&format!(".{key}")) =>
            {
                Some(format!("here it is `--set {nearest}=VALUE`"))
            }
            _ => None,
        }
    })
}

/// What `KEY=VALUE` alone is here: an option, a setting by another program's name, or a setting.
fn assigned(word: &str, line: &clap::Command) -> Option<String> {
    let (key, value) = word.split_once('=').filter(|_| !word.starts_with('-'))?;
    let option = format!("--{}", key.replace('_', "-"));
    if is_of_up(&option, line) {
        return Some(format!("here it is `{option} {value}`"));
    }
    let is_ours = !matches!(word.parse::<Setting>(), Err(SettingError::UnknownKey { .. }));
    let Some(known) = ours("up", key.rsplit('.').next()?) else {
        return Some(if is_ours {
            format!("each key has a `--set` of its own: `--set {word}`")
        } else {
            ALL_KEYS.to_owned()
        });
    };
    Some(with_value(known, Some(value)))
}

/// A tip that ends in an option with a placeholder, with the value that was typed: `--set ppo.learning_rate=1e-3`.
fn with_value(tip: String, value: Option<&str>) -> String {
    let filled = |value: &str| {
        let option = tip.strip_prefix("here it is `")?.strip_suffix('`')?;
        let (before, placeholder) = option.split_at(option.rfind(['=', ' '])? + 1);
        let (folder, placeholder) = placeholder.strip_prefix("runs/").map_or(("", placeholder), |name| ("runs/", name));
        let is_one = placeholder == "true" || placeholder.bytes().all(|letter| letter.is_ascii_uppercase());
        let fits = before.strip_prefix("--set ").is_none_or(|key| format!("{key}{value}").parse::<Setting>().is_ok());
        (is_one && fits && !before.contains('`'))
            .then(|| format!("here it is `{before}{}`", quoted(format!("{folder}{value}"))))
    };
    value.and_then(filled).unwrap_or(tip)
}

/// The value that was typed with an option: `--lr 1e-3`, `--lr=1e-3`.
fn typed<'a>(words: &'a [String], option: &str) -> Option<&'a str> {
    let at = words.iter().position(|word| word.split('=').next() == Some(option))?;
    let next = || words.get(at + 1).filter(|next| !next.starts_with('-') || next.parse::<f64>().is_ok());
    words[at].split_once('=').map(|(_, value)| value).or_else(|| next().map(String::as_str))
}

/// The key of `--set KEY VALUE` before this value.
fn set_before<'a>(words: &'a [String], value: &str) -> Option<&'a str> {
    words.windows(3).find_map(|three| match three {
        [set, key, next] if set == "--set" && !key.contains('=') && next == value => Some(key.as_str()),
        _ => None,
    })
}

/// The key of an option that is called as a key is: `--ppo.clip`.
fn key_in(option: &str) -> Option<&str> {
    let key = option.strip_prefix("--").filter(|key| key.contains('.'))?;
    matches!(format!("{key}=0").parse::<Setting>(), Ok(_) | Err(SettingError::WrongType(_))).then_some(key)
}

/// The preset of a built-in task that was given as another program's `--task`.
fn preset_of_task(words: &[String]) -> Option<String> {
    let task = words.iter().skip_while(|word| *word != "--task").nth(1)?.replace('-', "_");
    let is_of = |name: &&str| Config::resolve(name, None).is_ok_and(|config| config.task == task);
    let preset = presets().iter().map(|preset| preset.name.as_str()).find(is_of)?;
    Some(format!("a preset has a task: `--preset {preset}`"))
}

/// The newest run below `runs/`, as an example of what is missing. What is evaluated, reported or filmed has trained.
fn newest_run(command: &str) -> Option<String> {
    let cards = RunReaders::once(vec![RUNS.into()]).list();
    let needs_frames = ["eval", "report", "replay"].contains(&command);
    let is_fit = |card: &Card| !card.evaluation && card.problem.is_none() && (card.done > 0 || !needs_frames);
    let newest = cards.into_iter().find(is_fit)?;
    Some(format!("the newest is `orchestrator {command} {}`", quoted(&newest.folder)))
}

fn is_of_up(option: &str, line: &clap::Command) -> bool {
    let name = option.strip_prefix("--");
    let up = line.find_subcommand("up").filter(|_| name.is_some());
    up.is_some_and(|up| up.get_arguments().any(|argument| argument.get_long() == name))
}

/// The command of a usage, whatever the program is called; of the program itself `[OPTIONS]`.
fn command_of(usage: &str) -> &str {
    usage.split_whitespace().nth(2).unwrap_or_default()
}

/// Whether an option is a setting of `up`, by its name here or in another program.
fn is_setting(option: &str) -> bool {
    let is_ours = ["--preset", "--config", "--set", "--seed"].contains(&option);
    is_ours || option.starts_with("--") && ours("up", option).is_some_and(|tip| tip.contains("`--set "))
}

/// What was probably meant by an argument that a command does not have.
fn unknown_argument(word: &str, command: &str, line: &clap::Command, words: &[String]) -> Option<String> {
    match word {
        word if command == "presets" && !word.starts_with('-') => {
            Some(format!("`orchestrator config --preset {word}` prints a preset"))
        }
        word if command == "kitchens" && word.parse::<u32>().is_ok() => {
            Some(format!("it is drawn by `--kitchens {word}`"))
        }
        word if command == "[OPTIONS]" && is_of_up(word, line) => {
            Some(format!("a command comes first, as in `orchestrator up {word}`"))
        }
        "--run" if words.get(2).is_some_and(|second| second.starts_with("--run")) => {
            let value = words[2].strip_prefix("--run=").or(words.get(3).map(String::as_str)).unwrap_or("RUN");
            Some(format!("the run comes without `--run`: `orchestrator {command} {}`", quoted(value)))
        }
        word if command == "eval" && !word.starts_with('-') => {
            Some(format!("it evaluates one at a time: `orchestrator eval {}` is another call", quoted(word)))
        }
        word if command == "clean" && !word.starts_with('-') => Some(
            "it takes no run: it frees the shared memory of all dead runs; `rm -r RUN` removes a run".to_owned(),
        ),
        "--env" | "--env-command" | "--env-kwargs" | "--env-declaration" if command == "doctor" => {
            Some("`orchestrator up` tries an environment of your own before the run begins".to_owned())
        }
        word if word.contains('=') && !word.starts_with('-') && ["up", "config", "import", "doctor"].contains(&command) => {
            assigned(word, line)
        }
        word if key_in(word).is_some() => key_in(word).map(|key| format!("here it is `--set {key}=VALUE`")),
        word if command == "scale" && word.parse::<u32>().is_ok() => {
            Some(format!("their number is given as `--actors {word}`"))
        }
        word if presets().iter().any(|preset| preset.name == word) => {
            Some(format!("a preset is given as `--preset {word}`"))
        }
        word if set_before(words, word).is_some() => {
            set_before(words, word).map(|key| format!("key and value are one word: `--set {key}={word}`"))
        }
        word if command == "up" && !word.starts_with('-') => {
            Some("a preset is given as `--preset NAME`; `orchestrator presets` lists them".to_owned())
        }
        word if command == "resume" && is_setting(word) => Some(
            "a run keeps its settings, but for --frames, --actors and --learners, and what is edited in its config.toml; \
             `orchestrator up --from RUN` begins another run with its weights"
                .to_owned(),
        ),
        word => {
            let of_task = if word == "--task" { preset_of_task(words) } else { None };
            of_task.or_else(|| ours(command, word))
        }
    }
}

/// The text of an error, with what is said here where a key of a configuration is another program's.
pub fn told(error: &anyhow::Error) -> String {
    let (text, tip) = (format!("{error:#}"), of_key(error));
    format!("{}{tip}", without_guess(&text, &tip))
}

/// A text without the likest of our own names, where another program's name means something else.
fn without_guess(text: &str, tip: &str) -> String {
    let ours = tip.split_once("here it is `").and_then(|(_, ours)| ours.trim_start_matches("--set ").split('=').next());
    let ours = ours.map(str::trim_end);
    let parts = text.split_once(" (did you mean ").and_then(|(before, rest)| Some((before, rest.split_once(')')?)));
    match (ours, parts) {
        (Some(ours), Some((before, (guess, after)))) if !guess.contains(ours) => format!("{before}{after}"),
        _ => text.to_owned(),
    }
}

/// What was probably meant by a name that is no preset's: a run, or a key.
fn of_preset(name: &str) -> Option<String> {
    if Path::new(name).is_dir() {
        return Some(format!("; `orchestrator config --of {}` prints that of a run", quoted(name)));
    }
    let (key, is_set) = name.split_once('=').map_or((name, false), |(key, _)| (key, true));
    let is_key = !matches!(format!("{key}=0").parse::<Setting>(), Err(SettingError::UnknownKey { .. }));
    match (is_key && key.contains('.'), is_set) {
        (false, _) => None,
        (true, true) => {
            Some(format!("; a preset comes first, as in `orchestrator config demo --set {}`", quoted(name)))
        }
        (true, false) => Some(format!("; `orchestrator config demo --json | jq .{key}` prints a key of a preset")),
    }
}

/// A tip for a command line as a line of TOML: `--set 'key=value'` is `key = value`.
fn in_a_file(tip: &str) -> String {
    let parts = tip.split_once("`--set ").and_then(|(before, rest)| Some((before, rest.split_once('`')?)));
    parts.map_or_else(
        || tip.to_owned(),
        |(before, (set, after))| format!("{before}`{}`{after}", set.trim_matches('\'').replacen('=', " = ", 1)),
    )
}

/// What is wrong with a key of a configuration that another program has, in a sentence's end; nothing of other errors.
fn of_key(error: &anyhow::Error) -> String {
    let of_file = wrong::causes(error).find_map(|cause| match cause.downcast_ref::<ConfigError>()? {
        ConfigError::UnknownKey { key, origin, .. } if ["runs", "seeds", "evaluations"].contains(&&**key) => {
            Some(format!("; a suite's file is for `orchestrator suite {}`", quoted(origin)))
        }
        ConfigError::Unreadable { path, .. } => {
            let preset = presets().iter().find(|preset| path.as_os_str() == &*preset.name)?;
            Some(format!("; `--preset {}` takes the preset", preset.name))
        }
        ConfigError::UnknownPreset { name, .. } => of_preset(name),
        _ => None,
    });
    if let Some(tip) = of_file {
        return tip;
    }
    let unknown = wrong::causes(error).find_map(|cause| {
        match (cause.downcast_ref::<ConfigError>(), cause.downcast_ref::<SettingError>()) {
            (Some(ConfigError::UnknownKey { key, nearest, .. }), _)
            | (_, Some(SettingError::UnknownKey { key, nearest })) => {
                ours("up", key).map(|tip| in_a_file(&tip)).or_else(|| nearest.is_none().then(|| ALL_KEYS.to_owned()))
            }
            _ => None,
        }
    });
    unknown.map_or_else(String::new, |said| format!("; {said}"))
}

/// What an error of a command line says in this place.
fn text_of(error: &clap::Error, kind: ContextKind) -> Option<String> {
    match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.clone()),
        Some(ContextValue::StyledStr(text)) => Some(text.to_string()),
        _ => None,
    }
}

/// What was probably meant.
fn tip_of(error: &clap::Error, line: &clap::Command, words: &[String]) -> Option<String> {
    let text = |kind| text_of(error, kind);
    match error.kind() {
        ErrorKind::InvalidSubcommand => text(ContextKind::InvalidSubcommand).and_then(|word| {
            let all = COMMANDS.iter().flat_map(|(_, theirs)| *theirs).copied();
            let is_suggested = error.get(ContextKind::SuggestedSubcommand).is_some();
            let meant = if is_suggested {
                word
            } else if let Some(theirs) = nearest(&word, all).filter(|meant| likeness(&word, meant) > 0.85) {
                theirs
            } else {
                // `help` itself suggests none.
                let own = line.get_subcommands().map(clap::Command::get_name);
                let guess = nearest(&word, own).map(|meant| format!("did you mean `{meant}`?"));
                return Some(guess.unwrap_or_else(|| "`orchestrator help` lists the commands".to_owned()));
            };
            let (ours, _) = COMMANDS.iter().find(|(_, theirs)| theirs.contains(&meant.as_str()))?;
            Some(format!("`orchestrator {ours}` does that"))
        }),
        ErrorKind::UnknownArgument => {
            let usage = text(ContextKind::Usage).unwrap_or_default();
            let word = text(ContextKind::InvalidArg)?;
            let tip = unknown_argument(&word, command_of(&usage), line, words)?;
            Some(with_value(tip, typed(words, &word)))
        }
        ErrorKind::MissingRequiredArgument => {
            let usage = text(ContextKind::Usage).unwrap_or_default();
            let command = command_of(&usage);
            if ["status", "stop", "resume", "eval", "report", "logs", "replay"].contains(&command) {
                newest_run(command)
            } else {
                MISSING.iter().find(|(of, _)| *of == command).map(|(_, tip)| (*tip).to_owned())
            }
        }
        ErrorKind::ArgumentConflict => Some("leave out one of the two".to_owned()),
        ErrorKind::InvalidValue => match text(ContextKind::InvalidValue)?.as_str() {
            "gif" => Some(
                "apng moves wherever a GIF does, and `ffmpeg -i FILM.mp4 FILM.gif` makes a GIF of a film".to_owned(),
            ),
            "gpu" | "GPU" => Some("it is `cuda`".to_owned()),
            word if text(ContextKind::InvalidArg).is_some_and(|option| option.starts_with("--objects ")) => {
                Some(of_objects(word).to_owned())
            }
            "unseen" | "novel" => Some("unseen kitchens are those of `test`".to_owned()),
            _ => None,
        },
        ErrorKind::ValueValidation => text(ContextKind::InvalidValue).and_then(|setting| {
            let (key, value) = setting.split_once('=')?;
            let (first, last) = (key.trim().split('.').next()?, key.trim().rsplit('.').next()?);
            // A value that is wrong is no key of another program.
            let Err(SettingError::UnknownKey { nearest, .. }) = setting.parse::<Setting>() else { return None };
            let is_unknown =
                |key: &str| matches!(format!("{key}=0").parse::<Setting>(), Err(SettingError::UnknownKey { .. }));
            let theirs = ours("up", last).or_else(|| ours("up", first).filter(|_| is_unknown(first)));
            let theirs = theirs.map(|tip| with_value(tip, Some(value.trim())));
            theirs.or_else(|| nearest.is_none().then(|| ALL_KEYS.to_owned()))
        }),
        _ => None,
    }
}

/// What was probably meant by a word that is no set of objects.
fn of_objects(word: &str) -> &'static str {
    match word {
        "known" | "train" | "training" | "trained" | "old" => {
            "it is `seen`: objects that were targets in training; `novel` those that were not, `all` both"
        }
        "both" | "any" | "every" | "everything" => "it is `all`: those seen in training and novel ones",
        _ if word.starts_with("new") || ["test", "unknown"].contains(&word) => {
            "it is `novel`: objects that were no targets in training; `seen` those that were, `all` both"
        }
        _ => "`novel` objects were no targets in training, `seen` ones were, `all` are both",
    }
}

/// An error of a command line, `line` as it is declared and `words` as it was typed, with what was probably meant.
pub fn with_tip(mut error: clap::Error, line: &clap::Command, words: &[String]) -> clap::Error {
    let tip = tip_of(&error, line, words);
    let bare = |word: &str| word.trim_start_matches('-').to_owned();
    let given = text_of(&error, ContextKind::InvalidArg).map(|word| bare(&word)).unwrap_or_default();
    // Letters in common alone make an argument like another.
    let is_unlike = |suggested: &ContextValue| match suggested {
        ContextValue::String(ours) => nearest(&given, std::iter::once(&*bare(ours))).is_none(),
        _ => false,
    };
    let dashes = |value: &ContextValue| matches!(value, ContextValue::StyledStrs(all) if all.iter().any(|one| one.to_string().contains("as a value")));
    if error.get(ContextKind::Suggested).is_some_and(dashes) {
        error.remove(ContextKind::Suggested);
    }
    if error.get(ContextKind::SuggestedArg).is_some_and(is_unlike) {
        error.remove(ContextKind::SuggestedArg);
        error.remove(ContextKind::Usage);
    }
    if let Some(tip) = tip {
        error.remove(ContextKind::SuggestedSubcommand);
        error.remove(ContextKind::SuggestedValue);
        // The usage is of the argument that was suggested.
        if error.remove(ContextKind::SuggestedArg).is_some() {
            error.remove(ContextKind::Usage);
        }
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    // The usage of a likely option names no other.
    if error.get(ContextKind::SuggestedArg).is_some() {
        error.remove(ContextKind::Usage);
    }
    let said = error.to_string();
    let readable = if said.contains("tip: here it is `--set ") {
        without_guess(&said, &said)
    } else if said.contains("..=") {
        said.replace(" is not in ", " is outside ").replace("..=", " to ")
    } else {
        NO_NUMBERS.iter().fold(said.clone(), |said, (theirs, ours)| said.replace(theirs, ours))
    };
    if readable == said { error } else { clap::Error::raw(error.kind(), readable.trim_start_matches("error: ")) }
}

#[cfg(test)]
mod tests {
    use crate::command_line;

    /// The same by each name of the program.
    fn answer(words: &[&str]) -> String {
        let by = |name: &str| {
            let line: Vec<String> = std::iter::once(&name).chain(words).map(|&word| word.to_owned()).collect();
            let error = command_line().try_get_matches_from(&line).unwrap_err();
            super::with_tip(error, &command_line(), &line).to_string()
        };
        let [text, other] = ["orchestrator", "/usr/bin/stillroom"].map(by);
        assert_eq!(other.replace("stillroom ", "orchestrator "), text, "{words:?}");
        text
    }

    /// A command, an option and an argument that other programs have: each is answered by its line.
    #[test]
    fn every_word_of_other_programs_is_answered_by_its_line() {
        for (ours, theirs) in super::COMMANDS {
            let tip = format!("tip: `orchestrator {ours}` does that");
            assert!(theirs.iter().all(|word| answer(&[word]).contains(&tip)), "{ours}");
        }
        for (command, ours, theirs) in super::OPTIONS {
            for name in theirs.split(' ') {
                let option = if name.len() == 1 { format!("-{name}") } else { format!("--{name}") };
                let commands = if command.is_empty() { vec!["up", "eval"] } else { vec![*command] };
                for command in commands {
                    let error = answer(&[command, &option]);
                    assert!(error.contains(&format!("tip: here {ours}\n")), "{command} {option}: {error}");
                }
            }
        }
    }

    #[test]
    fn what_others_understand_is_answered_with_what_we_do() {
        for (words, tip) in [
            (&["up", "recepie"][..], "tip: a preset is given as `--preset NAME`; `orchestrator presets` lists them"),
            (&["resume", "runs/a", "--preset", "demo"], "tip: a run keeps its settings"),
            (&["upp"], "'up'"),
            (&["--preset", "demo"], "tip: a command comes first, as in `orchestrator up --preset`"),
            (&["--verion"], "tip: a similar argument exists: '--version'"),
            (&["kitchens", "7"], "tip: it is drawn by `--kitchens 7`"),
            (&["resume", "--run", "first"], "tip: the run comes without `--run`: `orchestrator resume first`"),
            (&["eval", "--run=my run"], "tip: the run comes without `--run`: `orchestrator eval 'my run'`"),
            (&["up", "-p", "demo"], "tip: here it is `--preset demo`"),
            (&["help", "upp"], "tip: did you mean `up`?"),
            (&["replay", "a", "--format", "gif"], "tip: apng moves wherever a GIF does"),
            (&["eval", "a", "--split", "test", "--kitchens", "7"], "tip: leave out one of the two"),
            (&["config", "--set", "network.gru=false"], "tip: here it is `--set network.memory=none`"),
            (&["config", "--set", "camera.height=1.2"], "tip: here the robot's and the camera's dimensions are no"),
            (&["up", "--resume", "runs/a"], "tip: here it is `orchestrator resume runs/a`"),
            (&["trian"], "tip: `orchestrator up` does that"),
            (&["presets", "--jsn"], "tip: a similar argument exists: '--json'"),
            (&["presets", "demo"], "tip: `orchestrator config --preset demo` prints a preset"),
            (&["scale", "runs/a", "40"], "tip: their number is given as `--actors 40`"),
            (
                &["up", "--set", "num_envs=8"],
                "tip: here it is `--actors N` times `--envs-per-actor N` (`actors.count` and `actors.environments_per_actor` in settings)",
            ),
            (&["config", "--set", "n_steps = 128"], "tip: here it is `--set ppo.rollout_steps=128`"),
            (&["up", "--set", "learning_rate=1e-3"], "tip: here it is `--set ppo.learning_rate=1e-3`"),
            (&["up", "--set", "ppo.lr=1e-3"], "tip: here it is `--set ppo.learning_rate=1e-3`"),
            (&["up", "ppo.lr=1e-3"], "tip: here it is `--set ppo.learning_rate=1e-3`"),
            (&["up", "batch_size=64"], "tip: here it is `--set ppo.minibatches=N`, how many of them"),
            (&["up", "ppo.gamma=0.9"], "tip: each key has a `--set` of its own: `--set ppo.gamma=0.9`"),
            (&["up", "envs_per_actor=2"], "tip: here it is `--envs-per-actor 2`"),
            (&["up", "--set", "clip_range_vf=0.2"], "tip: here it is `--set ppo.clip_value=true`"),
            (&["up", "--gamma", "0.9"], "tip: here it is `--set ppo.gamma=0.9`"),
            (&["up", "--gae_lambda", "0.9"], "tip: here it is `--set ppo.gae_lambda=0.9`"),
            (&["config", "--lr", "1e-3"], "tip: here it is `--set ppo.learning_rate=1e-3`"),
            (&["up", "--task", "Isaac-Lift"], "tip: here it is `--preset NAME`, or `--env gymnasium:ID`"),
            (&["up", "--envs_per_actor", "3"], "tip: a similar argument exists: '--envs-per-actor'"),
            // A value that was typed, where it fits.
            (&["up", "--lr=3e-4"], "tip: here it is `--set ppo.learning_rate=3e-4`"),
            (&["up", "--lr", "--seed", "1"], "tip: here it is `--set ppo.learning_rate=RATE`"),
            (&["up", "--lr", "fast"], "tip: here it is `--set ppo.learning_rate=RATE`"),
            (&["up", "--save-freq", "9"], "tip: here it is `--set checkpoint.interval_s=SECONDS`, in seconds"),
            (&["up", "--clip-vloss", "false"], "tip: here it is `--set ppo.clip_value=false`"),
            (&["up", "--run-name", "my run"], "tip: here it is `--run 'runs/my run'`"),
            (&["up", "--exp-name", "foo"], "tip: here it is `--run runs/foo`"),
            (
                &["up", "--max_iterations", "100"],
                "tip: here it is `--frames N`: N = iterations × `ppo.rollout_steps` ×",
            ),
            (&["resume", "a", "--max_iterations", "9"], "tip: here it is `--frames N`: N = iterations ×"),
            (&["resume", "a", "--lr", "1e-3"], "tip: a run keeps its settings"),
            (&["up", "--gpus", "0"], "tip: here it is `--learners N`, one a GPU; CUDA_VISIBLE_DEVICES chooses which"),
            (
                &["up", "habitat_baselines.num_environments=4"],
                "tip: here it is `--actors N` times `--envs-per-actor N`",
            ),
            (&["up", "hydra.run.dir=x"], "tip: `orchestrator config` prints all keys"),
            (&["eval", "a", "b"], "tip: it evaluates one at a time: `orchestrator eval b` is another call"),
            (&["suite", "a.toml", "--jobs", "4"], "tip: here it is `--gpus 0,1`: one run at a time on each"),
            (&["help", "nothing"], "tip: `orchestrator help` lists the commands"),
            (&["eval", "a", "--split", "unseen"], "tip: unseen kitchens are those of `test`"),
            // What is missing, or elsewhere.
            (&["export", "runs/a"], "tip: `orchestrator export RUN --out policy.onnx` writes a model"),
            (&["scale", "runs/a"], "tip: `orchestrator scale RUN --actors 8`"),
            (&["eval", "a", "--device", "gpu"], "tip: it is `cuda`"),
            (&["clean", "runs"], "tip: it takes no run"),
            (&["doctor", "--env", "a"], "tip: `orchestrator up` tries an environment"),
            (
                &["up", "--set", "seed=1", "ppo.clip=0.2"],
                "tip: each key has a `--set` of its own: `--set ppo.clip=0.2`",
            ),
            (&["up", "--ppo.clip=0.2"], "tip: here it is `--set ppo.clip=0.2`"),
            (&["up", "--set", "curriculum=none"], "tip: `orchestrator config` prints all keys"),
            (&["up", "--set", "checkpoint.every_frames=8"], "tip: `orchestrator config` prints all keys"),
        ] {
            let error = answer(words);
            assert!(error.contains(tip) && error.matches("tip:").count() == 1, "{words:?}: {error}");
        }
    }

    #[test]
    fn what_a_tip_names_is_there_and_what_needs_none_has_none() {
        for (_, ours, _) in super::OPTIONS.iter().filter(|(_, ours, _)| ours.contains("--set ")) {
            let key = ours.split("--set ").nth(1).unwrap().trim_start_matches('\'').split('=').next().unwrap();
            let problem = format!("{key}=[]").parse::<super::Setting>().err();
            assert!(!matches!(problem, Some(super::SettingError::UnknownKey { .. })), "{ours}");
        }
        for (words, said) in [
            (["eval", "runs/a", "--run", "b"], "unexpected argument '--run'"),
            (["eval", "runs/a", "--episodes", "many"], "expected a whole number"),
            (["kitchens", "--width", "-5", "--gltf"], "-5 is outside 320 to 8192"),
            (["logs", "runs/a", "--since", "yesterday"], "unexpected argument '--since'"),
        ] {
            let error = answer(&words);
            assert!(error.contains(said) && !error.contains("tip:"), "{words:?}: {error}");
        }
    }

    #[test]
    fn beside_what_another_name_means_no_name_is_guessed() {
        let error = answer(&["up", "--set", "ppo.clip_range=0.1"]);
        assert!(error.contains("`clip_range`\n\n  tip: here it is `--set ppo.clip=0.1`"), "{error}");
        assert!(answer(&["up", "--set", "gamma=0.9"]).contains("(did you mean `ppo.gamma`?)"));
        assert!(answer(&["up", "--set", "learning_rate=1e-3"]).contains("(did you mean `ppo.learning_rate` or "));
    }

    #[test]
    fn a_word_that_is_no_set_of_objects_is_answered_with_those_that_are() {
        let novel = "it is `novel`: objects that were no targets in training; `seen` those that were, `all` both";
        let seen = "it is `seen`: objects that were targets in training; `novel` those that were not, `all` both";
        let all = "it is `all`: those seen in training and novel ones";
        let any = "`novel` objects were no targets in training, `seen` ones were, `all` are both";
        for (word, tip) in [("new", novel), ("newest", novel), ("known", seen), ("both", all), ("Cup", any)] {
            let error = answer(&["eval", "a", "--objects", word]);
            assert!(error.contains(&format!("tip: {tip}\n")), "{word}: {error}");
            assert!(error.contains("[possible values: novel, seen, all]"), "{error}");
        }
    }

    #[test]
    fn a_likely_option_is_not_all_that_a_command_takes() {
        let error = answer(&["up", "--prest", "demo"]);
        assert!(error.contains("tip: a similar argument exists: '--preset'") && !error.contains("Usage:"), "{error}");
    }

    #[test]
    fn an_option_that_a_tip_names_is_one_of_its_command() {
        for (command, ours, _) in super::OPTIONS.iter().filter(|(command, ours, _)| {
            ["view", "replay", "eval", "suite", "resume"].contains(command) && ours.starts_with("it is `--")
        }) {
            let option = ours.trim_start_matches("it is `--").split([' ', '`']).next().unwrap();
            let line = command_line();
            let of = line.find_subcommand(command).unwrap();
            assert!(of.get_arguments().any(|argument| argument.get_long() == Some(option)), "{command}: {ours}");
        }
    }

    #[test]
    fn a_key_of_another_program_is_answered_in_a_file_too() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("mine.toml");
        std::fs::write(&file, "[ppo]\nlr = 1e-3\n").unwrap();
        let error = super::Config::resolve_set("demo", Some(&file), &[]).unwrap_err();
        let ours = "; here it is `ppo.learning_rate = RATE`";
        assert_eq!(super::of_key(&error.into()), ours);
        std::fs::write(&file, "scene = [\"a.toml\"]\n").unwrap();
        let error = super::Config::resolve_set("demo", Some(&file), &[]).unwrap_err();
        assert_eq!(super::of_key(&error.into()), "; here it is `scenes = [\"FILE.toml\"]`");
        std::fs::write(&file, "[ppo]\nclip_range = 0.1\n").unwrap();
        let error = super::Config::resolve_set("demo", Some(&file), &[]).unwrap_err();
        assert!(super::told(&error.into()).ends_with("unknown key `clip_range`; here it is `ppo.clip = CLIP`"));
        let error = super::Config::resolve_set("demo", Some("demo".as_ref()), &[]).unwrap_err();
        assert_eq!(error.to_string(), "cannot read configuration demo: there is no such file");
        assert_eq!(super::of_key(&error.into()), "; `--preset demo` takes the preset");
        for (name, tip) in [
            (
                folder.path().to_str().unwrap(),
                format!("; `orchestrator config --of {}` prints that of a", folder.path().display()),
            ),
            ("ppo.clip=0.1", "; a preset comes first, as in `orchestrator config demo --set ppo.clip=0.1`".to_owned()),
            ("ppo.clip", "; `orchestrator config demo --json | jq .ppo.clip` prints a key of a preset".to_owned()),
        ] {
            let error = super::of_key(&super::Config::resolve(name, None).unwrap_err().into());
            assert!(error.starts_with(&tip), "{error}");
        }
        assert_eq!(super::of_key(&super::Config::resolve("demmo", None).unwrap_err().into()), "");
        std::fs::write(&file, "[[runs]]\npreset = \"demo\"\n").unwrap();
        let error = super::Config::resolve_set("demo", Some(&file), &[]).unwrap_err();
        let of_suite = format!("; a suite's file is for `orchestrator suite {}`", file.display());
        assert_eq!(super::of_key(&error.into()), of_suite);
        let suite = "seeds = [1]\n[[runs]]\npreset = \"demo\"\nconfig.ppo.lr = 1e-3\n";
        let error = crate::wrong::wrong(crate::suite::Suite::parse(suite).unwrap_err());
        assert_eq!(super::of_key(&error), ours);
        assert_eq!(super::of_key(&anyhow::anyhow!("the disk is full")), "");
    }
}
