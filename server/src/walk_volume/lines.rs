//! Floor heights: exact intersections of the scene's triangles with vertical lines, one line per
//! raster cell.
//!
//! In: a scene and a raster over its horizontal bounds. Out: for each line, all heights at which
//! it meets a triangle. A line stands at a fixed pseudo-random place within its raster cell, so
//! that a thin rail along an axis cannot fall between all lines at once. Vertical triangles have
//! no horizontal area and meet no line: an eye does not stand on them.

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
    pub(crate) fn line(&self, i: u32, k: u32) -> DVec2 {
        let j = jitter(i, k);
        self.origin + (DVec2::new(f64::from(i), f64::from(k)) + j) * self.pitch_m
    }
}

/// Two numbers in [0.05, 0.95) from a cell's place, by an integer hash (Wang 2007): the same on
/// every machine.
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

/// Lines of a raster: from and to along x and z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Window {
    /// First line along x and z.
    pub from: [u32; 2],
    /// The one after the last.
    pub to: [u32; 2],
}

/// Heights along the lines of raster rows `rows`: (line within these rows, height), ascending.
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
    let window = Window { from: [0, rows.start], to: [raster.size[0], rows.end] };
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
                triangle(t.map(|v| world[v as usize]), raster, &window, |line, y| out.push((line, y as f32)));
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

/// Meets one triangle with the lines of a window: `met` takes the line, row-major within the
/// window, and the height, metres.
pub(crate) fn triangle(v: [DVec3; 3], raster: &Raster, window: &Window, mut met: impl FnMut(u32, f64)) {
    let flat = v.map(|p| DVec2::new(p.x, p.z));
    let area = (flat[1] - flat[0]).perp_dot(flat[2] - flat[0]);
    if area == 0.0 {
        return;
    }
    let low = (flat[0].min(flat[1]).min(flat[2]) - raster.origin) / raster.pitch_m;
    let high = (flat[0].max(flat[1]).max(flat[2]) - raster.origin) / raster.pitch_m;
    // Saturating conversions.
    let lines = |axis: usize| {
        let from = (low[axis].floor().max(0.0) as u32).max(window.from[axis]);
        from..((high[axis].floor().max(-1.0) + 1.0) as u32).min(window.to[axis])
    };
    let width = window.to[0] - window.from[0];
    for k in lines(1) {
        for i in lines(0) {
            let p = raster.line(i, k);
            // Barycentric weights, all of the sign of the area inside and on the border.
            let w: [f64; 3] =
                std::array::from_fn(|c| (flat[(c + 2) % 3] - flat[(c + 1) % 3]).perp_dot(p - flat[(c + 1) % 3]) / area);
            if w.iter().all(|w| *w >= 0.0) {
                met((k - window.from[1]) * width + i - window.from[0], w[0] * v[0].y + w[1] * v[1].y + w[2] * v[2].y);
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
        let all = Window { from: [0, 0], to: [30, 30] };
        let corners = [at(-9.0, -9.0), at(30.0, -9.0), at(-9.0, 30.0)];
        triangle(corners, &raster, &all, |line, y| hits.push((line, y)));
        assert_eq!(hits.len(), 900, "each line meets it once");
        for (line, y) in hits {
            let p = raster.line(line % 30, line / 30);
            assert!((y - (2.0 + p.x + 0.5 * p.y)).abs() < 1e-5);
        }
        let part = Window { from: [4, 6], to: [9, 8] };
        let mut of_part = Vec::new();
        triangle(corners, &raster, &part, |line, _| of_part.push(line));
        assert_eq!(of_part, (0..10).collect::<Vec<_>>(), "the lines of a window, numbered within it");
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
        let all = Window { from: [0, 0], to: [10, 10] };
        let wall = [DVec3::ZERO, DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.5, 3.0, 0.5)];
        triangle(wall, &raster, &all, |line, y| panic!("line {line} at {y}"));
    }
}
