//! Portals in the necks between basins: vertical convex polygons, found with rays.
//!
//! ```text
//!   ████████l<---------c--------->r████████   plan: the direction of least width through the neck, moved to the middle of the wall
//!
//!   in that plane: flood from the neck's middle between samples that see each other;
//!   a sample counts if it sees out on one side at least (the cavity of a double wall sees out on neither)
//! ```
//!
//! The polygon is the convex hull of what was reached, hence never smaller than the opening: a
//! leaf, a curtain or a plant that stands in it makes it no smaller as long as anything passes. A
//! rectangle is kept where it is nearly one.

use super::basins::{Basins, NONE};
use super::hull::{hull, rectangle_if_nearly};
use super::storeys::{Ground, SIGHT_M, Storey, is_free};
use crate::render::{Caster, CellSet, Ray};
use glam::{DVec2, DVec3};
use ldi_protocol::rooms::PortalKind;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Farthest that a neck's sides are looked for, metres.
const REACH_M: f64 = 3.0;
/// Pitch of the samples in the portal's plane, metres. Larger: gaps between blinds are missed;
/// smaller: time.
const SAMPLE_M: f64 = 0.05;
/// Step in which the middle of the wall is looked for, metres: below the thickness of a sheet, or
/// its plane is missed.
const SHEET_M: f64 = 0.01;
/// How far before and behind a neck's middle the wall is looked for, in places of the raster.
const AROUND_PLACES: f64 = 4.8;
/// How far a sample must see out of the plane to belong to the opening, metres: beyond half of a
/// common wall.
const OUT_M: f64 = 0.25;
/// Highest portal, metres.
const HIGHEST_M: f64 = 6.0;
/// A direction along an axis is taken if the opening is at most so many times as wide there as at
/// its narrowest.
const AXIS_FAVOUR: f64 = 1.15;
/// An opening whose lower edge is at most this far above the floor is a door.
const DOOR_SILL_M: f64 = 0.3;

/// A neck: steps from one basin to another, close to each other.
struct Neck {
    basins: [u32; 2],
    /// Middle of each step, and the distance to the walls there.
    steps: Vec<(DVec2, f32)>,
    /// Sum of the steps' directions, from the first basin into the second.
    forward: DVec2,
    floor_m: f64,
}

/// A portal between two basins of a storey.
pub(super) struct Opening {
    pub storey: usize,
    /// The normal points from the first into the second.
    pub basins: [u32; 2],
    pub kind: PortalKind,
    pub corners: Vec<DVec3>,
    /// Plan: a point of the plane, the unit normal, and how far the opening reaches to both sides
    /// of the point.
    pub middle: DVec2,
    pub normal: DVec2,
    pub reach_m: [f64; 2],
}

/// Finds the portals of a storey.
pub(super) fn openings(caster: &Caster, ground: &Ground, number: usize, s: &Storey, basins: &Basins) -> Vec<Opening> {
    necks(ground, s, basins).par_iter().filter_map(|n| opening(caster, ground, number, n)).collect()
}

fn necks(ground: &Ground, s: &Storey, basins: &Basins) -> Vec<Neck> {
    let mut between: BTreeMap<[u32; 2], Vec<(DVec2, DVec2, f32, f32)>> = BTreeMap::new();
    let is_outside = |b: u32| basins.outside[b as usize];
    for p in 0..ground.places() {
        for step in ground.neighbours(p).filter(|step| step.0 > p) {
            let q = step.0;
            if s.floor_m[q].is_nan() || s.floor_m[p].is_nan() || !s.is_open(step) {
                continue;
            }
            let (a, b) = (basins.of[p], basins.of[q]);
            if a == NONE || b == NONE || a == b || (is_outside(a) && is_outside(b)) {
                continue;
            }
            let (from, to) = (ground.middle(p), ground.middle(q));
            let forward = if a < b { to - from } else { from - to };
            let d = basins.distance_m[p].max(basins.distance_m[q]);
            let floor = s.floor_m[p].max(s.floor_m[q]);
            between.entry([a.min(b), a.max(b)]).or_default().push((from.midpoint(to), forward, d, floor));
        }
    }
    let mut necks = Vec::new();
    for (basins, mut steps) in between {
        // Steps within two places of each other make a neck.
        let reach = 2.5 * ground.raster.pitch_m;
        while let Some(first) = steps.pop() {
            let mut group = vec![first];
            let mut at = 0;
            while at < group.len() {
                let p = group[at].0;
                let (near, far): (Vec<_>, Vec<_>) = steps.into_iter().partition(|s| s.0.distance(p) <= reach);
                group.extend(near);
                steps = far;
                at += 1;
            }
            necks.push(Neck {
                basins,
                forward: group.iter().map(|s| s.1).sum(),
                floor_m: group.iter().map(|s| f64::from(s.3)).fold(f64::NEG_INFINITY, f64::max),
                steps: group.into_iter().map(|s| (s.0, s.2)).collect(),
            });
        }
    }
    necks
}

