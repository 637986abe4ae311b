//! A mesh's own origin: positions about it are exact enough in single precision wherever the mesh
//! stands.
//!
//! Text files hold world coordinates, of national grids often (500,000 m east, 5,000,000 m north),
//! where single precision knows half metres.

use glam::DVec3;
use ldi_protocol::Aabb;

/// Within this distance of zero single precision rounds by 0.03 mm at most.
const NEAR_M: f64 = 1024.0;

/// For these world positions: zero along axes on which all are near it, else their middle, in
/// whole metres.
pub(super) fn of(positions: impl IntoIterator<Item = DVec3>) -> DVec3 {
    let bounds = Aabb::from_points(positions);
    if bounds.is_empty() {
        return DVec3::ZERO;
    }
    let far = bounds.min.abs().max(bounds.max.abs()).cmpgt(DVec3::splat(NEAR_M));
    DVec3::select(far, bounds.centre().round(), DVec3::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_far_moves_and_what_is_near_stays() {
        assert_eq!(of([]), DVec3::ZERO);
        assert_eq!(of([DVec3::new(-1000.0, 3.0, 900.0), DVec3::ZERO]), DVec3::ZERO);
        let far = [DVec3::new(500_000.25, 20.0, 5_000_000.0), DVec3::new(500_010.25, 22.0, 5_000_001.0)];
        assert_eq!(of(far), DVec3::new(500_005.0, 0.0, 5_000_001.0));
    }
}
