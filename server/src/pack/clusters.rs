//! Clusters and simplified pieces as clusters of the wire, shared or not, and the cells that place
//! them.

use super::{Chunk, PackError, density};
use crate::levels::{Level, Levels, Piece};
use crate::octree::{Clusters, Octree};
use crate::scene::Scene;
use glam::DVec3;
use ldi_protocol::codec::cell::{self, ClusterSteps};
use ldi_protocol::index::{CellEntry, CellLevel, ChunkKind};
use ldi_protocol::mesh::{CellGeometry, Cluster, ClusterInstance, ClusterRef};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Raw size at which a bundle is closed: a few milliseconds of a slow link. Larger bundles make
/// cells fetch clusters they do not draw; smaller ones make a chunk, and a stream, of every few
/// clusters.
const BUNDLE_BYTES: usize = 32 << 10;

/// About how much a triangle takes before compression: half a vertex and three indices.
const TRIANGLE_BYTES: usize = 20;

/// zstd level of geometry chunks: they are small, and compressed once.
const LEVEL: i32 = 12;

/// Near geometry as chunks.
#[derive(Debug, Clone)]
pub struct PackedGeometry {
    /// Bundles, one chunk per cell, then bundles and chunks of levels of detail; chunk numbers
    /// count from `first_chunk`.
    pub chunks: Vec<Chunk>,
    /// Entries of the cells, in the octree's order.
    pub cells: Vec<CellEntry>,
    /// Clusters that are stored once and drawn from several cells.
    pub shared_clusters: usize,
}

/// What is placed: instances of the scene and pieces.
type Content = [(u32, u32)];

/// Encodes all cells; the first chunk gets number `first_chunk`.
///
/// # Errors
/// If a cluster does not fit the format.
pub fn pack_geometry(
    scene: &Scene,
    clusters: &Clusters,
    octree: &Octree,
    levels: &Levels,
    first_chunk: u32,
) -> Result<PackedGeometry, PackError> {
    let packer = Packer { scene, clusters, levels };
    let full: Vec<&Content> = octree.cells.iter().map(|c| &c.content[..]).collect();
    let cell_name = |k: usize| format!("the cell around {}", octree.cells[k].bounds.centre());
    let cells = packer.pack(&full, first_chunk, ChunkKind::Cell, cell_name)?;
    let shared_clusters = cells.shared;

    let groups = group_levels(levels);
    let joined: Vec<Vec<(u32, u32)>> = groups
        .iter()
        .map(|g| g.members.iter().flat_map(|(c, l)| &levels.cells[*c][*l].content).copied().collect())
        .collect();
    let contents: Vec<&Content> = joined.iter().map(Vec::as_slice).collect();
    let mut chunks = cells.chunks;
    let next = first_chunk + chunks.len() as u32;
    let group_name = |k: usize| {
        let first = groups[k].members.first().map_or(0, |(cell, _)| *cell);
        format!("levels of detail from the cell around {} on", octree.cells[first].bounds.centre())
    };
    let packed = packer.pack(&contents, next, ChunkKind::Levels, group_name)?;
    chunks.extend(packed.chunks);

    let mut of_cell: Vec<Vec<CellLevel>> = vec![Vec::new(); octree.cells.len()];
    for (group, (chunk, shared)) in groups.iter().zip(packed.users) {
        let mut start = 0;
        for (cell, l) in &group.members {
            let level = &levels.cells[*cell][*l];
            let instances = start..start + level.content.len() as u32;
            start = instances.end;
            let bundles = bundles_of(&level.content, &shared);
            let Level { deviation_m, triangles, .. } = *level;
            // Groups come level by level, fine ones first.
            of_cell[*cell].push(CellLevel { deviation_m, triangles, chunk, instances, bundles });
        }
    }
    let users = octree.cells.par_iter().zip(cells.users).zip(of_cell);
    let cells = users
        .map(|((c, (chunk, shared)), levels)| {
            let (materials, texel_density) = density::materials_of(scene, clusters, c);
            let bundles = bundles_of(&c.content, &shared);
            CellEntry { bounds: c.bounds, triangles: c.triangles, chunk, bundles, materials, texel_density, levels }
        })
        .collect();
    Ok(PackedGeometry { chunks, cells, shared_clusters })
}

/// Levels of neighbouring cells that share a chunk.
#[derive(Default)]
struct LevelGroup {
    /// (cell, position in its levels).
    members: Vec<(usize, usize)>,
}

