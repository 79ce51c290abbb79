//! Whether the processes of a run fit into this machine's memory: an estimate, made before they are started, because
//! otherwise the kernel would kill one of them without an error message.

use super::Finding;
use crate::output::format::{bytes, counted};
use proto::camera::FRAME_PIXELS;
use proto::config::{Config, dqn};
use proto::kitchen::Kitchens;
use std::path::Path;
use wire::WireShape;

/// An actor without environments: its program, its kitchen, meshes, and its ports.
const ACTOR_BASE: u64 = 24 << 20;
/// An environment: a physics world, that of the next episode's start, the simulator's buffers.
const ACTOR_ENVIRONMENT: u64 = 2 << 20;
/// What an environment has besides where it is in a kitchen of its own: that, and its camera.
const ACTOR_KITCHEN: u64 = 3 << 20;
/// A learner without a network: libtorch on the CPU.
const LEARNER_BASE: u64 = 400 << 20;
/// What CUDA and its libraries add in host memory.
const LEARNER_CUDA: u64 = 1536 << 20;
/// What autograd keeps of an observation of numbers alone, at most.
const NUMBERS: u64 = 64 << 10;
/// The orchestrator and the recorder's buffers.
const ORCHESTRATOR: u64 = 96 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Need {
    pub actor: u64,
    /// One learner, that with the most actors.
    pub learner: u64,
    pub learners: u32,
    pub shared: u64,
    pub total: u64,
}

/// `actors`: not fewer than [`Config::fewest_actors`].
pub fn need(config: &Config, actors: u32, cuda: bool) -> Need {
    let environments_per_actor = config.actors.environments_per_actor;
    let own_kitchen = if matches!(config.kitchens(), Kitchens::Procedural(_)) { ACTOR_KITCHEN } else { 0 };
    let actor = ACTOR_BASE + u64::from(environments_per_actor) * (ACTOR_ENVIRONMENT + own_kitchen);
    let shares = config.shares_among(actors);
    // The first learner has as many actors as any, and the first shard too.
    let environments = shares.actors_of(0).len() as u64 * u64::from(environments_per_actor);
    let in_shard = shares.actors_in(0).len() as u64 * u64::from(environments_per_actor);
    // An evaluation keeps no frames and no gradients: one step's worth is what it looks at.
    let steps = if config.evaluation.is_some() { 1 } else { u64::from(config.ppo.rollout_steps) };
    // One is collected while another is trained on.
    let rollouts = if config.ppo.overlap && config.evaluation.is_none() { 2 } else { 1 };
    let inputs = config.spec().inputs();
    let has_frame = inputs.as_ref().is_ok_and(|inputs| inputs.frame.is_some());
    let (pixels, images) = (if has_frame { FRAME_PIXELS as u64 } else { 0 }, inputs.as_ref().ok());
    let image_bytes = images.map_or(0, |inputs| inputs.image_bytes() as u64);
    let rollout = rollouts * environments * (steps + 1) * (pixels * 2 + image_bytes);
    let learner = if cuda {
        // Rollout and activations lie on the GPU; the host has staging buffers.
        LEARNER_BASE + LEARNER_CUDA + environments * (pixels * 4 + image_bytes)
    } else {
        let minibatch = in_shard.div_ceil(u64::from(config.ppo.minibatches.max(1)));
        let in_pass = match u64::from(config.ppo.environments_per_pass) {
            0 => minibatch,
            pass => pass.min(minibatch),
        };
        // Gates and states of a step, and what becomes of them, both directions.
        let memory = config.network.memory;
        let unit = u64::from(2 * (memory.gates() + memory.states()) * config.network.hidden) * 4;
        let encoder = || config.network.encoder.autograd_bytes(config.network.input_pool);
        let frame = if has_frame { encoder() } else { NUMBERS };
        let images = images.map_or(0, |inputs| inputs.images.iter().map(dqn::autograd_bytes).sum());
        LEARNER_BASE + rollout + in_pass * steps * (frame + images + unit)
    };
    let shared = WireShape::with_actors(config, shares).shared_memory_bytes();
    let learners = shares.learners();
    let total = u64::from(actors) * actor + u64::from(learners) * learner + shared + ORCHESTRATOR;
    Need { actor, learner, learners, shared, total }
}

pub fn check(config: &Config, cuda: bool, available: u64) -> Finding {
    let actors = config.actors.count;
    let all = need(config, actors, cuda);
    let learner = bytes(all.learner);
    let learners = match all.learners {
        1 => format!("a learner of {learner}"),
        learners => format!("{learners} learners of {learner} each"),
    };
    let figures = format!(
        "{} of {}, {learners}, {} shared memory: {} of {} available",
        counted(u64::from(actors), "actor"),
        bytes(all.actor),
        bytes(all.shared),
        bytes(all.total),
        bytes(available)
    );
    if all.total <= available {
        return Finding::Good(figures);
    }
    let fits = (config.fewest_actors()..actors).rev().find(|&fewer| need(config, fewer, cuda).total <= available);
    let way_out = match fits {
        Some(fewer) => format!(
            "--actors {fewer} is the most that memory holds; fewer environments (--envs-per-actor) or, on a CPU, a smaller \
             ppo.environments_per_pass need less, too"
        ),
        None if config.learner.shards > all.learners => format!(
            "not even {0} actors fit, one a shard: a smaller learner.shards than {0}, or a smaller \
             ppo.environments_per_pass, ppo.rollout_steps or encoder, need less",
            config.learner.shards
        ),
        None if all.learners > 1 => format!(
            "not even {0} actors fit, one a learner: fewer --learners than {0}, or a smaller ppo.environments_per_pass, \
             ppo.rollout_steps or encoder, need less",
            all.learners
        ),
        None => "not even one actor fits: a smaller ppo.environments_per_pass, ppo.rollout_steps or encoder needs less"
            .to_owned(),
    };
    Finding::Problem(format!("more actors than memory allows: {figures}. {way_out}"))
}

