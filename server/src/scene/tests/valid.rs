//! Valid files give exactly the scene they describe.

use std::f64::consts::FRAC_1_SQRT_2;

use glam::{DVec3, Vec2, Vec3};
use ldi_protocol::mesh::{Alpha, Material, Wrap};
use ldi_protocol::shade::linear_from_srgb;
use serde_json::json;

use super::super::{Scene, load};
use super::Folder;
use super::gltf_file::{GltfFile, INDICES_AT, TEXELS, png};

fn loaded(file: &GltfFile) -> Scene {
    let scene = load(&Folder::new().write("square.glb", file.glb())).unwrap();
    scene.check().unwrap();
    scene
}

#[test]
fn cameras_and_spawn_points_are_viewpoints() {
    let mut file = GltfFile::square();
    file.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]);
    let nodes = file.json["nodes"].as_array_mut().unwrap();
    let first = nodes.len();
    nodes.push(json!({"camera": 0, "translation": [1.0, 2.0, 3.0]}));
    nodes.push(json!({"name": "Info_PlayerStart.001", "translation": [4.0, 5.0, 6.0]}));
    nodes.push(json!({"name": "empty", "translation": [7.0, 8.0, 9.0]}));
    let shown = file.json["scenes"][0]["nodes"].as_array_mut().unwrap();
    shown.extend((first..first + 3).map(|n| json!(n)));
    let mut viewpoints = loaded(&file).viewpoints;
    viewpoints.sort_by(|a, b| a.x.total_cmp(&b.x));
    assert_eq!(viewpoints, [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)]);
}

/// World positions of all triangles, in order.
fn world_triangles(scene: &Scene) -> Vec<[DVec3; 3]> {
    let mut out = Vec::new();
    for i in &scene.instances {
        for p in &scene.meshes[i.mesh as usize].primitives {
            let at = |v: u32| i.world_from_mesh.transform_point3(p.positions[v as usize].as_dvec3());
            out.extend(p.triangles.iter().map(|t| t.map(at)));
        }
    }
    out
}

#[test]
fn a_glb_square_arrives_whole() {
    let scene = loaded(&GltfFile::square());
    assert_eq!(scene.name, "square.glb");
    assert_eq!((scene.triangles(), scene.unique_triangles()), (2, 2));
    assert_eq!(scene.bounds().max, DVec3::new(6.0, 1.0, 0.0));
    assert_eq!(scene.instances[0].world_from_mesh.translation, DVec3::new(5.0, 0.0, 0.0));
    let p = &scene.meshes[0].primitives[0];
    assert_eq!(p.positions, [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]].map(Vec3::from));
    assert_eq!(p.normals, [Vec3::Z; 4]);
    assert_eq!(p.uvs, [[0., 1.], [1., 1.], [1., 0.], [0., 0.]].map(Vec2::from));
    assert_eq!(p.colours[1], [1.0, 0.0, 0.0]);
    assert_eq!(p.colours[3], [0.2, 0.4, 0.6]);
    assert_eq!(p.triangles, [[0, 1, 2], [0, 2, 3]]);
    let material = Material {
        base_colour: [1.0, 0.5, 0.25, 1.0],
        texture: Some(0),
        alpha: Alpha::Mask(0.25),
        unlit: false,
        double_sided: true,
        wrap: [Wrap::Clamp, Wrap::Mirror],
    };
    assert_eq!(scene.materials, [material]);
    let t = &scene.textures[0];
    assert_eq!((t.name.as_str(), t.width, t.height), ("four texels", 2, 2));
    assert_eq!(t.rgba, TEXELS);
    assert_eq!(scene.notes, []);
}

#[test]
fn text_with_files_beside_it_gives_the_same_scene() {
    let folder = Folder::new();
    let file = GltfFile::square().with("/images/0", json!({"name": "four texels", "uri": "maps/a%20b.png"}));
    folder.write("deep/data.bin", &file.bin);
    folder.write("maps/a b.png", png());
    let spec = folder.write("square.gltf", file.gltf("./deep/data.bin"));
    let (beside, whole) = (load(&spec).unwrap(), loaded(&GltfFile::square()));
    assert_eq!(beside.meshes[0].primitives[0].positions, whole.meshes[0].primitives[0].positions);
    assert_eq!(beside.textures[0].rgba, whole.textures[0].rgba);
    assert_eq!(beside.instances, whole.instances);
}

