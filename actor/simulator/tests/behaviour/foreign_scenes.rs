//! The studio as other programs would write it: the same room, or a reason why not.

use serde_json::{Value, json};
use simulator::physics::geometry::Solid;
use simulator::scene_file::{self, Scene};
use std::path::Path;

/// The example's glTF file, to be changed.
#[derive(Clone)]
struct Studio {
    json: Value,
    binary: Vec<u8>,
    /// What is written before the entries of the scene file's own.
    entries: String,
}

impl Studio {
    fn new() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/studio/studio.glb");
        let bytes = std::fs::read(path).unwrap();
        let glb = gltf::Glb::from_slice(&bytes).unwrap();
        let json = serde_json::from_slice(&glb.json).unwrap();
        Self { json, binary: glb.bin.unwrap().into_owned(), entries: String::new() }
    }

    fn changed(change: impl FnOnce(&mut Self)) -> Self {
        let mut studio = Self::new();
        change(&mut studio);
        studio
    }

    fn node(&mut self, name: &str) -> &mut Value {
        let nodes = self.json["nodes"].as_array_mut().unwrap();
        nodes.iter_mut().find(|node| node["name"] == name).unwrap()
    }

    fn mesh(&mut self, name: &str) -> &mut Value {
        let mesh = self.node(name)["mesh"].as_u64().unwrap() as usize;
        &mut self.json["meshes"][mesh]
    }

    fn push(&mut self, list: &str, value: Value) -> usize {
        let list = self.json[list].as_array_mut().unwrap();
        list.push(value);
        list.len() - 1
    }

    fn add(&mut self, node: Value) -> usize {
        let node = self.push("nodes", node);
        self.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(node.into());
        node
    }

    /// Adds an accessor and a view of these bytes.
    fn accessor(&mut self, bytes: &[u8], stride: Option<usize>, mut accessor: Value) -> usize {
        let first = self.binary.len().next_multiple_of(4);
        self.binary.resize(first, 0);
        self.binary.extend(bytes);
        self.json["buffers"][0]["byteLength"] = self.binary.len().into();
        let mut view = json!({"buffer": 0, "byteOffset": first, "byteLength": bytes.len()});
        if let Some(stride) = stride {
            view["byteStride"] = stride.into();
        }
        accessor["bufferView"] = self.push("bufferViews", view).into();
        self.push("accessors", accessor)
    }

    fn bytes(&self, accessor: &Value) -> &[u8] {
        let accessor = &self.json["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &self.json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        &self.binary[view["byteOffset"].as_u64().unwrap() as usize..][..view["byteLength"].as_u64().unwrap() as usize]
    }

    fn corners(&self, primitive: &Value) -> Vec<u16> {
        self.bytes(&primitive["indices"]).chunks(2).map(|two| u16::from_le_bytes([two[0], two[1]])).collect()
    }

    /// Replaces every primitive by what `change` makes of it.
    fn rewrite(&mut self, change: impl Fn(&mut Self, &mut Value)) {
        let mut meshes = self.json["meshes"].clone();
        for mesh in meshes.as_array_mut().unwrap() {
            mesh["primitives"].as_array_mut().unwrap().iter_mut().for_each(|primitive| change(self, primitive));
        }
        self.json["meshes"] = meshes;
    }

    fn glb(&self) -> Vec<u8> {
        let header = gltf::binary::Header { magic: *b"glTF", version: 2, length: 0 };
        let json = serde_json::to_vec(&self.json).unwrap().into();
        gltf::Glb { header, json, bin: Some(self.binary.as_slice().into()) }.to_vec().unwrap()
    }

    fn read(&self) -> Result<Scene, String> {
        self.read_as(&self.glb(), &[])
    }

    /// Reads these bytes as the glTF file, with other files beside it.
    fn read_as(&self, gltf: &[u8], beside: &[(&str, &[u8])]) -> Result<Scene, String> {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes) in beside.iter().chain(&[("studio.glb", gltf)]) {
            std::fs::create_dir_all(folder.path().join(name).parent().unwrap()).unwrap();
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/studio/scene.toml");
        let own = std::fs::read_to_string(own).unwrap();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, own.replacen("[[node]]", &format!("{}\n[[node]]", self.entries), 1)).unwrap();
        scene_file::read(&path).map_err(|error| error.to_string())
    }

    fn refusal(&self) -> String {
        self.read().map(|_| "accepted").unwrap_err()
    }
}

