//! The bounding volume hierarchy: eight boxes to a node, four triangles to a leaf, in one or two
//! levels.
//!
//! obvhs builds a binary tree (PLOC with reinsertion, Meister and Bittner 2018); here it is
//! flattened into nodes of up to eight children, always opening the child with the largest surface
//! (Wald, Benthin and Boulos 2008), and leaves of one block of up to four triangles. Boxes and
//! triangles lie in arrays by coordinate, so that one ray is tested against eight boxes or four
//! triangles at once; a packet of rays shares the very same layout.
//!
//! Meshes that stand in few places are expanded: their triangles lie in the hierarchy in world
//! space, which traverses fastest. Of the others each cluster has a small hierarchy in its mesh's
//! space, made once, and the scene's hierarchy holds an [`Item`] per cluster of each instance (two
//! levels, Wald, Benthin and Slusallek 2003). So memory grows with unique triangles and with
//! instances, never with triangles times instances.
//!
//! Positions are f32 relative to the middle of the scene: over 100 m they are exact to 4 um.

use super::{geometry::Geometry, place::Place};
use crate::{octree::Clusters, scene::Primitive};
use glam::{DVec3, Vec3A};
use ldi_protocol::Aabb;
use obvhs::{Boundable, BvhBuildParams, bvh2::Bvh2};
use rayon::prelude::*;

/// Marks a child that is a block of triangles.
pub(super) const LEAF: u32 = 1 << 31;
/// With [`LEAF`]: marks a child that is an item.
pub(super) const ITEM: u32 = 1 << 30;
/// Triangles of meshes with several instances that are expanded at most. More: rays among such
/// meshes are faster; fewer: less memory, a quarter of a [`Block`] and its share of the nodes each.
pub(super) const MOST_EXPANDED: u64 = 4_000_000;
/// Marks a child that is not there.
pub(super) const EMPTY: u32 = u32::MAX;
/// Triangle number of a lane that is not there.
pub(super) const NO_TRIANGLE: u32 = u32::MAX;

/// Up to eight boxes; on as few cache lines as they fit on.
#[repr(C, align(64))]
pub(super) struct Node {
    /// min x, y, z, max x, y, z of every child; absent children have inverted infinite boxes.
    pub bounds: [[f32; 8]; 6],
    /// Node number, or LEAF | block number, or LEAF | ITEM | item number, or EMPTY.
    pub children: [u32; 8],
    /// Bits of the children that are there.
    pub used: u8,
}

/// Up to four triangles; on as few cache lines as they fit on. Lanes that are not there have NaN
/// corners, which nothing hits.
#[repr(C, align(64))]
pub(super) struct Block {
    /// x, y, z of corner 0, 1, 2.
    pub corners: [[[f32; 4]; 3]; 3],
    /// x, y, z of the unit normal, computed in f64: f32 differences of the corners would lose it
    /// for slivers.
    pub normal: [[f32; 4]; 3],
    /// Numbers of the triangles.
    pub triangles: [u32; 4],
    /// Bits of the lanes whose hits an alpha mask may cut out.
    pub masked: u8,
    /// The alpha masks' entry of the first of these ([`AlphaMasks`](super::alpha::AlphaMasks)).
    pub first_mask: u32,
}

/// A cluster of an instance.
pub(super) struct Item {
    /// Position in [`Bvh::places`].
    pub place: u32,
    /// The root of the cluster's hierarchy in [`Bvh::local`]: a child as a node has it.
    pub root: u32,
    /// Number of the first triangle of its primitive in this instance.
    pub first: u32,
    /// Octree cell.
    pub cell: u32,
}

/// Nodes and blocks; children come after their parents.
#[derive(Default)]
pub(super) struct Branches {
    pub nodes: Vec<Node>,
    pub blocks: Vec<Block>,
}

/// Blocks of the local hierarchies that come from one primitive.
pub(super) struct LocalPart {
    pub mesh: u32,
    pub primitive: u32,
    pub blocks: std::ops::Range<u32>,
}

