//! Which directions are looked in through a placement's images.
//!
//! In: the bins of directions that use a placement, with the planes of their pictures. Out: a
//! [`Gaze`]: a cube of squares around the eye, six faces of squares of about equal angle, and
//! which of them some picture holds. One ray through each of these squares is what an eye sees of
//! its surroundings (`construct::sight`).

use super::{
    bin_planes::{Behind, BinPlanes},
    faces::{FACES, face_basis},
};
use crate::render::Ray;
use glam::DVec3;
use ldi_protocol::{Aabb, rooms::newell};
use std::f64::consts::FRAC_PI_4;

/// Squares of directions around an eye, and which of them are looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaze {
    /// Squares along each side of each face.
    side: usize,
    /// A bit for each: by face, row (upward), column (to the right).
    looked: Vec<u64>,
}

/// Angle from the middle of a square to the middle of its sides is at most this many pixels of the
/// picture, at its middle. Larger: quicker, and what few eyes see through narrow gaps is
/// overlooked.
const HALF_SQUARE_PIXELS: f64 = 16.0;

/// Rays through a polygon may pass this far beside it, metres: portals may be a little smaller
/// than their openings.
const BESIDE_M: f64 = 0.03;
/// Rays begin this far before the eye, metres: the viewer's near plane.
const NEAR_M: f64 = 0.02;
const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];

impl Gaze {
    /// Every direction, for pictures of this focal length in pixels.
    pub fn everywhere(focal_px: f64) -> Self {
        let side = (FRAC_PI_4 / (HALF_SQUARE_PIXELS / focal_px).atan()).ceil().clamp(1.0, 1024.0) as usize;
        Self { side, looked: vec![u64::MAX; (FACES.len() * side * side).div_ceil(64)] }
    }

    /// No direction.
    pub(super) fn nowhere(focal_px: f64) -> Self {
        let mut gaze = Self::everywhere(focal_px);
        gaze.looked.fill(0);
        gaze
    }

    /// The directions that pictures within a bin hold.
    pub(super) fn of(bin: &BinPlanes, focal_px: f64) -> Self {
        let mut gaze = Self::nowhere(focal_px);
        let eye = Aabb { min: DVec3::ZERO, max: DVec3::ZERO };
        for at in 0..gaze.rows() * gaze.side {
            let square = Aabb::from_points(CORNERS.map(|corner| gaze.on_cube(at, corner)));
            gaze.looked[at / 64] |= u64::from(bin.show(&eye, &square) != Behind::Never) << (at % 64);
        }
        gaze
    }

    /// Adds what another one looks at; both are for the same pictures.
    pub(super) fn add(&mut self, other: &Self) {
        self.looked.iter_mut().zip(&other.looked).for_each(|(a, b)| *a |= b);
    }

    /// Rows of squares of all faces.
    fn rows(&self) -> usize {
        FACES.len() * self.side
    }

    /// Squares of a row.
    fn columns(&self) -> usize {
        self.side
    }

    /// Whether some picture holds some of a square; row-major.
    #[inline]
    fn looked(&self, square: usize) -> bool {
        self.looked[square / 64] >> (square % 64) & 1 == 1
    }

    /// The unit vector through a place in a square, both coordinates from 0 to 1.
    #[inline]
    fn direction(&self, square: usize, at: [f64; 2]) -> DVec3 {
        self.on_cube(square, at).normalize()
    }

    /// What an eye sees in a direction of unit length.
    pub fn ray(eye: DVec3, direction: DVec3) -> Ray {
        Ray { origin: eye, direction, t_min: NEAR_M, t_max: f64::INFINITY }
    }