/// All of a room, to the bit.
fn room(scene: Result<Scene, String>) -> String {
    format!("{:?}", scene.unwrap().room)
}

/// Where the fridge is: low and high, x and z.
fn fridge(studio: &Studio) -> [f32; 4] {
    let room = studio.read().unwrap().room;
    let fridge = room.fixtures.iter().find(|fixture| fixture.category == "Fridge").unwrap();
    let aabb = Solid::of(&fridge.shape).aabb(&fridge.pose);
    [aabb.mins.x, aabb.maxs.x, aabb.mins.z, aabb.maxs.z]
}

fn is_near(found: [f32; 4], expected: [f32; 4]) -> bool {
    found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.006)
}

/// All vertices of a mesh in one accessor, which its primitives share.
fn share_vertices(studio: &mut Studio) {
    let mut meshes = studio.json["meshes"].clone();
    for mesh in meshes.as_array_mut().unwrap() {
        let primitives = mesh["primitives"].as_array_mut().unwrap();
        let (mut vertices, mut first) = (Vec::new(), 0_u16);
        for primitive in primitives.iter_mut() {
            let corners: Vec<u8> =
                studio.corners(primitive).iter().flat_map(|corner| (corner + first).to_le_bytes()).collect();
            vertices.extend(studio.bytes(&primitive["attributes"]["POSITION"]));
            first = (vertices.len() / 12) as u16;
            let accessor = json!({"componentType": 5123, "count": corners.len() / 2, "type": "SCALAR"});
            primitive["indices"] = studio.accessor(&corners, None, accessor).into();
        }
        let accessor = json!({"componentType": 5126, "count": first, "type": "VEC3"});
        let shared = studio.accessor(&vertices, None, accessor);
        for primitive in primitives {
            primitive["attributes"]["POSITION"] = shared.into();
        }
    }
    studio.json["meshes"] = meshes;
}

/// Corners of another type, without spaces.
fn retype(studio: &mut Studio, kind: u32, bytes: impl Fn(u16) -> Vec<u8>) {
    studio.rewrite(|studio, primitive| {
        let corners: Vec<u16> = studio.corners(primitive);
        let bytes: Vec<u8> = corners.iter().flat_map(|&corner| bytes(corner)).collect();
        let accessor = json!({"componentType": kind, "count": corners.len(), "type": "SCALAR"});
        primitive["indices"] = studio.accessor(&bytes, None, accessor).into();
    });
}

/// Vertices with something between them, and attributes of unknown names.
fn space_vertices(studio: &mut Studio) {
    studio.rewrite(|studio, primitive| {
        let vertices = studio.bytes(&primitive["attributes"]["POSITION"]);
        let bytes: Vec<u8> = vertices.chunks(12).flat_map(|vertex| [&[7; 4], vertex, &[7; 8]].concat()).collect();
        let accessor = json!({"componentType": 5126, "count": vertices.len() / 12, "type": "VEC3", "byteOffset": 4});
        let spaced = studio.accessor(&bytes, Some(24), accessor);
        primitive["attributes"] = json!({"POSITION": spaced, "_OWN": spaced, "KHR_gaussian:X": 99999});
    });
}

