//! The test scenes load completely: triangle counts as their list states them, counted by another
//! reader.

use std::path::PathBuf;

use super::super::load;

fn expect(name: &str, triangles: u64, unique: u64, instances: usize, textures: usize) {
    let shared = std::env::var_os("LDI_SHARED")
        .map_or_else(|| concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared").into(), PathBuf::from);
    let path = shared.join("scenes").join(name);
    if !path.is_file() {
        println!("SKIPPED: no {}", path.display());
        return;
    }
    let scene = load(path.to_str().unwrap()).unwrap();
    assert_eq!(scene.triangles(), triangles);
    assert_eq!(scene.unique_triangles(), unique);
    assert_eq!(scene.instances.len(), instances);
    assert_eq!(scene.textures.len(), textures);
    scene.check().unwrap();
}

#[test]
fn small_house() {
    expect("small_house.glb", 145_842, 112_232, 85, 83);
}

#[test]
fn clinic() {
    expect("clinic.glb", 1_349_733, 302_298, 9_476, 0);
}

#[test]
fn black_forest() {
    expect("black_forest.glb", 1_080_993, 316_943, 1_671, 162);
}

#[test]
fn willow_garage() {
    expect("willow_garage.glb", 6_862, 6_862, 46, 6);
}

#[test]
fn bleach() {
    expect("bleach.glb", 26_328, 26_328, 120, 58);
}

#[test]
fn west_riverside_mep() {
    expect("west_riverside_mep.glb", 6_922_987, 702_511, 29_103, 0);
}
