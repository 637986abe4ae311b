//! From where a portal's images are looked at: boxes of eyes ("zones") on either side of a portal,
//! each with a camera that can serve all of them.
//!
//! In: places where eyes may be, a portal. Out: zones. The papers put reference images on a
//! semicircle around the portal at eye height (Rafferty and others 1998, section 3); here eyes may
//! be anywhere in the room, so the room before the portal is divided until each part keeps the
//! bounds of one image:
//!
//! ```text
//!    room        ______________________        D: distance of the plane from the centre of projection, at the nearest corner of the portal
//!      zone 3   |      zone 1   | near |       e: how far eyes of the zone come toward it
//!    ___________|     o cop     |      | p     footprint <= k^2 D / (D - e) / scale  (`placement::footprint`)
//!               |_______________|______| o
//!    zone 4         zone 2             | r     near: no image; the room beyond is geometry there
//! ```
//!
//! The image is parallel to the portal, which puts its plane as far from all eyes as can be; where
//! that does not do, its axis points from the zone to the portal.

use crate::placement::{Footprint, SCALES};
use glam::DVec3;
use ldi_protocol::room_index::{LEAST_SINE, is_faced};
use ldi_protocol::rooms::Portal;
use ldi_protocol::{Aabb, ViewBasis};
use std::{cmp::Ordering, f64::consts::FRAC_PI_2};

/// Lines of sight may be this far off an image's axis: cosine of 83 degrees, which the lowest
/// corner of a door has for eyes that just face it. Larger angles: fewer zones, each with more
/// samples at its sides, by the cube of the cosine.
const LEAST_COSINE: f64 = 0.12;
/// Boxes of eyes are divided along borders of what may be used down to this, metres, or this share
/// of their distance. Smaller: zones are a little larger, planning takes longer.
const FINEST_M: f64 = 0.15;
const FINEST_SHARE: f64 = 0.1;
/// Lookouts are this far apart, metres, or this share of their distance from the portal. Larger: a
/// strip beside a jamb is in no image although some eyes see it.
const APART_M: f64 = 0.125;
const APART_SHARE: f64 = 0.08;
/// A box of the walk volume has at most so many to a side: boxes are half a metre wide, but for
/// walks without floors the volume may be one box as large as the scene.
const MOST_APART: f64 = 16.0;
/// The image plane lies before the portal's nearest corner by this share of its distance: depths
/// are rounded.
const PLANE_SLACK: f64 = 1e-3;
/// Windows reach beyond what may be seen by this much, as tangents.
const WINDOW_PAD: f64 = 2e-3;

/// A portal as seen from one of its sides.
#[derive(Debug, Clone)]
pub(super) struct Gate {
    /// The portal.
    pub portal: Portal,
    /// Which of its rooms the eyes are in.
    pub side: usize,
    /// Unit normal, away from the eyes.
    pub beyond: DVec3,
    /// Nearer eyes have no image, metres.
    pub near_m: f64,
}

impl Gate {
    pub fn new(portal: &Portal, side: usize, near_m: f64) -> Self {
        let beyond = portal.normal() * if side == 0 { 1.0 } else { -1.0 };
        Self { portal: portal.clone(), side, beyond, near_m }
    }

    /// Whether some eyes of a box may have an image, as far as its corners and its middle tell.
    pub fn may_serve(&self, b: &Aabb) -> bool {
        let places = b.corners().into_iter().chain([b.centre()]);
        places.into_iter().any(|p| is_faced(&self.portal, self.side, p, self.near_m))
    }

    /// How far a place lies before the portal's plane, metres.
    pub fn before_m(&self, p: DVec3) -> f64 {
        (self.portal.corners[0] - p).dot(self.beyond)
    }

    fn centre(&self) -> DVec3 {
        self.portal.centre()
    }
}

/// A box of eyes and the camera that serves them.
#[derive(Debug, Clone)]
pub(super) struct Zone {
    pub users: Aabb,
    pub cop: DVec3,
    pub basis: ViewBasis,
    /// Yaw and pitch of the axis, degrees.
    pub axis_deg: [f64; 2],
    pub plane_m: f64,
    pub scale: f64,
    pub footprint_px: f64,
    pub window: [f64; 4],
}

/// Why a box of eyes is not a zone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Not {
    /// The nearest eyes would see samples too large: to be divided by distance.
    Near,
    /// Lines of sight differ too much: to be divided across.
    Askew,
}

