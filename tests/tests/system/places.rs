//! Places of another kind: disks without links or locks, containers, odd temporary folders. Each works, or is refused in one
//! sentence, which `doctor` says as well.

use crate::figures::validating;
use rustix::process::Signal;
use serde_json::Value;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};
use system_tests::{Printed, Undisturbed, Workshop, binary, complete, finish, signal, start, tell, wait_until};

/// What a disk like exFAT, a network share or a shared folder of a virtual machine refuses, as a library that programs are
/// started with. It concerns all below `DISK`.
const DISK: &str = r#"
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
static int below(const char *path) {
    char here[4096], whole[8192];
    const char *disk = getenv("DISK");
    snprintf(whole, sizeof whole, "%s/%s", path[0] == '/' || !getcwd(here, sizeof here) ? "" : here, path);
    return disk && !strncmp(whole + (path[0] == '/'), disk, strlen(disk));
}
static int of(int file) {
    char link[64], path[4096] = {0};
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    return readlink(link, path, sizeof path - 1) > 0 && below(path);
}
#define REAL(name, ...) ((int (*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name))
#define REFUSE(condition, error) if (condition) { errno = error; return -1; }
int symlink(const char *to, const char *path) {
    REFUSE(below(path), ENOSYS) return REAL(symlink, const char *, const char *)(to, path);
}
int link(const char *from, const char *path) {
    REFUSE(below(path), EPERM) return REAL(link, const char *, const char *)(from, path);
}
int linkat(int a, const char *from, int b, const char *path, int flags) {
    REFUSE(below(path), EPERM) return REAL(linkat, int, const char *, int, const char *, int)(a, from, b, path, flags);
}
int fsync(int file) {
    struct stat status;
    REFUSE(!fstat(file, &status) && S_ISDIR(status.st_mode) && of(file), EINVAL) return REAL(fsync, int)(file);
}
int fchmod(int file, mode_t mode) { REFUSE(of(file), EPERM) return REAL(fchmod, int, mode_t)(file, mode); }
int chmod(const char *path, mode_t mode) {
    REFUSE(below(path), EPERM) return REAL(chmod, const char *, mode_t)(path, mode);
}
int flock(int file, int operation) {
    REFUSE(getenv("DISK_WITHOUT_LOCKS") && of(file), ENOLCK) return REAL(flock, int, int)(file, operation);
}
"#;

/// The clock of the day, as a library that programs are started with: `CLOCK` is a file with the seconds that it is ahead.
const CLOCK: &str = r#"
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
int clock_gettime(clockid_t clock, struct timespec *now) {
    int64_t ahead_s = 0;
    int failed = syscall(SYS_clock_gettime, clock, now);
    if (clock != CLOCK_REALTIME || failed) return failed;
    int file = syscall(SYS_openat, AT_FDCWD, getenv("CLOCK"), O_RDONLY | O_CLOEXEC);
    if (syscall(SYS_read, file, &ahead_s, sizeof ahead_s) == sizeof ahead_s) now->tv_sec += ahead_s;
    syscall(SYS_close, file);
    return 0;
}
"#;

/// A library, compiled into a workshop.
fn library(workshop: &Workshop, text: &str) -> PathBuf {
    let (source, library) = (workshop.path("library.c"), workshop.path("library.so"));
    std::fs::write(&source, text).expect("a writable temporary folder");
    let built = Command::new("cc").args(["-shared", "-fPIC", "-o"]).args([&library, &source]).arg("-ldl").status();
    assert!(built.expect("a C compiler").success());
    library
}

/// It trained with a warning, and then no start began any more.
#[test]
fn a_run_on_a_disk_without_links_is_gone_on_with_and_has_its_best() {
    let workshop = validating();
    let library = library(&workshop, DISK);
    let there = |mut command: Command| {
        command.env("LD_PRELOAD", &library).env("DISK", workshop.path("run"));
        command
    };
    let undisturbed = Undisturbed::of(&workshop, workshop.up("undisturbed", 1, 3, 700));
    std::fs::create_dir(workshop.path("run")).unwrap();
    let child = start(there(workshop.up("run", 1, 3, 700)));
    let run = workshop.run("run");
    wait_until("a validation", || run.folder.best().exists());
    assert!(complete(there(workshop.orchestrator(&["stop", "run"]))).success);
    finish(child);
    assert!(!run.folder.summary().exists(), "the run was stopped in its middle");
    complete(there(workshop.resume("run"))).result();
    run.assert_same(&undisturbed, "without links");
    assert!(run.folder.best().is_file() && !run.folder.best().is_symlink());
    let log = run.log("orchestrator");
    assert!(!log.contains(" WARN ") && !log.contains("ERROR"), "{log}");
    for command in
        [&["eval", "run/best", "--episodes", "1", "--out", "evaluated"][..], &["export", "run/best", "--out", "a.onnx"]]
    {
        complete(there(workshop.orchestrator(command))).good();
    }
    run.assert_nothing_left();
}

