//! A scanned flat: one open, noisy mesh of what the scanner saw, with holes where it saw nothing.

use super::Specimen;
use super::kit::{Site, at};
use glam::{DVec3, Vec3};
use ldi_server::scene::{Mesh, Primitive};
use std::collections::BTreeMap;

/// Edge of the mesh's quads, metres.
const GRID_M: f64 = 0.1;
/// Largest displacement of a vertex along each axis.
const NOISE_M: f64 = 0.015;
/// Height of the rooms, in quads.
const HIGH: i32 = 25;

/// A room: x and z ranges in quads.
const ROOMS: [[i32; 4]; 3] = [[0, 44, 0, 60], [46, 80, 0, 32], [46, 80, 34, 60]];
/// Doorways, 21 quads high: x and z ranges through the walls, and whether they run along x.
const DOORS: [([i32; 4], bool); 2] = [([44, 46, 12, 21], true), ([60, 69, 32, 34], false)];
/// Pieces of furniture: x and z ranges and height in quads, and colour.
const BUMPS: [([i32; 5], [f32; 3]); 7] = [
    // Table, sofa, sideboard.
    ([14, 26, 40, 48, 7], [0.55, 0.36, 0.2]),
    ([2, 10, 8, 28, 5], [0.45, 0.2, 0.2]),
    ([38, 43, 26, 40, 9], [0.7, 0.65, 0.55]),
    // Bed, wardrobe.
    ([64, 79, 2, 20, 5], [0.3, 0.4, 0.6]),
    ([47, 53, 1, 12, 20], [0.5, 0.38, 0.28]),
    // Worktop, box.
    ([47, 79, 54, 59, 9], [0.65, 0.65, 0.68]),
    ([72, 77, 38, 43, 4], [0.6, 0.5, 0.3]),
];
/// Holes: middle and diameter, metres.
const HOLES: [(DVec3, f64); 16] = [
    (at(2.6, 0.0, 2.2), 0.6),
    (at(3.6, 0.0, 5.2), 0.4),
    (at(1.3, 0.0, 3.6), 0.3),
    (at(5.2, 0.0, 2.4), 0.5),
    (at(6.9, 0.0, 2.7), 0.3),
    (at(5.6, 0.0, 4.3), 0.6),
    (at(6.6, 0.0, 5.0), 0.2),
    (at(0.0, 1.2, 4.0), 0.6),
    (at(2.0, 1.6, 0.0), 0.5),
    (at(4.4, 0.8, 0.5), 0.4),
    (at(8.0, 1.4, 2.6), 0.6),
    (at(8.0, 0.4, 4.6), 0.4),
    (at(6.4, 1.5, 6.0), 0.5),
    (at(2.0, 2.5, 3.0), 0.6),
    (at(6.0, 2.5, 1.5), 0.5),
    (at(1.9, 0.7, 4.3), 0.2),
];

/// The mesh so far; vertices by their place on the lattice.
#[derive(Default)]
struct Surface {
    vertices: BTreeMap<[i32; 3], u32>,
    mesh: Primitive,
}

/// A number in [-1, 1) that depends on a lattice point and an axis alone.
fn noise(p: [i32; 3], axis: u32) -> f64 {
    let mut h = 0x9e37_79b9_u32.wrapping_mul(axis + 1);
    for c in p {
        h = (h ^ c as u32).wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
        h = h.wrapping_mul(0xc2b2_ae35);
        h ^= h >> 16;
    }
    f64::from(h) / f64::from(u32::MAX) * 2.0 - 1.0
}

impl Surface {
    fn vertex(&mut self, p: [i32; 3], colour: [f32; 3]) -> u32 {
        let mesh = &mut self.mesh;
        *self.vertices.entry(p).or_insert_with(|| {
            let exact = at(f64::from(p[0]), f64::from(p[1]), f64::from(p[2])) * GRID_M;
            let moved = exact + at(noise(p, 0), noise(p, 1), noise(p, 2)) * NOISE_M;
            let tone = (0.85 + 0.15 * noise(p.map(|c| c.div_euclid(4)), 3)) as f32;
            mesh.positions.push(moved.as_vec3());
            mesh.colours.push(colour.map(|c| c * tone));
            (mesh.positions.len() - 1) as u32
        })
    }

