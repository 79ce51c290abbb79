//! Which extensions a file may use.
//!
//! A file names those it uses, and those without which it cannot be understood. Where one that is merely used is not
//! read, the file says by other means how things stand without it.

use super::json::{Node, Root};

/// Read by [`super::accessor`].
const QUANTISATION: &str = "KHR_mesh_quantization";
/// Read by [`hides`].
const VISIBILITY: &str = "KHR_node_visibility";
/// Not read: a node that has it is refused.
pub const INSTANCING: &str = "EXT_mesh_gpu_instancing";
/// What extensions are about that say nothing of where geometry is: the second word of their names.
const HARMLESS: [&str; 9] =
    ["animation", "audio", "image", "lights", "materials", "packing", "techniques", "texture", "xmp"];
const HARMLESS_NAMES: [&str; 7] = [
    "EXT_instance_features",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_structural_metadata",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "MSFT_lod",
];
/// Compressed geometry. Where it is not required, the file has the plain one, too.
const COMPRESSION: [&str; 3] = ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"];

fn is_understood(extension: &str) -> bool {
    let about = extension.split('_').nth(1).unwrap_or_default();
    [QUANTISATION, VISIBILITY, INSTANCING].contains(&extension)
        || HARMLESS.contains(&about)
        || HARMLESS_NAMES.contains(&extension)
}

/// The first extension that the file requires and that is not read.
pub fn required(root: &Root) -> Option<&str> {
    root.extensions_required.iter().map(String::as_str).find(|extension| !is_understood(extension))
}

/// The extensions that the file uses and that are not known here: one of them may move things or hide them.
pub fn unknown(root: &Root) -> impl Iterator<Item = &str> {
    let used = root.extensions_used.iter().map(String::as_str);
    used.filter(|extension| !is_understood(extension) && !COMPRESSION.contains(extension))
}

/// Whether vertices may be whole numbers.
pub fn quantises(root: &Root) -> bool {
    root.extensions_used.iter().chain(&root.extensions_required).any(|used| used == QUANTISATION)
}

/// Whether a node is hidden, with all below it.
pub fn hides(node: &Node) -> bool {
    node.extensions.get(VISIBILITY).is_some_and(|extension| extension["visible"] == false)
}
