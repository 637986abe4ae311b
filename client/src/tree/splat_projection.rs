//! The projection of samples to quadrilaterals of the picture.

use super::pixel_mask::PixelMask;
use glam::{DVec3, Vec3};
use ldi_protocol::{
    Aabb, OutputCamera, Pose,
    tree::{DEPTH_STEPS, PARTS, Tree, TreeNode, TreeSample, across, share_covered},
};

/// Near plane, metres.
const NEAR_M: f32 = 0.02;
/// Width of a splat in pitches: splats of a curved surface must meet.
const OVERLAP: f32 = 1.1;
/// Largest half diagonal of a wide splat, in pitches: a pitch across on both sides, and two along
/// the axis, the largest coded slope.
const LARGEST_REACH: f32 = 4.6 * OVERLAP;
/// Largest elongation of a sphere's projection, for fields of view up to 100 degrees including
/// corners.
const SLANT: f32 = 2.5;
/// Surfaces that face away by more than this (cosine) are culled. Below zero, as normals are means,
/// and surfaces seen edge-on must stay.
const TURNED_AWAY: f32 = 0.2;
/// Largest distance in depth between samples of one surface, in pitches: the tree's merge
/// threshold, and half a pitch for coded depth and slope.
const MERGE_PITCHES: f32 = 1.5;

/// A splat in the picture. Pixel coordinates, centres at +0.5.
#[derive(Debug, Clone, Copy)]
pub struct Splat {
    /// Columns and rows that the wide splat (bilinear weights) may touch: first and last.
    pub columns: [i32; 2],
    pub rows: [i32; 2],
    /// Disparity plane: disparity at (u, v) is `plane . (u, v, 1)`.
    pub plane: [f32; 3],
    /// Position along the splat's two sides, in pitches from its middle, times disparity: `along[k]
    /// . (u, v, 1)`.
    pub along: [[f32; 3]; 2],
    /// Disparity of the middle; smallest and largest of the wide splat.
    pub disparity: [f32; 3],
    /// Distance in depth within which splats are one surface, metres.
    pub merge_m: f32,
    /// Parts of the pixel that the surface covers ([`TreeSample::covers`]).
    pub covers: u16,
    pub rgb: [u8; 3],
}

/// Which samples a projection draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Drawn {
    /// Filtered samples are drawn beside unfiltered ones.
    pub filtered: bool,
    /// Only parts that lie within the surface, not those at its rim: coarse samples that fill gaps
    /// must not widen outlines.
    pub within: bool,
}

/// The camera of a projection.
pub struct SplatProjection {
    position: DVec3,
    /// Axes: right, down, forward.
    axes: [DVec3; 3],
    focal: f32,
    centre: [f32; 2],
    size: [i32; 2],
}

impl SplatProjection {
    pub fn new(pose: &Pose, camera: &OutputCamera) -> Self {
        let basis = pose.basis();
        Self {
            position: pose.position,
            axes: [basis.right, -basis.up, basis.forward],
            focal: camera.focal_px() as f32,
            centre: [camera.width as f32 * 0.5, camera.height as f32 * 0.5],
            size: [camera.width as i32, camera.height as i32],
        }
    }

    /// A world vector in eye space: right, down, forward.
    fn turn(&self, v: DVec3) -> Vec3 {
        Vec3::from_array(self.axes.map(|a| a.dot(v) as f32))
    }

    /// The splats of a node's samples that may reach a wanted pixel.
    pub fn splats(
        &self,
        tree: &Tree,
        node: &TreeNode,
        drawn: Drawn,
        samples: &[TreeSample],
        wanted: &PixelMask,
        out: &mut Vec<Splat>,
    ) {
        let pitch = tree.pitch_of(node.level);
        // Offsets are relative to the eye, subtracted in f64.
        let corner = self.turn(tree.corner_of(node) - self.position);
        for of_face in samples.chunk_by(|a, b| a.face == b.face) {
            let axis = usize::from(of_face[0].face / 2);
            let [a, b] = across(axis);
            let unit = |k: usize| {
                let mut v = DVec3::ZERO;
                v[k] = pitch;
                self.turn(v)
            };
            let (column, row, depth) = (unit(a), unit(b), unit(axis) / DEPTH_STEPS as f32);
            let outward = unit(axis) * if of_face[0].face % 2 == 1 { 1.0 } else { -1.0 };
            for s in of_face.iter().filter(|s| drawn.filtered || !s.filtered) {
                let covers = if drawn.within { without_rim(s.covers) } else { s.covers };
                let middle = corner
                    + column * (f32::from(s.column) + 0.5)
                    + row * (f32::from(s.row) + 0.5)
                    + depth * (f32::from(s.depth) + 0.5);
                // Most samples are hidden or not wanted: they are rejected before their splat is
                // computed.
                if covers == 0
                    || !wanted.reaches(middle.length(), pitch as f32)
                    || !self.may_show(middle, pitch as f32, wanted)
                {
                    continue;
                }
                let sides = [column + depth * f32::from(s.slope[0]), row + depth * f32::from(s.slope[1])];
                if let Some(splat) = self.splat(middle, sides, outward, pitch as f32, (covers, s.rgb))
                    && wanted.any(splat.columns, splat.rows, splat.disparity[2])
                {
                    out.push(splat);
                }
            }
        }
    }

