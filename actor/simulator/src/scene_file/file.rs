use super::problem::{ENTRIES_MOST, PROBLEMS_MOST, Problem};
use crate::gltf_file::solid::Convex;
use crate::gltf_file::uri;
use proto::bounded;
use proto::likeness::nearest;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use unicode_normalization::UnicodeNormalization;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// The glTF file, relative to this one.
    pub gltf: String,
    /// What its nodes are. A node takes the first entry that fits its name.
    #[serde(rename = "node")]
    pub nodes: Vec<NodeEntry>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeEntry {
    /// Name of the node; `*` stands for any characters, `?` for one.
    pub name: String,
    pub role: Role,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<f32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub friction: Option<f32>,
    /// Category; the node's name without its number if this is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub category: Option<String>,
    /// What to do with a mesh that is not convex.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub convex: Option<Convex>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The floor: fixed, its horizontal extent is where the robot drives, its top becomes height 0.
    Floor,
    Fixed,
    /// Never moves, and its level tops are where targets can stand.
    Surface,
    Movable,
    Ignore,
}

/// What the parser found wrong, with what was probably meant.
fn in_words(message: &str) -> String {
    const ENTRIES: &str = "; an entry begins with [[node]], in two brackets on either side";
    // serde: unknown field `a`, expected one of `b`, `c`
    let mut quoted = message.split('`').skip(1).step_by(2);
    let meant = match quoted.next().filter(|_| message.starts_with("unknown ")) {
        Some(word) => nearest(word, quoted).map_or_else(String::new, |meant| format!(" (did you mean `{meant}`?)")),
        None if message == "duplicate key" || message.contains("expected a sequence") => ENTRIES.to_owned(),
        None if message == "missing field `node`" => format!(": say what the nodes of the glTF file are{ENTRIES}"),
        None if message == "missing field `gltf`" => ": name the glTF file, gltf = \"scene.glb\"".to_owned(),
        None if message == "missing field `role`" => format!(": this entry needs one of {ROLES}"),
        None if message == "missing field `name`" => ": this entry needs the name of a node, or a pattern".to_owned(),
        None => String::new(),
    };
    format!("{}{meant}", message.replace("expected f32", "expected a number"))
}

/// Every [`Role`], as it is written.
const ROLES: &str = "`floor`, `fixed`, `surface`, `movable`, `ignore`";

/// Parses a scene's text. After an error what it is about is left out, and the rest is parsed: all errors are found.
fn parse(text: &str) -> Result<SceneFile, Vec<Problem>> {
    let mut lines: Vec<&str> = text.split('\n').collect();
    let mut problems: Vec<Problem> = Vec::new();
    loop {
        let text = lines.join("\n");
        let error: toml::de::Error = match toml::from_str(&text) {
            Ok(file) if problems.is_empty() => return Ok(file),
            Ok(_) => return Err(problems),
            Err(error) => error,
        };
        let line = error.span().map_or(0, |span| text[..span.start].matches('\n').count());
        // Without what was left out there may be no entry at all.
        if problems.is_empty() || !error.message().starts_with("missing field `node`") {
            let problem = Problem::Toml { line: line + 1, problem: in_words(error.message()) };
            // What is missing is missing again when the line of the error is left out.
            if problems.iter().all(|other| other.to_string() != problem.to_string()) {
                problems.push(problem);
            }
        }
        let is_head = |line: &&str| line.trim_start().starts_with('[');
        let entry = lines[..=line].iter().rposition(is_head);
        let left_out = match entry.filter(|_| !error.message().starts_with("unknown field")) {
            Some(head) => head..lines[head + 1..].iter().position(is_head).map_or(lines.len(), |end| head + 1 + end),
            None => line..line + 1,
        };
        // One [node] in single brackets makes a duplicate of each that follows.
        let ends = problems.len() >= PROBLEMS_MOST || error.message() == "duplicate key";
        if ends || lines[left_out.clone()].iter().all(|line| line.is_empty()) {
            return Err(problems);
        }
        lines[left_out].fill("");
    }
}

impl SceneFile {
    /// The error holds everything that is wrong with the text.
    pub fn open(path: &Path) -> Result<Self, Vec<Problem>> {
        if path.extension().is_some_and(|kind| kind == "glb" || kind == "gltf") {
            return Err(vec![Problem::Geometry]);
        }
        if path.is_dir() {
            return Err(vec![Problem::Folder]);
        }
        if !path.exists() {
            return Err(vec![Problem::Missing]);
        }
        let text = bounded::read_text(path).map_err(|cause| vec![Problem::Unreadable { cause: cause.to_string() }])?;
        let mut file = parse(&text)?;
        // As the names of the nodes are.
        for entry in &mut file.nodes {
            entry.name = entry.name.nfc().collect();
        }
        let entries = file.nodes.len();
        if entries > ENTRIES_MOST { Err(vec![Problem::TooManyEntries { entries }]) } else { Ok(file) }
    }

    /// The glTF file, relative to this one's folder and inside it: a scene's files travel together.
    pub(crate) fn gltf_path(&self) -> Result<PathBuf, Problem> {
        uri::plain(Path::new(&self.gltf)).ok_or_else(|| Problem::Elsewhere { gltf: self.gltf.clone() })
    }
}
