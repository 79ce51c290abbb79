use crate::preflight::programs;
use crate::process_end::wait_for_child;
use crate::run::process_state::children;
use std::collections::HashMap;
use std::io::Read;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use view::data::Gpu;

/// GPUs are asked at most this often: `nvidia-smi` takes a tenth of a second.
const GPUS_EVERY: Duration = Duration::from_secs(3);
/// What `/proc` counts processor time in: hundredths of a second on every Linux of this architecture.
const TICKS_PER_S: f64 = 100.0;
const GPUS_DEADLINE: Duration = Duration::from_secs(2);

#[derive(Debug, Clone, PartialEq)]
pub struct Process {
    pub name: String,
    pub pid: u32,
    pub cores: Option<f64>,
    pub memory_bytes: Option<u64>,
    pub stopped: bool,
}

#[derive(Debug, Default)]
pub struct Processes {
    ticks: HashMap<u32, u64>,
    at: Option<Instant>,
    gpus: Option<(Instant, Vec<Gpu>)>,
}

impl Processes {
    pub fn look(&mut self, orchestrator: u32) -> Vec<Process> {
        let now = Instant::now();
        let elapsed = self.at.map(|before| now.duration_since(before).as_secs_f64());
        let mut ticks = HashMap::new();
        let mut seen = Vec::new();
        for pid in std::iter::once(orchestrator).chain(children(orchestrator)) {
            let Some((used, stopped)) =
                std::fs::read_to_string(format!("/proc/{pid}/stat")).ok().and_then(|stat| used(&stat))
            else {
                continue;
            };
            let Some(name) = std::fs::read(format!("/proc/{pid}/cmdline")).ok().and_then(|line| name_of(&line)) else {
                continue;
            };
            ticks.insert(pid, used);
            let before = self.ticks.get(&pid).copied();
            let cores = before.zip(elapsed).filter(|(_, elapsed)| *elapsed > 0.0);
            let cores = cores.map(|(before, elapsed)| used.saturating_sub(before) as f64 / TICKS_PER_S / elapsed);
            let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
            seen.push(Process { name, pid, cores, memory_bytes: own_memory(&status), stopped });
        }
        (self.ticks, self.at) = (ticks, Some(now));
        seen
    }

    pub fn gpus(&mut self) -> Vec<Gpu> {
        if let Some((asked, gpus)) = &self.gpus
            && asked.elapsed() < GPUS_EVERY
        {
            return gpus.clone();
        }
        let gpus = ask_gpus().unwrap_or_default();
        self.gpus = Some((Instant::now(), gpus.clone()));
        gpus
    }
}

/// Ticks of the processor in `/proc/PID/stat`, and whether the process is stopped. The name before is in brackets, and
/// can hold brackets itself.
fn used(stat: &str) -> Option<(u64, bool)> {
    let (_, after) = stat.rsplit_once(") ")?;
    let fields: Vec<&str> = after.split_whitespace().collect();
    let ticks = |at: usize| fields.get(at)?.parse::<u64>().ok();
    Some((ticks(11)? + ticks(12)?, matches!(fields.first(), Some(&("T" | "t")))))
}

fn name_of(line: &[u8]) -> Option<String> {
    let words: Vec<String> =
        line.split(|&byte| byte == 0).map(|word| String::from_utf8_lossy(word).into_owned()).collect();
    let after =
        |flag: &str| words.iter().rposition(|word| word == flag).and_then(|at| words.get(at + 1)?.parse::<u32>().ok());
    let program = words.first()?.rsplit('/').next()?;
    match program {
        // A viewer that the run started is no part of it.
        "orchestrator" => Some("orchestrator".to_owned()).filter(|_| words.get(1).is_none_or(|word| word != "view")),
        "learner" => Some(format!("learner-{}", after("--rank")?)),
        // Where environments are not built in the program is any, with the same arguments.
        _ => after("--actor")
            .filter(|_| words.iter().any(|word| word == "--wire"))
            .map(|actor| format!("actor-{actor:02}")),
    }
}

fn own_memory(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

fn ask_gpus() -> Option<Vec<Gpu>> {
    let mut child = Command::new(programs::on_path("nvidia-smi")?)
        .args(["--query-gpu=index,name,utilization.gpu,memory.used,memory.total", "--format=csv,noheader,nounits"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let ended = wait_for_child(&mut child, GPUS_DEADLINE);
    if !matches!(ended, Ok(Some(status)) if status.success()) {
        let _ = child.kill();
        let _ = child.wait();
        return None;
    }
    let mut text = String::new();
    child.stdout.take()?.read_to_string(&mut text).ok()?;
    Some(text.lines().filter_map(gpu).collect())
}

fn gpu(line: &str) -> Option<Gpu> {
    let mut fields = line.split(',').map(str::trim);
    let index = fields.next()?.parse().ok()?;
    let name = fields.next()?.to_owned();
    let mut number = || fields.next()?.parse::<f64>().ok();
    let (percent, used, total) = (number()?, number()?, number()?);
    Some(Gpu { index, name, busy: percent / 100.0, used_mib: used as u64, total_mib: total as u64 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processes_are_called_as_their_logs() {
        let name = |line: &str| name_of(line.replace(' ', "\0").as_bytes());
        assert_eq!(name("/x/actor --wire a --actor 3 --config c").as_deref(), Some("actor-03"));
        assert_eq!(
            name("/x/python -m stillroom serve a.py:b --actor 3 --config c --wire a").as_deref(),
            Some("actor-03")
        );
        assert_eq!(name("learner --run r --rank 1").as_deref(), Some("learner-1"));
        assert_eq!(name("./orchestrator up").as_deref(), Some("orchestrator"));
        assert_eq!(name("orchestrator view runs/a"), None);
        assert_eq!(name("vi actor"), None);
        assert_eq!(name("actor replay"), None);
    }

    #[test]
    fn ticks_memory_and_gpus_are_read_as_they_are_written() {
        let stat = "12 (a) (b) T 1 2 3 4 5 6 7 8 9 10 100 23 0 0 20";
        assert_eq!(used(stat), Some((123, true)));
        assert_eq!(own_memory("Name:\tx\nRssAnon:\t    2048 kB\n"), Some(2 << 20));
        let expected = Gpu { index: 0, name: "NVIDIA H200".into(), busy: 0.87, used_mib: 10240, total_mib: 143_771 };
        assert_eq!(gpu("0, NVIDIA H200, 87, 10240, 143771"), Some(expected));
        assert_eq!(gpu("0, NVIDIA H200, [N/A], 1, 2"), None);
    }
}
