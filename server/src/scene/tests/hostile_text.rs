//! Bad OBJ and PLY files, and files of no known format.

use std::os::unix::fs::symlink;

use super::hostile::Case;

/// All of them.
pub(super) fn cases() -> Vec<Case> {
    [objs(), libraries(), ply_headers(), ply_bodies(), others()].into_iter().flatten().collect()
}

/// Three vertices and a face in OBJ.
const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

fn obj(name: &'static str, says: &'static str, text: impl AsRef<[u8]> + 'static) -> Case {
    Case::new(name, says, move |f| f.write("bad.obj", text.as_ref()))
}

fn objs() -> Vec<Case> {
    // Line 5 follows the triangle.
    let line = |name, says, line: &str| obj(name, says, format!("{TRIANGLE}{line}\n"));
    vec![
        obj("OBJ empty", "no faces", ""),
        obj("OBJ of garbage", "no faces", vec![0xfe; 5000]),
        obj("OBJ of points", "no faces", "v 0 0 0\nv 1 0 0\np 1 2\n"),
        obj("OBJ positions NaN", "finite", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        obj("OBJ position infinite", "finite", "v inf 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        obj("OBJ position overflows", "finite", "v 1e99 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        line("OBJ position with a comma", "comma", "v 0,5 0 0"),
        line("OBJ position is a word", "line 5", "v 0 zero 0"),
        line("OBJ position of two", "line 5", "v 0 0"),
        line("OBJ position of eight", "line 5", "v 0 0 0 1 1 1 1 1"),
        line("OBJ texture coordinate of none", "line 5", "vt"),
        line("OBJ normal of two", "line 5", "vn 0 1"),
        line("OBJ face of zero", "line 5", "f 0 1 2"),
        line("OBJ face beyond", "line 5", "f 1 2 4"),
        line("OBJ face far beyond", "line 5", "f 1 2 4000000000"),
        line("OBJ face of 2 to the 64", "line 5", "f 1 2 18446744073709551616"),
        line("OBJ face before the first", "line 5", "f -1 -2 -4"),
        line("OBJ face of the smallest integer", "line 5", "f 1 2 -9223372036854775808"),
        obj("OBJ faces of two and one", "no faces", "v 0 0 0\nv 1 0 0\nf 1 2\nf 1\n"),
        line("OBJ face of words", "line 5", "f a b c"),
        line("OBJ corner of four", "line 5", "f 1/1/1/1 2 3"),
        line("OBJ corner of slashes", "line 5", "f // // //"),
        line("OBJ out of the world", "origin", "v 1e20 0 0\nf 1 2 4"),
    ]
}

fn libraries() -> Vec<Case> {
    let names = |name, says, path: &'static str| {
        Case::new(name, says, move |f| f.write("in/bad.obj", format!("mtllib {path}\nusemtl m\n{TRIANGLE}")))
    };
    let holds = |name, says, library: &'static str| {
        Case::new(name, says, move |f| {
            f.write("no.png", "no picture");
            f.write("a.mtl", library);
            f.write("bad.obj", format!("mtllib a.mtl\nusemtl m\n{TRIANGLE}"))
        })
    };
    vec![
        names("MTL missing", "cannot be read", "missing.mtl"),
        names("MTL goes up", "folder", "../a.mtl"),
        names("MTL goes up with backslashes", "folder", "..\\a.mtl"),
        names("MTL is absolute", "folder", "/etc/passwd"),
        names("MTL from the web", "scheme", "http://127.0.0.1:9/a.mtl"),
        names("MTL without name", "no file name", ""),
        names("MTL is a folder", "regular file", "."),
        Case::new("MTL is a link out", "link", |f| {
            let secret = f.write("secret.mtl", "newmtl m\n");
            let scene = f.write("in/bad.obj", format!("mtllib a.mtl\n{TRIANGLE}"));
            symlink(secret, f.path().join("in/a.mtl")).unwrap();
            scene
        }),
        holds("MTL colour of two", "line 2", "newmtl m\nKd 1 0"),
        holds("MTL colour of none", "line 2", "newmtl m\nKd"),
        holds("MTL colour of words", "line 2", "newmtl m\nKd red"),
        holds("MTL colour before a material", "line 1", "Kd 1 1 1"),
        holds("MTL opacity of two", "line 2", "newmtl m\nd 1 1"),
        holds("MTL texture before a material", "line 1", "map_Kd no.png"),
        holds("MTL texture missing", "line 2", "newmtl m\nmap_Kd missing.png"),
        holds("MTL texture goes up", "folder", "newmtl m\nmap_Kd ../../etc/passwd"),
        holds("MTL texture is no picture", "no format that is read", "newmtl m\nmap_Kd no.png"),
    ]
}

