//! Triangle setup: transform, outcodes, near-plane clipping, edge functions, assignment to bands.

use super::{
    gather::{Draw, Gathered, Mask},
    horizon::Horizon,
};
use crate::simd::Lanes;
use glam::{DMat3, DVec3};
use ldi_protocol::{OutputCamera, Pose, mesh::MAX_CLUSTER_TRIANGLES};
use std::ops::Range;

/// Distance of the near plane from the eye along the viewing direction, metres. Eyes nearer to a
/// surface see through it. Smaller: corners lie farther out of the picture, where edge functions
/// in f64 lose bits.
pub const NEAR_PLANE_M: f64 = 0.002;
/// Rows of a band, the unit of parallel work. Fewer rows list triangles more often, more rows
/// balance worse.
pub(super) const BAND_ROWS: usize = 32;

/// Triangle number of a pixel that no triangle covers.
pub(super) const NO_TRIANGLE: u32 = u32::MAX;

/// The camera in the world, f64. Eye space here is (right, up, forward): depth is the third
/// coordinate, positive ahead.
pub(super) struct Projection {
    eye: DVec3,
    /// Rows are right, up and forward.
    eye_from_world: DMat3,
    pub focal_px: f64,
    pub centre_px: [f64; 2],
    half_tan: [f64; 2],
    pub width: usize,
    pub height: usize,
}

/// A cluster's mesh space to eye space.
pub(super) struct EyeFromMesh {
    matrix: DMat3,
    translation: DVec3,
}

impl EyeFromMesh {
    /// Eye-space position of a vertex. Mesh positions are exact in f64 (origin and offset lie on
    /// one grid of powers of two), so a vertex that several clusters share comes out the same in
    /// all.
    #[inline]
    pub fn vertex(&self, origin: DVec3, offset: glam::Vec3) -> DVec3 {
        self.matrix * (origin + offset.as_dvec3()) + self.translation
    }
}

impl Projection {
    pub fn new(camera: &OutputCamera, pose: &Pose) -> Self {
        let b = pose.basis();
        Self {
            eye: pose.position,
            eye_from_world: DMat3::from_cols(b.right, b.up, b.forward).transpose(),
            focal_px: camera.focal_px(),
            centre_px: [f64::from(camera.width) * 0.5, f64::from(camera.height) * 0.5],
            half_tan: [camera.half_tan_x(), camera.half_tan_y()],
            width: camera.width as usize,
            height: camera.height as usize,
        }
    }

    /// The rays of eight pixel centres in one row, component 1 along forward.
    #[inline(always)]
    pub fn rays8<L: Lanes>(&self, x: L::F, y: f32) -> [L::F; 3] {
        let scale = 1.0 / self.focal_px as f32;
        [
            L::mul(L::sub(x, L::splat(self.centre_px[0] as f32)), L::splat(scale)),
            L::splat((self.centre_px[1] as f32 - y) * scale),
            L::splat(1.0),
        ]
    }

    pub fn eye_from_mesh(&self, draw: &Draw) -> EyeFromMesh {
        let m = &draw.world_from_mesh;
        EyeFromMesh {
            matrix: self.eye_from_world * m.matrix3,
            translation: self.eye_from_world * (m.translation - self.eye),
        }
    }

    /// One bit per plane that has the point on its outer side: left, right, bottom, top, near.
    #[inline]
    fn outcode(&self, p: DVec3) -> u8 {
        let (x, y) = (self.half_tan[0] * p.z, self.half_tan[1] * p.z);
        u8::from(p.x < -x)
            | u8::from(p.x > x) << 1
            | u8::from(p.y < -y) << 2
            | u8::from(p.y > y) << 3
            | u8::from(p.z < NEAR_PLANE_M) << 4
    }

    /// Position in the picture, to a 256th of a pixel.
    #[inline]
    fn project(&self, p: DVec3) -> [f64; 2] {
        let s = self.focal_px / p.z;
        [self.centre_px[0] + p.x * s, self.centre_px[1] - p.y * s].map(snapped)
    }
}

/// Rounds to a 256th of a pixel, the precision of GPUs (Direct3D requires eight bits, Vulkan
/// drivers offer them): a vertical edge through pixel centres is then on the same side for both.
/// Edge functions of corners within 2^18 pixels are exact in f64.
#[inline]
fn snapped(px: f64) -> f64 {
    /// Numbers of this size are multiples of a 256th: adding it rounds.
    const ROUNDS: f64 = (3u64 << 51) as f64 / 256.0;
    (px + ROUNDS) - ROUNDS
}

const OUT_NEAR: u8 = 1 << 4;

