use super::overrides::Overrides;
use crate::hosts::agent::{Agent, Otherwise};
use crate::hosts::membership::{Flags, Membership, membership};
use crate::hosts::rendezvous::{Patience, Rendezvous};
use crate::hosts::token::Token;
use crate::output::format::counted;
use crate::run::scenes;
use crate::training::run::Started;
use crate::wrong::wrong;
use anyhow::{Context, Result};
use clap::Args;
use proto::config::Config;
use proto::run_folder::RunFolder;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

/// Where a run has several hosts: the same command on each.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Several hosts (torchrun and srun say which host this is; docs/cluster.md)")]
pub struct HostFlags {
    /// Hosts that share the run; learners and actors are divided among them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=512))]
    hosts: Option<u32>,
    /// This host, from 0
    #[arg(long, value_name = "K")]
    host_rank: Option<u32>,
    /// Where the hosts meet: name or address of host 0, and a free port there
    #[arg(long, value_name = "HOST:PORT")]
    rendezvous: Option<String>,
    /// Actors of each host, instead of --actors for all: with another number of hosts there are more or fewer
    #[arg(long, value_name = "N", conflicts_with = "actors", value_parser = clap::value_parser!(u32).range(1..=512))]
    actors_per_host: Option<u32>,
    /// Learners of each host, instead of --learners for all
    #[arg(long, value_name = "R", conflicts_with = "learners", value_parser = clap::value_parser!(u32).range(1..=512))]
    learners_per_host: Option<u32>,
    /// The network to use here: an interface's name or address [default: the one that reaches the rendezvous]
    #[arg(long, value_name = "NAME|ADDRESS")]
    interface: Option<String>,
    /// A file with the secret that all hosts of the run share [default: the one that the variable `STILLROOM_TOKEN_FILE`
    /// names, or the secret itself in `STILLROOM_TOKEN`]
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// How long hosts wait for one another at the start, seconds
    #[arg(long, value_name = "S", default_value_t = 600, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    join_deadline: u64,
    /// Seconds from the loss of a host to the end of the job on all others, at most. Below 15 it can take longer: killed
    /// processes and recordings need their time. A host that sends nothing for a third of this time is lost [default: 30]
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(3..=3600))]
    host_deadline: Option<u64>,
}

impl HostFlags {
    pub fn membership(&self) -> Result<Option<Membership>> {
        let (hosts, host_rank, rendezvous) = (self.hosts, self.host_rank, self.rendezvous.clone());
        membership(&Flags { hosts, host_rank, rendezvous }, &|name| std::env::var(name).ok()).map_err(wrong)
    }

    /// The configuration of these options. The run has as many actors and learners as its hosts have together, where each
    /// has a number of its own.
    pub fn resolve(&self, overrides: &Overrides, preset: &str, member: Option<&Membership>) -> Result<Config> {
        let hosts = member.map_or(1, |member| member.hosts);
        let each = [(self.actors_per_host, "actor"), (self.learners_per_host, "learner")];
        let each = each.map(|(number, what)| number.map(|number| counted(u64::from(number), what)));
        let resolved = self.of_all(overrides, hosts).resolve(preset);
        match each.into_iter().flatten().reduce(|actors, learners| format!("{actors} and {learners}")) {
            Some(each) => resolved.with_context(|| format!("{} with {each} each", counted(u64::from(hosts), "host"))),
            None => resolved,
        }
    }

    fn of_all(&self, overrides: &Overrides, hosts: u32) -> Overrides {
        let of_all = |each: u32| each.saturating_mul(hosts);
        Overrides {
            actors: self.actors_per_host.map(of_all).or(overrides.actors),
            learners: self.learners_per_host.map(of_all).or(overrides.learners),
            ..overrides.clone()
        }
    }

    /// What these options ask for otherwise than host 0's run, by key: only what the user gave.
    pub fn otherwise(
        &self,
        overrides: &Overrides,
        preset: Option<&str>,
        hosts: u32,
        run: &Config,
        folder: &RunFolder,
    ) -> Result<Vec<String>> {
        let mut asked = self.of_all(overrides, hosts).over(run)?;
        asked.preset = overrides.preset(preset, || Ok(&run.preset))?;
        let mut found = vec![];
        if asked.scenes != run.scenes && asked.scenes.len() == run.scenes.len() {
            found = scenes::changes(&asked, run, folder)?;
            // The run names its own copies.
            let name = |scene: &String| Path::new(scene).file_name().map(OsStr::to_owned);
            let scenes = asked.scenes.iter_mut().zip(&run.scenes);
            scenes.filter(|(asked, run)| name(asked) == name(run)).for_each(|(asked, run)| asked.clone_from(run));
        }
        Ok([asked.changes_since(run), found].concat())
    }

    pub fn patience(&self) -> Patience {
        let lost = Duration::from_secs(self.host_deadline.unwrap_or(30));
        Patience { joining: Duration::from_secs(self.join_deadline), lost }
    }

