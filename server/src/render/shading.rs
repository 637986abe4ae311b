//! From a hit to a surface point and its colour.
//!
//! Colour = base colour (factor x texture x vertex colour) x light(n), in linear light, by
//! [`ldi_protocol::shade::light`] with the interpolated normal, never flipped. Textures are read
//! bilinearly in level 0, or trilinearly by the pixel's footprint: the change of the texture
//! coordinate to the neighbouring pixels on the triangle's plane, exact for a plane (ray
//! differentials of Igehy 1999, for rays that share an origin), isotropic like graphics hardware.

use super::{
    geometry::Geometry,
    ray::{Hit, Ray, RayFootprint},
};
use glam::{DVec3, Vec2, Vec3};
use ldi_protocol::{
    mesh::{Alpha, Material},
    shade::light,
    texture::{self, MipLevel, Texture},
};
use rayon::prelude::*;

/// What lies where a ray hit.
#[derive(Debug, Clone, Copy)]
pub struct SurfacePoint {
    /// World, metres: on the ray at the hit's t.
    pub position_world: DVec3,
    /// Unit normal of the triangle by its winding in the world; zero for a triangle without area.
    pub geometric_normal: DVec3,
    /// Unit interpolated normal in the world, never flipped toward the eye.
    pub shading_normal: Vec3,
    /// Texture coordinate; zero where the primitive has none.
    pub uv: Vec2,
    /// Where the triangle comes from.
    pub source: super::TriangleSource,
    /// Position in the scene's materials.
    pub material: u32,
}

/// Textures ready for sampling.
pub(super) struct Textures {
    textures: Vec<Texture>,
}

impl Textures {
    /// Level 0 only, or with all mip levels.
    pub fn new(geometry: &Geometry, mips: bool) -> Self {
        let scene = &geometry.scene;
        let mut masked = vec![false; scene.textures.len()];
        for m in &scene.materials {
            if let (Some(t), Alpha::Mask(_)) = (m.texture, m.alpha) {
                masked[t as usize] = true;
            }
        }
        let textures = scene
            .textures
            .par_iter()
            .zip(masked)
            .map(|(t, masked)| {
                let base = MipLevel { width: t.width, height: t.height, rgba: t.rgba.clone() };
                if mips { Texture::from_base(base, masked) } else { Texture { levels: vec![Some(base)] } }
            })
            .collect();
        Self { textures }
    }

    #[inline]
    pub fn get(&self, texture: u32) -> &Texture {
        &self.textures[texture as usize]
    }
}

/// Whether every hit passes the material's mask: nothing in it can be cut out.
pub(super) fn is_solid(material: &Material) -> bool {
    match material.alpha {
        Alpha::Opaque => true,
        Alpha::Mask(cutoff) => material.texture.is_none() && material.base_colour[3] >= cutoff,
    }
}

fn interpolate_uv(uvs: &[Vec2], vertices: [u32; 3], u: f32, v: f32) -> Vec2 {
    let [a, b, c] = vertices.map(|i| uvs[i as usize]);
    a * (1.0 - u - v) + b * u + c * v
}

pub(super) fn surface(geometry: &Geometry, hit: &Hit, ray: &Ray) -> SurfacePoint {
    let source = geometry.source(hit.triangle);
    let primitive = geometry.primitive(&source);
    let vertices = primitive.triangles[source.triangle as usize];
    let [a, b, c] = geometry.corners_world(hit.triangle);
    let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
    let mesh_normal = vertices.iter().zip(weights).fold(Vec3::ZERO, |n, (i, w)| n + primitive.normals[*i as usize] * w);
    let shading_normal = (geometry.normal_matrices[source.instance as usize] * mesh_normal).normalize_or_zero();
    SurfacePoint {
        position_world: ray.at(hit.t),
        geometric_normal: (b - a).cross(c - a).normalize_or_zero(),
        shading_normal,
        uv: if primitive.uvs.is_empty() { Vec2::ZERO } else { interpolate_uv(&primitive.uvs, vertices, hit.u, hit.v) },
        source,
        material: primitive.material,
    }
}

pub(super) fn shade(
    geometry: &Geometry,
    textures: &Textures,
    hit: &Hit,
    ray: &Ray,
    footprint: Option<&RayFootprint>,
) -> [f32; 3] {
    let source = geometry.source(hit.triangle);
    let primitive = geometry.primitive(&source);
    let material = &geometry.scene.materials[primitive.material as usize];
    let vertices = primitive.triangles[source.triangle as usize];
    let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
    let mut colour = [material.base_colour[0], material.base_colour[1], material.base_colour[2]];
    if let (Some(t), false) = (material.texture, primitive.uvs.is_empty()) {
        let texture = textures.get(t);
        let uv = interpolate_uv(&primitive.uvs, vertices, hit.u, hit.v);
        let (texel, _) = match footprint {
            None => texture::sample_bilinear(texture, uv, material.wrap),
            Some(f) => {
                let corner_uvs = vertices.map(|i| primitive.uvs[i as usize]);
                let lod = level_of_detail(geometry, texture, hit, ray, f, corner_uvs);
                texture::sample(texture, uv, lod, material.wrap)
            }
        };
        colour = std::array::from_fn(|k| colour[k] * texel[k]);
    }
    if !primitive.colours.is_empty() {
        let [a, b, c] = vertices.map(|i| primitive.colours[i as usize]);
        colour = std::array::from_fn(|k| colour[k] * (a[k] * weights[0] + b[k] * weights[1] + c[k] * weights[2]));
    }
    if !material.unlit {
        let mesh_normal =
            vertices.iter().zip(weights).fold(Vec3::ZERO, |n, (i, w)| n + primitive.normals[*i as usize] * w);
        let n = (geometry.normal_matrices[source.instance as usize] * mesh_normal).normalize_or_zero();
        let l = light(n.to_array());
        colour = colour.map(|c| c * l);
    }
    colour
}

/// Level of detail from where the neighbouring pixels' rays meet the triangle's plane.
fn level_of_detail(
    geometry: &Geometry,
    texture: &Texture,
    hit: &Hit,
    ray: &Ray,
    footprint: &RayFootprint,
    uvs: [Vec2; 3],
) -> f32 {
    let Some(size) = texture.size() else { return 0.0 };
    let [a, b, c] = geometry.corners_world(hit.triangle);
    let (ab, ac) = (b - a, c - a);
    let n = ab.cross(ac);
    let facing = n.dot(ray.direction);
    // Moving the direction by s moves the hit by t (s - d (n . s) / (n . d)); barycentric weights
    // change linearly with it.
    let duv = |s: DVec3| {
        let moved = (s - ray.direction * (n.dot(s) / facing)) * hit.t;
        let area2 = n.length_squared();
        let du = moved.cross(ac).dot(n) / area2;
        let dv = ab.cross(moved).dot(n) / area2;
        (uvs[1] - uvs[0]) * du as f32 + (uvs[2] - uvs[0]) * dv as f32
    };
    texture::lod_of(size, duv(footprint.direction_dx), duv(footprint.direction_dy))
}