/// How far one sees from a point, at most `reach_m`.
fn sight_m(caster: &Caster, from: DVec3, direction: DVec3, reach_m: f64) -> f64 {
    caster.trace(&Ray { origin: from, direction, t_min: 0.0, t_max: reach_m }, &CellSet::all()).map_or(reach_m, |h| h.t)
}

/// Sight to both sides along a direction, at the height at which it is widest: what hangs or
/// stands in the opening does not count.
fn reaches(caster: &Caster, at: DVec2, along: DVec2, floor_m: f64) -> [f64; 2] {
    let d = DVec3::new(along.x, 0.0, along.y);
    SIGHT_M
        .map(|h| {
            let from = DVec3::new(at.x, floor_m + h, at.y);
            [sight_m(caster, from, -d, REACH_M), sight_m(caster, from, d, REACH_M)]
        })
        .into_iter()
        .max_by(|a, b| (a[0] + a[1]).total_cmp(&(b[0] + b[1])))
        .unwrap_or([0.0; 2])
}

fn direction(degrees: f64) -> DVec2 {
    DVec2::from_angle(degrees.to_radians())
}

fn opening(caster: &Caster, ground: &Ground, storey: usize, neck: &Neck) -> Option<Opening> {
    let widest = neck.steps.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    // The middle one of the widest steps.
    let best: Vec<DVec2> = neck.steps.iter().filter(|s| s.1 > widest.1 - 0.03).map(|s| s.0).collect();
    let mean = best.iter().sum::<DVec2>() / best.len() as f64;
    let centre = best.into_iter().min_by(|a, b| a.distance_squared(mean).total_cmp(&b.distance_squared(mean)))?;
    let width = |at: DVec2, degrees: f64| {
        let r = reaches(caster, at, direction(degrees), neck.floor_m);
        r[0] + r[1]
    };
    let least = |at: DVec2, candidates: &mut dyn Iterator<Item = f64>| {
        candidates.map(|a| (width(at, a), a)).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, 0.0))
    };
    let (narrowest, mut degrees) = least(centre, &mut (0..45).map(|k| 4.0 * f64::from(k)));
    // The wall may lie some places before or behind the neck's middle.
    let places = |degrees: f64| -> Vec<(f64, DVec2)> {
        let across = direction(degrees).perp();
        let most = (AROUND_PLACES * ground.raster.pitch_m / SHEET_M).ceil() as i32;
        (-most..=most)
            .map(|k| centre + across * (SHEET_M * f64::from(k)))
            .filter(|p| is_free(caster, at3(centre, neck.floor_m + SIGHT_M[2]), at3(*p, neck.floor_m + SIGHT_M[2])))
            .map(|p| (width(p, degrees), p))
            .collect()
    };
    // Most walls follow the axes; leaves and frames make slanted ways look a little narrower, and
    // so does the cavity of a double wall.
    let (straight, axis) = [0.0, 90.0]
        .map(|axis| (places(axis).iter().map(|p| p.0).fold(f64::INFINITY, f64::min), axis))
        .into_iter()
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or((f64::INFINITY, 0.0));
    if straight <= AXIS_FAVOUR * narrowest {
        degrees = axis;
    }
    let mut at = centre;
    for fine in [0.25, 0.05] {
        let places = places(degrees);
        let narrowest = places.iter().map(|p| p.0).fold(f64::INFINITY, f64::min);
        let narrow: Vec<DVec2> = places.iter().filter(|p| p.0 < narrowest + 0.02).map(|p| p.1).collect();
        at = narrow.get(narrow.len() / 2).copied().unwrap_or(centre);
        degrees = least(at, &mut (-12..=12).map(|k| degrees + fine * f64::from(k))).1;
    }
    let mut normal = direction(degrees).perp();
    if normal.dot(neck.forward) < 0.0 {
        normal = -normal;
    }
    // u x Y is the normal.
    let along = DVec2::new(normal.y, -normal.x);
    let reach = reaches(caster, at, along, neck.floor_m);
    let plane = Plane { at, along, normal, floor_m: neck.floor_m };
    let points = plane.flood(caster, reach, plane.cap_m(ground, reach));
    let outline = rectangle_if_nearly(hull(points));
    if outline.len() < 3 {
        return None;
    }
    let low = outline.iter().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let span = |f: fn(f64, f64) -> f64| outline.iter().map(|p| p.x).reduce(f).unwrap_or(0.0);
    Some(Opening {
        storey,
        basins: neck.basins,
        kind: if low < neck.floor_m + DOOR_SILL_M { PortalKind::Door } else { PortalKind::Window },
        corners: outline.iter().map(|p| plane.point(*p)).collect(),
        middle: at,
        normal,
        reach_m: [-span(f64::min), span(f64::max)],
    })
}

