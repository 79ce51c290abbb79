//! Lists the tasks that are built in: every `task.toml` in a folder of `actor/simulator/src/tasks/`.

use std::fmt::Write as _;
use std::path::Path;

fn main() {
    const TASKS: &str = "../actor/simulator/src/tasks";
    println!("cargo:rerun-if-changed={TASKS}");
    let root = Path::new(&std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets it")).join(TASKS);
    let mut tasks: Vec<_> = std::fs::read_dir(&root)
        .expect("the tasks' folder is part of the sources")
        .map(|entry| entry.expect("it can be listed").path().join("task.toml"))
        .filter(|path| path.is_file())
        .collect();
    tasks.sort();
    let mut list = String::from("&[");
    for path in tasks {
        let path = path.to_str().expect("the sources lie under a UTF-8 path");
        write!(list, "include_str!({path:?}),").expect("a string takes any text");
    }
    list.push(']');
    let out = std::env::var("OUT_DIR").expect("cargo sets it");
    std::fs::write(Path::new(&out).join("tasks.rs"), list).expect("the output folder can be written");
}