/// Divides the places of eyes before a gate into zones; places that fit in none are left out.
pub(super) fn zones(gate: &Gate, places: &[Aabb], footprint: &Footprint) -> Vec<Zone> {
    let mut out = Vec::new();
    let mut open = vec![places.to_vec()];
    while let Some(mut places) = open.pop() {
        if places.is_empty() {
            continue;
        }
        let users = places.iter().fold(Aabb::EMPTY, |b, p| b.union(*p));
        let why = match zone(gate, users, footprint) {
            Ok(zone) => {
                out.push(zone);
                continue;
            }
            Err(why) if places.len() > 1 => why,
            Err(_) => continue,
        };
        let up = if gate.beyond.y.abs() > 0.7 { DVec3::X } else { DVec3::Y };
        let across = gate.beyond.cross(up).normalize_or_zero();
        let key = |b: &Aabb| match why {
            Not::Near => gate.portal.distance_m(b.centre()),
            Not::Askew => b.centre().dot(across),
        };
        let (low, high) =
            places.iter().map(key).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), k| (l.min(k), h.max(k)));
        let middle = match why {
            // Distances count by their ratio.
            Not::Near => (low.max(0.1) * high.max(0.1)).sqrt(),
            Not::Askew => (low + high) * 0.5,
        };
        let (mut a, mut b): (Vec<Aabb>, Vec<Aabb>) = places.iter().partition(|p| key(p) < middle);
        if a.is_empty() || b.is_empty() {
            let axis = longest(users.size());
            places.sort_by(|p, q| p.centre()[axis].total_cmp(&q.centre()[axis]));
            b = places.split_off(places.len() / 2);
            a = places;
        }
        open.extend([b, a]);
    }
    out
}

/// Corners of boxes that together hold all eyes of a box that may have an image: whatever is
/// linear in the eye has its extremes there.
fn eyes_of(gate: &Gate, users: &Aabb) -> Vec<DVec3> {
    let mut out = Vec::new();
    let mut open = vec![*users];
    while let Some(b) = open.pop() {
        let (distance, half) = (gate.portal.distance_m(b.centre()), b.size().length() * 0.5);
        let before = b.corners().map(|c| gate.before_m(c));
        let [least, most] = [f64::min, f64::max].map(|f| before.iter().copied().reduce(f).unwrap_or(0.0));
        if distance + half < gate.near_m || most < LEAST_SINE * (distance - half) || most <= 0.0 {
            continue;
        }
        let all = distance - half >= gate.near_m && least >= LEAST_SINE * (distance + half);
        let size = DVec3::new(b.size().x, 0.0, b.size().z);
        if all || size.max_element() <= FINEST_M.max(FINEST_SHARE * distance) {
            out.extend(b.corners().into_iter().filter(|c| gate.before_m(*c) > 0.0));
            continue;
        }
        let (mut low, mut high) = (b, b);
        let axis = longest(size);
        let middle = b.centre()[axis];
        (low.max[axis], high.min[axis]) = (middle, middle);
        open.extend([low, high]);
    }
    out
}

fn longest(size: DVec3) -> usize {
    (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best })
}

/// The zone of a box of eyes.
fn zone(gate: &Gate, users: Aabb, footprint: &Footprint) -> Result<Zone, Not> {
    let cop = users.centre();
    if gate.before_m(cop) <= 0.0 {
        return Err(Not::Near);
    }
    let eyes = eyes_of(gate, &users);
    if eyes.is_empty() {
        return Err(Not::Near);
    }
    let toward = (gate.centre() - cop).normalize();
    along(gate, users, &eyes, gate.beyond, footprint).or_else(|_| along(gate, users, &eyes, toward, footprint))
}

