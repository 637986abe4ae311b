//! The loose octree of cluster instances.
//!
//! In: clusters and where their instances stand. Out: cells.
//!
//! Clusters of one instance stay together where all of it is no larger than a cluster may be, or
//! hardly longer than its longest one, and has few triangles for the budget: levels of detail
//! simplify a mesh that lies in one cell as a whole, while one that is split keeps its vertices
//! where the parts meet. What is said below of clusters holds for such groups.
//!
//! The root is the cube around the scene. A cluster instance belongs to the node that contains its
//! centre, at the deepest level whose edge is at least its extent (longest edge of its box), so
//! that a node's content reaches at most half an edge out of it. A node is cut as long as its
//! subtree holds more than max(P / 256, 64) triangles and it lies above depth 12; where it is not
//! cut it is a pseudo-leaf and everything in it makes one cell. A node that is cut keeps only what
//! is too large to descend; that makes cells too. Content beyond the limit (large clusters of an
//! interior node, or a crowd at depth 12) is halved at the median of its centres until each part
//! is within the limit or is a single cluster: the largest cell enters the default optimization
//! budget twice.
//!
//! Why P / 256: a frame at the budget then shows hundreds of cells, so that one cell more or less
//! is half a percent of it. Larger divisors make more cells than the placement can sort per grid
//! point; smaller ones coarse placements.

use super::{Cell, Clusters, Octree, cluster::extent};
use crate::scene::Scene;
use glam::{BVec3, DVec3};
use ldi_protocol::Aabb;
use rayon::prelude::*;

/// Budget over triangles of an instance whose clusters stay together. Smaller: more meshes are
/// simplified as a whole; larger: cells follow what is near more closely.
const TOGETHER_PER_BUDGET: u64 = 24;
/// Clusters also stay together where all of them are at most this many times as long as the longest
/// and fit into a leaf: a profile's ends stay with its sides.
const LONGER: f64 = 2.0;
/// Nodes are not cut below this depth: 1/4096 of the scene.
const MAX_DEPTH: u8 = 12;
/// Budget over triangles in a pseudo-leaf (see the module's text).
const CELLS_PER_BUDGET: u64 = 256;
/// Pseudo-leaves of fewer triangles cost more in bookkeeping than they save.
const MIN_LEAF_TRIANGLES: u64 = 64;

/// A cluster instance, or all of one mesh, on its way down.
#[derive(Clone, Copy)]
struct Item {
    instance: u32,
    /// The first cluster, and the one after the last.
    clusters: [u32; 2],
    triangles: u32,
    /// Deepest level whose edge is at least the extent.
    level: u8,
    centre: DVec3,
    bounds: Aabb,
}

/// Largest number of triangles in a pseudo-leaf for a geometry budget.
pub(super) fn leaf_limit(budget: u64) -> u64 {
    (budget / CELLS_PER_BUDGET).max(MIN_LEAF_TRIANGLES)
}

/// Most triangles of an instance whose clusters stay together.
pub(super) fn together_limit(budget: u64) -> u64 {
    budget / TOGETHER_PER_BUDGET
}

impl Octree {
    /// Distributes the cluster instances of a scene to cells for a geometry budget in triangles;
    /// deterministic.
    pub fn build(scene: &Scene, clusters: &Clusters, budget: u64) -> Self {
        let mut items = items(scene, clusters, together_limit(budget), leaf_limit(budget));
        let root = items.iter().fold(Aabb::EMPTY, |b, i| b.union(i.bounds));
        let mut octree = Self::default();
        if items.is_empty() {
            return octree;
        }
        let edge = extent(&root);
        for i in &mut items {
            let mut level_edge = edge * 0.5;
            while i.level < MAX_DEPTH && level_edge >= extent(&i.bounds) {
                i.level += 1;
                level_edge *= 0.5;
            }
        }
        let mut builder = Builder { octree: &mut octree, limit: leaf_limit(budget) };
        builder.node(items, root.centre(), edge, 0);
        octree
    }

    /// Triangles in the largest cell; 0 without cells.
    pub fn largest_cell(&self) -> u32 {
        self.cells.iter().map(|c| c.triangles).max().unwrap_or(0)
    }
}

