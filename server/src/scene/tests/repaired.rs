//! Files with faults that do not matter: they are shown, and a note says what was mended.

use std::io::Write;

use glam::{DVec3, Vec3};
use ldi_protocol::mesh::Alpha;
use serde_json::{Value, json};

use super::super::{Scene, load};
use super::Folder;
use super::gltf_file::{GltfFile, NORMALS_AT, POSITIONS_AT, UVS_AT, png};

/// Loads bytes under a name, and checks that the scene is sound.
fn loaded(name: &str, bytes: impl AsRef<[u8]>) -> Scene {
    let scene = load(&Folder::new().write(name, bytes)).unwrap();
    scene.check().unwrap();
    scene
}

fn noted(scene: &Scene, what: &str) -> bool {
    scene.notes.iter().any(|n| n.what.contains(what) || n.why.contains(what))
}

/// Asserts that a changed square is shown whole, with a note.
fn whole(file: GltfFile, note: &str) -> Scene {
    let scene = loaded("square.glb", file.glb());
    assert_eq!(scene.triangles(), 2, "{:?}", scene.notes);
    assert!(note.is_empty() || noted(&scene, note), "{note}: {:?}", scene.notes);
    scene
}

#[test]
fn gltf_numbers_that_are_none_are_made_anew() {
    let float = |at: usize, value: f32| GltfFile::square().patch(at, &value.to_le_bytes());
    let scene = whole(float(NORMALS_AT, f32::NAN), "normals");
    assert_eq!(scene.meshes[0].primitives[0].normals, [Vec3::Z; 4]);
    whole(float(NORMALS_AT + 24, f32::NEG_INFINITY), "normals");
    whole(float(UVS_AT + 28, f32::NAN), "texture coordinates");
    let (file, view) = GltfFile::square().append(&[0xff; 64]);
    let colours = json!({"bufferView": view, "componentType": 5126, "count": 4, "type": "VEC4"});
    let scene = whole(file.with("/accessors/3", colours), "vertex colours");
    assert_eq!(scene.meshes[0].primitives[0].colours, [[1.0; 3]; 4]);
    // Vertex 1 belongs to the first triangle alone.
    let scene = loaded("a.glb", float(POSITIONS_AT + 16, f32::NAN).glb());
    assert_eq!((scene.triangles(), noted(&scene, "not finite")), (1, true));
    assert_eq!(scene.bounds().min, DVec3::new(5.0, 0.0, 0.0));
    let transform = json!({"scale": [3e38, 1], "offset": [3e38, 0]});
    let info = json!({"index": 0, "extensions": {"KHR_texture_transform": transform}});
    whole(GltfFile::square().with("/materials/0/pbrMetallicRoughness/baseColorTexture", info), "texture coordinates");
}

