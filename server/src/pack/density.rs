//! How densely textures lie on what a cell draws.
//!
//! In: the scene, and a cell of its octree. Out: per material the code of
//! [`CellEntry::texel_density`](ldi_protocol::index::CellEntry::texel_density), from which both
//! ends tell the levels of its texture that a view can show.

use crate::octree::{Cell, Clusters};
use crate::scene::Scene;
use glam::{DVec2, DVec3};
use ldi_protocol::index::EVERY_LEVEL;
use ldi_protocol::mesh::Alpha;
use std::collections::BTreeMap;

/// The materials of a cell, ascending, and their codes.
pub(super) fn materials_of(scene: &Scene, clusters: &Clusters, cell: &Cell) -> (Vec<u32>, Vec<i8>) {
    let mut least = BTreeMap::<u32, f64>::new();
    for (instance, cluster) in &cell.content {
        let cluster = &clusters.clusters[*cluster as usize];
        let primitive = &scene.meshes[cluster.mesh as usize].primitives[cluster.primitive as usize];
        let entry = least.entry(primitive.material).or_insert(f64::INFINITY);
        let material = &scene.materials[primitive.material as usize];
        let Some(texture) = material.texture.filter(|_| !primitive.uvs.is_empty()) else { continue };
        if material.alpha != Alpha::Opaque {
            *entry = 0.0;
            continue;
        }
        let texture = &scene.textures[texture as usize];
        let texels = DVec2::new(texture.width.into(), texture.height.into());
        let place = scene.instances[*instance as usize].world_from_mesh.matrix3;
        for triangle in &cluster.triangles {
            let corners = primitive.triangles[*triangle as usize];
            let at = corners.map(|v| place * primitive.positions[v as usize].as_dvec3());
            let on = corners.map(|v| primitive.uvs[v as usize].as_dvec2() * texels);
            if let Some(density) = texels_per_metre(at, on) {
                // Not a number is less than any.
                *entry = if density.is_nan() { 0.0 } else { entry.min(density) };
            }
        }
    }
    least.into_iter().map(|(material, density)| (material, code(density))).unzip()
}

/// Root mean square over directions on a triangle of how many texels lie along a metre; None
/// without an area.
fn texels_per_metre([a, b, c]: [DVec3; 3], [p, q, r]: [DVec2; 3]) -> Option<f64> {
    let ((across, other), (to_q, to_r)) = ((b - a, c - a), (q - p, r - p));
    let length = across.length();
    let along = other.dot(across) / length;
    let height = (other - across * (along / length)).length();
    // Steps over the texture by a metre along the first edge, and at right angles to it.
    let u = to_q / length;
    let v = (to_r - u * along) / height;
    (length > 0.0 && height > 0.0).then(|| (0.5 * (u.length_squared() + v.length_squared())).sqrt())
}

fn code(density: f64) -> i8 {
    let quarters = (4.0 * density.log2()).floor();
    if quarters >= -127.0 { quarters.min(127.0) as i8 } else { EVERY_LEVEL }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The longer of the steps over a texture to the next pixels, by differences: on triangles
    /// turned and mapped at random, seen from anywhere before them, it is no shorter than what the
    /// density promises.
    #[test]
    fn no_pixel_shows_a_finer_level_than_the_density_says() {
        let mut state = 7u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f64 / (1u64 << 24) as f64 * 2.0 - 1.0
        };
        let (mut tried, mut closest) = (0, f64::INFINITY);
        while tried < 200_000 {
            let mut corner = || DVec3::new(random(), random(), random());
            let at = [corner(), corner(), corner()];
            let mut texel = || DVec2::new(random(), random()) * 300.0;
            let on = [texel(), texel(), texel()];
            let Some(density) = texels_per_metre(at, on) else { continue };
            let (eye, focal) = (DVec3::new(0.0, 0.0, 3.0 + random()), 500.0);
            let hit = |x: f64, y: f64| {
                let ray = DVec3::new(x / focal, y / focal, -1.0);
                let normal = (at[1] - at[0]).cross(at[2] - at[0]);
                let t = (at[0] - eye).dot(normal) / ray.dot(normal);
                let place = eye + ray * t;
                // Weights by areas.
                let weight = |i: usize| {
                    (at[(i + 1) % 3] - place).cross(at[(i + 2) % 3] - place).dot(normal) / normal.length_squared()
                };
                (t, weight(0) * on[0] + weight(1) * on[1] + weight(2) * on[2])
            };
            let (x, y) = (random() * 500.0, random() * 300.0);
            let (depth, here) = hit(x, y);
            if !(depth > 0.1 && depth < 50.0) {
                continue;
            }
            const STEP: f64 = 1e-4;
            let (right, down) = (hit(x + STEP, y).1 - here, hit(x, y + STEP).1 - here);
            let step = right.length().max(down.length()) / STEP;
            let cos = (1.0 + (x * x + y * y) / (focal * focal)).sqrt().recip();
            let promised = density * depth / focal * cos;
            assert!(step >= promised * (1.0 - 1e-3), "{step} {promised}: {at:?} {on:?} {x} {y}");
            closest = closest.min(step / promised);
            tried += 1;
        }
        assert!(closest < 1.05, "the bound is near: {closest}");
    }

    #[test]
    fn codes_round_down_and_know_their_ends() {
        assert_eq!([1.0, 2.0, 2.3, 0.99].map(code), [0, 4, 4, -1]);
        assert_eq!([f64::INFINITY, 1e30, 1e-30, 0.0].map(code), [127, 127, EVERY_LEVEL, EVERY_LEVEL]);
        let (flat, line) = ([DVec3::ZERO, DVec3::X, DVec3::Y], [DVec3::ZERO, DVec3::X, DVec3::X * 2.0]);
        assert_eq!(texels_per_metre(flat, [DVec2::ZERO, DVec2::X * 8.0, DVec2::Y * 8.0]), Some(8.0));
        assert_eq!(texels_per_metre(flat, [DVec2::ONE; 3]), Some(0.0));
        assert_eq!(texels_per_metre(line, [DVec2::ZERO, DVec2::X, DVec2::Y]), None);
    }
}
