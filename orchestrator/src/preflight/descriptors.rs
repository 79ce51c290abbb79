//! Whether every process of a run may open as many files as it needs. Shared memory and pipes count as files: without
//! this check a large run would fail amid its start, with an error of the transport that names no limit.
//!
//! The figures are those of processes at work, read from /proc/PID/fd in runs of 1 to 4 actors and 1 to 4 learners, and of
//! 76 actors and 2 learners. They do not depend on the number of environments.

use super::Finding;
use crate::output::format::counted;
use proto::config::Config;
use proto::shares::Shares;

/// The orchestrator with its recorder: alone, for each actor, for each learner.
const ORCHESTRATOR: [u64; 3] = [31, 11, 11];
/// A learner: alone, for each actor of the run, for each learner.
const LEARNER: [u64; 3] = [24, 2, 8];
/// A learner, for each actor that it serves itself.
const LEARNER_OWN_ACTOR: u64 = 12;
/// An actor: alone, for each actor of the run, for each learner.
const ACTOR: [u64; 3] = [38, 2, 3];
/// For what is open only for moments, and for what CUDA opens, which was not measured.
const SPARE: u64 = 64;

fn need(shares: Shares) -> u64 {
    let (all, learners) = (u64::from(shares.actors()), u64::from(shares.learners()));
    let of = |[alone, actor, learner]: [u64; 3]| alone + actor * all + learner * learners;
    // The first learner has as many actors as any.
    let learner = of(LEARNER) + LEARNER_OWN_ACTOR * shares.actors_of(0).len() as u64;
    of(ORCHESTRATOR).max(learner).max(of(ACTOR)) + SPARE
}

/// Checks what `config` needs against this process's limit, raised as far as it may be: the run's processes inherit it.
pub fn check(config: &Config) -> Finding {
    check_against(config, wire::descriptors::raise_limit())
}

fn check_against(config: &Config, limit: Option<u64>) -> Finding {
    let (actors, learners) = (config.actors.count, config.learner.count);
    let most = need(config.shares());
    let Some(limit) = limit else { return Finding::Good(format!("{most} of any number")) };
    if most <= limit {
        return Finding::Good(format!("{most} of {limit} that a process may have"));
    }
    let fits = (config.fewest_actors()..actors).rev().find(|&fewer| need(config.shares_among(fewer)) <= limit);
    let fewer =
        fits.map_or_else(String::new, |fewer| format!(". --actors {fewer} is the most that the limit allows as it is"));
    let wanted = most.next_power_of_two().max(4096);
    Finding::Problem(format!(
        "more actors than open files allow: with {} and {} a process needs up to {most} open files, but it may have \
         {limit} (the hard limit, `ulimit -Hn`). Raise it: `ulimit -n {wanted}` as root, `LimitNOFILE={wanted}` of \
         systemd, `nofile` in /etc/security/limits.conf, or `docker run --ulimit nofile={wanted}`{fewer}",
        counted(u64::from(actors), "actor"),
        counted(u64::from(learners), "learner")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run_of(actors: u32, learners: u32) -> Config {
        let mut config = Config::resolve("demo", None).unwrap();
        (config.actors.count, config.learner.count) = (actors, learners);
        config
    }

    #[test]
    fn the_usual_soft_limit_is_too_low_for_large_runs_and_the_message_names_what_fits() {
        assert!(matches!(check_against(&run_of(19, 1), Some(1024)), Finding::Good(_)));
        for (actors, learners) in [(76, 1), (90, 2)] {
            let config = run_of(actors, learners);
            let Finding::Problem(text) = check_against(&config, Some(1024)) else { panic!("{actors} do not fit") };
            for part in ["more actors than open files allow", "may have 1024", "LimitNOFILE=4096", "nofile=4096"] {
                assert!(text.contains(part), "{part}: {text}");
            }
            let fits: u32 = text.split("--actors ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
            assert!(matches!(check_against(&run_of(fits, learners), Some(1024)), Finding::Good(_)));
            assert!(matches!(check_against(&run_of(fits + 1, learners), Some(1024)), Finding::Problem(_)));
            assert!(matches!(check_against(&config, Some(4096)), Finding::Good(_)));
            assert!(matches!(check_against(&config, None), Finding::Good(_)));
        }
        let Finding::Problem(text) = check_against(&run_of(2, 2), Some(100)) else { panic!("nothing fits there") };
        assert!(!text.contains("--actors"), "{text}");
    }

    /// What was counted in real runs.
    #[test]
    fn the_need_is_what_was_counted() {
        let runs = [((1, 1), 53), ((2, 1), 64), ((4, 1), 88), ((4, 2), 97), ((4, 4), 119), ((76, 2), 889)];
        for ((actors, learners), counted) in runs {
            assert_eq!(need(Shares::new(actors, learners)) - SPARE, counted, "{actors} actors, {learners} learners");
        }
    }
}
