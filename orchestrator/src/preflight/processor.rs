use super::Finding;

/// What x86-64-v3 has beyond x86-64-v2, as /proc/cpuinfo names it.
const NEEDED: [&str; 7] = ["avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"];

pub fn check() -> Finding {
    if !cfg!(target_arch = "x86_64") {
        return Finding::Good(std::env::consts::ARCH.to_owned());
    }
    match std::fs::read_to_string("/proc/cpuinfo") {
        Ok(text) => check_text(&text),
        Err(error) => Finding::Warning(format!("/proc/cpuinfo: {error}")),
    }
}

fn check_text(cpuinfo: &str) -> Finding {
    let field = |name: &str| {
        let line = cpuinfo.lines().find(|line| line.split(':').next().is_some_and(|key| key.trim() == name))?;
        Some(line.split_once(':')?.1.trim().to_owned())
    };
    let name = field("model name").unwrap_or_else(|| "unknown processor".to_owned());
    let Some(flags) = field("flags") else { return Finding::Warning(format!("{name}: features unknown")) };
    let flags: Vec<&str> = flags.split_whitespace().collect();
    let missing: Vec<&str> = NEEDED.into_iter().filter(|feature| !flags.contains(feature)).collect();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    if missing.is_empty() {
        Finding::Good(format!("{name}, {cores} threads usable"))
    } else {
        Finding::Problem(format!(
            "{name} lacks {}: the programs are compiled for x86-64-v3; build them with another target-cpu \
             (.cargo/config.toml)",
            missing.join(", ")
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_feature_is_named() {
        let with = |flags: &str| format!("processor : 0\nmodel name : Some CPU\nflags : fpu {flags}\n");
        assert!(matches!(check_text(&with("avx avx2 bmi1 bmi2 f16c fma movbe")), Finding::Good(_)));
        let Finding::Problem(text) = check_text(&with("avx bmi1 bmi2 f16c fma movbe")) else {
            panic!("AVX2 is missing")
        };
        assert!(text.contains("Some CPU lacks avx2:"), "{text}");
    }
}
