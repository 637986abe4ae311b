//! Clusters of the scene as clusters of the wire, shared or not, and the cells that place them.

use super::{Chunk, PackError, density};
use crate::octree::{Clusters, Octree, SourceCluster};
use crate::scene::Scene;
use glam::DVec3;
use ldi_protocol::Aabb;
use ldi_protocol::codec::cell::{self, ClusterSteps};
use ldi_protocol::index::{CellEntry, ChunkKind};
use ldi_protocol::mesh::{CellGeometry, Cluster, ClusterInstance, ClusterRef};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Raw size at which a bundle is closed: a few milliseconds of a slow link. Larger bundles make
/// cells fetch clusters they do not draw; smaller ones make a chunk, and a stream, of every few
/// clusters.
const BUNDLE_BYTES: usize = 32 << 10;

/// zstd level of geometry chunks: they are small, and compressed once.
const LEVEL: i32 = 12;

/// Near geometry as chunks.
#[derive(Debug, Clone)]
pub struct PackedGeometry {
    /// Bundles, then one chunk per cell; chunk numbers count from `first_chunk`.
    pub chunks: Vec<Chunk>,
    /// Entries of the cells, in the octree's order.
    pub cells: Vec<CellEntry>,
    /// Clusters that are stored once and drawn from several cells.
    pub shared_clusters: usize,
}

