use crate::environment::consent::shown;
use crate::environment::trial::{Ended, Trial};
use crate::output::log_line::ERROR;
use anyhow::{Context, Result, anyhow, bail};
use proto::config::EnvironmentConfig;
use proto::printable::printable;
use proto::task::Description;
use rustix::process::{Pid, Signal, kill_process_group};
use std::io::Read;
use std::os::unix::process::CommandExt;
use std::process::Stdio;
use std::thread::ScopedJoinHandle;
use std::time::Duration;
use wire::HeldRequests;

const NOTHING: &str = "nothing";
const SAYS_MOST: u64 = 4 << 20;

#[derive(Debug)]
pub struct Answer {
    pub description: Description,
    /// How many of them an actor has, where it makes vectors of a size.
    pub environments: Option<u32>,
    /// What a run goes on without.
    pub warnings: Vec<String>,
}

/// This program was asked to end.
#[derive(Debug, thiserror::Error)]
#[error("interrupted while the environment was tried: nothing was begun")]
pub struct Interrupted;

/// Tries the environment, which describes itself. `declaration`: TOML that has channels. `deadline`: for each call of its
/// methods.
pub fn describe(environment: &EnvironmentConfig, declaration: &str, deadline: Duration) -> Result<Answer> {
    let mut words = vec!["--describe"];
    let declared = declaration.parse::<toml::Table>()?.get("channels").map(serde_json::to_string).transpose()?;
    words.extend(declared.iter().flat_map(|declared| ["--declared", declared]));
    let (answer, errors) = ask(environment, &words, deadline)?;
    let command = shown(&environment.command);
    read(&answer)
        .with_context(|| format!("`{command}` answers with what is no description; it says: {}", last(&errors)))
}

/// Refuses environments whose package was compiled from other sources than this program: their actors would all die.
pub fn demand_build(environment: &EnvironmentConfig) -> Result<()> {
    const OWN: &str = wire::version::BUILD;
    let found = match ask(environment, &["--build"], Duration::MAX) {
        Ok((answer, _)) if answer.trim_ascii() == OWN.as_bytes() => return Ok(()),
        Ok((answer, _)) if answer.trim_ascii().len() == OWN.len() => {
            format!("build {}", printable(String::from_utf8_lossy(&answer).trim()))
        }
        Ok((_, errors)) => {
            bail!(
                "`{}` serves no environments: it must call stillroom.serve(make_env), or stillroom_serve of C \
                 (docs/your-simulator.md); it says: {}",
                shown(&environment.command),
                last(&errors)
            )
        }
        Err(error) if error.to_string().contains("--build") => "an older build".to_owned(),
        Err(error) => return Err(error),
    };
    bail!(
        "the package `stillroom` that `{}` uses is {found}, and this program, {}, is build {OWN}: `make python` \
         installs this program's package, and `--python .venv/bin/python` takes it; elsewhere install the wheel or \
         library that was made with this program",
        shown(&environment.command),
        std::env::current_exe().unwrap_or_default().display()
    )
}

fn ask(environment: &EnvironmentConfig, words: &[&str], deadline: Duration) -> Result<(Vec<u8>, String)> {
    let command = &environment.command;
    let mut asked = environment.program();
    asked.args(words).arg("--lifeline").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = asked.process_group(0).spawn().with_context(|| format!("cannot start `{}`", shown(command)))?;
    let requests = HeldRequests::hold();
    let group = Pid::from_child(&child);
    // The first closes when this program ends, however it does: then the environment ends, too.
    let (_lifeline, output, errors) = (child.stdin.take(), child.stdout.take(), child.stderr.take());
    let trial = Trial::default();
    std::thread::scope(|scope| {
        let answer = scope.spawn(|| output.map_or(Ok(vec![]), |output| trial.read(output.take(SAYS_MOST))));
        let errors = scope.spawn(|| whole(errors));
        let ended = trial.wait(&mut child, &requests, deadline);
        // Also what the environment has started and left behind, which may hold the pipes.
        let _ = kill_process_group(group, Signal::KILL);
        let _ = child.wait();
        let joined = |reader: ScopedJoinHandle<'_, std::io::Result<Vec<u8>>>| {
            reader.join().map_err(|_| anyhow!("a reader panicked"))?.context("cannot read what it says")
        };
        let read = (joined(answer)?, String::from_utf8_lossy(&joined(errors)?).into_owned());
        match ended.context("cannot wait for the environment's process")? {
            Ended::Exited(status) if status.success() => Ok(read),
            Ended::Exited(status) => {
                // Tracebacks, with --verbose.
                read.1.lines().for_each(|line| tracing::debug!("{}", printable(line)));
                bail!("{}", refusal(command, &read.1, &proto::exit::how(status)))
            }
            Ended::Late(late) => bail!("{}", late.sentence(&shown(command), place(&read.1).as_deref())),
            Ended::Interrupted => bail!(Interrupted),
        }
    })
}

