//! Cutting primitives into clusters.
//!
//! In: the unique primitives. Out: clusters of at most [`MAX_CLUSTER_TRIANGLES`] triangles and
//! bounded extent (longest edge of the box), in mesh space.
//!
//! The bound is E = (typical size of the scene) / 32, divided by the largest scale at which an
//! instance places the mesh. The typical size is that of the box that holds all but 2% of the
//! triangles' centres on each axis, so that a far backdrop does not make a building's clusters
//! coarse. Why 32: an octree node is cut where it holds too many triangles; clusters much larger
//! than such a node would stay in its ancestors, whose cells are seen from everywhere. With a
//! larger divisor clusters of coarse models hold fewer triangles each and cost more in headers and
//! repeated vertices than they save.
//!
//! A triangle larger than E / 2 would inflate the cluster around it. So triangles are first sorted
//! into size classes: class 0 up to E / 2, class k up to E 2^(k-1); the clusters of class k stay
//! within E 2^k, class 0 within E. No triangle is ever cut: the largest ones end up in clusters of
//! their own kind.
//!
//! Within a class, a group that is too large or holds too many triangles is halved at the middle
//! of its centroids' box, across the longest axis, until it fits.

use super::{Clusters, SourceCluster};
use crate::scene::{Primitive, Scene};
use glam::{DMat3, DVec3};
use ldi_protocol::{Aabb, mesh::MAX_CLUSTER_TRIANGLES};
use rayon::prelude::*;

/// E is the typical size of the scene over this (see the module's text).
const SIZE_OVER_EXTENT: f64 = 32.0;
/// Share of triangle centres left out at either end of each axis when measuring the typical size.
const OUTLIERS: f64 = 0.01;
/// Triangles whose centres are measured: enough for percentiles within a percent.
const SIZE_SAMPLES: u64 = 100_000;
/// Classes beyond it share one: 2^20 times E is larger than any scene.
const MAX_CLASS: u32 = 20;

impl Clusters {
    /// Cuts every primitive of every mesh; deterministic. Meshes that no instance uses are cut as
    /// well.
    pub fn build(scene: &Scene) -> Self {
        let extent_world_m = typical_size(scene) / SIZE_OVER_EXTENT;
        let mut scale = vec![0.0_f64; scene.meshes.len()];
        for i in &scene.instances {
            let s = &mut scale[i.mesh as usize];
            *s = s.max(largest_scale(&i.world_from_mesh.matrix3));
        }
        let per_mesh: Vec<Vec<SourceCluster>> = scene
            .meshes
            .par_iter()
            .zip(scale)
            .enumerate()
            .map(|(mesh, (m, scale))| {
                let extent = extent_world_m / if scale > 0.0 { scale } else { 1.0 };
                let cut = |(k, p)| cut_primitive(mesh as u32, k as u32, p, extent);
                m.primitives.iter().enumerate().flat_map(cut).collect()
            })
            .collect();
        let mut clusters = Self { extent_m: extent_world_m, ..Self::default() };
        for of_mesh in per_mesh {
            let start = clusters.clusters.len() as u32;
            clusters.clusters.extend(of_mesh);
            clusters.of_mesh.push(start..clusters.clusters.len() as u32);
        }
        clusters
    }
}

/// Longest edge of a box.
pub(super) fn extent(b: &Aabb) -> f64 {
    b.size().max_element()
}

