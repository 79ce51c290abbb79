//! Whether what happened to a command explains that it ended before it was complete. Pure.
//!
//! Several faults can be in force at once. One of them must explain the end; a command that fails must name the cause,
//! and may name no cause that was not in force.

use crate::fault::{ENOUGH_DESCRIPTORS, Fault, Who};
use crate::session::Ended;
use anyhow::{Result, ensure};
use rustix::process::Signal;

/// Exit status after a second Ctrl-C.
const INTERRUPTED: i32 = 130;

/// What a run can lack, and say so.
struct Want {
    name: &'static str,
    is_named_in: fn(&str) -> bool,
    is_caused_by: fn(&Fault) -> bool,
}

const WANTS: [Want; 3] = [
    Want {
        name: "a full disk",
        is_named_in: |line| {
            ["No space left on device", "disk is full", "disk is too full"].iter().any(|words| line.contains(words))
                && !line.contains(wire::SHARED_MEMORY)
        },
        is_caused_by: |fault| matches!(fault, Fault::FullDisk(_)),
    },
    Want {
        name: "full shared memory",
        is_named_in: |line| line.contains(wire::SHARED_MEMORY) || line.contains("SIGBUS"),
        is_caused_by: |fault| matches!(fault, Fault::FullMemory(_)),
    },
    Want {
        name: "few descriptors",
        is_named_in: |line| line.contains("open files"),
        is_caused_by: |fault| matches!(fault, Fault::FewDescriptors(limit) if *limit < ENOUGH_DESCRIPTORS),
    },
];

/// An error if none of `faults`, all that happened to a command, explains an end before it was complete.
pub fn explain(ended: &Ended, faults: &[Fault]) -> Result<()> {
    let any = |test: fn(&Fault) -> bool| faults.iter().any(test);
    let is_explained = match (ended.status.code(), ended.signal().and_then(Signal::from_named_raw)) {
        (Some(0), _) => any(asks_to_stop),
        (Some(INTERRUPTED), _) => {
            any(|fault| *fault == Fault::Interrupt) && faults.iter().filter(|fault| asks_to_stop(fault)).count() > 1
        }
        (Some(_), _) => return explain_failure(ended, faults),
        (None, Some(Signal::KILL)) => any(kills_the_first),
        (None, Some(Signal::BUS)) => any(|fault| matches!(fault, Fault::FullMemory(_))),
        // Before it handles signals as requests.
        (None, Some(Signal::INT)) => any(|fault| *fault == Fault::Interrupt),
        (None, Some(Signal::TERM)) => any(|fault| *fault == Fault::Terminate(Who::Orchestrator)),
        (None, _) => false,
    };
    ensure!(is_explained, "nothing that happened explains its end: {}{}", ended.last_words(), in_force(faults));
    Ok(())
}

fn explain_failure(ended: &Ended, faults: &[Fault]) -> Result<()> {
    let mut is_explained = ended.leaves_a_validation() && faults.iter().any(ends_evaluations);
    for line in ended.complaints() {
        for want in WANTS.iter().filter(|want| (want.is_named_in)(line)) {
            let holds = faults.iter().any(want.is_caused_by);
            ensure!(holds, "it names {}, which did not happen: {line}{}", want.name, in_force(faults));
            is_explained = true;
        }
        is_explained |= tells_of_signals(line, faults);
    }
    ensure!(is_explained, "it failed without a cause that was in force: {}{}", ended.last_words(), in_force(faults));
    Ok(())
}

/// Whether a line says what signals, to one process or another, led to.
fn tells_of_signals(line: &str, faults: &[Fault]) -> bool {
    let any = |test: &dyn Fn(&Fault) -> bool| faults.iter().any(test);
    let is_stopped = any(&asks_to_stop);
    if line.contains(" died while it s") {
        return is_stopped && faults.iter().map(deaths).sum::<u32>() > 0;
    }
    if let Some(number) = number_of_deaths(line) {
        return number <= faults.iter().map(deaths).sum();
    }
    if line.contains(" failed: its process was killed by signal 9 ") {
        return any(&|fault| match fault {
            Fault::Kill(who) => *who == Who::Child,
            Fault::KillTwo(one, other) => [one, other].contains(&&Who::Child),
            _ => false,
        });
    }
    // Of an evaluation; of a suite's run.
    let ends_stopped = line.ends_with(" stopped") || line.contains(" failed: its process was killed by signal 15 ");
    line.starts_with("stopped after ") && is_stopped
        || ends_stopped && (is_stopped || any(&|fault| *fault == Fault::Terminate(Who::Child)))
}