/// The hierarchy.
pub(super) struct Bvh {
    /// A child as a node has it; None in a scene without triangles.
    pub root: Option<u32>,
    /// What lies in world space.
    pub world: Branches,
    /// Cells of the triangles of each block of `world`; empty without an octree.
    pub cells: Vec<[u32; 4]>,
    /// Clusters of meshes that are not expanded; triangles are numbered within their primitive.
    pub local: Branches,
    pub local_parts: Vec<LocalPart>,
    pub items: Vec<Item>,
    pub places: Vec<Place>,
}

struct Boxed(obvhs::aabb::Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> obvhs::aabb::Aabb {
        self.0
    }
}

impl Boxed {
    fn of([a, b, c]: [Vec3A; 3]) -> Self {
        Self(obvhs::aabb::Aabb { min: a.min(b).min(c), max: a.max(b).max(c) })
    }
}

/// World corners relative to the scene's middle.
fn corners(geometry: &Geometry, triangle: u32) -> [Vec3A; 3] {
    geometry.corners_world(triangle).map(|p| (p - geometry.origin).as_vec3a())
}

fn binary_tree(boxes: &[Boxed], max_prims_per_leaf: u32) -> Bvh2 {
    let parameters = BvhBuildParams { max_prims_per_leaf, ..BvhBuildParams::medium_build() };
    obvhs::bvh2::builder::build_bvh2(boxes, parameters, &mut std::time::Duration::default())
}

/// Which meshes are expanded: those with one instance, and of the others those that take least, up
/// to `most` triangles.
fn expanded(geometry: &Geometry, most: u64) -> Vec<bool> {
    let scene = &geometry.scene;
    let mut instances = vec![0u64; scene.meshes.len()];
    scene.instances.iter().for_each(|i| instances[i.mesh as usize] += 1);
    let taken = |mesh: &usize| scene.meshes[*mesh].triangles() * instances[*mesh];
    let mut out: Vec<bool> = instances.iter().map(|n| *n <= 1).collect();
    let mut repeated: Vec<usize> = (0..out.len()).filter(|mesh| !out[*mesh]).collect();
    repeated.sort_by_key(taken);
    let mut sum = 0;
    for mesh in repeated {
        sum += taken(&mesh);
        if sum > most {
            break;
        }
        out[mesh] = true;
    }
    out
}

impl Bvh {
    /// Builds the hierarchy with at most so many triangles of repeated meshes expanded. `clusters`
    /// of the scene, if they are known already; `is_masked` says which primitives need a look at
    /// their alpha.
    pub fn new(
        geometry: &Geometry,
        clusters: Option<&Clusters>,
        is_masked: impl Fn(&Primitive) -> bool + Sync,
        most_expanded: u64,
    ) -> Self {
        let is_expanded = expanded(geometry, most_expanded);
        let scene = &geometry.scene;
        let mut bvh = Self {
            root: None,
            world: Branches::default(),
            cells: Vec::new(),
            local: Branches::default(),
            local_parts: Vec::new(),
            items: Vec::new(),
            places: Vec::new(),
        };
        let has_two_levels = is_expanded.iter().any(|e| !e);
        let mut roots = Vec::new();
        if has_two_levels {
            // Joins both hierarchies, and comes before them as a parent does.
            bvh.world.nodes.push(Node::over([].into_iter()));
            let own;
            let clusters = match clusters {
                Some(clusters) => clusters,
                None => {
                    own = Clusters::build(scene);
                    &own
                }
            };
            let bounds = bvh.add_items(geometry, clusters, &is_expanded);
            roots.extend(bvh.add_item_tree(&bounds).map(|root| (root, union(&bounds))));
        }
        let is_world = |i: &usize| is_expanded[scene.instances[*i].mesh as usize];
        let triangles: Vec<u32> = if bvh.items.is_empty() {
            (0..geometry.triangle_count).collect()
        } else {
            let of_instance = |i: usize| {
                let primitives = &scene.meshes[scene.instances[i].mesh as usize].primitives;
                let first = geometry.first_triangle(i as u32, 0);
                first..first + primitives.iter().map(|p| p.triangles.len() as u32).sum::<u32>()
            };
            let with_triangles = |i: &usize| !scene.meshes[scene.instances[*i].mesh as usize].primitives.is_empty();
            (0..scene.instances.len()).filter(is_world).filter(with_triangles).flat_map(of_instance).collect()
        };
        if let Some(world) = bvh.add_world(geometry, &triangles) {
            roots.push(world);
        }
        bvh.root = roots.first().map(|(root, _)| *root);
        if has_two_levels {
            bvh.world.nodes[0] = Node::over(roots.into_iter());
            bvh.root = Some(0);
        }
        let mut masks = 0;
        for block in &mut bvh.world.blocks {
            let masked = |t: u32| is_masked(geometry.primitive(&geometry.source(t)));
            (block.masked, block.first_mask) = (block.lanes(masked), masks);
            masks += block.masked.count_ones();
        }
        for part in &bvh.local_parts {
            let masked = is_masked(&scene.meshes[part.mesh as usize].primitives[part.primitive as usize]);
            for block in &mut bvh.local.blocks[part.blocks.start as usize..part.blocks.end as usize] {
                (block.masked, block.first_mask) = (block.lanes(|_| masked), masks);
                masks += block.masked.count_ones();
            }
        }
        bvh
    }

