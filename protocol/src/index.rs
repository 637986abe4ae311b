//! What a dataset holds, decoded from its manifest and pages: chunks, cells, grid points,
//! placements, materials.
//!
//! Numbers that name things (`u32`) are positions in the vectors of [`Index`].

use crate::{
    Aabb, CellRuns, OutputCamera, ViewBasis, floor_plan::FloorPlan, mesh::Material, room_index::RoomIndex, sky::SkyMap,
    tree::Tree, volume::WalkVolume,
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// A chunk's name: BLAKE3 of its stored bytes.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ChunkHash(pub [u8; 32]);

impl std::fmt::Display for ChunkHash {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}
impl std::fmt::Debug for ChunkHash {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{self}")
    }
}

/// What a chunk holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ChunkKind {
    /// A page of the manifest.
    Page,
    /// A cell: own clusters and instances.
    Cell,
    /// Clusters that several cells share.
    Bundle,
    /// What neighbouring cells draw at a level of detail.
    Levels,
    /// Layers of an LDI.
    Ldi,
    /// Mip levels of a texture.
    Texture,
    /// Nodes of the LDI tree.
    Tree,
}

/// A chunk as the dataset stores and sends it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChunkEntry {
    /// Its name.
    pub hash: ChunkHash,
    /// Stored (compressed) bytes.
    pub stored_bytes: u32,
    /// Bytes in memory once decoded, for the cache's accounts.
    pub decoded_bytes: u32,
    /// What it holds.
    pub kind: ChunkKind,
}

/// Value of `BuildSettings::grid` for view cells: the closest grid point counts, wherever it lies.
/// Any other value: the paper's scheme, the closest one in the reverse frustum.
pub const CELLS: &str = "cells";

/// The settings of a build that both ends need.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BuildSettings {
    /// Geometry budget P, triangles per frame.
    pub budget: u64,
    /// Optimization budget Popt.
    pub optimize_budget: u64,
    /// The picture the dataset is made for.
    pub camera: OutputCamera,
    /// Largest sample footprint, output pixels.
    pub max_footprint_px: f64,
    /// Farthest that near geometry may lie from where it is, output pixels; 0: there are no levels
    /// of detail.
    pub max_deviation_px: f64,
    /// Free look up and down, degrees.
    pub pitch_deg: f64,
    /// LDI samples per output pixel pitch.
    pub density: f64,
    /// `lossless`, `high` or `compact`.
    pub colour: String,
    /// `paper` or `cells`.
    pub grid: String,
    /// Eye height above the floor, or None for the whole box (`--fly`).
    pub eye_height_m: Option<f64>,
}

impl BuildSettings {
    /// Half tangent of the square planning frustum: the larger field of view both ways.
    pub fn square_half_tan(&self) -> f64 {
        self.camera.half_tan_x().max(self.camera.half_tan_y())
    }

    /// Farthest that geometry may lie from where it is, metres per metre between it and the eye.
    pub fn deviation_per_metre(&self) -> f64 {
        self.max_deviation_px / self.camera.displacement_px(1.0, 1.0)
    }
}

/// What is known of the source scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneInfo {
    /// File or built-in name.
    pub name: String,
    /// Triangles, every instance counted.
    pub triangles: u64,
    /// Triangles, each mesh counted once.
    pub unique_triangles: u64,
    /// Mesh instances.
    pub instances: u64,
    /// World bounds.
    pub bounds: Aabb,
}

/// A cell of the octree that holds clusters: the unit of culling and of near geometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellEntry {
    /// Tight world bounds of everything it draws.
    pub bounds: Aabb,
    /// Triangles it draws.
    pub triangles: u32,
    /// Its chunk.
    pub chunk: u32,
    /// The bundles it refers to, ascending.
    pub bundles: Vec<u32>,
    /// The materials it uses, ascending.
    pub materials: Vec<u32>,
    /// For each of them, how many texels of its texture lie along a metre of what the cell draws
    /// with it, where they are fewest: four times the binary logarithm, rounded down, of the root
    /// mean square over directions. [`EVERY_LEVEL`] where all levels of the texture count at any
    /// distance.
    pub texel_density: Vec<i8>,
    /// Coarser meshes of what it draws, at most [`MOST_LEVELS`]: fewer triangles and larger
    /// deviations each time.
    pub levels: Vec<CellLevel>,
}

/// Most coarser meshes of a cell.
pub const MOST_LEVELS: usize = 32;

