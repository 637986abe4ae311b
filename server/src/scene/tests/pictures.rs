//! Pictures in all formats that are read.

use serde_json::json;

use super::super::load;
use super::Folder;
use super::gltf_file::GltfFile;
use super::picture_files::pictures;

#[test]
fn every_format_is_read_whatever_its_name() {
    for (name, bytes) in pictures() {
        let (file, view) = GltfFile::square().append(&bytes);
        let scene = load(&Folder::new().write("a.glb", file.with("/images/0", json!({"bufferView": view})).glb()));
        let scene = scene.unwrap_or_else(|e| panic!("{name}: {e}"));
        let near = |texel: &[u8; 4]| texel.iter().zip([220, 20, 20, 255]).all(|(a, b)| a.abs_diff(b) < 8);
        assert!(scene.textures[0].rgba.iter().all(near), "{name}: {:?}", scene.textures[0].rgba[0]);
        // Only PNG and JPEG are stored as they are; the icon holds a PNG file.
        assert_eq!(scene.textures[0].file.is_empty(), name != "a.ico", "{name}");
    }
}

#[test]
fn extensions_name_pictures_where_textures_do_not() {
    let of = |name: &str| pictures().into_iter().find(|(n, _)| *n == name).expect("is there").1;
    let cases = [("EXT_texture_webp", "a.webp"), ("KHR_texture_basisu", "a.ktx2"), ("MSFT_texture_dds", "a.dds")];
    for (extension, picture) in cases {
        let (file, view) = GltfFile::square().append(&of(picture));
        let mut extensions = json!({});
        extensions[extension] = json!({"source": 1});
        let file = file.push("/images", json!({"bufferView": view})).with("/extensionsRequired", json!([extension]));
        let scene = load(
            &Folder::new().write("a.glb", file.clone().with("/textures/0", json!({"extensions": extensions})).glb()),
        );
        assert!(scene.unwrap().textures[0].rgba[0][0].abs_diff(220) < 8, "{extension}");
        // A picture that every reader knows comes first.
        let both = file.with("/textures/0", json!({"source": 0, "extensions": extensions}));
        let scene = load(&Folder::new().write("a.glb", both.glb())).unwrap();
        assert_eq!(scene.textures[0].width, 2, "{extension}");
        assert!(!scene.textures[0].file.is_empty());
    }
}

#[test]
fn headers_that_promise_too_much_are_refused() {
    let of = |name: &str| pictures().into_iter().find(|(n, _)| *n == name).expect("is there").1;
    let with = |name: &str, at: usize, bytes: &[u8]| {
        let mut out = of(name);
        out[at..at + bytes.len()].copy_from_slice(bytes);
        out
    };
    // 15,872 columns and rows.
    let side = [0u8, 62];
    let wide = [0u8, 62, 0, 0];
    let forged = [
        ("TGA", with("a.tga", 12, &[side, side].concat())),
        ("GIF", with("a.gif", 6, &[side, side].concat())),
        ("BMP", with("a.bmp", 18, &[wide, wide].concat())),
        ("DDS", with("a.dds", 12, &[wide, wide].concat())),
        ("KTX2", with("a.ktx2", 20, &[wide, wide].concat())),
        ("PNM", b"P6 15872 15872 255\n\xff".to_vec()),
    ];
    for (name, bytes) in forged {
        let (file, view) = GltfFile::square().append(&bytes);
        let said = load(&Folder::new().write("a.glb", file.with("/images/0", json!({"bufferView": view})).glb()));
        let said = said.map(drop).expect_err(name).to_string();
        assert!(said.contains("image 0"), "{name}: {said}");
    }
}
