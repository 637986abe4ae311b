//! Files as other programs write them: each gives the picture that its list expects, or a message
//! that helps.
//!
//! The files and their list lie in `shared/inputs`; where that folder is absent, the test says so.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;

use super::super::{Scene, load};
use crate::render::{Caster, CellSet, Ray};

/// A colour as a person would call it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Seen {
    Sky,
    Red,
    Green,
    Blue,
    White,
    /// A surface of another colour.
    Other,
}

use Seen::{Blue, Green, Red, Sky, White};

/// What is expected of a file.
enum Want {
    /// Colours at points of the plane z = 0, seen from (0, 0, 5).
    Shows(&'static [(f64, f64, Seen)]),
    /// A surface of any colour at the centre.
    ShowsSome,
    /// A message with all of these words.
    Says(&'static [&'static str]),
    /// Red at the centre, or a message with all of these words: both help.
    RedOr(&'static [&'static str]),
}

use Want::{RedOr, Says, Shows, ShowsSome};

const RED: Want = Shows(&[(0.0, 0.0, Red)]);
/// An L along the lower and right sides.
const L: Want = Shows(&[(0.0, 0.0, Sky), (0.0, -0.8, Red), (0.8, 0.0, Red), (-0.8, 0.5, Sky)]);

const FILES: &[(&str, Want)] = &[
    ("g01_scene_root_is_child.gltf", RED),
    ("g03_animation_pointer.gltf", RED),
    ("g05_nulls.gltf", RED),
    ("g08_bom.gltf", RED),
    ("g10_crlf.gltf", RED),
    ("g13_bytes_after_end.glb", RED),
    ("g15a_requires_KHR_lights_punctual.gltf", RED),
    ("g15b_requires_KHR_materials_variants.gltf", RED),
    ("g15c_requires_KHR_materials_clearcoat.gltf", RED),
    ("g15f_requires_KHR_xmp_json_ld.gltf", RED),
    ("g15g_requires_EXT_mesh_features.gltf", RED),
    ("g15i_requires_KHR_node_visibility.gltf", RED),
    ("g15j_requires_MSFT_lod.gltf", RED),
    ("g15k_requires_CESIUM_primitive_outline.gltf", RED),
    ("g15l_requires_KHR_materials_transmission.gltf", RED),
    ("g18_gpu_instancing.gltf", Shows(&[(0.0, 0.0, Red), (-1.1, 0.9, Red), (1.1, -1.1, Red), (1.4, 0.0, Sky)])),
    ("g19_emissive.gltf", Shows(&[(0.0, 0.0, Green)])),
    ("g20_transmission.gltf", RED),
    ("g21_blend_07.gltf", ShowsSome),
    ("g22_coincident_sides_front.gltf", RED),
    ("g24_factor_above_1_little.gltf", RED),
    ("g26_skin_scale.gltf", Shows(&[(0.0, 0.0, Red), (0.9, -0.9, Red), (1.1, 0.0, Sky)])),
    ("g27_morph_default_weight.gltf", Shows(&[(0.0, 0.0, Red), (2.4, 0.0, Red), (-1.1, 0.0, Sky)])),
    ("g29_nan_uv.gltf", Shows(&[(0.0, 0.0, Red), (2.5, 0.0, Red)])),
    ("g30_nan_position.gltf", RED),
    ("g32_stride_0.gltf", RED),
    ("g33_rotation_0.gltf", RED),
    ("g38_missing_texture_unused_material.gltf", RED),
    ("g40_uri_spaces_raw.gltf", RED),
    ("g42_uri_unicode_raw.gltf", RED),
    ("g43_uri_unicode_encoded.gltf", RED),
    ("g46_uri_backslash.gltf", RED),
    ("g49_uri_absolute_windows.gltf", RedOr(&["wood.png", "folder"])),
    ("g50_uri_file.gltf", RedOr(&["wood.png", "folder"])),
    ("g51_uri_http.gltf", Says(&["https://example.com/wood.png", "download"])),
    ("g52_uri_query.gltf", RED),
    ("g53_texture_without_source.gltf", Shows(&[(0.0, 0.0, White)])),
    ("g54_webp_core.gltf", RED),
    ("g55_webp_required.gltf", RED),
    ("g55b_webp_used.gltf", RED),
    ("g60_png16.gltf", ShowsSome),
    ("g61_png_palette.gltf", ShowsSome),
    ("g65_jpeg_progressive.gltf", ShowsSome),
    ("g67_png16_rgb.gltf", RED),
    ("g68_png_named_jpg.gltf", RED),
    ("g70_texture_16k.gltf", Shows(&[(0.0, 0.0, White)])),
    ("g72_png_truncated.gltf", Says(&["image 0", "missing=plain"])),
    ("g73_image_empty_uri.gltf", Says(&["image 0", "no file name"])),
    ("g80_draco.gltf", RED),
    ("g81_meshopt.glb", Shows(&[(0.0, 0.0, Red), (0.9, 0.9, Red), (1.1, 0.0, Sky)])),
    ("o01_mtllib_two_files.obj", RED),
    ("o04_mtllib_backslash.obj", RED),
    ("o07_mtllib_missing.obj", Says(&["line 1", "gone.mtl", "missing=plain"])),
    ("o10_Tr_1.obj", RED),
    ("o11_d_0.obj", RED),
    ("o12_Kd_0_with_map.obj", RED),
    ("o14_map_kd_lower.obj", RED),
    ("o16_Kd_spectral.obj", ShowsSome),
    ("o18_d_percent.obj", RED),
    ("o19_d_above_1.obj", RED),
    ("o24_map_absolute.obj", RED),
    ("o26_map_case.obj", RED),
    ("o27_map_scale.obj", Shows(&[(0.0, 0.0, Blue), (0.5, 0.5, Red), (-0.5, 0.5, Red), (-0.5, -0.5, Red)])),
    ("o28_map_d.obj", RED),
    ("o29_png_alpha.obj", Shows(&[(0.0, 0.0, Green)])),
    ("o30_bmp.obj", RED),
    ("o30_dds.obj", RED),
    ("o30_ico.obj", RED),
    ("o30_jp2.obj", RED),
    ("o30_pcx.obj", RED),
    ("o30_ppm.obj", RED),
    ("o30_tga.obj", RED),
    ("o30_tga_rle.obj", RED),
    ("o30_webp.obj", RED),
    ("o32_hdr.obj", Says(&["x.hdr", "Radiance", "convert"])),
    ("o34_map_Ka_only.obj", RED),
    ("o35_latin1_names.obj", RED),
    ("o36_gbk_names.obj", RED),
    ("o37_latin1_texture.obj", RED),
    ("o40_usemtl_before_mtllib.obj", RED),
    ("o41_usemtl_case.obj", Shows(&[(0.0, 0.0, White)])),
    ("o50_nan_normal.obj", RED),
    ("o52_qnan_uv.obj", RED),
    ("o54_nan_position_unused.obj", RED),
    ("o55_missing_vt.obj", RED),
    ("o56_missing_vn.obj", RED),
    ("o58_one_corner_face.obj", RED),
    ("o59_empty_face.obj", RED),
    ("o61_bad_index_one_face.obj", RedOr(&["line 13", "99"])),
    ("o62_xyzrgba.obj", RED),
    ("o63_rgb255.obj", RED),
    ("o64_w_0.obj", RED),
    ("o65_w_weight.obj", RED),
    ("o66_concave_L.obj", L),
    ("o67_concave_start_reflex.obj", L),
    (
        "o69_keyhole.obj",
        Shows(&[(0.0, 0.0, Sky), (0.75, 0.0, Red), (0.0, -0.75, Red), (-0.75, 0.7, Red), (0.4, 0.4, Sky)]),
    ),
    ("o70_continuation.obj", RED),
    ("o75_comma.obj", Says(&["line 2", "comma"])),
    ("o76_trailing_slashes.obj", RED),
    ("o77_numbers.obj", RED),
    ("o80_no_final_newline.obj", RED),
    ("o82_comment_after.obj", RED),
    ("o83_upper_keywords.obj", RED),
    ("o84_nul_bytes.obj", RED),
    ("o86_lines_only.obj", Says(&["no faces"])),
    ("o87_points_only.obj", Says(&["no faces"])),
    ("o88_vt_four.obj", RED),
    ("o93_closed_polygon.obj", L),
    ("p02_tristrips_restart.ply", Shows(&[(0.0, 0.0, Red), (0.9, 0.8, Red), (-0.9, -0.8, Red)])),
    ("p03_cr.ply", RED),
    ("p04_crlf.ply", RED),
    ("p06_little_double_ushort.ply", RED),
    ("p08_list_uint_count.ply", RED),
    ("p09_short_positions.ply", RED),
    ("p10_nan_unused.ply", RED),
    ("p11_nan_used.ply", RED),
    ("p12_points.ply", Says(&["point cloud"])),
    ("p13_concave.ply", L),
    ("p15_float_colour.ply", RED),
    ("p16_float_colour_255.ply", RED),
    ("p21_count_too_large.ply", RedOr(&["line"])),
    ("p24_trailing_words.ply", RED),
    ("p25_normals_nan.ply", RED),
    ("p27_texture_file_lower.ply", RED),
    ("p28_empty_texcoord_name.ply", Shows(&[(0.0, 0.0, White)])),
    ("p29_binary_cr.ply", RED),
    ("p30_blank_line.ply", RED),
    ("sub/g48_uri_parent.gltf", RedOr(&["outside.png", "folder"])),
    ("sub/g48b_uri_5C.gltf", RedOr(&["Red Wall.png", "folder"])),
    ("sub/o25_map_parent.obj", RedOr(&["redwall.png", "folder"])),
    ("x01.zip", RED),
    ("x02.usdz", Says(&["USDZ", "Blender"])),
    ("x05.dae", Says(&["COLLADA", "Blender"])),
    ("x09.blend", Says(&["Blender file", "export"])),
    ("x10.obj.gz", RED),
    ("x11.ply.gz", RED),
    ("x12.las", Says(&["point cloud", "mesh"])),
    ("x14.skp", Says(&["SketchUp", "export"])),
    ("x15.rvt", Says(&["Revit", "export"])),
    ("x16_noextension", RED),
    ("x17_glb_named.bin", RED),
    ("x18_glb_named.gltf", RED),
    ("x19_gltf_named.glb", RED),
    ("x20_lfs_pointer.glb", Says(&["Git LFS", "git lfs pull"])),
    ("x24_zip.glb", RedOr(&["zip"])),
    ("x30_gltf1.glb", Says(&["glTF 1.0", "gltf-pipeline"])),
];