    /// Whether a box may show in a wanted pixel.
    pub fn sees(&self, bounds: &Aabb, wanted: &PixelMask) -> bool {
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        let mut nearest = f32::MAX;
        for corner in bounds.corners() {
            let c = self.turn(corner - self.position);
            if c.z < NEAR_M {
                // The box reaches behind the eye: it may be anywhere in the picture.
                return !wanted.is_empty();
            }
            for (k, v) in [c.x, c.y].into_iter().enumerate() {
                let p = self.centre[k] + v * self.focal / c.z;
                low[k] = low[k].min(p);
                high[k] = high[k].max(p);
            }
            nearest = nearest.min(c.z);
        }
        let inside = |k: usize| [low[k].max(0.0) as i32, high[k].min((self.size[k] - 1) as f32) as i32];
        let (columns, rows) = (inside(0), inside(1));
        columns[0] <= columns[1] && rows[0] <= rows[1] && wanted.any(columns, rows, 1.0 / nearest)
    }

    /// False if no splat around `middle` can show: tests a sphere around the wide splat.
    fn may_show(&self, middle: Vec3, pitch: f32, wanted: &PixelMask) -> bool {
        let reach = pitch * LARGEST_REACH;
        let nearest = middle.z - reach;
        if nearest < NEAR_M {
            return middle.z >= NEAR_M;
        }
        let (scale, radius) = (self.focal / middle.z, reach * self.focal / nearest * SLANT);
        let inside = |k: usize, v: f32| {
            let p = self.centre[k] + v * scale;
            [(p - radius).max(0.0) as i32, (p + radius).min((self.size[k] - 1) as f32) as i32]
        };
        let (columns, rows) = (inside(0, middle.x), inside(1, middle.y));
        columns[0] <= columns[1] && rows[0] <= rows[1] && wanted.any(columns, rows, 1.0 / nearest)
    }

