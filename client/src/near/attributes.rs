//! Attributes of a triangle at any pixel: barycentric weights, texture coordinates, light.
//!
//! With p the first corner, e1 and e2 the edges from it and r = (x, y, 1) the eye-space ray of a
//! pixel, the ray meets the triangle's plane where the second and third barycentric weights are (A
//! . r) / (D . r) and (B . r) / (D . r), with A = e2 x p, B = p x e1, D = e1 x e2 (Cramer's rule on
//! p + u e1 + v e2 = z r). Linear over linear: perspective-correct, and differentiable for the mip
//! level.

use super::{
    alpha::AlphaBlocks,
    gather::Gathered,
    lane_math::{at, dot, hold, splat3},
    triangle_setup::Projection,
};
use crate::{frame::pack_rgb, simd::Lanes};
use glam::{Mat3, Vec2, Vec3};
use ldi_protocol::{
    mesh::Wrap,
    shade::{light, srgb8_from_linear},
    texture::{Texture, lod_of, sample},
};

/// Linear grey in place of an absent texture.
pub(crate) const ABSENT_TEXEL: [f32; 3] = [0.216; 3];

/// Values for shading any pixel of a triangle.
#[derive(Clone)]
pub(super) struct Attributes<'a> {
    pub id: u32,
    pub a: Vec3,
    pub b: Vec3,
    pub d: Vec3,
    /// The colour, if it is constant.
    pub constant: Option<u32>,
    /// Value at the first corner, differences to the second and to the third.
    pub normal: [Vec3; 3],
    pub colour: [Vec3; 3],
    pub uv: [Vec2; 3],
    pub texture: Option<&'a Texture>,
    blocks: Option<&'a AlphaBlocks>,
    pub texture_size: (u32, u32),
    pub wrap: [Wrap; 2],
    alpha: f32,
    pub unlit: bool,
}

/// Corner values as the first one and differences, for `f0 + u f1 + v f2`.
fn differences<T: Copy + std::ops::Sub<Output = T>>([p, q, r]: [T; 3]) -> [T; 3] {
    [p, q - p, r - p]
}

impl<'a> Attributes<'a> {
    /// Attributes of a triangle by its number; None for an invalid number.
    pub fn new(scene: &'a Gathered<'_>, projection: &Projection, id: u32) -> Option<Self> {
        let draw = scene.draws.get((id >> 8) as usize)?;
        let cluster = scene.cluster(draw);
        let material = scene.material(cluster);
        let corners = cluster.triangles.get((id & 255) as usize)?.map(usize::from);
        let to_eye = projection.eye_from_mesh(draw);
        let positions = match corners.map(|c| cluster.positions.get(c)) {
            [Some(p), Some(q), Some(r)] => [p, q, r].map(|p| to_eye.vertex(cluster.origin, *p)),
            _ => return None,
        };
        let [p, q, r] = positions;
        // Subtract in f64: edges of small, distant triangles keep their digits.
        let (e1, e2, p) = ((q - p).as_vec3(), (r - p).as_vec3(), p.as_vec3());
        let textured = material.texture.filter(|_| !cluster.uvs.is_empty());
        let factor = Vec3::from_slice(&material.base_colour);
        let factor = if textured.is_some() && scene.texture(material).is_none() {
            factor * Vec3::from(ABSENT_TEXEL)
        } else {
            factor
        };
        let texture = textured.and_then(|_| scene.texture(material));
        let colour = corners.map(|c| factor * cluster.colours.get(c).map_or(Vec3::ONE, |c| Vec3::from(*c)));
        // Normals turn by the inverse transpose; its scale is irrelevant.
        let turn: Mat3 = draw.world_from_mesh.matrix3.inverse().transpose().as_mat3();
        let normal = corners.map(|c| turn * cluster.normals.get(c).copied().unwrap_or(Vec3::Y));
        let mut out = Self {
            id,
            a: e2.cross(p),
            b: p.cross(e1),
            d: e1.cross(e2),
            constant: None,
            normal: differences(normal),
            colour: differences(colour),
            uv: differences(corners.map(|c| cluster.uvs.get(c).copied().unwrap_or(Vec2::ZERO))),
            texture,
            blocks: texture.and_then(|_| scene.blocks(material)),
            texture_size: texture.and_then(Texture::size).unwrap_or((1, 1)),
            wrap: material.wrap,
            alpha: material.base_colour[3],
            unlit: material.unlit,
        };
        let flat = |v: [Vec3; 3]| v[1] == Vec3::ZERO && v[2] == Vec3::ZERO;
        if texture.is_none() && flat(out.colour) && (material.unlit || flat(out.normal)) {
            out.constant = Some(out.lit(out.colour[0], out.normal[0]));
        }
        Some(out)
    }

