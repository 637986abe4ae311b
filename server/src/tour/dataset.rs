//! What stands in a dataset's walk volume: its near geometry as a scene for rays.
//!
//! In: a dataset. Out: its cells in full detail without textures, as far as a tour may get from the
//! middle of the walk volume, and that part of the volume.

use super::TourError;
use crate::{
    scene::{Instance, Mesh, Primitive, Scene},
    store::Dataset,
};
use glam::{DAffine3, DVec3};
use ldi_protocol::{
    Aabb,
    codec::cell,
    mesh::{Alpha, Cluster, ClusterRef, Material},
    stroll::Random,
    volume::WalkVolume,
};
use std::collections::{BTreeMap, BTreeSet};

/// Places of the volume of which the one amid them is where a tour is made.
const SAMPLES: usize = 101;
/// Geometry is read this much farther than a tour gets, metres: views end there.
const BEYOND_M: f64 = 40.0;

/// Geometry and walk volume of a dataset within `reach_m` of a place amid the volume.
///
/// # Errors
/// If there is no walk volume, or a chunk is damaged.
pub fn near_geometry(dataset: &Dataset, reach_m: f64, seed: u64) -> Result<(Scene, WalkVolume), TourError> {
    let index = dataset.index();
    let volume = index.volume.as_ref().ok_or(TourError::NoVolume)?;
    let middle = amid(volume, seed).ok_or(TourError::Nowhere)?;
    let around = |m: f64| Aabb { min: middle, max: middle }.inflated(m);
    let (within, seen) = (around(reach_m), around(reach_m + BEYOND_M));
    let boxes: Vec<bool> = volume.boxes().map(|b| within.contains(b.centre())).collect();
    // A volume to fly in is one box.
    let is_cut = boxes.iter().any(|inside| *inside);
    let volume = if is_cut { volume.only(|b| boxes[b]) } else { volume.clone() };

    let cells: Vec<usize> = (0..index.cells.len()).filter(|c| index.cells[*c].bounds.intersects(&seen)).collect();
    let used: BTreeSet<u32> =
        cells.iter().flat_map(|c| index.cells[*c].bundles.iter().copied().chain([index.cells[*c].chunk])).collect();
    let mut scene = Scene { name: index.scene.name.clone(), ..Scene::default() };
    scene.materials =
        index.materials.iter().map(|m| Material { texture: None, alpha: Alpha::Opaque, ..m.clone() }).collect();
    // Leaves and fences can be walked through, as in the window, unless everything is masked.
    let is_masked = |m: u32| index.materials.get(m as usize).is_some_and(|m| m.alpha != Alpha::Opaque);
    let all_masked = (0..index.materials.len() as u32).all(is_masked);
    // Number of the mesh, and the origin of its positions.
    let mut mesh_of: BTreeMap<(u32, u32), (u32, DVec3)> = BTreeMap::new();
    let mut placed = Vec::new();
    for chunk in used {
        let geometry = cell::decode(&dataset.chunk(chunk)?).map_err(|source| TourError::Chunk { chunk, source })?;
        for (cluster, number) in geometry.clusters.iter().zip(0..) {
            if all_masked || !is_masked(cluster.material) {
                mesh_of.insert((chunk, number), (scene.meshes.len() as u32, cluster.origin));
                scene.meshes.push(mesh(cluster));
            }
        }
        placed.extend(geometry.instances.into_iter().map(|instance| (chunk, instance)));
    }
    for (chunk, instance) in placed {
        let name = match instance.cluster {
            ClusterRef::Own(cluster) => (chunk, cluster),
            ClusterRef::Shared { chunk, cluster } => (chunk, cluster),
        };
        let Some(&(mesh, origin)) = mesh_of.get(&name) else { continue };
        let node = scene.instances.len() as u32;
        let world_from_mesh = instance.world_from_mesh * DAffine3::from_translation(origin);
        scene.instances.push(Instance { node, mesh, world_from_mesh });
    }
    Ok((scene, volume))
}

/// A place of the volume in the middle of all others.
fn amid(volume: &WalkVolume, seed: u64) -> Option<DVec3> {
    let sampler = volume.sampler();
    let mut random = Random::new(seed, 1);
    let mut one = || sampler.point([random.uniform(), random.uniform(), random.uniform(), random.uniform()]);
    let places: Vec<DVec3> = (0..SAMPLES).map_while(|_| one()).collect();
    let median = |axis: usize| {
        let mut values: Vec<f64> = places.iter().map(|p| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied()
    };
    let middle = DVec3::new(median(0)?, median(1)?, median(2)?);
    places.into_iter().min_by(|a, b| a.distance(middle).total_cmp(&b.distance(middle)))
}

/// A cluster as a mesh, relative to its origin.
fn mesh(cluster: &Cluster) -> Mesh {
    let primitive = Primitive {
        material: cluster.material,
        positions: cluster.positions.clone(),
        normals: cluster.normals.clone(),
        triangles: cluster.triangles.iter().map(|t| t.map(u32::from)).collect(),
        ..Primitive::default()
    };
    Mesh { name: String::new(), primitives: vec![primitive] }
}
