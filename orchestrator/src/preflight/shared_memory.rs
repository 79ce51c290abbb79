//! Whether /dev/shm holds a run. Its segments are sparse: creating them always succeeds, and the first write beyond
//! the limit kills the writer with SIGBUS. So the need is computed and compared before anything is created.

use super::Finding;
use crate::output::format::{bytes, counted};
use proto::config::Config;
use proto::shares::Shares;
use rustix::fs::{Access, access, statvfs};
use wire::{SHARED_MEMORY, WireShape};

pub fn check(config: &Config) -> Finding {
    let writable = access(SHARED_MEMORY, Access::READ_OK | Access::WRITE_OK | Access::EXEC_OK);
    match writable.and_then(|()| statvfs(SHARED_MEMORY)) {
        Ok(status) => check_against(config, status.f_bavail * status.f_frsize, status.f_blocks * status.f_frsize),
        Err(error) => Finding::Problem(format!(
            "{SHARED_MEMORY} cannot be used: {error}. A run has its shared memory there: mount a tmpfs that you can write \
             (`mount -o remount,rw,mode=1777 {SHARED_MEMORY}`)"
        )),
    }
}

fn check_against(config: &Config, free: u64, size: u64) -> Finding {
    let environments_per_actor = config.actors.environments_per_actor;
    let shape = |actors| WireShape::with_actors(config, Shares::of_one(actors));
    let actors = config.actors.count;
    let need = shape(actors).shared_memory_bytes();
    if need <= free {
        return Finding::Good(format!("{} of {} free in {SHARED_MEMORY}", bytes(need), bytes(free)));
    }
    let fits = (config.fewest_actors()..actors).rev().find(|&fewer| shape(fewer).shared_memory_bytes() <= free);
    let fewer = fits.map_or_else(String::new, |fewer| format!(" --actors {fewer} is the most that it holds as it is."));
    let wanted_mib = (size - free.min(size) + need).div_ceil(1 << 20).next_multiple_of(64);
    Finding::Problem(format!(
        "{SHARED_MEMORY} is too small: {} of {} need {}, but {} of its {} are free. \
         `mount -o remount,size={wanted_mib}m {SHARED_MEMORY}` enlarges it; in a container, \
         `docker run --shm-size={wanted_mib}m`. `orchestrator clean` frees what dead runs left.{fewer}",
        counted(u64::from(actors), "actor"),
        counted(u64::from(environments_per_actor), "environment"),
        bytes(need),
        bytes(free),
        bytes(size)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dockers_default_is_too_small_and_the_message_says_what_would_do() {
        let demo = Config::resolve("demo", None).unwrap();
        let Finding::Problem(text) = check_against(&demo, 40 << 20, 64 << 20) else { panic!("64 MiB is too little") };
        for part in ["/dev/shm is too small: 19 actors of 4 environments need", "--shm-size=", "remount,size="] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let size_mib: u64 = text.split("--shm-size=").nth(1).unwrap().split('m').next().unwrap().parse().unwrap();
        let used = 24 << 20;
        assert!(matches!(check_against(&demo, (size_mib << 20) - used, size_mib << 20), Finding::Good(_)));
    }
}
