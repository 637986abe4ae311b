//! How fine a tree has to be, and how fine one is: what random eyes see beyond the geometry that
//! they draw.
//!
//! In: a caster, the walk volume, cells and settings; later a tree. Out: per surface point the
//! size that the tree's samples have there in the picture. The promise of images is that no sample
//! is larger than `max_footprint_px`; a tree that keeps it at (nearly) all points is as good a
//! representation, by that measure.

use super::BuiltTree;
use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use ldi_protocol::{
    Pose,
    codec::CodecError,
    index::{BuildSettings, CellEntry},
    select::nearest_cells,
    tree::{CutOptions, DEPTH_STEPS, Lens, NodeSamples, Tree, TreeNode, TreeSample, across, cut},
    volume::WalkVolume,
};
use rayon::prelude::*;

/// Eyes that look together, and in all at most.
const EYES: [usize; 2] = [256, 8192];
/// So many points beyond the geometry are enough: one of a thousand is then known to a fifth of
/// itself.
const ENOUGH: usize = 25_000;
/// Rays of each eye's picture, across and up.
const RAYS: [u32; 2] = [48, 27];
/// Nothing nearer than this is seen, metres: the near plane.
const NEAR_M: f64 = 0.02;
/// A point is covered from so much coverage on. Higher: points near rims count as not covered.
const COVERED_FROM: f64 = 0.4;
/// Samples that look away by more than this cosine are not drawn.
const TURNED_AWAY: f64 = 0.2;
/// Samples of one surface lie within so many pitches in depth.
const SAME_SURFACE: f64 = 1.5;

/// A surface point beyond the geometry that is drawn for an eye.
#[derive(Debug, Clone, Copy)]
pub struct FarPoint {
    /// World, metres.
    pub position: DVec3,
    /// From the point to the eye, unit length.
    pub towards: DVec3,
    /// Depth from the eye along its line of sight, metres.
    pub depth_m: f64,
}

/// What random eyes see.
#[derive(Debug, Clone, Default)]
pub struct Probes {
    /// Beyond the near geometry.
    pub far: Vec<FarPoint>,
    /// Eyes that looked.
    pub eyes: Vec<Pose>,
    /// Rays that met a surface, near or far.
    pub surfaces: usize,
}

/// The k-th number of the base's van der Corput sequence: evenly spread over [0, 1), the same in
/// every run.
pub(super) fn radical(mut k: usize, base: usize) -> f64 {
    let (mut value, mut scale) = (0.0, 1.0 / base as f64);
    while k > 0 {
        value += (k % base) as f64 * scale;
        k /= base;
        scale /= base as f64;
    }
    value
}

impl Probes {
    /// Looks from random eyes of the volume in random directions within the built pitch.
    pub fn take(caster: &Caster, volume: &WalkVolume, cells: &[CellEntry], settings: &BuildSettings) -> Self {
        let sampler = volume.sampler();
        let eye = |k: usize| {
            let position = sampler.point([radical(k, 7), radical(k, 2), radical(k, 3), radical(k, 5)])?;
            let yaw_deg = 360.0 * radical(k, 11);
            Some(Pose { position, yaw_deg, pitch_deg: settings.pitch_deg * (2.0 * radical(k, 13) - 1.0) })
        };
        let camera = &settings.camera;
        let half_tan = (camera.half_tan_x(), camera.half_tan_y());
        let look = |pose: &Pose| -> (Vec<FarPoint>, usize) {
            let basis = pose.basis();
            let place = |k: u32, n: u32| (f64::from(k) + 0.5) / f64::from(n) * 2.0 - 1.0;
            let rays: Vec<Ray> = (0..RAYS[0] * RAYS[1])
                .map(|k| (place(k % RAYS[0], RAYS[0]) * half_tan.0, place(k / RAYS[0], RAYS[1]) * half_tan.1))
                .map(|(x, y)| basis.forward + basis.right * x + basis.up * y)
                .map(|d| Ray { t_min: NEAR_M, ..Ray::new(pose.position, d) })
                .collect();
            let mut hits = vec![None; rays.len()];
            caster.trace_batch(&rays, &CellSet::all(), &mut hits);
            let mut near = nearest_cells(cells, settings, pose, half_tan).cells;
            near.sort_unstable();
            let met: Vec<_> = rays.iter().zip(&hits).filter_map(|(ray, hit)| Some((ray, hit.as_ref()?))).collect();
            let far = met.iter().filter(|(_, hit)| near.binary_search(&caster.cell_of(hit.triangle)).is_err());
            // Rays have one metre along the line of sight per unit of t.
            let far = far.map(|(ray, hit)| FarPoint {
                position: ray.origin + ray.direction * hit.t,
                towards: -ray.direction.normalize(),
                depth_m: hit.t,
            });
            (far.collect(), met.len())
        };
        let mut probes = Self::default();
        for first in (1..=EYES[1]).step_by(EYES[0]) {
            let eyes: Vec<Pose> = (first..first + EYES[0]).filter_map(eye).collect();
            for (far, surfaces) in eyes.par_iter().map(look).collect::<Vec<_>>() {
                probes.far.extend(far);
                probes.surfaces += surfaces;
            }
            probes.eyes.extend(eyes);
            if probes.far.len() >= ENOUGH {
                break;
            }
        }
        probes
    }

