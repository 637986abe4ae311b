//! Bad glTF files, from the container down to single values.

use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;

use serde_json::{Value, json};

use super::gltf_file::{COLOURS_AT, GltfFile, INDICES_AT, POSITIONS_AT, glb};
use super::hostile::Case;

/// All of them.
pub(super) fn cases() -> Vec<Case> {
    [containers(), documents(), buffers(), accessors(), values(), nodes()].into_iter().flatten().collect()
}

/// A case from the bytes of a GLB.
fn bytes(name: &'static str, says: &'static str, make: impl Fn(Vec<u8>) -> Vec<u8> + 'static) -> Case {
    Case::new(name, says, move |f| f.write("bad.glb", make(GltfFile::square().glb())))
}

/// A case from the text of a `.gltf`.
fn text(name: &'static str, says: &'static str, make: impl Fn() -> Vec<u8> + 'static) -> Case {
    Case::new(name, says, move |f| f.write("bad.gltf", make()))
}

/// A case from a changed document.
pub(super) fn file(name: &'static str, says: &'static str, make: impl Fn(GltfFile) -> GltfFile + 'static) -> Case {
    Case::new(name, says, move |f| f.write("bad.glb", make(GltfFile::square()).glb()))
}

/// A case from one changed JSON value.
pub(super) fn value(name: &'static str, says: &'static str, pointer: &'static str, value: Value) -> Case {
    file(name, says, move |f| f.with(pointer, value.clone()))
}

pub(super) fn overwrite(mut bytes: Vec<u8>, at: usize, with: &[u8]) -> Vec<u8> {
    bytes[at..at + with.len()].copy_from_slice(with);
    bytes
}

fn containers() -> Vec<Case> {
    vec![
        bytes("empty", "it is empty", |_| Vec::new()),
        bytes("white space", "it is empty", |_| b" \n".to_vec()),
        bytes("a letter", "neither a GLB container nor the JSON text", |_| b"Dear sir".to_vec()),
        bytes("magic alone", "GLB header", |b| b[..4].to_vec()),
        bytes("eleven bytes", "GLB header", |b| b[..11].to_vec()),
        bytes("header alone", "GLB chunks", |b| overwrite(b, 8, &12u32.to_le_bytes())[..12].to_vec()),
        bytes("length zero", "GLB header", |b| overwrite(b, 8, &0u32.to_le_bytes())),
        bytes("length below the header", "GLB header", |b| overwrite(b, 8, &11u32.to_le_bytes())),
        bytes("length beyond the file", "GLB header", |b| overwrite(b, 8, &1_000_000u32.to_le_bytes())),
        bytes("length of 4 GiB", "GLB header", |b| overwrite(b, 8, &u32::MAX.to_le_bytes())),
        bytes("version 1", "version", |b| overwrite(b, 4, &1u32.to_le_bytes())),
        bytes("version 3", "version", |b| overwrite(b, 4, &3u32.to_le_bytes())),
        bytes("first chunk is BIN", "GLB chunks", |b| overwrite(b, 16, b"BIN\0")),
        bytes("unknown chunk", "GLB chunks", |b| overwrite(b, 16, b"HACK")),
        bytes("JSON chunk beyond the file", "GLB chunks", |b| overwrite(b, 12, &1_000_000u32.to_le_bytes())),
        bytes("JSON chunk of 4 GiB", "GLB chunks", |b| overwrite(b, 12, &u32::MAX.to_le_bytes())),
        bytes("JSON chunk cut short", "GLB chunks", |b| overwrite(b, 12, &64u32.to_le_bytes())),
        bytes("file cut in the JSON", "GLB header", |b| b[..200].to_vec()),
        bytes("file cut in the BIN", "GLB header", |b| b[..b.len() - 20].to_vec()),
        bytes("BIN chunk longer than the file", "GLB chunks", |b| {
            let json = u32::from_le_bytes([b[12], b[13], b[14], b[15]]) as usize;
            overwrite(b, 20 + json, &9_999u32.to_le_bytes())
        }),
        bytes("two JSON chunks", "GLB chunks", |b| {
            let json = u32::from_le_bytes([b[12], b[13], b[14], b[15]]) as usize;
            overwrite(b, 24 + json, b"JSON")
        }),
        bytes("no BIN chunk", "BIN chunk", |_| glb(GltfFile::square().json.to_string().as_bytes(), None)),
        bytes("text instead of GLB", "JSON", |_| b"this is no scene".to_vec()),
    ]
}

