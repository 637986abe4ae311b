//! Small scenes with known answers, for the tests of this stage.

use crate::scene::{Instance, Mesh, Primitive, Scene, SceneTexture};
use glam::{DAffine3, DVec3, Vec2, Vec3};
use ldi_protocol::mesh::{Alpha, Material, Wrap};

/// Deterministic values in [0, 1).
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }
    /// A point in the cube of this half edge.
    pub fn point(&mut self, half: f64) -> DVec3 {
        (DVec3::new(self.next(), self.next(), self.next()) * 2.0 - 1.0) * half
    }
}

/// An untextured material.
pub fn plain(colour: [f32; 4]) -> Material {
    Material {
        base_colour: colour,
        texture: None,
        alpha: Alpha::Opaque,
        unlit: true,
        double_sided: false,
        wrap: [Wrap::Repeat; 2],
    }
}

/// A scene of one primitive per material, each in an instance of its own.
pub fn scene(parts: Vec<(Primitive, Material)>, textures: Vec<SceneTexture>) -> Scene {
    let mut scene = Scene { textures, ..Scene::default() };
    for (i, (mut primitive, material)) in parts.into_iter().enumerate() {
        primitive.material = i as u32;
        if primitive.normals.is_empty() {
            primitive.normals = vec![Vec3::Y; primitive.positions.len()];
        }
        scene.materials.push(material);
        scene.meshes.push(Mesh { name: String::new(), primitives: vec![primitive] });
        scene.instances.push(Instance { node: i as u32, mesh: i as u32, world_from_mesh: DAffine3::IDENTITY });
    }
    scene
}

/// Random triangles of many sizes around the origin.
pub fn soup(seed: u64, triangles: usize) -> Primitive {
    let mut noise = Noise(seed);
    let mut p = Primitive::default();
    for i in 0..triangles as u32 {
        let (centre, size) = (noise.point(10.0), 0.05 * 60f64.powf(noise.next()));
        p.positions.extend((0..3).map(|_| (centre + noise.point(size)).as_vec3()));
        p.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    p
}

/// A rectangle from `corner` along two edges, uv (0, 0) at the corner.
pub fn quad(corner: Vec3, right: Vec3, down: Vec3) -> Primitive {
    Primitive {
        positions: vec![corner, corner + right, corner + right + down, corner + down],
        normals: vec![right.cross(down).normalize() * -1.0; 4],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
        ..Primitive::default()
    }
}

/// A closed unit sphere of `n` x `2n` quadrilaterals around the origin, with shared vertices.
pub fn sphere(n: u32) -> Primitive {
    let mut p = Primitive::default();
    for j in 0..=n {
        for i in 0..2 * n {
            let (theta, phi) = (f64::from(j) / f64::from(n), f64::from(i) / f64::from(n));
            let (st, ct) = (theta * std::f64::consts::PI).sin_cos();
            let (sp, cp) = (phi * std::f64::consts::PI).sin_cos();
            p.positions.push(DVec3::new(st * cp, ct, st * sp).as_vec3());
        }
    }
    // The poles are single points, whatever the rounding of sin(pi).
    for i in 0..2 * n {
        p.positions[i as usize] = Vec3::Y;
        p.positions[(n * 2 * n + i) as usize] = Vec3::NEG_Y;
    }
    for j in 0..n {
        for i in 0..2 * n {
            let at = |j: u32, i: u32| j * 2 * n + i % (2 * n);
            p.triangles.push([at(j, i), at(j, i + 1), at(j + 1, i)]);
            p.triangles.push([at(j, i + 1), at(j + 1, i + 1), at(j + 1, i)]);
        }
    }
    p.normals.clone_from(&p.positions);
    p
}