    /// Samples of a tree that nine of ten of the eyes draw at most, all else being equal: what
    /// geometry hides is counted.
    pub fn samples_drawn(&self, tree: &Tree, settings: &BuildSettings) -> u64 {
        let lens = Lens::from(&settings.camera);
        let of_eye = |pose: &Pose| cut(tree, pose, &lens, &CutOptions::default(), |_| true).samples;
        let mut drawn: Vec<u64> = self.eyes.par_iter().map(of_eye).collect();
        drawn.sort_unstable();
        drawn.get(drawn.len() * 9 / 10).copied().unwrap_or(0)
    }

    /// The distance of samples, metres, at which all but the share `beyond` of the far points have
    /// samples within `footprint_px`. None without far points.
    pub fn needed_pitch_m(&self, footprint_px: f64, focal_px: f64, beyond: f64) -> Option<f64> {
        let mut depths: Vec<f64> = self.far.iter().map(|p| p.depth_m).collect();
        depths.sort_unstable_by(f64::total_cmp);
        let rank = (beyond * depths.len() as f64) as usize;
        depths.get(rank).map(|depth| footprint_px * depth / focal_px)
    }

    /// Of every far point the size in the picture, pixels, of the finest samples that a tree has
    /// there; infinite where it has none.
    ///
    /// # Errors
    /// If a chunk cannot be decoded.
    pub fn footprints(&self, built: &BuiltTree, focal_px: f64) -> Result<Vec<f64>, CodecError> {
        let tree = &built.tree;
        let mut in_nodes: Vec<Vec<u32>> = vec![Vec::new(); tree.nodes.len()];
        for (number, p) in self.far.iter().enumerate() {
            let mut stack = vec![0u32];
            while let Some(n) = stack.pop() {
                let node = &tree.nodes[n as usize];
                // What is splatted across a border lies in the neighbour.
                if tree.bounds_of(node).inflated(2.0 * tree.pitch_of(node.level)).contains(p.position) {
                    in_nodes[n as usize].push(number as u32);
                    stack.extend(node.child_range());
                }
            }
        }
        let broods: Vec<_> = tree.broods().collect();
        let of_brood = |(chunk, nodes): &(u32, std::ops::Range<u32>)| -> Result<Vec<(u32, f64)>, CodecError> {
            if nodes.clone().all(|n| in_nodes[n as usize].is_empty()) {
                return Ok(Vec::new());
            }
            let bytes = &built.chunks[(chunk - tree.root_chunk) as usize].bytes;
            let brood = tree.decode(nodes.clone(), bytes)?;
            let found = nodes.clone().zip(&brood.nodes).flat_map(|(n, samples)| {
                let node = &tree.nodes[n as usize];
                let cover = move |p: &u32| Some((*p, covers(tree, node, samples, &self.far[*p as usize])?));
                in_nodes[n as usize].iter().filter_map(cover)
            });
            Ok(found.collect())
        };
        let found: Vec<Vec<(u32, f64)>> = broods.par_iter().map(of_brood).collect::<Result<_, _>>()?;
        let mut finest = vec![f64::INFINITY; self.far.len()];
        for (point, extent_m) in found.into_iter().flatten() {
            let size = extent_m * focal_px / self.far[point as usize].depth_m;
            finest[point as usize] = finest[point as usize].min(size);
        }
        Ok(finest)
    }
}

/// How large a node's samples are around a point, metres across the line of sight; None if they do
/// not cover it.
fn covers(tree: &Tree, node: &TreeNode, samples: &NodeSamples, p: &FarPoint) -> Option<f64> {
    let pitch = tree.pitch_of(node.level);
    let place = (p.position - tree.corner_of(node)) / pitch;
    let (mut coverage, mut extent) = (0.0, 0.0f64);
    for face in 0..6u8 {
        let axis = usize::from(face / 2);
        let [a, b] = across(axis);
        let (column, row) = (place[a] - 0.5, place[b] - 0.5);
        for (i, j) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (c, r) = (column.floor() + i, row.floor() + j);
            if c < 0.0 || r < 0.0 {
                continue;
            }
            let weight = (1.0 - (c - column).abs()) * (1.0 - (r - row).abs());
            for s in pixel(samples, face, c as u32, r as u32) {
                let slope = s.slope.map(|v| f64::from(v) / f64::from(DEPTH_STEPS));
                let depth = (f64::from(s.depth) + 0.5) / f64::from(DEPTH_STEPS);
                let there = depth + slope[0] * (column - c) + slope[1] * (row - r);
                let (mut along_a, mut along_b) = (DVec3::ZERO, DVec3::ZERO);
                (along_a[a], along_a[axis]) = (pitch, pitch * slope[0]);
                (along_b[b], along_b[axis]) = (pitch, pitch * slope[1]);
                let mut normal = along_a.cross(along_b).normalize();
                normal *= (if face % 2 == 1 { 1.0 } else { -1.0 }) * normal[axis].signum();
                if (there - place[axis]).abs() > SAME_SURFACE || normal.dot(p.towards) < -TURNED_AWAY {
                    continue;
                }
                coverage += weight * f64::from(s.coverage());
                for side in [along_a, along_b] {
                    extent = extent.max((side - p.towards * side.dot(p.towards)).length());
                }
            }
        }
    }
    (coverage >= COVERED_FROM).then_some(extent)
}

/// The samples of a pixel.
fn pixel(samples: &NodeSamples, face: u8, column: u32, row: u32) -> &[TreeSample] {
    let key = |s: &TreeSample| (s.face, u32::from(s.row), u32::from(s.column));
    let first = samples.samples.partition_point(|s| key(s) < (face, row, column));
    let rest = &samples.samples[first..];
    &rest[..rest.partition_point(|s| key(s) == (face, row, column))]
}