fn documents() -> Vec<Case> {
    let square = || GltfFile::square().json.to_string();
    vec![
        text("empty text", "it is empty", Vec::new),
        text("garbage text", "JSON", || vec![0x80; 1000]),
        text("text cut short", "JSON", move || square().into_bytes()[..500].to_vec()),
        text("text goes on", "JSON", move || (square() + "x").into_bytes()),
        text("invalid UTF-8", "JSON", move || {
            square().into_bytes().into_iter().map(|b| if b == b'p' { 0xff } else { b }).collect()
        }),
        text("array for a document", "JSON", || b"[]".to_vec()),
        text("nested a million deep", "JSON", || vec![b'['; 1_000_000]),
        text("extras nested deep", "JSON", || {
            format!("{{\"asset\":{{\"version\":\"2.0\"}},\"x\":{}", "{\"x\":".repeat(100_000)).into_bytes()
        }),
        text("number too large", "JSON", move || square().replacen("\"count\":4", "\"count\":1e999", 1).into_bytes()),
        text("count of 2 to the 64", "JSON", move || {
            square().replacen("\"count\":4", "\"count\":18446744073709551616", 1).into_bytes()
        }),
        text("no asset", "asset", || b"{\"scenes\":[]}".to_vec()),
        value("asset version 1.0", "version", "/asset/version", json!("1.0")),
        value("asset version 20", "version", "/asset/version", json!("20.0")),
        value("asset version missing", "version", "/asset", json!({})),
        value("nothing but an asset", "no triangles", "/scenes/0/nodes", json!([])),
        value("splats required", "KHR_gaussian_splatting", "/extensionsRequired", json!(["KHR_gaussian_splatting"])),
        value("extension name with escapes", "extensionsRequired", "/extensionsRequired", json!(["\u{1b}[31m\u{7}"])),
        value(
            "extension name of a megabyte",
            "extensionsRequired",
            "/extensionsRequired",
            json!(["x".repeat(1 << 20)]),
        ),
        value("nodes are an object", "JSON", "/nodes", json!({})),
        value("negative count", "JSON", "/accessors/0/count", json!(-1)),
        value("fractional count", "JSON", "/accessors/0/count", json!(3.5)),
        value("negative index", "JSON", "/nodes/0/mesh", json!(-1)),
    ]
}

