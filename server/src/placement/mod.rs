//! Stage 4: image placement (Aliaga and Lastra 1999, "Automatic Image Placement to Provide a
//! Guaranteed Frame Rate", section 3; rows A2 to A9).
//!
//! In: a scene, its octree's cells, its walk volume, the build's settings. Out: a
//! [`PlacementResult`]: the grid points that `select` can return with their angular ranges, and
//! [`PlacementPlan`]s with their images.
//!
//! ```text
//!   walk volume -> eye_tree ──────────────┐
//!   bounds -> lattice ────────────────────┼-> who may use which point: coverage (paper) or nearest (cells)
//!                    ^                    v
//!                    └── refine <── paper: point (arcs -> view: angular ranges; subset: 6-tuples)
//!                           │       cells: near_box (looks: certified counts; groups of points)
//!                           v
//!                         plan: cameras, and windows (paper: the frusta's reach; cells: faces of the box); footprint bounds
//! ```
//!
//! `--grid cells`, the default: every eye belongs to its closest point, groups of points share a
//! near box, and the box's faces are images of all the rest (`near_box`).
//!
//! `--grid paper`: the eye takes the closest grid point in its reverse frustum; the point's
//! frustum encloses the eye's, so what holds there holds for the eye. What we changed, each
//! explained in its file: users per point and direction certified by interval subdivision instead
//! of spheres (`coverage`), pitch bands (`arcs`), a footprint bound per image (`footprint`),
//! images that serve all ranges they can (`point`), centres of projection in the middle of the
//! users (`plan`).

mod arcs;
mod audit;
mod bands;
mod bin_planes;
mod cell_mask;
mod cells;
mod coverage;
mod error;
mod eye_tree;
mod faces;
mod footprint;
mod gaze;
mod groups;
mod hull;
mod lattice;
mod looks;
pub mod model;
mod near_box;
mod nearest;
mod plan;
mod point;
mod refine;
mod search;
mod stage;
mod subset;
#[cfg(test)]
pub(crate) mod test_scenes;
mod view;

pub use audit::{
    Adversary, AuditReport, AuditSize, AuditedPose, LevelAudit, PlanRow, Tally, audit, audit_levels, plan_row,
};
pub use error::PlacementError;
pub(crate) use footprint::{Footprint, SCALES};
pub use gaze::Gaze;
pub(crate) use gaze::scattered;
pub use groups::Groupings;
pub use model::{DirectionRange, ImagePlan, PlacementPlan, PlacementResult, PlacementStatistics};
pub(crate) use plan::spread;
pub use point::Sees;
pub use search::{Found, Search};
pub use stage::{Parameters, SearchCase, SearchComparison, check_settings, compare_searches, plan_placements, without};
pub use subset::CostBenefit;
