//! What is seen from near a region: rays from eyes spread over its floors.
//!
//! In: eyes per region. Out: which cells of the octree they see within [`NEAR_M`], and what share
//! of what surrounds them are backs of surfaces: eyes inside of a solid see nothing else.

use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use ldi_protocol::mesh::Alpha;
use rayon::prelude::*;
use std::f64::consts::PI;

/// What is farther is not seen from near, metres. Larger: a hill a street away counts as seen from
/// a roof.
const NEAR_M: f64 = 24.0;
/// Rays per eye, evenly over all directions.
const RAYS: u32 = 192;
/// Eyes are inside of a solid when this share of what surrounds them are backs. Smaller: rooms
/// with some turned walls are lost.
const BACKS: f64 = 0.65;
/// The same where the floor is a back, too: the inside of a hull, with pipes in it.
const BACKS_ON_BACK: f64 = 0.3;
/// Rays that look down more steeply than this tell nothing of what is around an eye: the floor
/// shows its face inside of a solid, too.
const DOWN: f64 = -0.3;

/// What the eyes of one region see.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Seen {
    /// Cells of the octree, ascending.
    pub cells: Vec<u32>,
    /// Triangles of the cells that an eye sees, summed over eyes.
    pub sightings: u64,
    /// Eyes.
    pub eyes: u32,
    /// Rays that met something, and those that met its back; without those that look down.
    pub met: [u32; 2],
    /// Rays that do not look down.
    pub level: u32,
}

impl Seen {
    /// Whether most of what surrounds the eyes are backs; `on_back`: what they stand on is a back.
    pub fn is_inside_a_solid(&self, on_back: bool) -> bool {
        let [met, backs] = self.met.map(f64::from);
        met > 0.5 * f64::from(self.level) && backs > if on_back { BACKS_ON_BACK } else { BACKS } * met
    }
}

/// What eyes see, region by region. `eyes`: (region, eye), regions ascending; `turned`: the file's
/// fronts are backs; `triangles`: of a cell.
pub(super) fn survey(
    caster: &Caster,
    eyes: &[(u32, DVec3)],
    turned: bool,
    triangles: &(dyn Fn(u32) -> u64 + Sync),
) -> Vec<(u32, Seen)> {
    let directions: Vec<DVec3> = (0..RAYS).map(direction).collect();
    let of_region = |eyes: &&[(u32, DVec3)]| {
        let parts: Vec<Seen> = eyes.par_iter().map(|(_, eye)| from(caster, *eye, &directions, turned)).collect();
        let mut all = Seen::default();
        for mut part in parts {
            part.sightings = part.cells.iter().map(|c| triangles(*c)).sum();
            all.cells.extend(part.cells);
            all.level += part.level;
            all.eyes += 1;
            all.sightings += part.sightings;
            all.met = [all.met[0] + part.met[0], all.met[1] + part.met[1]];
        }
        all.cells.sort_unstable();
        all.cells.dedup();
        (eyes[0].0, all)
    };
    let regions: Vec<&[(u32, DVec3)]> = eyes.chunk_by(|a, b| a.0 == b.0).collect();
    regions.par_iter().map(of_region).collect()
}

/// Directions on a golden spiral.
fn direction(n: u32) -> DVec3 {
    let y = 1.0 - (2.0 * f64::from(n) + 1.0) / f64::from(RAYS);
    let turn = f64::from(n) * PI * (3.0 - 5.0_f64.sqrt());
    let r = (1.0 - y * y).sqrt();
    DVec3::new(r * turn.cos(), y, r * turn.sin())
}

fn from(caster: &Caster, eye: DVec3, directions: &[DVec3], turned: bool) -> Seen {
    let ray = |d: &DVec3| Ray { origin: eye, direction: *d, t_min: 0.0, t_max: NEAR_M };
    let rays: Vec<Ray> = directions.iter().map(ray).collect();
    let mut hits = vec![None; rays.len()];
    caster.trace_batch(&rays, &CellSet::all(), &mut hits);
    let mut out = Seen::default();
    for (ray, hit) in rays.iter().zip(&hits) {
        let is_level = ray.direction.y > DOWN;
        out.level += u32::from(is_level);
        let Some(hit) = hit else { continue };
        out.cells.push(caster.cell_of(hit.triangle));
        let surface = caster.surface(hit, ray);
        // Leaves and fences have no inside.
        if is_level && caster.scene().materials[surface.material as usize].alpha == Alpha::Opaque {
            let instance = &caster.scene().instances[surface.source.instance as usize];
            let mirrored = instance.world_from_mesh.matrix3.determinant() < 0.0;
            let is_back = (surface.geometric_normal.dot(ray.direction) > 0.0) != (mirrored != turned);
            out.met = [out.met[0] + 1, out.met[1] + u32::from(is_back)];
        }
    }
    out.cells.sort_unstable();
    out.cells.dedup();
    out
}