fn buffers() -> Vec<Case> {
    let uri = |name, says, uri: &'static str| {
        Case::new(name, says, move |f| f.write("in/bad.gltf", GltfFile::square().gltf(uri)))
    };
    // The bytes that must not be read lie beside the scene's folder.
    let escape = |name, uri: fn(&str) -> String| {
        Case::new(name, "folder", move |f| {
            let outside = f.write("secret.bin", GltfFile::square().bin);
            f.write("in/bad.gltf", GltfFile::square().gltf(&uri(&outside)))
        })
    };
    let linked = |name, target: fn(&str) -> String, link: &'static str, uri: &'static str| {
        Case::new(name, "link", move |f| {
            let outside = f.write("secret/secret.bin", GltfFile::square().bin);
            let scene = f.write("in/bad.gltf", GltfFile::square().gltf(uri));
            symlink(target(&outside), f.path().join("in").join(link)).unwrap();
            scene
        })
    };
    vec![
        escape("URI goes up", |_| "../secret.bin".into()),
        escape("URI goes down and up", |_| "x/../../secret.bin".into()),
        escape("URI goes up in disguise", |_| "%2e%2e%2Fsecret.bin".into()),
        escape("URI goes up after a dot", |_| "./../secret.bin".into()),
        escape("URI is absolute", str::to_owned),
        escape("URI is absolute in disguise", |path| path.replace('/', "%2f")),
        escape("URI has two slashes", |path| format!("/{path}")),
        linked("URI is a link out", str::to_owned, "link.bin", "link.bin"),
        linked("URI passes a linked folder", |path| path.rsplit_once('/').unwrap().0.into(), "dir", "dir/secret.bin"),
        uri("URI is http", "scheme", "http://127.0.0.1:9/x.bin"),
        uri("URI is https", "scheme", "https://example.org/x.bin"),
        uri("URI is file", "scheme", "file:///etc/passwd"),
        uri("URI has a drive letter", "scheme", "C:\\x.bin"),
        uri("URI is /etc/passwd", "folder", "/etc/passwd"),
        uri("URI is /dev/zero", "folder", "/dev/zero"),
        uri("URI is a Windows share", "folder", "\\\\host\\share\\x.bin"),
        uri("URI is missing", "cannot be read", "nowhere.bin"),
        uri("URI is empty", "no file name", ""),
        uri("URI is the folder", "regular file", "."),
        uri("URI is cut within an escape", "cannot be read", "x%2"),
        uri("URI holds no text", "cannot be read", "%ff%fe"),
        uri("URI holds a zero byte", "no file name", "x%00.bin"),
        uri("data URI without comma", "comma", "data:application/octet-stream"),
        uri("data URI is not base64", "base64", "data:;base64,@@@@"),
        uri("data URI too short", "byteLength", "data:;base64,AAAA"),
        uri("data URI wrongly escaped", "percent", "data:,%zz"),
        Case::new("URI is a socket", "regular file", |f| {
            let scene = f.write("in/bad.gltf", GltfFile::square().gltf("socket.bin"));
            // The file stays when the listener is gone.
            drop(UnixListener::bind(f.path().join("in/socket.bin")).unwrap());
            scene
        }),
        Case::new("buffer file too short", "byteLength", |f| {
            f.write("short.bin", [0; 100]);
            f.write("bad.gltf", GltfFile::square().gltf("short.bin"))
        }),
        Case::new("scene is a folder", "regular file", |f| {
            f.write("scene.glb/file", "");
            f.path().join("scene.glb").display().to_string()
        }),
        Case::new("scene is missing", "cannot be read", |f| f.path().join("none.glb").display().to_string()),
        value("buffer longer than the BIN chunk", "byteLength", "/buffers/0/byteLength", json!(1_000_000)),
        value("buffer of 2 to the 63", "byteLength", "/buffers/0/byteLength", json!(1u64 << 63)),
        file("view of a second buffer without URI", "no uri", |f| {
            f.push("/buffers", json!({"byteLength": 400})).with("/bufferViews/0/buffer", json!(1))
        }),
        value("buffer shorter than its views", "leave buffer", "/buffers/0/byteLength", json!(64)),
    ]
}

