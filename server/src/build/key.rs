//! Names of unfinished work: what an image depends on, hashed, so that a resumed build takes only
//! what is still right.

use crate::scene::Scene;
use crate::tree::Places;
use ldi_protocol::index::BuildSettings;

/// Raised whenever construction or coding gives other bytes for the same input.
const VERSION: u32 = 34;

/// Hash of everything in a scene that a picture of it depends on.
pub fn scene_key(scene: &Scene) -> [u8; 32] {
    let mut h = blake3::Hasher::new();
    for p in scene.meshes.iter().flat_map(|m| &m.primitives) {
        h.update(&p.material.to_le_bytes());
        for v in p.positions.iter().chain(&p.normals) {
            v.to_array().iter().for_each(|f| {
                h.update(&f.to_le_bytes());
            });
        }
        for v in &p.uvs {
            v.to_array().iter().for_each(|f| {
                h.update(&f.to_le_bytes());
            });
        }
        for f in p.colours.iter().flatten() {
            h.update(&f.to_le_bytes());
        }
        for i in p.triangles.iter().flatten() {
            h.update(&i.to_le_bytes());
        }
    }
    for i in &scene.instances {
        h.update(&i.mesh.to_le_bytes());
        i.world_from_mesh.to_cols_array().iter().for_each(|f| {
            h.update(&f.to_le_bytes());
        });
    }
    for t in &scene.textures {
        h.update(&t.width.to_le_bytes());
        for texel in &t.rgba {
            h.update(texel);
        }
    }
    h.update(format!("{:?}", scene.materials).as_bytes());
    *h.finalize().as_bytes()
}

/// Key of an LDI tree that depends on a scene, the places of its references and `how` alone.
pub fn tree_key(scene: &[u8; 32], how: &dyn std::fmt::Debug, places: &Places) -> [u8; 32] {
    let mut h = blake3::Hasher::new();
    h.update(&VERSION.to_le_bytes());
    h.update(scene);
    let Places { positions, outside, candidates, coverage, area_m2, rays, .. } = places;
    let places = (positions, outside, candidates, coverage, area_m2, rays);
    h.update(format!("tree {how:?} {places:?}").as_bytes());
    *h.finalize().as_bytes()
}

/// Key of images that depend on scene, settings and `plan` alone.
pub fn images_key(scene: &[u8; 32], settings: &BuildSettings, plan: &dyn std::fmt::Debug) -> [u8; 32] {
    let mut h = blake3::Hasher::new();
    h.update(&VERSION.to_le_bytes());
    h.update(scene);
    // Debug prints every digit of a float, and every field there is.
    h.update(format!("{settings:?}{plan:?}").as_bytes());
    *h.finalize().as_bytes()
}