    /// Adds the blocks and nodes of these triangles; their root and its box.
    fn add_world(&mut self, geometry: &Geometry, triangles: &[u32]) -> Option<(u32, obvhs::aabb::Aabb)> {
        if triangles.is_empty() {
            return None;
        }
        let boxes: Vec<Boxed> = triangles.par_iter().map(|t| Boxed::of(corners(geometry, *t))).collect();
        let binary = binary_tree(&boxes, 4);
        drop(boxes);
        let mut leaves = Vec::new();
        let root = flatten(&binary, &mut self.world.nodes, &mut |leaf| {
            leaves.push(leaf);
            LEAF | (leaves.len() as u32 - 1)
        })?;
        let triangles_of = |leaf: &u32| {
            let n = &binary.nodes[*leaf as usize];
            let range = n.first_index as usize..(n.first_index + n.prim_count) as usize;
            let mut out = [NO_TRIANGLE; 4];
            out.iter_mut().zip(&binary.primitive_indices[range]).for_each(|(o, i)| *o = triangles[*i as usize]);
            out
        };
        self.world.blocks = leaves.par_iter().map(|l| Block::new(triangles_of(l), |t| corners(geometry, t))).collect();
        if geometry.has_cells() {
            let cell = |t: &u32| if *t == NO_TRIANGLE { u32::MAX } else { geometry.cell_of(*t) };
            self.cells = self.world.blocks.par_iter().map(|b| b.triangles.each_ref().map(cell)).collect();
        }
        Some((root, *binary.nodes[0].aabb()))
    }