    /// The splat around `middle` with these sides (eye space, metres). None if it is behind the
    /// eye, faces away, or is outside of the picture.
    fn splat(
        &self,
        middle: Vec3,
        sides: [Vec3; 2],
        outward: Vec3,
        pitch: f32,
        (covers, rgb): (u16, [u8; 3]),
    ) -> Option<Splat> {
        if middle.z < NEAR_M {
            return None;
        }
        let cross = sides[0].cross(sides[1]);
        let normal = if cross.dot(outward) < 0.0 { -cross } else { cross };
        let facing = normal.dot(middle);
        if facing > TURNED_AWAY * normal.length() * middle.length() {
            return None;
        }
        // A wide splat reaches a pitch to each side. Splats are shortened in front of the eye.
        let reach = (sides[0].z.abs() + sides[1].z.abs()) * OVERLAP;
        let shrink = if middle.z - reach < NEAR_M { ((middle.z - NEAR_M) / reach).clamp(0.0, 1.0) } else { 1.0 };
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        let (mut nearest, mut farthest) = (middle.z, middle.z);
        for (i, j) in [(-1.0f32, -1.0f32), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            let corner = middle + (sides[0] * i + sides[1] * j) * (OVERLAP * shrink);
            let scale = self.focal / corner.z.max(NEAR_M);
            for (k, v) in [corner.x, corner.y].into_iter().enumerate() {
                let p = self.centre[k] + v * scale;
                low[k] = low[k].min(p);
                high[k] = high[k].max(p);
            }
            nearest = nearest.min(corner.z.max(NEAR_M));
            farthest = farthest.max(corner.z);
        }
        let range = |k: usize| {
            let first = ((low[k] - 0.5).ceil().max(0.0)) as i32;
            let last = ((high[k] - 0.5).floor().min((self.size[k] - 1) as f32)) as i32;
            (first <= last).then_some([first, last])
        };
        let (columns, rows) = (range(0)?, range(1)?);
        // The ray of pixel (u, v) is (u - cx, v - cy, f) / f with component 1 forward. On the plane
        // n . X = n . M the disparity is n . ray / n . M, which is (n.x u + n.y v + (n.z f - n.x cx
        // - n.y cy)) / (f n . M). Seen edge-on that is a quotient of small numbers, and the
        // middle's is taken.
        let level = |n: Vec3, by: f32| {
            [n.x, n.y, n.z * self.focal - n.x * self.centre[0] - n.y * self.centre[1]].map(|v| v / (self.focal * by))
        };
        let edge_on = facing.abs() < 0.02 * normal.length() * middle.length();
        let plane = if edge_on { [0.0, 0.0, 1.0 / middle.z] } else { level(normal, facing) };
        // Position along side k of X = ray / disparity: dual vector . (X - M), times disparity:
        // dual . ray - disparity * dual . M.
        let dual = [sides[1].cross(cross), cross.cross(sides[0])].map(|d| d / cross.length_squared().max(1e-30));
        let along: [[f32; 3]; 2] = std::array::from_fn(|k| {
            let ray = level(dual[k], 1.0);
            let offset = dual[k].dot(middle);
            std::array::from_fn(|c| ray[c] - plane[c] * offset)
        });
        Some(Splat {
            columns,
            rows,
            plane,
            along,
            disparity: [1.0 / middle.z, 1.0 / farthest, 1.0 / nearest],
            merge_m: MERGE_PITCHES * pitch,
            covers,
            rgb,
        })
    }
}

impl Splat {
    /// Disparity at a pixel centre, and its position on the splat in pitches from its middle; None
    /// beyond the wide splat.
    pub fn at(&self, u: f32, v: f32) -> Option<(f32, f32, f32)> {
        let of = |c: &[f32; 3]| c[0] * u + c[1] * v + c[2];
        let disparity = of(&self.plane);
        if !(disparity > 0.0) {
            return None;
        }
        let (s, t) = (of(&self.along[0]) / disparity, of(&self.along[1]) / disparity);
        (s.abs() < 1.0 && t.abs() < 1.0).then_some((disparity.clamp(self.disparity[1], self.disparity[2]), s, t))
    }

    /// True where the surface covers a position on the splat. Parts at the border of the pixel
    /// reach beyond it by a twentieth or so, as neighbouring splats overlap.
    pub fn covers(&self, s: f32, t: f32) -> bool {
        let part = |v: f32| ((v + 0.5) * PARTS as f32).clamp(0.0, PARTS as f32 - 1.0) as u32;
        s.abs().max(t.abs()) <= 0.5 * OVERLAP && self.covers >> (part(t) * PARTS + part(s)) & 1 == 1
    }

    /// Share of the pixel that is covered.
    pub fn coverage(&self) -> f32 {
        share_covered(self.covers)
    }
}

/// The parts of a mask whose four neighbours in it are covered, too. What lies beyond the pixel is
/// taken to be as at its border.
fn without_rim(mask: u16) -> u16 {
    // First and last columns, first and last rows.
    const COLUMNS: [u16; 2] = [0x1111, 0x8888];
    const ROWS: [u16; 2] = [0x000f, 0xf000];
    let beside = [mask << 1 & !COLUMNS[0] | mask & COLUMNS[0], mask >> 1 & !COLUMNS[1] | mask & COLUMNS[1]];
    let above_below = [mask << PARTS | mask & ROWS[0], mask >> PARTS | mask & ROWS[1]];
    beside.into_iter().chain(above_below).fold(mask, |left, moved| left & moved)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_without_its_rim_keeps_what_lies_within() {
        // Whole; a half, a corner and a line that go on beyond the pixel; a bar and a dot within.
        for (mask, within) in
            [(0xffff, 0xffff), (0x3333, 0x1111), (0x0077, 0x0003), (0x0f00, 0), (0x6666, 0), (0x0660, 0)]
        {
            assert_eq!(without_rim(mask), within, "{mask:04x}");
        }
    }
}
