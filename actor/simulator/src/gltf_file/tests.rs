//! Files that a glTF reader must survive: each is refused with a reason, soon, whatever it says.

use super::document::{Document, DocumentError};
use super::piece::Piece;
use proptest::prelude::*;
use serde_json::{Value, json};

/// A file with one triangle: three positions, then three indices.
fn triangle() -> Value {
    let mut bytes: Vec<u8> =
        [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|value| value.to_le_bytes()).collect();
    bytes.extend([0u16, 1, 2].iter().flat_map(|index| index.to_le_bytes()));
    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, bytes);
    json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "Floor", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}
        ],
        "buffers": [{"byteLength": 42, "uri": format!("data:application/octet-stream;base64,{data}")}]
    })
}

fn open_bytes(bytes: &[u8]) -> Result<Document, DocumentError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    std::fs::write(&path, bytes).unwrap();
    Document::open(&path)
}

fn open(file: &Value) -> Result<Document, DocumentError> {
    open_bytes(file.to_string().as_bytes())
}

/// A file, and the meshes of all its nodes.
fn read(file: &Value) -> Result<(Document, Vec<Piece>), String> {
    let mut document = open(file).map_err(|error| error.to_string())?;
    let mut pieces = Vec::new();
    for node in 0..document.nodes.len() {
        let found = document.pieces(node);
        pieces.extend(found.map_err(|problem| format!("node {}: {problem}", document.nodes[node].name))?);
    }
    Ok((document, pieces))
}

/// What is said of the triangle after a change.
fn wrong(change: impl Fn(&mut Value)) -> String {
    let mut file = triangle();
    change(&mut file);
    read(&file).map_or_else(|problem| problem, |(document, _)| format!("{} nodes", document.nodes.len()))
}

