//! Which cores a run's processes are held to (`machine.pin`): those near a learner's GPU for it and its actors. It
//! changes when things happen, and nothing of what is computed.

use super::Finding;
use super::device::is_cuda;
use anyhow::{Context, Result};
use proto::config::Config;
use proto::device::Torch;
use proto::shares::Shares;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::collections::BTreeSet;
use std::path::Path;

/// Cores of one GPU's share from which on its learner has some to itself.
const ENOUGH: usize = 8;
const OWN: usize = 4;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cores {
    /// Cores that this process may use; threads of one core stand side by side.
    usable: Vec<usize>,
    /// Cores near each GPU, in the order of CUDA's devices; empty without a GPU.
    near: Vec<BTreeSet<usize>>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Placement {
    shares: Shares,
    learners: Vec<Vec<usize>>,
    actors: Vec<Vec<usize>>,
}

impl Cores {
    pub fn find(torch: &Torch) -> Result<Self> {
        let set = sched_getaffinity(None).context("cannot read this process's cores")?;
        let mut usable: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|&core| set.is_set(core)).collect();
        let first_thread = |core: usize| {
            let path = format!("/sys/devices/system/cpu/cpu{core}/topology/thread_siblings_list");
            list_in(Path::new(&path)).and_then(|siblings| siblings.first().copied()).unwrap_or(core)
        };
        usable.sort_by_cached_key(|&core| (first_thread(core), core));
        let local = |pci: &String| {
            let path = format!("/sys/bus/pci/devices/{pci}/local_cpulist");
            list_in(Path::new(&path)).unwrap_or_default()
        };
        // A GPU whose place is unknown is near to all.
        let count = torch.cuda_devices();
        let near = (0..count).map(|device| torch.pci.get(device).map(local).unwrap_or_default()).collect();
        Ok(Self { usable, near })
    }

    /// Places the processes of a run. `on_gpu`: learner r computes on GPU r.
    pub fn place(&self, shares: Shares, on_gpu: bool) -> Placement {
        let near = |rank: u32| -> Vec<usize> {
            let local = self.near.get(rank as usize).filter(|_| on_gpu);
            let cores = self.usable.iter().copied().filter(|core| local.is_some_and(|local| local.contains(core)));
            let cores: Vec<usize> = cores.collect();
            if cores.is_empty() { self.usable.clone() } else { cores }
        };
        let all: Vec<Vec<usize>> = (0..shares.learners()).map(near).collect();
        let (mut learners, mut actors) = (vec![], vec![]);
        for (rank, cores) in all.iter().enumerate() {
            let before = all[..rank].iter().filter(|other| *other == cores).count();
            let among = all.iter().filter(|other| *other == cores).count();
            let share = part(cores, before, among);
            // On a CPU a learner computes while its actors wait, and the other way round: they share.
            let own = if on_gpu && share.len() >= ENOUGH { (share.len() / 4).min(OWN) } else { 0 };
            learners.push(if own > 0 { share[..own].to_vec() } else { share.to_vec() });
            actors.push(share[own..].to_vec());
        }
        Placement { shares, learners, actors }
    }
}

/// One of `among` parts of a list that are as equal as can be; all of it if there is not one for each.
fn part(cores: &[usize], index: usize, among: usize) -> &[usize] {
    if cores.len() < among { cores } else { &cores[cores.len() * index / among..cores.len() * (index + 1) / among] }
}

impl Placement {
    pub fn of_learner(&self, rank: u32) -> &[usize] {
        &self.learners[rank as usize]
    }

    pub fn of_actor(&self, actor: u32) -> &[usize] {
        &self.actors[self.shares.learner_of(actor) as usize]
    }

    pub fn describe(&self) -> String {
        let each = self.learners.iter().zip(&self.actors).enumerate();
        let each = each
            .map(|(rank, (own, actors))| format!("learner {rank} on {}, its actors on {}", text(own), text(actors)));
        each.collect::<Vec<_>>().join("; ")
    }
}

/// Starts a child on some cores: it inherits them from the thread that starts it.
pub fn start_on<T>(cores: &[usize], start: impl FnOnce() -> T) -> Result<T> {
    let failed = || format!("cannot hold a process to cores {}", text(cores));
    let mut set = CpuSet::new();
    for &core in cores {
        set.set(core);
    }
    let before = sched_getaffinity(None).with_context(failed)?;
    sched_setaffinity(None, &set).with_context(failed)?;
    let started = start();
    sched_setaffinity(None, &before).with_context(failed)?;
    Ok(started)
}

