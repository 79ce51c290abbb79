//! Machines that cannot build or run it: each is told why, in a sentence.

use std::path::Path;
use std::process::{Command, Stdio};
use system_tests::{Printed, Workshop, binary, complete, root};

/// Set-up of this checkout on a machine whose `uname` prints something else.
fn set_up_on(system: &str, machine: &str) -> Printed {
    let workshop = Workshop::new();
    let script = format!("#!/bin/sh\ncase $1 in -s) echo {system} ;; -m) echo {machine} ;; *) exit 2 ;; esac\n");
    workshop.script("uname", &script);
    let path = std::env::var("PATH").expect("a PATH");
    let mut command = workshop.program(root().join("deploy/setup"));
    command.env("PATH", format!("{}:{path}", workshop.path(".").display())).env_remove("LIBTORCH");
    complete(command)
}

#[test]
fn set_up_says_on_macos_and_on_other_processors_what_is_needed() {
    for (system, machine) in [("Linux", "riscv64"), ("Darwin", "arm64"), ("Darwin", "x86_64")] {
        let printed = set_up_on(system, machine);
        let sentence = format!(
            "setup: error: this is {system} on {machine}; Stillroom's programs are for 64-bit x86 and ARM Linux only, \
             because libtorch is pinned for it. Use such a machine, or a container on one; the Python package alone ('make \
             python') needs no libtorch.\n"
        );
        assert!(!printed.success && printed.stderr == sentence, "{}", printed.stderr);
    }
}

/// `pip install .` calls these hooks, with maturin, which is not reached here.
#[test]
fn pip_says_what_a_build_of_the_wheel_lacks() {
    let workshop = Workshop::new();
    std::fs::write(workshop.path("maturin.py"), "").expect("a writable temporary folder");
    workshop.script("rustc", "#!/bin/sh\necho 'rustc 1.60.0'\n");
    let path = format!("{}:{}", workshop.path(".").display(), std::env::var("PATH").expect("a PATH"));
    for (variable, value, sentence) in [
        ("PATH", path.as_str(), "setup: error: rustc 1.60.0 is too old: Stillroom needs "),
        ("CXX", "no-compiler", "setup: error: no C++ compiler: 'no-compiler' is not on PATH"),
        ("LIBTORCH", "/nowhere", "setup: error: LIBTORCH=/nowhere"),
    ] {
        for hook in ["prepare_metadata_for_build_wheel", "build_wheel"] {
            let mut command = workshop.program("python3");
            command.args(["-c", &format!("import backend; backend.{hook}('.')")]);
            command.env("PYTHONDONTWRITEBYTECODE", "1").env_remove("LIBTORCH").env(variable, value);
            let folders = [workshop.path("."), root().join("deploy/release")];
            command.env("PYTHONPATH", std::env::join_paths(folders).expect("folders without colons"));
            let printed = complete(command);
            assert!(!printed.success && printed.stderr.starts_with(sentence), "{hook}: {}", printed.stderr);
            assert!(
                printed.stderr.ends_with("stillroom: error: `deploy/setup` failed: see above\n"),
                "{}",
                printed.stderr
            );
        }
    }
}

/// A program under QEMU's emulation of a processor, None where there is no QEMU.
fn under_processor(processor: &str, program: &Path) -> Option<Printed> {
    let mut command = Command::new("qemu-x86_64");
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if command.arg("--version").status().is_err() {
        eprintln!("skipped: qemu-x86_64 is not installed (Debian: apt-get install qemu-user)");
        return None;
    }
    let mut command = Command::new("qemu-x86_64");
    command.args(["-cpu", processor]).arg(program).arg("--version");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    Some(complete(command))
}

#[test]
fn every_program_says_that_a_processor_has_no_avx2() {
    for program in ["orchestrator", "actor", "learner"] {
        // Of 2008, without AVX; of 2011, with AVX alone.
        for processor in ["Nehalem", "SandyBridge"] {
            let Some(printed) = under_processor(processor, &binary(program)) else { return };
            assert!(!printed.success && printed.stdout.is_empty(), "{program}: {}", printed.stdout);
            let lines: Vec<_> = printed.stderr.lines().filter(|line| !line.starts_with("qemu")).collect();
            assert!(
                matches!(lines[..], [line] if line.starts_with("error: this processor has no AVX2, FMA or BMI2")),
                "{program}: {}",
                printed.stderr
            );
        }
    }
}
