//! Cameras: the central one, the construction cameras around it, and the eyes that will use the
//! image.
//!
//! All share one orientation and one scale, so that going from one to another is a translation. In
//! absolute image coordinates (U, V) = `pixels_per_unit` (x/z, -y/z), with an eye at offset e =
//! (right, up, forward) from the centre of projection:
//!
//! ```text
//! W = 1 - e_z d      U' = (U - k_x d) / W      V' = (V - k_y d) / W      d' = d / W      k = pixels_per_unit (e_x, -e_y)
//! ```
//!
//! which is McMillan's equation with P2 = P1; directions (d = 0) keep their coordinates, so sky is
//! one bit for all eyes.

use super::{ConstructError, sight::Open};
use crate::placement::ImagePlan;
use glam::{DVec2, DVec3};
use ldi_protocol::{
    OutputCamera, ViewBasis,
    ldi::{DisparityCodes, Ldi, LdiCamera},
};

impl ConstructionCamera {
    /// Absolute image coordinates of the middle of one of its pixels.
    #[inline]
    pub fn centre(&self, pixel: usize) -> (f64, f64) {
        let (u, v) = self.window.centre(pixel);
        (u / self.scale, v / self.scale)
    }

    /// How long a step to the image's next column, and to its next row, is in the picture of this
    /// camera at full scale, on a surface with this disparity and gradient, pixels.
    pub fn steps(&self, disparity: f64, gradient: [f32; 2]) -> [f64; 2] {
        let [gu, gv] = gradient.map(f64::from);
        let k = self.shift.k;
        let w = 1.0 / (1.0 - self.shift.forward * disparity);
        [(1.0 - k.x * gu).hypot(k.y * gu) * w, (k.x * gv).hypot(1.0 - k.y * gv) * w]
    }

    /// How many pixels of the image lie from one of its rays to the next on such a surface, along
    /// each axis, rounded up. At most 32, by judgement: what it sees still more steeply shows as a
    /// line.
    pub fn apart(&self, disparity: f64, gradient: [f32; 2]) -> [u8; 2] {
        self.steps(disparity, gradient).map(|step| (1.0 / (self.scale * step)).ceil().min(32.0) as u8)
    }

    /// The pixels of another window, at full scale, that have the directions of a pixel.
    pub fn same_directions<'a>(&self, pixel: u32, window: &'a Window) -> impl Iterator<Item = u32> + use<'a> {
        let (u, v) = self.centre(pixel as usize);
        let reach = 0.5 / self.scale;
        // Pixels whose middles lie within, the one that holds the middle in any case.
        let span = |x: f64| {
            let (first, last) = ((x - reach - 0.5).ceil() as i64, (x + reach - 0.5).floor() as i64);
            first.min(x.floor() as i64)..=last.max(x.floor() as i64)
        };
        let (columns, rows) = (span(u), span(v));
        rows.flat_map(move |row| {
            columns.clone().filter_map(move |column| {
                window.index(column - i64::from(window.left), row - i64::from(window.top)).map(|i| i as u32)
            })
        })
    }
}

/// What all cameras of one construction share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lens {
    pub basis: ViewBasis,
    pub pixels_per_unit: f64,
}

impl Lens {
    /// World direction through absolute image coordinates, component 1 along forward.
    #[inline]
    pub fn ray(&self, u: f64, v: f64) -> DVec3 {
        let s = 1.0 / self.pixels_per_unit;
        self.basis.forward + self.basis.right * (u * s) - self.basis.up * (v * s)
    }
    /// A world vector as (right, up, forward).
    pub fn in_basis(&self, v: DVec3) -> DVec3 {
        DVec3::new(v.dot(self.basis.right), v.dot(self.basis.up), v.dot(self.basis.forward))
    }
}

/// A rectangle of pixels of the common image plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub left: i32,
    pub top: i32,
    pub width: u32,
    pub height: u32,
}