/// What is seen from (0, 0, 5) through a point of the plane z = 0.
fn seen(caster: &Caster, x: f64, y: f64) -> Seen {
    let eye = DVec3::new(0.0, 0.0, 5.0);
    let ray = Ray::new(eye, (DVec3::new(x, y, 0.0) - eye).normalize());
    let Some(hit) = caster.trace(&ray, &CellSet::all()) else { return Sky };
    let [r, g, b] = caster.shade(&hit, &ray, None);
    // A third of the strongest still leaves no doubt what to call a colour.
    match () {
        () if r > 0.05 && r > 3.0 * g.max(b) => Red,
        () if g > 0.05 && g > 3.0 * r.max(b) => Green,
        () if b > 0.05 && b > 3.0 * r.max(g) => Blue,
        () if r.min(g).min(b) > 0.3 => White,
        () => Seen::Other,
    }
}

/// What is wrong with what a file gave.
fn fault(name: &str, want: &Want, got: Result<Scene, String>) -> Option<String> {
    let unhelpful = |said: &str, words: &[&str]| {
        let missing: Vec<_> = words.iter().filter(|w| !said.contains(**w)).collect();
        let file = Path::new(name).file_name().and_then(|n| n.to_str()).unwrap_or_default();
        (!missing.is_empty() || !said.contains(file)).then(|| format!("does not say {missing:?}: {said}"))
    };
    let scene = match (got, want) {
        (Err(said), Says(words) | RedOr(words)) => return unhelpful(&said, words),
        (Err(said), _) => return Some(format!("is refused: {said}")),
        (Ok(_), Says(_)) => return Some("is shown".into()),
        (Ok(scene), _) => scene,
    };
    if let Err(e) = scene.check() {
        return Some(format!("is not sound: {e}"));
    }
    let caster = Caster::of_scene(Arc::new(scene), false);
    let points: &[(f64, f64, Seen)] = match want {
        Shows(points) => points,
        RedOr(_) => &[(0.0, 0.0, Red)],
        _ => return (seen(&caster, 0.0, 0.0) == Sky).then(|| "shows the sky".into()),
    };
    let wrong = points.iter().find(|(x, y, colour)| seen(&caster, *x, *y) != *colour);
    wrong.map(|(x, y, colour)| format!("at ({x}, {y}) {:?} instead of {colour:?}", seen(&caster, *x, *y)))
}