/// An upper bound of the largest singular value: how much longer a vector can get.
fn largest_scale(m: &DMat3) -> f64 {
    m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Longest edge, metres, of the box of all but the outermost centres of the triangles in the
/// world; positive.
fn typical_size(scene: &Scene) -> f64 {
    let stride = (scene.triangles() / SIZE_SAMPLES).max(1);
    let mut axes: [Vec<f64>; 3] = Default::default();
    let mut number = 0u64;
    for i in &scene.instances {
        for p in &scene.meshes[i.mesh as usize].primitives {
            let first = (stride - number % stride) % stride;
            for t in p.triangles.iter().skip(first as usize).step_by(stride as usize) {
                let centre = i.world_from_mesh.transform_point3(centroid(p, t));
                for (axis, value) in axes.iter_mut().zip(centre.to_array()) {
                    axis.push(value);
                }
            }
            number += p.triangles.len() as u64;
        }
    }
    let spread = |values: &mut Vec<f64>| {
        values.sort_unstable_by(f64::total_cmp);
        let cut = (values.len() as f64 * OUTLIERS) as usize;
        match (values.get(cut), values.get((values.len().max(1) - 1).saturating_sub(cut))) {
            (Some(low), Some(high)) => (high - low).max(0.0),
            _ => 0.0,
        }
    };
    let size = axes.iter_mut().map(spread).fold(0.0, f64::max);
    // A scene of one flat dot: any positive bound serves.
    if size > 0.0 { size } else { extent(&scene.bounds()).max(1.0) }
}

fn corners(p: &Primitive, t: &[u32; 3]) -> [DVec3; 3] {
    t.map(|v| p.positions[v as usize].as_dvec3())
}

fn centroid(p: &Primitive, t: &[u32; 3]) -> DVec3 {
    let [a, b, c] = corners(p, t);
    (a + b + c) / 3.0
}

/// A triangle while it is sorted into clusters.
#[derive(Clone, Copy)]
struct Item {
    triangle: u32,
    centroid: DVec3,
    bounds: Aabb,
}

fn cut_primitive(mesh: u32, primitive: u32, p: &Primitive, extent_m: f64) -> Vec<SourceCluster> {
    let mut classes: Vec<Vec<Item>> = Vec::new();
    for (i, t) in p.triangles.iter().enumerate() {
        let bounds = Aabb::from_points(corners(p, t));
        let ratio = extent(&bounds) / (extent_m * 0.5);
        let class = if ratio > 1.0 { (ratio.log2().ceil() as u32).min(MAX_CLASS) } else { 0 } as usize;
        if classes.len() <= class {
            classes.resize_with(class + 1, Vec::new);
        }
        classes[class].push(Item { triangle: i as u32, centroid: centroid(p, t), bounds });
    }
    let mut clusters = Vec::new();
    for (class, mut items) in classes.into_iter().enumerate() {
        if !items.is_empty() {
            halve(&mut items, extent_m * f64::from(1u32 << class), &mut |group| {
                let mut triangles: Vec<u32> = group.iter().map(|i| i.triangle).collect();
                triangles.sort_unstable();
                let bounds = group.iter().fold(Aabb::EMPTY, |b, i| b.union(i.bounds));
                clusters.push(SourceCluster { mesh, primitive, triangles, bounds });
            });
        }
    }
    clusters
}

/// Hands on the group if it fits, else its two halves.
fn halve(items: &mut [Item], extent_m: f64, emit: &mut impl FnMut(&[Item])) {
    let bounds = items.iter().fold(Aabb::EMPTY, |b, i| b.union(i.bounds));
    let fits = items.len() <= MAX_CLUSTER_TRIANGLES && extent(&bounds) <= extent_m;
    if fits || items.len() == 1 {
        emit(items);
        return;
    }
    let centres = Aabb::from_points(items.iter().map(|i| i.centroid));
    let size = centres.size();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let middle = centres.centre()[axis];
    // Stable, so that the result depends on nothing but the file's order.
    items.sort_by_key(|i| i.centroid[axis] >= middle);
    let left = items.partition_point(|i| i.centroid[axis] < middle);
    // All centroids in one point (or so near that the middle rounds to an end): halve by count.
    let left = if left == 0 || left == items.len() { items.len() / 2 } else { left };
    let (a, b) = items.split_at_mut(left);
    halve(a, extent_m, emit);
    halve(b, extent_m, emit);
}
