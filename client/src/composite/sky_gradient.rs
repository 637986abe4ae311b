//! A sky with a horizon, in place of the one colour that measured pictures have.
//!
//! In: a frame whose sky has the colour [`SKY`], and its pose and camera. Out: the same, with sky
//! coloured by the elevation of each pixel's direction: from pale at the horizon to blue above,
//! and as ground below. Painted before a supersampled frame is averaged, so that its silhouettes
//! are averaged with the colours behind them.

use crate::frame::{Frame, SKY, Source, pack_rgb};
use ldi_protocol::{OutputCamera, Pose};
use rayon::prelude::*;

/// Colours by elevation: straight up, just above the horizon, just below it, straight down. The
/// step at the horizon shows which way is level. Judgements.
const ZENITH: [f32; 3] = [138.0, 174.0, 224.0];
const ABOVE: [f32; 3] = [224.0, 232.0, 240.0];
const BELOW: [f32; 3] = [184.0, 181.0, 176.0];
const NADIR: [f32; 3] = [132.0, 128.0, 122.0];
/// Colours between straight down and straight up. Fewer: bands; more: the horizon becomes a hard
/// line.
const COLOURS: usize = 512;

/// Pixels of a row that share a colour. The horizon is level in a picture without roll, so that
/// longer runs only make the gradient coarser, and shorter ones slower.
const RUN: usize = 8;

/// The colours by the sine of the elevation, from -1 to 1.
fn colours() -> [u32; COLOURS] {
    std::array::from_fn(|i| {
        let up = 2.0 * (i as f32 + 0.5) / COLOURS as f32 - 1.0;
        let ([from, to], share) = if up > 0.0 { ([ABOVE, ZENITH], up.sqrt()) } else { ([BELOW, NADIR], (-up).sqrt()) };
        pack_rgb(std::array::from_fn(|c| (from[c] + (to[c] - from[c]) * share).round() as u8))
    })
}

/// Colours the sky, and holes that were filled with sky or with nothing.
pub fn paint_sky(frame: &mut Frame, pose: &Pose, camera: &OutputCamera) {
    if frame.is_empty() || frame.source.len() != frame.colour.len() {
        return;
    }
    let basis = pose.basis();
    let ray = |column: f64, row: f64| camera.ray(&basis, column + 0.5, row + 0.5).as_vec3();
    let (first, right, below) = (ray(0.0, 0.0), ray(1.0, 0.0), ray(0.0, 1.0));
    let (per_column, per_row) = (right - first, below - first);
    let colours = colours();
    let width = frame.width as usize;
    let rows = frame.colour.par_chunks_mut(width).zip(frame.source.par_chunks(width)).enumerate();
    rows.with_min_len(16).for_each(|(row, (pixels, sources))| {
        let begin = first + per_row * row as f32;
        for (number, (pixels, sources)) in pixels.chunks_mut(RUN).zip(sources.chunks(RUN)).enumerate() {
            if !pixels.contains(&SKY) {
                continue;
            }
            let direction = begin + per_column * ((number * RUN) as f32 + 0.5 * (pixels.len() - 1) as f32);
            let up = direction.y / direction.length();
            let of_run = colours[((0.5 * (up + 1.0) * COLOURS as f32) as usize).min(COLOURS - 1)];
            for (colour, source) in pixels.iter_mut().zip(sources) {
                let sky = matches!(source, Source::Sky | Source::Filled | Source::Unpainted);
                *colour = if sky && *colour == SKY { of_run } else { *colour };
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::unpack_rgb;
    use glam::DVec3;

    fn painted(pitch_deg: f64, yaw_deg: f64) -> Frame {
        let mut frame = Frame::new(64, 48);
        frame.source.fill(Source::Sky);
        frame.source[5] = Source::Near;
        let pose = Pose { position: DVec3::new(3.0, 1.6, -2.0), yaw_deg, pitch_deg };
        paint_sky(&mut frame, &pose, &OutputCamera { width: 64, height: 48, fov_deg: 60.0 });
        frame
    }

    #[test]
    fn the_horizon_is_level_and_at_eye_height() {
        let frame = painted(0.0, 33.0);
        let at = |column: usize, row: usize| unpack_rgb(frame.colour[row * 64 + column]);
        for column in [0, 20, 63] {
            let [above, below] = [at(column, 23), at(column, 24)].map(|c| c.map(f32::from));
            assert!(above.iter().zip(ABOVE).all(|(c, of)| (c - of).abs() < 25.0), "{above:?}");
            assert!(below.iter().zip(BELOW).all(|(c, of)| (c - of).abs() < 25.0), "{below:?}");
        }
        // Bluer toward the top; looking down shows no sky.
        assert!(at(30, 0)[0] < at(30, 23)[0]);
        let down = painted(-60.0, 0.0);
        assert!(down.colour.iter().all(|c| unpack_rgb(*c)[2] <= BELOW[2] as u8 || *c == SKY));
    }

    #[test]
    fn surfaces_keep_their_colours_even_if_they_are_as_blue() {
        let frame = painted(10.0, 0.0);
        assert_eq!(frame.colour[5], SKY);
        assert!(frame.colour[4] != SKY && frame.colour[6] != SKY);
    }
}
