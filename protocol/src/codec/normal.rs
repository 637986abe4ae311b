//! Unit normals as octahedral coordinates (Meyer, Suessmuth, Sussner, Stamminger, Greiner 2010):
//! the sphere is projected onto the octahedron |x| + |y| + |z| = 1, its lower half unfolded over
//! the corners of the upper half's square.

use glam::Vec3;

/// Largest coordinate: 12 bits with 0 represented exactly, so that axis-aligned normals stay exact.
const NORMAL_MAX: f32 = 2047.0;

/// Most that a decoded normal is off, radians: sqrt(2) / 2047, 0.04 degrees. A step of one
/// coordinate moves a point of a face by a step of a hexagonal lattice, sqrt(2) / 2047 long, no
/// place is farther than 1 / sqrt(3) of that from a lattice point, and a face's middle, where it
/// counts most, is 1 / sqrt(3) from the origin. Rounding each coordinate by itself would not do:
/// where both are half way it is off by 3 / sqrt(2) / 2047.
#[cfg(test)]
pub(super) const MOST_OFF: f32 = std::f32::consts::SQRT_2 / NORMAL_MAX;

/// Octahedral coordinates of a unit normal, each -2047 to 2047: of the four around it those that
/// are decoded nearest to it. What is no direction becomes +Y.
pub(super) fn octahedral(n: Vec3) -> [i64; 2] {
    let sum = n.abs().element_sum();
    let n = if sum > 0.0 && sum.is_finite() { n / sum } else { Vec3::Y };
    let fold = |a: f32, b: f32| if n.z < 0.0 { (1.0 - b.abs()) * if a < 0.0 { -1.0 } else { 1.0 } } else { a };
    let [x, y] = [fold(n.x, n.y), fold(n.y, n.x)].map(|x| x * NORMAL_MAX);
    let around = [[x.floor(), y.floor()], [x.ceil(), y.floor()], [x.floor(), y.ceil()], [x.ceil(), y.ceil()]];
    let direction = n.normalize();
    let off = |k: &[i64; 2]| normal_of(*k).distance_squared(direction);
    let around = around.map(|k| k.map(|x| x as i64));
    around.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or_default()
}

/// Inverse of [`octahedral`] for any coordinates.
pub(super) fn normal_of(k: [i64; 2]) -> Vec3 {
    let [x, y] = k.map(|k| (k as f32 / NORMAL_MAX).clamp(-1.0, 1.0));
    let z = 1.0 - x.abs() - y.abs();
    let unfold = |a: f32, b: f32| if z < 0.0 { (1.0 - b.abs()) * if a < 0.0 { -1.0 } else { 1.0 } } else { a };
    Vec3::new(unfold(x, y), unfold(y, x), z).normalize_or(Vec3::Y)
}
