//! The faces of a near box, and what lies beyond each as its image shows it.
//!
//! In: a centre of projection, the distances of the six faces from it, boxes of cells. Out: per
//! face the window that holds what lies in its region, and how much of it is covered.

use glam::DVec3;
use ldi_protocol::{Aabb, ViewBasis};

/// Faces, by (axis, side).
pub(super) const FACES: [(usize, usize); 6] = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)];

/// The orientation of a face: `forward` is its outward normal.
pub(super) fn face_basis(face: usize) -> ViewBasis {
    let (axis, side) = FACES[face];
    let mut forward = DVec3::ZERO;
    forward[axis] = if side == 0 { -1.0 } else { 1.0 };
    let up = if axis == 1 { DVec3::Z } else { DVec3::Y };
    ViewBasis { right: forward.cross(up), up, forward }
}

/// The places that belong to a face.
pub(super) struct Region {
    /// World axes of right, up and forward, and their signs.
    axes: [(usize, f64); 3],
    /// Distance of the face.
    distance: f64,
    /// Distances of the faces beside it: left, right, bottom, top.
    pub beside: [f64; 4],
}

impl Region {
    pub fn new(face: usize, distance: &[f64; 6]) -> Self {
        let basis = face_basis(face);
        let axes = [basis.right, basis.up, basis.forward].map(|v| {
            let axis = v.abs().max_position();
            (axis, v[axis])
        });
        let of =
            |(axis, sign): (usize, f64), positive: bool| distance[axis * 2 + usize::from((sign > 0.0) == positive)];
        let beside = [of(axes[0], false), of(axes[0], true), of(axes[1], false), of(axes[1], true)];
        Self { axes, distance: distance[face], beside }
    }

    /// Whether a box relative to the centre of projection reaches beyond the face.
    pub fn is_beyond(&self, low: DVec3, high: DVec3) -> bool {
        let (axis, sign) = self.axes[2];
        (low[axis] * sign).max(high[axis] * sign) > self.distance
    }

    /// A box relative to the centre of projection, along right, up, forward.
    pub fn local(&self, low: DVec3, high: DVec3) -> Aabb {
        let mut out = Aabb { min: DVec3::ZERO, max: DVec3::ZERO };
        for (k, (axis, sign)) in self.axes.iter().enumerate() {
            let (a, b) = (low[*axis] * sign, high[*axis] * sign);
            (out.min[k], out.max[k]) = (a.min(b), a.max(b));
        }
        out
    }

    /// Tangents (left, right, bottom, top) around the part of a local box that is in the region;
    /// None if none is.
    pub fn tangents_of(&self, b: &Aabb) -> Option<[f64; 4]> {
        let (near, far) = (b.min.z.max(self.distance), b.max.z);
        if far <= self.distance {
            return None;
        }
        let around = |k: usize| tangents_around(b.min[k], b.max[k], near, far);
        let [x, y] = [around(0), around(1)];
        self.clipped(b, near, [x[0], x[1], y[0], y[1]])
    }

    /// The part in the region of what has tangents `t` around it, of a box that is seen from
    /// depth `near` on.
    #[inline]
    fn clipped(&self, b: &Aabb, near: f64, mut t: [f64; 4]) -> Option<[f64; 4]> {
        for k in 0..2 {
            let [low, high] = [self.beside[2 * k], self.beside[2 * k + 1]];
            // At depth z the region reaches to the larger of z and the face beside it.
            if b.min[k] > high.max(b.max.z) || b.max[k] < -low.max(b.max.z) {
                return None;
            }
            t[2 * k] = t[2 * k].max(-(low / near).max(1.0));
            t[2 * k + 1] = t[2 * k + 1].min((high / near).max(1.0));
            if t[2 * k] >= t[2 * k + 1] {
                return None;
            }
        }
        Some(t)
    }
}

/// Least and greatest tangent of what lies from `low` to `high` aside, at depths from `near` to
/// `far`.
fn tangents_around(low: f64, high: f64, near: f64, far: f64) -> [f64; 2] {
    [low / if low < 0.0 { near } else { far }, high / if high > 0.0 { near } else { far }]
}

/// What the image of a face shows of the cells that a box replaces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    /// Tangents around it: left, right, bottom, top.
    pub tangents: [f64; 4],
    /// What the bounds of the cells cover, added up, at distance 1.
    pub covered: f64,
}

impl Window {
    /// Nothing.
    pub const EMPTY: Self =
        Self { tangents: [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY], covered: 0.0 };

    /// Adds what is within tangents `t`, a share `fill` of which is covered.
    #[inline]
    pub fn add(&mut self, t: &[f64; 4], fill: f64) {
        let w = &mut self.tangents;
        self.covered += (t[1] - t[0]) * (t[3] - t[2]) * fill;
        *w = [w[0].min(t[0]), w[1].max(t[1]), w[2].min(t[2]), w[3].max(t[3])];
    }
}

/// Boxes of cells around a centre of projection, prepared so that what near boxes of many sizes
/// leave of them is found fast.
#[derive(Debug)]
pub(super) struct Surroundings {
    /// Per box: how far along the outward normal of each face all of it lies.
    nearest: Vec<[f64; 6]>,
    /// Per face: boxes that may reach beyond it.
    faces: [Vec<Part>; 6],
}

/// A box as a face sees it.
#[derive(Debug)]
struct Part {
    /// Which box.
    number: u32,
    /// Share of it that is covered.
    fill: f64,
    /// Relative to the centre of projection, along right, up, forward.
    local: Aabb,
    /// Tangents around all of it, where it lies wholly ahead.
    tangents: [f64; 4],
}

impl Surroundings {
    /// Prepares boxes, each relative to the centre of projection and with the share of it that is
    /// covered, for near boxes whose faces stand at `smallest` distances or farther.
    pub fn new(boxes: &[(Aabb, f64)], smallest: &[f64; 6]) -> Self {
        let nearest =
            boxes.iter().map(|(b, _)| FACES.map(|(axis, side)| if side == 0 { -b.max[axis] } else { b.min[axis] }));
        let faces = std::array::from_fn(|f| {
            let region = Region::new(f, smallest);
            let part = |(number, (b, fill)): (u32, &(Aabb, f64))| {
                let local = region.local(b.min, b.max);
                let [x, y] = [0, 1].map(|k| tangents_around(local.min[k], local.max[k], local.min.z, local.max.z));
                let tangents = [x[0], x[1], y[0], y[1]];
                (local.max.z > smallest[f]).then_some(Part { number, fill: *fill, local, tangents })
            };
            (0..).zip(boxes).filter_map(part).collect()
        });
        Self { nearest: nearest.collect(), faces }
    }

    /// What the faces' images show of the boxes that do not touch a near box with its faces `gap`
    /// metres farther off. A box around several cells counts as near if it touches: an estimate.
    pub fn windows(&self, distance: &[f64; 6], gap: f64) -> [Window; 6] {
        let is_far = |nearest: &[f64; 6]| (0..6).fold(false, |far, f| far | (nearest[f] > distance[f] + gap));
        let far: Vec<bool> = self.nearest.iter().map(is_far).collect();
        std::array::from_fn(|f| {
            let region = Region::new(f, distance);
            let mut window = Window::EMPTY;
            for part in self.faces[f].iter().filter(|p| p.local.max.z > distance[f] && far[p.number as usize]) {
                let tangents = match part.local.min.z >= distance[f] {
                    true => region.clipped(&part.local, part.local.min.z, part.tangents),
                    false => region.tangents_of(&part.local),
                };
                if let Some(t) = tangents {
                    window.add(&t, part.fill);
                }
            }
            window
        })
    }
}
