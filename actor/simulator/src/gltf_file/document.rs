//! A glTF file's nodes as triangles in our axes: `.glb`, or `.gltf` with buffers beside it or inside it.
//!
//! Textures, cameras, lights, skins and animations are passed over: neither physics nor a depth camera has a use for
//! them.

use super::mirror;
use super::sound::{self, FILE_BYTES_MOST, NODES_MOST, VERTICES_MOST};
use base64::Engine;
use gltf::buffer::Source;
use gltf::mesh::Mode;
use proto::bounded;
use rapier3d::math::{Pose3, Rot3, Vec3};
use std::path::{Component, Path, PathBuf};

/// The default scene of a file.
#[derive(Debug)]
pub struct Document {
    /// Its nodes, parents before children.
    pub nodes: Vec<Node>,
    /// Files it was read from, relative to its folder: the file itself first, then its buffers.
    pub files: Vec<PathBuf>,
}

/// One node.
#[derive(Debug)]
pub struct Node {
    /// Its name, or `node-N` by its index in the file.
    pub name: String,
    /// Its parent among the document's nodes.
    pub parent: Option<usize>,
    /// Its pose without scale, our axes.
    pub pose: Pose3,
    /// The primitives of its mesh, scale included.
    pub pieces: Vec<Piece>,
}

/// One primitive of a mesh, in its node's frame and our axes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Piece {
    /// Vertices, metres; the same place may occur more than once.
    pub vertices: Vec<Vec3>,
    /// Corners of its triangles. Which way round says nothing: a mirroring scale turns it over.
    pub triangles: Vec<[u32; 3]>,
    /// What its `extras` say, as JSON.
    pub extras: Option<String>,
}

/// Why a glTF file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DocumentError {
    /// It cannot be read.
    #[error("{file}: cannot be read: {cause}", file = .file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// It is not glTF 2.0.
    #[error("{file}: is not sound glTF 2.0: {problem}", file = .file.display())]
    Unsound {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// It cannot be understood without an extension that is not known here.
    #[error(
        "{file}: needs the extension {extension}, which is not read here; export it again without compression or \
         quantisation",
        file = .file.display()
    )]
    Extension {
        /// The file.
        file: PathBuf,
        /// The extension.
        extension: String,
    },
    /// A buffer is not where the file says.
    #[error("{file}: its buffer {uri} is missing: {problem}; put it beside the file, or export as .glb", file = .file.display())]
    Buffer {
        /// The file.
        file: PathBuf,
        /// The buffer.
        uri: String,
        /// What is wrong.
        problem: String,
    },
    /// A mesh's data cannot be read.
    #[error("{file}: node {node}: {problem}", file = .file.display())]
    Mesh {
        /// The file.
        file: PathBuf,
        /// The node.
        node: String,
        /// What is wrong.
        problem: &'static str,
    },
}

/// An affine map: columns of the linear part, then the translation. Double precision: nodes may be nested deeply.
#[derive(Debug, Clone, Copy)]
struct Affine {
    linear: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl Document {
    /// Reads a file.
    pub fn open(path: &Path) -> Result<Self, DocumentError> {
        let file = || path.to_path_buf();
        let bytes =
            bounded::read(path, FILE_BYTES_MOST).map_err(|cause| DocumentError::Unreadable { file: file(), cause })?;
        let unsound = |problem| DocumentError::Unsound { file: file(), problem };
        let (parsed, mut blob) = sound::parse(&bytes).map_err(unsound)?;
        drop(bytes);
        if let Some(extension) = parsed.extensions_required().next() {
            return Err(DocumentError::Extension { file: file(), extension: extension.to_owned() });
        }
        let mut reader = Reader { path, files: Vec::new(), buffers: Vec::new(), nodes: Vec::new(), vertices: 0 };
        reader.files.extend(path.file_name().map(PathBuf::from));
        for buffer in parsed.buffers() {
            let data = reader.buffer(&buffer, &mut blob)?;
            reader.buffers.push(data);
        }
        let scene = parsed.default_scene().or_else(|| parsed.scenes().next());
        let scene = scene.ok_or_else(|| unsound("it has no scene".into()))?;
        reader.tree(scene.nodes(), parsed.nodes().len())?;
        Ok(Self { nodes: reader.nodes, files: reader.files })
    }
}

/// What is farther from the scene's origin, or from its node's, was not made in metres.
const FARTHEST_M: f64 = 1000.0;
const TOO_FAR: &str = "lies or reaches more than 1 km away: glTF counts in metres; scale the scene or move it to its \
                       origin";

/// A node's name, or its number.
fn name_of(node: &gltf::Node<'_>) -> String {
    node.name().map_or_else(|| format!("node-{}", node.index()), str::to_owned)
}

struct Reader<'a> {
    path: &'a Path,
    files: Vec<PathBuf>,
    buffers: Vec<Vec<u8>>,
    nodes: Vec<Node>,
    /// Vertices and corners of all nodes so far.
    vertices: usize,
}