    /// `nu` by `nv` quads from a corner along two lattice directions; seen from where u x v points.
    fn sheet(
        &mut self,
        corner: [i32; 3],
        u: ([i32; 3], i32),
        v: ([i32; 3], i32),
        colour: [f32; 3],
        keep: impl Fn([i32; 3]) -> bool,
    ) {
        for j in 0..v.1 {
            for i in 0..u.1 {
                let p = |i: i32, j: i32| std::array::from_fn(|k| corner[k] + u.0[k] * i + v.0[k] * j);
                let corners: [[i32; 3]; 4] = [p(i, j), p(i + 1, j), p(i + 1, j + 1), p(i, j + 1)];
                let middle =
                    corners.iter().fold(DVec3::ZERO, |m, c| m + DVec3::from(c.map(f64::from))) * (0.25 * GRID_M);
                let least: [i32; 3] = std::array::from_fn(|k| corners.iter().map(|c| c[k]).min().unwrap_or(0));
                if keep(least) && HOLES.iter().all(|(c, d)| c.distance(middle) > d * 0.5) {
                    let [a, b, c, d] = corners.map(|c| self.vertex(c, colour));
                    self.mesh.triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
    }

    /// The mesh with smooth normals.
    fn finished(mut self, material: u32) -> Primitive {
        let mut sums = vec![DVec3::ZERO; self.mesh.positions.len()];
        for t in &self.mesh.triangles {
            let [a, b, c] = t.map(|v| self.mesh.positions[v as usize].as_dvec3());
            let n = (b - a).cross(c - a);
            t.iter().for_each(|v| sums[*v as usize] += n);
        }
        self.mesh.normals = sums.iter().map(|n| n.normalize_or(DVec3::Y).as_vec3()).collect::<Vec<Vec3>>();
        self.mesh.material = material;
        self.mesh
    }
}

/// Whether a quad of a ground plan lies in a rectangle.
fn inside([x0, x1, z0, z1]: [i32; 4], x: i32, z: i32) -> bool {
    (x0..x1).contains(&x) && (z0..z1).contains(&z)
}

/// A flat of three rooms as a scanner sees it.
pub(super) fn scan() -> Specimen {
    let mut site = Site::new();
    let material = site.plain([1.0, 1.0, 1.0]);
    let mut s = Surface::default();
    let (x, y, z) = ([1, 0, 0], [0, 1, 0], [0, 0, 1]);
    let door = |p: [i32; 3], beside: bool| {
        // Whether the quad at p, in a wall across x (`beside`) or z, belongs to a doorway.
        DOORS.iter().any(|(d, along_x)| {
            let within = if beside { (d[2]..d[3]).contains(&p[2]) } else { (d[0]..d[1]).contains(&p[0]) };
            let at_wall = if beside { p[0] == d[0] || p[0] == d[1] } else { p[2] == d[2] || p[2] == d[3] };
            *along_x == beside && within && at_wall && p[1] < 21
        })
    };
    let tints = [[0.8, 0.76, 0.66], [0.62, 0.72, 0.8], [0.78, 0.82, 0.68]];
    for (room, tint) in ROOMS.iter().zip(tints) {
        let [x0, x1, z0, z1] = *room;
        let (w, d) = (x1 - x0, z1 - z0);
        let bare = |p: [i32; 3]| BUMPS.iter().all(|(b, _)| !inside([b[0], b[1], b[2], b[3]], p[0], p[2]));
        s.sheet([x0, 0, z0], (z, d), (x, w), [0.5, 0.38, 0.26], bare);
        s.sheet([x0, HIGH, z0], (x, w), (z, d), [0.85, 0.85, 0.85], |_| true);
        s.sheet([x0, 0, z0], (y, HIGH), (z, d), tint, |p| !door(p, true));
        s.sheet([x1, 0, z0], (z, d), (y, HIGH), tint, |p| !door(p, true));
        s.sheet([x0, 0, z0], (x, w), (y, HIGH), tint, |p| !door(p, false));
        s.sheet([x0, 0, z1], (y, HIGH), (x, w), tint, |p| !door(p, false));
    }
    for ([x0, x1, z0, z1], along_x) in DOORS {
        let (w, d) = (x1 - x0, z1 - z0);
        let wood = [0.7, 0.62, 0.5];
        s.sheet([x0, 0, z0], (z, d), (x, w), [0.5, 0.38, 0.26], |_| true);
        s.sheet([x0, 21, z0], (x, w), (z, d), wood, |_| true);
        if along_x {
            s.sheet([x0, 0, z0], (x, w), (y, 21), wood, |_| true);
            s.sheet([x0, 0, z1], (y, 21), (x, w), wood, |_| true);
        } else {
            s.sheet([x0, 0, z0], (y, 21), (z, d), wood, |_| true);
            s.sheet([x1, 0, z0], (z, d), (y, 21), wood, |_| true);
        }
    }
    for ([x0, x1, z0, z1, high], colour) in BUMPS {
        let (w, d) = (x1 - x0, z1 - z0);
        s.sheet([x0, high, z0], (z, d), (x, w), colour, |_| true);
        s.sheet([x0, 0, z0], (z, d), (y, high), colour, |_| true);
        s.sheet([x1, 0, z0], (y, high), (z, d), colour, |_| true);
        s.sheet([x0, 0, z0], (y, high), (x, w), colour, |_| true);
        s.sheet([x0, 0, z1], (x, w), (y, high), colour, |_| true);
    }
    site.draft.scene.meshes.push(Mesh { name: "scan".into(), primitives: vec![s.finished(material)] });
    site.place(0, DVec3::ZERO, 0.0);

    site.stand([
        at(2.0, 0.0, 1.2),
        // Beside holes of the floor.
        at(2.6, 0.0, 2.65),
        at(2.15, 0.0, 2.2),
        at(3.3, 0.0, 5.2),
        at(1.3, 0.0, 3.3),
        at(5.2, 0.0, 2.8),
        at(5.9, 0.0, 2.4),
        at(5.2, 0.0, 4.5),
        at(6.4, 0.0, 4.7),
        at(4.5, 0.0, 1.65),
        at(6.45, 0.0, 3.3),
        at(3.4, 0.0, 1.0),
    ]);
    site.never_stand([at(2.2, 0.7, 4.4), at(4.05, 0.9, 3.4), at(5.0, 0.0, 9.0), at(-1.5, 0.0, 3.0), at(4.0, 2.5, 3.0)]);
    site.never_stand([at(2.0, -2.6, 1.2)]);
    site.specimen("scan")
}
