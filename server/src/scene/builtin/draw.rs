//! Shapes and the scene under construction. Sizes in metres, mesh space, Y up.

use super::paint;
use crate::scene::{Instance, Mesh, Primitive, Scene};
use glam::{DAffine3, DVec3, Vec2, Vec3};
use ldi_protocol::mesh::{Alpha, Material, Wrap};
use std::f64::consts::{PI, TAU};

/// A scene under construction.
#[derive(Debug, Default)]
pub struct Draft {
    /// The scene so far.
    pub scene: Scene,
}

impl Draft {
    /// A textured material; `tint` multiplies the texture, linear.
    pub fn paint(&mut self, pattern: paint::Pattern, tint: [f32; 3]) -> u32 {
        let name = format!("{pattern:?}");
        let texture = match self.scene.textures.iter().position(|t| t.name == name) {
            Some(t) => t,
            None => {
                self.scene.textures.push(paint::texture(pattern, name));
                self.scene.textures.len() - 1
            }
        };
        let alpha = if pattern == paint::Pattern::Leaf { Alpha::Mask(0.5) } else { Alpha::Opaque };
        self.scene.materials.push(Material {
            base_colour: [tint[0], tint[1], tint[2], 1.0],
            texture: Some(texture as u32),
            alpha,
            unlit: false,
            double_sided: alpha != Alpha::Opaque,
            wrap: [Wrap::Repeat; 2],
        });
        (self.scene.materials.len() - 1) as u32
    }

    /// Adds a mesh; empty shapes are left out.
    pub fn mesh(&mut self, name: &str, shapes: impl IntoIterator<Item = Shape>) -> u32 {
        let primitives = shapes.into_iter().map(|s| s.0).filter(|p| !p.triangles.is_empty()).collect();
        self.scene.meshes.push(Mesh { name: name.into(), primitives });
        (self.scene.meshes.len() - 1) as u32
    }

    /// Places a mesh: scaled, turned by `yaw_deg` about Y, moved.
    pub fn place(&mut self, mesh: u32, at: DVec3, yaw_deg: f64, scale: f64) {
        self.place_by(
            mesh,
            DAffine3::from_scale_rotation_translation(
                DVec3::splat(scale),
                glam::DQuat::from_rotation_y(yaw_deg.to_radians()),
                at,
            ),
        );
    }

    /// Places a mesh by any affine map.
    pub fn place_by(&mut self, mesh: u32, world_from_mesh: DAffine3) {
        let node = self.scene.instances.len() as u32;
        self.scene.instances.push(Instance { node, mesh, world_from_mesh });
    }
}

/// One primitive under construction.
#[derive(Debug, Clone, Default)]
pub struct Shape(Primitive);

impl Shape {
    /// An empty shape of a material.
    pub fn new(material: u32) -> Self {
        Self(Primitive { material, ..Primitive::default() })
    }

    fn vertex(&mut self, p: DVec3, n: DVec3, uv: (f64, f64)) -> u32 {
        self.0.positions.push(p.as_vec3());
        self.0.normals.push(n.normalize_or(DVec3::Y).as_vec3());
        self.0.uvs.push(Vec2::new(uv.0 as f32, uv.1 as f32));
        (self.0.positions.len() - 1) as u32
    }

