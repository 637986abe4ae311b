//! Splits a storey's free space at narrow places: a watershed of the distance to the walls
//! (Haumont, Debeir and Sillion 2003, "Volumetric cell-and-portal generation", in the plane;
//! basins are joined by persistence).
//!
//! In: a storey. Out: a basin per place. Flooding goes from the widest places to the narrowest;
//! where two basins meet, they are joined unless the place is a neck: narrow in itself, and
//! narrower than either basin. Under a lintel a little narrower is enough.

use super::storeys::{Ground, SIGHT_M, Storey};
use crate::render::{Caster, CellSet, Ray};
use glam::{DVec2, DVec3};
use std::collections::VecDeque;

/// No basin.
pub(super) const NONE: u32 = u32::MAX;

/// Widest half of a neck, metres. Wider openings join rooms: one sees the whole room through them
/// anyway.
const WIDEST_NECK_M: f64 = 1.3;
/// A neck has at most this share of either basin's half width. Larger: bends, columns and alcoves
/// split rooms. Smaller: rooms along a narrow corridor join it.
const NECK_SHARE: f64 = 0.78;
/// The same under a lintel.
const LINTEL_SHARE: f64 = 0.9;
/// A lintel hangs at least this far below the ceilings on both sides, metres.
const LINTEL_M: f64 = 0.12;
/// A basin's half width is at least this, metres, or it is joined to what it touches: niches and
/// noise.
const NARROWEST_M: f64 = 0.35;
/// Smallest room, m².
const SMALLEST_M2: f64 = 0.8;

/// A storey's basins.
pub(super) struct Basins {
    /// Basin per place, or [`NONE`].
    pub of: Vec<u32>,
    /// Distance to the nearest wall per place, metres.
    pub distance_m: Vec<f32>,
    /// For each basin, whether it reaches the raster's rim: the outside.
    pub outside: Vec<bool>,
    /// Area of each basin where somebody can stand, m².
    pub area_m2: Vec<f64>,
}

/// Distance to the nearest closed step, by passing on the nearest one's position (Danielsson 1980).
fn distances(ground: &Ground, s: &Storey) -> Vec<f32> {
    let n = ground.places();
    let mut nearest = vec![DVec2::INFINITY; n];
    let mut distance = vec![f32::INFINITY; n];
    let mut queue = VecDeque::new();
    for p in (0..n).filter(|p| !s.floor_m[*p].is_nan()) {
        let at = ground.middle(p);
        for step in ground.neighbours(p).filter(|step| !s.is_open(*step)) {
            let wall = at.midpoint(ground.middle(step.0));
            let d = at.distance(wall) as f32;
            if d < distance[p] {
                (distance[p], nearest[p]) = (d, wall);
            }
        }
        if distance[p].is_finite() {
            queue.push_back(p);
        }
    }
    while let Some(p) = queue.pop_front() {
        for step in ground.neighbours(p).filter(|step| s.is_open(*step)) {
            let d = ground.middle(step.0).distance(nearest[p]) as f32;
            if d < distance[step.0] - 1e-4 {
                (distance[step.0], nearest[step.0]) = (d, nearest[p]);
                queue.push_back(step.0);
            }
        }
    }
    distance
}

struct Flood {
    parent: Vec<u32>,
    /// Half width and clearance at the widest place.
    peak: Vec<(f32, f32)>,
}

impl Flood {
    fn root(&mut self, mut b: u32) -> u32 {
        while self.parent[b as usize] != b {
            let up = self.parent[self.parent[b as usize] as usize];
            self.parent[b as usize] = up;
            b = up;
        }
        b
    }

    /// Whether the step at half width `d` with this clearance parts the two basins.
    fn is_neck(&self, a: u32, b: u32, d: f32, clearance: f32) -> bool {
        let (pa, pb) = (self.peak[a as usize], self.peak[b as usize]);
        let narrower = pa.0.min(pb.0);
        let lintel = f64::from(clearance) + LINTEL_M <= f64::from(pa.1.min(pb.1));
        let share = if lintel { LINTEL_SHARE } else { NECK_SHARE };
        f64::from(d) <= WIDEST_NECK_M
            && f64::from(narrower) >= NARROWEST_M
            && f64::from(d) < share * f64::from(narrower)
    }
}

/// Finds the basins.
pub(super) fn basins(ground: &Ground, s: &Storey) -> Basins {
    let distance = distances(ground, s);
    let n = ground.places();
    let mut order: Vec<u32> = (0..n as u32).filter(|p| !s.floor_m[*p as usize].is_nan()).collect();
    order.sort_by(|a, b| distance[*b as usize].total_cmp(&distance[*a as usize]).then(a.cmp(b)));
    let mut of = vec![NONE; n];
    let mut flood = Flood { parent: Vec::new(), peak: Vec::new() };
    for p in order {
        let p = p as usize;
        let d = distance[p];
        let clearance = s.above_m[p] - s.floor_m[p];
        let mut own = NONE;
        let mut best = f32::NEG_INFINITY;
        let mut beside: Vec<u32> = Vec::new();
        for step in ground.neighbours(p).filter(|step| s.is_open(*step)) {
            if of[step.0] != NONE {
                let root = flood.root(of[step.0]);
                beside.push(root);
                if distance[step.0] > best {
                    (best, own) = (distance[step.0], root);
                }
            }
        }
        if own == NONE {
            own = flood.parent.len() as u32;
            flood.parent.push(own);
            flood.peak.push((d, clearance));
        }
        of[p] = own;
        for b in beside {
            let (a, b) = (flood.root(own), flood.root(b));
            if a != b && !flood.is_neck(a, b, d, clearance) {
                let (wide, narrow) = if flood.peak[a as usize].0 >= flood.peak[b as usize].0 { (a, b) } else { (b, a) };
                flood.parent[narrow as usize] = wide;
            }
        }
    }
    numbered(ground, s, of, flood, distance)
}