impl Window {
    /// Position of a pixel in row-major order; None outside.
    #[inline]
    pub fn index(&self, column: i64, row: i64) -> Option<usize> {
        let inside = column >= 0 && row >= 0 && column < i64::from(self.width) && row < i64::from(self.height);
        inside.then(|| row as usize * self.width as usize + column as usize)
    }
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }
    /// Whether an image may be that large.
    pub fn check(&self, max_pixels: u64) -> Result<(), ConstructError> {
        let fits = self.width <= Ldi::MAX_SIDE
            && self.height <= Ldi::MAX_SIDE
            && self.pixels() as u64 <= max_pixels.min(Ldi::MAX_PIXELS);
        let (width, height) = (f64::from(self.width), f64::from(self.height));
        if fits { Ok(()) } else { Err(ConstructError::Size { width, height, max_pixels }) }
    }
    /// As tangents (left, right, bottom, top) of a plan; borders that are those of the `whole` are
    /// the plan's own, unrounded.
    pub fn tangents_within(&self, whole: &Self, plan: &ImagePlan) -> [f64; 4] {
        let ends = |w: &Self| [w.left, w.left + w.width as i32, w.top + w.height as i32, w.top];
        let (mine, all) = (ends(self), ends(whole));
        let sign = [1.0, 1.0, -1.0, -1.0];
        std::array::from_fn(|k| {
            if mine[k] == all[k] { plan.window[k] } else { sign[k] * f64::from(mine[k]) / plan.pixels_per_unit }
        })
    }
    /// Absolute coordinates of a pixel's centre.
    #[inline]
    pub fn centre(&self, pixel: usize) -> (f64, f64) {
        let (row, column) = (pixel / self.width as usize, pixel % self.width as usize);
        (f64::from(self.left) + column as f64 + 0.5, f64::from(self.top) + row as f64 + 0.5)
    }
}

/// A translation of the camera, in units of the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shift {
    pub k: DVec2,
    pub forward: f64,
}

impl Shift {
    pub fn new(lens: &Lens, offset_in_basis: DVec3) -> Self {
        Self { k: DVec2::new(offset_in_basis.x, -offset_in_basis.y) * lens.pixels_per_unit, forward: offset_in_basis.z }
    }
    pub fn reversed(&self) -> Self {
        Self { k: -self.k, forward: -self.forward }
    }
    /// (U, V, d) as the moved camera sees it; meaningless where 1 - e_z d <= 0.
    #[inline]
    pub fn apply(&self, u: f64, v: f64, d: f64) -> (f64, f64, f64) {
        let w = 1.0 / (1.0 - self.forward * d);
        ((u - self.k.x * d) * w, (v - self.k.y * d) * w, d * w)
    }
}

/// A construction camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct ConstructionCamera {
    pub position: DVec3,
    pub shift: Shift,
    /// Its pixels, in absolute image coordinates times `scale`.
    pub window: Window,
    /// Its pixels per pixel of the image, at most 1.
    pub scale: f64,
    /// Depth from here before which nothing of the subset lies.
    pub near_m: f64,
}

/// A construction camera, and where in its picture it may see something of the image; None:
/// anywhere.
#[derive(Debug, Clone)]
pub(super) struct View {
    pub camera: ConstructionCamera,
    pub open: Option<Open>,
}

/// Tangents (left, right, top, bottom; downward positive) that the users' pictures reach, measured
/// on the image's orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reach {
    pub u: [f64; 2],
    pub v: [f64; 2],
}

/// The geometry of one construction.
#[derive(Debug, Clone)]
pub(super) struct Rig {
    pub lens: Lens,
    pub cop: DVec3,
    pub window: Window,
    /// Depth from the centre of projection before which nothing of the subset lies.
    pub near_m: f64,
    /// Corners of the users' box, (right, up, forward) from the centre of projection.
    pub user_offsets: [DVec3; 8],
    pub reach: Reach,
    /// An upper bound on |d(output pixel) / d(disparity)| over the users, pixel metres.
    pub parallax_bound: f64,
}

