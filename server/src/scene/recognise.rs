//! What a file is, by its first bytes, where it is no scene format that is read: messages name it
//! and the program that converts it.

use super::error::Fault;

/// A format that is not read.
struct Known {
    /// Bytes at the start.
    magic: &'static [u8],
    what: &'static str,
    remedy: &'static str,
}

const BLENDER: &str = "open it in Blender and export it as glTF (.glb)";
const ITS_PROGRAM: &str = "open it in the program that wrote it and export it as glTF (.glb) or OBJ";
const CAD: &str = "open it in FreeCAD or the program that wrote it, and export meshes as glTF (.glb), OBJ or STL";
const POINTS: &str = "make a mesh of polygons from it first, for example in CloudCompare or MeshLab";
const PICTURE: &str = "name the scene, not one of its pictures";

const fn known(magic: &'static [u8], what: &'static str, remedy: &'static str) -> Known {
    Known { magic, what, remedy }
}

/// Longer ones before their own beginnings.
const KNOWN: [Known; 45] = [
    known(b"Kaydara FBX Binary", "an FBX file", BLENDER),
    known(b"; FBX", "an FBX file (text)", BLENDER),
    known(b"BLENDER", "a Blender file", BLENDER),
    known(b"\xff\xfe\xff\x0eS\0k\0", "a SketchUp file", "open it in SketchUp and export it as glTF (.glb)"),
    known(b"\xff\xfe\xff", "a SketchUp file", "open it in SketchUp and export it as glTF (.glb)"),
    known(
        b"\xd0\xcf\x11\xe0",
        "a compound file, as Revit (.rvt, .rfa), 3ds Max (.max) and SolidWorks write",
        ITS_PROGRAM,
    ),
    known(b"3D Geometry File Format", "a Rhino file (.3dm)", "open it in Rhino and export it as glTF (.glb) or OBJ"),
    known(b"AC10", "an AutoCAD drawing (.dwg)", ITS_PROGRAM),
    known(b"AutoCAD Binary DXF", "a DXF drawing", ITS_PROGRAM),
    known(b"ISO-10303-21", "a STEP file", CAD),
    known(b"ISO-10303", "a STEP file", CAD),
    known(b"PXR-USDC", "a USD file", "open it in Blender, or convert it by usd2gltf, to glTF (.glb)"),
    known(b"#usda", "a USD file (text)", "open it in Blender, or convert it by usd2gltf, to glTF (.glb)"),
    known(b"Ogawa", "an Alembic file", BLENDER),
    known(b"\x89HDF", "an HDF5 file, as Alembic writes", BLENDER),
    known(b"LASF", "a LAS or LAZ point cloud", POINTS),
    known(b"ASTM-E57", "an E57 point cloud", POINTS),
    known(b"# .PCD", "a PCD point cloud", POINTS),
    known(b"VERSION .7", "a PCD point cloud", POINTS),
    known(
        b"version https://git-lfs",
        "a pointer of Git LFS, not the file itself",
        "run `git lfs pull` where it was cloned, or download the file itself",
    ),
    known(b"b3dm", "a tile of 3D Tiles (.b3dm)", "take the GLB out of it, for example by 3d-tiles-tools b3dmToGlb"),
    known(b"i3dm", "a tile of 3D Tiles (.i3dm)", "take the GLB out of it, for example by 3d-tiles-tools i3dmToGlb"),
    known(b"cmpt", "a tile of 3D Tiles (.cmpt)", "take the GLB out of it, for example by 3d-tiles-tools cmptToGlb"),
    known(b"pnts", "a point cloud of 3D Tiles (.pnts)", POINTS),
    known(b"#VRML", "a VRML file", "open it in MeshLab or Blender and export it as glTF (.glb) or PLY"),
    known(b"OFF\n", "an OFF file", "open it in MeshLab and export it as PLY"),
    known(b"OFF\r", "an OFF file", "open it in MeshLab and export it as PLY"),
    known(b"COFF", "an OFF file", "open it in MeshLab and export it as PLY"),
    known(b"DRACO", "a Draco file (.drc)", "convert it to glTF or PLY, for example by draco_decoder"),
    known(b"FORM", "an IFF file, as LightWave (.lwo) and Maya (.mb) write", ITS_PROGRAM),
    known(b"//Maya ASCII", "a Maya file", "open it in Maya and export it as glTF or FBX, then by Blender as .glb"),
    known(b"xof ", "a DirectX file (.x)", "open it in MeshLab or Blender and export it as glTF (.glb)"),
    known(b"IDP3", "a Quake model", BLENDER),
    known(b"Version 8", "a JT file", CAD),
    known(b"Version 9", "a JT file", CAD),
    known(b"Version 10", "a JT file", CAD),
    known(b"7z\xbc\xaf\x27\x1c", "a 7z archive", "unpack it and name the scene in it"),
    known(b"Rar!", "a RAR archive", "unpack it and name the scene in it"),
    known(b"\xfd7zXZ\0", "an xz archive", "unpack it and name the scene in it"),
    known(b"BZh", "a bzip2 archive", "unpack it and name the scene in it"),
    known(b"\x28\xb5\x2f\xfd", "a Zstandard file", "unpack it and name the scene in it"),
    known(b"%PDF", "a PDF file", ITS_PROGRAM),
    known(b"\x89PNG", "a PNG picture", PICTURE),
    known(b"\xff\xd8\xff", "a JPEG picture", PICTURE),
    known(b"\x1f\x8b", "a gzip file within another archive", "unpack it and name the scene in it"),
];