#[test]
fn placements_multiply_in_f64_from_the_root() {
    let file = GltfFile::square().with(
        "/nodes",
        json!([
            {"translation": [500_000.123, 0, 0], "children": [2]},
            {"mesh": 0, "matrix": [0, 0, -1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 1, 2, 3, 1]},
            {"rotation": [0, 0, FRAC_1_SQRT_2, FRAC_1_SQRT_2], "scale": [2, 3, 4], "children": [3]},
            {"mesh": 0, "translation": [1, 0, 0]},
        ]),
    );
    let scene = loaded(&file.with("/scenes/0/nodes", json!([1, 0])));
    assert_eq!(scene.instances.iter().map(|i| i.node).collect::<Vec<_>>(), [1, 3]);
    let corner = |i: usize| scene.instances[i].world_from_mesh.transform_point3(DVec3::new(1.0, 1.0, 0.0));
    assert_eq!(corner(0), DVec3::new(1.0, 3.0, 2.0));
    // (2, 1, 0) scaled is (4, 3, 0), a quarter turn about z makes it (-3, 4, 0).
    assert!(corner(1).distance(DVec3::new(500_000.123 - 3.0, 4.0, 0.0)) < 1e-9);
}

#[test]
fn instances_share_their_mesh_and_mirrors_stay() {
    let file = GltfFile::square().push("/nodes", json!({"mesh": 0, "scale": [-1, 1, 1]}));
    let scene = loaded(&file.with("/scenes/0/nodes", json!([0, 1])));
    assert_eq!((scene.triangles(), scene.unique_triangles(), scene.meshes.len()), (4, 2, 1));
    assert!(scene.instances[1].world_from_mesh.matrix3.determinant() < 0.0);
    assert_eq!(scene.bounds().min, DVec3::new(-1.0, 0.0, 0.0));
}

#[test]
fn only_the_shown_scene_is_placed() {
    let file = GltfFile::square().push("/nodes", json!({"mesh": 0})).push("/scenes", json!({"nodes": [1]}));
    assert_eq!(loaded(&file).instances.len(), 1);
    assert_eq!(loaded(&file.clone().with("/scene", json!(1))).instances[0].node, 1);
    let mut without = file.clone();
    for key in ["scene", "scenes"] {
        without.json.as_object_mut().unwrap().remove(key);
    }
    assert_eq!(loaded(&without).instances.len(), 2);
}

#[test]
fn strips_and_fans_unroll_with_their_winding() {
    let order: Vec<u8> = [0u16, 1, 3, 2, 2, 2].iter().flat_map(|i| i.to_le_bytes()).collect();
    let square = GltfFile::square().patch(INDICES_AT, &order).with("/accessors/4/count", json!(4));
    let mode = |m: u32| {
        loaded(&square.clone().with("/meshes/0/primitives/0/mode", json!(m))).meshes[0].primitives[0].triangles.clone()
    };
    assert_eq!(mode(5), [[0, 1, 3], [1, 2, 3]]);
    assert_eq!(mode(6), [[1, 3, 0], [3, 2, 0]]);
    // Every triangle of the strip faces +Z like the square.
    let scene = loaded(&square.with("/meshes/0/primitives/0/mode", json!(5)));
    assert!(world_triangles(&scene).iter().all(|[a, b, c]| (b - a).cross(c - a).z > 0.0));
}

#[test]
fn points_and_lines_stay_as_empty_primitives() {
    let line = json!({"attributes": {"POSITION": 0}, "mode": 1});
    let mut file = GltfFile::square();
    file.json["meshes"][0]["primitives"].as_array_mut().unwrap().insert(0, line);
    let scene = loaded(&file);
    let counts: Vec<_> = scene.meshes[0].primitives.iter().map(|p| p.triangles.len()).collect();
    assert_eq!(counts, [0, 2]);
    assert_eq!(scene.notes[0].what, "1 primitives of points or lines");
}