#[test]
fn gltf_members_out_of_range_are_mended() {
    let with = |pointer, value: Value| GltfFile::square().with(pointer, value);
    let factor = "/materials/0/pbrMetallicRoughness/baseColorFactor";
    let scene = whole(with(factor, json!([1.000_000_1, 7, 0.5, 1])), "colour factors");
    assert_eq!(scene.materials[0].base_colour, [1.0, 1.0, 0.5, 1.0]);
    whole(with("/bufferViews/0/byteStride", json!(0)), "");
    whole(with("/nodes/0/rotation", json!([0, 0, 0, 0])), "");
    let scene = whole(with("/nodes/0/rotation", json!([0, 0, 0, 10])), "");
    assert_eq!(scene.bounds().max, DVec3::new(6.0, 1.0, 0.0));
    whole(with("/scenes/0/nodes", json!([0, 0])), "");
    whole(with("/textures/0", json!({})), "without an image");
    whole(with("/samplers/0/wrapS", json!(1)), "");
    assert_eq!(whole(with("/materials/0/alphaMode", json!("GLASS")), "alpha modes").materials[0].alpha, Alpha::Opaque);
    assert_eq!(whole(with("/materials/0/alphaCutoff", json!(-1)), "").materials[0].alpha, Alpha::Mask(0.0));
    let parent = GltfFile::square().push("/nodes", json!({"children": [0], "translation": [9, 9, 9]}));
    assert_eq!(whole(parent, "").bounds().max, DVec3::new(6.0, 1.0, 0.0));
    let more: Vec<u8> = [0u16, 1, 2, 0, 2, 3, 1].iter().flat_map(|i| i.to_le_bytes()).collect();
    let (file, view) = GltfFile::square().append(&more);
    let indices = json!({"bufferView": view, "componentType": 5123, "count": 7, "type": "SCALAR"});
    whole(file.with("/accessors/4", indices), "no whole triangle");
    whole(GltfFile::square().push("/buffers", json!({"uri": "gone.bin", "byteLength": 4})), "");
    let unused = GltfFile::square()
        .push("/images", json!({"uri": "gone.png"}))
        .push("/textures", json!({"source": 1}))
        .push("/materials", json!({"pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}}));
    whole(unused, "gone.png");
}

#[test]
fn gltf_accessors_without_bytes_are_zeros() {
    let zeros = json!({"componentType": 5126, "count": 4, "type": "VEC3"});
    let scene = whole(GltfFile::square().with("/accessors/1", zeros), "normals of no length");
    assert_eq!(scene.meshes[0].primitives[0].normals, [Vec3::Z; 4]);
}

#[test]
fn json_that_writers_get_wrong_is_read() {
    let file = GltfFile::square();
    let text = file.json.to_string();
    let with = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        let folder = Folder::new();
        folder.write("data.bin", &file.bin);
        let text = text.replacen(from, to, 1);
        let buffers = "\"buffers\":[{\"uri\":\"data.bin\",";
        let scene = load(&folder.write("a.gltf", text.replacen("\"buffers\":[{", buffers, 1))).unwrap();
        assert_eq!((scene.triangles(), noted(&scene, "JSON")), (2, true), "{to}");
    };
    with("\"count\":4,", "\"count\":4.0,");
    with("\"asset\":{", "\"asset\":{\"version\":\"1.9\",");
    with(
        "\"scene\":0",
        "\"animations\":[{\"channels\":[{\"sampler\":0,\"target\":{\"path\":\"pointer\"}}],\"samplers\":[]}],\"scene\":0",
    );
    with("\"min\":[0,0,0]", "\"min\":[NaN,0,-Infinity]");
    // Padding of zeros, in a container.
    let padded = super::gltf_file::glb(format!("{text}\0\0\0").as_bytes(), Some(&file.bin));
    assert_eq!(loaded("a.glb", padded).triangles(), 2);
    // A name in Latin-1.
    let at = text.find("four texels").unwrap();
    let mut latin = text.clone().into_bytes();
    latin[at] = 0xe4;
    assert_eq!(loaded("a.glb", super::gltf_file::glb(&latin, Some(&file.bin))).triangles(), 2);
}

#[test]
fn extensions_that_change_no_shape_are_accepted_and_others_named() {
    let requires = |name: &str| GltfFile::square().with("/extensionsRequired", json!([name]));
    whole(requires("KHR_materials_clearcoat"), "KHR_materials_clearcoat");
    let said = |name: &str| load(&Folder::new().write("a.glb", requires(name).glb())).unwrap_err().to_string();
    assert!(said("KHR_gaussian_splatting").contains("splats"), "{}", said("KHR_gaussian_splatting"));
    assert!(said("EXT_texture_avif").contains("PNG or JPEG"));
    assert!(said("ACME_shape").contains("ACME_shape") && !said("ACME_shape").contains("compression"));
}

/// A square of OBJ, then lines.
const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1 4/1/1\n";

#[test]
fn obj_faults_that_do_not_matter_are_mended() {
    for (line, note) in [
        ("f 1 2\nf 1\nf", "fewer than three corners"),
        ("f 1/7/1 2/7/1 3/7/1", "do not exist"),
        ("f 1//9 2//9 3//9", "do not exist"),
        ("vt nan 0\nvn -1.#IND00 0 1", "not finite"),
        ("v nan 0 0\nf 5 1 2", "not finite"),
        ("v 1 1 1 0", "weight 0"),
        ("f 1 1 1 1", "without area"),
    ] {
        let scene = loaded("a.obj", format!("{SQUARE}{line}\n"));
        assert!(noted(&scene, note), "{line}: {:?}", scene.notes);
        assert!(scene.triangles() >= 2);
    }
    let upper = SQUARE.replace("v ", "V ").replace("f ", "F ");
    assert_eq!(loaded("a.obj", upper).triangles(), 2);
    assert_eq!(loaded("a.obj", SQUARE.replace('\n', "\r")).triangles(), 2);
    let wide: Vec<u8> = format!("\u{feff}{SQUARE}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    assert_eq!(loaded("a.obj", wide).triangles(), 2);
    assert_eq!(loaded("scene.txt", SQUARE).triangles(), 2);
}

#[test]
fn colours_of_bytes_are_taken_as_such() {
    let codes = "v 0 0 0 255 0 51\nv 1 0 0 255 0 51\nv 0 1 0 255 0 51\nf 1 2 3\n";
    let shares = "v 0 0 0 1 0 0.2\nv 1 0 0 1 0 0.2\nv 0 1 0 1 0 0.2\nf 1 2 3\n";
    let of = |text| loaded("a.obj", text).meshes[0].primitives[0].colours.clone();
    assert_eq!(of(codes), of(shares));
    let ply = |kind: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
             property {kind} red\nproperty {kind} green\nproperty {kind} blue\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n0 0 0 255 0 51\n1 0 0 255 0 51\n0 1 0 255 0 51\n3 0 1 2\n"
        )
    };
    let of = |text| loaded("a.ply", text).meshes[0].primitives[0].colours.clone();
    assert_eq!(of(ply("float")), of(ply("uchar")));
}

/// The material of a triangle whose library holds these lines.
fn material(lines: &str, folder: &Folder) -> (Scene, ldi_protocol::mesh::Material) {
    folder.write("a.mtl", format!("newmtl m\n{lines}\n"));
    let text = "mtllib a.mtl\nusemtl m\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n";
    let scene = load(&folder.write("a.obj", text)).unwrap();
    scene.check().unwrap();
    let material = scene.materials[scene.meshes[0].primitives[0].material as usize].clone();
    (scene, material)
}

#[test]
fn libraries_mean_what_their_writers_do() {
    let folder = Folder::new();
    folder.write("tex/Wall.png", png());
    let colour = |lines: &str| material(lines, &folder).1.base_colour;
    assert_eq!(colour("kd 0.5 0.25 1"), [0.5, 0.25, 1.0, 1.0]);
    assert_eq!(colour("Kd 1.2 -1 nan"), [1.0, 0.0, 1.0, 1.0]);
    assert_eq!(colour("Kd spectral a.rfl"), [1.0; 4]);
    assert_eq!((colour("Tr 1")[3], colour("d 0")[3], colour("d 0.25")[3], colour("d 1 1 1")[3]), (1.0, 1.0, 0.25, 1.0));
    assert_eq!(colour("Kd 0 0 0\nmap_Kd tex/Wall.png"), [1.0; 4]);
    assert_eq!(colour("Kd 0 0 0\nKe 0 0.5 0"), [0.0, 0.5, 0.0, 1.0]);
    let spellings =
        ["\"tex/Wall.png\"", "tex\\wall.PNG", "C:\\me\\tex\\Wall.png", "../tex/Wall.png", "/home/me/tex/wall.png"];
    for path in spellings {
        let (scene, made) = material(&format!("map_Kd {path}"), &folder);
        assert_eq!(scene.textures[made.texture.unwrap() as usize].width, 2, "{path}");
    }
    assert!(material("map_Kd", &folder).1.texture.is_none());
    let (scene, made) = material("map_Kd tex/Wall.png\nmap_d tex/Wall.png", &folder);
    assert_eq!(made.alpha, Alpha::Mask(0.5));
    assert_eq!(scene.textures[made.texture.unwrap() as usize].rgba[3][3], 0);
    let (scene, _) = material("map_Kd -s 2 3 -o 0.5 0 tex/Wall.png", &folder);
    let uvs: Vec<_> = scene.meshes[0].primitives[0].uvs.iter().map(|uv| [uv.x, 1.0 - uv.y]).collect();
    assert_eq!(uvs, [[0.5, 0.0], [2.5, 0.0], [0.5, 3.0]]);
    // Another material's missing picture matters to nobody.
    let (scene, _) = material("Kd 1 0 0\nnewmtl other\nmap_Kd gone.png", &folder);
    assert!(noted(&scene, "gone.png"));
}

#[test]
fn missing_pictures_are_told_at_once() {
    let folder = Folder::new();
    folder.write("a.mtl", "newmtl m\nmap_Kd gone.png\nnewmtl n\nmap_Kd lost.png\n");
    let text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\nusemtl n\nf 1 2 3\n";
    let said = load(&folder.write("a.obj", text)).unwrap_err().to_string();
    assert!(said.contains("gone.png") && said.contains("lost.png"), "{said}");
}

#[test]
fn ply_faults_that_do_not_matter_are_mended() {
    let of = |body: &str, looks: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             element face 2\nproperty list uchar int vertex_indices\n{looks}end_header\n{body}"
        )
    };
    let square = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n";
    let scene = loaded("a.ply", of(&format!("{square}3 0 1 2\n3 0 2 3\n"), ""));
    assert_eq!((scene.triangles(), scene.notes.len()), (2, 1));
    let scene = loaded("a.ply", of(&format!("{}3 0 1 2\n3 0 2 3\n", square.replace("1 0 0", "nan 0 0")), ""));
    assert_eq!((scene.triangles(), noted(&scene, "not finite")), (1, true));
    let scene = loaded("a.ply", of("0 0 0 255\n1 0 0\n1 1 0 7 8\n0 1 0\n3 0 1 2\n3 0 2 3 9\n", ""));
    assert_eq!((scene.triangles(), noted(&scene, "more words")), (2, true));
    let looks = "property list uchar float texcoord\n";
    let body = format!("{square}3 0 1 2 6 0 0 1 1 nan 0\n3 0 2 3 6 0 0 1 1 0 0\n");
    assert_eq!(loaded("a.ply", of(&body, looks)).triangles(), 2);
    // Elements that share a line are still read one after the other.
    let flowing = of("0 0 0 1 0 0 1 1 0 0 1 0 3 0 1 2 3 0 2 3", "");
    assert_eq!(loaded("a.ply", flowing).triangles(), 2);
}

