//! Gathers draws from cells: clusters, their placements and materials.

use super::{alpha::AlphaBlocks, stats::NearStats};
use crate::resident::{self, Resident};
use glam::{DAffine3, Vec3};
use ldi_protocol::{
    Aabb,
    index::{DrawnCell, Index},
    mesh::{Alpha, CellGeometry, Cluster, ClusterRef, MAX_CLUSTER_TRIANGLES, Material},
    texture::Texture,
};
use std::{collections::BTreeMap, ops::Range, sync::Arc};

/// Largest number of draws in a frame: a triangle's number has 24 bits for the draw and 8 bits for
/// the triangle; the last number is reserved.
const MAX_DRAWS: usize = (1 << 24) - 1;

/// A cluster in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Draw {
    /// Position in [`Gathered::held`].
    pub geometry: u32,
    /// Position in its clusters.
    pub cluster: u32,
    /// Placement of the cluster's mesh.
    pub world_from_mesh: DAffine3,
}

/// Alpha blocks of the textures in use, kept between frames, and computed again when a texture gets
/// finer.
pub(super) type BlockCache = BTreeMap<u32, (Arc<Texture>, Arc<AlphaBlocks>)>;

/// A texture, with alpha blocks if a mask needs them.
struct Held {
    texture: Arc<Texture>,
    blocks: Option<Arc<AlphaBlocks>>,
}

/// Everything that one frame draws, held so that the cache cannot evict it.
pub(crate) struct Gathered<'a> {
    materials: &'a [Material],
    /// The chunks that contain the draws' clusters.
    pub held: Vec<Arc<CellGeometry>>,
    textures: BTreeMap<u32, Option<Held>>,
    /// Draws in the order of the cells.
    pub draws: Vec<Draw>,
    /// Counts, without pixels.
    pub stats: NearStats,
}

/// Collects the draws of `cells`.
pub(crate) fn gather<'a>(index: &'a Index, resident: &dyn Resident, cells: &[DrawnCell]) -> Gathered<'a> {
    gather_if(index, resident, cells, |_, _| true)
}

/// Collects the draws of `cells` whose clusters touch a world-space box.
pub(crate) fn gather_within<'a>(
    index: &'a Index,
    resident: &dyn Resident,
    cells: &[DrawnCell],
    within: &Aabb,
) -> Gathered<'a> {
    gather_if(index, resident, cells, |cluster, world_from_mesh| bounds(cluster, world_from_mesh).intersects(within))
}

/// Bounds of a cluster in the world; not tight if it is rotated.
fn bounds(cluster: &Cluster, world_from_mesh: &DAffine3) -> Aabb {
    let points = || cluster.positions.iter();
    let (min, max) = (points().copied().reduce(Vec3::min), points().copied().reduce(Vec3::max));
    let (Some(min), Some(max)) = (min, max) else { return Aabb::EMPTY };
    let (min, max) = (min.as_dvec3() + cluster.origin, max.as_dvec3() + cluster.origin);
    let centre = world_from_mesh.transform_point3(0.5 * (min + max));
    let axes = world_from_mesh.matrix3;
    let half = 0.5 * (max - min);
    let half = axes.x_axis.abs() * half.x + axes.y_axis.abs() * half.y + axes.z_axis.abs() * half.z;
    Aabb { min: centre - half, max: centre + half }
}

fn gather_if<'a>(
    index: &'a Index,
    resident: &dyn Resident,
    cells: &[DrawnCell],
    wanted: impl Fn(&Cluster, &DAffine3) -> bool,
) -> Gathered<'a> {
    let mut out = Gathered {
        materials: &index.materials,
        held: Vec::new(),
        textures: BTreeMap::new(),
        draws: Vec::new(),
        stats: NearStats::default(),
    };
    let mut bundles: BTreeMap<u32, Option<u32>> = BTreeMap::new();
    // Levels of several cells lie in one chunk.
    let mut levels: BTreeMap<u32, u32> = BTreeMap::new();
    for &drawn in cells {
        let Some(mesh) = index.mesh_of(drawn) else { continue };
        let Some(geometry) = resident::mesh(index, resident, drawn) else {
            out.stats.missing_chunks.push(mesh.chunk);
            continue;
        };
        let own = match drawn.level {
            0 => out.hold(geometry.clone()),
            _ => *levels.entry(mesh.chunk).or_insert_with(|| out.hold(geometry.clone())),
        };
        for instance in resident::instances(index, &geometry, drawn) {
            let (held, cluster) = match instance.cluster {
                ClusterRef::Own(cluster) => (Some(own), cluster),
                ClusterRef::Shared { chunk, cluster } => {
                    let held = *bundles.entry(chunk).or_insert_with(|| match resident.bundle(chunk) {
                        Some(bundle) => Some(out.hold(bundle)),
                        None => {
                            out.stats.missing_chunks.push(chunk);
                            None
                        }
                    });
                    (held, cluster)
                }
            };
            if let Some(held) = held {
                out.add((held, cluster), &instance.world_from_mesh, resident, &wanted);
            }
        }
    }
    let stats = &mut out.stats;
    stats.missing_chunks.sort_unstable();
    stats.missing_chunks.dedup();
    for (number, texture) in &out.textures {
        match texture.as_ref().map(|t| t.texture.levels.first().is_some_and(Option::is_some)) {
            None => stats.missing_textures.push(*number),
            Some(false) => stats.coarse_textures.push(*number),
            Some(true) => {}
        }
    }
    out
}

