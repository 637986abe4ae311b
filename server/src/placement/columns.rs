//! Floor heights: exact intersections of the scene's triangles with vertical lines, one line per raster cell.
//!
//! In: a scene and a raster over its horizontal bounds. Out: for each line, all heights at which it meets a triangle.
//! A line stands at a fixed pseudo-random place within its raster cell, so that a thin rail along an axis cannot fall between
//! all lines at once. Vertical triangles have no horizontal area and meet no line: an eye does not stand on them.

use crate::scene::Scene;
use glam::{DVec2, DVec3};
use ldi_protocol::Aabb;

/// A raster of vertical lines over x and z.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Raster {
    /// Corner of cell (0, 0): smallest x and z.
    pub origin: DVec2,
    /// Edge of a cell, metres.
    pub pitch_m: f64,
    /// Cells along x and z.
    pub size: [u32; 2],
}

impl Raster {
    /// Where the line of a cell stands: (x, z).
    fn line(&self, i: u32, k: u32) -> DVec2 {
        let j = jitter(i, k);
        self.origin + (DVec2::new(f64::from(i), f64::from(k)) + j) * self.pitch_m
    }
}

/// Two numbers in [0.05, 0.95) from a cell's place, by an integer hash (Wang 2007): the same on every machine.
fn jitter(i: u32, k: u32) -> DVec2 {
    let hash = |mut h: u32| {
        h = (h ^ 61) ^ (h >> 16);
        h = h.wrapping_mul(9);
        h ^= h >> 4;
        h = h.wrapping_mul(0x27d4_eb2d);
        h ^ (h >> 15)
    };
    let a = hash(i.wrapping_mul(0x9e37_79b9) ^ hash(k));
    let b = hash(a ^ 0x68bc_21eb);
    DVec2::new(f64::from(a >> 8), f64::from(b >> 8)) / f64::from(1u32 << 24) * 0.9 + 0.05
}

/// Heights along the lines of raster rows `rows`: (cell within these rows, height), ascending.
pub(crate) fn heights(
    scene: &Scene,
    mesh_bounds: &[Aabb],
    raster: &Raster,
    rows: std::ops::Range<u32>,
) -> Vec<(u32, f32)> {
    let mut out = Vec::new();
    let z0 = raster.origin.y + f64::from(rows.start) * raster.pitch_m;
    let z1 = raster.origin.y + f64::from(rows.end) * raster.pitch_m;
    let mut world = Vec::new();
    for instance in &scene.instances {
        let local = &mesh_bounds[instance.mesh as usize];
        let world_from_mesh = instance.world_from_mesh;
        let b = Aabb::from_points(local.corners().map(|c| world_from_mesh.transform_point3(c)));
        if b.is_empty() || b.max.z < z0 || b.min.z > z1 {
            continue;
        }
        for primitive in &scene.meshes[instance.mesh as usize].primitives {
            world.clear();
            world.extend(primitive.positions.iter().map(|p| world_from_mesh.transform_point3(p.as_dvec3())));
            for t in &primitive.triangles {
                let corners = t.map(|v| world[v as usize]);
                triangle(corners, raster, &rows, &mut out);
            }
        }
    }
    out.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    out
}

/// Bounds of every mesh in its own space.
pub(crate) fn mesh_bounds(scene: &Scene) -> Vec<Aabb> {
    let of = |m: &crate::scene::Mesh| {
        Aabb::from_points(m.primitives.iter().flat_map(|p| &p.positions).map(|p| p.as_dvec3()))
    };
    scene.meshes.iter().map(of).collect()
}

/// Adds the heights at which one triangle meets the lines of `rows`.
fn triangle(v: [DVec3; 3], raster: &Raster, rows: &std::ops::Range<u32>, out: &mut Vec<(u32, f32)>) {
    let flat = v.map(|p| DVec2::new(p.x, p.z));
    let area = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]);
    if area == 0.0 {
        return;
    }
    let low = flat[0].min(flat[1]).min(flat[2]) - raster.origin;
    let high = flat[0].max(flat[1]).max(flat[2]) - raster.origin;
    let cell = |x: f64, n: u32| (x / raster.pitch_m).floor().clamp(0.0, f64::from(n - 1)) as u32;
    let (i0, i1) = (cell(low.x, raster.size[0]), cell(high.x, raster.size[0]));
    let k0 = cell(low.y, raster.size[1]).max(rows.start);
    let k1 = cell(high.y, raster.size[1]).min(rows.end - 1);
    for k in k0..=k1 {
        for i in i0..=i1 {
            let p = raster.line(i, k);
            // Barycentric weights, all of the sign of the area inside and on the border.
            let w: [f64; 3] =
                std::array::from_fn(|c| (flat[(c + 2) % 3] - flat[(c + 1) % 3]).perp_dot(p - flat[(c + 1) % 3]) / area);
            if w.iter().all(|w| *w >= 0.0) {
                let y = w[0] * v[0].y + w[1] * v[1].y + w[2] * v[2].y;
                out.push(((k - rows.start) * raster.size[0] + i, y as f32));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sloping_triangle_is_met_at_its_height() {
        let raster = Raster { origin: DVec2::new(-1.0, -1.0), pitch_m: 0.1, size: [30, 30] };
        // y = 2 + x + 0.5 z over a large triangle that covers the raster.
        let at = |x: f64, z: f64| DVec3::new(x, 2.0 + x + 0.5 * z, z);
        let mut hits = Vec::new();
        triangle([at(-9.0, -9.0), at(30.0, -9.0), at(-9.0, 30.0)], &raster, &(0..30), &mut hits);
        assert_eq!(hits.len(), 900, "each line meets it once");
        for (cell, y) in hits {
            let p = raster.line(cell % 30, cell / 30);
            assert!((f64::from(y) - (2.0 + p.x + 0.5 * p.y)).abs() < 1e-5);
        }
    }

    #[test]
    fn lines_stay_in_their_cells_and_differ() {
        let places: Vec<DVec2> = (0..100).map(|i| jitter(i, 7)).collect();
        assert!(places.iter().all(|p| p.min_element() >= 0.05 && p.max_element() < 0.95));
        let mean = places.iter().sum::<DVec2>() / 100.0;
        assert!((mean - 0.5).abs().max_element() < 0.1, "{mean}");
    }

    #[test]
    fn a_vertical_triangle_meets_nothing() {
        let raster = Raster { origin: DVec2::ZERO, pitch_m: 0.1, size: [10, 10] };
        let mut hits = Vec::new();
        triangle([DVec3::ZERO, DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.5, 3.0, 0.5)], &raster, &(0..10), &mut hits);
        assert!(hits.is_empty());
    }
}
