use super::Finding;

/// Which it is. That it has what programs are compiled for, [`wire::require_processor!`] has checked.
pub fn check() -> Finding {
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = cpuinfo.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    let name = name.map_or(std::env::consts::ARCH, |(_, name)| name.trim());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    Finding::Good(format!("{name}, {cores} threads usable"))
}