/// Memory that this process and its children may still take, bytes: what the machine has left, or less where a
/// container is limited.
pub fn available() -> std::io::Result<u64> {
    let meminfo = std::fs::read_to_string("/proc/meminfo")?;
    let machine = meminfo_available(&meminfo)
        .ok_or_else(|| std::io::Error::new(std::io::ErrorKind::InvalidData, "/proc/meminfo has no MemAvailable"))?;
    let group = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    Ok(cgroup_left(&group, Path::new("/sys/fs/cgroup")).map_or(machine, |left| left.min(machine)))
}

fn meminfo_available(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

/// The smallest amount that is left in this process's control group (version 2) and those around it.
fn cgroup_left(cgroup: &str, mount: &Path) -> Option<u64> {
    let own = cgroup.lines().find_map(|line| line.strip_prefix("0::"))?;
    let mut folder = mount.join(own.trim_start_matches('/'));
    let number =
        |folder: &Path, name: &str| std::fs::read_to_string(folder.join(name)).ok()?.trim().parse::<u64>().ok();
    let reclaimable = |folder: &Path| {
        let stat = std::fs::read_to_string(folder.join("memory.stat")).ok()?;
        stat.lines().find_map(|line| line.strip_prefix("inactive_file "))?.trim().parse::<u64>().ok()
    };
    let mut least = None::<u64>;
    loop {
        // "max" is no number: no limit here.
        if let (Some(limit), Some(used)) = (number(&folder, "memory.max"), number(&folder, "memory.current")) {
            let used = used.saturating_sub(reclaimable(&folder).unwrap_or(0));
            let left = limit.saturating_sub(used);
            least = Some(least.map_or(left, |least| least.min(left)));
        }
        if folder == mount || !folder.pop() {
            return least;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_demo_fits_into_eight_gibibytes_and_the_message_names_what_would() {
        let demo = Config::resolve("demo", None).unwrap();
        assert!(matches!(check(&demo, false, 7 << 30), Finding::Good(_)));
        let mut many = demo.clone();
        many.actors.count = 400;
        let Finding::Problem(text) = check(&many, false, 7 << 30) else { panic!("400 actors fit nowhere") };
        assert!(text.starts_with("more actors than memory allows: 400 actors of "), "{text}");
        let fits: u32 = text.split("--actors ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!(need(&many, fits, false).total <= 7 << 30);
        assert!(need(&many, fits + 1, false).total > 7 << 30);
        let Finding::Problem(text) = check(&many, false, 100 << 20) else { panic!("nothing fits there") };
        assert!(text.contains("not even one actor fits"), "{text}");
    }

    #[test]
    fn learners_divide_the_rollout_and_each_has_its_own_libtorch() {
        let one = Config::resolve("demo", None).unwrap();
        let mut three = one.clone();
        three.learner.count = 3;
        let (alone, each) = (need(&one, 19, false), need(&three, 19, false));
        // Seven actors of 19 are the largest share.
        let parts = |learner: u64| learner - LEARNER_BASE;
        assert!(parts(each.learner) >= parts(alone.learner) * 7 / 19 && parts(each.learner) <= parts(alone.learner));
        let learners = |need: Need| need.total - 19 * need.actor - need.shared - ORCHESTRATOR;
        assert_eq!((learners(alone), learners(each)), (alone.learner, 3 * each.learner));
        assert!(learners(each) > learners(alone) && each.shared == alone.shared);
        let Finding::Problem(text) = check(&three, false, 800 << 20) else { panic!("nothing fits there") };
        for part in ["3 learners of", "not even 3 actors fit", "fewer --learners than 3"] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }

    #[test]
    fn the_narrowest_control_group_counts() {
        let mount = tempfile::tempdir().unwrap();
        let inner = mount.path().join("a/b");
        std::fs::create_dir_all(&inner).unwrap();
        let write = |folder: &Path, max: &str, current: &str| {
            std::fs::write(folder.join("memory.max"), max).unwrap();
            std::fs::write(folder.join("memory.current"), current).unwrap();
        };
        write(&inner, "max\n", "50\n");
        assert_eq!(cgroup_left("0::/a/b\n", mount.path()), None);
        write(&mount.path().join("a"), "1000\n", "700\n");
        std::fs::write(mount.path().join("a/memory.stat"), "anon 1\ninactive_file 100\n").unwrap();
        assert_eq!(cgroup_left("0::/a/b\n", mount.path()), Some(400));
        assert_eq!(meminfo_available("MemTotal: 9 kB\nMemAvailable:   2048 kB\n"), Some(2 << 20));
    }
}
