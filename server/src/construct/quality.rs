//! How large samples get on the screen, measured over samples, eyes and directions.
//!
//! Footprint: largest singular value of d(output pixel) / d(image pixel) at fixed disparity,
//! rotation included; placement bounds it. Stretch: the same along the surface, disparity changing
//! with the sample's gradient; it has no bound, so it is measured.

use super::{layers::RawLayer, sample::Sample, view::Rig};
use crate::placement::ImagePlan;
use glam::{DVec2, DVec3};
use ldi_protocol::{OutputCamera, ViewBasis};

/// Sizes in output pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Sizes {
    pub footprint_max: f64,
    pub stretch_p99: f64,
    pub stretch_max: f64,
}

/// Samples looked at: enough for a steady percentile.
const LOOKED_AT: usize = 2048;
/// Directions looked in.
const MOST_DIRECTIONS: usize = 24;

/// Measures sizes for samples evenly spread over the layers, from the corners of the users' box.
pub(super) fn measure(rig: &Rig, plan: &ImagePlan, output: &OutputCamera, layers: &[RawLayer]) -> Sizes {
    let total: usize = layers.iter().map(|l| l.samples.len()).sum();
    let stride = total.div_ceil(LOOKED_AT).max(1);
    let mut directions: Vec<ViewBasis> = Vec::new();
    for r in &plan.directions {
        let mid = |x: [f64; 2]| 0.5 * (x[0] + x[1]);
        for (yaw, pitch) in [
            (mid(r.yaw_deg), mid(r.pitch_deg)),
            (r.yaw_deg[0], r.pitch_deg[0]),
            (r.yaw_deg[0], r.pitch_deg[1]),
            (r.yaw_deg[1], r.pitch_deg[0]),
            (r.yaw_deg[1], r.pitch_deg[1]),
        ] {
            directions.push(ViewBasis::from_yaw_pitch(yaw, pitch));
        }
    }
    let skip = directions.len().div_ceil(MOST_DIRECTIONS).max(1);
    let directions: Vec<ViewBasis> = directions.into_iter().step_by(skip).collect();
    let mut sizes = Sizes::default();
    let mut stretches = Vec::new();
    for (pixel, s) in layers.iter().flat_map(|l| &l.samples).step_by(stride) {
        let mut largest = 0.0_f64;
        for eye in plan.users.corners() {
            for basis in &directions {
                if let Some((footprint, stretch)) = sizes_of(rig, *pixel, s, eye, basis, output) {
                    sizes.footprint_max = sizes.footprint_max.max(footprint);
                    largest = largest.max(stretch);
                }
            }
        }
        if largest > 0.0 {
            stretches.push(largest);
        }
    }
    stretches.sort_by(f64::total_cmp);
    if let Some(last) = stretches.last() {
        sizes.stretch_max = *last;
        sizes.stretch_p99 = stretches[(stretches.len() - 1) * 99 / 100];
    }
    sizes
}

/// (footprint, stretch) of a sample in one picture; None outside of it.
fn sizes_of(
    rig: &Rig,
    pixel: u32,
    s: &Sample,
    eye: DVec3,
    basis: &ViewBasis,
    output: &OutputCamera,
) -> Option<(f64, f64)> {
    let (u, v) = rig.window.centre(pixel as usize);
    let f = output.focal_px();
    let project = |u: f64, v: f64, d: f64| {
        let e = rig.cop + rig.lens.ray(u, v) / d - eye;
        let z = e.dot(basis.forward);
        (z > 0.0).then(|| DVec2::new(e.dot(basis.right), -e.dot(basis.up)) * (f / z))
    };
    let d = f64::from(s.disparity);
    let at = project(u, v, d)?;
    if at.x.abs() > 0.5 * f64::from(output.width) || at.y.abs() > 0.5 * f64::from(output.height) {
        return None;
    }
    // Central differences over a hundredth of a pixel: second order, well above rounding.
    const H: f64 = 0.01;
    let spread = |gu: f64, gv: f64| {
        let du = (project(u + H, v, d + gu * H)? - project(u - H, v, d - gu * H)?) / (2.0 * H);
        let dv = (project(u, v + H, d + gv * H)? - project(u, v - H, d - gv * H)?) / (2.0 * H);
        Some(largest_singular_value(du, dv))
    };
    let sizes = (spread(0.0, 0.0)?, spread(f64::from(s.gradient[0]), f64::from(s.gradient[1]))?);
    // A difference across a surface's horizon measures nothing, and would not survive being kept
    // as JSON.
    (sizes.0.is_finite() && sizes.1.is_finite()).then_some(sizes)
}

/// Of the matrix with these columns.
fn largest_singular_value(a: DVec2, b: DVec2) -> f64 {
    let sum = a.length_squared() + b.length_squared();
    let det = a.perp_dot(b);
    (0.5 * (sum + (sum * sum - 4.0 * det * det).max(0.0).sqrt())).sqrt()
}