/// The zone of a box of eyes, with an image along `axis`.
fn along(gate: &Gate, users: Aabb, eyes: &[DVec3], axis: DVec3, footprint: &Footprint) -> Result<Zone, Not> {
    let cop = users.centre();
    let axis_deg = [(-axis.x).atan2(-axis.z).to_degrees(), axis.y.clamp(-1.0, 1.0).asin().to_degrees()];
    let basis = ViewBasis::from_yaw_pitch(axis_deg[0], axis_deg[1]);
    let local = |v: DVec3| [v.dot(basis.right), v.dot(basis.up), v.dot(basis.forward)];
    let mut plane_m = f64::INFINITY;
    let mut window = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    let mut reach = |[x, y, z]: [f64; 3]| {
        let (x, y) = (x / z, y / z);
        window = [window[0].min(x), window[1].max(x), window[2].min(y), window[3].max(y)];
    };
    for corner in &gate.portal.corners {
        let v = local(*corner - cop);
        plane_m = plane_m.min(v[2]);
        if v[2] < LEAST_COSINE * corner.distance(cop) {
            return Err(Not::Askew);
        }
        reach(v);
    }
    let mut ahead_m = f64::NEG_INFINITY;
    // What an eye sees beyond a corner of the portal lies, as seen from the centre, between that
    // corner and the direction from the eye to it.
    for eye in eyes {
        ahead_m = ahead_m.max((*eye - cop).dot(basis.forward));
        for corner in &gate.portal.corners {
            let v = local(*corner - *eye);
            if v[2] < LEAST_COSINE * corner.distance(*eye) {
                return Err(Not::Askew);
            }
            reach(v);
        }
    }
    let plane_m = plane_m * (1.0 - PLANE_SLACK);
    let (scale, footprint_px) = footprint.scale(FRAC_PI_2, plane_m, ahead_m).ok_or(Not::Near)?;
    debug_assert!(SCALES.contains(&scale));
    let [left, right, bottom, top] = window;
    let window = [left - WINDOW_PAD, right + WINDOW_PAD, bottom - WINDOW_PAD, top + WINDOW_PAD];
    Ok(Zone { users, cop, basis, axis_deg, plane_m, scale, footprint_px, window })
}

/// Where eyes of a zone may be, [`APART_M`] or more apart, and there the lowest and the highest.
pub(super) fn lookouts(gate: &Gate, zone: &Zone, places: &[Aabb]) -> Vec<DVec3> {
    let mut eyes: Vec<DVec3> = places
        .iter()
        .filter(|b| b.intersects(&zone.users))
        .flat_map(|b| {
            let b = Aabb { min: b.min.max(zone.users.min), max: b.max.min(zone.users.max) };
            let apart_m = APART_M.max(APART_SHARE * gate.portal.distance_m(b.centre()));
            let [across, along] =
                [b.size().x, b.size().z].map(|size| (size / apart_m).ceil().clamp(1.0, MOST_APART) as u32);
            (0..=across).flat_map(move |i| (0..=along).map(move |k| (i, k))).flat_map(move |(i, k)| {
                let share = |n: u32, of: u32| f64::from(n) / f64::from(of);
                let at = b.min + b.size() * DVec3::new(share(i, across), 0.0, share(k, along));
                [at.y, b.max.y].map(|y| DVec3::new(at.x, y, at.z))
            })
        })
        .filter(|p| is_faced(&gate.portal, gate.side, *p, gate.near_m))
        .collect();
    // Boxes share their sides.
    eyes.sort_unstable_by(|a, b| a.to_array().partial_cmp(&b.to_array()).unwrap_or(Ordering::Equal));
    eyes.dedup();
    eyes
}