    /// The ray of a pixel centre, component 1 along forward.
    #[inline]
    fn ray(projection: &Projection, x: f32, y: f32) -> Vec3 {
        let s = 1.0 / projection.focal_px as f32;
        Vec3::new((x - projection.centre_px[0] as f32) * s, (projection.centre_px[1] as f32 - y) * s, 1.0)
    }

    /// Second and third barycentric weight, and 1 / (D . ray). Clamped to [0, 1], as the pixel
    /// centre may lie slightly outside.
    #[inline]
    fn weights(&self, ray: Vec3) -> (f32, f32, f32) {
        let inverse = 1.0 / self.d.dot(ray);
        // Not `clamp`: the NaN of an edge-on triangle becomes 0.
        let hold = |w: f32| if w > 0.0 { w.min(1.0) } else { 0.0 };
        (hold(self.a.dot(ray) * inverse), hold(self.b.dot(ray) * inverse), inverse)
    }

    /// Texture coordinates at a pixel centre.
    #[cfg(test)]
    pub fn uv_at(&self, projection: &Projection, x: f32, y: f32) -> Vec2 {
        let (u, v, _) = self.weights(Self::ray(projection, x, y));
        self.uv[0] + self.uv[1] * u + self.uv[2] * v
    }

    /// [`weights`](Self::weights) of eight pixels.
    #[inline(always)]
    pub fn weights8<L: Lanes>(&self, ray: [L::F; 3]) -> ([L::F; 2], L::F) {
        let inverse = L::div(L::splat(1.0), dot::<L>(splat3::<L>(self.d), ray));
        let u = hold::<L>(L::mul(dot::<L>(splat3::<L>(self.a), ray), inverse));
        let v = hold::<L>(L::mul(dot::<L>(splat3::<L>(self.b), ray), inverse));
        ([u, v], inverse)
    }

    /// At which of eight pixel centres texture alpha times factor reaches the cutoff: the bits of
    /// `wanted` that stay set.
    #[inline(always)]
    pub fn passes8<L: Lanes>(&self, ray: [L::F; 3], cutoff: f32, wanted: u32) -> u32 {
        let (Some(texture), Some(blocks)) = (self.texture, self.blocks) else {
            return if self.alpha >= cutoff { wanted } else { 0 };
        };
        let ([u, v], _) = self.weights8::<L>(ray);
        let [f, g, h] = self.uv;
        let uv = [at::<L>(f.x, g.x, h.x, u, v), at::<L>(f.y, g.y, h.y, u, v)];
        blocks.passes8::<L>(texture, uv, self.wrap, [self.alpha, cutoff], wanted)
    }

    /// The colour at a pixel centre.
    #[inline]
    pub fn shade(&self, projection: &Projection, x: f32, y: f32) -> u32 {
        let (u, v, inverse) = self.weights(Self::ray(projection, x, y));
        let mut colour = self.colour[0] + self.colour[1] * u + self.colour[2] * v;
        if let Some(texture) = self.texture {
            let uv = self.uv[0] + self.uv[1] * u + self.uv[2] * v;
            // Derivatives of (A . r) / (D . r) by columns and rows.
            let step = inverse / projection.focal_px as f32;
            let along = |i: usize, sign: f32| {
                let (du, dv) = (self.a[i] - u * self.d[i], self.b[i] - v * self.d[i]);
                (self.uv[1] * du + self.uv[2] * dv) * (step * sign)
            };
            let lod = lod_of(self.texture_size, along(0, 1.0), along(1, -1.0));
            colour *= Vec3::from(sample(texture, uv, lod, self.wrap).0);
        }
        self.lit(colour, self.normal[0] + self.normal[1] * u + self.normal[2] * v)
    }

    #[inline]
    fn lit(&self, colour: Vec3, normal: Vec3) -> u32 {
        let amount = if self.unlit { 1.0 } else { light(normal.normalize_or_zero().to_array()) };
        pack_rgb((colour * amount).to_array().map(srgb8_from_linear))
    }
}
