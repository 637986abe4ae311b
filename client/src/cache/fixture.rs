//! A small dataset in memory with one of everything, for tests here and end to end: a street of
//! cells along -Z, a textured material, a bundle that every second cell shares, and one LDI that
//! stands for the farther half.

use glam::{DAffine3, DVec3, Vec2, Vec3};
use ldi_protocol::{
    Aabb, OutputCamera, ViewBasis,
    codec::{self, ColourMode, cell::ClusterSteps, texture::TextureLevels},
    index::*,
    ldi::{DisparityCodes, Ldi, LdiCamera, LdiLayer, Segment},
    mesh::{Alpha, CellGeometry, Cluster, ClusterInstance, ClusterRef, Material, Wrap},
    texture::{MipLevel, Texture},
    tree::{Brood, NodeSamples, Tree, TreeNode, TreeSample, WHOLE},
};

/// Index and stored chunks.
pub struct Street {
    pub index: Index,
    pub chunks: Vec<Vec<u8>>,
}

/// The bundle that odd cells share.
pub const BUNDLE: u32 = 0;
/// Coarse and fine levels of the texture.
pub const TEXTURE: [u32; 2] = [1, 2];
/// First and deeper layers of the LDI.
pub const LDI: [u32; 2] = [3, 4];
/// The first cell's chunk; the others follow.
pub const FIRST_CELL: u32 = 5;
/// Cells are this far apart, metres.
pub const STEP_M: f64 = 10.0;

/// A street of `cells` cells; the LDI has `side * side` pixels of noise, which do not compress.
pub fn street(cells: u32, side: u32) -> Street {
    let mut street = Builder::default();
    let steps = [ClusterSteps { position_log2: -14, uv_log2: -8 }];
    let shared = CellGeometry { clusters: vec![quad(0.5)], instances: vec![] };
    street.add(
        ChunkKind::Bundle,
        codec::cell::encode(&shared, &steps, 1).unwrap(),
        codec::cell::decoded_bytes(&shared),
    );
    street.add_texture(128);
    street.add_ldi(side);
    let mut entries = Vec::new();
    for i in 0..cells {
        let own = ClusterInstance { cluster: ClusterRef::Own(0), world_from_mesh: at(i) };
        let mut instances = vec![own];
        if i % 2 == 1 {
            instances.push(ClusterInstance {
                cluster: ClusterRef::Shared { chunk: BUNDLE, cluster: 0 },
                world_from_mesh: at(i),
            });
        }
        let geometry = CellGeometry { clusters: vec![quad(0.25 + 0.5 * i as f32 / cells as f32)], instances };
        let bytes = codec::cell::encode(&geometry, &steps, 1).unwrap();
        let chunk = street.add(ChunkKind::Cell, bytes, codec::cell::decoded_bytes(&geometry));
        let z = -STEP_M * f64::from(i + 1);
        entries.push(CellEntry {
            bounds: Aabb { min: DVec3::new(-1.0, -1.0, z), max: DVec3::new(1.0, 1.0, z) },
            triangles: 2 + 2 * (i % 2),
            chunk,
            bundles: if i % 2 == 1 { vec![BUNDLE] } else { vec![] },
            materials: vec![0],
            texel_density: vec![0],
            levels: Vec::new(),
        });
    }
    let bounds = entries.iter().fold(Aabb::EMPTY, |b, c: &CellEntry| b.union(c.bounds));
    let triangles = entries.iter().map(|c| u64::from(c.triangles)).sum();
    let camera = OutputCamera { width: 64, height: 36, fov_deg: 60.0 };
    let index = Index {
        scene: SceneInfo {
            name: "street".into(),
            triangles,
            unique_triangles: triangles,
            instances: u64::from(cells),
            bounds,
        },
        settings: BuildSettings {
            budget: triangles,
            optimize_budget: triangles,
            camera,
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "lossless".into(),
            grid: "paper".into(),
            eye_height_m: None,
        },
        chunks: street.entries,
        cells: entries,
        materials: vec![Material {
            base_colour: [1.0; 4],
            texture: Some(0),
            alpha: Alpha::Opaque,
            unlit: false,
            double_sided: true,
            wrap: [Wrap::Repeat; 2],
        }],
        textures: vec![TextureEntry {
            width: 128,
            height: 128,
            chunks: vec![
                TextureChunk { chunk: TEXTURE[0], first_level: 1, last_level: 7 },
                TextureChunk { chunk: TEXTURE[1], first_level: 0, last_level: 0 },
            ],
        }],
        pitch_bands_deg: vec![-60.0, 60.0],
        points: vec![GridPoint {
            position: DVec3::new(0.0, 0.0, 5.0),
            level: 0,
            radius: 10.0,
            // Looking along -Z only: to the sides and back there is nothing to replace.
            bands: vec![vec![
                AngularRange { yaw_start_deg: 45.0, placement: None },
                AngularRange { yaw_start_deg: 315.0, placement: Some(0) },
            ]],
        }],
        placements: vec![Placement {
            grid_point: Some(0),
            cop: DVec3::new(0.0, 0.0, 5.0),
            culled: (cells / 2..cells).collect(),
            footprint_px: 1.0,
            users: Aabb { min: DVec3::new(-1.0, -1.0, -5.0), max: DVec3::new(1.0, 1.0, 6.0) },
            images: 0..1,
            sky: Default::default(),
        }],
        images: vec![ImageEntry {
            basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
            plane_distance: 10.0,
            window: [-1.0, 1.0, -1.0, 1.0],
            stretch_p99_px: 1.0,
            chunks: LDI.to_vec(),
            samples_by_layer: vec![side * side, side],
        }],
        volume: None,
        tree: None,
        rooms: None,
        plans: Vec::new(),
    };
    Street { index, chunks: street.chunks }
}

