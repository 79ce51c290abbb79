use super::rendezvous::Invitation;
use crate::preflight::all::demand_all;
use crate::preflight::programs::Tools;
use crate::run::lock::{RunLock, wait_for_learners};
use crate::run::remains;
use crate::supervisor::session::part_of;
use anyhow::{Context, Result, bail, ensure};
use proto::config::Config;
use proto::hosts::Hosts;
use proto::run_folder::{RunFolder, write_atomically};
use std::path::{Component, Path, PathBuf};
use std::time::Duration;
use wire::WireAddress;

const LEAVE: Duration = Duration::from_secs(5);

pub struct HostFolder {
    pub folder: RunFolder,
    pub config: Config,
    pub address: WireAddress,
    pub hosts: Hosts,
    pub tools: Tools,
    pub lock: RunLock,
}

/// Prepares host `host` in the run folder `run`, which may be its own or shared with host 0. `patience`: for what an
/// earlier start of it still does.
pub fn prepare(
    run: &Path,
    host: u32,
    invitation: &Invitation,
    files: &[Vec<u8>],
    patience: Duration,
) -> Result<HostFolder> {
    let folder = RunFolder::new(run).host(host);
    for path in [folder.root().to_path_buf(), folder.logs(), folder.recordings()] {
        std::fs::create_dir_all(&path).with_context(|| format!("cannot create {}", path.display()))?;
    }
    let lock = RunLock::acquire_within(&folder, patience)?;
    check_run(&folder, &invitation.run_id)?;
    let config = Config::from_toml(&invitation.config, "host 0's configuration")?;
    let hosts = Hosts::new(invitation.hosts, config.shares());
    let ranks = hosts.ranks_of(host);
    if let Some(rank) = wait_for_learners(&folder, ranks, patience, |rank| {
        tracing::info!("learner-{rank} of the last start still runs; waiting until it has left");
    })? {
        bail!("the learner of the last start still holds {}", folder.learner_lock(rank).display());
    }
    // Two hosts may be one machine: so each has names of its own there.
    let names = format!("{}h{host:03}", invitation.run_id);
    for left in remains::survey()?.into_iter().filter(|left| left.address.run_id() == names) {
        remains::sweep(&left.address, LEAVE)?;
    }
    keep(&folder, invitation, files)?;
    let tools = Tools::find()?;
    demand_all(&part_of(&config, hosts, host), &folder, &tools)?;
    let address = WireAddress::new(&names, invitation.incarnation);
    Ok(HostFolder { folder, config, address, hosts, tools, lock })
}

fn check_run(folder: &RunFolder, run_id: &str) -> Result<()> {
    let note = folder.root().join("run-id");
    match folder.read_text(&note) {
        Ok(id) if id.trim() == run_id => Ok(()),
        Ok(id) => bail!(
            "{} holds a host's part of run {}, and this is run {run_id}: choose another folder with --run",
            folder.root().display(),
            id.trim()
        ),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            write_atomically(&note, run_id.as_bytes()).with_context(|| format!("cannot write {}", note.display()))
        }
        Err(error) => Err(error).with_context(|| note.display().to_string()),
    }
}

fn keep(folder: &RunFolder, invitation: &Invitation, files: &[Vec<u8>]) -> Result<()> {
    for ((name, _), bytes) in invitation.files.iter().zip(files) {
        let path = folder.root().join(inside(name)?);
        let parent = path.parent().context("a file lies in a folder")?;
        std::fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display()))?;
        write_atomically(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    write_atomically(&folder.config(), invitation.config.as_bytes())
        .with_context(|| format!("cannot write {}", folder.config().display()))?;
    let task = Config::of_run(folder)?.spec().text();
    write_atomically(&folder.task(), task.as_bytes())
        .with_context(|| format!("cannot write {}", folder.task().display()))
}

fn inside(name: &str) -> Result<PathBuf> {
    let path = PathBuf::from(name);
    let plain = !name.is_empty() && path.components().all(|part| matches!(part, Component::Normal(_)));
    ensure!(plain, "host 0 names a file `{name}`, which is not inside of the run folder");
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_stays_inside_and_a_folder_belongs_to_one_run() {
        assert_eq!(inside("scenes/000/a.glb").unwrap(), Path::new("scenes/000/a.glb"));
        for name in ["", "/etc/passwd", "scenes/../../x", "./x"] {
            assert!(inside(name).is_err(), "{name}");
        }
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        check_run(&folder, "abc").unwrap();
        check_run(&folder, "abc").unwrap();
        let message = check_run(&folder, "def").unwrap_err().to_string();
        assert!(message.contains("part of run abc, and this is run def"), "{message}");
    }
}
