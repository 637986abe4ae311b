//! Stage 2: clusters and the loose octree of cells (A1).
//!
//! In: a [`Scene`]. Out: [`Clusters`] (each unique primitive cut once into pieces of at most 256 triangles and bounded
//! extent) and [`Octree`] (every cluster instance in exactly one cell).

mod model;

pub use model::{Cell, Clusters, Octree, SourceCluster};
