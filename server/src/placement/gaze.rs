//! Which directions are looked in through a placement's images.
//!
//! In: the bins of directions that use a placement, with the planes of their pictures. Out: a [`Gaze`]: a cube of squares around the eye, six faces of
//! squares of about equal angle, and which of them some picture holds. One ray through each of these squares is what an eye sees of its surroundings
//! (`construct::sight`).

use super::{
    bin_planes::{Behind, BinPlanes},
    near_box::{FACES, face_basis},
};
use crate::render::Ray;
use glam::DVec3;
use ldi_protocol::Aabb;
use std::f64::consts::FRAC_PI_4;

/// Squares of directions around an eye, and which of them are looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct Gaze {
    /// Squares along each side of each face.
    side: usize,
    /// A bit for each: by face, row (upward), column (to the right).
    looked: Vec<u64>,
}

/// Angle from the middle of a square to the middle of its sides is at most this many pixels of the picture, at its middle. Larger: quicker, and what few
/// eyes see through narrow gaps is overlooked.
const HALF_SQUARE_PIXELS: f64 = 16.0;

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

    /// Rays of unit length through the squares that are looked at, each through another place in its square for another `number`, as regular rasters
    /// overlook regular gaps; in batches of neighbours, which share most of their way.
    pub fn rays(&self, eye: DVec3, number: usize) -> impl Iterator<Item = Vec<Ray>> + '_ {
        const TILE: usize = 8;
        let (columns, rows) = (self.columns(), self.rows());
        let tiles = (0..rows).step_by(TILE).flat_map(move |r| (0..columns).step_by(TILE).map(move |c| (r, c)));
        tiles.map(move |(row, column)| {
            let squares = (row..(row + TILE).min(rows))
                .flat_map(|r| (column..(column + TILE).min(columns)).map(move |c| r * columns + c));
            let ray = |square: usize| Ray {
                origin: eye,
                direction: self.direction(square, scattered(number * rows * columns + square)),
                t_min: NEAR_M,
                t_max: f64::INFINITY,
            };
            squares.filter(|s| self.looked(*s)).map(ray).collect()
        })
    }

    /// Angle from the middle of a square to a side, radians; squares toward a face's corners are narrower.
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

/// A place in the unit square, another for each number.
fn scattered(number: usize) -> [f64; 2] {
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
