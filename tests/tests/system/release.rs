//! What `make dist` packs, from the programs that are built: these are linked for this machine, so what they
//! need of it is not compared.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use system_tests::{Printed, Workshop, binary, complete, root};

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
    let options = ["--programs", &programs, "--out", &out.display().to_string(), "--as-built"];
    python("pack.py", &options, &workshop.path(".")).good();
    out
}

#[test]
fn a_program_that_needs_more_than_promised_is_named() {
    let workshop = Workshop::new();
    let program = binary("actor").display().to_string();
    let old = python("symbols.py", &["--glibc", "2.2", &program], &workshop.path("."));
    // Which it is depends on the machine; `memcpy` of 2.14 is in every program that was linked since.
    old.refused("needs GLIBC_2.14 of libc.so.6, newer than GLIBC_2.2: ");
    assert!(old.stderr.contains("memcpy"), "{}", old.stderr);
    python("symbols.py", &["--glibc", "2.99", &program], &workshop.path(".")).good();
    // Where its libtorch lies on this machine is no business of a release.
    let learner = binary("learner").display().to_string();
    python("symbols.py", &["--glibc", "2.99", &learner], &workshop.path("."))
        .refused("a folder of the machine that built it");
}

/// A library that asks glibc for `planted`, a function of glibc 2.34, whatever glibc this machine has.
fn planted(workshop: &Workshop) -> PathBuf {
    let folder = workshop.path("planted");
    std::fs::create_dir(&folder).expect("a folder");
    for (file, text) in [
        ("libc.c", "void planted(void) {}\n"),
        ("libc.map", "GLIBC_2.34 { global: planted; };\n"),
        ("newer.c", "void planted(void);\nvoid call(void) { planted(); }\n"),
    ] {
        std::fs::write(folder.join(file), text).expect("a file");
    }
    for arguments in
        ["-Wl,-soname,libc.so.6 -Wl,--version-script=libc.map -o libc.so.6 libc.c", "-o newer.so newer.c ./libc.so.6"]
    {
        let mut compile = command("cc", &folder);
        compile.args(["-shared", "-nostdlib", "-fPIC"]).args(arguments.split(' '));
        complete(compile).good();
    }
    folder.join("newer.so")
}

#[test]
fn a_file_that_needs_a_newer_glibc_is_not_packed() {
    let workshop = Workshop::new();
    let newer = planted(&workshop);
    let name = newer.display().to_string();
    let symbols = |glibc: &str| python("symbols.py", &["--glibc", glibc, &name], &workshop.path("."));
    assert!(symbols("2.34").success && !symbols("2.33").success);

    // As a program, as the library for other languages, and as the module in a wheel.
    let programs = workshop.path("programs");
    std::fs::create_dir(&programs).expect("a folder");
    for program in ["orchestrator", "learner"] {
        std::os::unix::fs::symlink(binary(program), programs.join(program)).expect("a link");
    }
    std::fs::copy(&newer, programs.join("actor")).expect("a copy");
    let wheels = workshop.path("wheels");
    std::fs::create_dir(&wheels).expect("a folder");
    let wheel = wheels.join(format!("stillroom-{}-cp310-abi3-manylinux_2_28_x86_64.whl", env!("CARGO_PKG_VERSION")));
    let mut zip = command("python3", newer.parent().expect("a folder"));
    std::fs::create_dir(newer.with_file_name("stillroom")).expect("a folder");
    std::fs::copy(&newer, newer.with_file_name("stillroom").join("libstillroom_actor.so")).expect("a copy");
    zip.args(["-m", "zipfile", "-c"]).arg(&wheel).args(["newer.so", "stillroom"]);
    assert!(complete(zip).success);
    let out = workshop.path("dist");
    let folders = [&programs, &wheels, &out].map(|folder| folder.display().to_string());
    let arguments = ["--programs", &folders[0], "--wheels", &folders[1], "--out", &folders[2], "--glibc", "2.28"];
    let printed = python("pack.py", &arguments, &workshop.path("."));
    assert!(!printed.success);
    let of_library = "_x86_64/stillroom/libstillroom_actor.so".to_owned();
    for file in [format!("stillroom-{}/actor", env!("CARGO_PKG_VERSION")), "_x86_64/newer.so".to_owned(), of_library] {
        let finding = format!("{file} needs GLIBC_2.34 of libc.so.6, newer than GLIBC_2.28: planted");
        assert!(printed.stderr.contains(&finding), "{finding}: {}", printed.stderr);
    }
    assert_eq!(std::fs::read_dir(&out).expect("a folder").count(), 0, "nothing of a release is left");
}

