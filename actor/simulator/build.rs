//! Lists the tasks that are built in: every folder of `src/tasks/` is a module, whose `open` makes an environment. Of each
//! `task.toml` it makes the records in which that environment reports a step.

use std::fmt::Write as _;
use std::path::Path;

const NEVER: &str = "a string takes any text";

fn main() {
    println!("cargo:rerun-if-changed=src/tasks");
    let root = Path::new(&std::env::var("CARGO_MANIFEST_DIR").expect("cargo sets it")).join("src/tasks");
    let out = std::env::var("OUT_DIR").expect("cargo sets it");
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
        writeln!(modules, "#[path = {path:?}]\npub mod {name};").expect(NEVER);
        write!(table, "({name:?}, {name}::open as Open),").expect(NEVER);
        let declared = std::fs::read_to_string(folder.join("task.toml")).expect("it is a file");
        let records = records(&declared).unwrap_or_else(|problem| panic!("task `{name}`: task.toml: {problem}"));
        std::fs::write(Path::new(&out).join(format!("{name}.rs")), records).expect("the output folder can be written");
    }
    let text = format!("{modules}static TASKS: [(&str, Open); {}] = [{table}];\n", folders.len());
    std::fs::write(Path::new(&out).join("tasks.rs"), text).expect("the output folder can be written");
}

/// `Transition` and `Current`, with a field for each channel but images. They lie as a task's layout has it: in the order
/// of the declaration, each aligned to its type.
fn records(declared: &str) -> Result<String, String> {
    let task: toml::Table = declared.parse().map_err(|cause: toml::de::Error| cause.to_string())?;
    let channels = task.get("channels").and_then(toml::Value::as_array).ok_or("it declares no [[channels]]")?;
    let (mut done, mut seen) = (Record::default(), Record::default());
    for channel in channels {
        let text = |key: &str| {
            let value = channel.get(key).and_then(toml::Value::as_str);
            value.ok_or_else(|| format!("a channel lacks the text `{key}`: {channel}"))
        };
        let (name, dtype, doc) = (text("name")?, text("dtype")?, text("doc")?);
        let shape = channel.get("shape").and_then(toml::Value::as_array).map_or(&[][..], Vec::as_slice);
        let count: i64 = shape.iter().filter_map(toml::Value::as_integer).product();
        if matches!(dtype, "u8" | "u16") && shape.len() >= 2 {
            continue;
        }
        let of_type = if shape.is_empty() { dtype.to_owned() } else { format!("[{dtype}; {count}]") };
        let record = if matches!(text("role")?, "part" | "outcome") { &mut done } else { &mut seen };
        writeln!(record.fields, "#[doc = {doc:?}]\npub {name}: {of_type},").expect(NEVER);
        writeln!(record.writes, "put(block, std::mem::offset_of!(Self, {name}), bytemuck::bytes_of(&self.{name}));")
            .expect(NEVER);
    }
    let helper = "fn put(block: &mut [u8], offset: usize, bytes: &[u8]) {\nblock[offset..][..bytes.len()]\
                  .copy_from_slice(bytes);\n}\n";
    let transition = "What the last action did: the channels of parts and outcomes. It belongs to the episode in which the \
                      action was taken, also if that has just ended. The default is all zero: no action was taken.";
    let current = "What is seen now: the channels of observations and states, but for images.";
    Ok([helper.to_owned(), done.text("Transition", transition), seen.text("Current", current)].concat())
}

#[derive(Default)]
struct Record {
    fields: String,
    writes: String,
}

impl Record {
    fn text(&self, name: &str, doc: &str) -> String {
        let Self { fields, writes } = self;
        format!(
            "#[doc = {doc:?}]\n#[derive(Debug, Clone, Copy, PartialEq, bytemuck::Zeroable)]\n#[repr(C)]\n\
             pub struct {name} {{\n{fields}}}\n\
             impl {name} {{\n/// Writes it into its block of a record.\n///\n/// # Panics\n/// If that is shorter.\n\
             pub fn write(&self, block: &mut [u8]) {{\n{writes}}}\n}}\n\
             impl Default for {name} {{\nfn default() -> Self {{\nbytemuck::Zeroable::zeroed()\n}}\n}}\n"
        )
    }
}
