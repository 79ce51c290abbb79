//! A glTF file's nodes as triangles in our axes: `.glb`, or `.gltf` with buffers beside it or inside it.
//!
//! Nothing that moves geometry or hides it is passed over: it is read, or the node that has it is refused. Nodes that
//! a scene ignores are not read, so that nothing in them is wrong. Animations are not played.

use super::accessor::Data;
use super::affine::Affine;
use super::json::{self, Buffer, FILE_BYTES_MOST, Root};
use super::piece::{self, FARTHEST_M, Piece, TOO_FAR, VERTICES_MOST};
use super::{extensions, uri};
use proto::bounded;
use rapier3d::math::Pose3;
use std::path::{Path, PathBuf};
use unicode_normalization::UnicodeNormalization;

const NODES_MOST: usize = 20_000;

#[derive(Debug)]
pub struct Document {
    /// Its nodes, parents before children.
    pub nodes: Vec<Node>,
    /// Files it was read from, relative to its folder: the file itself first, then its buffers.
    pub files: Vec<PathBuf>,
    data: Data,
    /// Vertices and corners that may still be read.
    left: usize,
}

#[derive(Debug)]
pub struct Node {
    /// Its name in Unicode's composed form, or `node-N` by its index in the file.
    pub name: String,
    /// Its parent among the document's nodes.
    pub parent: Option<usize>,
    /// Its pose without scale, our axes.
    pub pose: Pose3,
    /// What comes before the pose: scale, mirroring, shear.
    scale: Affine,
    index: usize,
    is_hidden: bool,
    /// Why its mesh cannot be where the node says.
    flaw: Option<&'static str>,
}

#[derive(Debug, thiserror::Error)]
pub enum DocumentError {
    #[error("{file}: cannot be read: {cause}", file = .file.display())]
    Unreadable { file: PathBuf, cause: std::io::Error },
    #[error("{file}: is not sound glTF 2.0: {problem}", file = .file.display())]
    Unsound { file: PathBuf, problem: String },
    #[error(
        "{file}: needs the extension {extension}, which is not read here; export it again without it, as plain glTF 2.0 \
         without compression",
        file = .file.display()
    )]
    Extension { file: PathBuf, extension: String },
    #[error("{file}: its buffer {uri} is missing: {problem}; put it beside the file, or export as .glb", file = .file.display())]
    Buffer { file: PathBuf, uri: String, problem: String },
}

impl Document {
    pub fn open(path: &Path) -> Result<Self, DocumentError> {
        let file = || path.to_path_buf();
        let bytes =
            bounded::read(path, FILE_BYTES_MOST).map_err(|cause| DocumentError::Unreadable { file: file(), cause })?;
        let unsound = |problem| DocumentError::Unsound { file: file(), problem };
        let (root, mut binary) = json::parse(&bytes).map_err(unsound)?;
        drop(bytes);
        if let Some(extension) = extensions::required(&root) {
            return Err(DocumentError::Extension { file: file(), extension: extension.to_owned() });
        }
        let nodes = nodes_of(&root).map_err(unsound)?;
        let mut files: Vec<PathBuf> = path.file_name().map(PathBuf::from).into_iter().collect();
        let (mut buffers, mut left) = (Vec::new(), FILE_BYTES_MOST);
        for buffer in &root.buffers {
            let data = read_buffer(buffer, path, &mut binary, left, &mut files).map_err(|problem| {
                // One that is embedded is long.
                let uri = buffer.uri.as_deref().unwrap_or("(binary chunk)").chars().take(100).collect();
                DocumentError::Buffer { file: file(), uri, problem }
            })?;
            left = left.saturating_sub(data.len() as u64);
            buffers.push(data);
        }
        warn_of_what_is_not_read(&root, path);
        Ok(Self { nodes, files, data: Data { root, buffers }, left: VERTICES_MOST })
    }

    /// Whether there is anything to touch or to see at a node itself.
    pub fn has_surface(&self, node: usize) -> bool {
        let node = &self.nodes[node];
        let mesh = self.data.root.nodes[node.index].mesh.filter(|_| !node.is_hidden);
        mesh.is_some_and(|mesh| self.data.root.meshes[mesh].primitives.iter().any(piece::has_surface))
    }

    /// The primitives of a node's mesh, scale included.
    pub fn pieces(&mut self, node: usize) -> Result<Vec<Piece>, &'static str> {
        let node = &self.nodes[node];
        node.flaw.map_or(Ok(()), Err)?;
        let json = &self.data.root.nodes[node.index];
        let Some(mesh) = json.mesh.map(|mesh| &self.data.root.meshes[mesh]) else { return Ok(Vec::new()) };
        let weights = json.weights.as_ref().unwrap_or(&mesh.weights);
        let primitives = mesh.primitives.iter().filter(|primitive| piece::has_surface(primitive));
        primitives.map(|primitive| piece::read(primitive, weights, &node.scale, &self.data, &mut self.left)).collect()
    }
}