#[test]
fn a_disk_without_locks_is_refused_and_what_is_on_it_is_shown() {
    let workshop = Workshop::new();
    let library = library(&workshop, DISK);
    complete(workshop.up("run", 1, 2, 100)).result();
    let there = |arguments: &[&str]| {
        let mut command = workshop.orchestrator(arguments);
        command.env("LD_PRELOAD", &library).env("DISK", workshop.path("")).env("DISK_WITHOUT_LOCKS", "");
        complete(command)
    };
    let new = ["--preset", "demo", "--actors", "1", "--run", "new"];
    same_sentence(
        &there(&[&["doctor"], &new[..]].concat()),
        &there(&[&["up"], &new[..]].concat()),
        "has no file locks",
    );
    assert!(!workshop.path("new").exists());
    for command in [&["status", "run"][..], &["replay", "run", "--check"]] {
        there(command).good();
    }
}

/// Wall time was 0 s, or a day.
#[test]
fn a_clock_that_is_set_while_a_run_goes_on_changes_no_wall_time() {
    let workshop = Workshop::new();
    let (library, clock) = (library(&workshop, CLOCK), workshop.path("clock"));
    let set = |ahead_s: i64| std::fs::write(&clock, ahead_s.to_le_bytes()).unwrap();
    let with = |mut command: Command| {
        command.env("LD_PRELOAD", &library).env("CLOCK", &clock);
        command
    };
    let json = |arguments: &[&str]| -> Value { complete(with(workshop.orchestrator(arguments))).json() };
    let undisturbed = complete(workshop.up("undisturbed", 1, 2, 1000)).result();
    let (run, began) = (workshop.run("run"), Instant::now());
    let child = start(with(workshop.up("run", 1, 2, 1000)));
    run.wait_for_rollouts(1);
    let mut before_s = 0.0;
    let mut is_sound = |all_s: &Value| {
        let all_s = all_s.as_f64().expect("seconds");
        assert!(all_s > before_s && all_s < began.elapsed().as_secs_f64(), "{all_s} s after {before_s} s");
        before_s = all_s;
    };
    for ahead_s in [86_400, -86_400] {
        set(ahead_s);
        run.wait_for_rollouts(run.metrics().len() + 3);
        let status = json(&["status", "run", "--json"]);
        assert_eq!(status["state"], "running");
        is_sound(&status["wall"]["all_starts_s"]);
    }
    signal(child.id(), Signal::KILL);
    finish(child);
    set(30 * 86_400);
    let resumed = complete(with(workshop.resume("run")));
    assert_eq!(resumed.result(), undisturbed);
    let summary = workshop.json("run/summary.json");
    is_sound(&summary["wall"]["all_starts_s"]);
    set(0);
    // The summary was written a moment before the end, which may be less than the millisecond that is noted.
    let status = json(&["status", "run", "--json"]);
    let seconds = |of: &Value| of["wall"]["all_starts_s"].as_f64().expect("seconds");
    assert!((0.0..1.0).contains(&(seconds(&status) - seconds(&summary))), "{status:#} {summary:#}");
    let compared = json(&["compare", "run", "undisturbed", "--json"]);
    let figures = compared["figures"].as_array().expect("figures");
    let wall = figures.iter().find(|row| row["name"] == "wall time").expect("a row");
    assert_eq!(wall["values"][0], status["wall"]["all_starts_s"]);
}

/// `doctor` names a problem and `up` refuses, in the same words. `words`: some of them.
fn same_sentence(doctor: &Printed, up: &Printed, words: &str) {
    let problems: Vec<&str> = doctor.stdout.lines().filter_map(|line| Some(line.split_once("PROBLEM  ")?.1)).collect();
    let [problem] = problems[..] else { panic!("one problem, not {problems:?}: {doctor:#?}") };
    assert!(problem.contains(words) && !doctor.success, "{problem}");
    assert!(!up.success && up.stderr.contains(problem) && !up.stderr.contains("panicked"), "{problem}: {up:#?}");
}