#[test]
fn a_release_takes_its_notes_from_the_changelog_and_needs_them() {
    let workshop = Workshop::new();
    let file = workshop.path("CHANGELOG.md");
    let notes = |version: &str, text: &str| {
        std::fs::write(&file, text).expect("a file");
        python("changelog.py", &[version, &file.display().to_string()], &workshop.path("."))
    };
    let two =
        "# Changelog\n\n## [Unreleased]\n\n## [0.2.0] - 2026-12-01\n\n- New.\n\n## [0.1.0] - 2026-11-23\n\n- Old.\n";
    let printed = notes("0.2.0", two).good();
    assert_eq!(printed.stdout, "## [0.2.0] - 2026-12-01\n\n- New.\n");
    for (version, text, said) in [
        ("0.3.0", two.to_owned(), "no section '## [0.3.0] - YEAR-MONTH-DAY'"),
        // A dot is a dot.
        ("0.2", two.to_owned(), "no section '## [0.2] - "),
        ("0.1.0", two.replace("- Old.\n", ""), "nothing stands below it"),
        ("0.2.0", two.replace(" - 2026-12-01", ""), "no section '## [0.2.0] - "),
        ("0.2.0", two.replace("## [Unreleased]\n", "## [Unreleased]\n\n- Newest.\n"), "lists changes as unreleased"),
    ] {
        notes(version, &text).refused(said);
    }

    // What packs says the same; with STRICT it is an error.
    let programs = binary("orchestrator").parent().expect("a folder").to_owned();
    let pack = |strict: &str| {
        let mut pack = command("python3", &workshop.path("."));
        pack.arg(root().join("deploy/release/pack.py")).arg("--as-built").env("STRICT", strict);
        pack.arg("--programs").arg(&programs).arg("--changelog").arg(&file).arg("--out").arg(workshop.path("dist"));
        complete(pack)
    };
    let version = env!("CARGO_PKG_VERSION");
    std::fs::write(&file, two.replace("0.1.0", "9.9.9").replace("0.2.0", "9.9.8")).expect("a file");
    let printed = pack("yes");
    let said = format!("not a release: CHANGELOG.md has no section '## [{version}]");
    printed.refused(&said);
    std::fs::write(&file, two.replace("0.2.0", version)).expect("a file");
    let printed = pack("");
    assert!(printed.success && !printed.stderr.contains("CHANGELOG.md"), "{}", printed.stderr);
    let written = std::fs::read_to_string(workshop.path("dist").join(format!("stillroom-{version}.notes.md")));
    assert_eq!(written.expect("a file"), format!("## [{version}] - 2026-12-01\n\n- New.\n"));
}