/// Depth bounds are loosened by this, relatively: cells touch the plane, rays are cast in f32.
const PLANE_SLACK: f64 = 1e-5;
/// Pixels of the image per pixel of a construction camera, per side. What it finds is cast again
/// at full resolution, and continued into what lies between (`merge`). On 24 images of the clinic
/// 2 took 1.16 s per million pixels where 1 took 1.61; both found 0.92 samples per pixel.
pub(super) const COARSENESS: usize = 2;
/// A face may have this many pixels a side: 120 times the picture's width. What nobody looks at of
/// it is never made.
const MOST_FACE_SIDE: f64 = (1 << 17) as f64;
/// A construction camera may have this many pixels, or four times the image's.
const MOST_PIXELS: u64 = 1 << 24;
/// The construction cameras stop short of the users' box by this factor, so that what they see
/// still has neighbours beyond.
const WITHIN_USERS: f64 = 0.98;

impl Rig {
    /// Over the whole window of a plan, which may be larger than an image can be.
    pub fn new(plan: &ImagePlan, output: &OutputCamera) -> Result<Self, ConstructError> {
        let lens = Lens { basis: plan.basis, pixels_per_unit: plan.pixels_per_unit };
        let sound = plan.pixels_per_unit.is_finite()
            && plan.pixels_per_unit > 0.0
            && plan.plane_distance.is_finite()
            && plan.plane_distance > 0.0
            && plan.cop.is_finite()
            && plan.window.iter().all(|w| w.is_finite())
            && plan.window[0] < plan.window[1]
            && plan.window[2] < plan.window[3]
            && !plan.users.is_empty();
        if !sound {
            return Err(ConstructError::Plan);
        }
        let s = plan.pixels_per_unit;
        let [left, right, bottom, top] = plan.window;
        let window = pixel_window([left * s, right * s, -top * s, -bottom * s], MOST_FACE_SIDE)?;
        let near_m = plan.plane_distance * (1.0 - PLANE_SLACK);
        let user_offsets = plan.users.corners().map(|c| lens.in_basis(c - plan.cop));
        let reach = Reach::of(plan, output);
        Ok(Self {
            lens,
            cop: plan.cop,
            window,
            near_m,
            user_offsets,
            reach,
            parallax_bound: parallax_bound(&user_offsets, near_m, output),
        })
    }

    /// Rounds of construction cameras for eyes that may be anywhere in the users' box: the four
    /// corners nearest the plane, from where eyes see furthest around things, then the other four.
    pub fn corner_cameras(&self) -> Vec<Vec<View>> {
        let mut corners = self.user_offsets;
        corners.sort_by(|a, b| b.z.total_cmp(&a.z));
        // At the centre nothing new is seen.
        let apart = |half: &[DVec3]| {
            half.iter()
                .filter(|c| c.length() >= 1e-4 * self.near_m)
                .filter_map(|c| self.camera_at(*c * WITHIN_USERS))
                .map(|camera| View { camera, open: None })
                .collect()
        };
        corners.chunks_exact(4).map(apart).collect()
    }

