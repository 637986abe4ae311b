//! Folds: where a surface turns back on itself at its silhouette.
//!
//! In: layers with ends. Out: slivers that join what the centre of projection sees of a surface to
//! what it does not.
//!
//! A lampshade or a post curves away within the last pixel before its silhouette: the layer that
//! the centre sees and the one behind it end there at one place of the image and at two
//! disparities, and to an eye beside it the step between them is a gap as wide as many pixels.
//! Both ends are known, so the gap is closed by a quadrilateral that the centre sees edge-on. It
//! is one surface if both sides close as they go on outward: the planes at their ends meet within
//! [`MEETS`] pixels.

use super::{
    layers::{RawLayer, open_sides},
    sample::{Sample, Tolerance},
    slivers::Found,
    view::Rig,
};
use ldi_protocol::ldi::{END_PARTS, SIDES, Sliver, end_of};

/// Planes at both ends meet within so many pixels beyond: twice what a circle's do, whose ends are
/// told by quarters of a pixel.
const MEETS: f64 = 1.0;
/// Narrower steps do not show: in steps of disparity, each an eighth of an output pixel for the
/// worst eye.
const LEAST_STEPS: f64 = 2.0;
/// Ends of both sides lie at most so far apart, in parts of a pixel ([`END_PARTS`]): it is one
/// place, and each is told to the nearest part.
const APART: u16 = 1;

/// Slivers across the folds of all layers, in their order.
pub(super) fn find(rig: &Rig, layers: &[RawLayer], tolerance: &Tolerance) -> Vec<Found> {
    let open: Vec<Vec<[bool; 4]>> = layers.iter().map(|l| open_sides(l, rig.window.width)).collect();
    let mut found = Vec::new();
    for (k, front) in layers.iter().enumerate() {
        for (i, (pixel, s)) in front.samples.iter().enumerate() {
            for side in (0..SIDES.len()).filter(|side| open[k][i][*side]) {
                let behind = (k + 1..layers.len()).find_map(|m| {
                    let j = layers[m].samples.binary_search_by_key(pixel, |x| x.0).ok()?;
                    let same = layers[m].samples[j].1.surface == s.surface && open[m][j][side];
                    same.then(|| End::of(&layers[m], j, side))
                });
                let here = End::of(front, i, side);
                if let Some(there) = behind.filter(|there| is_fold(&here, there, tolerance)) {
                    found.extend(joined(rig, *pixel, side, [here, there]));
                }
            }
        }
    }
    found
}

/// Where a sample ends on a side.
#[derive(Debug, Clone, Copy)]
struct End {
    sample: Sample,
    /// Parts of a pixel beyond its centre.
    parts: u16,
    /// Disparity there.
    disparity: f64,
    /// Its change per pixel outward: of the plane at the centre, and from there to the end.
    slopes: [f64; 2],
}

impl End {
    fn of(layer: &RawLayer, i: usize, side: usize) -> Self {
        let sample = layer.samples[i].1;
        let parts = end_of(layer.ends[i], side);
        let [across, down] = SIDES[side];
        let (axis, outward) = (side / 2, f64::from(across + down));
        let slopes = [f64::from(sample.gradient[axis]), layer.slopes[i][axis]].map(|s| s * outward);
        let disparity = f64::from(sample.disparity) + slopes[1] * f64::from(parts) / f64::from(END_PARTS);
        Self { sample, parts, disparity, slopes }
    }
}

/// Whether one surface goes on from one end to the other.
fn is_fold(front: &End, back: &End, tolerance: &Tolerance) -> bool {
    let step = front.disparity - back.disparity;
    let closing = back.slopes[0].max(back.slopes[1]) - front.slopes[0].min(front.slopes[1]);
    front.parts.abs_diff(back.parts) <= APART
        && step >= LEAST_STEPS * f64::from(tolerance.step)
        && step <= MEETS * closing
}

/// The quadrilateral between two ends of a pixel, as wide as the pixel.
fn joined(rig: &Rig, pixel: u32, side: usize, ends: [End; 2]) -> Option<Found> {
    let (axis, [across, down]) = (side / 2, SIDES[side]);
    let parts = f64::from(Sliver::PARTS);
    let centre = [pixel % rig.window.width, pixel / rig.window.width].map(|x| f64::from(x) + 0.5);
    let corner = |end: &End, along: f64| {
        let out = f64::from(across + down) * f64::from(end.parts) / f64::from(END_PARTS);
        let (u, v) = if axis == 0 { (out, along) } else { (along, out) };
        let d = end.disparity + along * f64::from(end.sample.gradient[1 - axis]);
        let place = [centre[0] + u, centre[1] + v].map(|x| (x * parts).round() as i32);
        (d > 0.0).then_some((place, d))
    };
    let [front, back] = &ends;
    let corners = [corner(front, -0.5)?, corner(back, -0.5)?, corner(front, 0.5)?, corner(back, 0.5)?];
    let rgb = std::array::from_fn(|k| front.sample.rgb[k].midpoint(back.sample.rgb[k]));
    Some(Found { corners, rgb })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn end(disparity: f64, slope: f64, parts: u16) -> End {
        End { sample: Sample::default(), parts, disparity, slopes: [0.5 * slope, slope] }
    }

    /// A circle closes at its silhouette; two fins of one surface run side by side, and a bowl
    /// opens.
    #[test]
    fn only_what_closes_is_a_fold() {
        let t = Tolerance { step: 1e-4 };
        // A quarter of a pixel before the silhouette of a circle d = 0.1 +- 0.01 sqrt(x).
        let circle = |side: f64| end(0.1 + side * 0.005, -side * 0.01, 2);
        assert!(is_fold(&circle(1.0), &circle(-1.0), &t));
        let fin = |disparity| end(disparity, -0.01, 2);
        assert!(!is_fold(&fin(0.105), &fin(0.095), &t), "they never meet");
        let bowl = |side: f64| end(0.1 + side * 0.005, side * 0.01, 2);
        assert!(!is_fold(&bowl(1.0), &bowl(-1.0), &t), "they part");
        assert!(!is_fold(&circle(1.0), &end(0.095, 0.01, 0), &t), "it ends elsewhere");
        let thin = |side: f64| end(0.1 + side * 0.9e-4, -side * 0.01, 2);
        assert!(!is_fold(&thin(1.0), &thin(-1.0), &t), "nobody can see that");
    }
}
