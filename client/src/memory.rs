//! A dataset in memory, without a network: cells, textures and images put there by hand. For
//! calibration and for tests.

use crate::resident::Resident;
use glam::{DAffine3, DVec3, Vec3};
use ldi_protocol::{
    Aabb, OutputCamera,
    index::{BuildSettings, CellEntry, ChunkEntry, ChunkHash, ChunkKind, EVERY_LEVEL, Index, SceneInfo},
    ldi::Ldi,
    mesh::{Alpha, CellGeometry, Cluster, ClusterInstance, ClusterRef, Material, Wrap},
    texture::Texture,
    tree::Brood,
};
use std::{collections::BTreeMap, sync::Arc};

/// A dataset in memory. Everything is resident unless a test removes it.
#[derive(Default)]
pub struct Memory {
    /// By cell number.
    pub cells: BTreeMap<u32, Arc<CellGeometry>>,
    /// By chunk number.
    pub bundles: BTreeMap<u32, Arc<CellGeometry>>,
    /// By texture number.
    pub textures: BTreeMap<u32, Arc<Texture>>,
    /// By image number.
    pub ldis: BTreeMap<u32, Arc<Ldi>>,
    /// By chunk number.
    pub broods: BTreeMap<u32, Arc<Brood>>,
}

impl Resident for Memory {
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>> {
        self.cells.get(&cell).cloned()
    }
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>> {
        self.bundles.get(&chunk).cloned()
    }
    fn texture(&self, texture: u32) -> Option<Arc<Texture>> {
        self.textures.get(&texture).cloned()
    }
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>> {
        self.ldis.get(&image).cloned()
    }
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        self.broods.get(&chunk).cloned()
    }
}

/// An opaque white unlit material.
pub fn plain_material() -> Material {
    Material {
        base_colour: [1.0; 4],
        texture: None,
        alpha: Alpha::Opaque,
        unlit: true,
        double_sided: true,
        wrap: [Wrap::Repeat; 2],
    }
}

/// A cluster of loose triangles, upward normals.
pub fn loose_cluster(material: u32, triangles: &[[Vec3; 3]]) -> Cluster {
    Cluster {
        material,
        positions: triangles.iter().flatten().copied().collect(),
        origin: DVec3::ZERO,
        normals: vec![Vec3::Y; triangles.len() * 3],
        uvs: Vec::new(),
        colours: Vec::new(),
        triangles: (0..triangles.len() as u16).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    }
}

/// A dataset with one cell per cluster, each placed once where it stands.
pub fn dataset(camera: OutputCamera, materials: Vec<Material>, clusters: Vec<Cluster>) -> (Index, Memory) {
    let mut memory = Memory::default();
    let (mut cells, mut chunks, mut bounds, mut triangles) = (Vec::new(), Vec::new(), Aabb::EMPTY, 0);
    for (i, cluster) in clusters.into_iter().enumerate() {
        let b = Aabb::from_points(cluster.positions.iter().map(|p| cluster.origin + p.as_dvec3()));
        bounds = bounds.union(b);
        triangles += cluster.triangles.len() as u64;
        cells.push(CellEntry {
            bounds: b,
            triangles: cluster.triangles.len() as u32,
            chunk: i as u32,
            bundles: Vec::new(),
            materials: vec![cluster.material],
            texel_density: vec![EVERY_LEVEL],
            levels: Vec::new(),
        });
        chunks.push(ChunkEntry {
            hash: ChunkHash([i as u8; 32]),
            stored_bytes: 1,
            decoded_bytes: 1,
            kind: ChunkKind::Cell,
        });
        let instances = vec![ClusterInstance { cluster: ClusterRef::Own(0), world_from_mesh: DAffine3::IDENTITY }];
        memory.cells.insert(i as u32, Arc::new(CellGeometry { clusters: vec![cluster], instances }));
    }
    let index = Index {
        scene: SceneInfo {
            name: "in memory".into(),
            triangles,
            unique_triangles: triangles,
            instances: cells.len() as u64,
            bounds,
        },
        settings: BuildSettings {
            budget: 1 << 30,
            optimize_budget: 1 << 29,
            camera,
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "high".into(),
            grid: "paper".into(),
            eye_height_m: None,
        },
        chunks,
        cells,
        materials,
        textures: Vec::new(),
        pitch_bands_deg: Vec::new(),
        volume: None,
        tree: None,
        rooms: None,
        plans: Vec::new(),
        points: Vec::new(),
        placements: Vec::new(),
        images: Vec::new(),
    };
    (index, memory)
}