/// A coarser mesh of what a cell draws.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellLevel {
    /// No point of it lies farther from the cell's surfaces, nor they from it, metres; an f32.
    pub deviation_m: f64,
    /// Triangles.
    pub triangles: u32,
    /// Its chunk, of kind [`ChunkKind::Levels`].
    pub chunk: u32,
    /// Which of the chunk's instances are this cell's.
    pub instances: Range<u32>,
    /// The bundles that they refer to, ascending.
    pub bundles: Vec<u32>,
}

/// A cell at a level of detail: what a view draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct DrawnCell {
    /// Position in [`Index::cells`].
    pub cell: u32,
    /// 0: in full; k: [`CellEntry::levels`]`[k - 1]`.
    pub level: u8,
}

impl DrawnCell {
    /// The cell in full.
    pub const fn full(cell: u32) -> Self {
        Self { cell, level: 0 }
    }

    /// Several cells in full.
    pub fn all_full(cells: impl IntoIterator<Item = u32>) -> Vec<Self> {
        cells.into_iter().map(Self::full).collect()
    }
}

/// Where the geometry of a cell at a level is, and how much it is.
#[derive(Debug, Clone, PartialEq)]
pub struct CellMesh<'a> {
    /// Its chunk.
    pub chunk: u32,
    /// Which of the chunk's instances; None: all.
    pub instances: Option<Range<u32>>,
    /// The bundles that they refer to.
    pub bundles: &'a [u32],
    /// Triangles.
    pub triangles: u32,
    /// Deviation, metres; 0 in full.
    pub deviation_m: f64,
}

impl CellEntry {
    /// The coarsest level whose deviation is at most this, metres.
    pub fn level_within(&self, deviation_m: f64) -> u8 {
        self.levels.partition_point(|l| l.deviation_m <= deviation_m) as u8
    }

    /// Triangles at a level; 0 where there is no such level.
    pub fn triangles_at(&self, level: u8) -> u32 {
        self.mesh(level).map_or(0, |m| m.triangles)
    }

    /// The geometry at a level.
    pub fn mesh(&self, level: u8) -> Option<CellMesh<'_>> {
        let Some(coarser) = level.checked_sub(1) else {
            return Some(CellMesh {
                chunk: self.chunk,
                instances: None,
                bundles: &self.bundles,
                triangles: self.triangles,
                deviation_m: 0.0,
            });
        };
        self.levels.get(usize::from(coarser)).map(|l| CellMesh {
            chunk: l.chunk,
            instances: Some(l.instances.clone()),
            bundles: &l.bundles,
            triangles: l.triangles,
            deviation_m: l.deviation_m,
        })
    }
}

/// See [`CellEntry::texel_density`]: of alpha masks, whose finest level decides at any distance,
/// and of coordinates that do not move.
pub const EVERY_LEVEL: i8 = i8::MIN;

/// One entry of a grid point's list for a pitch band: from `yaw_start_deg` on (to the next entry's
/// start, the last one to the first's, around the circle), use `placement`, or draw everything
/// when it is None.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AngularRange {
    /// In [0, 360), ascending within the band.
    pub yaw_start_deg: f64,
    /// Position in [`Index::placements`].
    pub placement: Option<u32>,
}

/// A grid point.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridPoint {
    /// World position.
    pub position: DVec3,
    /// 0 for the initial grid; odd and even levels follow different subdivision rules.
    pub level: u8,
    /// Certified: no eye of the walk volume farther than this selects the point, metres.
    pub radius: f64,
    /// Per pitch band of [`Index::pitch_bands_deg`]; an empty list means: nothing culled in any
    /// direction.
    pub bands: Vec<Vec<AngularRange>>,
}

/// An image placement: a subset of the cells, replaced by LDIs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Placement {
    /// The grid point it was solved at, or the first that uses it; None for one of a portal
    /// ([`RoomIndex::placements`]).
    pub grid_point: Option<u32>,
    /// Centre of projection of all its images, metres.
    pub cop: DVec3,
    /// Cells that are not drawn. Each lies wholly beyond the plane of one of the
    /// images. Empty for a portal's: there it is all that is seen through the portal but the cells
    /// of the room before it.
    pub culled: CellRuns,
    /// Bound on the footprint of any sample from any eye that may use it, output pixels.
    pub footprint_px: f64,
    /// Box of all eyes that may use it. They lie before the planes of all images.
    pub users: Aabb,
    /// Its images, as positions in [`Index::images`]; those of one placement follow those of the
    /// one before.
    pub images: Range<u32>,
    /// Where its eyes see sky, roughly: images know it by the pixel, but not all directions.
    pub sky: SkyMap,
}

