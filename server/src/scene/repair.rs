//! Vertices without a place: they are taken out, and triangles that use them with them.

use glam::Vec2;

use super::model::Primitive;

/// What was taken out of a primitive.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) struct Dropped {
    /// Vertices whose position is not finite.
    pub(super) vertices: usize,
    /// Triangles that use such a vertex.
    pub(super) triangles: usize,
}

/// Removes vertices whose position is not finite, and the triangles that use one.
pub(super) fn drop_unplaced(primitive: &mut Primitive) -> Dropped {
    let placed: Vec<bool> = primitive.positions.iter().map(|p| p.is_finite()).collect();
    let vertices = placed.iter().filter(|p| !**p).count();
    if vertices == 0 {
        return Dropped::default();
    }
    let before = primitive.triangles.len();
    primitive.triangles.retain(|t| t.iter().all(|&v| placed[v as usize]));
    let mut next = 0;
    let new_numbers: Vec<u32> = placed
        .iter()
        .map(|&kept| {
            next += u32::from(kept);
            next - u32::from(kept)
        })
        .collect();
    for v in primitive.triangles.as_flattened_mut() {
        *v = new_numbers[*v as usize];
    }
    fn keep<T: Copy>(values: &mut Vec<T>, placed: &[bool]) {
        if !values.is_empty() {
            *values = values.iter().zip(placed).filter(|(_, kept)| **kept).map(|(value, _)| *value).collect();
        }
    }
    keep(&mut primitive.positions, &placed);
    keep(&mut primitive.normals, &placed);
    keep(&mut primitive.uvs, &placed);
    keep(&mut primitive.colours, &placed);
    Dropped { vertices, triangles: before - primitive.triangles.len() }
}

/// Replaces texture coordinates that are not finite by (0, 0); returns how many.
pub(super) fn place_uvs(uvs: &mut [Vec2]) -> usize {
    let mut count = 0;
    for uv in uvs.iter_mut().filter(|uv| !uv.is_finite()) {
        (*uv, count) = (Vec2::ZERO, count + 1);
    }
    count
}

/// A colour within [0, 1]; white where it is not a number.
pub(super) fn clamp_colour(colour: [f32; 3]) -> [f32; 3] {
    colour.map(|c| if c.is_nan() { 1.0 } else { c.clamp(0.0, 1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn what_has_no_place_goes_and_the_rest_keeps_its_looks() {
        let mut p = Primitive {
            positions: vec![Vec3::NAN, Vec3::X, Vec3::Y, Vec3::Z, Vec3::INFINITY],
            colours: (0..5).map(|k| [k as f32 / 4.0; 3]).collect(),
            triangles: vec![[0, 1, 2], [3, 2, 1], [4, 2, 1]],
            ..Primitive::default()
        };
        assert_eq!(drop_unplaced(&mut p), Dropped { vertices: 2, triangles: 2 });
        assert_eq!(p.positions, [Vec3::X, Vec3::Y, Vec3::Z]);
        assert_eq!(p.triangles, [[2, 1, 0]]);
        assert_eq!(p.colours, [[0.25; 3], [0.5; 3], [0.75; 3]]);
        assert_eq!(drop_unplaced(&mut p), Dropped::default());
    }

    #[test]
    fn looks_that_are_no_numbers_are_made_anew() {
        let mut uvs = [Vec2::ONE, Vec2::new(f32::NAN, 0.5)];
        assert_eq!((place_uvs(&mut uvs), uvs), (1, [Vec2::ONE, Vec2::ZERO]));
        assert_eq!(clamp_colour([f32::NAN, -2.0, 1.5]), [1.0, 0.0, 1.0]);
    }
}
