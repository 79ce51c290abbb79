//! What is read of a glTF file's JSON.
//!
//! Materials, textures, cameras and lights are passed over, whatever stands in them: neither physics nor a depth camera
//! has a use for them.

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;
use serde_json::value::RawValue;
use std::collections::BTreeMap;

/// The file and all of its buffers, bytes.
pub const FILE_BYTES_MOST: u64 = 512 << 20;
/// The part that is JSON, bytes; buffers may be embedded in it.
const JSON_BYTES_MOST: usize = 128 << 20;
/// Objects in the JSON: each becomes a struct of some hundred bytes.
const OBJECTS_MOST: usize = 500_000;

/// The whole of it. Numbers of nodes, meshes, accessors, views and buffers are places in these lists, and not checked.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Root {
    pub asset: Asset,
    pub extensions_used: Vec<String>,
    pub extensions_required: Vec<String>,
    pub scene: Option<usize>,
    pub scenes: Vec<Scene>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<Mesh>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<BufferView>,
    pub buffers: Vec<Buffer>,
    /// Whether there are any is all that matters.
    pub animations: Vec<IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
pub struct Asset {
    pub version: String,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Scene {
    pub nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Node {
    pub name: Option<String>,
    pub children: Vec<usize>,
    pub mesh: Option<usize>,
    pub skin: Option<IgnoredAny>,
    /// Column after column.
    pub matrix: Option<[f32; 16]>,
    pub translation: Option<[f32; 3]>,
    /// A quaternion: x, y, z, w.
    pub rotation: Option<[f32; 4]>,
    pub scale: Option<[f32; 3]>,
    /// Of morph targets, in place of the mesh's.
    pub weights: Option<Vec<f32>>,
    pub extensions: BTreeMap<String, Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Mesh {
    pub primitives: Vec<Primitive>,
    /// Of morph targets.
    pub weights: Vec<f32>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub struct Primitive {
    /// Accessors of vertices by what they hold.
    pub attributes: BTreeMap<String, usize>,
    pub indices: Option<usize>,
    /// How indices make triangles; plain ones if it is left out.
    pub mode: Option<u32>,
    /// Morph targets: accessors of what a weight of 1 adds to the vertices.
    pub targets: Vec<BTreeMap<String, usize>>,
    pub extras: Option<Box<RawValue>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub struct Accessor {
    pub buffer_view: Option<usize>,
    pub byte_offset: usize,
    pub component_type: u32,
    pub normalized: bool,
    pub count: usize,
    #[serde(rename = "type")]
    pub shape: String,
    pub sparse: Option<Sparse>,
}

/// Values that differ from those of the view.
#[derive(Debug, Deserialize)]
pub struct Sparse {
    pub count: usize,
    pub indices: SparsePart,
    pub values: SparsePart,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct SparsePart {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: usize,
    /// Of indices.
    #[serde(default)]
    pub component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct BufferView {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: usize,
    pub byte_length: usize,
    pub byte_stride: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub struct Buffer {
    pub byte_length: usize,
    /// Where its bytes are; those of the binary chunk if it is left out.
    pub uri: Option<String>,
}

pub fn parse(bytes: &[u8]) -> Result<(Root, Option<Vec<u8>>), String> {
    let (json, binary) = if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
    let json = json.strip_prefix("\u{feff}".as_bytes()).unwrap_or(json);
    if json.len() > JSON_BYTES_MOST {
        return Err(format!("its JSON has {} bytes, more than {JSON_BYTES_MOST}: export it as .glb", json.len()));
    }
    let objects: usize = json.iter().map(|&byte| usize::from(byte == b'{')).sum();
    if objects > OBJECTS_MOST {
        return Err(format!("its JSON has {objects} objects, more than {OBJECTS_MOST}: simplify the scene"));
    }
    let root: Root = serde_json::from_slice(json).map_err(|error| error.to_string())?;
    if !root.asset.version.starts_with("2.") {
        return Err(format!("its version is `{}`", root.asset.version));
    }
    Ok((root, binary.map(<[u8]>::to_vec)))
}

/// The JSON and the binary chunk of a `.glb` file. Chunks of other kinds are passed over.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let word = |bytes: &[u8], at: usize| {
        let word = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes([word[0], word[1], word[2], word[3]]) as usize)
    };
    let (version, length) = word(bytes, 4).zip(word(bytes, 8)).ok_or("it is shorter than a header")?;
    if version != 2 {
        return Err(format!("its container has version {version}"));
    }
    if length > bytes.len() {
        return Err(format!("it is cut short: it has {} bytes of {length}", bytes.len()));
    }
    let (mut json, mut binary) = (None, None);
    let mut rest = &bytes[12..];
    while let (Some(length), Some(kind)) = (word(rest, 0), rest.get(4..8)) {
        let (chunk, others) =
            rest[8..].split_at_checked(length).ok_or("it is cut short: a chunk goes beyond its end")?;
        match kind {
            b"JSON" => json = json.or(Some(chunk)),
            b"BIN\0" => binary = binary.or(Some(chunk)),
            _ => {}
        }
        rest = others;
    }
    Ok((json.ok_or("it has no JSON")?, binary))
}