/// All cluster instances with tight world bounds, level 0; together those of small meshes of at
/// most `most` triangles, and of meshes of a leaf's triangles that are hardly longer than one of
/// their clusters.
fn items(scene: &Scene, clusters: &Clusters, most: u64, leaf_limit: u64) -> Vec<Item> {
    let of_instance = |(number, i): (usize, &crate::scene::Instance)| {
        let mesh = &scene.meshes[i.mesh as usize];
        let world: Vec<Vec<DVec3>> = mesh
            .primitives
            .iter()
            .map(|p| p.positions.iter().map(|v| i.world_from_mesh.transform_point3(v.as_dvec3())).collect())
            .collect();
        let of_mesh = clusters.of_mesh[i.mesh as usize].clone();
        let each: Vec<Item> = of_mesh
            .clone()
            .map(|c| {
                let cluster = &clusters.clusters[c as usize];
                let triangles = &mesh.primitives[cluster.primitive as usize].triangles;
                let vertices = cluster.triangles.iter().flat_map(|t| triangles[*t as usize]);
                let bounds = Aabb::from_points(vertices.map(|v| world[cluster.primitive as usize][v as usize]));
                Item {
                    instance: number as u32,
                    clusters: [c, c + 1],
                    triangles: cluster.triangles.len() as u32,
                    level: 0,
                    centre: bounds.centre(),
                    bounds,
                }
            })
            .collect();
        let bounds = each.iter().fold(Aabb::EMPTY, |b, i| b.union(i.bounds));
        let longest = each.iter().map(|i| extent(&i.bounds)).fold(0.0, f64::max);
        let is_small = total(&each) <= most && extent(&bounds) <= clusters.extent_m;
        let is_long_anyway = total(&each) <= leaf_limit && extent(&bounds) <= LONGER * longest;
        if each.len() > 1 && (is_small || is_long_anyway) {
            let (clusters, triangles) = ([of_mesh.start, of_mesh.end], total(&each) as u32);
            return vec![Item { clusters, triangles, centre: bounds.centre(), bounds, ..each[0] }];
        }
        each
    };
    let per_instance: Vec<Vec<Item>> = scene.instances.par_iter().enumerate().map(of_instance).collect();
    per_instance.concat()
}

struct Builder<'a> {
    octree: &'a mut Octree,
    limit: u64,
}

fn total(items: &[Item]) -> u64 {
    items.iter().map(|i| u64::from(i.triangles)).sum()
}

impl Builder<'_> {
    fn node(&mut self, items: Vec<Item>, centre: DVec3, edge: f64, depth: u8) {
        self.octree.nodes += 1;
        self.octree.depth = self.octree.depth.max(depth);
        if total(&items) <= self.limit || depth == MAX_DEPTH {
            self.cells(items, depth);
            return;
        }
        let mut own = Vec::new();
        let mut children: [Vec<Item>; 8] = Default::default();
        for item in items {
            if item.level <= depth {
                own.push(item);
            } else {
                children[item.centre.cmpge(centre).bitmask() as usize].push(item);
            }
        }
        self.cells(own, depth);
        for (octant, items) in children.into_iter().enumerate() {
            if !items.is_empty() {
                let side = BVec3::new(octant & 1 != 0, octant & 2 != 0, octant & 4 != 0);
                let offset = DVec3::select(side, DVec3::splat(edge * 0.25), DVec3::splat(edge * -0.25));
                self.node(items, centre + offset, edge * 0.5, depth + 1);
            }
        }
    }

    /// One cell, or several where the content exceeds the limit.
    fn cells(&mut self, mut items: Vec<Item>, depth: u8) {
        if items.is_empty() {
            return;
        }
        let triangles = total(&items);
        if triangles > self.limit && items.len() > 1 {
            let (left, right) = halved(items);
            self.cells(left, depth);
            self.cells(right, depth);
            return;
        }
        items.sort_unstable_by_key(|i| (i.instance, i.clusters));
        let bounds = items.iter().fold(Aabb::EMPTY, |b, i| b.union(i.bounds));
        self.octree.cells.push(Cell {
            bounds: outward_f32(&bounds),
            triangles: triangles as u32,
            depth,
            content: items.iter().flat_map(|i| (i.clusters[0]..i.clusters[1]).map(|c| (i.instance, c))).collect(),
        });
    }
}

/// Two parts of about equal triangle count, separated along the longest axis of the centres' box.
fn halved(mut items: Vec<Item>) -> (Vec<Item>, Vec<Item>) {
    let size = Aabb::from_points(items.iter().map(|i| i.centre)).size();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let key = |i: &Item| (i.instance, i.clusters);
    items.sort_unstable_by(|a, b| a.centre[axis].total_cmp(&b.centre[axis]).then(key(a).cmp(&key(b))));
    let half = total(&items) / 2;
    let mut sum = 0;
    let middle = items.iter().position(|i| {
        sum += u64::from(i.triangles);
        sum >= half
    });
    let right = items.split_off((middle.unwrap_or(0) + 1).clamp(1, items.len() - 1));
    (items, right)
}

/// The smallest box with f32 corners around a box.
pub(super) fn outward_f32(b: &Aabb) -> Aabb {
    let down = |x: f64| {
        let r = x as f32;
        f64::from(if f64::from(r) > x { r.next_down() } else { r })
    };
    Aabb {
        min: DVec3::new(down(b.min.x), down(b.min.y), down(b.min.z)),
        max: DVec3::new(up_to_f32(b.max.x), up_to_f32(b.max.y), up_to_f32(b.max.z)),
    }
}

/// The smallest f32 that is at least `x`.
pub(crate) fn up_to_f32(x: f64) -> f64 {
    let r = x as f32;
    f64::from(if f64::from(r) < x { r.next_up() } else { r })
}
