//! Statistics of the rasterizer: counts, and missing data.

/// Statistics of the rasterizer.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct NearStats {
    /// Triangles of the drawn clusters, before frustum rejection and clipping.
    pub triangles: u64,
    /// Clusters drawn.
    pub clusters: u64,
    /// Chunks of cells and bundles that are not resident, ascending, without repetition.
    pub missing_chunks: Vec<u32>,
    /// Textures in use of which no level is resident, ascending.
    pub missing_textures: Vec<u32>,
    /// Textures in use whose finest level is not resident, ascending: drawn coarser than possible.
    pub coarse_textures: Vec<u32>,
}