fn in_force(faults: &[Fault]) -> String {
    let faults: Vec<String> = faults.iter().map(Fault::to_string).collect();
    format!(" (in force: {})", faults.join("; "))
}

/// Learners and actors that a signal of their own ends are started again: only the first command stops when it is asked.
fn asks_to_stop(fault: &Fault) -> bool {
    matches!(fault, Fault::Interrupt | Fault::Terminate(Who::Orchestrator))
}

fn kills_the_first(fault: &Fault) -> bool {
    use Who::Orchestrator;
    match fault {
        Fault::Kill(who) | Fault::KillAgain(who, _) => *who == Orchestrator,
        Fault::KillTwo(one, other) => [one, other].contains(&&Orchestrator),
        Fault::Point(point, _) => point.program == "orchestrator",
        Fault::KillAll | Fault::LosePower => true,
        _ => false,
    }
}

/// Whether it can end the evaluation beside a run as often as it is tried.
fn ends_evaluations(fault: &Fault) -> bool {
    WANTS.iter().any(|want| (want.is_caused_by)(fault))
        || match fault {
            Fault::Kill(who) | Fault::Terminate(who) => *who == Who::Child,
            Fault::KillTwo(one, other) => [one, other].contains(&&Who::Child),
            _ => false,
        }
}

/// Learners and actors that it ends; full shared memory ends as many as touch it.
fn deaths(fault: &Fault) -> u32 {
    let of = |who: &Who| u32::from(matches!(who, Who::Learner(_) | Who::Actor(_)));
    match fault {
        Fault::Kill(who) | Fault::Terminate(who) => of(who),
        Fault::KillTwo(one, other) => of(one) + of(other),
        Fault::KillAgain(who, _) => 2 * of(who),
        Fault::KillAndHold(..) => 1,
        Fault::Point(point, _) => u32::from(point.program != "orchestrator"),
        Fault::FullMemory(_) => u32::from(u8::MAX),
        _ => 0,
    }
}

