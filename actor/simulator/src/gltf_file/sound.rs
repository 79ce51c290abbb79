//! What the crate that reads glTF takes for granted, checked before it reads: it indexes, subtracts and allocates as
//! the file says, and so a file could make it panic or fill the memory.

use gltf::accessor::{DataType, Dimensions};
use gltf::json::{Root, deserialize};
use gltf::{Accessor, Document, Primitive, Semantic, buffer};

/// The file and each of its buffers, bytes.
pub const FILE_BYTES_MOST: u64 = 512 << 20;
/// The part that is JSON, bytes; buffers may be embedded in it.
const JSON_BYTES_MOST: usize = 128 << 20;
/// Objects in the JSON: each becomes a struct of some hundred bytes.
const OBJECTS_MOST: usize = 500_000;
/// Nodes that a scene may have.
pub const NODES_MOST: usize = 20_000;
/// Vertices, and corners of triangles, that all nodes of a scene together may have. A mesh counts for each node that
/// has it.
pub const VERTICES_MOST: usize = 4_000_000;

/// Parses a `.glb` or `.gltf` file: the document and its binary chunk.
pub fn parse(bytes: &[u8]) -> Result<(Document, Option<Vec<u8>>), String> {
    let (json, blob) = if bytes.starts_with(b"glTF") {
        let length = bytes.get(8..12).map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]));
        if length.is_none_or(|length| length < 20) {
            return Err("it is shorter than a header".to_owned());
        }
        let glb = gltf::Glb::from_slice(bytes).map_err(|error| error.to_string())?;
        (glb.json, glb.bin.map(std::borrow::Cow::into_owned))
    } else {
        (bytes.into(), None)
    };
    if json.len() > JSON_BYTES_MOST {
        return Err(format!("its JSON has {} bytes, more than {JSON_BYTES_MOST}: export it as .glb", json.len()));
    }
    let objects: usize = json.iter().map(|&byte| usize::from(byte == b'{')).sum();
    if objects > OBJECTS_MOST {
        return Err(format!("its JSON has {objects} objects, more than {OBJECTS_MOST}: simplify the scene"));
    }
    let root: Root = deserialize::from_slice(&json).map_err(|error| error.to_string())?;
    // The crate's own check looks these accessors up before it knows that they exist.
    let accessors = root.accessors.len();
    let mut positions = root.meshes.iter().flat_map(|mesh| &mesh.primitives).flat_map(|p| p.attributes.values());
    if let Some(index) = positions.find(|index| index.value() >= accessors) {
        return Err(format!("it names accessor {}, and there are {accessors}", index.value()));
    }
    let document = Document::from_json(root).map_err(|error| error.to_string())?;
    Ok((document, blob))
}

/// Where data must lie: a buffer's length by its number.
type Lengths<'a> = &'a dyn Fn(usize) -> Option<usize>;

/// Checks what a primitive's positions and corners are read from. Returns how many vertices and corners it has.
pub fn check(primitive: &Primitive<'_>, lengths: Lengths<'_>) -> Result<[usize; 2], &'static str> {
    let positions = primitive.get(&Semantic::Positions).ok_or("has a mesh without positions")?;
    if positions.dimensions() != Dimensions::Vec3 || positions.data_type() != DataType::F32 {
        return Err("has a mesh whose positions are not three 32-bit floating-point numbers each");
    }
    check_accessor(&positions, lengths)?;
    let Some(corners) = primitive.indices() else { return Ok([positions.count(); 2]) };
    let is_index = matches!(corners.data_type(), DataType::U8 | DataType::U16 | DataType::U32);
    if corners.dimensions() != Dimensions::Scalar || !is_index {
        return Err("has a mesh whose corners are not whole numbers");
    }
    check_accessor(&corners, lengths)?;
    Ok([positions.count(), corners.count()])
}

fn check_accessor(accessor: &Accessor<'_>, lengths: Lengths<'_>) -> Result<(), &'static str> {
    let (count, size) = (accessor.count(), accessor.size());
    if count == 0 {
        return Err("has a mesh with nothing in it");
    }
    if count > VERTICES_MOST {
        return Err("has a mesh of more than 4000000 vertices or corners: simplify it");
    }
    if let Some(view) = accessor.view() {
        check_range(&view, accessor.offset(), [count, size], lengths)?;
    } else if accessor.sparse().is_none() {
        return Err("has a mesh whose data are nowhere");
    }
    let Some(sparse) = accessor.sparse() else { return Ok(()) };
    if sparse.count() == 0 || sparse.count() > count {
        return Err("has a mesh with more sparse values than values, or none");
    }
    let (indices, values) = (sparse.indices(), sparse.values());
    check_range(&indices.view(), indices.offset(), [sparse.count(), indices.index_type().size()], lengths)?;
    check_range(&values.view(), values.offset(), [sparse.count(), size], lengths)
}

/// Whether `count` values of `size` bytes lie in a view, and the view in its buffer.
fn check_range(
    view: &buffer::View<'_>,
    offset: usize,
    [count, size]: [usize; 2],
    lengths: Lengths<'_>,
) -> Result<(), &'static str> {
    const OUTSIDE: &str = "has a mesh whose data reach beyond their buffer";
    let stride = view.stride().unwrap_or(size);
    if stride < size || stride > 252 {
        return Err("has a mesh whose values overlap, or lie more than 252 bytes apart (byteStride)");
    }
    let buffer = lengths(view.buffer().index()).ok_or(OUTSIDE)?;
    let view_end = view.offset().checked_add(view.length()).ok_or(OUTSIDE)?;
    let end = stride.checked_mul(count - 1).and_then(|last| last.checked_add(size)?.checked_add(offset));
    if view_end <= buffer && end.is_some_and(|end| end <= view.length()) { Ok(()) } else { Err(OUTSIDE) }
}