    /// Adds the local hierarchies of the clusters of meshes that are not expanded, and an item for
    /// each of their instances; the items' boxes.
    fn add_items(&mut self, geometry: &Geometry, clusters: &Clusters, is_expanded: &[bool]) -> Vec<Boxed> {
        let scene = &geometry.scene;
        let built: Vec<Option<(Branches, u32)>> = clusters
            .clusters
            .par_iter()
            .map(|c| {
                let primitive = &scene.meshes[c.mesh as usize].primitives[c.primitive as usize];
                if is_expanded[c.mesh as usize] { None } else { Branches::local(primitive, &c.triangles) }
            })
            .collect();
        let mut roots = Vec::with_capacity(built.len());
        for (built, cluster) in built.into_iter().zip(&clusters.clusters) {
            let Some((branches, root)) = built else {
                roots.push(EMPTY);
                continue;
            };
            let (node, block) = (self.local.nodes.len() as u32, self.local.blocks.len() as u32);
            let moved = |child: u32| match child {
                EMPTY => EMPTY,
                leaf if leaf & LEAF != 0 => leaf + block,
                inner => inner + node,
            };
            roots.push(moved(root));
            self.local.nodes.extend(branches.nodes.into_iter().map(|n| Node { children: n.children.map(moved), ..n }));
            self.local.blocks.extend(branches.blocks);
            self.local_parts.push(LocalPart {
                mesh: cluster.mesh,
                primitive: cluster.primitive,
                blocks: block..self.local.blocks.len() as u32,
            });
        }
        let mesh_bounds: Vec<Aabb> = scene.meshes.par_iter().map(|m| m.bounds()).collect();
        let mut boxes = Vec::new();
        for (number, instance) in (0u32..).zip(&scene.instances) {
            let mesh = instance.mesh as usize;
            if is_expanded[mesh] || clusters.of_mesh[mesh].is_empty() {
                continue;
            }
            let normal_matrix = &geometry.normal_matrices[number as usize];
            let place = Place::new(number, instance, normal_matrix, &mesh_bounds[mesh], geometry.origin);
            for c in clusters.of_mesh[mesh].clone() {
                let cluster = &clusters.clusters[c as usize];
                let root = roots[c as usize];
                if root == EMPTY {
                    continue;
                }
                self.items.push(Item {
                    place: self.places.len() as u32,
                    root,
                    first: geometry.first_triangle(number, cluster.primitive),
                    cell: geometry.cell(number, c),
                });
                let world = cluster.bounds.corners().map(|p| instance.world_from_mesh.transform_point3(p));
                let world = Aabb::from_points(world.map(|p| p - geometry.origin));
                let slack = DVec3::splat(f64::from(place.slack()));
                boxes.push(Boxed(obvhs::aabb::Aabb {
                    min: (world.min - slack).as_vec3a(),
                    max: (world.max + slack).as_vec3a(),
                }));
            }
            self.places.push(place);
        }
        boxes
    }

    /// Adds the nodes over all items; their root.
    fn add_item_tree(&mut self, boxes: &[Boxed]) -> Option<u32> {
        let binary = binary_tree(boxes, 1);
        flatten(&binary, &mut self.world.nodes, &mut |leaf| {
            let leaf = &binary.nodes[leaf as usize];
            debug_assert_eq!(leaf.prim_count, 1, "leaves of one item were asked for");
            LEAF | ITEM | binary.primitive_indices[leaf.first_index as usize]
        })
    }
}

fn union(boxes: &[Boxed]) -> obvhs::aabb::Aabb {
    boxes.iter().fold(obvhs::aabb::Aabb::empty(), |a, b| a.union(&b.0))
}

impl Branches {
    /// The hierarchy of some triangles of a primitive, in the mesh's space, and its root.
    fn local(primitive: &Primitive, triangles: &[u32]) -> Option<(Self, u32)> {
        let corners = |t: u32| primitive.triangles[t as usize].map(|v| Vec3A::from(primitive.positions[v as usize]));
        let boxes: Vec<Boxed> = triangles.iter().map(|t| Boxed::of(corners(*t))).collect();
        let binary = binary_tree(&boxes, 4);
        let mut out = Self::default();
        let root = flatten(&binary, &mut out.nodes, &mut |leaf| {
            let leaf = &binary.nodes[leaf as usize];
            let range = leaf.first_index as usize..(leaf.first_index + leaf.prim_count) as usize;
            let mut of_leaf = [NO_TRIANGLE; 4];
            let found = binary.primitive_indices[range].iter().map(|i| triangles[*i as usize]);
            of_leaf.iter_mut().zip(found).for_each(|(o, t)| *o = t);
            out.blocks.push(Block::new(of_leaf, corners));
            LEAF | (out.blocks.len() as u32 - 1)
        })?;
        Some((out, root))
    }
}