/// A triangle on the screen, ready for its rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Triangle {
    /// Edge functions `a x + b y + c`, positive inside.
    pub a: [f64; 3],
    pub b: [f64; 3],
    pub c: [f64; 3],
    /// Disparity plane `a x + b y + c`, 1/m.
    pub disparity_a: f32,
    pub disparity_b: f32,
    pub disparity_c: f64,
    /// Smallest and largest disparity of the corners: near-vertical planes are cut to it.
    pub disparity_range: [f32; 2],
    /// Draw and triangle.
    pub id: u32,
    /// Alpha cutoff per texel; negative for solid triangles.
    pub cutoff: f32,
    /// Columns and rows whose centres the bounds contain.
    pub columns: [u16; 2],
    pub rows: [u16; 2],
}

#[derive(Clone, Copy)]
struct Vertex {
    eye: DVec3,
    screen: [f64; 2],
    out: u8,
}

/// Triangles of some draws, and per band the list of those that touch it. Memory is reused.
#[derive(Debug, Default)]
pub(super) struct Task {
    pub triangles: Vec<Triangle>,
    /// Whether one of them has an alpha test.
    pub any_masked: bool,
    /// Triangle numbers, grouped by band.
    listed: Vec<u32>,
    /// Per band, where its group starts; one more at the end.
    starts: Vec<u32>,
}

impl Task {
    /// The triangles of a band, in drawing order.
    pub fn band(&self, band: usize) -> &[u32] {
        &self.listed[self.starts[band] as usize..self.starts[band + 1] as usize]
    }

    /// Sets up the triangles of some draws.
    pub fn fill(&mut self, scene: &Gathered<'_>, draws: Range<usize>, projection: &Projection, horizon: &Horizon) {
        self.triangles.clear();
        self.any_masked = false;
        let mut vertices = Vec::new();
        for number in draws {
            self.add_draw(scene, number, projection, horizon, &mut vertices);
        }
        self.list_by_band(projection.height.div_ceil(BAND_ROWS));
    }

    fn add_draw(
        &mut self,
        scene: &Gathered<'_>,
        number: usize,
        projection: &Projection,
        horizon: &Horizon,
        vertices: &mut Vec<Vertex>,
    ) {
        let draw = &scene.draws[number];
        let cluster = scene.cluster(draw);
        let cutoff = match scene.mask(cluster) {
            Mask::Solid => -1.0,
            Mask::ByTexel(cutoff) => {
                self.any_masked = true;
                cutoff.max(0.0)
            }
            Mask::Nothing => return,
        };
        let to_eye = projection.eye_from_mesh(draw);
        let (mut all_out, mut any_out) = (u8::MAX, 0);
        vertices.clear();
        vertices.extend(cluster.positions.iter().map(|p| {
            let eye = to_eye.vertex(cluster.origin, *p);
            let out = projection.outcode(eye);
            all_out &= out;
            any_out |= out;
            Vertex { eye, screen: [0.0; 2], out }
        }));
        if all_out != 0 {
            return;
        }
        for v in vertices.iter_mut() {
            if v.out & OUT_NEAR == 0 {
                v.screen = projection.project(v.eye);
            }
        }
        if any_out & OUT_NEAR == 0 && hidden(vertices, projection, horizon) {
            return;
        }
        for (i, corners) in cluster.triangles.iter().take(MAX_CLUSTER_TRIANGLES).enumerate() {
            let [Some(p), Some(q), Some(r)] = corners.map(|c| vertices.get(c as usize)) else { continue };
            if p.out & q.out & r.out != 0 {
                continue;
            }
            let id = (number as u32) << 8 | i as u32;
            if (p.out | q.out | r.out) & OUT_NEAR == 0 {
                self.add_triangle(projection, horizon, [p, q, r], id, cutoff);
            } else {
                self.add_clipped(projection, horizon, [p, q, r], id, cutoff);
            }
        }
    }

    /// Cuts a triangle at the near plane. A cut point is computed from the inner to the outer end,
    /// so that the two triangles of an edge find the same one.
    fn add_clipped(&mut self, projection: &Projection, horizon: &Horizon, corners: [&Vertex; 3], id: u32, cutoff: f32) {
        let mut polygon = [*corners[0]; 4];
        let mut n = 0;
        for i in 0..3 {
            let (p, q) = (corners[i], corners[(i + 1) % 3]);
            let (p_in, q_in) = (p.out & OUT_NEAR == 0, q.out & OUT_NEAR == 0);
            if p_in {
                polygon[n] = *p;
                n += 1;
            }
            if p_in != q_in {
                let (inner, outer) = if p_in { (p.eye, q.eye) } else { (q.eye, p.eye) };
                let t = (inner.z - NEAR_PLANE_M) / (inner.z - outer.z);
                let mut eye = inner + (outer - inner) * t;
                eye.z = NEAR_PLANE_M;
                polygon[n] = Vertex { eye, screen: projection.project(eye), out: 0 };
                n += 1;
            }
        }
        for i in 2..n {
            self.add_triangle(projection, horizon, [&polygon[0], &polygon[i - 1], &polygon[i]], id, cutoff);
        }
    }

