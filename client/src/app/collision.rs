//! Collision: near geometry around the walker that blocks the way or carries the foot.
//!
//! In: decoded cells around an eye. Out: the distance of an upright body to surfaces between knee
//! and head, and the height of the floor. The walk volume contains floors but no walls, which are
//! thinner than its columns. Near geometry is complete around the eye once it has arrived; until
//! then nothing blocks the way.
//!
//! ```text
//!      eye + 0.1 m  ----+--------   surfaces in between are clipped to this slab and seen from
//!                       | body      above: convex polygons, from which a body at (x, z) keeps
//!      foot + knee  ----+--------   its radius
//!                                   lower surfaces are stepped over, or on
//!      foot         =============   floor: the highest surface below the knee
//! ```

use super::server_connection::Scene;
use crate::resident::{Resident, each_cluster};
use glam::{DAffine3, DVec2, DVec3};
use ldi_protocol::{
    Aabb,
    index::Index,
    mesh::{Alpha, Cluster},
};

/// Radius of the body, metres. Larger: some doors are too narrow; smaller: the near plane cuts into
/// walls.
pub const BODY_M: f64 = 0.15;
/// Surfaces lower than this above the foot are stepped over or on, metres: steps, kerbs,
/// thresholds.
const KNEE_M: f64 = 0.45;
/// Distance from the eye to the top of the head, metres.
const HEAD_M: f64 = 0.1;
/// Depth below the foot in which a floor is searched, metres.
const DROP_M: f64 = 1.5;
/// Radius around the eye in which surfaces are gathered, metres.
const REACH_M: f64 = 2.0;
/// Distance that the eye may move before surfaces are gathered again, metres.
pub const STRAY_M: f64 = 0.5;
/// Offsets from the body's axis at which the floor is tested, metres: a crack between boards must
/// not count as a drop.
const FEET_M: [(f64, f64); 5] = [(0.0, 0.0), (0.08, 0.0), (-0.08, 0.0), (0.0, 0.08), (0.0, -0.08)];

/// Surfaces around an eye.
#[derive(Debug, Clone, Default)]
pub struct CollisionGeometry {
    /// Obstacles seen from above (x, z), as convex polygons of either orientation.
    obstacles: Vec<Vec<DVec2>>,
    floors: Vec<[DVec3; 3]>,
    eye_height_m: f64,
}

impl CollisionGeometry {
    /// Gathers cached surfaces around `eye`, for a body whose eye is `eye_height_m` above its foot.
    pub fn around(scene: &Scene, eye: DVec3, eye_height_m: f64) -> Self {
        Self::within(scene, eye, eye_height_m, REACH_M)
    }

    /// Gathers cached surfaces within `reach_m`.
    pub fn within(scene: &Scene, eye: DVec3, eye_height_m: f64, reach_m: f64) -> Self {
        Self::update_collision(&scene.index, &*scene.cache, eye, eye_height_m, reach_m)
    }

    fn update_collision(index: &Index, resident: &dyn Resident, eye: DVec3, eye_height_m: f64, reach_m: f64) -> Self {
        let mut out = Self { eye_height_m, ..Self::default() };
        let foot = eye.y - eye_height_m;
        // The slab is extended by the height that may be climbed before surfaces are gathered
        // again.
        let reach = DVec3::new(reach_m, 0.0, reach_m);
        let room = Aabb {
            min: DVec3::new(eye.x, foot - DROP_M, eye.z) - reach,
            max: DVec3::new(eye.x, eye.y + HEAD_M, eye.z) + reach,
        };
        let slab = [foot + KNEE_M, eye.y + HEAD_M];
        for (number, _) in (0u32..).zip(&index.cells).filter(|(_, c)| touch(&c.bounds, &room)) {
            each_cluster(index, resident, number, |cluster, world_from_mesh| {
                // Materials with alpha (leaves, panes) do not block the way.
                let material = index.materials.get(cluster.material as usize);
                if material.is_some_and(|m| m.alpha == Alpha::Opaque) {
                    out.add(cluster, world_from_mesh, &room, slab);
                }
            });
        }
        out
    }

