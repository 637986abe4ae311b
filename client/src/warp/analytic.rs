//! Analytic scenes: planes, spheres and fences with a smooth texture, their layered depth images by
//! ray casting, and ground truth from any eye. Used by tests and by `ldi-bench numerics` only.

use glam::DVec3;
use ldi_protocol::{
    OutputCamera, Pose, ViewBasis,
    ldi::{DisparityCodes, LINK_DOWN, LINK_RIGHT, Ldi, LdiCamera, LdiLayer, Segment},
};

/// A surface.
#[derive(Debug, Clone, Copy)]
pub enum Surface {
    /// All points p with n . (p - point) = 0 that lie within `half` of the point along two axes.
    Rectangle {
        /// Its middle.
        point: DVec3,
        /// Unit vector.
        across: DVec3,
        /// Unit vector, perpendicular to it.
        up: DVec3,
        /// Half the extents along both, metres.
        half: [f64; 2],
    },
    /// A sphere.
    Sphere {
        /// Middle.
        centre: DVec3,
        /// Metres.
        radius: f64,
    },
    /// Vertical bars in the plane z = `z`: solid where x modulo `period` is below `solid`.
    Fence {
        /// Metres.
        z: f64,
        /// Metres.
        period: f64,
        /// Metres.
        solid: f64,
    },
}

impl Surface {
    /// Ray parameters of the hits.
    fn hits(&self, origin: DVec3, ray: DVec3) -> Vec<f64> {
        match *self {
            Self::Rectangle { point, across, up, half } => {
                let n = across.cross(up);
                let t = n.dot(point - origin) / n.dot(ray);
                let p = origin + ray * t - point;
                let inside = p.dot(across).abs() <= half[0] && p.dot(up).abs() <= half[1];
                if inside { vec![t] } else { vec![] }
            }
            Self::Sphere { centre, radius } => {
                let (o, a) = (origin - centre, ray.length_squared());
                let b = o.dot(ray);
                let q = b * b - a * (o.length_squared() - radius * radius);
                if q < 0.0 { vec![] } else { vec![(-b - q.sqrt()) / a] }
            }
            Self::Fence { z, period, solid } => {
                let t = (z - origin.z) / ray.z;
                let x = (origin + ray * t).x;
                if x.rem_euclid(period) < solid { vec![t] } else { vec![] }
            }
        }
    }
}

/// Surfaces and a texture wavelength in metres.
#[derive(Debug, Clone)]
pub struct Scene {
    /// What there is.
    pub surfaces: Vec<Surface>,
    /// Of the texture.
    pub wavelength_m: f64,
}

/// A hit: eye-space depth for rays with unit forward component, colour, surface number.
#[derive(Debug, Clone, Copy)]
pub struct Hit {
    /// Metres.
    pub depth: f64,
    /// sRGB.
    pub rgb: [u8; 3],
    /// Number of the surface.
    pub surface: usize,
}

impl Scene {
    /// What a ray meets, nearest first.
    pub fn hits(&self, origin: DVec3, ray: DVec3) -> Vec<Hit> {
        let mut hits: Vec<Hit> = self
            .surfaces
            .iter()
            .enumerate()
            .flat_map(|(surface, s)| s.hits(origin, ray).into_iter().map(move |depth| (surface, depth)))
            .filter(|(_, depth)| *depth > 1e-9 && depth.is_finite())
            .map(|(surface, depth)| Hit { depth, rgb: self.texture(surface, origin + ray * depth), surface })
            .collect();
        hits.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        hits
    }

    /// A smooth texture, different on every surface.
    fn texture(&self, surface: usize, p: DVec3) -> [u8; 3] {
        let k = std::f64::consts::TAU / self.wavelength_m;
        let tint = [[0.9, 0.6, 0.4], [0.3, 0.8, 0.5], [0.5, 0.4, 0.9]][surface % 3];
        let wave = |q: f64| 0.5 + 0.5 * (q * k).cos();
        let value = 0.3 + 0.7 * wave(p.x + 0.3 * p.z) * wave(p.y - 0.2 * p.z);
        tint.map(|t: f64| (value * t * 255.0 + 0.5) as u8)
    }