    /// Rays of unit length through the squares that are looked at, each through another place in
    /// its square for another `number`, as regular rasters overlook regular gaps; in batches of
    /// neighbours, which share most of their way.
    pub fn rays(&self, eye: DVec3, number: usize) -> impl Iterator<Item = Vec<Ray>> + '_ {
        const TILE: usize = 8;
        let (columns, rows) = (self.columns(), self.rows());
        let tiles = (0..rows).step_by(TILE).flat_map(move |r| (0..columns).step_by(TILE).map(move |c| (r, c)));
        tiles.map(move |(row, column)| {
            let squares = (row..(row + TILE).min(rows))
                .flat_map(|r| (column..(column + TILE).min(columns)).map(move |c| r * columns + c));
            let ray =
                |square: usize| Self::ray(eye, self.direction(square, scattered(number * rows * columns + square)));
            squares.filter(|s| self.looked(*s)).map(ray).collect()
        })
    }

    /// Rays of unit length through a flat convex polygon and [`BESIDE_M`] around it, no farther
    /// apart than squares are wide, each through another place for another `number`.
    pub fn rays_through(&self, eye: DVec3, number: usize, polygon: &[DVec3]) -> Vec<Ray> {
        let Some(frame) = Frame::of(polygon) else { return Vec::new() };
        let distance = polygon.iter().map(|c| c.distance(eye)).fold(f64::INFINITY, f64::min);
        // At least so many each way: a door across the room is no wider than a few squares.
        const LEAST: f64 = 16.0;
        const MOST: f64 = 96.0;
        let step = (2.0 * self.half_angle() * distance).max(1e-6);
        let count = |size: f64| (size / step).ceil().clamp(LEAST, MOST) as usize;
        let [columns, rows] = frame.size.map(count);
        let mut out = Vec::with_capacity(columns * rows);
        for at in 0..columns * rows {
            let [x, y] = scattered(number * columns * rows + at);
            let place = [
                ((at % columns) as f64 + x) / columns as f64 * frame.size[0],
                ((at / columns) as f64 + y) / rows as f64 * frame.size[1],
            ];
            let p = frame.origin + frame.across[0] * place[0] + frame.across[1] * place[1];
            if let Some(direction) = (p - eye).try_normalize().filter(|_| frame.holds(p)) {
                out.push(Self::ray(eye, direction));
            }
        }
        out
    }

    /// Angle from the middle of a square to a side, radians; squares toward a face's corners are
    /// narrower.
    pub fn half_angle(&self) -> f64 {
        FRAC_PI_4 / self.side as f64
    }

    fn on_cube(&self, square: usize, at: [f64; 2]) -> DVec3 {
        let (row, column) = (square / self.side, square % self.side);
        let basis = face_basis(row / self.side);
        // Equal steps of the angle.
        let place = |k: usize, x: f64| ((2.0 * (k as f64 + x) / self.side as f64 - 1.0) * FRAC_PI_4).tan();
        basis.forward + basis.right * place(column, at[0]) + basis.up * place(row % self.side, at[1])
    }
}

/// A rectangle around a polygon in its plane.
struct Frame {
    origin: DVec3,
    across: [DVec3; 2],
    size: [f64; 2],
    /// Per side of the polygon a corner and the inward direction.
    sides: Vec<(DVec3, DVec3)>,
}

impl Frame {
    fn of(polygon: &[DVec3]) -> Option<Self> {
        let n = polygon.len();
        let normal = newell(polygon).try_normalize()?;
        let x = (polygon[1] - polygon[0]).try_normalize()?;
        let across = [x, normal.cross(x)];
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for c in polygon {
            for k in 0..2 {
                let t = (*c - polygon[0]).dot(across[k]);
                (low[k], high[k]) = (low[k].min(t - BESIDE_M), high[k].max(t + BESIDE_M));
            }
        }
        let side = |i: usize| (polygon[i], normal.cross(polygon[(i + 1) % n] - polygon[i]).normalize_or_zero());
        Some(Self {
            origin: polygon[0] + across[0] * low[0] + across[1] * low[1],
            across,
            size: [high[0] - low[0], high[1] - low[1]],
            sides: (0..n).map(side).collect(),
        })
    }

    fn holds(&self, p: DVec3) -> bool {
        self.sides.iter().all(|(corner, inward)| (p - *corner).dot(*inward) >= -BESIDE_M)
    }
}

