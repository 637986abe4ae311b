//! `select`: from a pose to what is drawn. A pure function over the [`Index`], so that the server plans with
//! exactly what the client renders with (Aliaga and Lastra 1999, Figure 12).

use crate::{Aabb, Pose, camera::Frustum, index::Index};

/// What a pose sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Selection {
    /// The closest grid point inside the reverse frustum. None: no grid, or the pose is outside the walk volume.
    pub grid_point: Option<u32>,
    /// The placement of the pose's angular range; None draws everything.
    pub placement: Option<u32>,
}

/// The frusta that a cell must touch to be drawn: the planning square and the picture itself. Testing both makes the
/// drawn cells a subset of those counted at the grid point, plane by plane.
#[derive(Debug, Clone, Copy)]
pub struct DrawFrusta {
    square: Frustum,
    picture: Frustum,
}

impl DrawFrusta {
    /// Frusta of a pose under the build's settings. A picture wider or taller than planned is cut to the square.
    pub fn new(index: &Index, pose: &Pose, picture_half_tan: (f64, f64)) -> Self {
        let basis = pose.basis();
        let t = index.settings.square_half_tan();
        Self {
            square: Frustum::new(pose.position, &basis, t, t),
            picture: Frustum::new(pose.position, &basis, picture_half_tan.0, picture_half_tan.1),
        }
    }
    /// Whether a cell with these bounds is drawn (unless it is culled).
    pub fn admit(&self, b: &Aabb) -> bool {
        self.square.may_intersect(b) && self.picture.may_intersect(b)
    }
}

/// Selects the grid point and the placement of a pose.
///
/// The grid point is the closest P with `eye in P + forward square frustum(direction)`; ties go to the smaller number.
pub fn select(index: &Index, pose: &Pose) -> Selection {
    let basis = pose.basis();
    let t = index.settings.square_half_tan();
    let mut best: Option<(f64, u32)> = None;
    for (i, p) in index.points.iter().enumerate() {
        let v = pose.position - p.position;
        let d2 = v.length_squared();
        if best.is_some_and(|(b, _)| d2 >= b) {
            continue;
        }
        let z = v.dot(basis.forward);
        if z >= 0.0 && v.dot(basis.right).abs() <= t * z && v.dot(basis.up).abs() <= t * z {
            best = Some((d2, i as u32));
        }
    }
    let grid_point = best.map(|b| b.1);
    Selection { grid_point, placement: grid_point.and_then(|g| placement_of(index, g, pose)) }
}

/// The placement that a grid point names for the direction of a pose.
pub fn placement_of(index: &Index, grid_point: u32, pose: &Pose) -> Option<u32> {
    let point = &index.points[grid_point as usize];
    let band = band_of(&index.pitch_bands_deg, pose.pitch_deg)?;
    let ranges = point.bands.get(band)?;
    let yaw = pose.yaw_deg.rem_euclid(360.0);
    let after = ranges.partition_point(|r| r.yaw_start_deg <= yaw);
    let range = if after == 0 { ranges.last() } else { ranges.get(after - 1) };
    range.and_then(|r| r.placement)
}

/// The pitch band of a direction; None outside the built range.
pub fn band_of(borders_deg: &[f64], pitch_deg: f64) -> Option<usize> {
    let (first, last) = (borders_deg.first()?, borders_deg.last()?);
    if pitch_deg < *first || pitch_deg > *last {
        return None;
    }
    Some(borders_deg.partition_point(|b| *b <= pitch_deg).clamp(1, borders_deg.len() - 1) - 1)
}