#[test]
fn a_temporary_folder_is_used_or_refused_in_the_words_of_the_doctor() {
    let workshop = Workshop::new();
    let up = |run: &str, folder: &OsStr| {
        let mut command = workshop.up(run, 1, 1, 30);
        command.env("TMPDIR", folder);
        complete(command)
    };
    let doctor = |folder: &OsStr| {
        let mut command = workshop.orchestrator(&["doctor", "--preset", "demo", "--actors", "1"]);
        command.env("TMPDIR", folder);
        complete(command)
    };
    std::fs::write(workshop.path("file"), "").unwrap();
    for (number, used) in ["relative", "zwei Worte", "./a/.."].into_iter().enumerate() {
        std::fs::create_dir_all(workshop.path(used)).unwrap();
        let found = doctor(OsStr::new(used));
        assert!(found.success, "{used}: {found:#?}");
        up(&format!("run-{number}"), OsStr::new(used)).result();
        assert_eq!(std::fs::read_dir(workshop.path("relative")).unwrap().count(), 0, "{used}");
    }
    up("run-empty", OsStr::new("")).result();
    let long = "x".repeat(99);
    for (folder, words) in [
        (workshop.path("Küche").into_os_string(), "has a letter in its name that cannot be used"),
        (OsStr::from_bytes(b"wrong-\xff").to_owned(), "has a letter in its name that cannot be used"),
        (workshop.path("what?").into_os_string(), "has a letter in its name that cannot be used"),
        (workshop.path(&long).into_os_string(), "too long a name"),
        ("file".into(), "file cannot be used: not a directory. Set TMPDIR to a folder that is there"),
        ("gone".into(), "gone cannot be used: No such file or directory (os error 2). Set TMPDIR to a folder"),
        ("/proc".into(), "/proc"),
    ] {
        if ![OsStr::new("file"), OsStr::new("gone"), OsStr::new("/proc")].contains(&folder.as_os_str()) {
            std::fs::create_dir(workshop.path("").join(&folder)).unwrap();
        }
        same_sentence(&doctor(&folder), &up("refused", &folder), words);
        assert!(!workshop.path("refused").exists(), "nothing is left of a run that never began");
    }
}

/// The doctor called it `ok`.
#[test]
fn a_dev_shm_that_cannot_be_written_is_refused_in_the_words_of_the_doctor() {
    let workshop = Workshop::new();
    let contained = |options: &str, inner: &Command| {
        let mut command = workshop.program("unshare");
        command.args(["--user", "--map-root-user", "--mount", "sh", "-c"]);
        command.arg(format!("mount -t tmpfs -o {options} tmpfs /dev/shm && exec \"$0\" \"$@\""));
        command.arg(inner.get_program()).args(inner.get_args());
        complete(command)
    };
    let doctor = contained("ro", &workshop.orchestrator(&["doctor", "--preset", "demo", "--actors", "1"]));
    if doctor.stderr.contains("unshare:") || doctor.stderr.contains("mount:") {
        tell(&format!("skipped: this machine allows no mount namespaces: {}", doctor.stderr));
        return;
    }
    same_sentence(&doctor, &contained("ro", &workshop.up("new", 1, 1, 100)), "/dev/shm cannot be used");
    // Docker's.
    contained("size=4m", &workshop.up("new", 4, 16, 1_000)).refused("/dev/shm is too small");
}