impl Reader<'_> {
    /// A buffer's bytes, wherever they are.
    fn buffer(&mut self, buffer: &gltf::Buffer<'_>, blob: &mut Option<Vec<u8>>) -> Result<Vec<u8>, DocumentError> {
        let (uri, data) = match buffer.source() {
            Source::Bin => ("(binary chunk)".to_owned(), blob.take().ok_or("the file has no binary chunk".to_owned())),
            Source::Uri(uri) => match uri.strip_prefix("data:") {
                Some(data) => {
                    let text = data.split_once(";base64,").map(|(_, text)| text).ok_or("is not base64".to_owned());
                    let decode = |text| {
                        base64::engine::general_purpose::STANDARD.decode(text).map_err(|error| error.to_string())
                    };
                    ("(embedded)".to_owned(), text.and_then(decode))
                }
                None => (uri.to_owned(), self.beside(uri)),
            },
        };
        let data = data.and_then(|data| {
            if data.len() >= buffer.length() {
                Ok(data)
            } else {
                Err(format!("it has {} bytes of {}", data.len(), buffer.length()))
            }
        });
        data.map_err(|problem| DocumentError::Buffer { file: self.path.to_path_buf(), uri, problem })
    }

    /// A file below the glTF file's folder. Nothing else: the scene's files travel together.
    fn beside(&mut self, uri: &str) -> Result<Vec<u8>, String> {
        let relative = PathBuf::from(uri.replace("%20", " "));
        if !relative.components().all(|component| matches!(component, Component::Normal(_))) {
            return Err("it lies outside of the file's folder".to_owned());
        }
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let bytes = bounded::read(&folder.join(&relative), FILE_BYTES_MOST).map_err(|error| error.to_string())?;
        self.files.push(relative);
        Ok(bytes)
    }

    /// Reads the nodes of a scene, parents before children. `count`: nodes of the file.
    fn tree<'a>(&mut self, roots: impl Iterator<Item = gltf::Node<'a>>, count: usize) -> Result<(), DocumentError> {
        let unsound = |problem| DocumentError::Unsound { file: self.path.to_path_buf(), problem };
        if count > NODES_MOST {
            return Err(unsound(format!("it has {count} nodes, more than {NODES_MOST}: join what is one thing")));
        }
        // In a tree each node is met once. In a circle, or where two nodes share a child, one is met again.
        let mut met = vec![false; count];
        // The next one is the last in the list. Not by recursion: a file may nest as deeply as it likes.
        let mut waiting: Vec<_> = roots.map(|node| (node, None, Affine::identity())).collect();
        waiting.reverse();
        while let Some((node, parent, above)) = waiting.pop() {
            if std::mem::replace(&mut met[node.index()], true) {
                let problem = format!("node {} has two parents, or is below itself", name_of(&node));
                return Err(DocumentError::Unsound { file: self.path.to_path_buf(), problem });
            }
            let own = self.nodes.len();
            let world = self.node(&node, parent, &above)?;
            let first = waiting.len();
            waiting.extend(node.children().map(|child| (child, Some(own), world)));
            waiting[first..].reverse();
        }
        Ok(())
    }

    /// Reads a node without its children; returns how it stands in the scene.
    fn node(&mut self, node: &gltf::Node<'_>, parent: Option<usize>, above: &Affine) -> Result<Affine, DocumentError> {
        let world = above.after(&Affine::of(node.transform().matrix()));
        let name = name_of(node);
        let problem = |problem| DocumentError::Mesh { file: self.path.to_path_buf(), node: name.clone(), problem };
        if !world.translation.iter().all(|v| v.abs() <= FARTHEST_M) {
            return Err(problem(TOO_FAR));
        }
        let (pose, rest) = world.split().ok_or_else(|| problem("has no extent: its scale is zero, or not a number"))?;
        let mut pieces = Vec::new();
        let mut vertices = self.vertices;
        for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
            let has_surface = match primitive.mode() {
                Mode::Triangles => true,
                Mode::TriangleStrip | Mode::TriangleFan => {
                    return Err(problem("has triangle strips; export plain triangles"));
                }
                // Loose edges and points have no surface.
                Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => false,
            };
            if has_surface {
                let lengths = |buffer: usize| self.buffers.get(buffer).map(Vec::len);
                let counts = sound::check(&primitive, &lengths).map_err(problem)?;
                vertices += counts[0].max(counts[1]);
                if vertices > VERTICES_MOST {
                    return Err(problem("makes more than 4000000 vertices or corners in all: simplify the scene"));
                }
                pieces.push(self.piece(&primitive, &rest).map_err(problem)?);
            }
        }
        self.vertices = vertices;
        self.nodes.push(Node { name, parent, pose, pieces });
        Ok(world)
    }

    fn piece(&self, primitive: &gltf::Primitive<'_>, rest: &Affine) -> Result<Piece, &'static str> {
        let data = primitive.reader(|buffer| self.buffers.get(buffer.index()).map(Vec::as_slice));
        let positions = data.read_positions().ok_or("has a mesh whose positions cannot be read")?;
        let mut vertices: Vec<Vec3> = Vec::new();
        for position in positions {
            if !position.iter().all(|v| v.is_finite()) {
                return Err("has a mesh with a position that is not a number");
            }
            let vertex = rest.point(position);
            if vertex.abs().max_element() > FARTHEST_M as f32 {
                return Err(TOO_FAR);
            }
            vertices.push(mirror::vector(vertex));
        }
        let indices: Vec<u32> = match data.read_indices() {
            Some(indices) => indices.into_u32().collect(),
            None => (0..vertices.len() as u32).collect(),
        };
        if !indices.len().is_multiple_of(3) {
            return Err("has a mesh whose corners are not three for each triangle");
        }
        if indices.iter().any(|&index| index as usize >= vertices.len()) {
            return Err("has a mesh with a corner that is no vertex");
        }
        let triangles = indices.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]).collect();
        // What the extras say of a solid holds only for the mesh as it was written.
        let unscaled = rest.is_identity();
        let extras = primitive.extras().as_ref().filter(|_| unscaled).map(|extras| extras.get().to_owned());
        Ok(Piece { vertices, triangles, extras })
    }
}