/// Files that are not shown as expected, and why that is so.
const KNOWN_FAULTS: &[(&str, &str)] =
    &[("g22_coincident_sides_front.gltf", "both faces of every triangle are drawn, and the first of two is seen")];

#[test]
fn every_file_gives_what_its_list_expects() {
    let shared = std::env::var_os("LDI_SHARED")
        .map_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared").into(), PathBuf::from);
    let folder = shared.join("inputs");
    if !folder.is_dir() {
        println!("SKIPPED: no {}", folder.display());
        return;
    }
    let mut faults = Vec::new();
    for (name, want) in FILES {
        let path = folder.join(name);
        let got = load(&path.display().to_string()).map_err(|e| e.to_string());
        let fault = fault(name, want, got);
        let known = KNOWN_FAULTS.iter().any(|(file, _)| file == name);
        match fault {
            Some(fault) if !known => faults.push(format!("{name} {fault}")),
            None if known => faults.push(format!("{name} is right now; take it off the list of known faults")),
            _ => {}
        }
    }
    assert!(faults.is_empty(), "{} of {} files:\n{}", faults.len(), FILES.len(), faults.join("\n"));
}

/// The list here names every scene of the folder.
#[test]
fn no_file_is_left_out() {
    let shared = std::env::var_os("LDI_SHARED")
        .map_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared").into(), PathBuf::from);
    let Ok(readme) = std::fs::read_to_string(shared.join("inputs/README.md")) else {
        println!("SKIPPED: no {}", shared.join("inputs/README.md").display());
        return;
    };
    let rows = readme.lines().filter_map(|l| l.strip_prefix("| ")?.split(" |").next());
    let files: Vec<&str> = rows.filter(|name| *name != "file").collect();
    assert!(files.len() > 100, "{files:?}");
    let missing: Vec<_> = files.iter().filter(|f| !FILES.iter().any(|(name, _)| name == *f)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}