    /// A patch of `nu` by `nv` quads over the unit square: `at` gives position, normal and texture
    /// coordinates. Counter-clockwise as seen from where (du x dv) points.
    #[must_use]
    pub fn patch(mut self, nu: u32, nv: u32, at: impl Fn(f64, f64) -> (DVec3, DVec3, (f64, f64))) -> Self {
        let first = self.0.positions.len() as u32;
        for j in 0..=nv {
            for i in 0..=nu {
                let (p, n, uv) = at(f64::from(i) / f64::from(nu), f64::from(j) / f64::from(nv));
                self.vertex(p, n, uv);
            }
        }
        for j in 0..nv {
            for i in 0..nu {
                let a = first + j * (nu + 1) + i;
                let (b, c, d) = (a + 1, a + nu + 2, a + nu + 1);
                self.0.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        self
    }

    /// A rectangle from `corner` along two edges, textured at one repeat per metre.
    #[must_use]
    pub fn rect(self, corner: DVec3, du: DVec3, dv: DVec3) -> Self {
        let (n, lu, lv) = (du.cross(dv), du.length(), dv.length());
        self.patch(1, 1, |u, v| (corner + du * u + dv * v, n, (u * lu, v * lv)))
    }

    /// A box.
    #[must_use]
    pub fn cuboid(self, min: DVec3, max: DVec3) -> Self {
        let s = max - min;
        let (x, y, z) = (DVec3::X * s.x, DVec3::Y * s.y, DVec3::Z * s.z);
        self.rect(min, y, x).rect(min + z, x, y).rect(min, z, y).rect(min + x, y, z).rect(min, x, z).rect(min + y, z, x)
    }

    /// A surface of revolution about Y through `profile` (radius, height), `around` quads about
    /// and `along` between neighbouring profile points; smooth across the profile only where
    /// `smooth`.
    #[must_use]
    pub fn lathe(mut self, profile: &[(f64, f64)], around: u32, along: u32, smooth: bool) -> Self {
        let slope = |k: usize| {
            let (a, b) = (profile[k], profile[k + 1]);
            DVec3::new(b.1 - a.1, a.0 - b.0, 0.0).normalize_or(DVec3::X)
        };
        for k in 0..profile.len() - 1 {
            let (a, b) = (profile[k], profile[k + 1]);
            let here = slope(k);
            let (na, nb) = if smooth {
                let before = if k > 0 { slope(k - 1) } else { here };
                let after = if k + 2 < profile.len() { slope(k + 1) } else { here };
                (here + before, here + after)
            } else {
                (here, here)
            };
            self = self.patch(around, along, |u, v| {
                let (s, c) = (-u * TAU).sin_cos();
                let (r, y) = (a.0 + (b.0 - a.0) * v, a.1 + (b.1 - a.1) * v);
                let n = na.lerp(nb, v);
                (
                    DVec3::new(r * c, y, r * s),
                    DVec3::new(n.x * c, n.y, n.x * s),
                    (u * 4.0 * (a.0.max(b.0)).max(0.25), y),
                )
            });
        }
        self
    }

    /// A tube along +Z from 0 to `length`.
    #[must_use]
    pub fn tube(self, radius: f64, length: f64, around: u32, along: u32) -> Self {
        self.patch(around, along, |u, v| {
            let (s, c) = (u * TAU).sin_cos();
            let n = DVec3::new(c, s, 0.0);
            (n * radius + DVec3::Z * (length * v), n, (u * TAU * radius, v * length))
        })
    }

    /// A quarter of a torus: leaves the origin along +Z, turns toward +X around the point (bend,
    /// 0, 0).
    #[must_use]
    pub fn elbow(self, radius: f64, bend: f64, around: u32, along: u32) -> Self {
        self.patch(around, along, |u, v| {
            let (s, c) = (-u * TAU).sin_cos();
            let (sa, ca) = (v * PI * 0.5).sin_cos();
            let outward = DVec3::new(-ca, 0.0, sa);
            let n = outward * c + DVec3::Y * s;
            (DVec3::X * bend + outward * bend + n * radius, n, (u * TAU * radius, v * bend * PI * 0.5))
        })
    }

    /// A ball.
    #[must_use]
    pub fn ball(self, centre: DVec3, radius: f64, around: u32, along: u32) -> Self {
        self.patch(around, along, |u, v| {
            let (s, c) = (-u * TAU).sin_cos();
            let (sp, cp) = ((v - 0.5) * PI).sin_cos();
            let n = DVec3::new(cp * c, sp, cp * s);
            (centre + n * radius, n, (u * TAU * radius, v * PI * radius))
        })
    }

    /// Adds another shape of the same material.
    #[must_use]
    pub fn with(mut self, other: Self) -> Self {
        let first = self.0.positions.len() as u32;
        self.0.positions.extend(other.0.positions);
        self.0.normals.extend(other.0.normals);
        self.0.uvs.extend(other.0.uvs);
        self.0.triangles.extend(other.0.triangles.iter().map(|t| t.map(|i| i + first)));
        self
    }

    /// Multiplies vertex colours by a field over positions: shade that errors in position make
    /// visible.
    #[must_use]
    pub fn shaded(mut self, tone: impl Fn(Vec3) -> f32) -> Self {
        self.0.colours = self.0.positions.iter().map(|p| [tone(*p).clamp(0.0, 1.0); 3]).collect();
        self
    }

    /// Moves and turns everything drawn so far.
    #[must_use]
    pub fn moved(mut self, by: DAffine3) -> Self {
        let normals = by.matrix3.inverse().transpose();
        for p in &mut self.0.positions {
            *p = by.transform_point3(p.as_dvec3()).as_vec3();
        }
        for n in &mut self.0.normals {
            *n = (normals * n.as_dvec3()).normalize_or(DVec3::Y).as_vec3();
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every triangle's winding agrees with its normals: counter-clockwise from outside.
    fn assert_outward(name: &str, shape: &Shape) {
        let p = &shape.0;
        for t in &p.triangles {
            let [a, b, c] = t.map(|i| p.positions[i as usize]);
            let n = t.map(|i| p.normals[i as usize]).iter().sum::<Vec3>();
            let face = (b - a).cross(c - a);
            assert!(face.length() < 1e-9 || face.dot(n) > 0.0, "{name}: {a} {b} {c}");
        }
    }

    #[test]
    fn windings_agree_with_normals() {
        let s = || Shape::new(0);
        assert_outward("box", &s().cuboid(DVec3::ZERO, DVec3::new(1.0, 2.0, 3.0)));
        assert_outward("tube", &s().tube(0.2, 2.0, 8, 2));
        assert_outward("elbow", &s().elbow(0.2, 0.6, 8, 4));
        assert_outward("ball", &s().ball(DVec3::ZERO, 1.0, 8, 6));
        assert_outward("lathe", &s().lathe(&[(0.0, 0.0), (1.0, 0.0), (0.5, 1.0), (0.0, 1.0)], 8, 2, false));
    }

    #[test]
    fn normals_point_outward() {
        let ball = Shape::new(0).ball(DVec3::ZERO, 2.0, 8, 6).0;
        assert!(ball.positions.iter().zip(&ball.normals).all(|(p, n)| p.dot(*n) > 1.9));
        let cube = Shape::new(0).cuboid(DVec3::NEG_ONE, DVec3::ONE).0;
        assert!(cube.positions.iter().zip(&cube.normals).all(|(p, n)| p.dot(*n) > 0.9));
    }
}
