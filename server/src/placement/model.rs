//! What the placement stage hands on: grid points with their angular ranges, and
//! [`PlacementPlan`]s.

use super::gaze::Gaze;
use glam::DVec3;
use ldi_protocol::{Aabb, CellRuns, ViewBasis, index::GridPoint, volume::WalkVolume};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Directions from which an image is looked at: a yaw interval times a pitch interval, degrees.
///
/// `yaw_deg[0] < yaw_deg[1]`, and the second may exceed 360 where the interval crosses 0.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct DirectionRange {
    /// Yaw from, to.
    pub yaw_deg: [f64; 2],
    /// Pitch from, to.
    pub pitch_deg: [f64; 2],
}

/// Cells that images replace, and those images.
#[derive(Debug, Clone, PartialEq)]
pub struct PlacementPlan {
    /// Position in [`PlacementResult::points`] of the point it was solved at, or of the first that
    /// uses it; None for a portal's.
    pub grid_point: Option<u32>,
    /// Centre of projection of all its images: the middle of the users.
    pub cop: DVec3,
    /// Cells that the images replace. Each lies wholly beyond the plane of one of them.
    pub culled: CellRuns,
    /// Box of all eyes that may use it.
    pub users: Aabb,
    /// Places inside that box where eyes stand, spread over all of them: what they see of the
    /// replaced cells is what the images hold. Empty: anywhere in the box, and past cells that
    /// stay as if they were not there.
    pub eyes: Vec<DVec3>,
    /// More such places, nearer to each other: sky that only those see is known as well.
    pub lookouts: Vec<DVec3>,
    /// The directions in which they look.
    pub gaze: Gaze,
    /// A flat convex polygon that they look through: the images hold nothing else. Empty:
    /// everything.
    pub through: Vec<DVec3>,
    /// Largest bound of its images.
    pub footprint_px: f64,
    /// Its images: one in the paper's scheme; up to six faces of a near box with view cells.
    pub images: Vec<ImagePlan>,
}

/// An image to be made: its plane, its camera, and who looks at it.
///
/// ```text
///   users (box of eyes)          image plane        culled cells
///   ┌──────────────┐                  │           ┌────┐
///   │      + cop   │ ── basis.forward │→     ┌────┤    │
///   └──────────────┘                  │      └────┴────┘
///          |<---- plane_distance ---->|
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ImagePlan {
    /// Orientation of the image plane; `forward` is its normal, into the scene.
    pub basis: ViewBasis,
    /// Centre of projection.
    pub cop: DVec3,
    /// Distance from the centre of projection to the image plane along `basis.forward`, metres;
    /// positive.
    pub plane_distance: f64,
    /// Distances of the planes of the images beside it, left, right, bottom, top, metres; infinite
    /// where there is none.
    pub beside: [f64; 4],
    /// Samples per unit of the image plane at distance 1 from the centre of projection.
    pub pixels_per_unit: f64,
    /// Tangent extents of the image at distance 1 from the centre of projection: left, right
    /// (along `basis.right`), bottom, top (along `basis.up`).
    pub window: [f64; 4],
    /// Box of all eyes that may use it.
    pub users: Aabb,
    /// The directions from which they do; disjoint but for borders.
    pub directions: Vec<DirectionRange>,
    /// Bound on the footprint of any sample from any of these eyes in any of these directions,
    /// output pixels.
    pub footprint_px: f64,
}

impl ImagePlan {
    /// Whether a place (right, up, forward from the centre of projection) is this image's to show:
    /// it lies beyond the plane, and if it lies beyond the plane of an image beside, it is farther
    /// along this one's axis. A direction is a place far away.
    pub fn owns(&self, p: DVec3) -> bool {
        let [left, right, bottom, top] = self.beside.map(|d| d.max(p.z));
        p.z >= self.plane_distance && -p.x <= left && p.x <= right && -p.y <= bottom && p.y <= top
    }

    /// Pixels, before rounding to whole ones.
    pub fn pixels(&self) -> f64 {
        let side = |low: f64, high: f64| ((high - low) * self.pixels_per_unit).max(0.0);
        side(self.window[0], self.window[1]) * side(self.window[2], self.window[3])
    }
}

/// What the placement stage found.
#[derive(Debug, Clone)]
pub struct PlacementResult {
    /// Grid points that `select` may return, in lattice order.
    pub points: Vec<GridPoint>,
    /// Placements, by grid point, then in the order they were solved.
    pub plans: Vec<PlacementPlan>,
    /// Borders of the pitch bands, ascending; empty without points.
    pub pitch_bands_deg: Vec<f64>,
    /// Where eyes may be.
    pub volume: WalkVolume,
    /// Around the eyes that were taken from it, as no image can serve them within the budget.
    pub beyond_budget: Vec<Aabb>,
    /// Figures for the build report.
    pub statistics: PlacementStatistics,
}

/// Figures of the placement stage for the build report.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct PlacementStatistics {
    /// Why there are no points, if there are none.
    pub nothing_to_do: Option<String>,
    /// Floor of the walk volume that was given up, as no image can serve its eyes within the
    /// budget, square metres.
    #[serde(default)]
    pub beyond_budget_m2: f64,
    /// The smallest budget that would do there, triangles; 0 without such places.
    #[serde(default)]
    pub beyond_budget_needs: u64,
    /// Spacing of the level-0 grid, metres.
    pub spacing_m: f64,
    /// Grid points in use per level.
    pub by_level: BTreeMap<u8, u32>,
    /// The paper's star-shape radius per level (2 r at even, 3 r at odd levels), metres; the
    /// guarantee rests on `GridPoint::radius` instead.
    pub paper_radius_m: BTreeMap<u8, f64>,
    /// Largest ratio of a certified radius to the paper's.
    pub largest_radius_ratio: f64,
    /// Lattice points left out, by reason.
    pub skipped: BTreeMap<String, u64>,
    /// Histogram of |drawn - Popt| / Popt over solved subsets, in steps of 1% (the last entry: 20%
    /// and more).
    pub popt_closeness: Vec<u32>,
    /// Share of solved subsets within 2% of Popt.
    pub within_two_percent: f64,
    /// Rounds of coverage, evaluation and subdivision.
    pub rounds: u32,
    /// Position-direction boxes that the certificate consists of.
    pub certified_boxes: u64,
    /// Every eye of the walk volume has, for each direction, a certified grid point.
    pub coverage_certified: bool,
    /// Largest number of triangles any range draws at its grid point.
    pub max_triangles: u64,
    /// Largest footprint bound, output pixels.
    pub max_footprint_px: f64,
    /// Seconds per step (timing only; not part of the dataset).
    pub seconds: BTreeMap<String, f64>,
}
