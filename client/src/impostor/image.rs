//! A cached image: a node as seen from one eye, on a plane through its middle (Shade et al. 1996,
//! section 2).
//!
//! Empty pixels are transparent. In addition to the paper each pixel has its own disparity: images
//! are composited with geometry and each other by depth, as the plane lies in front of one half of
//! the node and behind the other.

use super::safety_zone::Plane;
use crate::frame::{Frame, Source, pack_rgb, unpack_rgb};
use glam::DVec3;
use ldi_protocol::{Aabb, OutputCamera, Pose, ViewBasis};
use rayon::prelude::*;

/// Resolution of an image relative to the picture, at its middle. Larger: more memory and time;
/// smaller: the image is too coarse sooner when the eye approaches.
pub const OVERSAMPLED: f64 = 1.25;
/// Rows per task: images have few rows, which all threads should share.
const TASK_ROWS: usize = 8;

/// The framing of a node: a camera at the eye that encloses the node.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Framing {
    /// The image's camera.
    pub camera: OutputCamera,
    /// The image's pose: at the eye, toward the node's middle.
    pub pose: Pose,
    /// The image's plane, through the node's middle.
    pub plane: Plane,
}

impl Framing {
    /// None if the node surrounds the eye, reaches behind it, or needs an image larger than the
    /// picture.
    pub fn new(bounds: &Aabb, eye: DVec3, picture: &OutputCamera) -> Option<Self> {
        let to = bounds.centre() - eye;
        let distance = to.length();
        if bounds.contains(eye) || !(distance > 0.0) {
            return None;
        }
        let forward = to / distance;
        let yaw_deg = f64::atan2(-forward.x, -forward.z).to_degrees();
        let pitch_deg = forward.y.clamp(-1.0, 1.0).asin().to_degrees();
        let pose = Pose { position: eye, yaw_deg, pitch_deg };
        let basis = pose.basis();
        let mut half = [0.0f64; 2];
        for corner in bounds.corners().map(|c| c - eye) {
            let z = corner.dot(basis.forward);
            // The near plane of the rasterizer.
            if z < crate::near::NEAR_PLANE_M {
                return None;
            }
            half = [half[0].max((corner.dot(basis.right) / z).abs()), half[1].max((corner.dot(basis.up) / z).abs())];
        }
        let focal = picture.focal_px() * OVERSAMPLED;
        // A margin of a pixel for filtering. Saturating conversions.
        let [width, height] = half.map(|h| 2 * ((h * focal).ceil() as u32).saturating_add(1));
        if width > picture.width || height > picture.height {
            return None;
        }
        let fov_deg = 2.0 * (f64::from(width) * 0.5 / focal).atan().to_degrees();
        let plane = Plane { eye, normal: basis.forward, distance };
        Some(Self { camera: OutputCamera { width, height, fov_deg }, pose, plane })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.camera.width) * u64::from(self.camera.height)
    }

    /// Copies the part of another frame inside of a box to a frame with this framing.
    pub fn bring_in(&self, bounds: &Aabb, other: &Frame, frame: &mut Frame) {
        let basis = self.pose.basis();
        let width = frame.width as usize;
        for (at, theirs) in other.disparity.iter().enumerate() {
            if *theirs > frame.disparity[at] {
                let (x, y) = ((at % width) as f64 + 0.5, (at / width) as f64 + 0.5);
                let point = self.pose.position + self.camera.ray(&basis, x, y) / f64::from(*theirs);
                if bounds.contains(point) {
                    (frame.disparity[at], frame.colour[at]) = (*theirs, other.colour[at]);
                }
            }
        }
    }

    /// Whether the image is sharp for an eye: its pixels are not magnified.
    pub fn is_sharp(&self, eye: DVec3) -> bool {
        self.plane.distance - self.plane.normal.dot(eye - self.plane.eye) >= self.plane.distance / OVERSAMPLED
    }
}

/// An image with its framing.
#[derive(Debug, Clone)]
pub struct ImpostorImage {
    /// The framing.
    pub framing: Framing,
    basis: ViewBasis,
    /// sRGB, packed.
    colour: Vec<u32>,
    /// 1/m in its own camera; 0: transparent.
    disparity: Vec<f32>,
}

/// An affine function of the picture's pixel coordinates.
#[derive(Clone, Copy)]
struct Affine([f64; 3]);

impl Affine {
    fn at(&self, x: f64, y: f64) -> f64 {
        self.0[0] + self.0[1] * x + self.0[2] * y
    }
}

