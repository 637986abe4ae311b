//! Where glTF places meshes by other ways than nodes, and looks beside the base colour.

use glam::{DVec3, Vec3};
use ldi_protocol::mesh::Alpha;
use serde_json::json;

use super::super::{Scene, load};
use super::Folder;
use super::gltf_file::GltfFile;

fn loaded(file: &GltfFile) -> Scene {
    let scene = load(&Folder::new().write("square.glb", file.glb())).unwrap();
    scene.check().unwrap();
    scene
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

/// The file with an accessor of floats; returns its number too.
fn accessor(file: GltfFile, values: &[f32], kind: &str, width: usize) -> (GltfFile, usize) {
    let (file, view) = file.append(&floats(values));
    let number = file.json["accessors"].as_array().unwrap().len();
    let count = values.len() / width;
    let accessor = json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind});
    (file.push("/accessors", accessor), number)
}

#[test]
fn many_instances_of_a_node_are_instances() {
    let (file, translations) = accessor(GltfFile::square(), &[0., 0., 0., 0., 10., 0.], "VEC3", 3);
    let (file, scales) = accessor(file, &[1., 1., 1., 2., 2., 2.], "VEC3", 3);
    let attributes = json!({"TRANSLATION": translations, "SCALE": scales, "_ID": 0});
    let file = file.with("/nodes/0/extensions", json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}}));
    let scene = loaded(&file.clone().with("/extensionsRequired", json!(["EXT_mesh_gpu_instancing"])));
    assert_eq!((scene.meshes.len(), scene.unique_triangles(), scene.triangles()), (1, 2, 4));
    assert_eq!(scene.bounds().max, DVec3::new(7.0, 12.0, 0.0));
    let uneven = file.with(&format!("/accessors/{scales}/count"), json!(1));
    assert!(load(&Folder::new().write("a.glb", uneven.glb())).is_err());
}

#[test]
fn hidden_nodes_hide_what_is_below_them() {
    let hidden = json!({"KHR_node_visibility": {"visible": false}});
    let file = GltfFile::square()
        .push("/nodes", json!({"extensions": hidden, "children": [2]}))
        .push("/nodes", json!({"mesh": 0}))
        .with("/scenes/0/nodes", json!([0, 1]));
    let scene = loaded(&file);
    assert_eq!(scene.instances.iter().map(|i| i.node).collect::<Vec<_>>(), [0]);
    assert!(scene.notes.iter().any(|n| n.what.contains("not visible")));
}

#[test]
fn morph_targets_stand_by_their_weights() {
    let (file, target) = accessor(GltfFile::square(), &[0., 0., 4.].repeat(4), "VEC3", 3);
    let file = file.with("/meshes/0/primitives/0/targets", json!([{"POSITION": target}]));
    assert_eq!(loaded(&file).bounds().max.z, 0.0);
    let file = file.with("/meshes/0/weights", json!([0.5]));
    let scene = loaded(&file);
    assert_eq!((scene.meshes.len(), scene.bounds().min.z, scene.bounds().max.z), (1, 2.0, 2.0));
    // A node's own weights come first; each way to show the mesh is a mesh of its own.
    let file = file.push("/nodes", json!({"mesh": 0, "weights": [0.0]})).with("/scenes/0/nodes", json!([0, 1]));
    let scene = loaded(&file);
    assert_eq!((scene.meshes.len(), scene.bounds().min.z, scene.bounds().max.z), (2, 0.0, 2.0));
    assert_eq!(scene.instances[1].mesh, 0);
}

/// The square, its lower corners moved by joint 0, its upper by joint 1.
fn skinned() -> GltfFile {
    let (file, joints) = accessor(
        GltfFile::square(),
        &[[0., 0., 0., 0.], [0., 0., 0., 0.], [1., 0., 0., 0.], [1., 0., 0., 0.]].concat(),
        "VEC4",
        4,
    );
    let (file, weights) = accessor(file, &[1., 0., 0., 0.].repeat(4), "VEC4", 4);
    let mut file = file
        .push("/nodes", json!({"translation": [0, 0, 7]}))
        .push("/nodes", json!({"translation": [0, 0, 7]}))
        .with("/nodes/0/skin", json!(0))
        .with("/skins", json!([{"joints": [1, 2]}]))
        .with("/scenes/0/nodes", json!([0, 1, 2]));
    file.set("/meshes/0/primitives/0/attributes/JOINTS_0", json!(joints));
    file.set("/meshes/0/primitives/0/attributes/WEIGHTS_0", json!(weights));
    file
}