fn at3(p: DVec2, y: f64) -> DVec3 {
    DVec3::new(p.x, y, p.y)
}

/// A vertical plane with coordinates (metres along, height).
struct Plane {
    at: DVec2,
    along: DVec2,
    normal: DVec2,
    floor_m: f64,
}

impl Plane {
    fn point(&self, p: DVec2) -> DVec3 {
        at3(self.at + self.along * p.x, p.y)
    }

    /// Where the walls beside the opening end: above that there is nothing for a portal to be in.
    fn cap_m(&self, ground: &Ground, reach: [f64; 2]) -> f64 {
        let beside = [-reach[0] - 0.1, reach[1] + 0.1];
        let top = |u: f64| {
            let place = ground.place(self.at + self.along * u)?;
            ground.surfaces(place).last().map(|y| f64::from(*y)).filter(|y| *y > self.floor_m + SIGHT_M[2])
        };
        let lower = beside.into_iter().filter_map(top).fold(f64::INFINITY, f64::min);
        lower.min(self.floor_m + HIGHEST_M)
    }

    /// Points of the opening, borders included.
    fn flood(&self, caster: &Caster, reach: [f64; 2], cap_m: f64) -> Vec<DVec2> {
        let n = DVec3::new(self.normal.x, 0.0, self.normal.y) * OUT_M;
        let [left, right] = reach.map(|r| (r / SAMPLE_M).ceil() as i32 + 1);
        let [down, up] = [(0.3 / SAMPLE_M) as i32, ((cap_m - self.floor_m) / SAMPLE_M).floor() as i32];
        // Samples lie at half pitches, so that none lies exactly on a floor or a sill.
        let sample =
            |i: i32, k: i32| DVec2::new(f64::from(i) * SAMPLE_M, self.floor_m + (f64::from(k) + 0.5) * SAMPLE_M);
        let counts = |i: i32, k: i32| {
            let p = self.point(sample(i, k));
            is_free(caster, p, p + n) || is_free(caster, p, p - n)
        };
        let mut seen = std::collections::BTreeSet::new();
        let mut open: Vec<(i32, i32)> =
            SIGHT_M.iter().map(|h| (0, (h / SAMPLE_M) as i32)).filter(|(i, k)| counts(*i, *k)).collect();
        seen.extend(open.iter().copied());
        let mut points = Vec::new();
        while let Some((i, k)) = open.pop() {
            let p = sample(i, k);
            points.push(p);
            for (di, dk) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
                let (qi, qk) = (i + di, k + dk);
                if seen.contains(&(qi, qk)) {
                    continue;
                }
                let step = self.point(sample(qi, qk)) - self.point(p);
                let t = sight_m(caster, self.point(p), step, 1.0);
                let within = (-left..=right).contains(&qi) && (-down..=up).contains(&qk);
                if t >= 1.0 && within && counts(qi, qk) {
                    seen.insert((qi, qk));
                    open.push((qi, qk));
                } else {
                    points.push(p + (sample(qi, qk) - p) * t);
                }
            }
        }
        points
    }
}