/// A list of cores as the kernel writes it: `0-3,8`.
fn text(cores: &[usize]) -> String {
    let sorted: BTreeSet<usize> = cores.iter().copied().collect();
    let mut ranges: Vec<(usize, usize)> = vec![];
    for core in sorted {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == core => *last = core,
            _ => ranges.push((core, core)),
        }
    }
    let shown = ranges
        .into_iter()
        .map(|(first, last)| if first == last { first.to_string() } else { format!("{first}-{last}") });
    shown.collect::<Vec<_>>().join(",")
}

fn list_in(path: &Path) -> Option<BTreeSet<usize>> {
    parse(std::fs::read_to_string(path).ok()?.trim())
}

fn parse(list: &str) -> Option<BTreeSet<usize>> {
    let mut found = BTreeSet::new();
    for range in list.split(',').filter(|range| !range.is_empty()) {
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        found.extend(first.parse::<usize>().ok()?..=last.parse().ok()?);
    }
    Some(found)
}

pub fn placement(config: &Config, torch: &Torch) -> Result<Option<Placement>> {
    if !config.machine.pin {
        return Ok(None);
    }
    Ok(Some(Cores::find(torch)?.place(config.shares(), is_cuda(config, torch))))
}

pub fn check(config: &Config, torch: &Torch) -> Finding {
    match placement(config, torch) {
        Ok(None) => Finding::Good("as the kernel chooses (machine.pin = false)".to_owned()),
        Ok(Some(placement)) => Finding::Good(placement.describe()),
        Err(error) => Finding::Problem(format!("{error:#}")),
    }
}

#[cfg(test)]
mod tests {
    use super::super::device::tests::torch;
    use super::*;

    /// Two sockets of eight cores with two GPUs each.
    fn machine() -> Cores {
        let near = [0..8, 0..8, 8..16, 8..16].map(Iterator::collect).to_vec();
        Cores { usable: (0..16).collect(), near }
    }

    fn places(cores: &Cores, learners: u32, on_gpu: bool) -> Vec<(String, String)> {
        let placed = cores.place(Shares::new(2 * learners, learners), on_gpu);
        placed.learners.iter().zip(&placed.actors).map(|(own, actors)| (text(own), text(actors))).collect()
    }

    fn pair(learner: &str, actors: &str) -> (String, String) {
        (learner.to_owned(), actors.to_owned())
    }

    #[test]
    fn a_learner_and_its_actors_are_near_their_gpu() {
        assert_eq!(places(&machine(), 1, true), [pair("0-1", "2-7")]);
        // Two GPUs of a socket divide its cores; with four each, nobody has one to itself.
        let four = [pair("0-3", "0-3"), pair("4-7", "4-7"), pair("8-11", "8-11"), pair("12-15", "12-15")];
        assert_eq!(places(&machine(), 4, true), four);
        assert_eq!(places(&machine(), 2, false), [pair("0-7", "0-7"), pair("8-15", "8-15")]);
        // Of a GPU nothing is known, or its cores are not ours.
        let unknown = Cores { near: vec![BTreeSet::new(), (90..99).collect()], ..machine() };
        assert_eq!(places(&unknown, 2, true), [pair("0-1", "2-7"), pair("8-9", "10-15")]);
        let small = Cores { usable: vec![3], near: vec![] };
        assert_eq!(places(&small, 2, false), [pair("3", "3"), pair("3", "3")]);
    }

    #[test]
    fn lists_are_the_kernels() {
        assert_eq!(parse("0-3,8").map(|list| text(&Vec::from_iter(list))), Some("0-3,8".to_owned()));
        assert_eq!((parse(""), parse("x")), (Some(BTreeSet::new()), None));
    }

    #[test]
    fn a_child_inherits_its_cores_and_this_thread_keeps_its_own() {
        let last = *Cores::find(&torch(0)).unwrap().usable.last().unwrap();
        let placed = Cores { usable: vec![last], near: vec![] }.place(Shares::of_one(1), false);
        let own = || std::fs::read_to_string("/proc/thread-self/status").unwrap();
        let list = |status: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:"));
            line.map(|line| line.trim().to_owned())
        };
        let before = list(&own());
        let child = || std::process::Command::new("cat").arg("/proc/self/status").output().unwrap();
        for cores in [placed.of_actor(0), placed.of_learner(0)] {
            let status = start_on(cores, child).unwrap().stdout;
            assert_eq!(list(&String::from_utf8_lossy(&status)), Some(last.to_string()));
        }
        assert_eq!(list(&own()), before);
    }

    #[test]
    fn cores_are_chosen_where_that_is_asked_for() {
        let mut config = Config::resolve("demo", None).unwrap();
        assert!(matches!(check(&config, &torch(0)), Finding::Good(text) if text.contains("kernel")));
        config.machine.pin = true;
        assert!(matches!(check(&config, &torch(0)), Finding::Good(text) if text.starts_with("learner 0 on ")));
    }
}