/// Bytes in which a text says what it is.
const HEAD: usize = 4096;

/// The fault that names the format, where the bytes tell it.
pub(super) fn foreign(name: &str, bytes: &[u8]) -> Option<Fault> {
    let fault = |what: &str, remedy: &str| Some(Fault::unsupported("file", format!("it is {what}"), remedy));
    if let Some(k) = KNOWN.iter().find(|k| bytes.starts_with(k.magic)) {
        let head = String::from_utf8_lossy(&bytes[..bytes.len().min(HEAD)]);
        let named_ifc = name.to_ascii_lowercase().ends_with(".ifc");
        return match k.what {
            "a STEP file" if cfg!(not(feature = "ifc")) && head.contains("IFC") => {
                fault("an IFC file", "build ldi-server with its feature `ifc`, or convert the file to glTF (.glb)")
            }
            "a STEP file" if named_ifc && !head.contains("FILE_SCHEMA") => Some(Fault::invalid(
                "header",
                "names no schema within its first 4096 bytes",
                "copy the file again, or export it again",
            )),
            what => fault(what, k.remedy),
        };
    }
    if bytes.len() > 262 && bytes[257..].starts_with(b"ustar") {
        return fault("a tar archive", "unpack it and name the scene in it");
    }
    let extension = name.rsplit_once('.').map(|(_, e)| e.to_ascii_lowercase()).unwrap_or_default();
    // A chunk number and the length of the whole file.
    if bytes.starts_with(b"MM") && extension == "3ds" {
        return fault("a 3DS file", BLENDER);
    }
    let start = bytes.iter().position(|b| !b.is_ascii_whitespace() && !b"\xef\xbb\xbf".contains(b))?;
    let text = String::from_utf8_lossy(&bytes[start..bytes.len().min(start + HEAD)]).to_ascii_lowercase();
    if text.starts_with("<!doctype html") || text.starts_with("<html") {
        let remedy = "download the file itself; a server answered with a page instead, often one that asks to sign in";
        return fault("an HTML page", remedy);
    }
    if text.starts_with('<') {
        return match text {
            t if t.contains("<collada") => fault("a COLLADA file (.dae)", BLENDER),
            t if t.contains("<x3d") => fault("an X3D file", BLENDER),
            t if t.contains("<ifcxml") || t.contains("<ex:iso_10303") => {
                fault("an IFC file (XML)", "export it as STEP text (.ifc)")
            }
            t if t.contains("citygml") || t.contains("citymodel") => {
                fault("a CityGML file", "convert it to glTF or OBJ, for example by citygml-tools and cjio")
            }
            t if t.contains("<kml") => fault("a KML file", "name the model that it refers to, as glTF or OBJ"),
            _ => fault("an XML file", "convert it to .gltf, .glb, .obj, .ply or .stl"),
        };
    }
    // A drawing starts with the group code 0 and its first section.
    if text.starts_with('0') && text.lines().nth(1).is_some_and(|l| l.trim() == "section") {
        return fault("a DXF drawing", ITS_PROGRAM);
    }
    let names = |word: &str| text.contains(word);
    if text.starts_with('{') && names("\"geometricerror\"") && names("\"root\"") && !names("\"accessors\"") {
        let remedy = "name one of the glTF files that it lists; 3d-tiles-tools converts other tiles";
        return fault("a tileset of 3D Tiles", remedy);
    }
    if text.starts_with('{') && text.contains("\"cityjson\"") {
        return fault("a CityJSON file", "convert it to OBJ or glTF, for example by `cjio FILE export glb`");
    }
    match extension.as_str() {
        "usdz" => fault("a USDZ file", "open it in Blender, or convert it by usd2gltf, to glTF (.glb)"),
        "fbx" | "dae" | "3ds" | "abc" | "blend" | "x3d" | "usd" | "usda" | "usdc" => {
            fault(&format!("named .{extension}, a format that is not read"), BLENDER)
        }
        "ifc" | "stp" | "step" | "igs" | "iges" | "sat" | "x_t" => {
            fault(&format!("named .{extension}, a format that is not read"), CAD)
        }
        "las" | "laz" | "e57" | "pcd" | "pts" | "xyz" => fault("a point cloud", POINTS),
        _ => None,
    }
}

