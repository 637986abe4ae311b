//! Openings that nobody meant: found by rays, made portals.
//!
//! In: the volumes and the portals so far. Rays leave random places of all rooms in all
//! directions, up to what they hit; where the label changes along a ray and none of the two
//! labels' portals is there, sight leaks. Leaks close to each other become a portal of the kind
//! `gap`: the hull of the places in their common plane, a little larger. Where they do not lie in
//! a plane they are cut into layers that do, and rooms with very many gaps between them are
//! joined: they have no border.
//!
//! What is left after the last round is counted by rays that were not used to find it.

use super::find::MARGIN_PLACES;
use super::hull::hull;
use super::storeys::{Ground, SIGHT_M, is_free};
use super::volumes::{OUTSIDE, Volumes, id};
use crate::render::{Caster, CellSet, Ray};
use glam::{DVec2, DVec3};
use ldi_protocol::rooms::{Portal, PortalKind};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Farthest that a ray goes, metres.
const REACH_M: f64 = 60.0;
/// How far a ray's change of label may be from the portal, across its plane, metres: half of a
/// wall.
const ACROSS_M: f64 = 0.45;
/// How far a crossing may lie beside a portal's polygon, metres.
const BESIDE_M: f64 = 0.03;
/// Stretches of a ray shorter than this between two others are noise of the raster, metres.
const SHORT_M: f64 = 0.3;
/// Leaks within this distance belong together, metres.
const TOGETHER_M: f64 = 0.5;
/// How far a gap reaches beyond the rays that found it, metres.
const GROWN_M: f64 = 0.12;
/// Thickest set of leaks that has a plane, metres.
const FLAT_M: f64 = 0.35;

/// Edge of a cube of which one leak is kept, metres; below what gaps are grown by.
const CUBE_M: f64 = 0.08;
/// Rooms with more gaps between them than this have no border worth the name.
const MOST_GAPS: usize = 16;

/// Sight from one label to another beside all portals.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leak {
    pub labels: [u32; 2],
    at: DVec3,
    direction: DVec3,
}

/// Somewhere to look from: a free place of the plan and its floor.
#[derive(Clone, Copy)]
pub(super) struct Stand {
    pub place: usize,
    pub floor_m: f64,
}

/// SplitMix64 (Steele, Lea and Flood 2014).
pub(super) struct Random(pub u64);

impl Random {
    pub(super) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A unit vector, all directions alike.
    pub(super) fn direction(&mut self) -> DVec3 {
        let (up, angle) = (2.0 * self.unit() - 1.0, std::f64::consts::TAU * self.unit());
        let around = (1.0f64 - up * up).sqrt();
        DVec3::new(angle.cos() * around, up, angle.sin() * around)
    }
}

/// Looks for leaks along `rays` rays.
pub(super) fn leaks(
    caster: &Caster,
    ground: &Ground,
    volumes: &Volumes,
    stands: &[Stand],
    portals: &[Portal],
    rays: usize,
    seed: u64,
) -> Vec<Leak> {
    if stands.is_empty() {
        return Vec::new();
    }
    let mut between: BTreeMap<(u32, u32), Vec<&Portal>> = BTreeMap::new();
    for p in portals {
        let [a, b] = p.cells.map(|c| c.unwrap_or(OUTSIDE));
        between.entry((a.min(b), a.max(b))).or_default().push(p);
    }
    let one = |n: usize| {
        let mut r = Random(seed.wrapping_add(n as u64).wrapping_mul(0x2545_f491_4f6c_dd1d));
        let stand = stands[(r.unit() * stands.len() as f64) as usize];
        let m = ground.middle(stand.place) + (DVec2::new(r.unit(), r.unit()) - 0.5) * (0.9 * ground.raster.pitch_m);
        // From where sight is free, so that no eye starts within a wall.
        let sure = ground.middle(stand.place);
        let sure = DVec3::new(sure.x, stand.floor_m + SIGHT_M[1], sure.y);
        let beside = DVec3::new(m.x, sure.y, m.y);
        let eye = DVec3::new(m.x, stand.floor_m + 0.3 + 1.7 * r.unit(), m.y);
        let (up, angle) = (1.6 * r.unit() - 0.8, std::f64::consts::TAU * r.unit());
        if !is_free(caster, sure, beside) || !is_free(caster, beside, eye) {
            return None;
        }
        let around = DVec2::from_angle(angle) * (1.0f64 - up * up).sqrt();
        let direction = DVec3::new(around.x, up, around.y);
        let ray = Ray { origin: eye, direction, t_min: 0.0, t_max: REACH_M };
        let reach = caster.trace(&ray, &CellSet::all()).map_or(REACH_M, |h| h.t);
        along(ground, volumes, &ray, reach, &between)
    };
    (0..rays).into_par_iter().with_min_len(1024).filter_map(one).collect()
}