/// A second vertex that only a sparse value sets right.
fn make_sparse(studio: &mut Studio) {
    studio.rewrite(|studio, primitive| {
        let vertices = studio.bytes(&primitive["attributes"]["POSITION"]).to_vec();
        let (count, mut wrong) = (vertices.len() / 12, vertices.clone());
        wrong[12..24].fill(0x40);
        let indices = studio.accessor(&[1, 0], None, json!({"componentType": 5123, "count": 1}));
        let values = studio.accessor(&vertices[12..24], None, json!({"componentType": 5126, "count": 1}));
        let view = |accessor: usize| studio.json["accessors"][accessor]["bufferView"].clone();
        let sparse = json!({"count": 1, "indices": {"bufferView": view(indices), "componentType": 5123},
                            "values": {"bufferView": view(values)}});
        let accessor = json!({"componentType": 5126, "count": count, "type": "VEC3", "sparse": sparse});
        primitive["attributes"]["POSITION"] = studio.accessor(&wrong, None, accessor).into();
    });
}

#[test]
fn the_same_geometry_written_otherwise_is_the_same_room() {
    type Change = fn(&mut Studio);
    let ways: [(&str, Change); 10] = [
        ("shared vertices", share_vertices),
        ("corners of 8 bits", |studio| retype(studio, 5121, |corner| vec![u8::try_from(corner).unwrap()])),
        ("corners of 32 bits", |studio| retype(studio, 5125, |corner| u32::from(corner).to_le_bytes().to_vec())),
        ("vertices with something between them", space_vertices),
        ("sparse vertices", make_sparse),
        ("matrices", |studio| {
            for node in studio.json["nodes"].as_array_mut().unwrap() {
                let at = node.as_object_mut().unwrap().remove("translation").unwrap();
                node["matrix"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, at[0], at[1], at[2], 1]);
            }
        }),
        ("a scene without nodes, and lines, and nodes that hold nothing", |studio| {
            let scene = studio.push("scenes", json!({"name": "Empty"}));
            studio.json["scenes"].as_array_mut().unwrap().swap(0, scene);
            studio.json["scene"] = scene.into();
            studio.mesh("Mug")["primitives"].as_array_mut().unwrap().push(json!({"attributes": {}, "mode": 1}));
            let nodes = [
                json!({"name": "Hidden-by-scale", "scale": [0, 0, 0]}),
                json!({"name": "Sun", "translation": [0, 5000, 0], "camera": 3}),
                json!({"name": "Bones", "skin": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}}),
            ];
            for node in nodes {
                let node = studio.push("nodes", node);
                studio.json["scenes"][scene]["nodes"].as_array_mut().unwrap().push(node.into());
            }
        }),
        ("what is ignored", |studio| {
            studio.entries = "[[node]]\nname = \"Ignored*\"\nrole = \"ignore\"".to_owned();
            let mesh = studio.push("meshes", json!({"primitives": [{"attributes": {"POSITION": 99999}}]}));
            studio.add(json!({"name": "Ignored", "mesh": 0, "scale": [1, 1, 0]}));
            studio.add(json!({"name": "Ignored too", "mesh": mesh, "skin": 0}));
            studio.add(json!({"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": false}}}));
        }),
        ("weights of nothing", |studio| {
            studio.mesh("Fridge")["weights"] = json!([0.0]);
            studio.node("Mug")["extensions"] = json!({"KHR_node_visibility": {"visible": true}, "VENDOR_x": {}});
            studio.json["animations"] = json!([{"channels": [{"target": {"path": "pointer"}}], "samplers": []}]);
        }),
        ("extensions of what is not read", |studio| {
            let names = json!([
                "EXT_texture_webp",
                "EXT_texture_avif",
                "KHR_texture_basisu",
                "MSFT_texture_dds",
                "KHR_texture_transform",
                "KHR_materials_unlit",
                "KHR_materials_variants",
                "KHR_lights_punctual",
                "EXT_lights_image_based",
                "KHR_xmp_json_ld",
                "MSFT_packing_occlusionRoughnessMetallic",
                "MSFT_lod",
                "KHR_animation_pointer"
            ]);
            studio.json["extensionsUsed"] = names.clone();
            studio.json["extensionsRequired"] = names;
            studio.json["textures"] = json!([{"extensions": {"EXT_texture_webp": {"source": 0}}}]);
            studio.json["materials"] = json!([{"alphaMode": "NEW"}]);
            // Compression that is not required has the plain geometry beside it.
            studio.json["extensionsUsed"].as_array_mut().unwrap().push("EXT_meshopt_compression".into());
        }),
    ];
    let plain = room(Studio::new().read());
    for (way, change) in ways {
        let changed = Studio::changed(change).read().map_err(|error| format!("{way}: {error}"));
        assert!(room(changed) == plain, "{way}: another room");
    }
}