    /// The camera at an offset; None where its picture holds nothing that a user may look at.
    pub fn camera_at(&self, offset: DVec3) -> Option<ConstructionCamera> {
        let near_m = self.near_m - offset.z;
        // Closer to the plane than this, its picture of the plane is without bounds.
        if near_m < 0.05 * self.near_m {
            return None;
        }
        let shift = Shift::new(&self.lens, offset);
        let (w, s) = (self.window, self.lens.pixels_per_unit);
        let mut extent = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for d in [0.0, 1.0 / self.near_m] {
            for (u, v) in [(w.left, w.top), (w.left + w.width as i32, w.top + w.height as i32)] {
                let (u, v, _) = shift.apply(f64::from(u), f64::from(v), d);
                extent = [extent[0].min(u), extent[1].max(u), extent[2].min(v), extent[3].max(v)];
            }
        }
        let [l, r] = [extent[0].max(self.reach.u[0] * s), extent[1].min(self.reach.u[1] * s)];
        let [t, b] = [extent[2].max(self.reach.v[0] * s), extent[3].min(self.reach.v[1] * s)];
        if l + 1.0 >= r || t + 1.0 >= b {
            return None;
        }
        // Coming nearer to the plane magnifies it, which brings nothing new.
        let scale = (near_m / self.near_m).min(1.0) / COARSENESS as f64;
        // Memory stays bounded; only grotesquely wide pictures exceed this.
        let window = pixel_window([l, r, t, b].map(|x| x * scale), f64::from(Ldi::MAX_SIDE)).ok()?;
        window.check(MOST_PIXELS.max(4 * w.pixels() as u64)).ok()?;
        let position = self.cop
            + self.lens.basis.right * offset.x
            + self.lens.basis.up * offset.y
            + self.lens.basis.forward * offset.z;
        Some(ConstructionCamera { position, shift, window, scale, near_m })
    }

    /// Whether some user may have (U, V, d) in the picture: false only if from every corner of the
    /// users' box the point lies beyond the same border of their reach (what a box's corners all
    /// see beyond a border, its inside does too: the border is a plane).
    #[inline]
    pub fn in_reach(&self, u: f64, v: f64, d: f64) -> bool {
        let s = 1.0 / self.lens.pixels_per_unit;
        let (x, y) = (u * s, v * s);
        let mut beyond = [true; 4];
        for e in &self.user_offsets {
            let w = 1.0 - e.z * d;
            let (px, py) = (x - e.x * d, y + e.y * d);
            beyond[0] &= px < self.reach.u[0] * w;
            beyond[1] &= px > self.reach.u[1] * w;
            beyond[2] &= py < self.reach.v[0] * w;
            beyond[3] &= py > self.reach.v[1] * w;
        }
        beyond == [false; 4]
    }

    /// Whether any point on a camera's ray beyond the plane projects into the window; what does
    /// not could not be stored.
    pub fn may_hold(&self, camera: &ConstructionCamera, u: f64, v: f64) -> bool {
        let (un, vn, _) = camera.shift.reversed().apply(u, v, 1.0 / camera.near_m);
        let w = &self.window;
        let (l, t) = (f64::from(w.left), f64::from(w.top));
        let (r, b) = (l + f64::from(w.width), t + f64::from(w.height));
        !(u.max(un) < l || u.min(un) > r || v.max(vn) < t || v.min(vn) > b)
    }

    pub fn ldi_camera(&self) -> LdiCamera {
        let w = self.window;
        LdiCamera {
            cop: self.cop,
            basis: self.lens.basis,
            pixels_per_unit: self.lens.pixels_per_unit,
            left: w.left,
            top: w.top,
            width: w.width,
            height: w.height,
        }
    }

    /// The step of disparity that moves no sample by more than an eighth of an output pixel.
    pub fn step(&self) -> f64 {
        0.125 / self.parallax_bound.max(1e-9)
    }

    /// Codes from `smallest` to `largest` disparity with [`Rig::step`], or as fine as 16 bits
    /// allow.
    pub fn codes(&self, smallest: f64, largest: f64) -> DisparityCodes {
        let span = (largest - smallest).max(0.0);
        let wanted = (span / self.step()).ceil().clamp(1.0, 65_534.0);
        // A span of zero still needs a positive step.
        let step = if span > 0.0 { span / wanted } else { self.step().min(smallest) };
        DisparityCodes { smallest, step, largest_code: wanted as u16 + 1 }
    }
}

/// Rounds an extent (left, right, top, bottom) in pixels outward to a window of at most `side`
/// pixels a side.
fn pixel_window(extent: [f64; 4], side: f64) -> Result<Window, ConstructError> {
    let [l, r, t, b] = [extent[0].floor(), extent[1].ceil(), extent[2].floor(), extent[3].ceil()];
    let (w, h) = (r - l, b - t);
    // Far from i32's ends too, so that left + width never overflows.
    let near_axis = [l, r, t, b].iter().all(|x| x.abs() < 1e8);
    if !near_axis || w < 1.0 || h < 1.0 || w > side || h > side {
        return Err(ConstructError::Size { width: w, height: h, max_pixels: (side * side) as u64 });
    }
    Ok(Window { left: l as i32, top: t as i32, width: w as u32, height: h as u32 })
}