impl<'a> Gathered<'a> {
    fn hold(&mut self, geometry: Arc<CellGeometry>) -> u32 {
        self.held.push(geometry);
        self.held.len() as u32 - 1
    }

    fn add(
        &mut self,
        (geometry, cluster): (u32, u32),
        world_from_mesh: &DAffine3,
        resident: &dyn Resident,
        wanted: impl Fn(&Cluster, &DAffine3) -> bool,
    ) {
        let Some(c) = self.held[geometry as usize].clusters.get(cluster as usize) else { return };
        let Some(material) = self.materials.get(c.material as usize) else { return };
        if self.draws.len() >= MAX_DRAWS || !wanted(c, world_from_mesh) {
            return;
        }
        self.stats.clusters += 1;
        self.stats.triangles += c.triangles.len().min(MAX_CLUSTER_TRIANGLES) as u64;
        if let Some(texture) = material.texture {
            self.textures
                .entry(texture)
                .or_insert_with(|| resident.texture(texture).map(|texture| Held { texture, blocks: None }));
        }
        self.draws.push(Draw { geometry, cluster, world_from_mesh: *world_from_mesh });
    }

    /// Finds or computes the alpha blocks of masked textures, and drops those of unused textures.
    pub(super) fn hold_blocks(&mut self, cache: &mut BlockCache) {
        cache.retain(|number, _| self.textures.contains_key(number));
        for material in self.materials.iter().filter(|m| matches!(m.alpha, Alpha::Mask(_))) {
            let Some(number) = material.texture else { continue };
            let Some(Some(held)) = self.textures.get_mut(&number) else { continue };
            if held.blocks.is_none() {
                let known = cache.get(&number).filter(|(texture, _)| Arc::ptr_eq(texture, &held.texture));
                let blocks =
                    known.map_or_else(|| Arc::new(AlphaBlocks::new(&held.texture)), |(_, blocks)| blocks.clone());
                cache.insert(number, (held.texture.clone(), blocks.clone()));
                held.blocks = Some(blocks);
            }
        }
    }

    /// The cluster of a draw.
    pub fn cluster(&self, draw: &Draw) -> &Cluster {
        &self.held[draw.geometry as usize].clusters[draw.cluster as usize]
    }

    /// The material of a cluster.
    pub fn material(&self, cluster: &Cluster) -> &'a Material {
        &self.materials[cluster.material as usize]
    }

    /// The texture of a material, if any level of it is resident.
    pub fn texture(&self, material: &Material) -> Option<&Texture> {
        Some(&*self.textures.get(&material.texture?)?.as_ref()?.texture)
    }

    /// The resident textures in use, by number.
    pub fn textures(&self) -> impl Iterator<Item = (u32, &Arc<Texture>)> {
        self.textures.iter().filter_map(|(number, held)| Some((*number, &held.as_ref()?.texture)))
    }

    /// The alpha blocks of a masked material's texture.
    pub(super) fn blocks(&self, material: &Material) -> Option<&AlphaBlocks> {
        self.textures.get(&material.texture?)?.as_ref()?.blocks.as_deref()
    }

    /// The alpha test of a cluster's material: per texel, or for the whole triangle.
    pub fn mask(&self, cluster: &Cluster) -> Mask {
        let material = self.material(cluster);
        match material.alpha {
            Alpha::Opaque => Mask::Solid,
            Alpha::Mask(cutoff) if !cluster.uvs.is_empty() && self.texture(material).is_some() => Mask::ByTexel(cutoff),
            Alpha::Mask(cutoff) if material.base_colour[3] < cutoff => Mask::Nothing,
            Alpha::Mask(_) => Mask::Solid,
        }
    }

    /// Consecutive ranges of draws: about `first` triangles, then twice as many each time up to
    /// `largest`.
    pub fn batches(&self, first: usize, largest: usize) -> Vec<Range<usize>> {
        self.ranges(0..self.draws.len(), first, largest)
    }

    /// Cuts a range of draws into consecutive ones with about `triangles` triangles each.
    pub fn tasks(&self, range: Range<usize>, triangles: usize) -> Vec<Range<usize>> {
        self.ranges(range, triangles, triangles)
    }

    fn ranges(&self, range: Range<usize>, first: usize, largest: usize) -> Vec<Range<usize>> {
        let (mut out, mut start, mut sum, mut wanted) = (Vec::new(), range.start, 0, first);
        for i in range.clone() {
            sum += self.cluster(&self.draws[i]).triangles.len();
            if sum >= wanted {
                out.push(start..i + 1);
                (start, sum, wanted) = (i + 1, 0, (2 * wanted).min(largest));
            }
        }
        if start < range.end {
            out.push(start..range.end);
        }
        out
    }
}

/// Alpha test of a material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Mask {
    /// Every covered pixel is drawn.
    Solid,
    /// A pixel is drawn if the texture's alpha times the factor reaches the cutoff.
    ByTexel(f32),
    /// No pixel is drawn.
    Nothing,
}
