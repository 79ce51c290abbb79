//! Whether a process of this machine is stopped (SIGSTOP, Ctrl-Z, a debugger): it neither works nor answers.

use std::path::Path;

#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Stopped {
    /// Name of its program.
    pub program: String,
    pub pid: u32,
}

/// Those of a process and its children that are stopped.
pub fn stopped(pid: u32) -> Vec<Stopped> {
    let process = format!("/proc/{pid}");
    let children = std::fs::read_dir(Path::new(&process).join("task")).into_iter().flatten().flatten();
    let children = children.filter_map(|task| std::fs::read_to_string(task.path().join("children")).ok());
    let children: Vec<u32> = children
        .flat_map(|list| list.split_whitespace().filter_map(|pid| pid.parse().ok()).collect::<Vec<_>>())
        .collect();
    std::iter::once(pid).chain(children).filter_map(look).collect()
}

fn look(pid: u32) -> Option<Stopped> {
    let (program, state) = parse(&std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?)?;
    matches!(state, 'T' | 't').then_some(Stopped { program, pid })
}

/// Name and state in `/proc/PID/stat`. The name is in brackets, and can hold brackets itself.
fn parse(stat: &str) -> Option<(String, char)> {
    let (before, after) = stat.rsplit_once(") ")?;
    Some((before.split_once('(')?.1.to_owned(), after.chars().next()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::process::{Pid, Signal, kill_process};
    use std::process::{Child, Command};
    use std::time::{Duration, Instant};

    fn signal(child: &Child, signal: Signal) {
        kill_process(Pid::from_child(child), signal).unwrap();
    }

    #[test]
    fn a_stopped_process_is_told_from_one_that_runs() {
        assert_eq!(parse("12 (a) (b) T 1 2"), Some(("a) (b".to_owned(), 'T')));
        let mut child = Command::new("sleep").arg("60").spawn().unwrap();
        let of_child = || stopped(child.id());
        assert_eq!(of_child(), []);
        signal(&child, Signal::STOP);
        let begun = Instant::now();
        while of_child().is_empty() {
            assert!(begun.elapsed() < Duration::from_secs(10), "it is stopped soon");
            std::thread::sleep(Duration::from_millis(5));
        }
        let expected = Stopped { program: "sleep".to_owned(), pid: child.id() };
        assert_eq!(of_child(), std::slice::from_ref(&expected));
        assert!(stopped(std::process::id()).contains(&expected), "a child is found by its parent");
        signal(&child, Signal::KILL);
        child.wait().unwrap();
        assert_eq!(stopped(child.id()), []);
    }
}