/// A buffer's bytes, wherever they are, `left` at most. A file that they are read from is added to `files`.
fn read_buffer(
    buffer: &Buffer,
    gltf: &Path,
    binary: &mut Option<Vec<u8>>,
    left: u64,
    files: &mut Vec<PathBuf>,
) -> Result<Vec<u8>, String> {
    let bytes = match (&buffer.uri, buffer.uri.as_deref().and_then(uri::data)) {
        (None, _) => binary.take().ok_or("the file has no binary chunk")?,
        (Some(_), Some(embedded)) => embedded?,
        (Some(uri), None) => {
            let folder = gltf.parent().unwrap_or(Path::new(""));
            let relative = uri::find(folder, &uri::path(uri)?);
            let bytes = uri::read(folder, &relative, left)?;
            files.push(relative);
            bytes
        }
    };
    if bytes.len() < buffer.byte_length {
        return Err(format!("it has {} bytes of {}", bytes.len(), buffer.byte_length));
    }
    Ok(bytes)
}

/// The nodes of the default scene, parents before children.
fn nodes_of(root: &Root) -> Result<Vec<Node>, String> {
    let scene = root.scenes.get(root.scene.unwrap_or(0)).ok_or("it has no scene, or not the one that it names")?;
    let count = root.nodes.len();
    if count > NODES_MOST {
        return Err(format!("it has {count} nodes, more than {NODES_MOST}: join what is one thing"));
    }
    let name_of = |index: usize| {
        let name = root.nodes[index].name.as_ref();
        name.map_or_else(|| format!("node-{index}"), |name| name.nfc().collect())
    };
    // In a tree each node is met once. In a circle, or where two nodes share a child, one is met again.
    let mut met = vec![false; count];
    let mut meet = |index: usize| match met.get_mut(index).map(|met| std::mem::replace(met, true)) {
        None => Err(format!("it names node {index}, and there are {count}")),
        Some(false) => Ok(index),
        Some(true) => Err(format!("node {} has two parents, or is below itself", name_of(index))),
    };
    let mut nodes: Vec<Node> = Vec::new();
    // The next one is the last in the list. Not by recursion: a file may nest as deeply as it likes.
    let mut waiting = Vec::new();
    for &node in scene.nodes.iter().rev() {
        waiting.push((meet(node)?, None, Affine::identity(), false));
    }
    while let Some((index, parent, above, is_hidden)) = waiting.pop() {
        let (json, name) = (&root.nodes[index], name_of(index));
        if json.mesh.is_some_and(|mesh| mesh >= root.meshes.len()) {
            return Err(format!("node {name} has a mesh that is not there"));
        }
        let world = above.after(&Affine::of(json));
        let is_hidden = is_hidden || extensions::hides(json);
        for &child in json.children.iter().rev() {
            waiting.push((meet(child)?, Some(nodes.len()), world, is_hidden));
        }
        let split = world.split();
        let flaw = if is_hidden {
            Some("is hidden (KHR_node_visibility): show it, or give it the role `ignore`")
        } else if !world.translation.iter().all(|v| v.abs() <= FARTHEST_M) {
            Some(TOO_FAR)
        } else if split.is_none() {
            Some("has no extent: its scale is zero, or not a number")
        } else if json.mesh.is_none() {
            None
        } else if json.skin.is_some() {
            Some(
                "is bent by a skin, which is not read: apply it (in Blender, the Armature modifier) and export it again",
            )
        } else if json.extensions.contains_key(extensions::INSTANCING) {
            Some(
                "stands in several places by EXT_mesh_gpu_instancing, which is not read: give each place a node of its own",
            )
        } else {
            None
        };
        let (pose, scale) = split.unwrap_or((Pose3::identity(), Affine::identity()));
        nodes.push(Node { name, parent, pose, scale, index, is_hidden, flaw });
    }
    Ok(nodes)
}

fn warn_of_what_is_not_read(root: &Root, path: &Path) {
    let unknown: Vec<&str> = extensions::unknown(root).take(5).collect();
    let path = path.display();
    if !unknown.is_empty() {
        tracing::warn!("{path}: things stand as they do without {}, which is not read here", unknown.join(", "));
    }
    if !root.animations.is_empty() {
        tracing::warn!("{path}: its animations are not played: things stand where their nodes say");
    }
}