#[test]
fn containers_of_other_writers_hold_the_same_room() {
    let studio = Studio::new();
    let plain = room(studio.read());
    // A chunk of another kind, before the binary one and behind it.
    let glb = studio.glb();
    let json_end = 20 + u32::from_le_bytes([glb[12], glb[13], glb[14], glb[15]]) as usize;
    let own = b"\x04\0\0\0OWN\0abcd";
    let mut chunks = [&glb[..json_end], own, &glb[json_end..], own].concat();
    let length = chunks.len() as u32;
    chunks[8..12].copy_from_slice(&length.to_le_bytes());
    assert!(room(studio.read_as(&chunks, &[])) == plain);

    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, &studio.binary);
    for (uri, file) in [
        ("k%C3%BCche%20%25.bin", "küche %.bin"),
        ("küche.bin", "küche.bin"),
        ("ku\u{308}che.bin", "k\u{fc}che.bin"),
        ("./studio.bin", "studio.bin"),
        ("a/./b%2Fc/%2E%2E/studio.bin", "a/b/studio.bin"),
        (&format!("data:application/octet-stream;charset=utf-8;base64,{data}"), ""),
        (&format!("DATA:;base64,{}", data.trim_end_matches('=').replace('+', "%2B")), ""),
    ] {
        let mut studio = studio.clone();
        studio.json["buffers"][0]["uri"] = uri.into();
        let text = format!("\u{feff}{}", studio.json);
        let binary = studio.binary.as_slice();
        let beside = [(file, binary)];
        let read = studio.read_as(text.as_bytes(), if file.is_empty() { &[] } else { &beside });
        if !file.is_empty() {
            assert_eq!(read.as_ref().unwrap().files[2], Path::new(file));
        }
        assert!(room(read) == plain, "{file}: another room");
    }
    for uri in ["../studio.bin", "%2E%2E/studio.bin", "a/..%2F../studio.bin", "%2Fetc/passwd", "/etc/passwd", ".", ""] {
        let mut studio = studio.clone();
        studio.json["buffers"][0]["uri"] = uri.into();
        let refused = studio.read_as(studio.json.to_string().as_bytes(), &[]).unwrap_err();
        assert!(refused.contains("outside of the file's folder"), "{uri}: {refused}");
    }
}

