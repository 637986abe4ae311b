//! How much a scene file may ask for. A file is data from a stranger: a few bytes of it can
//! promise billions of vertices, so every size is compared with these before anything is allocated
//! for it.

/// Upper bounds for one scene. [`LIMITS`] holds the values in use; tests pass smaller ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Bytes of the scene file and of all files it refers to, together.
    pub file_bytes: u64,
    /// Bytes of a glTF file's JSON part. A parsed object takes up to a hundred times its text.
    pub json_bytes: u64,
    /// JSON objects (`{`) in a glTF file: bounds the parsed document at about 350 bytes each.
    pub json_objects: u64,
    /// Bytes of STEP text (IFC). Its records are found by an index in memory.
    pub step_bytes: u64,
    /// Records of STEP text: about 40 bytes of index each.
    pub step_records: u64,
    /// Vertices of all meshes together after unrolling, each mesh once: about 44 bytes each.
    pub vertices: u64,
    /// Triangles of all meshes together, each mesh once: 12 bytes each.
    pub unique_triangles: u64,
    /// Triangles with every instance counted.
    pub expanded_triangles: u64,
    /// Instances (glTF nodes with a mesh).
    pub instances: u64,
    /// Nodes from a root down to a leaf. Traversal does not recurse; deeper trees are mistakes.
    pub node_depth: u32,
    /// Columns or rows of an image.
    pub image_side: u32,
    /// Pixels of all images together: 4 bytes each.
    pub image_pixels: u64,
    /// Largest distance from the origin along any axis, metres. At 10,000 km an f64 still resolves
    /// 2 nm, and squares of f32 coordinates stay finite.
    pub coordinate_m: f64,
    /// Bytes of a PLY header.
    pub ply_header_bytes: u64,
    /// Rooms, and separately portals, that a file may name.
    pub rooms: u64,
    /// Corners of a portal.
    pub portal_corners: u64,
}

/// The limits in use: several times the largest scene known to be worth walking (7 million
/// triangles), and together below 10 GiB in the worst case.
pub const LIMITS: Limits = Limits {
    file_bytes: 4 << 30,
    json_bytes: 128 << 20,
    json_objects: 4 << 20,
    step_bytes: 2 << 30,
    step_records: 32 << 20,
    vertices: 64 << 20,
    unique_triangles: 64 << 20,
    expanded_triangles: 1 << 30,
    instances: 2 << 20,
    node_depth: 256,
    image_side: 16_384,
    image_pixels: 512 << 20,
    coordinate_m: 1.0e7,
    ply_header_bytes: 64 << 10,
    rooms: 65_536,
    portal_corners: 64,
};
