//! Analytic scenes in f64: rectangles, with or without a hole, and spheres.

use super::super::caster::{Facet, Met, SubsetCaster};
use crate::{
    placement::{DirectionRange, ImagePlan},
    render::{Hit, Ray, RayFootprint},
};
use glam::DVec3;
use ldi_protocol::{Aabb, OutputCamera, ViewBasis};

pub(super) enum Shape {
    /// Corner and edges; a hole in edge coordinates (u from, u to, v from, v to).
    Rect {
        corner: DVec3,
        du: DVec3,
        dv: DVec3,
        hole: Option<[f64; 4]>,
    },
    Sphere {
        centre: DVec3,
        radius: f64,
    },
}

pub(super) struct Piece {
    pub shape: Shape,
    pub linear: [f32; 3],
}

#[derive(Default)]
pub(super) struct Analytic {
    pub pieces: Vec<Piece>,
    /// What stays: an opaque scene that images do not hold.
    pub staying: Option<Box<Analytic>>,
    /// Period of a texture on everything, metres along x: lit for the first half of each, dark for
    /// the second.
    pub grating_m: Option<f64>,
}

impl Analytic {
    pub fn rect(
        mut self,
        corner: [f64; 3],
        du: [f64; 3],
        dv: [f64; 3],
        hole: Option<[f64; 4]>,
        linear: [f32; 3],
    ) -> Self {
        let shape = Shape::Rect { corner: corner.into(), du: du.into(), dv: dv.into(), hole };
        self.pieces.push(Piece { shape, linear });
        self
    }
    pub fn sphere(mut self, centre: [f64; 3], radius: f64, linear: [f32; 3]) -> Self {
        self.pieces.push(Piece { shape: Shape::Sphere { centre: centre.into(), radius }, linear });
        self
    }

    pub fn behind(mut self, staying: Analytic) -> Self {
        self.staying = Some(Box::new(staying));
        self
    }

    /// Whether a ray meets what stays before it meets anything else.
    pub fn first_stays(&self, origin: DVec3, direction: DVec3) -> bool {
        let mut met = [Met::Nothing];
        self.meet(&[Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY }], &mut met);
        met == [Met::Stays]
    }

    /// All hits on a ray's line beyond its origin: (t, piece, unit normal).
    pub fn all_hits(&self, origin: DVec3, direction: DVec3) -> Vec<(f64, usize, DVec3)> {
        let mut hits = Vec::new();
        for (i, piece) in self.pieces.iter().enumerate() {
            match &piece.shape {
                Shape::Rect { corner, du, dv, hole } => {
                    let n = du.cross(*dv);
                    let t = n.dot(*corner - origin) / n.dot(direction);
                    let x = origin + direction * t - *corner;
                    let (u, v) = (x.dot(*du) / du.length_squared(), x.dot(*dv) / dv.length_squared());
                    let inside = (0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v);
                    let open = hole.is_some_and(|h| u > h[0] && u < h[1] && v > h[2] && v < h[3]);
                    if t.is_finite() && t > 0.0 && inside && !open {
                        hits.push((t, i, n.normalize()));
                    }
                }
                Shape::Sphere { centre, radius } => {
                    let (o, a) = (origin - *centre, direction.length_squared());
                    let b = o.dot(direction);
                    let root = b * b - a * (o.length_squared() - radius * radius);
                    if root >= 0.0 {
                        for t in [(-b - root.sqrt()) / a, (-b + root.sqrt()) / a] {
                            if t > 0.0 {
                                hits.push((t, i, (o + direction * t) / *radius));
                            }
                        }
                    }
                }
            }
        }
        hits.sort_by(|a, b| a.0.total_cmp(&b.0));
        hits
    }
}

impl SubsetCaster for Analytic {
    const PLANAR: bool = false;

    fn trace(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        for (ray, hit) in rays.iter().zip(hits) {
            let all = self.all_hits(ray.origin, ray.direction);
            *hit = all.iter().find(|h| h.0 >= ray.t_min && h.0 <= ray.t_max).map(|(t, piece, n)| {
                // A sphere's patches, small enough to be nearly plane.
                let patch = match self.pieces[*piece].shape {
                    Shape::Rect { .. } => 0,
                    Shape::Sphere { .. } => {
                        let q = ((*n + 1.0) * 200.0).floor();
                        1 + (q.x * 160_000.0 + q.y * 400.0 + q.z) as u32
                    }
                };
                Hit { t: *t, triangle: *piece as u32 | patch << 4, u: 0.0, v: 0.0 }
            });
        }
    }