#[test]
fn without_indices_and_normals_faces_are_flat() {
    let file = GltfFile::square().with("/meshes/0/primitives/0", json!({"attributes": {"POSITION": 0}}));
    let scene = loaded(&file.with("/accessors/0/count", json!(3)));
    let p = &scene.meshes[0].primitives[0];
    assert_eq!((p.triangles.as_slice(), p.normals.as_slice()), (&[[0, 1, 2]][..], &[Vec3::Z; 3][..]));
    // The default material is white, opaque, single-sided, and follows the file's own.
    assert_eq!(p.material, 1);
    assert!(!scene.materials[1].double_sided && scene.materials[1].base_colour == [1.0; 4]);
}

#[test]
fn interleaved_and_quantized_attributes_decode() {
    // Per vertex: three i16 positions, two bytes of padding, three i8 normals, one of padding, two
    // u16 coordinates.
    let mut bytes = Vec::new();
    for (p, uv) in [([0i16, 0, 0], [0u16, 65_535]), ([32_767, 0, 0], [65_535, 0]), ([0, -32_768, 0], [0, 0])] {
        bytes.extend(p.map(i16::to_le_bytes).as_flattened());
        bytes.extend([0, 0, 0, 0, 127, 0]);
        bytes.extend(uv.map(u16::to_le_bytes).as_flattened());
    }
    let (file, view) = GltfFile::square().append(&bytes);
    let accessor = |offset: u32, component: u32, kind: &str| json!({"bufferView": view, "byteOffset": offset, "componentType": component, "count": 3, "type": kind, "normalized": true});
    let file = file
        .with(&format!("/bufferViews/{view}/byteStride"), json!(16))
        .with("/accessors/0", accessor(0, 5122, "VEC3"))
        .with("/accessors/1", accessor(8, 5120, "VEC3"))
        .with("/accessors/2", accessor(12, 5123, "VEC2"))
        .with(
            "/meshes/0/primitives/0",
            json!({"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "material": 0}),
        )
        .with("/extensionsRequired", json!(["KHR_mesh_quantization"]));
    let scene = loaded(&file);
    let p = &scene.meshes[0].primitives[0];
    assert_eq!(p.positions, [Vec3::ZERO, Vec3::X, -Vec3::Y]);
    assert_eq!(p.normals, [Vec3::Z; 3]);
    assert_eq!(p.uvs, [Vec2::Y, Vec2::X, Vec2::ZERO]);
}

#[test]
fn sparse_accessors_replace_elements() {
    let (file, values) = GltfFile::square().append([7f32, 8., 9.].map(f32::to_le_bytes).as_flattened());
    // View 4, from byte 10 on, holds the index 3.
    let sparse = json!({"count": 1, "indices": {"bufferView": 4, "byteOffset": 10, "componentType": 5123}, "values": {"bufferView": values}});
    let scene = loaded(&file.clone().with("/accessors/0/sparse", sparse.clone()));
    assert_eq!(scene.meshes[0].primitives[0].positions[2..], [Vec3::new(1., 1., 0.), Vec3::new(7., 8., 9.)]);
    // Without a view, the others are zero.
    let zeros = json!({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse});
    let scene = loaded(&file.with("/accessors/0", zeros));
    assert_eq!(scene.meshes[0].primitives[0].positions, [Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, Vec3::new(7., 8., 9.)]);
}

#[test]
fn texture_transforms_move_the_coordinates() {
    // Scale, then a quarter turn counter-clockwise where v points down, then offset.
    let transform = json!({"offset": [0.5, 0], "rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 3]});
    let file = GltfFile::square().with(
        "/materials/0/pbrMetallicRoughness/baseColorTexture",
        json!({"index": 0, "texCoord": 4, "extensions": {"KHR_texture_transform": transform}}),
    );
    let mut moved = file.clone();
    moved.set("/meshes/0/primitives/0/attributes/TEXCOORD_4", json!(2));
    let scene = loaded(&moved);
    for (uv, want) in scene.meshes[0].primitives[0].uvs.iter().zip([[3.5, 0.], [3.5, -2.], [0.5, -2.], [0.5, 0.]]) {
        assert!(uv.distance(Vec2::from(want)) < 1e-6, "{uv}");
    }
    // Without the set that the texture asks for, all coordinates are zero before they move.
    let scene = loaded(&file);
    assert_eq!(scene.meshes[0].primitives[0].uvs, [Vec2::ZERO; 4]);
    assert!(scene.notes.iter().any(|n| n.what.contains("without the texture coordinates")));
}

#[test]
fn blended_unlit_and_ignored_things_are_noted() {
    let file = GltfFile::square()
        .with("/materials/0/alphaMode", json!("BLEND"))
        .with("/materials/0/extensions", json!({"KHR_materials_unlit": {}}))
        .with("/extensionsUsed", json!(["KHR_materials_unlit", "EXT_nobody"]))
        .push("/images", json!({"uri": "http://never.fetched/x.png"}));
    let scene = loaded(&file);
    assert_eq!(scene.materials[0].alpha, Alpha::Mask(0.5));
    assert!(scene.materials[0].unlit);
    let what: Vec<_> = scene.notes.iter().map(|n| n.what.as_str()).collect();
    assert_eq!(what, ["blended materials: \"paper\"", "1 of 2 images", "extensions \"EXT_nobody\""]);
}

#[test]
fn rooms_and_portals_come_from_the_scenes_extras() {
    let extras = json!({
        "ldi_cells": [{"name": "a", "min": [0, 0, 0], "max": [1, 1, 1]}, {"name": "b", "min": [1, 0, 0], "max": [2, 1, 1]}],
        "ldi_portals": [{"rooms": ["a", "b"], "corners": [[1, 0, 0], [1, 0, 1], [1, 1, 1], [1, 1, 0]]}],
    });
    let scene = loaded(&GltfFile::square().with("/scenes/0/extras", extras));
    assert_eq!(scene.rooms[1].name, "b");
    assert_eq!(scene.rooms[1].bounds.max, DVec3::new(2.0, 1.0, 1.0));
    assert_eq!(scene.portals[0].rooms, ["a", "b"]);
    assert_eq!(scene.portals[0].corners[1], DVec3::new(1.0, 0.0, 1.0));
}

#[test]
fn a_built_in_scene_survives_the_way_through_a_file() {
    let built = load("builtin:house?triangles=60000&seed=3").unwrap();
    built.check().unwrap();
    let bytes = super::super::glb_write::glb_bytes(&built).unwrap();
    let read = load(&Folder::new().write("house.glb", bytes)).unwrap();
    read.check().unwrap();
    assert_eq!((read.triangles(), read.unique_triangles()), (built.triangles(), built.unique_triangles()));
    assert_eq!((read.rooms.len(), read.portals.len()), (19, 52));
    assert_eq!((&read.rooms, &read.portals), (&built.rooms, &built.portals));
    assert_eq!(read.textures.len(), built.textures.len());
    assert!(read.textures.iter().zip(&built.textures).all(|(a, b)| a.rgba == b.rgba));
}

#[test]
fn obj_groups_materials_and_fans() {
    let folder = Folder::new();
    folder.write("wall.png", png());
    folder.write(
        "house.mtl",
        "newmtl paint\nKd 0.5 0.25 1\n\nnewmtl glass\nKd 1 1 1\nd 0.3\nmap_Kd -clamp on wall.png\n",
    );
    let text = "mtllib house.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 2\n\
                o front # a comment\nusemtl glass\nf 1/1/1 2/2/1 3/3/1 4/4/1\nusemtl paint\nf 1//1 2//1 3//1\n\
                g side\nf -5 -4 -1\nl 1 2\n";
    let scene = load(&folder.write("house.obj", text)).unwrap();
    scene.check().unwrap();
    let names: Vec<_> = scene.meshes.iter().map(|m| (m.name.as_str(), m.primitives.len())).collect();
    assert_eq!(names, [("front", 2), ("side", 1)]);
    let glass = &scene.meshes[0].primitives[0];
    assert_eq!(glass.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(glass.normals, [Vec3::Z; 4]);
    assert_eq!(glass.uvs, [[0., 1.], [1., 1.], [1., 0.], [0., 0.]].map(Vec2::from));
    assert_eq!(scene.materials[glass.material as usize].texture, Some(0));
    assert_eq!(scene.materials[glass.material as usize].alpha, Alpha::Mask(0.5));
    assert_eq!(scene.materials[glass.material as usize].wrap, [Wrap::Clamp; 2]);
    let paint = &scene.meshes[0].primitives[1];
    assert_eq!(scene.materials[paint.material as usize].base_colour, [0.5, 0.25, 1.0, 1.0]);
    assert!(paint.uvs.is_empty());
    // The side's material goes on; it has no normals, so it gets flat ones.
    let side = &scene.meshes[1].primitives[0];
    assert_eq!((side.material, side.normals.as_slice()), (paint.material, &[-Vec3::Y; 3][..]));
    assert_eq!(scene.notes.len(), 3, "{:?}", scene.notes);
}

#[test]
fn obj_vertex_colours_are_srgb() {
    let text = "v 0 0 0 1 0.5 0\nv 1 0 0\nv 0 1 0 0 0 0\nf 1 2 3\n";
    let scene = load(&Folder::new().write("a.obj", text)).unwrap();
    let half = linear_from_srgb(0.5);
    assert_eq!(scene.meshes[0].primitives[0].colours, [[1.0, half, 0.0], [1.0; 3], [0.0; 3]]);
}

#[test]
fn ply_in_all_three_codings() {
    let header = |format| {
        format!(
            "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex 4\nproperty double x\nproperty float y\nproperty short z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nelement edge 1\nproperty list uchar short ends\n\
             element face 2\nproperty uchar flags\nproperty list uchar uint vertex_index\nend_header\n"
        )
    };
    let points = [(0f64, 0f32, 0i16), (1.0, 0.0, 0), (1.0, 1.0, 0), (0.0, 1.0, 0)];
    let faces: [&[u32]; 2] = [&[0, 1, 2, 3], &[2, 1]];
    let mut ascii = header("ascii");
    let (mut little, mut big) = (header("binary_little_endian").into_bytes(), header("binary_big_endian").into_bytes());
    for (x, y, z) in points {
        ascii += &format!("{x} {y} {z} 255 188 0\n");
        little.extend([&x.to_le_bytes()[..], &y.to_le_bytes(), &z.to_le_bytes(), &[255, 188, 0]].concat());
        big.extend([&x.to_be_bytes()[..], &y.to_be_bytes(), &z.to_be_bytes(), &[255, 188, 0]].concat());
    }
    ascii += "3 1 2 -3\n";
    little.extend([&[3][..], &[1i16, 2, -3].map(i16::to_le_bytes).concat()].concat());
    big.extend([&[3][..], &[1i16, 2, -3].map(i16::to_be_bytes).concat()].concat());
    for face in faces {
        let words: Vec<String> = face.iter().map(u32::to_string).collect();
        ascii += &format!("9 {} {}\n", face.len(), words.join(" "));
        little.extend([9, face.len() as u8]);
        little.extend(face.iter().flat_map(|v| v.to_le_bytes()));
        big.extend([9, face.len() as u8]);
        big.extend(face.iter().flat_map(|v| v.to_be_bytes()));
    }
    for bytes in [ascii.into_bytes(), little, big] {
        let scene = load(&Folder::new().write("a.ply", bytes)).unwrap();
        scene.check().unwrap();
        let p = &scene.meshes[0].primitives[0];
        assert_eq!(p.positions, points.map(|(x, y, z)| Vec3::new(x as f32, y, f32::from(z))));
        assert_eq!(p.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(p.normals, [Vec3::Z; 4]);
        assert_eq!(p.colours, [[1.0, linear_from_srgb(188.0 / 255.0), 0.0]; 4]);
        assert_eq!(scene.notes.len(), 3, "{:?}", scene.notes);
        assert!(
            scene.notes.iter().any(|n| n.what == "elements or properties: \"edge\", \"flags\""),
            "{:?}",
            scene.notes
        );
    }
}

#[test]
fn ply_faces_have_looks_of_their_own() {
    let folder = Folder::new();
    folder.write("a.png", png());
    folder.write("b.png", png());
    // Two triangles of a square, painted from two pictures, and one that is not painted.
    let text = "ply\nformat ascii 1.0\ncomment TextureFile a.png\ncomment TextureFile b.png\nelement vertex 4\nproperty float x\nproperty float y\n\
                property float z\nelement face 3\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\n\
                end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 6 0 0 1 0 1 1 0\n3 0 2 3 6 0 0.5 1 1 0 1 1\n3 0 1 3 0 -1\n";
    let scene = load(&folder.write("painted.ply", text)).unwrap();
    scene.check().unwrap();
    let parts = &scene.meshes[0].primitives;
    let textures: Vec<_> = parts.iter().map(|p| scene.materials[p.material as usize].texture).collect();
    assert_eq!(textures, [Some(0), Some(1), None]);
    assert_eq!(parts[0].uvs, [[0., 1.], [1., 1.], [1., 0.]].map(Vec2::from));
    assert_eq!(parts[1].uvs, [[0., 0.5], [1., 0.], [0., 0.]].map(Vec2::from));
    assert_eq!(parts[1].positions, [[0., 0., 0.], [1., 1., 0.], [0., 1., 0.]].map(Vec3::from));
    assert!(parts.iter().all(|p| p.triangles == [[0, 1, 2]]), "{parts:?}");
    // Normals are the smooth ones of the whole surface.
    assert!(parts.iter().all(|p| p.normals == [Vec3::Z; 3]));
    assert_eq!(scene.notes.len(), 1, "{:?}", scene.notes);

    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
                property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n\
                3 0 1 2 255 0 0\n3 0 2 3 0 0 255\n";
    let scene = load(&folder.write("faces.ply", text)).unwrap();
    scene.check().unwrap();
    let p = &scene.meshes[0].primitives[0];
    assert_eq!(p.colours, [[1., 0., 0.], [1., 0., 0.], [1., 0., 0.], [0., 0., 1.], [0., 0., 1.], [0., 0., 1.]]);
    assert_eq!(p.triangles, [[0, 1, 2], [3, 4, 5]]);
}

/// Coordinates of national grids, as plans and scans have them.
#[test]
fn text_far_from_the_origin_keeps_its_millimetres() {
    let (east, north) = (500_000.0, 5_000_000.0);
    let corners = [[0.0, 0.0, 0.0], [1.001, 0.25, 0.0], [0.502, 0.003, 2.0]];
    let world = corners.map(|[x, y, z]| DVec3::new(east + x, y, north + z));
    let line = |p: DVec3| format!("{:.6} {:.6} {:.6}\n", p.x, p.y, p.z);
    let obj = world.map(|p| format!("v {}", line(p))).concat() + "f 1 2 3\n";
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\nelement face 1\n\
               property list uchar int vertex_indices\nend_header\n"
        .to_owned()
        + &world.map(line).concat()
        + "3 0 1 2\n";
    let folder = Folder::new();
    for spec in [folder.write("far.obj", obj), folder.write("far.ply", ply)] {
        let scene = load(&spec).unwrap();
        scene.check().unwrap();
        for (got, want) in world_triangles(&scene)[0].iter().zip(world) {
            assert!(got.distance(want) < 1e-5, "{spec}: {got} instead of {want}");
        }
    }
}

#[test]
fn axes_and_units_are_told_beside_the_name() {
    let folder = Folder::new();
    let spec = folder.write("a.obj", "v 0 0 0\nv 1000 0 0\nv 0 0 2500\nf 1 2 3\n");
    let scene = load(&format!("{spec}?up=z&unit=mm")).unwrap();
    scene.check().unwrap();
    assert_eq!(scene.name, "a.obj");
    assert!(scene.bounds().max.distance(DVec3::new(1.0, 2.5, 0.0)) < 1e-9, "{:?}", scene.bounds());
    // The front faces -Y in the file, and so +Z here.
    let normal = scene.instances[0].world_from_mesh.matrix3 * scene.meshes[0].primitives[0].normals[0].as_dvec3();
    assert!(normal.normalize().distance(DVec3::Z) < 1e-9, "{normal}");
    let extras = json!({"ldi_cells": [{"name": "a", "min": [0, 0, 0], "max": [1, 2, 3]}]});
    let spec = folder.write("a.glb", GltfFile::square().with("/scenes/0/extras", extras).glb());
    let scene = load(&format!("{spec}?up=z")).unwrap();
    assert_eq!(
        (scene.rooms[0].bounds.min, scene.rooms[0].bounds.max),
        (DVec3::new(0.0, 0.0, -2.0), DVec3::new(1.0, 3.0, 0.0))
    );
    assert!(load(&format!("{spec}?up=x")).is_err());
}

#[test]
fn what_is_missing_is_plain_where_that_is_wanted() {
    let folder = Folder::new();
    folder.write("broken.png", b"\x89PNG\r\n\x1a\nnothing");
    folder.write("a.mtl", "newmtl a\nKd 1 0 0\nmap_Kd gone.png\nnewmtl b\nmap_Kd broken.png\n");
    let text = "mtllib a.mtl\nmtllib gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 3/1 2/1 1/1\n";
    let spec = folder.write("a.obj", text);
    let said = load(&spec).unwrap_err().to_string();
    assert!(said.contains("gone.png") && said.contains("FILE?missing=plain"), "{said}");
    let scene = load(&format!("{spec}?missing=plain")).unwrap();
    scene.check().unwrap();
    assert!(scene.textures.iter().all(|t| t.rgba == [[255; 4]]), "{:?}", scene.textures);
    assert_eq!(scene.materials[0].base_colour, [1.0, 0.0, 0.0, 1.0]);
    let note = scene.notes.iter().find(|n| n.what.starts_with("3 pictures")).expect("is told");
    assert!(["gone.mtl", "gone.png", "broken.png"].iter().all(|f| note.what.contains(f)), "{note:?}");
    // An empty picture is told as well.
    folder.write("gone.png", "");
    let scene = load(&format!("{spec}?missing=plain")).unwrap();
    assert!(
        scene.notes.iter().any(|n| n.what.starts_with("3 pictures") && n.what.contains("gone.png")),
        "{:?}",
        scene.notes
    );
    let uri = json!([{"uri": "nowhere.png"}]);
    let spec = folder.write("a.glb", GltfFile::square().with("/images", uri).glb());
    assert!(load(&spec).is_err());
    assert_eq!(load(&format!("{spec}?missing=plain")).unwrap().textures[0].rgba, [[255; 4]]);
}

#[test]
fn a_mark_of_utf_8_is_no_part_of_the_first_line() {
    let folder = Folder::new();
    folder.write("a.mtl", "\u{feff}newmtl red\nKd 1 0 0\n");
    let scene =
        load(&folder.write("a.obj", "\u{feff}mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")).unwrap();
    assert_eq!(scene.materials[0].base_colour, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(scene.notes.len(), 1, "{:?}", scene.notes);
    let scene = load(&folder.write("b.obj", "\u{feff}v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")).unwrap();
    assert_eq!(scene.triangles(), 1);
    let file = GltfFile::square();
    let text = format!("\u{feff}{}", String::from_utf8(file.gltf("data.bin")).unwrap());
    folder.write("data.bin", &file.bin);
    assert_eq!(load(&folder.write("c.gltf", text)).unwrap().triangles(), 2);
}