    fn add_triangle(
        &mut self,
        projection: &Projection,
        horizon: &Horizon,
        [p, q, r]: [&Vertex; 3],
        id: u32,
        cutoff: f32,
    ) {
        let bounds = |axis: usize, size: usize| {
            let (s, t, u) = (p.screen[axis], q.screen[axis], r.screen[axis]);
            // First and one past the last whole number k with k + 0.5 in [low, high].
            let low = (s.min(t).min(u) - 0.5).ceil().max(0.0) as usize;
            let high = (s.max(t).max(u) - 0.5).floor().min(size as f64) + 1.0;
            (low, (high.max(0.0) as usize).min(size))
        };
        let (left, right) = bounds(0, projection.width);
        let (top, bottom) = bounds(1, projection.height);
        if left >= right || top >= bottom {
            return;
        }
        let depths = [p.eye.z, q.eye.z, r.eye.z];
        let far = depths.into_iter().fold(0.0, f64::max);
        let near = depths.into_iter().fold(f64::INFINITY, f64::min);
        let disparity_range = [(1.0 / far) as f32, (1.0 / near) as f32];
        if horizon.hides([left, right], [top, bottom], disparity_range[1]) {
            return;
        }
        let area = (q.screen[0] - p.screen[0]) * (r.screen[1] - p.screen[1])
            - (q.screen[1] - p.screen[1]) * (r.screen[0] - p.screen[0]);
        let corners = if area > 0.0 {
            [p, q, r]
        } else if area < 0.0 {
            [p, r, q]
        } else {
            return;
        };
        let [mut a, mut b, mut c] = [[0.0; 3]; 3];
        for i in 0..3 {
            let ([x0, y0], [x1, y1]) = (corners[i].screen, corners[(i + 1) % 3].screen);
            a[i] = y0 - y1;
            b[i] = x1 - x0;
            c[i] = x0 * y1 - x1 * y0;
        }
        // The plane n . X = n . p seen along the ray (x, y, 1) has disparity (n . ray) / (n . p).
        // Edges from p keep their relative precision however far the triangle lies.
        let normal = (q.eye - p.eye).cross(r.eye - p.eye);
        let scale = 1.0 / (normal.dot(p.eye) * projection.focal_px);
        let (da, db) = (normal.x * scale, -normal.y * scale);
        let dc = normal.z * scale * projection.focal_px - da * projection.centre_px[0] - db * projection.centre_px[1];
        if !(da.is_finite() && db.is_finite() && dc.is_finite()) {
            return;
        }
        self.triangles.push(Triangle {
            a,
            b,
            c,
            disparity_a: da as f32,
            disparity_b: db as f32,
            disparity_c: dc,
            disparity_range,
            id,
            cutoff,
            columns: [left as u16, right as u16],
            rows: [top as u16, bottom as u16],
        });
    }

    /// Counting sort of the triangles into bands; a triangle over several bands is listed in each.
    fn list_by_band(&mut self, bands: usize) {
        let of = |t: &Triangle| t.rows[0] as usize / BAND_ROWS..=(t.rows[1] as usize - 1) / BAND_ROWS;
        self.starts.clear();
        self.starts.resize(bands + 1, 0);
        for t in &self.triangles {
            for band in of(t) {
                self.starts[band + 1] += 1;
            }
        }
        for band in 0..bands {
            self.starts[band + 1] += self.starts[band];
        }
        self.listed.clear();
        self.listed.resize(self.starts[bands] as usize, 0);
        let mut next = self.starts.clone();
        for (i, t) in self.triangles.iter().enumerate() {
            for band in of(t) {
                self.listed[next[band] as usize] = i as u32;
                next[band] += 1;
            }
        }
    }
}

/// Whether earlier batches hide everything between these vertices, all of which lie before the near
/// plane.
fn hidden(vertices: &[Vertex], projection: &Projection, horizon: &Horizon) -> bool {
    let (mut low, mut high, mut nearest_m) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2], f64::INFINITY);
    for v in vertices {
        for axis in 0..2 {
            low[axis] = low[axis].min(v.screen[axis]);
            high[axis] = high[axis].max(v.screen[axis]);
        }
        nearest_m = nearest_m.min(v.eye.z);
    }
    // Saturating casts: left of and above the picture is 0.
    let range = |axis: usize, size: usize| [(low[axis] as usize).min(size), (high[axis] as usize + 1).min(size)];
    horizon.hides(range(0, projection.width), range(1, projection.height), (1.0 / nearest_m) as f32)
}