/// A PLY header for one triangle of floats, then a body.
fn ply_of(format: &str, vertices: &str, faces: &str, body: &[u8]) -> Vec<u8> {
    let header = format!(
        "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {faces}\nproperty list char int vertex_indices\nend_header\n"
    );
    [header.as_bytes(), body].concat()
}

fn ply(name: &'static str, says: &'static str, bytes: impl AsRef<[u8]> + 'static) -> Case {
    Case::new(name, says, move |f| f.write("bad.ply", bytes.as_ref()))
}

/// Three vertices and a face with more properties than corners.
fn ply_faces(comments: &str, looks: &str, face: &str) -> String {
    format!(
        "ply\nformat ascii 1.0\n{comments}element vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
         property list uchar int vertex_indices\n{looks}end_header\n0 0 0\n1 0 0\n0 1 0\n{face}\n"
    )
}

fn ply_headers() -> Vec<Case> {
    let header = |name, says, lines: &str| ply(name, says, format!("ply\nformat ascii 1.0\n{lines}\nend_header\n"));
    vec![
        ply("PLY empty", "line 1", ""),
        ply("PLY of garbage", "line 1", vec![0x90; 3000]),
        ply("PLY without format", "format", "ply\nelement vertex 0\nend_header\n"),
        ply("PLY of unknown format", "format", "ply\nformat binary_middle_endian 1.0\nend_header\n"),
        ply("PLY version 2", "line 2", "ply\nformat ascii 2.0\nend_header\n"),
        ply("PLY without end_header", "end_header", "ply\nformat ascii 1.0\n"),
        ply(
            "PLY header without end",
            "end_header",
            [b"ply\nformat ascii 1.0\n".to_vec(), b"comment x\n".repeat(100_000)].concat(),
        ),
        ply("PLY header line without end", "line", [b"ply\n".to_vec(), vec![b'x'; 1 << 20]].concat()),
        header("PLY property first", "line 3", "property float x"),
        header("PLY property of unknown type", "line 4", "element vertex 1\nproperty half x"),
        header("PLY property without name", "line 4", "element vertex 1\nproperty float"),
        header("PLY list counted in floats", "line 4", "element face 1\nproperty list float int vertex_indices"),
        header("PLY property twice", "line 5", "element vertex 1\nproperty float x\nproperty float x"),
        header("PLY count negative", "line 3", "element vertex -1"),
        header("PLY count of 2 to the 64", "line 3", "element vertex 18446744073709551616"),
        header("PLY unknown line", "line 3", "elephant vertex 1"),
        header("PLY four billion of nothing", "no properties", "element nothing 4000000000"),
        header("PLY without z", "lacks", "element vertex 0\nproperty float x\nproperty float y"),
        header("PLY of nothing", "no faces", "comment nothing"),
        header("PLY face without list", "vertex_indices", "element face 1\nproperty int vertex_indices"),
    ]
}