fn accessors() -> Vec<Case> {
    let sparse = |name, says, sparse: Value| value(name, says, "/accessors/0/sparse", sparse);
    // View 4 holds the indices 0, 1, 2, 0, 2, 3; view 0 the positions.
    let patch = |count: u64, offset: u64, component: u32, view: u32| json!({"count": count, "indices": {"bufferView": 4, "byteOffset": offset, "componentType": component}, "values": {"bufferView": view}});
    vec![
        value("view of no buffer", "buffer 7", "/bufferViews/0/buffer", json!(7)),
        value("view beyond its buffer", "leave buffer", "/bufferViews/0/byteLength", json!(100_000)),
        value("view of 2 to the 64", "leave buffer", "/bufferViews/0/byteLength", json!(u64::MAX)),
        value("view offset overflows", "leave buffer", "/bufferViews/0/byteOffset", json!(u64::MAX - 8)),
        value("stride below the element", "overlap", "/bufferViews/0/byteStride", json!(8)),
        value("stride beyond the view", "leave bufferView", "/bufferViews/0/byteStride", json!(252)),
        value("stride of 2 to the 63", "leave bufferView", "/bufferViews/0/byteStride", json!(1u64 << 63)),
        value("accessor of no view", "bufferView 77", "/accessors/0/bufferView", json!(77)),
        value("one element too many", "leave bufferView", "/accessors/0/count", json!(5)),
        value("four billion positions", "at most", "/accessors/0/count", json!(4_000_000_000u64)),
        value("2 to the 63 positions", "at most", "/accessors/0/count", json!(1u64 << 63)),
        value("sixty million positions", "leave bufferView", "/accessors/0/count", json!(60_000_000)),
        value("four billion indices", "at most", "/accessors/4/count", json!(4_000_000_000u64)),
        value("accessor offset beyond the view", "leave bufferView", "/accessors/0/byteOffset", json!(4)),
        value("accessor offset overflows", "leave bufferView", "/accessors/0/byteOffset", json!(u64::MAX)),
        value("component type unknown", "componentType", "/accessors/0/componentType", json!(99)),
        value("component type signed int", "componentType", "/accessors/0/componentType", json!(5124)),
        value("type unknown", "type", "/accessors/0/type", json!("VEC9")),
        value("positions of scalars", "cannot hold positions", "/accessors/0/type", json!("SCALAR")),
        value("positions of matrices", "cannot hold positions", "/accessors/0/type", json!("MAT4")),
        value("positions of large integers", "cannot hold positions", "/accessors/0/componentType", json!(5125)),
        value("indices of floats", "cannot hold indices", "/accessors/4/componentType", json!(5126)),
        value("indices of vectors", "cannot hold indices", "/accessors/4/type", json!("VEC3")),
        value("colours of scalars", "cannot hold colours", "/accessors/3/type", json!("SCALAR")),
        value("fewer normals than positions", "3 elements", "/accessors/1/count", json!(3)),
        value("fewer texture coordinates", "1 elements", "/accessors/2/count", json!(1)),
        value(
            "four billion zeros",
            "at most",
            "/accessors/0",
            json!({"componentType": 5126, "count": 4_000_000_000u64, "type": "VEC3"}),
        ),
        value(
            "sixty million zeros",
            "without bytes",
            "/accessors/0",
            json!({"componentType": 5126, "count": 60_000_000, "type": "VEC3"}),
        ),
        value("no such positions", "accessor 99", "/meshes/0/primitives/0/attributes/POSITION", json!(99)),
        value("no such normals", "accessor 99", "/meshes/0/primitives/0/attributes/NORMAL", json!(99)),
        value("no such indices", "accessor 99", "/meshes/0/primitives/0/indices", json!(99)),
        value("mode unknown", "mode", "/meshes/0/primitives/0/mode", json!(9)),
        file("two indices for a strip", "no triangles", |f| {
            f.with("/accessors/4/count", json!(2)).with("/meshes/0/primitives/0/mode", json!(5))
        }),
        sparse("sparse replaces too many", "replaces 5 of 4", patch(5, 0, 5123, 0)),
        sparse("sparse of four billion", "replaces", patch(4_000_000_000, 0, 5123, 0)),
        sparse("sparse index out of range", "sparse indices", patch(1, 1, 5123, 0)),
        sparse("sparse indices decrease", "not increasing", patch(2, 4, 5123, 0)),
        sparse("sparse index twice", "not increasing", patch(2, 0, 5121, 0)),
        sparse(
            "sparse indices of floats",
            "no integer",
            json!({"count": 1, "indices": {"bufferView": 4, "componentType": 5126}, "values": {"bufferView": 0}}),
        ),
        sparse(
            "sparse indices of no view",
            "bufferView 55",
            json!({"count": 1, "indices": {"bufferView": 55, "componentType": 5123}, "values": {"bufferView": 0}}),
        ),
        sparse("sparse values of no view", "bufferView 55", patch(1, 0, 5123, 55)),
        sparse("sparse values beyond their view", "leave bufferView", patch(3, 0, 5123, 3)),
        sparse("sparse indices beyond their view", "leave bufferView", patch(3, 10, 5123, 0)),
        value(
            "four billion sparse zeros",
            "at most",
            "/accessors/0",
            json!({"componentType": 5126, "count": 4_000_000_000u64, "type": "VEC3", "sparse": patch(1, 0, 5123, 0)}),
        ),
    ]
}

