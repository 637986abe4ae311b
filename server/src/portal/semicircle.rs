//! From where a portal's reference images are taken: a semicircle before it at eye height
//! (Rafferty, Aliaga, Popescu and Lastra 1998, section 2.2 and Figure 2).
//!
//! In: rooms, the walk volume, whether sight is free. Out: per side of a portal a [`SidePlan`]:
//! cameras from left to right, and that of the layered image merged from them (section 4).
//!
//! ```text
//!     wall ======[ portal ]====== wall       arc: angles off the portal's normal, N images in the middles of N equal parts of it
//!           \   \    |    /   /              radius: from the portal's middle, at eye height over the floor
//!            o    o  o  o    o               all images are parallel to the portal and as fine in its plane
//! ```
//!
//! What the paper leaves open, and what is done here:
//! - The radius is not told. The default is a little more than the distance at which images give
//!   way to geometry: nearer references hold more of what far eyes see (a cone through the portal
//!   is the wider, the nearer its apex), farther ones are looked at with less magnification.
//! - Eyes more than 60 degrees off a portal's normal see geometry here
//!   ([`is_faced`](ldi_protocol::room_index::is_faced)), so the default arc is the 120 degrees in
//!   the middle of the semicircle; 180 is all of it.
//! - All images are parallel to the portal, so that their samples are equally fine in its plane:
//!   13 pictures of the same number of pixels, as the paper's of 256 x 256.
//! - A place where no eye can be, in another cell, or behind furniture is pulled in toward the
//!   portal, at most to half the radius; if there is none it is left out. Both are counted.
//! - Horizontal portals have no semicircle at eye height: geometry shows through them.

use super::zones::Gate;
use crate::placement::{Footprint, ImagePlan};
use glam::DVec3;
use ldi_protocol::index::BuildSettings;
use ldi_protocol::room_index::{LEAST_SINE, MAX_REFERENCES};
use ldi_protocol::rooms::Rooms;
use ldi_protocol::volume::WalkVolume;
use ldi_protocol::{Aabb, ViewBasis};
use rayon::prelude::*;
use serde::Serialize;

/// Lowest eyes stand this far below the eye height, metres: the walk volume's lower margin.
const BELOW_EYE_M: f64 = 0.5;
/// Steps in which places are pulled in, and the nearest of them, as shares of the radius.
const PULL_STEP: f64 = 0.1;
const PULLED_MOST: f64 = 0.5;
/// A portal whose normal is this steep is horizontal: cosine of its angle with the vertical.
const STEEPEST: f64 = 0.7;
/// References stand at least this far before the portal's plane, as a share of the radius: nearer
/// ones see it edge-on.
const LEAST_BEFORE: f64 = 0.05;
/// Half the layered image's field of view, as a tangent: 76 degrees. What lies farther to the side
/// is held by no layer. Larger: more pixels, by the square, for what is seen at grazing angles.
const WIDEST: f64 = 4.0;
/// What images say of sky holds for directions up to this tangent: all that eyes may look in
/// through a portal.
pub(crate) const EVERYWHERE: [f64; 4] = [-20.0, 20.0, -20.0, 20.0];
/// The image plane lies before the portal's nearest corner by this share of its distance: depths
/// are rounded.
const PLANE_SLACK: f64 = 1e-3;

/// How reference images are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Semicircle {
    /// Images on each side of a portal; odd, so that one looks straight at it; at most
    /// [`MAX_REFERENCES`]. The paper: 13.
    pub references: usize,
    /// Metres from the portal's middle.
    pub radius_m: f64,
    /// Degrees from the first to the last of the parts that images stand in the middles of, at
    /// most 180.
    pub arc_deg: f64,
}

impl Default for Semicircle {
    fn default() -> Self {
        Self { references: 13, radius_m: 2.0, arc_deg: 120.0 }
    }
}

impl Semicircle {
    /// Angles off the portal's normal, degrees, from left to right.
    pub fn angles_deg(&self) -> impl Iterator<Item = f64> + use<> {
        let (n, arc) = (self.references, self.arc_deg);
        (0..n).map(move |k| ((k as f64 + 0.5) / n as f64 - 0.5) * arc)
    }

    /// Whether the values are those that can be used; else why not.
    ///
    /// # Errors
    /// The value, its range.
    pub fn check(&self) -> Result<(), String> {
        if self.references.is_multiple_of(2) || self.references > MAX_REFERENCES {
            return Err(format!(
                "{} reference images: an odd number up to {MAX_REFERENCES} is needed",
                self.references
            ));
        }
        if !(0.2..=100.0).contains(&self.radius_m) {
            return Err(format!("a radius of {} m: 0.2 to 100 m are possible", self.radius_m));
        }
        if !(1.0..=180.0).contains(&self.arc_deg) {
            return Err(format!("an arc of {} degrees: 1 to 180 are possible", self.arc_deg));
        }
        Ok(())
    }
}