/// Encodes all cells; the first chunk gets number `first_chunk`.
///
/// # Errors
/// If a cluster does not fit the format.
pub fn pack_geometry(
    scene: &Scene,
    clusters: &Clusters,
    octree: &Octree,
    first_chunk: u32,
) -> Result<PackedGeometry, PackError> {
    let steps = mesh_steps(scene);
    let bundles = plan_bundles(clusters, octree);
    let shared: BTreeMap<u32, ClusterRef> = bundles
        .iter()
        .zip(first_chunk..)
        .flat_map(|(members, chunk)| {
            members.iter().zip(0..).map(move |(c, cluster)| (*c, ClusterRef::Shared { chunk, cluster }))
        })
        .collect();
    let convert = |numbers: &[u32]| -> (Vec<Cluster>, Vec<ClusterSteps>) {
        numbers
            .iter()
            .map(|n| {
                let source = &clusters.clusters[*n as usize];
                (wire_cluster(scene, source), cluster_steps(scene, source, &steps))
            })
            .unzip()
    };
    let bundle_chunks: Vec<Result<Chunk, PackError>> = bundles
        .par_iter()
        .map(|members| {
            let (clusters, steps) = convert(members);
            encode(ChunkKind::Bundle, CellGeometry { clusters, instances: Vec::new() }, &steps, || {
                "a bundle of shared meshes".into()
            })
        })
        .collect();
    let cell_chunks: Vec<Result<Chunk, PackError>> = octree
        .cells
        .par_iter()
        .map(|c| {
            let own: Vec<u32> = c
                .content
                .iter()
                .map(|(_, k)| *k)
                .filter(|k| !shared.contains_key(k))
                .collect::<BTreeSet<_>>()
                .into_iter()
                .collect();
            let instances = c
                .content
                .iter()
                .map(|(instance, k)| ClusterInstance {
                    cluster: shared
                        .get(k)
                        .copied()
                        .unwrap_or_else(|| ClusterRef::Own(own.partition_point(|o| o < k) as u32)),
                    world_from_mesh: scene.instances[*instance as usize].world_from_mesh,
                })
                .collect();
            let name = || format!("the cell around {}", c.bounds.centre());
            let (clusters, steps) = convert(&own);
            encode(ChunkKind::Cell, CellGeometry { clusters, instances }, &steps, name)
        })
        .collect();
    let cells = octree
        .cells
        .par_iter()
        .zip(first_chunk + bundles.len() as u32..first_chunk + (bundles.len() + octree.cells.len()) as u32)
        .map(|(c, chunk)| {
            let in_bundles = c.content.iter().filter_map(|(_, k)| match shared.get(k) {
                Some(ClusterRef::Shared { chunk, .. }) => Some(*chunk),
                _ => None,
            });
            let bundles = in_bundles.collect::<BTreeSet<_>>().into_iter().collect();
            let (materials, texel_density) = density::materials_of(scene, clusters, c);
            CellEntry { bounds: c.bounds, triangles: c.triangles, chunk, bundles, materials, texel_density }
        })
        .collect();
    let chunks = bundle_chunks.into_iter().chain(cell_chunks).collect::<Result<_, _>>()?;
    Ok(PackedGeometry { chunks, cells, shared_clusters: shared.len() })
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

/// Clusters that several cells draw, in order of first use, cut into bundles.
fn plan_bundles(clusters: &Clusters, octree: &Octree) -> Vec<Vec<u32>> {
    const NONE: u32 = u32::MAX;
    let mut user = vec![NONE; clusters.clusters.len()];
    let mut is_shared = vec![false; clusters.clusters.len()];
    for (cell, c) in octree.cells.iter().enumerate() {
        for (_, k) in &c.content {
            let user = &mut user[*k as usize];
            is_shared[*k as usize] |= *user != NONE && *user != cell as u32;
            *user = cell as u32;
        }
    }
    let mut bundles: Vec<Vec<u32>> = Vec::new();
    let mut room = 0;
    for c in &octree.cells {
        for (_, k) in &c.content {
            if !std::mem::take(&mut is_shared[*k as usize]) {
                continue;
            }
            // About 20 bytes per triangle before compression: half a vertex and three indices.
            let size = 20 * clusters.clusters[*k as usize].triangles.len();
            if size > room {
                bundles.push(Vec::new());
                room = BUNDLE_BYTES;
            }
            room = room.saturating_sub(size);
            if let Some(b) = bundles.last_mut() {
                b.push(*k);
            }
        }
    }
    bundles
}

fn material(scene: &Scene, c: &SourceCluster) -> u32 {
    scene.meshes[c.mesh as usize].primitives[c.primitive as usize].material
}

/// Position step per mesh: the same for all its clusters, so that neighbours meet without cracks.
fn mesh_steps(scene: &Scene) -> Vec<i8> {
    let mut scale = vec![0.0f64; scene.meshes.len()];
    for i in &scene.instances {
        let m = &i.world_from_mesh.matrix3;
        let s = m.x_axis.length().max(m.y_axis.length()).max(m.z_axis.length());
        scale[i.mesh as usize] = scale[i.mesh as usize].max(s);
    }
    scene
        .meshes
        .iter()
        .zip(scale)
        .map(|(m, s)| {
            let bounds = Aabb::from_points(m.primitives.iter().flat_map(|p| &p.positions).map(|p| p.as_dvec3()));
            cell::position_step_log2(if bounds.is_empty() { 0.0 } else { bounds.size().max_element() }, s)
        })
        .collect()
}

fn cluster_steps(scene: &Scene, c: &SourceCluster, steps: &[i8]) -> ClusterSteps {
    let texture = scene.materials[material(scene, c) as usize].texture.map(|t| &scene.textures[t as usize]);
    ClusterSteps {
        position_log2: steps[c.mesh as usize],
        uv_log2: cell::uv_step_log2(texture.map_or(1, |t| t.width.max(t.height))),
    }
}

/// The vertices that the cluster's triangles use, numbered by first use.
fn wire_cluster(scene: &Scene, c: &SourceCluster) -> Cluster {
    let p = &scene.meshes[c.mesh as usize].primitives[c.primitive as usize];
    let textured = scene.materials[p.material as usize].texture.is_some() && !p.uvs.is_empty();
    let mut number: BTreeMap<u32, u16> = BTreeMap::new();
    let mut order = Vec::new();
    let triangles = c
        .triangles
        .iter()
        .map(|t| {
            p.triangles[*t as usize].map(|v| {
                *number.entry(v).or_insert_with(|| {
                    order.push(v as usize);
                    (order.len() - 1) as u16
                })
            })
        })
        .collect();
    let positions = || order.iter().map(|v| p.positions[*v].as_dvec3());
    let origin = positions().next().unwrap_or(DVec3::ZERO);
    Cluster {
        material: p.material,
        positions: positions().map(|v| (v - origin).as_vec3()).collect(),
        origin,
        normals: order.iter().map(|v| p.normals[*v]).collect(),
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
    fn every_cell_decodes_to_its_source_triangles() {
        let scene = builtin::build("plant", Some(60_000), 1).expect("builds").scene;
        let clusters = Clusters::build(&scene);
        let octree = Octree::build(&scene, &clusters, 6_000);
        let first = 5;
        let packed = pack_geometry(&scene, &clusters, &octree, first).expect("packs");
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
