//! Whether a process of this machine is stopped (SIGSTOP, Ctrl-Z, a debugger): it neither works nor answers.

#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Stopped {
    pub program: String,
    pub pid: u32,
}

pub fn children(pid: u32) -> Vec<u32> {
    let tasks = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let lists = tasks.filter_map(|task| std::fs::read_to_string(task.path().join("children")).ok());
    lists.flat_map(|list| list.split_whitespace().filter_map(|pid| pid.parse().ok()).collect::<Vec<_>>()).collect()
}

pub fn stopped(pid: u32) -> Vec<Stopped> {
    std::iter::once(pid).chain(children(pid)).filter_map(look).collect()
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