/// The images of one side of a portal, to be made.
#[derive(Debug, Clone, PartialEq)]
pub struct SidePlan {
    /// Position in [`Rooms::portals`].
    pub portal: usize,
    /// Which of its rooms the eyes are in.
    pub side: usize,
    /// Reference images, from left to right; at least one. Windows are those of the portal as seen
    /// from there.
    pub references: Vec<ImagePlan>,
    /// Of them the one that looks most nearly straight at the portal.
    pub central: usize,
    /// The same camera with a window as wide as the layered image may be.
    pub layered: ImagePlan,
    /// The portal's corners: rays go through them.
    pub through: Vec<DVec3>,
    /// How far eyes that use the images may be ahead of the central one, along its axis, metres.
    pub ahead_m: f64,
}

/// Figures of the plan.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct SemicircleStatistics {
    /// Sides of portals that get images.
    pub sides: usize,
    /// Sides without: horizontal portals.
    pub horizontal: usize,
    /// Sides without: no eye can face the portal from there.
    pub nobody: usize,
    /// Sides without: no place on the semicircle can be used.
    pub no_place: usize,
    /// Reference images planned.
    pub references: usize,
    /// Of them those whose place was pulled in.
    pub pulled_in: usize,
    /// Places of these sides left out.
    pub skipped: usize,
    /// Bound on the footprint of samples near the portal, output pixels.
    pub footprint_px: f64,
}

/// Plans the reference images of all portals. `near_m`: eyes nearer than this to a portal use
/// none; `sees`: whether nothing lies between two places.
pub fn plan_semicircles(
    rooms: &Rooms,
    volume: &WalkVolume,
    settings: &BuildSettings,
    near_m: f64,
    semicircle: &Semicircle,
    sees: &(dyn Fn(DVec3, DVec3) -> bool + Sync),
) -> (Vec<SidePlan>, SemicircleStatistics) {
    let places: Vec<Aabb> = volume.boxes().collect();
    let footprint = Footprint::new(&settings.camera, settings.density, settings.max_footprint_px);
    let site = Site { rooms, volume, settings, semicircle, sees, footprint };
    let sides: Vec<(usize, usize)> = (0..rooms.portals().len()).flat_map(|p| [(p, 0), (p, 1)]).collect();
    let planned: Vec<(Option<SidePlan>, SemicircleStatistics)> =
        sides.par_iter().map(|(portal, side)| site.plan(*portal, *side, near_m, &places)).collect();
    let mut statistics = SemicircleStatistics::default();
    let mut plans = Vec::new();
    for (plan, s) in planned {
        statistics.sides += usize::from(plan.is_some());
        statistics.horizontal += s.horizontal;
        statistics.nobody += s.nobody;
        statistics.no_place += s.no_place;
        statistics.references += s.references;
        statistics.pulled_in += s.pulled_in;
        statistics.skipped += s.skipped;
        statistics.footprint_px = statistics.footprint_px.max(s.footprint_px);
        plans.extend(plan);
    }
    (plans, statistics)
}

/// What plans of all sides share.
struct Site<'a> {
    rooms: &'a Rooms,
    volume: &'a WalkVolume,
    settings: &'a BuildSettings,
    semicircle: &'a Semicircle,
    sees: &'a (dyn Fn(DVec3, DVec3) -> bool + Sync),
    footprint: Footprint,
}

