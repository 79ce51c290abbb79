//! Every way carries every byte, and leaves nothing behind.

use std::process::Command;

fn cell(way: &str, frames: u32, more: &[&str]) {
    let frames = format!("--frames={frames}");
    let mut command = Command::new(env!("CARGO_BIN_EXE_bench-wire"));
    command.args(["cell", "--way", way, "--actors=3", &frames, "--seconds=0.1"]).args(more);
    let child = command.stdout(std::process::Stdio::piped()).spawn().unwrap();
    let id = child.id();
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{way}: {}", output.status);
    let figures: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for figure in ["frames_per_s", "p50_us", "p99_us", "cpu_us"] {
        assert!(figures[figure].as_f64().unwrap() > 0.0, "{way}: {figures}");
    }
    assert!(figures["p50_us"].as_f64() <= figures["p99_us"].as_f64(), "{way}: {figures}");
    let left = |folder: &str| {
        let names = std::fs::read_dir(folder).unwrap().flatten().map(|entry| entry.file_name().into_string().unwrap());
        names.filter(|name| name.contains(&format!("bench{id}_")) || name.ends_with(&format!("bench-{id}"))).count()
    };
    assert_eq!(left("/dev/shm") + left(std::env::temp_dir().to_str().unwrap()), 0, "{way}");
}

#[test]
fn every_way_carries_one_frame_and_halves_of_several() {
    for way in ["wire", "shm", "unix", "zeromq", "grpc"] {
        cell(way, 1, &[]);
        cell(way, 2, &[]);
    }
}

#[test]
fn a_recorder_reads_along() {
    cell("wire", 2, &["--recorded"]);
}
