use super::problem::{ENTRIES_MOST, Problem};
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

impl SceneFile {
    pub fn open(path: &Path) -> Result<Self, Problem> {
        if path.extension().is_some_and(|kind| kind == "glb" || kind == "gltf") {
            return Err(Problem::Geometry);
        }
        let text = bounded::read_text(path).map_err(|cause| Problem::Unreadable { cause: cause.to_string() })?;
        let mut file: Self = toml::from_str(&text).map_err(|error: toml::de::Error| Problem::Toml {
            line: error.span().map_or(0, |span| text[..span.start].matches('\n').count() + 1),
            problem: in_words(error.message()),
        })?;
        // As the names of the nodes are.
        for entry in &mut file.nodes {
            entry.name = entry.name.nfc().collect();
        }
        let entries = file.nodes.len();
        if entries > ENTRIES_MOST { Err(Problem::TooManyEntries { entries }) } else { Ok(file) }
    }

    /// The glTF file, relative to this one's folder and inside it: a scene's files travel together.
    pub(crate) fn gltf_path(&self) -> Result<PathBuf, Problem> {
        uri::plain(Path::new(&self.gltf)).ok_or_else(|| Problem::Elsewhere { gltf: self.gltf.clone() })
    }
}
