//! Debug colours: images recoloured by a property of their samples, then warped like any other.
//!
//! In: an [`Ldi`]. Out: the same with other colours: [`coloured_by_layer`] by layer,
//! [`coloured_by_footprint`] by the footprint in the picture, [`coloured_by_links`] by the ends of
//! surfaces, [`coloured_by_age`] by the time since it arrived.

use super::WarpMatrix;
use ldi_protocol::{
    OutputCamera, Pose,
    ldi::{LINK_DOWN, LINK_RIGHT, Ldi},
};

/// Colours of layers 0, 1, 2, 3; deeper ones take the last.
pub const LAYER_COLOURS: [[u8; 3]; 5] = [[200, 200, 200], [230, 159, 0], [0, 158, 115], [0, 114, 178], [213, 94, 0]];

/// The image with its layers in [`LAYER_COLOURS`].
pub fn coloured_by_layer(ldi: &Ldi) -> Ldi {
    recoloured(ldi, |layer, _| LAYER_COLOURS[layer.min(LAYER_COLOURS.len() - 1)])
}

/// The image with its footprints in output pixels as a heat map: dark blue at 0, white at 1, red at
/// 2 and more. Samples behind the eye are black.
pub fn coloured_by_footprint(ldi: &Ldi, pose: &Pose, camera: &OutputCamera) -> Ldi {
    let matrix = WarpMatrix::new(&ldi.camera, pose, camera);
    recoloured(ldi, |_, s| match matrix.footprint(s.u, s.v, s.disparity) {
        None => [0; 3],
        Some(footprint) if footprint <= 1.0 => {
            let rise = |from: f64| (from + (255.0 - from) * footprint) as u8;
            [rise(0.0), rise(0.0), rise(128.0)]
        }
        Some(footprint) => {
            let fall = (255.0 * (2.0 - footprint).clamp(0.0, 1.0)) as u8;
            [255, fall, fall]
        }
    })
}

/// The image with samples that end a surface in red (to the right), green (below) or yellow (both).
pub fn coloured_by_links(ldi: &Ldi) -> Ldi {
    let code = |missing: bool| if missing { 255 } else { 40 };
    recoloured(ldi, |_, s| [code(s.links & LINK_RIGHT == 0), code(s.links & LINK_DOWN == 0), 40])
}

/// The image in one colour by its age, seconds: white when new, dark blue after a minute.
pub fn coloured_by_age(ldi: &Ldi, age_s: f64) -> Ldi {
    let fade = 1.0 - ((1.0 + age_s.max(0.0)).ln() / 61.0f64.ln()).min(1.0);
    let code = |old: f64| (old + (255.0 - old) * fade) as u8;
    let colour = [code(10.0), code(30.0), code(90.0)];
    let mut out = recoloured(ldi, |_, _| colour);
    out.slivers.iter_mut().for_each(|s| s.rgb = colour);
    out
}

/// The colour of slivers in all views.
const SLIVERS: [u8; 3] = [204, 121, 167];

/// A sample as seen by the colouring function, with the image coordinates of its centre.
struct Seen {
    u: f64,
    v: f64,
    disparity: f64,
    links: u8,
}

fn recoloured(ldi: &Ldi, colour: impl Fn(usize, &Seen) -> [u8; 3]) -> Ldi {
    let mut out = ldi.clone();
    out.slivers.iter_mut().for_each(|s| s.rgb = SLIVERS);
    for (number, layer) in out.layers.iter_mut().enumerate() {
        for segment in &layer.segments {
            let first = segment.first as usize;
            for i in first..first + usize::from(segment.count) {
                let seen = Seen {
                    u: f64::from(segment.column_base) + f64::from(layer.column[i]) + 0.5,
                    v: f64::from(segment.row) + 0.5,
                    disparity: ldi.codes.disparity(layer.disparity[i]),
                    links: layer.links[i],
                };
                layer.rgb[i] = colour(number, &seen);
            }
        }
    }
    out
}
