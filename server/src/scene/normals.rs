//! Normals where a file has none, or useless ones.
//!
//! Two ways, because the formats differ: glTF 2.0 (section 3.7.2.1) and, by the habit of its
//! viewers, OBJ ask for flat normals, for which vertices are no longer shared between triangles; a
//! PLY scan means one smooth surface, whose normal at a vertex is the mean of its triangles'
//! normals weighted by area. Sums run in f64 in file order, so that neither huge coordinates nor
//! the number of threads change them.

use glam::{DVec3, Vec3};

use super::model::Primitive;

/// The normal of what has none: a triangle without area, a vertex without triangles.
const UP: Vec3 = Vec3::Y;
/// Squared length below which a stored normal says nothing about a direction.
const SHORTEST_SQUARED: f32 = 1.0e-12;

/// Twice the area of a triangle times its unit normal, counter-clockwise seen from the front.
fn area_normal(positions: &[Vec3], [a, b, c]: [u32; 3]) -> DVec3 {
    let at = |v: u32| positions[v as usize].as_dvec3();
    (at(b) - at(a)).cross(at(c) - at(a))
}

fn unit(n: DVec3) -> Vec3 {
    // Scaled first: the square of a tiny triangle's area underflows even in f64.
    let largest = n.abs().max_element();
    if largest > 0.0 && largest.is_finite() { (n / largest).normalize().as_vec3() } else { UP }
}

/// One normal per vertex: the area-weighted mean of its triangles' normals.
pub(super) fn smooth(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for &triangle in triangles {
        let n = area_normal(positions, triangle);
        for v in triangle {
            sums[v as usize] += n;
        }
    }
    sums.into_iter().map(unit).collect()
}

/// Gives every triangle its own three vertices, with the triangle's normal.
pub(super) fn flatten(primitive: &mut Primitive) {
    fn unshare<T: Copy>(values: &mut Vec<T>, triangles: &[[u32; 3]]) {
        if !values.is_empty() {
            *values = triangles.as_flattened().iter().map(|&v| values[v as usize]).collect();
        }
    }
    primitive.normals =
        primitive.triangles.iter().flat_map(|&t| [unit(area_normal(&primitive.positions, t)); 3]).collect();
    unshare(&mut primitive.positions, &primitive.triangles);
    unshare(&mut primitive.uvs, &primitive.triangles);
    unshare(&mut primitive.colours, &primitive.triangles);
    for (i, triangle) in (0u32..).zip(&mut primitive.triangles) {
        *triangle = [3 * i, 3 * i + 1, 3 * i + 2];
    }
}

/// Brings stored normals to unit length; those without a direction, or not finite, become smooth
/// ones. Returns how many did.
pub(super) fn repair(primitive: &mut Primitive) -> usize {
    let mut lost = Vec::new();
    for (i, n) in primitive.normals.iter_mut().enumerate() {
        let squared = n.length_squared();
        if (squared - 1.0).abs() < 1.0e-6 {
            continue;
        }
        if squared > SHORTEST_SQUARED && n.is_finite() {
            *n = unit(n.as_dvec3());
        } else {
            lost.push(i);
        }
    }
    if !lost.is_empty() {
        let made = smooth(&primitive.positions, &primitive.triangles);
        for &i in &lost {
            primitive.normals[i] = made[i];
        }
    }
    lost.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two faces of a cube that share the edge x = 1, z = 0..1: the floor (up) and the wall
    /// (right).
    fn corner() -> Primitive {
        Primitive {
            positions: [[0., 1., 0.], [1., 1., 0.], [1., 1., 1.], [1., 0., 0.], [1., 0., 1.]].map(Vec3::from).to_vec(),
            triangles: vec![[0, 2, 1], [1, 2, 3], [3, 2, 4]],
            colours: (0..5).map(|i| [i as f32; 3]).collect(),
            ..Primitive::default()
        }
    }

    #[test]
    fn flat_normals_are_the_faces_own() {
        let mut p = corner();
        flatten(&mut p);
        assert_eq!(p.positions.len(), 9);
        assert_eq!(p.triangles, [[0, 1, 2], [3, 4, 5], [6, 7, 8]]);
        assert!(p.normals[..3].iter().all(|&n| n == Vec3::Y));
        assert!(p.normals[3..].iter().all(|&n| n == Vec3::X));
        assert_eq!(p.colours[1], [2.0; 3]);
    }

    #[test]
    fn smooth_normals_weigh_by_area() {
        let p = corner();
        let n = smooth(&p.positions, &p.triangles);
        assert_eq!(n[0], Vec3::Y);
        assert_eq!(n[4], Vec3::X);
        // Vertex 2 belongs to one triangle of the floor and two of the wall, all of area one half.
        assert!(n[2].distance(Vec3::new(2.0, 1.0, 0.0).normalize()) < 1e-6);
    }

    #[test]
    fn degenerate_triangles_give_finite_unit_normals() {
        let mut p = Primitive {
            positions: vec![Vec3::ZERO, Vec3::ZERO, Vec3::X],
            normals: vec![Vec3::ZERO, Vec3::new(0.0, 0.0, 5.0), Vec3::X],
            triangles: vec![[0, 1, 2]],
            ..Primitive::default()
        };
        assert_eq!(repair(&mut p), 1);
        assert_eq!(p.normals, [Vec3::Y, Vec3::Z, Vec3::X]);
        flatten(&mut p);
        assert_eq!(p.normals, [Vec3::Y; 3]);
    }

    #[test]
    fn neither_huge_nor_tiny_triangles_lose_their_normal() {
        for scale in [1.0e-18_f32, 1.0e18] {
            let positions = [Vec3::ZERO, Vec3::X * scale, Vec3::Y * scale];
            assert_eq!(smooth(&positions, &[[0, 1, 2]]), [Vec3::Z; 3]);
        }
    }
}