    fn add(&mut self, cluster: &Cluster, world_from_mesh: &DAffine3, room: &Aabb, slab: [f64; 2]) {
        let world = |p: &glam::Vec3| world_from_mesh.transform_point3(cluster.origin + p.as_dvec3());
        let corners: Vec<DVec3> = cluster.positions.iter().map(world).collect();
        for t in &cluster.triangles {
            let [Some(a), Some(b), Some(c)] = t.map(|i| corners.get(usize::from(i)).copied()) else { continue };
            let bounds = Aabb { min: a.min(b).min(c), max: a.max(b).max(c) };
            if !touch(&bounds, room) {
                continue;
            }
            if bounds.min.y < slab[0] {
                self.floors.push([a, b, c]);
            }
            if bounds.max.y > slab[0] && bounds.min.y < slab[1] {
                let cut = clip(&clip(&[a, b, c], slab[0], 1.0), slab[1], -1.0);
                if cut.len() >= 2 {
                    self.obstacles.push(cut.iter().map(|p| DVec2::new(p.x, p.z)).collect());
                }
            }
        }
    }

    /// Horizontal distance from (x, z) to the nearest obstacle, at most [`REACH_M`], and the
    /// direction away from it.
    pub fn clearance(&self, x: f64, z: f64) -> (f64, DVec2) {
        let p = DVec2::new(x, z);
        let mut best = (REACH_M, DVec2::ZERO);
        for polygon in &self.obstacles {
            if inside(polygon, p) {
                return (0.0, DVec2::ZERO);
            }
            for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
                let along = *b - *a;
                let t = ((p - *a).dot(along) / along.length_squared().max(1e-18)).clamp(0.0, 1.0);
                let off = p - (*a + along * t);
                let distance = off.length();
                if distance < best.0 {
                    best = (distance, off.normalize_or_zero());
                }
            }
        }
        best
    }

    /// Whether a body may move between two places: it stays clear of obstacles, or at least does
    /// not come nearer.
    pub fn allows(&self, from: DVec3, to: DVec3) -> bool {
        let (there, _) = self.clearance(to.x, to.z);
        if there >= BODY_M {
            return true;
        }
        // A body inside of an obstacle, as after a jump on the map, can always leave.
        let (here, _) = self.clearance(from.x, from.z);
        there > here || here == 0.0
    }

    /// Height of the eye above the floor below it; None without a floor.
    pub fn eye_above_floor(&self, eye: DVec3) -> Option<f64> {
        let foot = eye.y - self.eye_height_m;
        let heights = FEET_M.iter().filter_map(|(dx, dz)| {
            let below = self.floors.iter().filter_map(|t| height_at(t, eye.x + dx, eye.z + dz));
            below.filter(|y| (foot - DROP_M..=foot + KNEE_M).contains(y)).max_by(f64::total_cmp)
        });
        heights.max_by(f64::total_cmp).map(|y| y + self.eye_height_m)
    }
}

fn touch(a: &Aabb, b: &Aabb) -> bool {
    a.min.cmple(b.max).all() && b.min.cmple(a.max).all()
}

/// The part of a polygon with `side * (y - at) >= 0`.
fn clip(polygon: &[DVec3], at: f64, side: f64) -> Vec<DVec3> {
    let mut out = Vec::with_capacity(polygon.len() + 1);
    for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
        let (da, db) = (side * (a.y - at), side * (b.y - at));
        if da >= 0.0 {
            out.push(*a);
        }
        if (da < 0.0) != (db < 0.0) {
            out.push(*a + (*b - *a) * (da / (da - db)));
        }
    }
    out
}

/// Whether a convex polygon with an area holds a point.
fn inside(polygon: &[DVec2], p: DVec2) -> bool {
    let sides = || polygon.iter().zip(polygon.iter().cycle().skip(1)).map(|(a, b)| (*b - *a).perp_dot(p - *a));
    sides().all(|s| s > 1e-12) || sides().all(|s| s < -1e-12)
}

