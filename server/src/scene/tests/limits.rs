//! Each limit is compared before it is reached: a valid file passes exactly at its own size, and
//! fails one below.

use serde_json::json;

use super::super::{LIMITS, Limits, SceneError, load_within};
use super::Folder;
use super::gltf_file::GltfFile;

fn passes_at_and_fails_below(spec: &str, at: u64, with: impl Fn(u64) -> Limits) {
    load_within(spec, &with(at)).unwrap();
    match load_within(spec, &with(at - 1)) {
        Err(SceneError::TooLarge { file, .. }) => assert_eq!(file, spec),
        other => panic!("{other:?}"),
    }
}

#[test]
fn gltf_limits_hold() {
    let folder = Folder::new();
    // Two nodes, one below the other, of one mesh with four vertices and two triangles; a picture
    // of four texels.
    let file = GltfFile::square().with("/nodes/0/children", json!([1])).push("/nodes", json!({"mesh": 0}));
    let text = file.json.to_string();
    let spec = folder.write("square.glb", file.glb());
    let length = file.glb().len() as u64;
    passes_at_and_fails_below(&spec, length, |n| Limits { file_bytes: n, ..LIMITS });
    let padded = (text.len() as u64).next_multiple_of(4);
    passes_at_and_fails_below(&spec, padded, |n| Limits { json_bytes: n, ..LIMITS });
    let objects = text.matches('{').count() as u64;
    passes_at_and_fails_below(&spec, objects, |n| Limits { json_objects: n, ..LIMITS });
    passes_at_and_fails_below(&spec, 4, |n| Limits { vertices: n, ..LIMITS });
    passes_at_and_fails_below(&spec, 2, |n| Limits { unique_triangles: n, ..LIMITS });
    passes_at_and_fails_below(&spec, 4, |n| Limits { expanded_triangles: n, ..LIMITS });
    passes_at_and_fails_below(&spec, 2, |n| Limits { instances: n, ..LIMITS });
    passes_at_and_fails_below(&spec, 2, |n| Limits { node_depth: n as u32, ..LIMITS });
    passes_at_and_fails_below(&spec, 2, |n| Limits { image_side: n as u32, ..LIMITS });
    passes_at_and_fails_below(&spec, 4, |n| Limits { image_pixels: n, ..LIMITS });
}

#[test]
fn primitives_that_share_an_accessor_count_each() {
    let folder = Folder::new();
    let primitive = GltfFile::square().json["meshes"][0]["primitives"][0].clone();
    let spec = folder.write("shared.glb", GltfFile::square().push("/meshes/0/primitives", primitive).glb());
    passes_at_and_fails_below(&spec, 8, |n| Limits { vertices: n, ..LIMITS });
    passes_at_and_fails_below(&spec, 4, |n| Limits { unique_triangles: n, ..LIMITS });
}

#[test]
fn flat_normals_count_their_vertices() {
    let folder = Folder::new();
    let attributes = json!({"POSITION": 0});
    let spec = folder.write("flat.glb", GltfFile::square().with("/meshes/0/primitives/0/attributes", attributes).glb());
    passes_at_and_fails_below(&spec, 4 + 6, |n| Limits { vertices: n, ..LIMITS });
}

#[test]
fn files_count_together() {
    let folder = Folder::new();
    let file = GltfFile::square();
    folder.write("square.bin", &file.bin);
    let text = file.gltf("square.bin");
    let spec = folder.write("square.gltf", &text);
    passes_at_and_fails_below(&spec, (text.len() + file.bin.len()) as u64, |n| Limits { file_bytes: n, ..LIMITS });
}

#[test]
fn obj_and_ply_limits_hold() {
    let folder = Folder::new();
    let obj = folder.write("quad.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1 4//1\n");
    let ply = folder.write(
        "quad.ply",
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
         property list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n",
    );
    for spec in [obj, ply] {
        passes_at_and_fails_below(&spec, 4, |n| Limits { vertices: n, ..LIMITS });
        passes_at_and_fails_below(&spec, 2, |n| Limits { unique_triangles: n, ..LIMITS });
    }
}