/// The first leak along a ray.
fn along(
    ground: &Ground,
    volumes: &Volumes,
    ray: &Ray,
    reach: f64,
    between: &BTreeMap<(u32, u32), Vec<&Portal>>,
) -> Option<Leak> {
    let step = 0.5 * ground.raster.pitch_m;
    // Stretches of one label: where each begins.
    let mut stretches: Vec<(u32, f64)> = Vec::new();
    for k in 0..(reach / step) as usize {
        let t = (k as f64 + 0.5) * step;
        let label = volumes.at(ground, ray.at(t));
        if stretches.last().is_none_or(|s| s.0 != label) {
            stretches.push((label, t));
        }
    }
    let leads = |a: u32, b: u32, t: f64| {
        between.get(&(a.min(b), a.max(b))).is_some_and(|portals| {
            portals.iter().any(|p| {
                let n = p.normal();
                let across = n.dot(ray.direction);
                let tp = n.dot(p.corners[0] - ray.origin) / across;
                (tp - t).abs() * across.abs() <= ACROSS_M && p.distance_m(ray.at(tp)) <= BESIDE_M
            })
        })
    };
    // What lies within the margin of a border belongs to both sides, eyes and surfaces alike, as
    // in `Rooms::cells_near`: no more, or culling misses it.
    let margin_m = MARGIN_PLACES * ground.raster.pitch_m;
    let is_near = |p: DVec3, label: u32| volumes.is_near(ground, p, label, margin_m);
    let mut from = 0;
    while from + 1 < stretches.len() {
        let (a, _) = stretches[from];
        let (b, t) = stretches[from + 1];
        let end = stretches.get(from + 2).map_or(reach, |s| s.1);
        if leads(a, b, t) || (from == 0 && is_near(ray.origin, b)) {
            from += 1;
            continue;
        }
        if from + 2 == stretches.len() {
            if is_near(ray.at(reach), a) {
                return None;
            }
        } else if end - t <= SHORT_M {
            let c = stretches[from + 2].0;
            if c == a || leads(a, c, end) {
                from += 2;
                continue;
            }
        }
        return Some(Leak { labels: [a, b], at: ray.at(t), direction: ray.direction });
    }
    None
}

/// Gaps, and pairs of labels with very many between them: sight between those has no plane.
pub(super) fn gaps(mut leaks: Vec<Leak>) -> (Vec<Portal>, Vec<[u32; 2]>) {
    // Both directions of a border are one.
    for l in &mut leaks {
        if l.labels[0] > l.labels[1] {
            l.labels.swap(0, 1);
            l.direction = -l.direction;
        }
    }
    let mut pairs: BTreeMap<[u32; 2], Vec<Leak>> = BTreeMap::new();
    let mut places = std::collections::BTreeSet::new();
    for l in leaks {
        // One for each small cube: rays through a wide gap are many, and grouping takes their
        // square.
        if places.insert((l.labels, (l.at / CUBE_M).floor().to_array().map(|v| v as i64))) {
            pairs.entry(l.labels).or_default().push(l);
        }
    }
    let (mut portals, mut joined) = (Vec::new(), Vec::new());
    for (labels, mut rest) in pairs {
        while let Some(first) = rest.pop() {
            let (mut group, mut at) = (vec![first], 0);
            while at < group.len() {
                let p = group[at].at;
                let (near, far): (Vec<_>, Vec<_>) = rest.into_iter().partition(|l| l.at.distance(p) <= TOGETHER_M);
                group.extend(near);
                rest = far;
                at += 1;
            }
            match gap(labels, &group) {
                Some(portal) => portals.push(portal),
                None => portals.extend(slices(labels, &group)),
            }
        }
        let of_pair = portals.iter().filter(|p: &&Portal| p.cells == labels.map(id)).count();
        if of_pair > MOST_GAPS {
            joined.push(labels);
        }
    }
    (portals, joined)
}