    fn meet(&self, rays: &[Ray], met: &mut [Met]) {
        for (ray, met) in rays.iter().zip(met) {
            let first = |scene: &Analytic| {
                let hits = scene.all_hits(ray.origin, ray.direction);
                hits.iter().map(|h| h.0).find(|t| *t >= ray.t_min && *t <= ray.t_max)
            };
            let stays = self.staying.as_deref().and_then(first);
            *met = match first(self) {
                Some(t) if stays.is_none_or(|s| t < s) => Met::Replaced(t),
                _ if stays.is_some() => Met::Stays,
                _ => Met::Nothing,
            };
        }
    }

    fn facet(&self, ray: &Ray, hit: &Hit) -> Facet {
        let all = self.all_hits(ray.origin, ray.direction);
        let normal = all.iter().find(|h| h.0 == hit.t).map_or(DVec3::ZERO, |h| h.2);
        Facet { normal, surface: hit.triangle & 15 }
    }

    fn shade(&self, ray: &Ray, hit: &Hit, footprint: &RayFootprint) -> [f32; 3] {
        let linear = self.pieces[(hit.triangle & 15) as usize].linear;
        let Some(period) = self.grating_m else { return linear };
        let x = (ray.origin + ray.direction * hit.t).x;
        let half = 0.5 * footprint.direction_dx.x * hit.t;
        linear.map(|c| c * lit_share(period, x - half, x + half))
    }
}

/// How much of a grating is lit between two places along x, as a share.
pub(super) fn lit_share(period: f64, from: f64, to: f64) -> f32 {
    let lit_until = |x: f64| ((x / period).floor() + (2.0 * (x / period).rem_euclid(1.0)).min(1.0)) * 0.5 * period;
    ((lit_until(to) - lit_until(from)) / (to - from)) as f32
}

/// A small picture, so that tests are quick.
pub(super) const OUTPUT: OutputCamera = OutputCamera { width: 160, height: 120, fov_deg: 60.0 };
pub(super) const GREY: [f32; 3] = [0.5; 3];
pub(super) const RED: [f32; 3] = [0.8, 0.1, 0.1];

/// An image that looks along -Z from the origin, its plane `plane_m` away, for eyes within `eyes`
/// of the origin.
pub(super) fn plan(plane_m: f64, eyes: [f64; 3]) -> ImagePlan {
    let eyes = DVec3::from(eyes);
    ImagePlan {
        basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
        cop: DVec3::ZERO,
        plane_distance: plane_m,
        beside: [f64::INFINITY; 4],
        pixels_per_unit: OUTPUT.focal_px(),
        window: [-1.1, 1.1, -0.9, 0.9],
        users: Aabb { min: -eyes, max: eyes },
        directions: vec![DirectionRange { yaw_deg: [-5.0, 5.0], pitch_deg: [-3.0, 3.0] }],
        footprint_px: 2.0,
    }
}

/// A wall with a window, before a back wall, a slanted floor that meets it, and a ball between the
/// walls.
pub(super) fn room() -> Analytic {
    Analytic::default()
        .rect([-30.0, -20.0, -20.0], [60.0, 0.0, 0.0], [0.0, 40.0, 0.0], None, GREY)
        .rect([-4.0, -2.5, -10.0], [8.0, 0.0, 0.0], [0.0, 5.0, 0.0], Some([0.3, 0.7, 0.3, 0.8]), RED)
        .rect([-30.0, -3.0, -20.0], [60.0, 0.0, 0.0], [0.0, -0.4, 11.0], None, [0.2, 0.5, 0.2])
        .sphere([1.0, 0.0, -14.0], 1.5, [0.2, 0.2, 0.7])
}

/// Deterministic values in [0, 1).
pub(super) struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
    pub fn within(&mut self, range: [f64; 2]) -> f64 {
        range[0] + (range[1] - range[0]) * self.next()
    }
    pub fn inside(&mut self, b: &Aabb) -> DVec3 {
        let at = DVec3::new(self.next(), self.next(), self.next());
        b.min + b.size() * at
    }
}