/// Of some eyes of a zone those that look most to the left, to the right, down and up past each
/// corner of the portal: what others see through it lies between that.
pub(super) fn outermost(gate: &Gate, zone: &Zone, eyes: &[DVec3]) -> Vec<DVec3> {
    let mut out: Vec<usize> = Vec::new();
    for corner in &gate.portal.corners {
        for side in [zone.basis.right, -zone.basis.right, zone.basis.up, -zone.basis.up] {
            let reach = |k: &usize| {
                let v = *corner - eyes[*k];
                v.dot(side) / v.dot(zone.basis.forward)
            };
            out.extend((0..eyes.len()).max_by(|a, b| reach(a).total_cmp(&reach(b))));
        }
    }
    out.sort_unstable();
    out.dedup();
    out.into_iter().map(|k| eyes[k]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::Random;
    use ldi_protocol::OutputCamera;
    use ldi_protocol::rooms::PortalKind;

    const CAMERA: OutputCamera = OutputCamera { width: 1280, height: 720, fov_deg: 60.0 };

    /// A door of 1 m by 2 m in the plane x = 0, seen from smaller x; eyes in a room of 5 m by 5 m
    /// before it.
    fn room() -> (Gate, Vec<Aabb>) {
        let corners = [(0.0, -0.5), (0.0, 0.5), (2.0, 0.5), (2.0, -0.5)].map(|(y, z)| DVec3::new(0.0, y, z)).to_vec();
        let place = |i: usize| {
            let min = DVec3::new(-5.0 + 0.25 * (i % 20) as f64, 1.1, -2.5 + 0.25 * (i / 20) as f64);
            Aabb { min, max: min + DVec3::new(0.25, 0.9, 0.25) }
        };
        let portal = Portal { cells: [Some(0), Some(1)], kind: PortalKind::Door, corners };
        assert!(portal.normal().distance(DVec3::X) < 1e-12 || portal.normal().distance(DVec3::NEG_X) < 1e-12);
        let side = usize::from(portal.normal().x < 0.0);
        (Gate::new(&portal, side, 1.5), (0..400).map(place).collect())
    }

    #[test]
    fn what_eyes_of_a_zone_see_lies_in_its_window_beyond_its_plane_and_is_no_larger_than_promised() {
        let (gate, places) = room();
        let footprint = Footprint::new(&CAMERA, 1.0, 2.0);
        let all = zones(&gate, &places, &footprint);
        assert!((2..32).contains(&all.len()), "{}", all.len());
        // All eyes that face the door have one.
        let faced = |p: DVec3| is_faced(&gate.portal, gate.side, p, gate.near_m);
        let far = places.iter().filter(|p| faced(p.centre()));
        let served = far.clone().filter(|p| all.iter().any(|z| z.users.contains(p.centre()))).count();
        assert_eq!(served, far.count());
        let mut random = Random::new(5);
        for z in &all {
            for _ in 0..300 {
                let mut mix = |b: &Aabb| b.min + b.size() * DVec3::new(random.unit(), random.unit(), random.unit());
                let eye = mix(&z.users);
                if !faced(eye) {
                    continue;
                }
                let door = mix(&Aabb::from_points(gate.portal.corners.iter().copied()));
                let seen = door + (door - eye) * (random.unit() * 30.0);
                let v = seen - z.cop;
                let depth = v.dot(z.basis.forward);
                assert!(depth >= z.plane_m, "{depth} {}", z.plane_m);
                let (x, y) = (v.dot(z.basis.right) / depth, v.dot(z.basis.up) / depth);
                let [l, r, b, t] = z.window;
                assert!(x >= l && x <= r && y >= b && y <= t, "{x} {y} {:?}", z.window);
                // Straight at it, which magnifies as much as eyes can: the ratio of depths, over
                // the sampling density.
                let e = (eye - z.cop).dot(z.basis.forward);
                assert!(depth / (depth - e) / z.scale <= z.footprint_px);
            }
            assert!(z.footprint_px <= 2.0);
        }
    }

    /// Directions past the portal's corners, of eyes anywhere in a zone: none is farther out than
    /// the outermost eye's, but for what eyes among those tried differ by.
    #[test]
    fn the_outermost_eyes_see_past_corners_what_any_eye_sees() {
        let (gate, places) = room();
        let footprint = Footprint::new(&CAMERA, 1.0, 2.0);
        let mut random = Random::new(6);
        for z in zones(&gate, &places, &footprint) {
            let outer = outermost(&gate, &z, &lookouts(&gate, &z, &places));
            assert!((2..=16).contains(&outer.len()) && outer.iter().all(|e| z.users.contains(*e)), "{outer:?}");
            let local = |v: DVec3| [v.dot(z.basis.right), v.dot(z.basis.up)].map(|x| x.atan2(v.dot(z.basis.forward)));
            for _ in 0..300 {
                let eye = z.users.min + z.users.size() * DVec3::new(random.unit(), random.unit(), random.unit());
                for corner in gate.portal.corners.iter().filter(|_| is_faced(&gate.portal, gate.side, eye, gate.near_m))
                {
                    let seen = local(*corner - eye);
                    for k in 0..2 {
                        let all = outer.iter().map(|e| local(*corner - *e)[k]);
                        let (low, high) = all.fold((f64::MAX, f64::MIN), |(l, h), a| (l.min(a), h.max(a)));
                        let slack = (APART_M / gate.near_m).max(APART_SHARE);
                        assert!(
                            (low - slack..high + slack).contains(&seen[k]),
                            "{eye} {corner}: {} {low} {high}",
                            seen[k]
                        );
                    }
                }
            }
        }
    }
}