    /// The layered depth image with every hit, at most `layers` deep.
    pub fn ldi(&self, camera: LdiCamera, layers: usize) -> Ldi {
        let (w, h) = (camera.width as usize, camera.height as usize);
        let pixels: Vec<Vec<Hit>> = (0..w * h)
            .map(|i| {
                let mut hits = self.hits(camera.cop, camera.ray((i % w) as f64 + 0.5, (i / w) as f64 + 0.5));
                hits.truncate(layers);
                hits
            })
            .collect();
        let disparities = || pixels.iter().flatten().map(|hit| 1.0 / hit.depth);
        let (least, most) = disparities().fold((f64::MAX, 0.0f64), |(a, b), d| (a.min(d), b.max(d)));
        let least = if least > most { 1.0 } else { least };
        let codes =
            DisparityCodes { smallest: least, step: ((most - least) / 65_534.0).max(1e-12), largest_code: u16::MAX };
        let words = w.div_ceil(64);
        let mut sky = vec![0u64; words * h];
        for i in (0..w * h).filter(|i| pixels[*i].is_empty()) {
            sky[i / w * words + i % w / 64] |= 1 << (i % w % 64);
        }
        let deepest = pixels.iter().map(Vec::len).max().unwrap_or(0);
        let layers = (0..deepest)
            .map(|k| {
                let at = |column: usize, row: usize| -> Option<&Hit> {
                    if column < w && row < h { pixels[row * w + column].get(k) } else { None }
                };
                let mut layer = LdiLayer::default();
                for row in 0..h {
                    for base in (0..w).step_by(256) {
                        let first = layer.len() as u32;
                        for column in base..w.min(base + 256) {
                            let Some(hit) = at(column, row) else { continue };
                            let same = |c: usize, r: usize| at(c, r).is_some_and(|n| n.surface == hit.surface);
                            layer.column.push((column - base) as u8);
                            layer.disparity.push(codes.code(1.0 / hit.depth));
                            layer.rgb.push(hit.rgb);
                            let right = if same(column + 1, row) { LINK_RIGHT } else { 0 };
                            let down = if same(column, row + 1) { LINK_DOWN } else { 0 };
                            layer.links.push(right | down);
                        }
                        let count = (layer.len() as u32 - first) as u16;
                        if count > 0 {
                            layer.segments.push(Segment { row: row as u16, column_base: base as u16, first, count });
                        }
                    }
                }
                layer.with_half_ends()
            })
            .collect();
        Ldi { camera, codes, layers, sky, slivers: vec![] }
    }

    /// What an eye sees at the pixel centres: the nearest hits.
    pub fn truth(&self, pose: &Pose, camera: &OutputCamera) -> Vec<Option<Hit>> {
        let basis = pose.basis();
        let (w, h) = (camera.width as usize, camera.height as usize);
        (0..w * h)
            .map(|i| {
                let ray = camera.ray(&basis, (i % w) as f64 + 0.5, (i / w) as f64 + 0.5);
                self.hits(pose.position, ray).first().copied()
            })
            .collect()
    }
}

/// A camera that looks along -Z and sees `fov_deg` horizontally.
pub fn ldi_camera(cop: DVec3, width: u32, height: u32, fov_deg: f64) -> LdiCamera {
    let pixels_per_unit = f64::from(width) * 0.5 / (fov_deg.to_radians() * 0.5).tan();
    LdiCamera {
        cop,
        basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
        pixels_per_unit,
        left: -(width as i32 / 2),
        top: -(height as i32 / 2),
        width,
        height,
    }
}

/// The scenes of the tests by name, around the origin, looking along -Z.
#[cfg(test)]
pub fn scene(name: &str) -> Scene {
    let wall = |z: f64, half: f64| Surface::Rectangle {
        point: DVec3::new(0.0, 0.0, z),
        across: DVec3::X,
        up: DVec3::Y,
        half: [half; 2],
    };
    let surfaces = match name {
        "frontal" => vec![wall(-10.0, 40.0)],
        "slanted" => vec![Surface::Rectangle {
            point: DVec3::new(0.0, 0.0, -10.0),
            across: DVec3::new(1.0, 0.0, 0.8).normalize(),
            up: DVec3::Y,
            half: [100.0; 2],
        }],
        "sphere" => {
            vec![wall(-20.0, 80.0), Surface::Sphere { centre: DVec3::new(0.0, 0.0, -10.0), radius: 2.0 }]
        }
        "fence" => vec![wall(-20.0, 80.0), Surface::Fence { z: -8.0, period: 1.0, solid: 0.3 }],
        "floor" => vec![Surface::Rectangle {
            point: DVec3::new(0.0, -1.6, 0.0),
            across: DVec3::X,
            up: DVec3::Z,
            half: [1e4; 2],
        }],
        other => unreachable!("no test scene {other}"),
    };
    Scene { surfaces, wavelength_m: 4.0 }
}