fn values() -> Vec<Case> {
    let float = |name, says, at: usize, value: f32| file(name, says, move |f| f.patch(at, &value.to_le_bytes()));
    let index = |name, says, value: u16| file(name, says, move |f| f.patch(INDICES_AT + 4, &value.to_le_bytes()));
    vec![
        file("positions NaN", "finite", |f| f.patch(POSITIONS_AT, &[0xff; 48])),
        file("position NaN in both triangles", "finite", |f| f.patch(POSITIONS_AT, &f32::NAN.to_le_bytes())),
        float("position far beyond the world", "origin", POSITIONS_AT, 1e30),
        index("index one too large", "accessor 4, element 2", 4),
        index("index is the restart value", "vertex 65535", u16::MAX),
        file("index of four bytes too large", "vertex 4294967295", |f| {
            let (f, view) = f.append(&[0xff; 24]);
            f.with("/accessors/4", json!({"bufferView": view, "componentType": 5125, "count": 6, "type": "SCALAR"}))
        }),
        file("index of one byte too large", "vertex 255", |f| {
            let f = f.patch(COLOURS_AT, &[255; 12]);
            f.with("/accessors/4", json!({"bufferView": 3, "componentType": 5121, "count": 6, "type": "SCALAR"}))
        }),
        value("material out of range", "material 9", "/meshes/0/primitives/0/material", json!(9)),
    ]
}

fn nodes() -> Vec<Case> {
    let nodes = |name, says, nodes: Value| value(name, says, "/nodes", nodes);
    vec![
        nodes("node is its own child", "ancestor", json!([{"mesh": 0}, {"children": [1]}])),
        nodes(
            "two nodes are each other's child",
            "ancestor",
            json!([{"mesh": 0}, {"children": [2]}, {"children": [1]}]),
        ),
        nodes("root in a ring", "ancestor", json!([{"mesh": 0, "children": [1]}, {"children": [0]}])),
        nodes("node with two parents", "two parents", json!([{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}])),
        nodes("child listed twice", "two parents", json!([{"children": [1, 1]}, {"mesh": 0}])),
        nodes("child out of range", "child 9", json!([{"mesh": 0, "children": [9]}])),
        nodes("mesh out of range", "mesh 9", json!([{"mesh": 9}])),
        nodes("mesh out of range, not shown", "mesh 9", json!([{"mesh": 0}, {"mesh": 9}])),
        file("nodes too deep", "from a root down", |f| {
            let mut chain: Vec<Value> = (1..=300).map(|child| json!({"children": [child]})).collect();
            chain.push(json!({"mesh": 0}));
            f.with("/nodes", chain.into())
        }),
        file("nodes a hundred thousand deep", "from a root down", |f| {
            let mut chain: Vec<Value> = (1..=100_000).map(|child| json!({"children": [child]})).collect();
            chain.push(json!({"mesh": 0}));
            f.with("/nodes", chain.into())
        }),
        value("scene out of range", "scene 3", "/scene", json!(3)),
        value("scene lists a missing node", "node 4", "/scenes/0/nodes", json!([4])),
        nodes(
            "matrix with perspective",
            "last row",
            json!([{"mesh": 0, "matrix": [1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}]),
        ),
        nodes(
            "matrix of 15 numbers",
            "JSON",
            json!([{"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0]}]),
        ),
        nodes("translation out of the world", "origin", json!([{"mesh": 0, "translation": [1e30, 0, 0]}])),
        nodes("scale out of the world", "origin", json!([{"mesh": 0, "scale": [1e30, 1e30, 1e30]}])),
        nodes("scale to nothing", "no triangles", json!([{"mesh": 0, "scale": [0, 0, 0]}])),
        file("scales overflow together", "no triangles", |f| {
            let mut chain: Vec<Value> =
                (1..=9).map(|child| json!({"children": [child], "scale": [1e38, 1e38, 1e38]})).collect();
            chain.push(json!({"mesh": 0}));
            f.with("/nodes", chain.into())
        }),
        nodes("translation beyond f32", "JSON", json!([{"mesh": 0, "translation": [1e300, 0, 0]}])),
        nodes("no meshes placed", "no triangles", json!([{}])),
    ]
}
