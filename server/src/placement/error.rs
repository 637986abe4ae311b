//! What can go wrong while placing images.

use glam::DVec3;

/// Why a placement could not be computed. All are permanent: the same request fails again.
#[derive(Debug, thiserror::Error)]
pub enum PlacementError {
    /// The paper's star-shapes, and the two extra grid points on each side, need a field of view
    /// of at least 54 degrees.
    #[error(
        "field of view {fov_deg} degrees: images are placed for at least 54 and less than 120; give a --fov between"
    )]
    FieldOfView {
        /// What was asked for.
        fov_deg: f64,
    },
    /// A setting is outside its range.
    #[error("setting {name} = {value}: must be {must}")]
    Setting {
        /// Which one.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        must: &'static str,
    },
    /// No image can bring the views of many places within the budget, however fine the grid.
    #[error(
        "budget {budget}: near ({x:.2}, {y:.2}, {z:.2}), yaw {yaw_deg:.0}, pitch {pitch_deg:.0}, {needed} triangles lie too near to be replaced by an image, however fine the grid, and so it is in much of the walk volume; use a larger --budget (at least {needed}; as cells grow with the budget, better {}), a larger --max-footprint, or a larger --density",
        needed + needed / 2,
        x = position.x, y = position.y, z = position.z
    )]
    Infeasible {
        /// P.
        budget: u64,
        /// Smallest budget that would do there.
        needed: u64,
        /// Eye or grid point.
        position: DVec3,
        /// Direction.
        yaw_deg: f64,
        /// Direction.
        pitch_deg: f64,
    },
    /// The grid does not cover an eye.
    #[error("no grid point behind the eye at ({x:.3}, {y:.3}, {z:.3}), yaw {yaw_deg:.1}, pitch {pitch_deg:.1}; this is a fault of the grid: please report the scene", x = position.x, y = position.y, z = position.z)]
    Uncovered {
        /// Eye.
        position: DVec3,
        /// Direction.
        yaw_deg: f64,
        /// Direction.
        pitch_deg: f64,
    },
}