#[test]
fn an_archive_holds_all_that_a_machine_needs_and_its_programs_run() {
    let workshop = Workshop::new();
    let out = packed(&workshop);
    let mut check = command("sha256sum", &out);
    check.args(["--check", "--strict", "SHA256SUMS"]);
    let checked = complete(check);
    // The archives of programs and of sources, the bill of materials, and the notes where this version is in the changelog.
    let files = std::fs::read_dir(&out).expect("a folder").count() - 1;
    assert!((3..=4).contains(&files));
    assert!(checked.success && checked.stdout.lines().count() == files, "{}{}", checked.stdout, checked.stderr);

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

/// As a user installs it: a virtual environment of its own, pip, nothing of the checkout but the libtorch.
#[test]
fn a_wheel_proves_itself_in_a_fresh_environment() {
    let workshop = Workshop::new();
    let run = |program: &Path, arguments: &[&str]| {
        let mut command = command(program, &workshop.path("."));
        command.args(arguments);
        complete(command)
    };
    let succeed = |program: &Path, arguments: &[&str]| {
        let printed = run(program, arguments);
        assert!(printed.success, "{program:?} {arguments:?}: {}{}", printed.stdout, printed.stderr);
        printed.stdout
    };
    let mut setup = command(root().join("python/setup"), &workshop.path("."));
    // Of what `make library` has compiled: maturin's own build can take longer than a command may here.
    setup.env("BUILT", "yes");
    let printed = complete(setup);
    assert!(printed.success, "{}{}", printed.stdout, printed.stderr);
    let name = |path: &PathBuf| path.file_name().expect("a name").to_string_lossy().into_owned();
    let wheels = std::fs::read_dir(root().join("target/wheels")).expect("a folder").flatten().map(|entry| entry.path());
    let made = wheels.into_iter().find(|path| name(path).starts_with("stillroom-")).expect("a wheel");
    let wheel = workshop.path(&name(&made));
    std::fs::copy(&made, &wheel).expect("a copy");
    let programs = binary("orchestrator").parent().expect("a folder").display().to_string();
    let wheel = wheel.display().to_string();
    python("wheel.py", &["--programs", &programs, &wheel], &workshop.path(".")).good();
    let packed = succeed(Path::new("python3"), &["-m", "zipfile", "-l", &wheel]);
    for file in [
        "stillroom/_stillroom.abi3.so",
        "stillroom/c/libstillroom_actor.so",
        "stillroom/c/stillroom_actor.h",
        "stillroom/py.typed",
        "stillroom_programs/actor",
        "stillroom_programs/learner",
        "stillroom_programs/models/fetch.safetensors",
        "stillroom_programs/orchestrator",
    ] {
        assert!(packed.lines().any(|line| line.starts_with(&format!("{file} "))), "{file}: {packed}");
    }
    let metadata = "import sys, zipfile; file = zipfile.ZipFile(sys.argv[1]); \
                    [print(file.read(name).decode()) for name in file.namelist() if name.endswith(('METADATA', 'entry_points.txt'))]";
    let metadata = succeed(Path::new("python3"), &["-c", metadata, &wheel]);
    for line in ["Requires-Dist: torch==2.11.0 ; extra == 'train'", "stillroom=stillroom_programs:orchestrator"] {
        assert!(metadata.lines().any(|found| found == line), "{line}: {metadata}");
    }

    let environment = workshop.path("environment");
    succeed(Path::new("python3"), &["-m", "venv", &environment.display().to_string()]);
    let bin = environment.join("bin");
    // The console commands need none of what the simulator's module needs.
    succeed(&bin.join("pip"), &["install", "--no-index", "--no-deps", &wheel]);
    run(&bin.join("learner"), &["check"]).refused("pip install 'stillroom[train]'");
    let without = run(&bin.join("stillroom"), &["doctor", "--preset", "demo"]);
    assert!(!without.success && without.stdout.contains("Run `pip install 'stillroom[train]'`"), "{}", without.stdout);

    let site = succeed(&bin.join("python"), &["-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]);
    std::os::unix::fs::symlink(torch(), Path::new(site.trim()).join("torch")).expect("a link");
    let said = succeed(&bin.join("stillroom"), &["test"]);
    assert!(said.contains(site.trim()) && said.ends_with("this installation works\n"), "{said}");
}

/// The torch that the programs were built with: `LIBTORCH`, as for the build, or what set-up made.
fn torch() -> PathBuf {
    std::env::var_os("LIBTORCH").map_or_else(|| root().join(".torch/libtorch"), PathBuf::from)
}

#[test]
fn the_bill_lists_what_is_linked_and_what_is_fetched() {
    let workshop = Workshop::new();
    let file = workshop.path("bill.json");
    python("parts.py", &["--bill", &file.display().to_string()], &workshop.path(".")).good();
    let bill: Value = serde_json::from_slice(&std::fs::read(file).expect("a file")).expect("JSON");
    assert_eq!((&bill["bomFormat"], &bill["specVersion"]), (&"CycloneDX".into(), &"1.5".into()));
    let parts = bill["components"].as_array().expect("a list");
    let names: Vec<_> = parts.iter().filter_map(|part| part["name"].as_str()).collect();
    for name in ["rapier3d", "iceoryx2", "tch", "pyo3", "torch", "orchestrator"] {
        assert!(names.contains(&name), "{name}: {names:?}");
    }
    for name in ["proptest", "syn", "cc", "chaos"] {
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
