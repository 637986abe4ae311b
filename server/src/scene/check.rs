//! What every later stage may rely on, checked.

use glam::{DVec3, Vec3};

use super::error::Fault;
use super::files::shown;
use super::limits::Limits;
use super::model::{Mesh, Primitive, Scene};

/// Squared length of a unit normal after rounding to f32.
const UNIT: std::ops::RangeInclusive<f32> = 0.9999..=1.0001;

/// Bounds the world: the corners of each instance's box stay within the coordinate limit.
pub(super) fn world_within(scene: &Scene, limits: &Limits) -> Result<(), Fault> {
    let bounds: Vec<_> = scene.meshes.iter().map(Mesh::bounds).collect();
    for i in &scene.instances {
        let mesh = &bounds[i.mesh as usize];
        let near =
            |p: DVec3| i.world_from_mesh.transform_point3(p).abs().cmple(DVec3::splat(limits.coordinate_m)).all();
        if !mesh.is_empty() && !mesh.corners().into_iter().all(near) {
            let place = format!("node {}, mesh {}", i.node, shown(&scene.meshes[i.mesh as usize].name));
            let problem = format!("reaches farther than {} m from the origin", limits.coordinate_m);
            return Err(Fault::invalid(place, problem, "move the scene to the origin and scale it to metres"));
        }
    }
    Ok(())
}

impl Scene {
    /// Checks what the fields promise: references in range, values finite, normals of unit length,
    /// placements with an inverse. Importers check their input as they read it; this is for tests
    /// and for scenes made by code.
    ///
    /// # Errors
    /// The first thing that is wrong, in words.
    pub fn check(&self) -> Result<(), String> {
        if self.materials.is_empty() {
            return Err("no materials".into());
        }
        for (m, material) in self.materials.iter().enumerate() {
            if material.texture.is_some_and(|t| t as usize >= self.textures.len()) {
                return Err(format!("material {m}: texture out of range"));
            }
            if !material.base_colour.iter().all(|c| (0.0..=1.0).contains(c)) {
                return Err(format!("material {m}: base colour leaves [0, 1]"));
            }
        }
        for (t, texture) in self.textures.iter().enumerate() {
            let pixels = texture.width as usize * texture.height as usize;
            if pixels == 0 || pixels != texture.rgba.len() {
                return Err(format!(
                    "texture {t}: {} texels for {} x {}",
                    texture.rgba.len(),
                    texture.width,
                    texture.height
                ));
            }
        }
        for (m, mesh) in self.meshes.iter().enumerate() {
            for (p, primitive) in mesh.primitives.iter().enumerate() {
                self.check_primitive(primitive).map_err(|e| format!("mesh {m}, primitive {p}: {e}"))?;
            }
        }
        for (i, instance) in self.instances.iter().enumerate() {
            if instance.mesh as usize >= self.meshes.len() {
                return Err(format!("instance {i}: mesh out of range"));
            }
            let t = &instance.world_from_mesh;
            if !t.is_finite() || !t.inverse().is_finite() {
                return Err(format!("instance {i}: placement has no inverse"));
            }
        }
        Ok(())
    }

    fn check_primitive(&self, p: &Primitive) -> Result<(), String> {
        let vertices = p.positions.len();
        if p.material as usize >= self.materials.len() {
            return Err("material out of range".into());
        }
        let textured = self.materials[p.material as usize].texture.is_some();
        let lengths_agree = p.normals.len() == vertices
            && (p.uvs.len() == vertices || (p.uvs.is_empty() && !textured))
            && (p.colours.len() == vertices || p.colours.is_empty());
        if !lengths_agree {
            return Err("attributes of different lengths".into());
        }
        if p.triangles.as_flattened().iter().any(|&v| v as usize >= vertices) {
            return Err("vertex out of range".into());
        }
        let unit = |n: &Vec3| UNIT.contains(&n.length_squared());
        if !p.positions.iter().all(|v| v.is_finite()) || !p.uvs.iter().all(|v| v.is_finite()) {
            return Err("a value is not finite".into());
        }
        if !p.normals.iter().all(unit) {
            return Err("a normal is not of unit length".into());
        }
        if !p.colours.as_flattened().iter().all(|c| (0.0..=1.0).contains(c)) {
            return Err("a colour leaves [0, 1]".into());
        }
        Ok(())
    }
}