impl Block {
    fn new(triangles: [u32; 4], corners: impl Fn(u32) -> [Vec3A; 3]) -> Self {
        let mut block =
            Self { corners: [[[f32::NAN; 4]; 3]; 3], normal: [[0.0; 4]; 3], triangles, masked: 0, first_mask: 0 };
        for (lane, t) in triangles.into_iter().enumerate().filter(|(_, t)| *t != NO_TRIANGLE) {
            let local = corners(t);
            for (corner, p) in block.corners.iter_mut().zip(local) {
                for (axis, x) in corner.iter_mut().zip(p.to_array()) {
                    axis[lane] = x;
                }
            }
            // Of the corners as they are stored, so that the plane is the one that edges are
            // tested against.
            let [a, b, c] = local.map(|p| p.as_dvec3());
            let n = (b - a).cross(c - a).normalize_or_zero().as_vec3();
            for (axis, x) in block.normal.iter_mut().zip(n.to_array()) {
                axis[lane] = x;
            }
        }
        block
    }

    /// Bits of the lanes whose triangle is `wanted`.
    pub fn lanes(&self, wanted: impl Fn(u32) -> bool) -> u8 {
        let is_wanted = |t: u32| t != NO_TRIANGLE && wanted(t);
        self.triangles.iter().enumerate().fold(0, |bits, (i, t)| bits | u8::from(is_wanted(*t)) << i)
    }
}

impl Node {
    /// A node over up to eight children with their boxes.
    fn over(children: impl Iterator<Item = (u32, obvhs::aabb::Aabb)>) -> Self {
        let mut node = Self { bounds: [[0.0; 8]; 6], children: [EMPTY; 8], used: 0 };
        for axis in 0..3 {
            (node.bounds[axis], node.bounds[axis + 3]) = ([f32::INFINITY; 8], [f32::NEG_INFINITY; 8]);
        }
        for (slot, (child, b)) in children.enumerate() {
            node.children[slot] = child;
            node.used |= 1 << slot;
            for axis in 0..3 {
                node.bounds[axis][slot] = b.min[axis];
                node.bounds[axis + 3][slot] = b.max[axis];
            }
        }
        node
    }
}

/// Turns a binary tree into wide nodes, depth first; its root, as a node has a child. `leaf` makes
/// a child of the number of a binary leaf. None: there are no nodes.
fn flatten(binary: &Bvh2, nodes: &mut Vec<Node>, leaf: &mut impl FnMut(u32) -> u32) -> Option<u32> {
    let first = binary.nodes.first()?;
    if first.is_leaf() {
        return (first.prim_count > 0).then(|| leaf(0));
    }
    let root = nodes.len() as u32;
    // An explicit stack: binary trees can be deep.
    let mut pending = vec![(0, None)];
    while let Some((at, parent)) = pending.pop() {
        let number = nodes.len() as u32;
        if let Some((parent, slot)) = parent {
            let parent: &mut Node = &mut nodes[parent as usize];
            parent.children[slot] = number;
        }
        let opened = open(binary, at);
        let mut node = Node::over(opened.iter().map(|b| (EMPTY, *binary.nodes[*b as usize].aabb())));
        for (slot, &b) in opened.iter().enumerate() {
            if binary.nodes[b as usize].is_leaf() {
                node.children[slot] = leaf(b);
            } else {
                pending.push((b, Some((number, slot))));
            }
        }
        nodes.push(node);
    }
    Some(root)
}

/// Up to eight descendants that together are an inner node of a binary tree.
fn open(binary: &Bvh2, node: u32) -> Vec<u32> {
    let first = binary.nodes[node as usize].first_index;
    let mut opened = vec![first, first + 1];
    while opened.len() < 8 {
        let area = |b: &u32| binary.nodes[*b as usize].aabb().half_area();
        let inner = opened.iter().enumerate().filter(|(_, b)| !binary.nodes[**b as usize].is_leaf());
        let Some((largest, _)) = inner.max_by(|a, b| area(a.1).total_cmp(&area(b.1))) else { break };
        let first = binary.nodes[opened[largest] as usize].first_index;
        opened[largest] = first;
        opened.push(first + 1);
    }
    opened
}