impl ImpostorImage {
    /// The content of a frame drawn with this framing.
    pub fn new(framing: Framing, frame: &Frame) -> Self {
        Self { framing, basis: framing.pose.basis(), colour: frame.colour.clone(), disparity: frame.disparity.clone() }
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.colour[..]) + size_of_val(&self.disparity[..])
    }

    /// The rectangle of the picture that the image covers: columns and rows from, to.
    fn covers(&self, camera: &OutputCamera, pose: &Pose) -> [u32; 4] {
        let (basis, focal) = (pose.basis(), camera.focal_px());
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let own = &self.framing.camera;
        let (w, h) = (f64::from(own.width), f64::from(own.height));
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for [u, v] in [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]] {
            let corner = self.framing.plane.eye + own.ray(&self.basis, u, v) * self.framing.plane.distance;
            let to = corner - pose.position;
            let z = to.dot(basis.forward);
            if z < crate::near::NEAR_PLANE_M {
                return [0, 0, camera.width, camera.height];
            }
            let p = [0.5 * width + focal * to.dot(basis.right) / z, 0.5 * height - focal * to.dot(basis.up) / z];
            (low, high) = ([low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]);
        }
        let to = [high[0].ceil().min(width), high[1].ceil().min(height)].map(|x| x.max(0.0) as u32);
        let from = low.map(|x| x.floor().max(0.0) as u32);
        [from[0].min(to[0]), from[1].min(to[1]), to[0], to[1]]
    }

    /// Draws the image where it is nearer than the frame; linear filtering among opaque pixels.
    /// Returns the number of visited pixels.
    pub fn draw(&self, camera: &OutputCamera, pose: &Pose, frame: &mut Frame) -> u64 {
        let [left, top, right, bottom] = self.covers(camera, pose).map(|x| x as usize);
        if left >= right || top >= bottom {
            return 0;
        }
        let basis = pose.basis();
        let own = &self.framing.camera;
        let plane = &self.framing.plane;
        // The ray of a pixel of the picture, component by component.
        let [origin, across, down] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|[x, y]| camera.ray(&basis, x, y));
        let ray_along = |n: DVec3| Affine([origin.dot(n), (across - origin).dot(n), (down - origin).dot(n)]);
        let (ahead, rightward, upward) =
            (ray_along(plane.normal), ray_along(self.basis.right), ray_along(self.basis.up));
        let shift = pose.position - plane.eye;
        // The ray meets the plane at shift + reach / ahead * ray; in the image at focal / distance
        // times its components.
        let reach = plane.distance - plane.normal.dot(shift);
        let scale = own.focal_px() / plane.distance;
        let (middle_u, middle_v) = (f64::from(own.width) * 0.5, f64::from(own.height) * 0.5);
        let (shift_u, shift_v) = (shift.dot(self.basis.right), shift.dot(self.basis.up));
        // Depth in the picture of the image's content at (u, v) with depth z: back + z (ray of the
        // image along the picture's axis).
        let back = -(shift.dot(basis.forward)) as f32;
        let [o, a, d] =
            [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(|[u, v]| own.ray(&self.basis, u, v).dot(basis.forward));
        let depth = [o, a - o, d - o].map(|x| x as f32);
        let width = frame.width as usize;
        let rows = top * width..bottom * width;
        let planes = frame.colour[rows.clone()]
            .par_chunks_mut(TASK_ROWS * width)
            .zip(frame.disparity[rows.clone()].par_chunks_mut(TASK_ROWS * width))
            .zip(frame.source[rows].par_chunks_mut(TASK_ROWS * width));
        planes.enumerate().for_each(|(task, ((colour, disparity), source))| {
            let lines = colour.chunks_mut(width).zip(disparity.chunks_mut(width)).zip(source.chunks_mut(width));
            for (row, ((colour, disparity), source)) in (top + task * TASK_ROWS..).zip(lines) {
                let y = row as f64 + 0.5;
                for column in left..right {
                    let x = column as f64 + 0.5;
                    let t = reach / ahead.at(x, y);
                    let u = (middle_u + scale * (shift_u + t * rightward.at(x, y))) as f32;
                    let v = (middle_v - scale * (shift_v + t * upward.at(x, y))) as f32;
                    if !(t > 0.0 && u >= 0.0 && v >= 0.0 && u < own.width as f32 && v < own.height as f32) {
                        continue;
                    }
                    let Some((rgb, own_disparity)) = self.filtered(u, v) else { continue };
                    let here = own_disparity / (back * own_disparity + depth[0] + depth[1] * u + depth[2] * v);
                    if here > disparity[column] {
                        (colour[column], disparity[column], source[column]) = (rgb, here, Source::Far);
                    }
                }
            }
        });
        ((right - left) * (bottom - top)) as u64
    }

    /// The four pixels around a position, and the position among them.
    fn around(&self, u: f32, v: f32) -> ([usize; 4], [f32; 2]) {
        let (w, h) = (self.framing.camera.width as usize, self.framing.camera.height as usize);
        let (u, v) = ((u - 0.5).max(0.0), (v - 0.5).max(0.0));
        let (i, j) = ((u as usize).min(w - 1), (v as usize).min(h - 1));
        let (right, below) = ((i + 1).min(w - 1), (j + 1).min(h - 1));
        ([j * w + i, j * w + right, below * w + i, below * w + right], [u - i as f32, v - j as f32])
    }

    /// Colour and disparity at a position, if opaque pixels have at least half of the weight, as
    /// filtering extends half a pixel beyond them. Disparities are not filtered: the mean of two
    /// surfaces lies on neither.
    fn filtered(&self, u: f32, v: f32) -> Option<(u32, f32)> {
        let (at, [s, t]) = self.around(u, v);
        let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
        let (mut sum, mut rgb, mut heaviest) = (0.0, [0.0f32; 3], (0.0, 0.0));
        for (at, weight) in at.into_iter().zip(weights) {
            if self.disparity[at] > 0.0 {
                sum += weight;
                let [r, g, b] = unpack_rgb(self.colour[at]).map(f32::from);
                rgb = [rgb[0] + weight * r, rgb[1] + weight * g, rgb[2] + weight * b];
                heaviest = if weight > heaviest.0 { (weight, self.disparity[at]) } else { heaviest };
            }
        }
        if sum < 0.5 {
            return None;
        }
        Some((pack_rgb(rgb.map(|c| (c / sum + 0.5) as u8)), heaviest.1))
    }
}
