use super::overrides::Overrides;
use crate::environment::describe::{Answer, Interrupted, demand_build, describe};
use crate::environment::{consent, deadline};
use crate::output::terminal;
use crate::preflight::programs::on_path;
use crate::wrong::{demand, judged, reject, wrong};
use anyhow::{Context, Result, ensure};
use clap::Args;
use proto::bounded;
use proto::config::{EnvironmentConfig, Setting};
use proto::shell::quoted;
use proto::task::Spec;
use std::path::{Path, PathBuf};

/// An environment of the user's.
#[derive(Debug, Clone, Default, Args)]
pub struct EnvironmentFlags {
    /// Environment of your own (docs/your-simulator.md): gymnasium:ID, envpool:ID, package.module:function
    /// or ./file.py:function
    #[arg(long, value_name = "ENV", conflicts_with = "env_command")]
    env: Option<String>,
    /// Keyword arguments for it, as JSON
    #[arg(long, value_name = "JSON", requires = "env")]
    env_kwargs: Option<String>,
    /// Python that it runs in [default: that of the active virtual environment, else of this program's own, else python3]
    #[arg(long, value_name = "PYTHON", requires = "env")]
    python: Option<PathBuf>,
    /// Any other program that serves environments, such as a script that calls stillroom.serve: its words, as a shell
    /// reads them
    #[arg(long, value_name = "COMMAND")]
    env_command: Option<String>,
    /// Rewards, metrics, cost and channels of `info` that its declaration gets beside its spaces: a TOML file
    #[arg(long, value_name = "FILE")]
    env_declaration: Option<PathBuf>,
}

impl EnvironmentFlags {
    pub fn is_named(&self) -> bool {
        self.env.is_some() || self.env_command.is_some()
    }

    /// Asks the environment what it is. The settings of its task; none where no environment is named. Naming it is the
    /// consent to start it. `given`: what the user sets beside it.
    pub fn settings(&self, given: &Overrides) -> Result<Vec<Setting>> {
        let Some(command) = self.command()? else {
            demand!(self.env_declaration.is_none(), "--env-declaration goes with --env or --env-command");
            return Ok(vec![]);
        };
        if let Some(task) = given.built_in_task()? {
            reject!("task = \"{task}\" is a built-in task, and an environment of your own has its own: leave it out");
        }
        let mut environment = EnvironmentConfig { command, declaration: String::new() };
        let file = self.env_declaration.as_ref().map_or_else(String::new, |path| path.display().to_string());
        let more = match &self.env_declaration {
            Some(path) => judged(bounded::read_text(path).with_context(|| format!("cannot read {file}")))?,
            None => String::new(),
        };
        EnvironmentConfig::check_addition(&more, &file)?;
        demand_build(&environment)?;
        let tried = describe(&environment, &more, deadline(&given.over_defaults()?));
        let tried = tried.map_err(|error| if error.is::<Interrupted>() { error } else { wrong(error) });
        let Answer { description, environments, warnings } = tried?;
        for warning in &warnings {
            terminal::note(&format!("warning: {warning}"));
        }
        if let (Some(size), Some(given)) = (environments, given.environments_per_actor()?) {
            ensure!(
                size == given,
                "the environment makes vectors of a size that an actor of {given} environments cannot have: leave out \
                 --envs-per-actor and actors.environments_per_actor, or say {size}"
            );
        }
        environment.declaration = description.declaration(&more)?;
        let of = if more.is_empty() { "the environment's declaration" } else { &file };
        let task = judged(Spec::kept(&environment.declaration).context(of.to_owned()))?.name.clone();
        consent::allow(&environment.command)?;
        let environment = toml::Value::try_from(environment)?;
        let mut settings = vec![Setting::new("task", task.into())?, Setting::new("environment", environment)?];
        if let Some(size) = environments {
            settings.push(Setting::new("actors.environments_per_actor", i64::from(size).into())?);
        }
        Ok(settings)
    }