impl Site<'_> {
    fn plan(
        &self,
        portal: usize,
        side: usize,
        near_m: f64,
        places: &[Aabb],
    ) -> (Option<SidePlan>, SemicircleStatistics) {
        let mut statistics = SemicircleStatistics::default();
        let p = &self.rooms.portals()[portal];
        let gate = Gate::new(p, side, near_m);
        if gate.beyond.y.abs() > STEEPEST {
            statistics.horizontal = 1;
            return (None, statistics);
        }
        let room = p.cells[side];
        let users = places
            .iter()
            .filter(|b| self.rooms.cell_at(b.centre()) == room && gate.may_serve(b))
            .fold(Aabb::EMPTY, |b, p| b.union(*p));
        if users.is_empty() {
            statistics.nobody = 1;
            return (None, statistics);
        }
        let radius = self.semicircle.radius_m;
        let found: Vec<(f64, Option<(DVec3, f64)>)> =
            self.semicircle.angles_deg().map(|angle| (angle, self.place(&gate, room, angle))).collect();
        let cops: Vec<(f64, DVec3, f64)> = found.iter().filter_map(|(a, at)| at.map(|(c, r)| (*a, c, r))).collect();
        if cops.is_empty() {
            statistics.no_place = 1;
            return (None, statistics);
        }
        statistics.references = cops.len();
        statistics.skipped = found.len() - cops.len();
        statistics.pulled_in = cops.iter().filter(|(.., r)| *r < radius).count();
        // Samples lie as close in the portal's plane as those of an image straight before it have
        // to.
        let texel_m = radius / self.footprint.pixels_per_unit(1.0);
        // Eyes that face the portal are at least this far before its plane.
        let least_before_m = near_m * LEAST_SINE;
        let references: Vec<ImagePlan> =
            cops.iter().map(|(_, cop, _)| self.image(&gate, *cop, users, texel_m, least_before_m)).collect();
        let straight = |k: &usize| cops[*k].0.abs();
        let central = (0..cops.len()).min_by(|a, b| straight(a).total_cmp(&straight(b)).then(a.cmp(b))).unwrap_or(0);
        statistics.footprint_px = references.iter().map(|r| r.footprint_px).fold(0.0, f64::max);
        let widest = |t: f64, sign: f64| if t * sign > WIDEST { t } else { sign * WIDEST };
        let [l, r, b, t] = references[central].window;
        let window = [widest(l, -1.0), widest(r, 1.0), widest(b, -1.0), widest(t, 1.0)];
        let layered = ImagePlan { window, ..references[central].clone() };
        let ahead_m = layered.plane_distance - least_before_m;
        let through = p.corners.clone();
        (Some(SidePlan { portal, side, references, central, layered, through, ahead_m }), statistics)
    }

    /// The place at an angle off the portal's normal, and its distance; None if no eye can be
    /// there, or nearer.
    fn place(&self, gate: &Gate, room: Option<u32>, angle_deg: f64) -> Option<(DVec3, f64)> {
        let corners = &gate.portal.corners;
        let centre = gate.portal.centre();
        let ahead = (gate.beyond * DVec3::new(1.0, 0.0, 1.0)).normalize_or_zero();
        let right = ahead.cross(DVec3::Y);
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let radius = self.semicircle.radius_m;
        let steps = ((1.0 - PULLED_MOST) / PULL_STEP).round() as usize;
        // Sight of the middle may be blocked by a chair that an eye looks over.
        let high = corners.iter().map(|c| c.y).fold(f64::NEG_INFINITY, f64::max);
        let seen_from = |eye: DVec3| {
            let targets = [0.0, 0.5, 0.9].map(|up| centre + DVec3::Y * ((high - centre.y) * up));
            targets.into_iter().any(|t| (self.sees)(eye, t))
        };
        (0..=steps).map(|k| radius * (1.0 - PULL_STEP * k as f64)).find_map(|r| {
            let at = centre + (right * sin - ahead * cos) * r;
            let y = self.eye_height(at.x, at.z, centre.y)?;
            let eye = DVec3::new(at.x, y, at.z);
            let usable = gate.before_m(eye) >= LEAST_BEFORE * radius
                && self.rooms.cell_at(eye) == room
                && self.volume.contains(eye)
                && seen_from(eye);
            usable.then_some((eye, r))
        })
    }

    /// The height of eyes over the floor at (x, z) that is nearest to `about`.
    fn eye_height(&self, x: f64, z: f64, about: f64) -> Option<f64> {
        let level = |[low, high]: [f64; 2]| match self.settings.eye_height_m {
            Some(_) => (low + BELOW_EYE_M).min(high),
            None => about.clamp(low, high),
        };
        self.volume.heights(x, z).map(level).min_by(|a, b| (a - about).abs().total_cmp(&(b - about).abs()))
    }

    /// A reference image from a place: the portal's rectangle.
    fn image(&self, gate: &Gate, cop: DVec3, users: Aabb, texel_m: f64, least_before_m: f64) -> ImagePlan {
        let axis = gate.beyond;
        let basis = ViewBasis::from_yaw_pitch(
            (-axis.x).atan2(-axis.z).to_degrees(),
            axis.y.clamp(-1.0, 1.0).asin().to_degrees(),
        );
        let mut window = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let mut plane_m = f64::INFINITY;
        for corner in &gate.portal.corners {
            let v = *corner - cop;
            let z = v.dot(basis.forward);
            let (x, y) = (v.dot(basis.right) / z, v.dot(basis.up) / z);
            plane_m = plane_m.min(z);
            window = [window[0].min(x), window[1].max(x), window[2].min(y), window[3].max(y)];
        }
        // A pixel around, so that its borders are whole.
        let pad = texel_m / plane_m;
        let [l, r, b, t] = window;
        let plane_distance = plane_m * (1.0 - PLANE_SLACK);
        let pixels_per_unit = plane_m / texel_m;
        // Of eyes as near before the plane as any: nearer ones see geometry
        // (`placement::footprint`).
        let scale = pixels_per_unit / self.footprint.pixels_per_unit(1.0);
        let ahead_m = plane_distance - least_before_m * (1.0 - PLANE_SLACK);
        let footprint_px = self.footprint.bound_px(scale, std::f64::consts::FRAC_PI_2, plane_distance, ahead_m);
        ImagePlan {
            basis,
            cop,
            plane_distance,
            beside: [f64::INFINITY; 4],
            pixels_per_unit,
            window: [l - pad, r + pad, b - pad, t + pad],
            users,
            directions: Vec::new(),
            footprint_px,
        }
    }
}

#[cfg(test)]
#[path = "semicircle_test.rs"]
mod tests;