/// Rays that tell whether a basin lies within a solid.
const SOLID_RAYS: u32 = 64;
/// Share of these that leave a solid, from which on it does.
const SOLID_SHARE: f64 = 0.95;
/// Most surfaces that are counted along such a ray.
const MOST_SURFACES: usize = 64;
/// Surfaces closer to each other than this touch, metres: the top of a block and the ceiling that
/// it reaches.
const CONTACT_M: f64 = 2.0e-3;

/// Whether a ray starts within a solid: it meets a back face first, or it leaves more solids than
/// it enters (walls that a block reaches into show their front faces within it). Where two solids
/// touch, either surface may be met, so that says yes.
fn leaves_solid(caster: &Caster, ground: &Ground, mut ray: Ray) -> bool {
    let mut inside = 0;
    for n in 0..MOST_SURFACES {
        let Some(hit) = caster.trace(&ray, &CellSet::all()) else { break };
        let back = caster.surface(&hit, &ray).geometric_normal.dot(ray.direction) > 0.0;
        if n == 0 && (back || is_contact(ground, ray.at(hit.t))) {
            return true;
        }
        inside += if back { 1 } else { -1 };
        ray.t_min = hit.t + 1.0e-4;
    }
    inside > 0
}

/// Whether two level surfaces touch at a point.
fn is_contact(ground: &Ground, p: DVec3) -> bool {
    let Some(place) = ground.place(DVec2::new(p.x, p.z)) else { return false };
    let touching = ground.surfaces(place).iter().filter(|y| (f64::from(**y) - p.y).abs() <= CONTACT_M);
    touching.count() > 1
}

/// Forgets the basins that lie within solids (a block, a wide pillar): no opening, and rays all
/// around leave a solid.
pub(super) fn drop_solids(
    caster: &Caster,
    ground: &Ground,
    s: &Storey,
    b: &mut Basins,
    has_opening: &dyn Fn(u32) -> bool,
) {
    let mut widest = vec![(f32::NEG_INFINITY, 0); b.outside.len()];
    for p in (0..b.of.len()).filter(|p| b.of[*p] != NONE) {
        let w = &mut widest[b.of[p] as usize];
        if b.distance_m[p] > w.0 {
            *w = (b.distance_m[p], p);
        }
    }
    let is_solid = |n: usize| {
        if b.outside[n] || has_opening(n as u32) {
            return false;
        }
        let p = widest[n].1;
        let m = ground.middle(p);
        let eye = DVec3::new(m.x, f64::from(s.floor_m[p]) + SIGHT_M[1], m.y);
        let leaving = (0..SOLID_RAYS).filter(|k| {
            // Fibonacci's sphere, without what is far below: solids stand on floors.
            let y = 1.0 - 1.2 * (f64::from(*k) + 0.5) / f64::from(SOLID_RAYS);
            let around = DVec2::from_angle(2.399_963 * f64::from(*k)) * (1.0 - y * y).sqrt();
            let ray = Ray::new(eye, DVec3::new(around.x, y, around.y));
            leaves_solid(caster, ground, ray)
        });
        leaving.count() as f64 >= SOLID_SHARE * f64::from(SOLID_RAYS)
    };
    let solid: Vec<bool> = (0..b.outside.len()).map(is_solid).collect();
    b.of.iter_mut().filter(|n| **n != NONE && solid[**n as usize]).for_each(|n| *n = NONE);
}

/// Gives the basins that stay their numbers.
fn numbered(ground: &Ground, s: &Storey, mut of: Vec<u32>, mut flood: Flood, distance_m: Vec<f32>) -> Basins {
    let place_m2 = ground.raster.pitch_m * ground.raster.pitch_m;
    let count = flood.parent.len();
    let (mut area, mut walkable, mut outside) = (vec![0.0; count], vec![0.0; count], vec![false; count]);
    for p in 0..of.len() {
        if of[p] != NONE {
            let root = flood.root(of[p]);
            of[p] = root;
            area[root as usize] += place_m2;
            walkable[root as usize] += place_m2 * f64::from(u8::from(s.real[p]));
            outside[root as usize] |= ground.on_rim(p);
        }
    }
    let mut number = vec![NONE; count];
    let mut kept = Basins { of: Vec::new(), distance_m, outside: Vec::new(), area_m2: Vec::new() };
    for b in 0..count {
        let wide = f64::from(flood.peak[b].0) >= NARROWEST_M && walkable[b] >= SMALLEST_M2;
        if area[b] > 0.0 && (outside[b] || wide) {
            number[b] = kept.outside.len() as u32;
            kept.outside.push(outside[b]);
            kept.area_m2.push(walkable[b]);
        }
    }
    of.iter_mut().filter(|b| **b != NONE).for_each(|b| *b = number[*b as usize]);
    kept.of = of;
    kept
}