    /// What host 0 has to start with; the door is open from now on.
    pub fn started(&self, member: Option<&Membership>) -> Result<Started> {
        let open =
            |member: &Membership| Rendezvous::open(member, self.token()?, self.interface.as_deref(), self.patience());
        let rendezvous = member.filter(|member| member.hosts > 1).map(open).transpose()?;
        Ok(Started { launched: member.is_some(), rendezvous })
    }

    pub fn take_part(&self, member: Membership, run: &Path, otherwise: Otherwise<'_>) -> Result<ExitCode> {
        let (token, interface) = (self.token()?, self.interface.clone());
        let run = run.to_path_buf();
        Agent { member, token, interface, run, patience: self.patience(), lost_s: self.host_deadline }.run(otherwise)
    }

    fn token(&self) -> Result<Token> {
        Token::find(self.token_file.as_deref()).context("the hosts cannot trust one another")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hosts::membership::Launcher;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        hosts: HostFlags,
        #[command(flatten)]
        overrides: Overrides,
    }

    /// Learners and actors of a run on so many hosts.
    fn resolved(hosts: u32, words: &[&str]) -> Result<(u32, u32)> {
        let Line { hosts: flags, overrides } = Line::try_parse_from([&["up"], words].concat())?;
        let member = Membership { hosts, host: 0, rendezvous: "first:1".into(), by: Launcher::Torchrun };
        let config = flags.resolve(&overrides, "demo", Some(&member))?;
        Ok((config.learner.count, config.actors.count))
    }

    /// The demonstration has 19 actors.
    #[test]
    fn numbers_of_each_host_are_judged_when_they_are_those_of_all() {
        assert_eq!(resolved(2, &["--actors-per-host", "10", "--learners", "20"]).unwrap(), (20, 20));
        assert_eq!(resolved(3, &["--actors-per-host", "7", "--learners-per-host", "7"]).unwrap(), (21, 21));
        assert_eq!(resolved(3, &["--learners-per-host", "2"]).unwrap(), (6, 19));
        for (hosts, words, parts) in [
            (2, ["--actors-per-host", "300"].as_slice(), ["2 hosts with 300 actors each", "actors.count = 600"]),
            (
                4,
                &["--actors-per-host", "2", "--learners-per-host", "3"],
                ["4 hosts with 2 actors and 3 learners each", "learner.count = 12"],
            ),
        ] {
            let message = format!("{:#}", resolved(hosts, words).unwrap_err());
            assert!(parts.iter().all(|part| message.contains(part)), "{parts:?}: {message}");
        }
    }

    #[test]
    fn another_hosts_command_is_compared_by_what_it_says_and_by_nothing_else() {
        let temporary = tempfile::tempdir().unwrap();
        let file = |text: &str| {
            let path = temporary.path().join("mine.toml");
            std::fs::write(&path, text).unwrap();
            path.display().to_string()
        };
        let folder = RunFolder::new(temporary.path().join("run"));
        let run = Config { seed: 7, ..Config::resolve("paper", None).unwrap() };
        let found = |preset: Option<&str>, words: &[&str]| {
            let Line { hosts, overrides } = Line::try_parse_from([&["up"], words].concat()).unwrap();
            hosts.otherwise(&overrides, preset, 2, &run, &folder).unwrap()
        };
        assert_eq!(found(None, &[]), Vec::<String>::new(), "another host may say nothing");
        let frames: u64 = run.stages.iter().map(|stage| stage.frames).sum();
        let frames = frames.to_string();
        let same = file("preset = \"demo\"\n[ppo]\nclip = 0.1\n");
        assert_eq!(run.ppo.clip, 0.1, "as the file has it");
        let words = ["--seed", "7", "--frames", &frames, "--actors", "19", "--config", &same];
        assert_eq!(found(Some("paper"), &words), Vec::<String>::new(), "it says the same");
        assert_eq!(
            found(Some("demo"), &["--seed", "9"]),
            ["preset = \"demo\" instead of \"paper\"", "seed = 9 instead of 7"]
        );
        assert_eq!(found(None, &["--actors-per-host", "4"]), ["actors.count = 8 instead of 19"]);
        let words = ["--set", "ppo.learning_rate=1", "--learners-per-host", "1"];
        let expected = ["learner.count = 2 instead of 1", "ppo.learning_rate = 1.0 instead of 0.0003"];
        let all = found(None, &words);
        assert!(all.len() == 2 && expected.iter().all(|key| all.iter().any(|found| found == key)), "{all:?}");
        let less = found(None, &["--frames", "450"]);
        assert!(less.iter().all(|key| key.starts_with("stages.") && key.contains(".frames = ")), "{less:?}");
        assert_eq!(less.len(), run.stages.len());
        assert_eq!(found(None, &["--set", "scenes=[\"a.toml\"]"]), ["scenes = [\"a.toml\"] instead of []"]);
    }
}
