//! Stage 2: clusters and the loose octree of cells (A1).
//!
//! In: a [`Scene`](crate::scene::Scene). Out: [`Clusters`] (each unique primitive cut once into
//! pieces of at most 256 triangles and bounded extent) and [`Octree`] (every cluster instance in
//! exactly one cell).
//!
//! After Aliaga and Lastra 1999, section 3: their octree cuts the model into pseudo-leaves, the
//! unit of culling, and a triangle that crosses cell borders is counted in each. Here nothing is
//! cut at cell borders: the unit is the cluster, a *loose* octree (Ulrich 2000) takes it by its
//! centre, and cells keep tight bounds of what they hold, so near + far = scene, every triangle of
//! every instance exactly once, and instances stay references.

mod check;
mod cluster;
mod model;
mod ranges;
mod recount;
mod tree;

pub use check::OctreeFault;
pub use model::{Cell, Clusters, Octree, SourceCluster};
pub use ranges::SourceRange;
pub use recount::{RecountError, recount};
pub(crate) use tree::up_to_f32;

#[cfg(test)]
mod tests;