/// An image: a window of a plane as seen from its placement's centre of projection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImageEntry {
    /// Orientation of the image plane.
    pub basis: ViewBasis,
    /// Distance from the centre of projection to the plane along `basis.forward`, metres. No
    /// sample lies nearer.
    pub plane_distance: f64,
    /// Tangents of the window that it stands for: left, right (along `basis.right`), bottom, top
    /// (along `basis.up`). The LDI may be smaller: it is cut to what eyes see. Windows of one
    /// placement may overlap: what lies beyond several planes is in one of the images.
    pub window: [f64; 4],
    /// 99th percentile of the stretch along surface tangents over samples and sampled eyes, output
    /// pixels; NaN if unknown.
    pub stretch_p99_px: f64,
    /// Chunks of the LDI: the first layer, then deeper ones. Empty: nothing of the subset can be
    /// seen in it.
    pub chunks: Vec<u32>,
    /// Samples per layer.
    pub samples_by_layer: Vec<u32>,
}

/// A texture: its size and its chunks, each a range of mip levels, coarse mips first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TextureEntry {
    /// Columns of level 0.
    pub width: u32,
    /// Rows of level 0.
    pub height: u32,
    /// Chunks in the order of sending.
    pub chunks: Vec<TextureChunk>,
}

/// A chunk with mip levels `first_level ..= last_level` of a texture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TextureChunk {
    /// Position in [`Index::chunks`].
    pub chunk: u32,
    /// Finest level in it.
    pub first_level: u8,
    /// Coarsest level in it.
    pub last_level: u8,
}

/// Everything both ends know about a dataset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Index {
    /// The source.
    pub scene: SceneInfo,
    /// How it was built.
    pub settings: BuildSettings,
    /// All chunks but pages.
    pub chunks: Vec<ChunkEntry>,
    /// Cells that hold clusters.
    pub cells: Vec<CellEntry>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Textures.
    pub textures: Vec<TextureEntry>,
    /// Borders of the pitch bands, degrees, ascending: band i spans borders i and i + 1. Empty
    /// without grid points.
    pub pitch_bands_deg: Vec<f64>,
    /// Grid points. Empty when the whole scene is within the budget from everywhere.
    pub points: Vec<GridPoint>,
    /// Placements of all grid points.
    pub placements: Vec<Placement>,
    /// Images of all placements.
    pub images: Vec<ImageEntry>,
    /// Where eyes may be: what every promise is made for. None in a dataset that promises nothing
    /// of the kind (tests).
    pub volume: Option<WalkVolume>,
    /// The base layer: what stands in for whatever else is not there. None for a scene without
    /// surfaces that an eye sees.
    pub tree: Option<Tree>,
    /// Rooms and portals, in a dataset that is walked by them.
    pub rooms: Option<RoomIndex>,
    /// Floor plans, from below to above; empty in a dataset for flying.
    pub plans: Vec<FloorPlan>,
}

impl Index {
    /// Whether what lies beyond the budget comes from the LDI tree: there are no placements that
    /// would replace it.
    pub fn walks_by_tree(&self) -> bool {
        let other = !self.points.is_empty() || self.rooms.is_some();
        self.tree.is_some() && !other && self.scene.triangles > self.settings.budget
    }

    /// Whether it is all of a dataset's index, and not that of a first picture
    /// ([`crate::manifest::early`]).
    pub fn is_whole(&self) -> bool {
        !self.cells.is_empty() || self.chunks.iter().all(|c| c.kind != ChunkKind::Page)
    }

    /// The geometry of a cell at a level.
    pub fn mesh_of(&self, drawn: DrawnCell) -> Option<CellMesh<'_>> {
        self.cells.get(drawn.cell as usize)?.mesh(drawn.level)
    }

    /// The images of a placement, with their numbers; none where the index has no such placement.
    pub fn images_of(&self, placement: u32) -> impl Iterator<Item = (u32, &ImageEntry)> {
        let range = self.placements.get(placement as usize).map_or(0..0, |p| p.images.clone());
        range.filter_map(|i| Some((i, self.images.get(i as usize)?)))
    }
}
