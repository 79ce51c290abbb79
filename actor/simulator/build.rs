//! Lists the tasks that are built in: every folder of `src/tasks/` is a module, whose `open` makes an environment.

use std::fmt::Write as _;
use std::path::Path;

fn main() {
    println!("cargo:rerun-if-changed=src/tasks");
    let root = Path::new(&std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets it")).join("src/tasks");
    let mut folders: Vec<_> = std::fs::read_dir(&root)
        .expect("the tasks' folder is part of the sources")
        .map(|entry| entry.expect("it can be listed").path())
        .filter(|path| path.join("task.toml").is_file())
        .collect();
    folders.sort();
    let (mut modules, mut table) = (String::new(), String::new());
    for folder in &folders {
        let name = folder.file_name().and_then(|name| name.to_str()).expect("a folder is named as its task");
        let file = folder.join("mod.rs");
        let path = file.to_str().expect("the sources lie under a UTF-8 path");
        writeln!(modules, "#[path = {path:?}]\npub mod {name};").expect("a string takes any text");
        write!(table, "({name:?}, {name}::open as Open),").expect("a string takes any text");
    }
    let text = format!("{modules}static TASKS: [(&str, Open); {}] = [{table}];\n", folders.len());
    let out = std::env::var("OUT_DIR").expect("cargo sets it");
    std::fs::write(Path::new(&out).join("tasks.rs"), text).expect("the output folder can be written");
}