impl Street {
    /// With an LDI tree of one sample: the root's chunk, pinned, and the last of the dataset.
    pub fn with_tree(mut self) -> Self {
        let sample = TreeSample {
            face: 5,
            column: 3,
            row: 4,
            covers: WHOLE,
            depth: 9,
            slope: [0; 2],
            rgb: [200, 100, 50],
            filtered: false,
        };
        let brood = Brood { nodes: vec![NodeSamples { samples: vec![sample] }] };
        let mut builder = Builder { entries: self.index.chunks, chunks: self.chunks };
        let bytes = codec::tree::encode(&brood, 1).unwrap();
        let root_chunk = builder.add(ChunkKind::Tree, bytes, brood.decoded_bytes());
        (self.index.chunks, self.chunks) = (builder.entries, builder.chunks);
        let root =
            TreeNode { level: 0, cell: [0; 3], samples: 1, unfiltered: 1, first_child: 0, children: 0, chunk: 0 };
        let (origin, edge_m) = (DVec3::splat(-64.0), 128.0);
        self.index.tree = Some(Tree { origin, edge_m, root_chunk, pinned_levels: 1, nodes: vec![root] });
        self
    }
}

#[derive(Default)]
struct Builder {
    entries: Vec<ChunkEntry>,
    chunks: Vec<Vec<u8>>,
}

impl Builder {
    fn add(&mut self, kind: ChunkKind, bytes: Vec<u8>, decoded: usize) -> u32 {
        let hash = ChunkHash(*blake3::hash(&bytes).as_bytes());
        self.entries.push(ChunkEntry { hash, stored_bytes: bytes.len() as u32, decoded_bytes: decoded as u32, kind });
        self.chunks.push(bytes);
        self.chunks.len() as u32 - 1
    }

    fn add_texture(&mut self, side: u32) {
        let mut noise = noise();
        let rgba = (0..side * side).map(|_| [noise(), noise(), noise(), 255]).collect();
        let mut levels: Vec<MipLevel> = Texture::from_base(MipLevel { width: side, height: side, rgba }, false)
            .levels
            .into_iter()
            .flatten()
            .collect();
        let coarse = levels.split_off(1);
        for (first_level, levels) in [(1, coarse), (0, levels)] {
            let t = TextureLevels { width: side, height: side, first_level, levels };
            let bytes = codec::texture::encode(&t, ColourMode::LOSSLESS, 1).unwrap();
            self.add(ChunkKind::Texture, bytes, codec::texture::decoded_bytes(&t));
        }
    }

    fn add_ldi(&mut self, side: u32) {
        let ldi = noise_image(side);
        let [first, deeper] = codec::ldi::decoded_bytes(&ldi);
        self.add(ChunkKind::Ldi, codec::ldi::encode_first(&ldi, ColourMode::LOSSLESS, 1).unwrap(), first);
        self.add(ChunkKind::Ldi, codec::ldi::encode_deeper(&ldi, ColourMode::LOSSLESS, 1).unwrap().unwrap(), deeper);
    }
}

/// A full first layer, and one column of a second.
fn noise_image(side: u32) -> Ldi {
    let mut noise = noise();
    let mut layer = |columns: u32, code: u16| {
        let mut l = LdiLayer::default();
        for row in 0..side {
            for base in (0..columns).step_by(256) {
                let count = (columns - base).min(256);
                let first = l.column.len() as u32;
                l.segments.push(Segment { row: row as u16, column_base: base as u16, first, count: count as u16 });
                l.column.extend((0..count).map(|c| c as u8));
            }
        }
        let n = l.column.len();
        l.disparity = vec![code; n];
        l.rgb = (0..n).map(|_| [noise(), noise(), noise()]).collect();
        l.links = vec![0; n];
        l.with_half_ends()
    };
    let layers = vec![layer(side, 200), layer(1, 100)];
    let camera = LdiCamera {
        cop: DVec3::new(0.0, 0.0, 5.0),
        basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
        pixels_per_unit: f64::from(side),
        left: -(side as i32) / 2,
        top: -(side as i32) / 2,
        width: side,
        height: side,
    };
    let sky = vec![0; side as usize * (side as usize).div_ceil(64)];
    let codes = DisparityCodes { smallest: 0.001, step: 0.001, largest_code: 300 };
    Ldi { camera, codes, layers, sky, slivers: vec![] }
}

fn at(cell: u32) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(0.0, 0.0, -STEP_M * f64::from(cell + 1)))
}

/// A square of this half side in the plane z = 0.
fn quad(half: f32) -> Cluster {
    let corner = |x: f32, y: f32| Vec3::new(x * half, y * half, 0.0);
    Cluster {
        material: 0,
        positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        origin: DVec3::ZERO,
        normals: vec![Vec3::Z; 4],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        colours: vec![],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

/// Bytes of a linear congruential generator (Knuth's constants): the same on every run.
fn noise() -> impl FnMut() -> u8 {
    let mut state = 1u64;
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    }
}
