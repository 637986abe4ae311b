//! Reference images: what an eye sees in all directions, as six square pictures of 90 degrees.
//!
//! In: a place. Out: of every pixel that meets a surface its point, normal, colour and stamp
//! (section 3.1, equations 1 and 2).

use crate::render::{Caster, CellSet, Hit, Ray, RayFootprint};
use glam::{DVec3, Vec3};
use ldi_protocol::tree::across;

/// A surface seen at less than this cosine counts as seen at it: the stamp would be without bound.
const SMALLEST_COSINE: f64 = 0.05;
/// No hits nearer than this, metres: eyes keep 0.05 m from surfaces.
const NEAR_M: f64 = 0.02;

/// A pixel of a reference image.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// World, metres.
    pub position: DVec3,
    /// Unit normal toward the eye.
    pub normal: Vec3,
    /// Linear light.
    pub colour: [f32; 3],
    /// Largest distance to the neighbouring pixels' points on the surface, metres.
    pub stamp_m: f32,
    /// Area of the surface that the pixel covers, square metres.
    pub area_m2: f32,
}

/// What one eye sees.
pub struct Reference {
    /// By face, row, column.
    pub points: Vec<Point>,
    /// Rays cast.
    pub rays: u64,
}

/// Rows and columns of rays that are cast together.
const BLOCK: u32 = 8;

/// Directions of a face's pixels: face f (-x, +x, -y, +y, -z, +z), `side` pixels along each side.
/// Component 1 or -1 along the face's axis.
pub fn direction(face: usize, column: f64, row: f64, side: u32) -> DVec3 {
    let axis = face / 2;
    let [a, b] = across(axis);
    let place = |k: f64| 2.0 * k / f64::from(side) - 1.0;
    let mut d = DVec3::ZERO;
    d[axis] = if face % 2 == 1 { 1.0 } else { -1.0 };
    (d[a], d[b]) = (place(column), place(row));
    d
}

impl Reference {
    /// The reference at a place: images of `side` x `side` pixels to these faces.
    pub fn take(caster: &Caster, position: DVec3, faces: &[usize], side: u32) -> Self {
        let mut out = Self { points: Vec::new(), rays: 0 };
        let (mut rays, mut hits) = (Vec::new(), Vec::new());
        for &face in faces {
            let step = |c: f64, r: f64| direction(face, c, r, side) - direction(face, 0.0, 0.0, side);
            let footprint = RayFootprint { direction_dx: step(1.0, 0.0), direction_dy: step(0.0, 1.0) };
            for top in (0..side).step_by(BLOCK as usize) {
                for left in (0..side).step_by(BLOCK as usize) {
                    rays.clear();
                    for row in top..(top + BLOCK).min(side) {
                        for column in left..(left + BLOCK).min(side) {
                            let d = direction(face, f64::from(column) + 0.5, f64::from(row) + 0.5, side);
                            rays.push(Ray { t_min: NEAR_M, ..Ray::new(position, d) });
                        }
                    }
                    hits.clear();
                    hits.resize(rays.len(), None);
                    caster.trace_batch(&rays, &CellSet::all(), &mut hits);
                    let met = rays.iter().zip(&hits).filter_map(|(ray, hit)| Some((ray, hit.as_ref()?)));
                    out.points.extend(met.filter_map(|(ray, hit)| point(caster, ray, hit, &footprint, side)));
                }
            }
        }
        out.rays = faces.len() as u64 * u64::from(side * side);
        out
    }
}

/// The point of a pixel; None on a triangle without area.
fn point(caster: &Caster, ray: &Ray, hit: &Hit, footprint: &RayFootprint, side: u32) -> Option<Point> {
    let surface = caster.surface(hit, ray);
    let n = surface.geometric_normal;
    if n == DVec3::ZERO {
        return None;
    }
    let along = n.dot(ray.direction);
    let normal = if along > 0.0 { -n } else { n };
    // Equation (2): |a| / disparity; then along the surface.
    let frontal = hit.t * 2.0 / f64::from(side);
    let length = ray.direction.length();
    let cosine = (along.abs() / length).max(SMALLEST_COSINE);
    Some(Point {
        position: surface.position_world,
        normal: normal.as_vec3(),
        colour: caster.shade(hit, ray, Some(footprint)),
        stamp_m: (frontal * length / cosine) as f32,
        area_m2: (frontal * frontal / (cosine * length)) as f32,
    })
}
