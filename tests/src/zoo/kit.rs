//! What the generators share: a scene under construction, and closed shapes beyond those of the
//! built-in scenes.
//!
//! Metres, Y up. Faces are counter-clockwise seen from outside.

use super::Specimen;
use glam::{DAffine3, DQuat, DVec3};
use ldi_protocol::mesh::{Alpha, Material, Wrap};
pub(super) use ldi_server::scene::builtin::{
    draw::{Draft, Shape},
    paint::Pattern,
};

/// Eye height of every specimen, metres.
pub(super) const EYE_M: f64 = 1.6;

/// A scene under construction, with its walked and unwalked places.
pub(super) struct Site {
    pub draft: Draft,
    walked: Vec<DVec3>,
    unwalked: Vec<DVec3>,
}

/// A position.
pub(super) const fn at(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

impl Site {
    pub fn new() -> Self {
        Self { draft: Draft::default(), walked: vec![], unwalked: vec![] }
    }

    /// A material of one colour, linear.
    pub fn plain(&mut self, rgb: [f32; 3]) -> u32 {
        self.draft.scene.materials.push(Material {
            base_colour: [rgb[0], rgb[1], rgb[2], 1.0],
            texture: None,
            alpha: Alpha::Opaque,
            unlit: false,
            double_sided: false,
            wrap: [Wrap::Repeat; 2],
        });
        (self.draft.scene.materials.len() - 1) as u32
    }

    /// A textured material; `tint` multiplies the texture, linear.
    pub fn paint(&mut self, pattern: Pattern, tint: [f32; 3]) -> u32 {
        self.draft.paint(pattern, tint)
    }

    /// Adds a mesh of these shapes and places it once, as it is.
    pub fn put(&mut self, name: &str, shapes: impl IntoIterator<Item = Shape>) {
        let mesh = self.draft.mesh(name, shapes);
        self.draft.place(mesh, DVec3::ZERO, 0.0, 1.0);
    }

    /// Places a mesh, turned about Y.
    pub fn place(&mut self, mesh: u32, at: DVec3, yaw_deg: f64) {
        self.draft.place(mesh, at, yaw_deg, 1.0);
    }

    /// People stand on these points of floors.
    pub fn stand(&mut self, feet: impl IntoIterator<Item = DVec3>) {
        self.walked.extend(feet.into_iter().map(|f| f + DVec3::Y * EYE_M));
    }

    /// Nobody stands on these points of surfaces.
    pub fn never_stand(&mut self, feet: impl IntoIterator<Item = DVec3>) {
        self.unwalked.extend(feet.into_iter().map(|f| f + DVec3::Y * EYE_M));
    }

    /// Nobody's eye is at these points.
    pub fn never_eye(&mut self, eyes: impl IntoIterator<Item = DVec3>) {
        self.unwalked.extend(eyes);
    }

    /// Moves everything drawn and noted so far by moving the instances; vertices stay local.
    pub fn translate(&mut self, by: DVec3) {
        for i in &mut self.draft.scene.instances {
            i.world_from_mesh = DAffine3::from_translation(by) * i.world_from_mesh;
        }
        self.walked.iter_mut().chain(&mut self.unwalked).for_each(|p| *p += by);
    }

    pub fn specimen(mut self, name: &'static str) -> Specimen {
        self.draft.scene.name = name.into();
        Specimen { name, scene: self.draft.scene, eye_height_m: EYE_M, walked: self.walked, unwalked: self.unwalked }
    }
}

/// `n + 1` numbers from `from` to `to`.
pub(super) fn spaced(from: f64, to: f64, n: u32) -> Vec<f64> {
    (0..=n).map(|i| from + (to - from) * f64::from(i) / f64::from(n)).collect()
}

/// 0 below `low`, 1 above `high`, smooth between them.
pub(super) fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Turns +X into a horizontal direction.
fn turn_to(direction: DVec3) -> DQuat {
    DQuat::from_rotation_y((-direction.z).atan2(direction.x))
}

/// Shapes that the built-in scenes do not need.
pub(super) trait Shapes: Sized {
    /// A flat quadrilateral, its corners counter-clockwise.
    fn quad(self, corners: [DVec3; 4]) -> Self;
    /// A closed block between two quadrilaterals, corners counter-clockwise seen from above.
    fn block(self, lower: [DVec3; 4], upper: [DVec3; 4]) -> Self;
    /// A closed box whose texture stands upright on all sides.
    fn solid(self, min: DVec3, max: DVec3) -> Self;
    /// A closed box of half extents `half` about `centre`.
    fn boxed(self, centre: DVec3, half: DVec3) -> Self;
    /// A closed cylinder between two points.
    fn rod(self, from: DVec3, to: DVec3, radius: f64, around: u32) -> Self;
    /// A closed box that stands on the line between two points of one height.
    fn bar(self, from: DVec3, to: DVec3, height: f64, thickness: f64) -> Self;
    /// A wall on the line between two points of one height. Openings in order, each
    /// `[distance of its middle from the start, width, low edge, high edge]`.
    fn wall(self, from: DVec3, to: DVec3, height: f64, thickness: f64, openings: &[[f64; 4]]) -> Self;
    /// A railing 1 m high: posts, a handrail and two bars.
    fn railing(self, from: DVec3, to: DVec3) -> Self;
    /// Straight stairs: treads as boxes from the middle of the lower edge along `direction`;
    /// `size` holds tread depth, rise and width.
    fn flight(self, foot: DVec3, direction: DVec3, treads: u32, size: DVec3) -> Self;
    /// A height field over a grid; `keep` chooses its cells by their middle.
    fn ground(self, xs: &[f64], zs: &[f64], height: impl Fn(f64, f64) -> f64, keep: impl Fn(f64, f64) -> bool) -> Self;
    /// Ellipsoid.
    fn blob(self, centre: DVec3, radii: DVec3, around: u32, along: u32) -> Self;
}

impl Shapes for Shape {
    fn quad(self, [a, b, c, d]: [DVec3; 4]) -> Self {
        let normal = (c - a).cross(d - b);
        let (lu, lv) = ((b - a).length(), (d - a).length());
        self.patch(1, 1, |u, v| (a.lerp(b, u).lerp(d.lerp(c, u), v), normal, (u * lu, v * lv)))
    }

    fn block(mut self, lower: [DVec3; 4], upper: [DVec3; 4]) -> Self {
        self = self.quad(upper).quad([lower[3], lower[2], lower[1], lower[0]]);
        for i in 0..4 {
            let j = (i + 1) % 4;
            self = self.quad([lower[i], lower[j], upper[j], upper[i]]);
        }
        self
    }

    fn solid(self, min: DVec3, max: DVec3) -> Self {
        let corners = |y: f64| [at(min.x, y, max.z), at(max.x, y, max.z), at(max.x, y, min.z), at(min.x, y, min.z)];
        self.block(corners(min.y), corners(max.y))
    }

    fn boxed(self, centre: DVec3, half: DVec3) -> Self {
        self.solid(centre - half, centre + half)
    }

    fn rod(self, from: DVec3, to: DVec3, radius: f64, around: u32) -> Self {
        let length = (to - from).length();
        // `with` takes over the triangles alone, so this material does not matter.
        let rod = Shape::new(0).lathe(&[(0.0, 0.0), (radius, 0.0), (radius, length), (0.0, length)], around, 1, false);
        let turn = DQuat::from_rotation_arc(DVec3::Y, (to - from) / length);
        self.with(rod.moved(DAffine3::from_rotation_translation(turn, from)))
    }

    fn bar(self, from: DVec3, to: DVec3, height: f64, thickness: f64) -> Self {
        self.wall(from, to, height, thickness, &[])
    }

    fn wall(self, from: DVec3, to: DVec3, height: f64, thickness: f64, openings: &[[f64; 4]]) -> Self {
        let length = (to - from).length();
        let mut wall = Shape::new(0);
        let mut piece = |x0: f64, x1: f64, low: f64, high: f64| {
            if x1 - x0 > 1e-6 && high - low > 1e-6 {
                let s = thickness * 0.5;
                wall = std::mem::take(&mut wall).solid(at(x0, low, -s), at(x1, high, s));
            }
        };
        let mut done = 0.0;
        for &[middle, width, low, high] in openings {
            let (x0, x1) = (middle - width * 0.5, middle + width * 0.5);
            piece(done, x0, 0.0, height);
            piece(x0, x1, 0.0, low);
            piece(x0, x1, high, height);
            done = x1;
        }
        piece(done, length, 0.0, height);
        self.with(wall.moved(DAffine3::from_rotation_translation(turn_to(to - from), from)))
    }

    fn railing(mut self, from: DVec3, to: DVec3) -> Self {
        let posts = ((to - from).length() / 1.2).ceil() as u32;
        for t in spaced(0.0, 1.0, posts) {
            let foot = from.lerp(to, t);
            self = self.boxed(foot + DVec3::Y * 0.5, at(0.025, 0.5, 0.025));
        }
        for y in [0.4, 0.7, 1.0] {
            self = self.bar(from + DVec3::Y * (y - 0.02), to + DVec3::Y * (y - 0.02), 0.05, 0.04);
        }
        self
    }

    fn flight(self, foot: DVec3, direction: DVec3, treads: u32, size: DVec3) -> Self {
        let mut flight = Shape::new(0);
        for i in 0..treads {
            let (x, y) = (f64::from(i) * size.x, f64::from(i + 1) * size.y);
            let half = size.z * 0.5;
            flight = flight.solid(at(x, y - size.y - 0.02, -half), at(x + size.x + 0.02, y, half));
        }
        self.with(flight.moved(DAffine3::from_rotation_translation(turn_to(direction), foot)))
    }

    fn ground(
        mut self,
        xs: &[f64],
        zs: &[f64],
        height: impl Fn(f64, f64) -> f64,
        keep: impl Fn(f64, f64) -> bool,
    ) -> Self {
        let e = 0.05;
        let normal = |x: f64, z: f64| {
            let slope = |a: f64, b: f64| (b - a) / (2.0 * e);
            at(-slope(height(x - e, z), height(x + e, z)), 1.0, -slope(height(x, z - e), height(x, z + e)))
        };
        for z in zs.windows(2) {
            for x in xs.windows(2) {
                if keep((x[0] + x[1]) * 0.5, (z[0] + z[1]) * 0.5) {
                    self = self.patch(1, 1, |u, v| {
                        let (x, z) = (if v < 0.5 { x[0] } else { x[1] }, if u < 0.5 { z[0] } else { z[1] });
                        (at(x, height(x, z), z), normal(x, z), (x * 0.5, z * 0.5))
                    });
                }
            }
        }
        self
    }

    fn blob(self, centre: DVec3, radii: DVec3, around: u32, along: u32) -> Self {
        let by = DAffine3::from_scale_rotation_translation(radii, DQuat::IDENTITY, centre);
        self.with(Shape::new(0).ball(DVec3::ZERO, 1.0, around, along).moved(by))
    }
}
