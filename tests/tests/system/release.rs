//! What `make dist` packs, from the programs that are built: these are linked for this machine, so what they
//! need of it is not compared.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use system_tests::{Printed, Workshop, binary, complete};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().expect("a checkout")
}

/// A command without what a build, or another test's machine, has in its environment.
fn command(program: impl AsRef<std::ffi::OsStr>, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command.current_dir(folder);
    for variable in ["LIBTORCH", "LD_LIBRARY_PATH", "STRICT", "SOURCE_DATE_EPOCH"] {
        command.env_remove(variable);
    }
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn python(script: &str, arguments: &[&str], folder: &Path) -> Printed {
    let mut command = command("python3", folder);
    command.arg(root().join("deploy/release").join(script)).args(arguments);
    complete(command)
}

fn packed(workshop: &Workshop) -> PathBuf {
    let out = workshop.path("dist");
    let programs = binary("orchestrator").parent().expect("a folder").display().to_string();
    let printed = python(
        "pack.py",
        &["--programs", &programs, "--out", &out.display().to_string(), "--as-built"],
        &workshop.path("."),
    );
    assert!(printed.success, "{}", printed.stderr);
    out
}

#[test]
fn a_program_that_needs_more_than_promised_is_named() {
    let workshop = Workshop::new();
    let program = binary("actor").display().to_string();
    let old = python("symbols.py", &["--glibc", "2.2", &program], &workshop.path("."));
    // Which it is depends on the machine; `memcpy` of 2.14 is in every program that was linked since.
    assert!(
        !old.success && old.stderr.contains("needs GLIBC_2.14 of libc.so.6, newer than GLIBC_2.2: "),
        "{}",
        old.stderr
    );
    assert!(old.stderr.contains("memcpy"), "{}", old.stderr);
    let new = python("symbols.py", &["--glibc", "2.99", &program], &workshop.path("."));
    assert!(new.success, "{}", new.stderr);
    // Where its libtorch lies on this machine is no business of a release.
    let learner = binary("learner").display().to_string();
    let built = python("symbols.py", &["--glibc", "2.99", &learner], &workshop.path("."));
    assert!(!built.success && built.stderr.contains("a folder of the machine that built it"), "{}", built.stderr);
}

#[test]
fn an_archive_holds_all_that_a_machine_needs_and_its_programs_run() {
    let workshop = Workshop::new();
    let out = packed(&workshop);
    let mut check = command("sha256sum", &out);
    check.args(["--check", "--strict", "SHA256SUMS"]);
    let checked = complete(check);
    assert!(checked.success && checked.stdout.lines().count() == 2, "{}{}", checked.stdout, checked.stderr);

    let version = env!("CARGO_PKG_VERSION");
    let name = format!("stillroom-{version}");
    let mut unpack = command("tar", &out);
    unpack.args(["xzf", &format!("{name}-x86_64-linux-as-built.tar.gz")]);
    assert!(complete(unpack).success);
    let release = out.join(&name);
    for file in [
        "CHANGELOG.md",
        "LICENSE-APACHE",
        "LICENSE-MIT",
        "README.md",
        "SECURITY.md",
        "deploy/install",
        "deploy/setup_libtorch.py",
        "scenes",
        "share/bash-completion/completions/orchestrator",
        "share/man/man1/orchestrator-up.1",
        "suites",
    ] {
        assert!(release.join(file).exists(), "{file}");
    }
    let licences = std::fs::read_to_string(release.join("THIRD-PARTY.txt")).expect("a text");
    assert!(licences.contains("rapier3d ") && licences.contains("Permission is hereby granted"));
    assert!(!licences.contains("proptest "), "tests are not in the programs");

    for program in ["orchestrator", "actor"] {
        let mut ask = command(release.join(program), &release);
        ask.arg("--version");
        let said = complete(ask).stdout;
        let rest = said.trim_end().strip_prefix(&format!("{program} {version}")).unwrap_or_else(|| panic!("{said}"));
        // The commit, where the programs were built with one.
        assert!(rest.is_empty() || rest.starts_with(" (") && rest.ends_with(')'), "{said}");
    }
    // Before the set-up, it is the release's own that is named.
    let doctor = |release: &Path| {
        let mut doctor = command(release.join("orchestrator"), release);
        doctor.args(["doctor", "--preset", "demo"]);
        let printed = complete(doctor);
        printed.stdout + &printed.stderr
    };
    let said = doctor(&release);
    let script = release.canonicalize().expect("a folder").join("setup");
    assert!(said.contains(&format!("Run `{}`", script.display())), "{said}");

    let mut setup = command(&script, &out);
    setup.env("LIBTORCH", torch());
    let printed = complete(setup);
    assert!(
        printed.success && printed.stdout.contains("./orchestrator doctor"),
        "{}{}",
        printed.stdout,
        printed.stderr
    );
    let mut check = command(release.join("learner"), &release);
    check.arg("check");
    let answer: Value = serde_json::from_str(&complete(check).stdout).expect("JSON");
    // Its run path names nothing but the release.
    assert!(answer["torch"].as_str().is_some_and(|version| version.starts_with("2.11")), "{answer}");
    assert!(!doctor(&release).contains("there is no libtorch"));
}

/// The torch that the programs were built with: `LIBTORCH`, as for the build, or what set-up made.
fn torch() -> PathBuf {
    std::env::var_os("LIBTORCH").map_or_else(|| root().join(".torch/libtorch"), PathBuf::from)
}

#[test]
fn the_bill_lists_what_is_linked_and_what_is_fetched() {
    let workshop = Workshop::new();
    let file = workshop.path("bill.json");
    let printed = python("parts.py", &["--bill", &file.display().to_string()], &workshop.path("."));
    assert!(printed.success, "{}", printed.stderr);
    let bill: Value = serde_json::from_slice(&std::fs::read(file).expect("a file")).expect("JSON");
    assert_eq!((&bill["bomFormat"], &bill["specVersion"]), (&"CycloneDX".into(), &"1.5".into()));
    let parts = bill["components"].as_array().expect("a list");
    let names: Vec<_> = parts.iter().filter_map(|part| part["name"].as_str()).collect();
    for name in ["rapier3d", "iceoryx2", "tch", "pyo3", "torch", "orchestrator"] {
        assert!(names.contains(&name), "{name}: {names:?}");
    }
    for name in ["proptest", "syn", "cc", "chaos", "prost-build"] {
        assert!(!names.contains(&name), "{name} is in no program");
    }
    // What comes from a registry can be compared with it.
    let rapier = parts.iter().find(|part| part["name"] == "rapier3d").expect("found above");
    assert_eq!(rapier["hashes"][0]["content"].as_str().map(str::len), Some(64));
    assert_eq!(rapier["licenses"][0]["expression"], "Apache-2.0");
    let references: Vec<_> = parts.iter().map(|part| &part["bom-ref"]).collect();
    for dependency in bill["dependencies"].as_array().expect("a list") {
        for to in dependency["dependsOn"].as_array().expect("a list") {
            assert!(references.contains(&to), "{to}");
        }
    }
}
