//! Where a walker stands, and where a body passes.
//!
//! In: a walk volume, which holds floors and no walls, and rays at the scene. Out: spots on a
//! lattice with the eye above each, and whether a body gets from one eye to another.

use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use ldi_protocol::{stroll::Random, volume::WalkVolume};
use std::{cell::RefCell, collections::HashMap};

/// Half the width of a body, metres. A person is as wide; less brings the eye close to walls.
const RADIUS_M: f64 = 0.25;
/// Distance that must be free around a spot, metres.
const AROUND_M: f64 = 0.4;
/// Distance between places of a way where its sides are looked at, metres.
const SIDES_M: f64 = 0.25;
/// Places that tell whether there are floors at all.
const PROBED: u64 = 64;
/// Heights at which a body meets obstacles, as shares of the eye height below the eye: head, hip,
/// and just above the highest step.
const BODY: [f64; 3] = [0.0, 0.35, 0.7];
/// The same for flying, metres below the eye.
const FLYING_BODY_M: [f64; 3] = [0.0, -RADIUS_M, RADIUS_M];
/// Largest difference in height between neighbouring spots, metres: that of steep stairs.
const STEP_M: f64 = 0.5;
/// An eye on a straight way differs from the eye of the spot there by at most this, metres.
const LEVEL_M: f64 = 0.15;
/// Spots along the longest side of a volume that is flown in.
const FLYING_SPOTS: f64 = 48.0;
/// Flying eyes are at this share of the volume's height.
const FLYING_HEIGHT: f64 = 0.4;

/// A place on the lattice: its column along x and z, and which of the eye heights there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Spot {
    x: i32,
    z: i32,
    run: u16,
}

/// The walk volume with what stands in it.
pub struct Ground<'a> {
    caster: &'a Caster,
    cells: CellSet,
    volume: &'a WalkVolume,
    eye_height_m: Option<f64>,
    /// There are no floors: people walk around an exhibit on a plane.
    is_around: bool,
    pitch_m: f64,
    /// The eye above each spot that was asked for; None: nobody stands there.
    eyes: RefCell<HashMap<Spot, Option<DVec3>>>,
    /// Whether a body passes between two neighbours, the smaller first.
    ways: RefCell<HashMap<(Spot, Spot), bool>>,
}

impl<'a> Ground<'a> {
    pub fn new(caster: &'a Caster, volume: &'a WalkVolume, eye_height_m: Option<f64>) -> Self {
        let size = volume.bounds().size();
        let pitch_m = match eye_height_m {
            Some(_) => volume.pitch_m(),
            None => (size.x.max(size.z) / FLYING_SPOTS).clamp(0.25, 4.0),
        };
        let (eyes, ways) = Default::default();
        let (cells, is_around) = (CellSet::all(), false);
        let mut ground = Self { caster, cells, volume, eye_height_m, is_around, pitch_m, eyes, ways };
        ground.is_around = eye_height_m.is_some_and(|height| !ground.has_floors(height));
        ground
    }

    /// Whether there is a floor below any of some places.
    fn has_floors(&self, eye_height_m: f64) -> bool {
        let sampler = self.volume.sampler();
        let mut random = Random::new(0, 2);
        let mut place = || sampler.point([random.uniform(), random.uniform(), random.uniform(), random.uniform()]);
        (0..PROBED).filter_map(|_| place()).any(|p| self.floor_m(p, eye_height_m + 1.0).is_some())
    }

    /// Height of the floor at most `within_m` below a place.
    fn floor_m(&self, place: DVec3, within_m: f64) -> Option<f64> {
        let down = Ray { origin: place, direction: -DVec3::Y, t_min: 0.0, t_max: within_m };
        self.caster.trace(&down, &self.cells).map(|hit| place.y - hit.t)
    }

    /// The walk volume that all spots lie in.
    pub fn volume(&self) -> &WalkVolume {
        self.volume
    }