fn read(answer: &[u8]) -> serde_json::Result<Answer> {
    let mut table: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(answer)?;
    let environments = table.remove("environments").map(serde_json::from_value).transpose()?;
    let warnings = table.remove("warnings").map(serde_json::from_value).transpose()?.unwrap_or_default();
    Ok(Answer { description: serde_json::from_value(table.into())?, environments, warnings })
}

fn whole(stream: Option<impl Read>) -> std::io::Result<Vec<u8>> {
    let mut bytes = vec![];
    stream.map_or(Ok(0), |stream| stream.take(SAYS_MOST).read_to_end(&mut bytes))?;
    Ok(bytes)
}

fn refusal(command: &[String], errors: &str, how: &str) -> String {
    let program = command.first().map_or("", String::as_str);
    // In sources without `make python` its compiled part is missing.
    if ["stillroom", "'stillroom._stillroom'"].iter().any(|name| errors.contains(&format!("No module named {name}"))) {
        return format!(
            "{program} has no package `stillroom`: install its wheel there (docs/your-simulator.md), or name another \
             interpreter with --python; in a checkout `make python` makes `--python .venv/bin/python`"
        );
    }
    match errors.lines().rev().find_map(|line| line.strip_prefix(ERROR)) {
        Some(problem) => printable(problem).into_owned(),
        None => match (crash(errors), last(errors)) {
            (Some(place), _) => format!("`{}` {how} in {place}", shown(command)),
            (None, said) if said == NOTHING && how.starts_with("ended") => {
                format!("`{}` {how} without a message: does its reset() or step() call os._exit?", shown(command))
            }
            (None, said) => format!("`{}` {how}; its last message: {said}", shown(command)),
        },
    }
}

/// Where Python's `faulthandler` found a crash.
fn crash(errors: &str) -> Option<String> {
    place(errors.split_once("Fatal Python error: ")?.1)
}

/// Where Python is in what its `faulthandler` writes: the innermost call, of the user's own code if there is one.
pub fn place(errors: &str) -> Option<String> {
    let (_, frames) = errors.split_once(" (most recent call first):")?;
    let calls = || frames.lines().filter_map(|line| line.strip_prefix("  File \""));
    let is_own = |call: &&str| !call.contains("/site-packages/") && !call.starts_with('<');
    let call = calls().find(is_own).or_else(|| calls().next())?;
    let (file, rest) = call.split_once("\", line ")?;
    let (line, function) = rest.split_once(" in ")?;
    let at = format!("{file}:{line}");
    let place = if function.starts_with('<') { at } else { format!("{function}() ({at})") };
    Some(printable(&place).into_owned())
}