/// Bound on f |t_xy - p t_z| / W over the users, t the eye's offset, p the picture coordinate at
/// distance 1, W = d z_eye.
///
/// With |p|^2 <= q: |t_xy - p t_z| <= |t| sqrt(1 + q), and z_eye >= |X - E| / sqrt(1 + q) inside
/// the picture, and
/// |X - E| d >= 1 - e_z d >= 1 - e_z / near. So the whole is at most f |t| (1 + q) / (1 - max e_z / near). In pixel metres; lengths in metres,
/// offsets as (right, up, forward) from the centre of projection, `near_m` the depth of the
/// nearest surface.
pub fn parallax_bound(user_offsets: &[DVec3; 8], near_m: f64, output: &OutputCamera) -> f64 {
    let q = output.half_tan_x().powi(2) + output.half_tan_y().powi(2);
    let farthest = user_offsets.iter().fold(0.0_f64, |m, e| m.max(e.length()));
    let most_ahead = user_offsets.iter().fold(0.0_f64, |m, e| m.max(e.z));
    // An eye on the plane has no bound; a fiftieth of the distance stands in, and 16 bits limit
    // the rest.
    let w = (1.0 - most_ahead / near_m).max(0.02);
    output.focal_px() * farthest * (1.0 + q) / w
}

impl Reach {
    /// Pictures in any of the plan's directions, by sampling the directions every two degrees or
    /// finer and the picture's square by its corners and edge middles; between samples the extent
    /// bulges by less than the margin.
    pub fn of(plan: &ImagePlan, output: &OutputCamera) -> Self {
        const MARGIN: f64 = 0.01;
        let t = output.half_tan_x().max(output.half_tan_y());
        let everything = Self { u: [f64::NEG_INFINITY, f64::INFINITY], v: [f64::NEG_INFINITY, f64::INFINITY] };
        let (mut u, mut v) = ([f64::INFINITY, f64::NEG_INFINITY], [f64::INFINITY, f64::NEG_INFINITY]);
        for range in &plan.directions {
            let steps = |r: [f64; 2]| ((r[1] - r[0]).abs() / 2.0).ceil().clamp(1.0, 360.0) as usize;
            let at = |r: [f64; 2], i: usize| r[0] + (r[1] - r[0]) * i as f64 / steps(r) as f64;
            for i in 0..=steps(range.yaw_deg) {
                for j in 0..=steps(range.pitch_deg) {
                    let b = ViewBasis::from_yaw_pitch(at(range.yaw_deg, i), at(range.pitch_deg, j));
                    for (x, y) in [
                        (-1.0, -1.0),
                        (0.0, -1.0),
                        (1.0, -1.0),
                        (1.0, 0.0),
                        (1.0, 1.0),
                        (0.0, 1.0),
                        (-1.0, 1.0),
                        (-1.0, 0.0),
                    ] {
                        let ray = b.forward + b.right * (x * t) + b.up * (y * t);
                        let z = ray.dot(plan.basis.forward);
                        if z < 0.1 {
                            return everything;
                        }
                        let (x, y) = (ray.dot(plan.basis.right) / z, -ray.dot(plan.basis.up) / z);
                        u = [u[0].min(x), u[1].max(x)];
                        v = [v[0].min(y), v[1].max(y)];
                    }
                }
            }
        }
        if u[0] > u[1] {
            return everything;
        }
        let wide = |r: [f64; 2]| {
            let m = MARGIN * (1.0 + r[0].abs().max(r[1].abs()).powi(2));
            [r[0] - m, r[1] + m]
        };
        Self { u: wide(u), v: wide(v) }
    }
}