fn ply_bodies() -> Vec<Case> {
    const POINTS: &str = "0 0 0\n1 0 0\n0 1 0\n";
    let ascii = |name, says, vertices: &str, faces: &str, body: String| {
        ply(name, says, ply_of("ascii", vertices, faces, body.as_bytes()))
    };
    let binary = |name, says, vertices: &str, faces: &str, body: &[u8]| {
        ply(name, says, ply_of("binary_little_endian", vertices, faces, body))
    };
    let face = |name, says, face: &str| ascii(name, says, "3", "1", format!("{POINTS}{face}\n"));
    let points = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].map(f32::to_le_bytes).concat();
    let with_face = |bytes: &[u8]| [&points[..], bytes].concat();
    vec![
        ascii("PLY four billion vertices", "at most", "4000000000", "1", POINTS.into()),
        ascii("PLY sixty million vertices", "do not fit", "60000000", "1", POINTS.into()),
        ascii("PLY four billion faces", "do not fit", "3", "4000000000", format!("{POINTS}3 0 1 2\n")),
        ascii("PLY point cloud", "point cloud", "3", "0", POINTS.into()),
        ascii("PLY cut in the vertices", "do not fit", "4", "0", "0 0 0 1 0 0 0 1 0 0 0".into()),
        ascii("PLY cut within a vertex", "ends", "3", "0", "0 0 0 1 0 0 0.00000 1".into()),
        ascii("PLY position NaN", "line 11", "3", "1", POINTS.replacen("1 0 0", "1 nan 0", 1) + "3 0 1 2"),
        ascii("PLY position infinite", "line 10", "3", "1", POINTS.replacen("0 0 0", "0 0 inf", 1) + "3 0 1 2"),
        ascii("PLY position beyond f32", "finite", "3", "1", POINTS.replacen("0 0 0", "0 0 1e200", 1) + "3 0 1 2"),
        ascii("PLY position is a word", "no number", "3", "1", POINTS.replacen("1 0 0", "1 x 0", 1) + "3 0 1 2"),
        ascii("PLY out of the world", "origin", "3", "1", POINTS.replacen("1 0 0", "1 1e20 0", 1) + "3 0 1 2"),
        face("PLY face beyond", "vertex 3 of 3", "3 0 1 3"),
        face("PLY face negative", "vertex -1", "3 0 1 -1"),
        face("PLY face of fractions", "whole", "3 0 1 1.5"),
        face("PLY face of NaN", "whole", "3 0 1 nan"),
        face("PLY list of minus one", "list of -1", "-1 0 1 2"),
        face("PLY list of a billion", "do not fit", "1000000000 0 1 2"),
        face("PLY list of infinity", "whole", "inf 0 1 2"),
        face("PLY face of two corners only", "no faces", "2 0 1"),
        face("PLY list cut short", "do not fit", "9 0 1 2"),
        binary("PLY binary, four billion vertices", "at most", "4000000000", "1", &points),
        binary("PLY binary, sixty million vertices", "do not fit", "60000000", "1", &points),
        binary("PLY binary, a billion faces", "do not fit", "3", "1000000000", &with_face(&[3, 0, 0, 0, 0])),
        binary("PLY binary, list of minus one", "list of -1", "3", "1", &with_face(&[0xff; 13])),
        binary("PLY binary, list cut short", "do not fit", "3", "1", &with_face(&[100, 0, 0, 0, 0])),
        binary(
            "PLY binary, vertex beyond",
            "of 3",
            "3",
            "1",
            &with_face(&[3, 0, 0, 0, 0, 1, 0, 0, 0, 0xff, 0xff, 0xff, 0x7f]),
        ),
        binary("PLY binary, position NaN, then a list of minus one", "list of -1", "3", "1", &[0xff; 64]),
        binary("PLY binary, cut in the vertices", "do not fit", "3", "0", &points[..30]),
        ply(
            "PLY big-endian read as such",
            "of 3",
            ply_of("binary_big_endian", "3", "1", &with_face(&[3, 0, 0, 0, 0, 0, 0, 0, 1, 2, 0, 0, 0])),
        ),
        ply("PLY of no vertices, then of three", "twice", {
            let of = |n: u32| format!("element vertex {n}\nproperty float x\nproperty float y\nproperty float z\n");
            let faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
            let body = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
            format!("ply\nformat ascii 1.0\n{}{}{faces}{body}", of(0), of(3))
        }),
        ply("PLY vertices twice", "twice", {
            let vertices = "element vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
            format!("ply\nformat ascii 1.0\n{vertices}{vertices}end_header\n0 0 0 0 0 0\n")
        }),
        ply("PLY texture goes up", "folder", {
            let properties =
                "property float x\nproperty float y\nproperty float z\nproperty float s\nproperty float t\n";
            format!(
                "ply\nformat ascii 1.0\ncomment TextureFile ../x.png\nelement vertex 3\n{properties}element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 0 0\n0 1 0 0 0\n3 0 1 2\n"
            )
        }),
        ply("PLY texture coordinates of two corners", "face 0", {
            let looks = "property list uchar float texcoord\n";
            ply_faces("", looks, "3 0 1 2 4 0 0 1 1")
        }),
        ply("PLY texture coordinates beyond", "do not fit", {
            ply_faces("", "property list uint float texcoord\n", "3 0 1 2 4000000000 0 0")
        }),
        ply("PLY second of one pictures", "texture 1 of 1", {
            let looks = "property list uchar float texcoord\nproperty int texnumber\n";
            ply_faces("comment TextureFile a.png\n", looks, "3 0 1 2 6 0 0 1 1 1 0 1")
        }),
        ply("PLY skipped element forged", "do not fit", {
            "ply\nformat binary_little_endian 1.0\nelement camera 4000000000\nproperty list uint double view\nend_header\n\u{1}\u{2}\u{3}"
        }),
    ]
}

fn others() -> Vec<Case> {
    vec![
        Case::new("FBX", "Blender", |f| f.write("bad.fbx", "Kaydara FBX Binary")),
        Case::new("unknown format", "no scene format", |f| f.write("bad.xyzw", "Dear sir")),
        Case::new("no extension", "no scene format", |f| f.write("bad", "x")),
        Case::new("unknown built-in scene", "builtin", |_| "builtin:nowhere".into()),
        Case::new("built-in scene with a wrong parameter", "parameter", |_| "builtin:pipes?colour=1".into()),
    ]
}