#[test]
fn a_link_that_leads_out_of_the_folder_is_refused() {
    let (inside, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut studio = Studio::new();
    studio.json["buffers"][0]["uri"] = "studio.bin".into();
    let scene = inside.path().join("scene.toml");
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/studio/scene.toml");
    std::fs::write(&scene, std::fs::read_to_string(own).unwrap().replace("\"studio.glb\"", "\"./studio.gltf\""))
        .unwrap();
    let refused = |linked: &str, other: &str| {
        for folder in [&inside, &outside] {
            std::fs::write(folder.path().join("studio.bin"), &studio.binary).unwrap();
            std::fs::write(folder.path().join("studio.gltf"), studio.json.to_string()).unwrap();
        }
        assert!(scene_file::read(&scene).is_ok());
        std::fs::remove_file(inside.path().join(linked)).unwrap();
        std::os::unix::fs::symlink(outside.path().join(linked), inside.path().join(linked)).unwrap();
        let text = scene_file::read(&scene).unwrap_err().to_string();
        assert!(text.contains("outside of") && text.contains(other), "{text}");
        // To another file of the same folder it may lead.
        std::fs::remove_file(inside.path().join(linked)).unwrap();
        std::fs::copy(outside.path().join(linked), inside.path().join("other")).unwrap();
        std::os::unix::fs::symlink("other", inside.path().join(linked)).unwrap();
        assert!(scene_file::read(&scene).is_ok());
        std::fs::remove_file(inside.path().join(linked)).unwrap();
    };
    refused("studio.bin", "its buffer studio.bin");
    refused("studio.gltf", "gltf = \"./studio.gltf\"");
}

#[test]
fn morph_weights_move_what_they_say() {
    let unmoved = [1.21, 1.79, 1.01, 1.70];
    let moved = [1.21, 1.79, 0.41, 1.10];
    let with = |mesh_weight: Value, node_weights: Option<Value>| {
        Studio::changed(|studio| {
            let mesh = studio.node("Fridge")["mesh"].as_u64().unwrap() as usize;
            let mut primitives = studio.json["meshes"][mesh]["primitives"].clone();
            for primitive in primitives.as_array_mut().unwrap() {
                let count = studio.bytes(&primitive["attributes"]["POSITION"]).len() / 12;
                let added: Vec<u8> =
                    [0.0_f32, 0.0, 0.6].repeat(count).iter().flat_map(|value| value.to_le_bytes()).collect();
                let accessor = json!({"componentType": 5126, "count": count, "type": "VEC3"});
                primitive["targets"] = json!([{"NORMAL": 0}, {"POSITION": studio.accessor(&added, None, accessor)}]);
            }
            studio.json["meshes"][mesh]["primitives"] = primitives;
            studio.json["meshes"][mesh]["weights"] = mesh_weight;
            if let Some(weights) = node_weights {
                studio.node("Fridge")["weights"] = weights;
            }
        })
    };
    for (studio, expected) in [
        (Studio::new(), unmoved),
        (with(json!([1.0, 0.0]), None), unmoved),
        (with(json!([0.5, 1.0]), None), moved),
        (with(json!([0.0, 1.0]), Some(json!([0.0, 0.0]))), unmoved),
        (with(json!([]), Some(json!([0.0, 1.0]))), moved),
    ] {
        let found = fridge(&studio);
        assert!(is_near(found, expected), "{found:?}, not {expected:?}");
    }
    let refused = with(json!([0.0, 0.0, 1.0]), None).refusal();
    assert!(refused.contains("node Fridge: has a mesh with more morph weights than morph targets"), "{refused}");
}

#[test]
fn quantised_vertices_are_read() {
    let of = |kind: u32, normalised: bool, name: &str| {
        Studio::changed(|studio| {
            // The floor's box as a cube from -1 to 1, of whole numbers.
            let most = if normalised { f32::from(i16::MAX) } else { 1.0 };
            let mut primitive = studio.mesh("Fridge")["primitives"][0].clone();
            let vertices = studio.bytes(&primitive["attributes"]["POSITION"]).to_vec();
            let values = vertices.chunks(4).map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]]));
            let sides = [(-0.29, 0.29), (0.0, 1.7), (-0.33, 0.33)];
            let whole = values.enumerate().map(|(i, value)| {
                let (low, high) = sides[i % 3];
                (((value - low) / (high - low) * 2.0 - 1.0).round() * most) as i16
            });
            let bytes: Vec<u8> = if kind == 5122 {
                whole
                    .collect::<Vec<_>>()
                    .chunks(3)
                    .flat_map(|v| [v[0], v[1], v[2], 7])
                    .flat_map(i16::to_le_bytes)
                    .collect()
            } else {
                whole.collect::<Vec<_>>().chunks(3).flat_map(|v| [v[0], v[1], v[2], 7].map(|v| v as u8)).collect()
            };
            let stride = if kind == 5122 { 8 } else { 4 };
            let accessor = json!({"componentType": kind, "count": 8, "type": "VEC3", "normalized": normalised});
            let quantised = studio.accessor(&bytes, Some(stride), accessor);
            primitive["attributes"]["POSITION"] = quantised.into();
            studio.mesh("Fridge")["primitives"] = json!([primitive]);
            studio.node("Fridge")["scale"] = json!([0.29, 0.85, 0.33]);
            studio.node("Fridge")["translation"][1] = json!(0.85);
            studio.json["extensionsUsed"] = json!([name]);
            studio.json["extensionsRequired"] = json!([name]);
        })
    };
    for (kind, normalised) in [(5122, true), (5122, false), (5120, false)] {
        let found = fridge(&of(kind, normalised, "KHR_mesh_quantization"));
        assert!(is_near(found, [1.21, 1.79, 1.04, 1.70]), "{kind}: {found:?}");
    }
    let refused = of(5122, true, "KHR_materials_unlit").refusal();
    assert!(refused.contains("not three 32-bit"), "{refused}");
}