/// A place in the unit square, another for each number.
pub(crate) fn scattered(number: usize) -> [f64; 2] {
    // SplitMix64's mixing step.
    let mut z = (number as u64).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^= z >> 31;
    [z >> 40, z >> 16 & 0xFF_FFFF].map(|b| b as f64 / f64::from(1u32 << 24))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::Random;
    use ldi_protocol::{OutputCamera, ViewBasis};

    #[test]
    fn rays_through_a_polygon_fill_it() {
        let gaze = Gaze::everywhere(1000.0);
        let polygon: Vec<DVec3> =
            [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 2.0), (0.0, 1.0)].map(|(x, y)| DVec3::new(x, y, -4.0)).to_vec();
        let rays = gaze.rays_through(DVec3::new(1.0, 0.5, 0.0), 3, &polygon);
        let places: Vec<DVec3> = rays.iter().map(|r| r.at(-4.0 / r.direction.z)).collect();
        let inside =
            |p: &DVec3, by: f64| p.x > -by && p.x < 2.0 + by && p.y > -by && p.y + (p.x - 1.0).abs() < 2.0 + 1.5 * by;
        assert!(places.iter().all(|p| inside(p, BESIDE_M)));
        // Of places inside, each has a ray within the width of a square.
        let mut random = Random::new(8);
        let width = 2.0 * 4.0 * 2.0 * gaze.half_angle();
        for _ in 0..2000 {
            let p = DVec3::new(2.0 * random.unit(), 2.0 * random.unit(), -4.0);
            assert!(!inside(&p, 0.0) || places.iter().any(|q| q.distance(p) < width), "{p}");
        }
        assert!(gaze.rays_through(DVec3::ZERO, 0, &[DVec3::ZERO; 3]).is_empty());
    }

    #[test]
    fn squares_fill_the_sphere_and_pictures_are_held() {
        let camera = OutputCamera { width: 640, height: 360, fov_deg: 60.0 };
        let (tx, ty) = (camera.half_tan_x(), camera.half_tan_y());
        let bins =
            [BinPlanes::new([20.0, 30.0], [-10.0, 0.0], tx, ty), BinPlanes::new([90.0, 100.0], [50.0, 60.0], tx, ty)];
        let (all, mut gaze) = (Gaze::everywhere(camera.focal_px()), Gaze::of(&bins[0], camera.focal_px()));
        gaze.add(&Gaze::of(&bins[1], camera.focal_px()));
        // Solid angles of squares, by their middles and corners, add up to the whole.
        let (mut sphere, mut widest) = (0.0, 0.0f64);
        for square in 0..all.rows() * all.columns() {
            let [a, b, c, d] = CORNERS.map(|at| all.direction(square, at));
            let triangle = |a: DVec3, b: DVec3, c: DVec3| {
                2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a))
            };
            sphere += triangle(a, b, c) + triangle(b, c, d);
            widest = widest.max(a.angle_between(b)).max(a.angle_between(c));
            assert!(all.looked(square));
        }
        assert!((sphere - 4.0 * std::f64::consts::PI).abs() < 1e-6, "{sphere}");
        assert!(widest <= 2.0 * all.half_angle() + 1e-9 && widest.tan() * camera.focal_px() < 32.01);

        let looked = (0..gaze.rows() * gaze.columns()).filter(|s| gaze.looked(*s)).count();
        assert!(looked > 50 && looked * 3 < gaze.rows() * gaze.columns(), "{looked}");
        // Any direction of any picture lies in a square that is looked at.
        let mut random = Random::new(3);
        for _ in 0..20_000 {
            let (yaw, pitch) = if random.unit() < 0.5 { (20.0, -10.0) } else { (90.0, 50.0) };
            let basis = ViewBasis::from_yaw_pitch(yaw + 10.0 * random.unit(), pitch + 10.0 * random.unit());
            let (x, y) = ((2.0 * random.unit() - 1.0) * tx, (2.0 * random.unit() - 1.0) * ty);
            let ray = basis.forward + basis.right * x + basis.up * y;
            let face =
                (0..6).max_by(|a, b| face_basis(*a).forward.dot(ray).total_cmp(&face_basis(*b).forward.dot(ray)));
            let b = face_basis(face.unwrap());
            let z = ray.dot(b.forward);
            let place =
                |x: f64| ((((x / z).atan() / FRAC_PI_4 + 1.0) * 0.5 * gaze.side as f64) as usize).min(gaze.side - 1);
            let row = face.unwrap() * gaze.side + place(ray.dot(b.up));
            assert!(gaze.looked(row * gaze.side + place(ray.dot(b.right))), "{ray}");
        }
    }
}