#[test]
fn the_triangle_itself_is_sound() {
    assert_eq!(wrong(|_| {}), "1 nodes");
    let sparse = json!({"count": 1, "indices": {"bufferView": 1, "byteOffset": 2, "componentType": 5123},
                        "values": {"bufferView": 0, "byteOffset": 12}});
    let (_, pieces) = read(&{
        let mut file = triangle();
        file["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        file["accessors"][0]["sparse"] = sparse;
        file
    })
    .unwrap();
    assert_eq!(pieces[0].vertices.iter().map(|vertex| vertex.x).collect::<Vec<_>>(), [0.0, 1.0, 0.0]);
}

#[test]
fn accessors_that_reach_beyond_their_data() {
    assert!(
        wrong(|f| f["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(7)).contains("which is not there")
    );
    assert!(wrong(|f| f["meshes"][0]["primitives"][0]["indices"] = json!(7)).contains("which is not there"));
    assert!(wrong(|f| f["accessors"][0]["bufferView"] = json!(7)).contains("beyond"));
    assert!(wrong(|f| f["bufferViews"][0]["buffer"] = json!(7)).contains("beyond"));
    assert!(wrong(|f| f["buffers"][0]["uri"] = json!("a.bin")).contains("a.gltf: its buffer a.bin is missing"));
    assert!(wrong(|f| f["nodes"][0]["mesh"] = json!(7)).contains("a mesh that is not there"));
    assert!(wrong(|f| f["nodes"][0]["children"] = json!([7])).contains("names node 7"));
    assert!(wrong(|f| f["scene"] = json!(7)).contains("no scene"));
    assert!(wrong(|f| f["accessors"][1]["componentType"] = json!(5126)).contains("not whole numbers"));
    assert!(wrong(|f| f["accessors"][1]["componentType"] = json!(5120)).contains("not whole numbers"));
    assert!(wrong(|f| f["accessors"][0]["type"] = json!("VEC2")).contains("not three 32-bit"));
    assert!(wrong(|f| f["accessors"][0]["componentType"] = json!(5123)).contains("not three 32-bit"));
    assert!(wrong(|f| f["accessors"][1]["type"] = json!("VEC3")).contains("not whole numbers"));
    assert!(wrong(|f| f["bufferViews"][0]["byteStride"] = json!(4)).contains("byteStride"));
    assert!(wrong(|f| f["bufferViews"][0]["byteStride"] = json!(253)).contains("byteStride"));
    assert!(wrong(|f| f["bufferViews"][1]["byteStride"] = json!(1)).contains("byteStride"));
    for count in [4_u64, 1 << 31, u64::MAX] {
        let text = wrong(|f| f["accessors"][0]["count"] = json!(count));
        assert!(text.contains("beyond") || text.contains("simplify"), "{count}: {text}");
    }
    assert!(wrong(|f| f["accessors"][0]["count"] = json!(0)).contains("nothing in it"));
    assert!(wrong(|f| f["accessors"][1]["byteOffset"] = json!(u64::MAX)).contains("beyond"));
    assert!(wrong(|f| f["bufferViews"][0]["byteOffset"] = json!(u64::MAX)).contains("beyond"));
    assert!(wrong(|f| f["bufferViews"][0]["byteLength"] = json!(43)).contains("beyond"));
    assert!(wrong(|f| f["bufferViews"][0]["byteLength"] = json!(35)).contains("beyond"));
    assert!(wrong(|f| f["accessors"][1]["count"] = json!(2)).contains("three for each triangle"));
    // Indices of three vertices of which there are two.
    assert!(wrong(|f| f["accessors"][0]["count"] = json!(2)).contains("no vertex"));
}

#[test]
fn sparse_accessors_that_reach_beyond_their_data() {
    let sparse = |count: u64, indices: u64, values: u64| {
        wrong(|file| {
            file["accessors"][0].as_object_mut().unwrap().remove("bufferView");
            file["accessors"][0]["sparse"] = json!({
                "count": count, "indices": {"bufferView": 1, "byteOffset": indices, "componentType": 5123},
                "values": {"bufferView": 0, "byteOffset": values}
            });
        })
    };
    assert_eq!(sparse(3, 0, 0), "1 nodes");
    assert!(sparse(0, 0, 0).contains("or none"));
    assert!(sparse(4, 0, 0).contains("more sparse values than values"));
    assert!(sparse(3, 2, 0).contains("beyond"));
    assert!(sparse(3, 0, 4).contains("beyond"));
    let alone = wrong(|file| {
        file["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    });
    assert!(alone.contains("data are nowhere"), "{alone}");
}

#[test]
fn a_scene_is_a_tree_however_deep() {
    let below = |children: &dyn Fn(usize) -> Vec<usize>, nodes: usize| {
        wrong(|file| {
            let node = |index: usize| match children(index) {
                children if children.is_empty() => json!({"mesh": 0}),
                children => json!({"children": children}),
            };
            file["nodes"] = (0..nodes).map(node).collect();
        })
    };
    assert!(below(&|index| vec![index], 1).contains("two parents, or is below itself"));
    assert!(below(&|index| vec![(index + 1) % 3], 3).contains("two parents, or is below itself"));
    // Forty levels of two nodes that share both children: 2^40 ways.
    let shared = |index: usize| if index < 80 { vec![(index / 2 + 1) * 2, (index / 2 + 1) * 2 + 1] } else { vec![] };
    assert!(below(&shared, 82).contains("two parents"));
    assert_eq!(below(&|index| if index < 9_999 { vec![index + 1] } else { vec![] }, 10_000), "10000 nodes");
    assert!(below(&|_| vec![], 20_001).contains("20001 nodes, more than"));
    // Parents come before children, and children in their order.
    let mut file = triangle();
    file["nodes"] = json!([{"name": "a", "children": [2, 1]}, {"name": "b", "mesh": 0}, {"name": "c", "children": [3]}, {"name": "d"}]);
    let document = open(&file).unwrap();
    let names: Vec<(&str, Option<usize>)> = document.nodes.iter().map(|n| (n.name.as_str(), n.parent)).collect();
    assert_eq!(names, [("a", None), ("c", Some(0)), ("d", Some(1)), ("b", Some(0))]);
}

#[test]
fn a_mesh_counts_for_each_node_that_has_it() {
    let text = wrong(|file| {
        // 1,500,000 vertices three times.
        let count = 1_500_000;
        let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, vec![0; 12 * count]);
        file["buffers"][0] =
            json!({"byteLength": 12 * count, "uri": format!("data:application/octet-stream;base64,{data}")});
        file["bufferViews"] = json!([{"buffer": 0, "byteLength": 12 * count}]);
        file["accessors"] = json!([{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3",
                                    "min": [0, 0, 0], "max": [0, 0, 0]}]);
        file["meshes"] = json!([{"primitives": [{"attributes": {"POSITION": 0}}]}]);
        file["nodes"] = json!([{"mesh": 0}, {"mesh": 0}, {"mesh": 0}]);
        file["scenes"] = json!([{"nodes": [0, 1, 2]}]);
    });
    assert!(text.contains("in all: simplify the scene"), "{text}");
}

#[test]
fn places_that_are_no_places() {
    for (key, value) in [
        ("translation", json!([0.0, 1e20, 0.0])),
        ("translation", json!([1001.0, 0.0, 0.0])),
        ("scale", json!([1e30, 1e30, 1e30])),
        ("matrix", json!([1e30, 0, 0, 0, 0, 1e30, 0, 0, 0, 0, 1e30, 0, 0, 0, 0, 1])),
    ] {
        let text = wrong(|file| file["nodes"][0][key] = value.clone());
        assert!(text.contains("node Floor: lies or reaches more than 1 km away"), "{key} {value}: {text}");
    }
    assert_eq!(wrong(|file| file["nodes"][0]["translation"] = json!([999.0, 0.0, 0.0])), "1 nodes");
    let far = wrong(|file| {
        let data = [3e38_f32; 9].iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, data);
        file["buffers"] = json!([{"byteLength": 36, "uri": format!("data:x;base64,{data}")}]);
        file["bufferViews"] = json!([{"buffer": 0, "byteLength": 36}]);
        file["accessors"].as_array_mut().unwrap().truncate(1);
        file["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("indices");
    });
    assert!(far.contains("more than 1 km away"), "{far}");
    let none = wrong(|file| file["nodes"][0]["scale"] = json!([1e-30, 1.0, 1.0]));
    assert!(none.contains("has no extent"), "{none}");
}

#[test]
fn files_that_are_too_large_or_too_short() {
    assert!(matches!(open_bytes(b"glTF"), Err(DocumentError::Unsound { .. })));
    for length in [0_u32, 11, 12, 19, 20, u32::MAX] {
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend(length.to_le_bytes());
        bytes.extend([0; 8]);
        assert!(matches!(open_bytes(&bytes), Err(DocumentError::Unsound { .. })), "{length}");
    }
    let objects = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"nodes\": [{}{{}}]}}", "{},".repeat(500_000));
    let text = open_bytes(objects.as_bytes()).unwrap_err().to_string();
    assert!(text.contains("objects, more than 500000"), "{text}");
    let deep = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"extras\": {}", "[".repeat(100_000));
    assert!(matches!(open_bytes(deep.as_bytes()), Err(DocumentError::Unsound { .. })));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    std::fs::File::create(&path).unwrap().set_len(600 << 20).unwrap();
    let text = Document::open(&path).unwrap_err().to_string();
    assert!(text.contains("more than the"), "{text}");
}

/// Numbers that break arithmetic.
fn number() -> impl Strategy<Value = Value> {
    prop_oneof![
        Just(json!(0)),
        Just(json!(-1)),
        Just(json!(1)),
        Just(json!(2)),
        Just(json!(3)),
        Just(json!(41)),
        Just(json!(u32::MAX)),
        Just(json!(i64::MAX)),
        Just(json!(u64::MAX)),
        Just(json!(5121)),
        Just(json!(5125)),
        Just(json!(5126)),
        Just(json!(1e30)),
        Just(json!(-1e-30)),
        Just(json!("VEC2")),
        Just(json!("SCALAR")),
        Just(json!([])),
        Just(json!([0, 0])),
        Just(json!([0, 1e39, 0])),
        Just(Value::Null),
    ]
}

/// Every place in the file that a value can be put.
fn places(value: &Value, here: &str, found: &mut Vec<String>) {
    found.push(here.to_owned());
    match value {
        Value::Object(fields) => fields.iter().for_each(|(key, value)| places(value, &format!("{here}/{key}"), found)),
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(i, value)| places(value, &format!("{here}/{i}"), found));
        }
        _ => {}
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    /// Whatever one or two values are replaced by, the file is read or refused.
    #[test]
    fn any_value_anywhere_is_survived(
        changes in prop::collection::vec((any::<prop::sample::Index>(), number()), 1..3),
    ) {
        let mut file = triangle();
        for (place, value) in changes {
            let mut all = Vec::new();
            places(&file, "", &mut all);
            let here = &all[place.index(all.len())];
            *file.pointer_mut(here).unwrap() = value;
        }
        if let Ok((_, pieces)) = read(&file) {
            for piece in &pieces {
                let count = piece.vertices.len() as u32;
                prop_assert!(piece.triangles.iter().flatten().all(|&corner| corner < count));
                prop_assert!(piece.vertices.iter().all(|vertex| vertex.abs().max_element() <= 1000.0));
                let _ = super::solid::part_of(piece, Some(super::solid::Convex::Decompose));
            }
        }
    }
}