#[test]
fn what_moves_or_hides_things_and_is_not_read_is_refused_with_what_to_do() {
    let required = |name: &str| Studio::changed(|studio| studio.json["extensionsRequired"] = json!([name]));
    let extended = |name: &str, value: Value| {
        Studio::changed(|studio| studio.node("Fridge")["extensions"] = json!({ name: value }))
    };
    let hidden = json!({"visible": false});
    for (studio, expected) in [
        (Studio::changed(|studio| studio.node("Fridge")["skin"] = json!(0)), "node Fridge: is bent by a skin"),
        (
            extended("EXT_mesh_gpu_instancing", json!({"attributes": {}})),
            "node Fridge: stands in several places by EXT_mesh_gpu_instancing",
        ),
        (extended("KHR_node_visibility", hidden.clone()), "node Fridge: is hidden (KHR_node_visibility)"),
        (
            Studio::changed(|studio| {
                let nodes = std::mem::replace(&mut studio.json["scenes"][0]["nodes"], json!([]));
                studio.add(json!({"children": nodes, "extensions": {"KHR_node_visibility": hidden}}));
            }),
            "node Mug: is hidden",
        ),
        (Studio::changed(|studio| studio.node("Fridge")["scale"] = json!([1, 1, 0])), "node Fridge: has no extent"),
        (
            required("KHR_draco_mesh_compression"),
            "needs the extension KHR_draco_mesh_compression, which is not read here",
        ),
        (required("EXT_meshopt_compression"), "needs the extension EXT_meshopt_compression"),
        (required("KHR_meshopt_compression"), "needs the extension KHR_meshopt_compression"),
        (required("VENDOR_moves_all"), "needs the extension VENDOR_moves_all, which is not read here; export it again"),
        (
            Studio::changed(|studio| {
                let position = studio.mesh("Fridge")["primitives"][0]["attributes"]["POSITION"].as_u64().unwrap();
                studio.json["accessors"][position as usize].as_object_mut().unwrap().remove("bufferView");
            }),
            "node Fridge: has a mesh whose data are nowhere, or compressed",
        ),
    ] {
        let refused = studio.refusal();
        assert!(refused.contains(expected), "`{expected}` is not in: {refused}");
    }
}

#[test]
fn a_name_is_the_same_however_its_accents_are_written() {
    let named = |name: &str, entry: &str| {
        Studio::changed(|studio| {
            studio.entries = format!("[[node]]\nname = \"{entry}\"\nrole = \"fixed\"\ncategory = \"Fridge\"");
            studio.node("Stool")["name"] = name.into();
        })
    };
    for (name, entry) in
        [("Hocker-ü", "Hocker-u\u{308}"), ("Hocker-u\u{308}", "Hocker-ü"), ("Hocker-u\u{308}", "Hocker-?")]
    {
        let refused = named(name, entry).refusal();
        assert!(refused.contains("no node is called `Stool") && !refused.contains("no entry says"), "{refused}");
    }
}

#[test]
fn a_mirror_turns_things_over_and_parents_may_be_matrices() {
    let plain = fridge(&Studio::new());
    let scaled = Studio::changed(|studio| {
        let nodes = std::mem::replace(&mut studio.json["scenes"][0]["nodes"], json!([]));
        let inner = studio.push("nodes", json!({"children": nodes, "scale": [-1, 1, 1]}));
        studio.add(json!({"children": [inner], "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1]}));
    });
    let [low_x, high_x, low_z, high_z] = plain;
    let found = fridge(&scaled);
    assert!(is_near(found, [-high_x, -low_x, -high_z, -low_z]), "{found:?}");
}