impl Affine {
    fn identity() -> Self {
        Self { linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] }
    }

    /// From glTF's 4 × 4 matrix, column after column.
    fn of(columns: [[f32; 4]; 4]) -> Self {
        let column = |i: usize| [0, 1, 2].map(|row| f64::from(columns[i][row]));
        Self { linear: [column(0), column(1), column(2)], translation: column(3) }
    }

    fn turn(&self, v: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|row| self.linear[0][row] * v[0] + self.linear[1][row] * v[1] + self.linear[2][row] * v[2])
    }

    /// `self` after `first`.
    fn after(&self, first: &Self) -> Self {
        let moved = self.turn(first.translation);
        Self {
            linear: first.linear.map(|column| self.turn(column)),
            translation: [0, 1, 2].map(|i| moved[i] + self.translation[i]),
        }
    }

    fn point(&self, p: [f32; 3]) -> Vec3 {
        let moved = self.turn(p.map(f64::from));
        Vec3::from([0, 1, 2].map(|i| (moved[i] + self.translation[i]) as f32))
    }

    /// A pose in our axes, and what comes before it: scale, mirroring, shear. None if the map is flat.
    fn split(&self) -> Option<(Pose3, Self)> {
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let less = |a: [f64; 3], b: [f64; 3], share: f64| [0, 1, 2].map(|i| a[i] - share * b[i]);
        let unit = |a: [f64; 3]| {
            let length = dot(a, a).sqrt();
            (length > 1e-9 && length.is_finite()).then(|| a.map(|v| v / length))
        };
        // Gram and Schmidt; the third axis by the right hand, so that a mirror goes into the rest.
        let x = unit(self.linear[0])?;
        let y = unit(less(self.linear[1], x, dot(self.linear[1], x)))?;
        let z = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
        let height = dot(z, self.linear[2]).abs();
        if height < 1e-9 || !height.is_finite() {
            return None;
        }
        let rest = self.linear.map(|column| [dot(x, column), dot(y, column), dot(z, column)]);
        let axis = |v: [f64; 3]| Vec3::from(v.map(|c| c as f32));
        let rotation = Rot3::from_mat3(&rapier3d::math::Mat3::from_cols(axis(x), axis(y), axis(z)));
        let pose = Pose3::from_parts(axis(self.translation), rotation.normalize());
        Some((mirror::pose(pose), Self { linear: rest, translation: [0.0; 3] }))
    }

    fn is_identity(&self) -> bool {
        let identity = Self::identity().linear;
        self.linear.as_flattened().iter().zip(identity.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tetrahedron as an external buffer: positions only.
    const CORNERS: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    fn bytes() -> Vec<u8> {
        CORNERS.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect()
    }

    fn text(uri: &str, node: &str) -> String {
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}],
                "nodes": [{{"name": "Outer", "translation": [1, 2, 3], "children": [1]}}, {node}],
                "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}],
                "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                                "min": [0, 0, 0], "max": [1, 1, 0]}}],
                "bufferViews": [{{"buffer": 0, "byteLength": 36}}],
                "buffers": [{{"byteLength": 36, "uri": "{uri}"}}]}}"#
        )
    }

    fn open(uri: &str, node: &str, buffer: bool) -> Result<Document, DocumentError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gltf");
        std::fs::write(&path, text(uri, node)).unwrap();
        if buffer {
            std::fs::write(folder.path().join("a.bin"), bytes()).unwrap();
        }
        Document::open(&path)
    }

    #[test]
    fn buffers_beside_and_inside_give_the_same_with_scale_and_mirror_in_the_vertices() {
        let node = r#"{"name": "Inner", "mesh": 0, "translation": [1, 0, 0], "scale": [2, 2, -3]}"#;
        let embedded = format!(
            "data:application/octet-stream;base64,{}",
            base64::engine::general_purpose::STANDARD.encode(bytes())
        );
        for (uri, buffer, files) in [("a.bin", true, 2), (embedded.as_str(), false, 1)] {
            let document = open(uri, node, buffer).unwrap();
            assert_eq!(document.files.len(), files);
            assert_eq!((document.nodes[1].name.as_str(), document.nodes[1].parent), ("Inner", Some(0)));
            // z is flipped; the parent's place is added.
            assert!((document.nodes[1].pose.translation - Vec3::new(2.0, 2.0, -3.0)).length() < 1e-6);
            let piece = &document.nodes[1].pieces[0];
            assert_eq!(piece.triangles, [[0, 1, 2]]);
            let world = document.nodes[1].pose * piece.vertices[2];
            assert!((world - Vec3::new(2.0, 4.0, -3.0)).length() < 1e-6, "{world}");
        }
    }

    #[test]
    fn what_is_missing_is_named() {
        let node = r#"{"name": "Inner", "mesh": 0}"#;
        let message = |uri, node, buffer| open(uri, node, buffer).unwrap_err().to_string();
        let missing = message("a.bin", node, false);
        assert!(missing.contains("a.gltf") && missing.contains("buffer a.bin is missing"), "{missing}");
        let outside = message("../a.bin", node, true);
        assert!(outside.contains("outside"), "{outside}");
        let flat = message("a.bin", r#"{"name": "Inner", "mesh": 0, "scale": [1, 1, 0]}"#, true);
        assert!(flat.contains("node Inner") && flat.contains("scale is zero"), "{flat}");
        assert!(matches!(open("a.bin", "{]", true).unwrap_err(), DocumentError::Unsound { .. }));
    }
}