/// Whether bytes are the JSON text of a glTF file, whatever the file's name ends in.
pub(super) fn is_gltf_text(bytes: &[u8]) -> bool {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let head = &text[..text.len().min(HEAD)];
    // A document may hold its nodes before its asset.
    let names = |word: &[u8]| head.windows(word.len()).any(|w| w == word);
    text.starts_with(b"{") && [&b"\"asset\""[..], b"\"meshes\"", b"\"accessors\"", b"\"nodes\""].into_iter().any(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_known_by_their_bytes() {
        for (name, bytes, says) in [
            ("a", &b"Kaydara FBX Binary  \0"[..], "FBX"),
            ("a.ifc", b"ISO-10303-21;\nHEADER;", "no schema"),
            ("a.stp", b"ISO-10303-21;\nFILE_SCHEMA(('AUTOMOTIVE'));", "STEP"),
            ("a.glb", b"<!DOCTYPE html><html>sign in", "HTML"),
            ("a.glb", b"\n<html>", "HTML"),
            ("a.json", b"{\"asset\":{\"version\":\"1.0\"},\"geometricError\":1,\"root\":{}}", "tileset"),
            ("a.3ds", b"MM\x10\0\0\0", "3DS"),
            ("a.dxf", b"  0\nSECTION\n", "DXF"),
            ("a.xml", b"<?xml version='1.0'?><a/>", "XML"),
        ] {
            let said = foreign(name, bytes).expect("known").in_file(name).to_string();
            assert!(said.contains(says), "{said}");
        }
        assert!(foreign("a.txt", b"Dear sir").is_none() && foreign("a", b"").is_none());
    }

    #[test]
    fn gltf_text_is_known_without_its_name() {
        assert!(is_gltf_text(b"\xef\xbb\xbf\n{\"nodes\": [], \"asset\": {}}"));
        assert!(!is_gltf_text(b"{\"colour\": 1}") && !is_gltf_text(b"v 0 0 0"));
    }
}