#[test]
fn skins_stand_where_their_joints_are() {
    // Joints that agree place the instance; the node's own placement does not count.
    let scene = loaded(&skinned());
    assert_eq!(scene.bounds().max, DVec3::new(1.0, 1.0, 7.0));
    assert_eq!(scene.meshes[0].primitives[0].positions[2], Vec3::new(1.0, 1.0, 0.0));
    // Joints that do not move the vertices.
    let scene = loaded(&skinned().with("/nodes/2/translation", json!([0, 10, 7])));
    assert_eq!((scene.bounds().min, scene.bounds().max), (DVec3::new(0.0, 0.0, 7.0), DVec3::new(1.0, 11.0, 7.0)));
    assert!(scene.notes.iter().any(|n| n.what.contains("skins")));
    // Far from the origin, nothing is lost to rounding.
    let far = skinned()
        .with("/nodes/1/translation", json!([500_000.25, 0, 7]))
        .with("/nodes/2/translation", json!([500_000.25, 10, 7]));
    assert_eq!(loaded(&far).bounds().min, DVec3::new(500_000.25, 0.0, 7.0));
    // A skin in its bind pose is its node's mesh.
    let bound = skinned().with("/nodes/1/translation", json!([5, 0, 0])).with("/nodes/2/translation", json!([5, 0, 0]));
    let scene = loaded(&bound);
    assert_eq!(scene.instances, loaded(&GltfFile::square()).instances);
    assert!(!scene.notes.iter().any(|n| n.what.contains("skins")));
    for wrong in [json!([{"joints": [1, 99]}]), json!([{"joints": [1, 2], "inverseBindMatrices": 0}])] {
        assert!(load(&Folder::new().write("a.glb", skinned().with("/skins", wrong).glb())).is_err());
    }
}

#[test]
fn looks_beside_the_base_colour() {
    let material = |value| {
        let scene = loaded(&GltfFile::square().with("/materials/0", value));
        scene.materials[0].clone()
    };
    let gloss = json!({"diffuseFactor": [0.5, 0.25, 0.125, 1], "diffuseTexture": {"index": 0}});
    let made = material(json!({"extensions": {"KHR_materials_pbrSpecularGlossiness": gloss}}));
    assert_eq!((made.base_colour, made.texture), ([0.5, 0.25, 0.125, 1.0], Some(0)));
    // A base colour that the file states comes first.
    let base = json!({"baseColorFactor": [1, 0, 0, 1]});
    let both = json!({"pbrMetallicRoughness": base, "extensions": {"KHR_materials_pbrSpecularGlossiness": gloss}});
    assert_eq!((material(both.clone()).base_colour, material(both).texture), ([1.0, 0.0, 0.0, 1.0], None));
    let black = json!({"baseColorFactor": [0, 0, 0, 1]});
    let lamp = json!({"pbrMetallicRoughness": black, "emissiveFactor": [0, 0.25, 0],
        "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 2}}});
    let made = material(lamp);
    assert_eq!((made.base_colour, made.unlit), ([0.0, 0.5, 0.0, 1.0], true));
    let bright = material(json!({"emissiveFactor": [0, 0.25, 0]}));
    assert_eq!((bright.base_colour, bright.unlit), ([1.0; 4], false));
    let glass =
        |factor: f32| material(json!({"extensions": {"KHR_materials_transmission": {"transmissionFactor": factor}}}));
    assert_eq!((glass(1.0).alpha, glass(1.0).base_colour[3]), (Alpha::Mask(0.5), 0.0));
    assert_eq!((glass(0.0).alpha, glass(0.25).base_colour[3]), (Alpha::Opaque, 0.75));
}

#[test]
fn views_of_meshoptimizer_are_decoded() {
    let square = GltfFile::square();
    let points: Vec<[f32; 3]> = vec![[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    let encoded = meshopt::encode_vertex_buffer(&points).unwrap();
    let (file, from) = square.append(&encoded);
    let offset = file.json["bufferViews"][from]["byteOffset"].clone();
    // Buffer 1 has no bytes: decoders fill it.
    let file = file.push("/buffers", json!({"byteLength": 48}));
    let compressed = json!({"buffer": 0, "byteOffset": offset, "byteLength": encoded.len(), "byteStride": 12,
        "count": 4, "mode": "ATTRIBUTES"});
    for name in ["EXT_meshopt_compression", "KHR_meshopt_compression"] {
        let mut extensions = json!({});
        extensions[name] = compressed.clone();
        let view = json!({"buffer": 1, "byteLength": 48, "extensions": extensions});
        let file = file.clone().with("/bufferViews/0", view).with("/extensionsRequired", json!([name]));
        assert_eq!(
            loaded(&file).meshes[0].primitives[0].positions,
            points.iter().map(|p| Vec3::from(*p)).collect::<Vec<_>>()
        );
    }
    let mut broken = compressed;
    broken["byteLength"] = json!(u64::MAX);
    let view = json!({"buffer": 1, "byteLength": 48, "extensions": {"EXT_meshopt_compression": broken}});
    assert!(load(&Folder::new().write("a.glb", file.with("/bufferViews/0", view).glb())).is_err());
}