fn last(errors: &str) -> String {
    let last = errors.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or(NOTHING);
    printable(last).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(command: &[&str]) -> EnvironmentConfig {
        let command = command.iter().map(|&word| word.to_owned()).collect();
        EnvironmentConfig { command, declaration: String::new() }
    }

    fn asked(script: &str) -> Result<Answer, String> {
        let environment = environment(&["sh", "-c", script]);
        describe(&environment, "", Duration::from_secs(1)).map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn another_build_is_one_sentence_that_says_which_is_which() {
        let of = |script: &str| demand_build(&environment(&["sh", "-c", script])).map_err(|error| error.to_string());
        let own = wire::version::BUILD;
        of(&format!("test $0 = --build && echo {own}")).unwrap();
        let older = "echo 'usage: x\nserve: error: unrecognized arguments: --build' >&2; exit 2";
        assert!(of("true").unwrap_err().contains("serves no environments"));
        let other = "0123456789abcdef";
        for (script, found) in
            [(&*format!("echo {other}"), &*format!("is build {other},")), (older, "is an older build,")]
        {
            let problem = of(script).unwrap_err();
            assert!(problem.contains(found) && problem.contains(own) && problem.contains("`make python`"), "{problem}");
        }
    }

    #[test]
    fn a_description_is_read_and_everything_else_is_one_sentence() {
        let answer = r#"{ "name": "mine", "actions": { "kind": "discrete", "names": ["a"] }, "channels": [] }"#;
        assert_eq!(asked(&format!("echo '{answer}'; sleep 100 &")).unwrap().description.name, "mine");
        let vectors = asked(&format!("echo '{}'", answer.replacen('{', "{ \"environments\": 16,", 1))).unwrap();
        assert_eq!((vectors.description.name.as_str(), vectors.environments), ("mine", Some(16)));
        let call = r#"{"call": "step()", "place": "step 1 of the episode with seed 1"}"#;
        let warned = answer.replacen('{', "{ \"warnings\": [\"it has more\"],", 1);
        assert_eq!(asked(&format!("echo '{call}'; echo '{warned}'")).unwrap().warnings, ["it has more"]);
        for (script, expected) in [
            ("echo nonsense; echo noise >&2", "what is no description; it says: noise"),
            ("echo trace >&2; echo 'stillroom: error: it has no step' >&2; exit 2", "it has no step"),
            ("echo 'python3: No module named stillroom' >&2; exit 1", "has no package `stillroom`"),
            ("echo \"Error: No module named 'stillroom._stillroom'\" >&2; exit 1", "has no package `stillroom`"),
            ("kill -SEGV $$", "its last message: nothing"),
            ("exit 3", "ended with exit status: 3 without a message: does its reset() or step() call os._exit?"),
            (
                "printf 'Fatal Python error: Segmentation fault\n\nCurrent thread 0x1 (most recent call first):\n  File \
                 \"/p/site-packages/a.py\", line 3 in go\n  File \"/mine.py\", line 14 in step\n' >&2; kill -SEGV $$",
                "was killed by signal 11 (SIGSEGV) in step() (/mine.py:14)",
            ),
        ] {
            let problem = asked(script).unwrap_err();
            assert!(problem.contains(expected) && !problem.contains('\n'), "{problem}");
        }
        assert!(describe(&environment(&["/no/such/program"]), "", Duration::from_secs(1)).is_err());
    }

    #[test]
    fn a_hang_is_said_with_its_call_and_place_and_leaves_no_process() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("pid");
        let traced = "Current thread 0x1 (most recent call first):\\n  File \\\"/mine.py\\\", line 14 in step\\n";
        let script = format!(
            r#"trap 'printf "{traced}" >&2' USR1; echo '{{"call": "step()", "place": "step 4 of the episode with seed 1"}}'
            sleep 1000 & echo $! > {file}; wait; wait"#,
            file = file.display()
        );
        let problem = asked(&script).unwrap_err();
        assert_eq!(
            problem,
            "the environment's step() has not returned for 1 s (last call: step 4 of the episode with seed 1), and is in \
             step() (/mine.py:14); learner.actor_deadline_s is its deadline"
        );
        let pid: i32 = std::fs::read_to_string(file).unwrap().trim().parse().unwrap();
        let state = || std::fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
        // It is gone, or dead until somebody waits for it.
        let gone = || state().is_empty() || state().contains(") Z ");
        for _ in 0..500 {
            if gone() {
                break;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        assert!(gone(), "{}", state());
    }
}