    /// The spot nearest to a place of the volume, if a walker stands there.
    pub fn spot_at(&self, place: DVec3) -> Option<Spot> {
        let [x0, z0] = self.volume.corner();
        let at = |v: f64, from: f64| ((v - from) / self.pitch_m).floor() as i32;
        let (x, z) = (at(place.x, x0), at(place.z, z0));
        let spots = self.spots_of(x, z).filter_map(|spot| Some((spot, (self.eye(spot)?.y - place.y).abs())));
        spots.min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0))).map(|(spot, _)| spot)
    }

    /// The eye above a spot; None if nobody stands there.
    pub fn eye(&self, spot: Spot) -> Option<DVec3> {
        if let Some(known) = self.eyes.borrow().get(&spot) {
            return *known;
        }
        let eye = self.find_eye(spot).filter(|eye| self.is_roomy(*eye));
        self.eyes.borrow_mut().insert(spot, eye);
        eye
    }

    /// Neighbours of a spot that a body gets to from it, with the distance.
    pub fn neighbours(&self, spot: Spot) -> Vec<(Spot, f64)> {
        const AROUND: [[i32; 2]; 8] = [[-1, -1], [0, -1], [1, -1], [-1, 0], [1, 0], [-1, 1], [0, 1], [1, 1]];
        let Some(eye) = self.eye(spot) else { return Vec::new() };
        let beside = AROUND.iter().flat_map(|[dx, dz]| self.spots_of(spot.x + dx, spot.z + dz));
        let near = |other: Spot| {
            let there = self.eye(other)?;
            let reached = (there.y - eye.y).abs() <= STEP_M && self.passes(spot, other, eye, there);
            reached.then(|| (other, eye.distance(there)))
        };
        beside.filter_map(near).collect()
    }

    fn passes(&self, a: Spot, b: Spot, from: DVec3, to: DVec3) -> bool {
        let pair = (a.min(b), a.max(b));
        if let Some(known) = self.ways.borrow().get(&pair) {
            return *known;
        }
        let passes = self.is_free(from, to);
        self.ways.borrow_mut().insert(pair, passes);
        passes
    }

    /// Whether a walker gets straight from one eye to another, at eye height all the way.
    pub fn is_straight(&self, from: DVec3, to: DVec3) -> bool {
        let steps = (from.distance(to) / (self.pitch_m / 2.0)).ceil().max(1.0) as u32;
        let level = |n: u32| {
            let at = from.lerp(to, f64::from(n) / f64::from(steps));
            let eye = self.spot_at(at).and_then(|spot| self.eye(spot));
            self.eye_height_m.is_none() || eye.is_some_and(|eye| (eye.y - at.y).abs() <= LEVEL_M)
        };
        (1..steps).all(level) && self.is_free(from, to)
    }

    /// Whether the straight way lies in the volume and nothing stands in the body's way, on the way
    /// there and back.
    fn is_free(&self, from: DVec3, to: DVec3) -> bool {
        if !self.is_inside(from, to) {
            return false;
        }
        let along = (to - from).normalize_or_zero();
        let side = along.cross(DVec3::Y).normalize_or_zero() * RADIUS_M;
        let rays: Vec<Ray> = [DVec3::ZERO, side, -side]
            .into_iter()
            .flat_map(|aside| self.body().map(|below| aside - DVec3::Y * below))
            .map(|offset| Ray {
                origin: from + offset - along * RADIUS_M,
                direction: to - from + along * (2.0 * RADIUS_M),
                t_min: 0.0,
                t_max: 1.0,
            })
            .collect();
        // A ray inside of a wall meets nothing, and a table top lies between rays: the sides are
        // looked at across and from above, too.
        let steps = (from.distance(to) / SIDES_M).ceil().max(1.0) as u32;
        let is_free_across = |n: u32| {
            let at = from.lerp(to, f64::from(n) / f64::from(steps));
            let is_free_below = |offset: DVec3| match self.eye_height_m {
                Some(height) => self.floor_m(at + offset, height - STEP_M).is_none(),
                None => true,
            };
            [DVec3::ZERO, side, -side].into_iter().all(is_free_below)
                && self.body().into_iter().all(|below| {
                    [side, -side].into_iter().all(|direction| {
                        let ray = Ray { origin: at - DVec3::Y * below, direction, t_min: 0.0, t_max: 1.0 };
                        !self.caster.occluded(&ray, &self.cells)
                    })
                })
        };
        rays.iter().all(|ray| !self.caster.occluded(ray, &self.cells)) && (0..=steps).all(is_free_across)
    }

    /// Whether every eye on a straight way lies in the volume: in each column that the way crosses
    /// one run holds it.
    fn is_inside(&self, from: DVec3, to: DVec3) -> bool {
        let (pitch, corner) = (self.volume.pitch_m(), self.volume.corner());
        let mut cuts = vec![0.0, 1.0];
        for (a, b, corner) in [(from.x, to.x, corner[0]), (from.z, to.z, corner[1])] {
            let [first, last] = [a.min(b), a.max(b)].map(|v| ((v - corner) / pitch).floor() as i64);
            cuts.extend((first + 1..=last).map(|line| (corner + line as f64 * pitch - a) / (b - a)));
        }
        cuts.retain(|t| (0.0..=1.0).contains(t));
        cuts.sort_by(f64::total_cmp);
        let at = |t: f64| from.lerp(to, t);
        cuts.iter().all(|t| self.volume.contains(at(*t)))
            && cuts.windows(2).all(|cut| {
                let (a, b, middle) = (at(cut[0]).y, at(cut[1]).y, at((cut[0] + cut[1]) / 2.0));
                self.volume.heights(middle.x, middle.z).any(|[low, high]| low <= a.min(b) && a.max(b) <= high)
            })
    }

    /// How far the next surface is in a direction of length 1, if it is nearer than `most_m`.
    pub fn sight_m(&self, eye: DVec3, direction: DVec3, most_m: f64) -> Option<f64> {
        let ray = Ray { origin: eye, direction, t_min: 0.0, t_max: most_m };
        self.caster.trace(&ray, &self.cells).map(|hit| hit.t)
    }

    fn spots_of(&self, x: i32, z: i32) -> impl Iterator<Item = Spot> + '_ {
        let [at_x, at_z] = self.middle(x, z);
        (0..self.volume.heights(at_x, at_z).count() as u16).map(move |run| Spot { x, z, run })
    }

    /// Middle of a column of the lattice along x and z, metres.
    fn middle(&self, x: i32, z: i32) -> [f64; 2] {
        let [x0, z0] = self.volume.corner();
        [x0 + (f64::from(x) + 0.5) * self.pitch_m, z0 + (f64::from(z) + 0.5) * self.pitch_m]
    }

    /// The eye above the floor of a spot.
    fn find_eye(&self, spot: Spot) -> Option<DVec3> {
        let [x, z] = self.middle(spot.x, spot.z);
        let [low, high] = self.volume.heights(x, z).nth(usize::from(spot.run))?;
        let Some(eye_height_m) = self.eye_height_m else {
            return Some(DVec3::new(x, low + FLYING_HEIGHT * (high - low), z));
        };
        // Between the highest eye and the floor below the lowest one.
        let y = match self.is_around {
            true => (low + high) / 2.0,
            false => self.floor_m(DVec3::new(x, high, z), high - low + eye_height_m + STEP_M)? + eye_height_m,
        };
        (low..=high).contains(&y).then(|| DVec3::new(x, y, z))
    }

    /// Whether nothing stands close around an eye.
    fn is_roomy(&self, eye: DVec3) -> bool {
        let directions = (0..8).map(|n| {
            let (sin, cos) = (f64::from(n) * std::f64::consts::FRAC_PI_4).sin_cos();
            DVec3::new(cos, 0.0, sin)
        });
        let is_free = |direction: DVec3| {
            self.body().into_iter().all(|below| {
                let ray = Ray { origin: eye - DVec3::Y * below, direction, t_min: 0.0, t_max: AROUND_M };
                !self.caster.occluded(&ray, &self.cells)
            })
        };
        directions.into_iter().all(is_free)
    }

    /// Metres below the eye at which a body meets obstacles.
    fn body(&self) -> [f64; 3] {
        self.eye_height_m.map_or(FLYING_BODY_M, |height| BODY.map(|share| share * height))
    }
}
