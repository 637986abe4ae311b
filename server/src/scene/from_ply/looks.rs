//! What faces of a PLY file say of their looks: texture coordinates per corner, the number of the
//! picture, colours.
//!
//! In: a smooth surface and the looks of its triangles. Out: primitives, one per picture, whose
//! vertices are split where looks differ.

use std::collections::HashMap;

use glam::Vec2;

use super::super::error::Fault;
use super::super::limits::Limits;
use super::super::model::Primitive;

/// Of all triangles; each list is as long as the triangles' or empty.
#[derive(Debug, Default)]
pub(super) struct Looks {
    /// Of the three corners, v downward.
    pub(super) uvs: Vec<[Vec2; 3]>,
    /// Linear colours.
    pub(super) colours: Vec<[f32; 3]>,
    /// Number of the picture; one that does not exist for none.
    pub(super) pictures: Vec<u32>,
}

/// Primitives by picture, in the order of their numbers; those without triangles stay empty. The
/// material of each is its number.
///
/// # Errors
/// If there are more vertices than [`Limits::vertices`].
pub(super) fn split(
    surface: &Primitive,
    looks: &Looks,
    pictures: usize,
    limits: &Limits,
) -> Result<Vec<Primitive>, Fault> {
    type Key = (u32, [u32; 2], [u32; 3]);
    let parts = pictures.max(1) + usize::from(looks.pictures.iter().any(|p| *p as usize >= pictures.max(1)));
    let mut out: Vec<Primitive> =
        (0..parts).map(|material| Primitive { material: material as u32, ..Primitive::default() }).collect();
    let mut numbers: Vec<HashMap<Key, u32>> = vec![HashMap::new(); parts];
    let mut vertices = 0u64;
    for (t, triangle) in surface.triangles.iter().enumerate() {
        let part = looks.pictures.get(t).map_or(0, |p| (*p as usize).min(parts - 1));
        let (made, numbers) = (&mut out[part], &mut numbers[part]);
        let mut corners = [0; 3];
        for (k, &v) in triangle.iter().enumerate() {
            let uv = looks.uvs.get(t).map(|uvs| uvs[k]).or_else(|| surface.uvs.get(v as usize).copied());
            let colour = looks.colours.get(t).copied().or_else(|| surface.colours.get(v as usize).copied());
            let bits = |x: f32| x.to_bits();
            let key = (v, uv.unwrap_or_default().to_array().map(bits), colour.unwrap_or_default().map(bits));
            corners[k] = *numbers.entry(key).or_insert_with(|| {
                vertices += 1;
                made.positions.push(surface.positions[v as usize]);
                made.normals.push(surface.normals[v as usize]);
                made.uvs.extend(uv);
                made.colours.extend(colour);
                made.positions.len() as u32 - 1
            });
        }
        if vertices > limits.vertices {
            return Err(Fault::too_large("element face", "or more vertices", vertices, limits.vertices));
        }
        made.triangles.push(corners);
    }
    Ok(out)
}