/// Levels in groups of about [`BUNDLE_BYTES`], level by level.
fn group_levels(levels: &Levels) -> Vec<LevelGroup> {
    let deepest = levels.cells.iter().map(Vec::len).max().unwrap_or(0);
    let mut groups: Vec<LevelGroup> = Vec::new();
    for l in 0..deepest {
        let mut room = 0;
        for (cell, of_cell) in levels.cells.iter().enumerate() {
            let Some(level) = of_cell.get(l) else { continue };
            let size = TRIANGLE_BYTES * level.triangles as usize;
            if size > room {
                groups.push(LevelGroup::default());
                room = BUNDLE_BYTES;
            }
            room = room.saturating_sub(size);
            if let Some(group) = groups.last_mut() {
                group.members.push((cell, l));
            }
        }
    }
    groups
}

/// The bundles that some content refers to, ascending.
fn bundles_of(content: &Content, shared: &BTreeMap<u32, ClusterRef>) -> Vec<u32> {
    let of = content.iter().filter_map(|(_, piece)| match shared.get(piece) {
        Some(ClusterRef::Shared { chunk, .. }) => Some(*chunk),
        _ => None,
    });
    of.collect::<BTreeSet<_>>().into_iter().collect()
}

/// Chunks of several contents, and what they share.
struct Packed {
    chunks: Vec<Chunk>,
    /// Per content its chunk, and where shared pieces are.
    users: Vec<(u32, Arc<BTreeMap<u32, ClusterRef>>)>,
    /// Pieces in bundles.
    shared: usize,
}

struct Packer<'a> {
    scene: &'a Scene,
    clusters: &'a Clusters,
    levels: &'a Levels,
}

impl Packer<'_> {
    /// Encodes each content as a chunk, after bundles of the pieces that several of them place.
    fn pack(
        &self,
        contents: &[&Content],
        first_chunk: u32,
        kind: ChunkKind,
        name: impl Fn(usize) -> String + Sync,
    ) -> Result<Packed, PackError> {
        let bundles = self.plan_bundles(contents);
        let shared: BTreeMap<u32, ClusterRef> = bundles
            .iter()
            .zip(first_chunk..)
            .flat_map(|(members, chunk)| {
                members.iter().zip(0..).map(move |(c, cluster)| (*c, ClusterRef::Shared { chunk, cluster }))
            })
            .collect();
        let bundle_chunks: Vec<Result<Chunk, PackError>> = bundles
            .par_iter()
            .map(|members| {
                let (clusters, steps) = self.convert(members);
                encode(ChunkKind::Bundle, CellGeometry { clusters, instances: Vec::new() }, &steps, || {
                    "a bundle of shared meshes".into()
                })
            })
            .collect();
        let own_chunks: Vec<Result<Chunk, PackError>> = contents
            .par_iter()
            .enumerate()
            .map(|(k, content)| {
                let own: Vec<u32> = content
                    .iter()
                    .map(|(_, piece)| *piece)
                    .filter(|piece| !shared.contains_key(piece))
                    .collect::<BTreeSet<_>>()
                    .into_iter()
                    .collect();
                let instances = content
                    .iter()
                    .map(|(instance, piece)| ClusterInstance {
                        cluster: shared
                            .get(piece)
                            .copied()
                            .unwrap_or_else(|| ClusterRef::Own(own.partition_point(|o| o < piece) as u32)),
                        world_from_mesh: self.scene.instances[*instance as usize].world_from_mesh,
                    })
                    .collect();
                let (clusters, steps) = self.convert(&own);
                encode(kind, CellGeometry { clusters, instances }, &steps, || name(k))
            })
            .collect();
        let (first_own, shared_pieces, shared) = (first_chunk + bundles.len() as u32, shared.len(), Arc::new(shared));
        Ok(Packed {
            chunks: bundle_chunks.into_iter().chain(own_chunks).collect::<Result<_, _>>()?,
            users: (first_own..).take(contents.len()).map(|chunk| (chunk, Arc::clone(&shared))).collect(),
            shared: shared_pieces,
        })
    }

    fn convert(&self, pieces: &[u32]) -> (Vec<Cluster>, Vec<ClusterSteps>) {
        let of = |n: &u32| {
            let piece = self.levels.piece(self.clusters, self.scene, *n);
            (wire_cluster(self.scene, &piece), cluster_steps(self.scene, &piece, &self.levels.position_steps_log2))
        };
        pieces.iter().map(of).unzip()
    }

    fn triangles(&self, piece: u32) -> usize {
        let number = piece as usize;
        match number.checked_sub(self.clusters.clusters.len()) {
            None => self.clusters.clusters[number].triangles.len(),
            Some(simplified) => self.levels.pieces[simplified].triangles.len(),
        }
    }

    /// Pieces that several contents place, in order of first use, cut into bundles.
    fn plan_bundles(&self, contents: &[&Content]) -> Vec<Vec<u32>> {
        const NONE: u32 = u32::MAX;
        let pieces = self.clusters.clusters.len() + self.levels.pieces.len();
        let mut user = vec![NONE; pieces];
        let mut is_shared = vec![false; pieces];
        for (k, content) in contents.iter().enumerate() {
            for (_, piece) in *content {
                let user = &mut user[*piece as usize];
                is_shared[*piece as usize] |= *user != NONE && *user != k as u32;
                *user = k as u32;
            }
        }
        let mut bundles: Vec<Vec<u32>> = Vec::new();
        let mut room = 0;
        for (_, piece) in contents.iter().copied().flatten() {
            if !std::mem::take(&mut is_shared[*piece as usize]) {
                continue;
            }
            let size = TRIANGLE_BYTES * self.triangles(*piece);
            if size > room {
                bundles.push(Vec::new());
                room = BUNDLE_BYTES;
            }
            room = room.saturating_sub(size);
            if let Some(b) = bundles.last_mut() {
                b.push(*piece);
            }
        }
        bundles
    }
}