/// Of `actor-01 died 6 times while the run got no further`.
fn number_of_deaths(line: &str) -> Option<u32> {
    line.split_once(" died ")?.1.split_once(" times")?.0.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::{Case, Damage, Journal};
    use crate::points::Point;
    use crate::session::ended;
    use std::collections::BTreeSet;

    const FAILURE: i32 = 1 << 8;

    /// Ways to end before a command is complete: name, raw status, standard error.
    const ENDS: [(&str, i32, &str); 17] = [
        ("SIGKILL", 9, ""),
        ("SIGBUS", 7, ""),
        ("SIGINT", 2, ""),
        ("SIGTERM", 15, ""),
        ("SIGSEGV", 11, ""),
        ("stopped", 0, "[   1.2s]  INFO stopping: the learner saves"),
        ("twice", 130 << 8, "[   1.2s]  INFO stopping: the learner saves; Ctrl-C again ends everything at once"),
        ("no result", FAILURE, "stopped after 1 of 6 episodes: there is no result"),
        (
            "at stop",
            FAILURE,
            "[   1.2s] ERROR learner-1 died while it saved (signal 15 (SIGTERM)); the checkpoint stands",
        ),
        (
            "disk",
            FAILURE,
            "[   1.2s] ERROR what the run does cannot be written down any more: cannot write recording run/a.mcap: the \
             disk is full (No space left on device (os error 28))\n\
             [   1.3s] ERROR learner-0 died while it saved (exit status 5); the last checkpoint stands",
        ),
        ("memory", FAILURE, "error: cannot use the bells in /dev/shm/a: No space left on device (os error 28)"),
        ("few", FAILURE, "error: more actors than open files allow: it may have 48 (the hard limit, `ulimit -Hn`)"),
        ("child killed", FAILURE, "tiny-5 failed: its process was killed by signal 9 (SIGKILL) (all it said: a.log)"),
        ("child stopped", FAILURE, "tiny-5 stopped"),
        ("deaths", FAILURE, "[   1.2s] ERROR actor-00 died 3 times while the run got no further, last with signal 9"),
        (
            "no validation",
            FAILURE,
            "[   3.5s]  WARN the validation after rollout 12 failed 3 times and is left to `orchestrator resume run`: it \
             ended with exit status: 1",
        ),
        // A warning is no reason.
        ("silent", FAILURE, "[   0.9s]  WARN the disk is full; /dev/shm; open files\nerror: no such device"),
    ];

    fn point(program: &'static str) -> Fault {
        Fault::Point(Point { name: "a.point", program, passes: 1 }, 1)
    }

    /// What can happen, with the names of the ends that it explains alone.
    fn kinds() -> Vec<(Fault, &'static str)> {
        use Who::{Actor, Child, Learner, Orchestrator};
        vec![
            (Fault::Kill(Orchestrator), "SIGKILL"),
            (Fault::Kill(Learner(0)), ""),
            (Fault::Kill(Actor(1)), ""),
            (Fault::Kill(Child), "child killed, no validation"),
            (Fault::KillTwo(Actor(1), Orchestrator), "SIGKILL"),
            (Fault::KillTwo(Child, Actor(0)), "child killed, no validation"),
            (Fault::KillTwo(Learner(0), Actor(0)), ""),
            (Fault::KillAll, "SIGKILL"),
            (Fault::KillAgain(Learner(0), 30), ""),
            (Fault::KillAndHold(0, 900), ""),
            (Fault::Pause(Orchestrator, 900), ""),
            (Fault::Terminate(Orchestrator), "SIGTERM, stopped, no result, child stopped"),
            (Fault::Terminate(Learner(0)), ""),
            (Fault::Terminate(Actor(0)), ""),
            (Fault::Terminate(Child), "child stopped, no validation"),
            (Fault::Interrupt, "SIGINT, stopped, no result, child stopped"),
            (point("orchestrator"), "SIGKILL"),
            (point("learner"), ""),
            (point("actor"), ""),
            (Fault::FullDisk(700), "disk, no validation"),
            (Fault::FullMemory(700), "memory, SIGBUS, deaths, no validation"),
            (Fault::LosePower, "SIGKILL"),
            (Fault::Checkpoint(Damage::NoTensors), ""),
            (Fault::Metrics(Journal::Torn), ""),
            (Fault::FewDescriptors(48), "few, no validation"),
            (Fault::FewDescriptors(ENOUGH_DESCRIPTORS), ""),
        ]
    }

    /// A start with few descriptors met a full disk and said so, and was blamed for not naming the descriptors.
    #[test]
    fn an_end_is_explained_by_any_fault_that_was_in_force_and_by_no_other() {
        let faults = (0..400).flat_map(|number| Case::draw(1, number).faults);
        let drawn: BTreeSet<_> = faults.map(|planned| planned.fault.class()).collect();
        assert_eq!(kinds().into_iter().map(|(fault, _)| fault.class()).collect::<BTreeSet<_>>(), drawn);
        for (one, explained_by_one) in kinds() {
            for (other, explained_by_other) in kinds() {
                let faults = [one, other];
                let together = |end: &str| match end {
                    "twice" => faults.iter().all(asks_to_stop) && faults.contains(&Fault::Interrupt),
                    "at stop" => faults.iter().any(asks_to_stop) && faults.iter().any(|fault| deaths(fault) > 0),
                    "deaths" => faults.iter().map(deaths).sum::<u32>() >= 3,
                    _ => false,
                };
                for (end, raw_status, stderr) in ENDS {
                    let listed = format!("{explained_by_one}, {explained_by_other}");
                    let expected = listed.split(", ").any(|name| name == end) || together(end);
                    let explained = explain(&ended(raw_status, stderr), &faults);
                    assert_eq!(explained.is_ok(), expected, "{end} after {one} and {other}: {explained:?}");
                }
            }
        }
    }

    #[test]
    fn a_cause_that_was_not_in_force_may_not_be_named_beside_one_that_was() {
        let words = "error: the disk is full (No space left on device)\nerror: Too many open files (os error 24)";
        let full_disk = [Fault::FullDisk(700), Fault::FewDescriptors(ENOUGH_DESCRIPTORS)];
        let blamed = explain(&ended(FAILURE, words), &full_disk).unwrap_err().to_string();
        assert!(blamed.starts_with("it names few descriptors, which did not happen: "), "{blamed}");
        assert!(explain(&ended(FAILURE, words), &[Fault::FullDisk(700), Fault::FewDescriptors(48)]).is_ok());
    }
}