    fn command(&self) -> Result<Option<Vec<String>>> {
        if let Some(command) = &self.env_command {
            demand!(!command.trim().is_empty(), "--env-command is empty");
            check_command(command)?;
            // A shell reads it, in the folder where the user wrote it, and adds what the orchestrator says.
            let script = format!("cd {} && exec {command} \"$@\"", quoted(std::env::current_dir()?));
            return Ok(Some(["sh", "-c", &script, "sh"].map(str::to_owned).to_vec()));
        }
        let Some(env) = &self.env else { return Ok(None) };
        let Some((place, name)) = env.split_once(':') else {
            let is_file = Path::new(env).extension().is_some_and(|extension| extension == "py");
            demand!(!is_file, "--env {env} names no function: give it, as in {env}:make_env");
            let example = match env.as_str() {
                "gymnasium" | "envpool" => format!("{env}:CartPole-v1"),
                id => format!("gymnasium:{id}"),
            };
            reject!(
                "--env {env}: expected gymnasium:ID, envpool:ID, package.module:function or ./file.py:function, as in \
                 {example}"
            );
        };
        let text = |path: PathBuf| path.into_os_string().into_string().ok().context("a path is not text");
        let absolute = |path: &Path| std::path::absolute(path).context("the current folder").and_then(text);
        let is_file = Path::new(place).extension().is_some_and(|extension| extension == "py");
        let env = if is_file { format!("{}:{name}", absolute(Path::new(place))?) } else { env.clone() };
        let mut command = vec![text(self.interpreter()?)?, "-m".into(), "stillroom".into(), "serve".into(), env];
        if !["gymnasium", "envpool"].contains(&place) {
            command.extend(["--path".to_owned(), absolute(Path::new("."))?]);
        }
        if let Some(kwargs) = &self.env_kwargs {
            let table: serde_json::Value =
                judged(serde_json::from_str(kwargs).context("--env-kwargs is no JSON, such as '{\"size\": 5}'"))?;
            demand!(table.is_object(), "--env-kwargs is {table}, not an object such as {{\"size\": 5}}");
            command.extend(["--kwargs".to_owned(), table.to_string()]);
        }
        Ok(Some(command))
    }

    /// The interpreter under its own name: in a virtual environment that is a link.
    fn interpreter(&self) -> Result<PathBuf> {
        let active = || std::env::var_os("VIRTUAL_ENV").map(|folder| PathBuf::from(folder).join("bin/python"));
        match &self.python {
            Some(python) if python.components().count() > 1 => {
                demand!(python.exists(), "--python {} does not exist", python.display());
                Ok(std::path::absolute(python)?)
            }
            Some(python) => {
                let name = python.to_str().context("--python is not text")?;
                on_path(name).with_context(|| format!("there is no program `{name}` on the PATH"))
            }
            None => {
                let own = || beside(&std::env::current_exe().ok()?);
                active()
                    .or_else(own)
                    .or_else(|| on_path("python3"))
                    .context("there is no Python: name one with --python")
            }
        }
    }
}

/// The interpreter of the virtual environment that a program is installed in: in its `bin`, or in a package of it.
fn beside(program: &Path) -> Option<PathBuf> {
    let environment = program.ancestors().find(|folder| folder.join("pyvenv.cfg").is_file())?;
    Some(environment.join("bin/python")).filter(|python| python.exists())
}

/// Refuses a command whose quotation marks are not closed, or whose program is not there: a shell says less.
fn check_command(command: &str) -> Result<()> {
    // What a shell makes of these is its own.
    let is_expanded = |word: &str| word.contains(['~', '*', '?', '[', '{', '(', ')', '<', '>', '|', '&', ';']);
    if command.contains(['$', '`']) || command.split_whitespace().next().is_none_or(is_expanded) {
        return Ok(());
    }
    let Some(words) = shlex::split(command) else {
        reject!("--env-command {command}: a quotation mark is not closed");
    };
    let Some(word) = words.first() else { return Ok(()) };
    let is_there = if word.contains('/') { Path::new(word).is_file() } else { on_path(word).is_some() };
    demand!(is_there, "--env-command {word}: there is no such file or program");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_that_no_shell_can_start_is_refused_in_a_sentence() {
        let said = |command: &str| check_command(command).map_err(|error| format!("{error:#}"));
        let missing = |word: &str| -> Result<(), String> {
            Err(format!("--env-command {word}: there is no such file or program"))
        };
        assert_eq!(said("./nope"), missing("./nope"));
        assert_eq!(said("'./no pe' --size 3"), missing("./no pe"));
        assert_eq!(said("no-such-stillroom-program x"), missing("no-such-stillroom-program"));
        for command in ["'unclosed", "sh -c \"echo", "sh it's"] {
            assert_eq!(said(command), Err(format!("--env-command {command}: a quotation mark is not closed")));
        }
        for command in ["sh", "\"sh\" -c 'exec \"x'", "/bin/sh -c it\\'s", "$PYTHON mine.py", "~/nope", "./a*"] {
            assert_eq!(said(command), Ok(()), "{command}");
        }
    }

    #[test]
    fn a_program_in_a_virtual_environment_has_its_interpreter() {
        let folder = tempfile::tempdir().unwrap();
        let (bin, package) = (folder.path().join("bin"), folder.path().join("lib/python3.12/site-packages/programs"));
        std::fs::create_dir_all(&bin).unwrap();
        std::fs::create_dir_all(&package).unwrap();
        std::fs::write(bin.join("python"), "").unwrap();
        assert_eq!(beside(&bin.join("orchestrator")), None, "any folder");
        std::fs::write(folder.path().join("pyvenv.cfg"), "").unwrap();
        for place in [&bin, &package] {
            assert_eq!(beside(&place.join("orchestrator")), Some(bin.join("python")));
        }
    }
}