fn encode(
    kind: ChunkKind,
    geometry: CellGeometry,
    steps: &[ClusterSteps],
    what: impl Fn() -> String,
) -> Result<Chunk, PackError> {
    let bytes = cell::encode(&geometry, steps, LEVEL).map_err(|source| PackError { what: what(), source })?;
    Ok(Chunk { kind, bytes, decoded_bytes: cell::decoded_bytes(&geometry) })
}

fn cluster_steps(scene: &Scene, piece: &Piece<'_>, steps: &[i8]) -> ClusterSteps {
    let material = scene.meshes[piece.mesh as usize].primitives[piece.primitive as usize].material;
    let texture = scene.materials[material as usize].texture.map(|t| &scene.textures[t as usize]);
    ClusterSteps {
        position_log2: steps[piece.mesh as usize],
        uv_log2: cell::uv_step_log2(texture.map_or(1, |t| t.width.max(t.height))),
    }
}

/// The vertices that the piece's triangles use, numbered by first use.
fn wire_cluster(scene: &Scene, piece: &Piece<'_>) -> Cluster {
    let p = &scene.meshes[piece.mesh as usize].primitives[piece.primitive as usize];
    let textured = scene.materials[p.material as usize].texture.is_some() && !p.uvs.is_empty();
    // By vertex of the primitive and normal.
    let mut number: BTreeMap<(u32, [u32; 3]), u16> = BTreeMap::new();
    let (mut order, mut normals) = (Vec::new(), Vec::new());
    let mut turned = piece.turned.iter().peekable();
    let mut triangles = Vec::with_capacity(piece.triangles.len());
    for (k, t) in (0u32..).zip(piece.triangles.iter()) {
        let mut of = [0; 3];
        for (corner, (v, of)) in (3 * k..).zip(t.iter().zip(&mut of)) {
            let normal = turned.next_if(|t| t.0 == corner).map_or(p.normals[*v as usize], |t| t.1);
            *of = *number.entry((*v, normal.to_array().map(f32::to_bits))).or_insert_with(|| {
                order.push(*v as usize);
                normals.push(normal);
                (order.len() - 1) as u16
            });
        }
        triangles.push(of);
    }
    let positions = || order.iter().map(|v| p.positions[*v].as_dvec3());
    let origin = positions().next().unwrap_or(DVec3::ZERO);
    Cluster {
        material: p.material,
        positions: positions().map(|v| (v - origin).as_vec3()).collect(),
        origin,
        normals,
        uvs: if textured { order.iter().map(|v| p.uvs[*v]).collect() } else { Vec::new() },
        colours: if p.colours.is_empty() { Vec::new() } else { order.iter().map(|v| p.colours[*v]).collect() },
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::builtin;

    #[test]
    fn every_level_decodes_to_its_pieces() {
        let scene = builtin::build("plant", Some(60_000), 1).expect("builds").scene;
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 60_000);
        let levels = Levels::build(&scene, &clusters, &octree);
        let packed = pack_geometry(&scene, &clusters, &octree, &levels, 0).expect("packs");
        let decode = |chunk: u32| cell::decode(&packed.chunks[chunk as usize].bytes).expect("decodes");
        let (mut seen, mut shared) = (0, 0);
        for (entry, of_cell) in packed.cells.iter().zip(&levels.cells) {
            assert_eq!(entry.levels.len(), of_cell.len());
            for (l, level) in entry.levels.iter().zip(of_cell) {
                assert_eq!((l.deviation_m, l.triangles), (level.deviation_m, level.triangles));
                assert_eq!(packed.chunks[l.chunk as usize].kind, ChunkKind::Levels);
                let geometry = decode(l.chunk);
                let instances = &geometry.instances[l.instances.start as usize..l.instances.end as usize];
                for (instance, (number, piece)) in instances.iter().zip(&level.content) {
                    let found = match instance.cluster {
                        ClusterRef::Own(k) => geometry.clusters[k as usize].clone(),
                        ClusterRef::Shared { chunk, cluster } => {
                            assert!(l.bundles.contains(&chunk));
                            shared += 1;
                            decode(chunk).clusters[cluster as usize].clone()
                        }
                    };
                    let piece = levels.piece(&clusters, &scene, *piece);
                    let p = &scene.meshes[piece.mesh as usize].primitives[piece.primitive as usize];
                    assert_eq!(found.triangles.len(), piece.triangles.len());
                    assert_eq!(instance.world_from_mesh, scene.instances[*number as usize].world_from_mesh);
                    for (t, wanted) in found.triangles.iter().zip(piece.triangles.iter()) {
                        for (v, wanted) in t.iter().zip(wanted) {
                            let at = found.origin + found.positions[usize::from(*v)].as_dvec3();
                            assert!(at.distance(p.positions[*wanted as usize].as_dvec3()) < 3e-4);
                        }
                    }
                    seen += 1;
                }
                assert_eq!(instances.len(), level.content.len());
            }
        }
        assert!(seen > 500 && shared > 0, "{seen} pieces, {shared} of them shared");
    }

    #[test]
    fn every_cell_decodes_to_its_source_triangles() {
        let scene = builtin::build("plant", Some(60_000), 1).expect("builds").scene;
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 6_000);
        let first = 5;
        let packed = pack_geometry(&scene, &clusters, &octree, &Levels::none(&scene, &octree), first).expect("packs");
        let decode = |chunk: u32| cell::decode(&packed.chunks[(chunk - first) as usize].bytes).expect("decodes");
        assert!(packed.shared_clusters > 0, "the plant has instances in many cells");
        for (entry, source) in packed.cells.iter().zip(&octree.cells) {
            let geometry = decode(entry.chunk);
            let got = geometry.instances.iter().flat_map(|i| {
                let c = match i.cluster {
                    ClusterRef::Own(k) => geometry.clusters[k as usize].clone(),
                    ClusterRef::Shared { chunk, cluster } => {
                        assert!(entry.bundles.contains(&chunk));
                        decode(chunk).clusters[cluster as usize].clone()
                    }
                };
                let to_world = i.world_from_mesh;
                let corner = move |v: u16| to_world.transform_point3(c.origin + c.positions[v as usize].as_dvec3());
                c.triangles.clone().into_iter().map(move |t| t.map(&corner)).collect::<Vec<_>>()
            });
            let want = source.content.iter().flat_map(|(i, k)| {
                let (i, c) = (&scene.instances[*i as usize], &clusters.clusters[*k as usize]);
                let p = &scene.meshes[c.mesh as usize].primitives[c.primitive as usize];
                c.triangles
                    .iter()
                    .map(|t| {
                        p.triangles[*t as usize]
                            .map(|v| i.world_from_mesh.transform_point3(p.positions[v as usize].as_dvec3()))
                    })
                    .collect::<Vec<_>>()
            });
            let (got, want): (Vec<_>, Vec<_>) = (got.collect(), want.collect());
            assert_eq!(got.len() as u32, entry.triangles);
            let far = got.iter().flatten().zip(want.iter().flatten()).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
            assert!(far < 3e-4, "{far} m from the source");
        }
    }
}