/// The portal of a group of leaks, upright or level; None if they do not lie in such a plane.
fn gap(labels: [u32; 2], group: &[Leak]) -> Option<Portal> {
    let mean = group.iter().map(|l| l.at).sum::<DVec3>() / group.len() as f64;
    let forward = group.iter().map(|l| l.direction).sum::<DVec3>();
    // In plan, the direction of least spread; few leaks say nothing about it but their own.
    let (mut xx, mut xz, mut zz) = (1e-6, 0.0, 1e-6);
    for l in group {
        let d = l.at - mean;
        (xx, xz, zz) = (xx + d.x * d.x, xz + d.x * d.z, zz + d.z * d.z);
    }
    let angle = 0.5 * f64::atan2(2.0 * xz, xx - zz);
    let mut across = DVec2::from_angle(angle).perp();
    if group.len() < 4 {
        across = DVec2::new(forward.x, forward.z);
    }
    // Walls mostly follow the axes.
    let snapped = if across.x.abs() > across.y.abs() { DVec2::X } else { DVec2::Y };
    let across = across.normalize_or(snapped);
    let across = if across.dot(snapped).abs() > 0.97 { snapped } else { across };
    let upright = DVec3::new(across.x, 0.0, across.y);
    let spread = |normal: DVec3| {
        let d = group.iter().map(|l| (l.at - mean).dot(normal));
        d.clone().fold(f64::NEG_INFINITY, f64::max) - d.fold(f64::INFINITY, f64::min)
    };
    let normal = [DVec3::Y, upright].into_iter().min_by(|a, b| spread(*a).total_cmp(&spread(*b)))?;
    // Few leaks lie in many planes: the one that sight crosses.
    let normal = if group.len() < 4 && spread(upright) <= FLAT_M && forward.dot(upright).abs() > forward.y.abs() {
        upright
    } else {
        normal
    };
    if spread(normal) > FLAT_M {
        return None;
    }
    Some(outline(labels, group.iter().map(|l| l.at), mean, if normal.dot(forward) < 0.0 { -normal } else { normal }))
}

/// The hull of points in a plane, grown.
fn outline(labels: [u32; 2], points: impl Iterator<Item = DVec3>, mean: DVec3, normal: DVec3) -> Portal {
    let u = if normal.y.abs() > 0.5 { DVec3::X } else { DVec3::Y.cross(normal).normalize_or(DVec3::X) };
    let v = normal.cross(u);
    let mut flat = Vec::new();
    for p in points {
        let d = p - mean;
        let at = DVec2::new(d.dot(u), d.dot(v));
        flat.extend([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| at + DVec2::new(x, y) * GROWN_M));
    }
    let outline = super::hull::rectangle_if_nearly(hull(flat));
    // u x v is the normal, so counter-clockwise points along it.
    let corners = outline.into_iter().map(|p| mean + u * p.x + v * p.y).collect();
    Portal { cells: labels.map(id), kind: PortalKind::Gap, corners }
}

/// Gaps for leaks around a corner: the leaks in layers along the three axes, each layer by those
/// that cross it most squarely.
fn slices(labels: [u32; 2], group: &[Leak]) -> Vec<Portal> {
    let mut layers: BTreeMap<(usize, bool, i64), Vec<Leak>> = BTreeMap::new();
    for l in group {
        let d = l.direction.abs();
        let axis = (0..3).max_by(|a, b| d[*a].total_cmp(&d[*b])).unwrap_or(0);
        let layer = (l.at[axis] / FLAT_M).floor() as i64;
        layers.entry((axis, l.direction[axis] > 0.0, layer)).or_default().push(*l);
    }
    layers
        .into_iter()
        .map(|((axis, up, _), leaks)| {
            let normal = DVec3::AXES[axis] * if up { 1.0 } else { -1.0 };
            let mean = leaks.iter().map(|l| l.at).sum::<DVec3>() / leaks.len() as f64;
            outline(labels, leaks.iter().map(|l| l.at), mean, normal)
        })
        .collect()
}