/// Height of a triangle at (x, z); None outside of it and for vertical ones.
fn height_at(t: &[DVec3; 3], x: f64, z: f64) -> Option<f64> {
    let (u, v) = (t[1] - t[0], t[2] - t[0]);
    let area = u.x * v.z - u.z * v.x;
    if area.abs() < 1e-12 {
        return None;
    }
    let (dx, dz) = (x - t[0].x, z - t[0].z);
    let (a, b) = ((dx * v.z - dz * v.x) / area, (u.x * dz - u.z * dx) / area);
    (a >= -1e-9 && b >= -1e-9 && a + b <= 1.0 + 1e-9).then(|| t[0].y + a * u.y + b * v.y)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::test_support::{dataset, plain_material, quad_cluster};
    use glam::Vec3;
    use ldi_protocol::OutputCamera;

    /// A room of the given quadrilaterals, for an eye at (2, 2) 1.6 m above the floor.
    pub fn of(quads: &[[Vec3; 4]], eye: DVec3) -> CollisionGeometry {
        let clusters = quads.iter().map(|q| quad_cluster(0, *q)).collect();
        let camera = OutputCamera { width: 64, height: 36, fov_deg: 60.0 };
        let (index, memory) = dataset(camera, vec![plain_material()], clusters);
        CollisionGeometry::update_collision(&index, &memory, eye, 1.6, REACH_M)
    }

    /// A horizontal rectangle.
    pub fn plate(min: [f32; 2], max: [f32; 2], y: f32) -> [Vec3; 4] {
        [(min[0], min[1]), (max[0], min[1]), (max[0], max[1]), (min[0], max[1])].map(|(x, z)| Vec3::new(x, y, z))
    }

    /// An upright rectangle between two places.
    pub fn wall(a: [f32; 2], b: [f32; 2], low: f32, high: f32) -> [Vec3; 4] {
        [
            Vec3::new(a[0], low, a[1]),
            Vec3::new(b[0], low, b[1]),
            Vec3::new(b[0], high, b[1]),
            Vec3::new(a[0], high, a[1]),
        ]
    }

    const EYE: DVec3 = DVec3::new(2.0, 1.6, 2.0);

    #[test]
    fn walls_are_as_far_as_they_are() {
        let s = of(&[plate([0.0, 0.0], [4.0, 4.0], 0.0), wall([3.0, 0.0], [3.0, 4.0], 0.0, 2.5)], EYE);
        let (distance, away) = s.clearance(2.4, 2.0);
        assert!((distance - 0.6).abs() < 1e-9 && (away - DVec2::new(-1.0, 0.0)).length() < 1e-9);
        assert!(s.allows(EYE, DVec3::new(2.8, 1.6, 2.0)) && !s.allows(EYE, DVec3::new(2.9, 1.6, 2.0)));
        // Away from the wall even when too near.
        assert!(s.allows(DVec3::new(2.9, 1.6, 2.0), DVec3::new(2.88, 1.6, 2.0)));
    }

    #[test]
    fn only_what_is_between_knee_and_head_stands_in_the_way() {
        let far = |quads: &[[Vec3; 4]]| of(quads, EYE).clearance(2.9, 2.0).0;
        let bar = |low, high| wall([3.0, 0.0], [3.0, 4.0], low, high);
        assert_eq!(far(&[bar(0.0, 0.4)]), REACH_M, "a step");
        assert_eq!(far(&[bar(2.0, 2.5)]), REACH_M, "a lintel");
        assert!(far(&[bar(1.0, 1.1)]) < 0.11, "a railing");
        assert_eq!(far(&[plate([2.8, 1.0], [3.5, 3.0], 0.75)]), 0.0, "a table");
    }

    #[test]
    fn the_floor_is_the_highest_below_the_knee() {
        let quads = [
            plate([0.0, 0.0], [4.0, 4.0], 0.0),
            plate([1.0, 1.0], [2.5, 2.5], 0.18),
            plate([1.5, 1.5], [2.5, 2.5], 0.75),
        ];
        let s = of(&quads, EYE);
        let at = |x: f64| s.eye_above_floor(DVec3::new(x, 1.6, 2.0)).map(|y| (y * 100.0).round());
        assert_eq!(at(3.0), Some(160.0));
        assert_eq!(at(2.0), Some(178.0), "on the step, not on the table");
        assert_eq!(at(2.55), Some(178.0), "half a foot on the step");
        assert_eq!(at(4.5), None);
    }

    #[test]
    fn panes_are_no_walls() {
        let mut glass = plain_material();
        glass.alpha = Alpha::Mask(0.5);
        let camera = OutputCamera { width: 64, height: 36, fov_deg: 60.0 };
        let (index, memory) =
            dataset(camera, vec![glass], vec![quad_cluster(0, wall([3.0, 0.0], [3.0, 4.0], 0.0, 2.5))]);
        assert_eq!(
            CollisionGeometry::update_collision(&index, &memory, EYE, 1.6, REACH_M).clearance(2.9, 2.0).0,
            REACH_M
        );
    }
}