#[test]
fn scenes_in_archives_are_opened_within_bounds() {
    let folder = Folder::new();
    let zip = |entries: &[(&str, &[u8])]| {
        let mut out = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for (name, bytes) in entries {
            out.start_file(*name, zip::write::SimpleFileOptions::default()).unwrap();
            out.write_all(bytes).unwrap();
        }
        out.finish().unwrap().into_inner()
    };
    let text = format!("mtllib looks/a.mtl\nusemtl m\n{SQUARE}");
    let packed = zip(&[("house/a.obj", text.as_bytes()), ("house/looks/a.mtl", b"newmtl m\nKd 1 0 0\n")]);
    let scene = load(&folder.write("a.zip", packed)).unwrap();
    assert_eq!((scene.triangles(), scene.materials[0].base_colour), (2, [1.0, 0.0, 0.0, 1.0]));
    let said = |name: &str, bytes: Vec<u8>| load(&folder.write(name, bytes)).unwrap_err().to_string();
    assert!(said("two.zip", zip(&[("a.obj", b"v"), ("b.obj", b"v")])).contains("2 scene files"));
    assert!(said("none.zip", zip(&[("a.txt", b"v")])).contains("zip"));
    let bomb = vec![b'#'; 64 << 20];
    assert!(said("bomb.zip", zip(&[("a.obj", &bomb)])).contains("unpacked"));
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gz.write_all(&bomb).unwrap();
    assert!(said("bomb.obj.gz", gz.finish().unwrap()).contains("unpacked"));
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gz.write_all(SQUARE.as_bytes()).unwrap();
    assert_eq!(load(&folder.write("b.obj.gz", gz.finish().unwrap())).unwrap().triangles(), 2);
}