/// `stop` said that it had asked a process, which was another's number, and waited for an hour.
#[test]
fn a_run_in_another_pid_namespace_is_not_asked_and_that_is_said_at_once() {
    let workshop = Workshop::new();
    let up = workshop.up("run", 1, 2, 100_000);
    let mut command = workshop.program("unshare");
    command.args(["--pid", "--fork", "--kill-child", "--mount-proc"]).arg(up.get_program()).args(up.get_args());
    let mut child = start(command);
    let run = workshop.run("run");
    wait_until("it trains, or cannot be started", || run.metrics().len() > 1 || child.try_wait().unwrap().is_some());
    if child.try_wait().unwrap().is_some() {
        tell(&format!("skipped: this machine allows no PID namespaces: {}", finish(child).stderr));
        return;
    }
    let began = Instant::now();
    let stop = workshop.call(&["stop", "run"]);
    assert!(began.elapsed() < Duration::from_secs(20) && !stop.success, "{stop:#?}");
    for words in ["nobody was asked: ", "in another container or PID namespace", "docker exec"] {
        assert!(stop.stderr.contains(words) && !stop.stderr.contains("asked pid"), "{words}: {stop:#?}");
    }
    let status = workshop.call(&["status", "run"]);
    assert!(status.stdout.contains(" running (pid 1 on ") && status.stdout.contains("PID namespace)"), "{status:#?}");
    assert!(complete(workshop.resume("run")).stderr.contains("is already in use"));
    let orchestrator = *run.processes("up --preset").last().expect("it runs");
    signal(orchestrator, rustix::process::Signal::TERM);
    finish(child);
    assert!(workshop.call(&["stop", "run"]).stderr.contains("does not run"));
    run.assert_nothing_left();
}

/// All but one were refused.
#[test]
fn runs_that_begin_in_the_same_second_have_folders_of_their_own() {
    let workshop = Workshop::new();
    let up =
        ["up", "--preset", "demo", "--config", "tiny.toml", "--actors", "1", "--envs-per-actor", "1", "--frames", "30"];
    let children: Vec<_> = (0..3).map(|_| start(workshop.orchestrator(&up))).collect();
    for child in children {
        finish(child).result();
    }
    assert_eq!(std::fs::read_dir(workshop.path("runs")).unwrap().count(), 3);
}

/// A folder with the orchestrator and another program as this script, in which REAL is that program's path.
fn beside(workshop: &Workshop, other: &str, script: &str) -> PathBuf {
    let folder = workshop.path(&format!("with-{other}"));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir(&folder).expect("a writable temporary folder");
    for name in ["orchestrator", "actor", "learner"] {
        if name != other {
            std::fs::hard_link(binary(name), folder.join(name))
                .or_else(|_| std::fs::copy(binary(name), folder.join(name)).map(drop))
                .expect("a copy of a program");
        }
    }
    let text = format!("#!/bin/sh\n{}\n", script.replace("REAL", &binary(other).display().to_string()));
    workshop.script(&format!("with-{other}/{other}"), &text);
    folder.join("orchestrator")
}

fn run_of(workshop: &Workshop, orchestrator: &Path, arguments: &[&str]) -> Printed {
    let mut command = workshop.program(orchestrator);
    command.args(arguments);
    complete(command)
}

/// It was said that libtorch does not work.
#[test]
fn a_learner_that_is_killed_while_it_checks_is_asked_once_more() {
    let workshop = Workshop::new();
    let once = "if mkdir killed 2>/dev/null; then kill -9 $$; fi; exec REAL \"$@\"";
    let printed =
        run_of(&workshop, &beside(&workshop, "learner", once), &["doctor", "--preset", "demo", "--actors", "1"]);
    let warned = "`learner check` was killed by signal 9 (SIGKILL), and is asked once more";
    assert!(printed.success && printed.stderr.contains(warned), "{printed:#?}");
    let orchestrator = beside(&workshop, "learner", "kill -9 $$");
    let printed = run_of(&workshop, &orchestrator, &["eval", "--preset", "demo", "--episodes", "1"]);
    let said = "`learner check` was killed by signal 9 (SIGKILL) when it was asked once more";
    assert!(
        !printed.success && printed.stderr.contains(said) && !printed.stderr.contains("does not work"),
        "{printed:#?}"
    );
}

#[test]
fn an_actor_that_is_killed_while_it_works_for_a_command_is_named_with_the_signal() {
    let workshop = Workshop::new();
    complete(workshop.up("run", 1, 2, 100)).result();
    let orchestrator = beside(&workshop, "actor", "kill -9 $$");
    for (command, name) in [
        (&["kitchens", "--kitchens", "1"][..], "kitchens"),
        (&["replay", "--check", "run"], "replay"),
        (&["export", "run", "--format", "npz", "--out", "arrays"], "dataset"),
    ] {
        let said = format!("`actor {name}` was killed by signal 9 (SIGKILL)");
        run_of(&workshop, &orchestrator, command).refused(&said);
    }
}
