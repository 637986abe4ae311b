//! An image as a flat texture: its colours on a plane, as the first portal system showed rooms
//! beyond a door (Rafferty, Aliaga, Popescu and Lastra 1998, section 2.2).
//!
//! In: a depth image and a plane. Out: the same image with the plane's disparities and all
//! neighbours linked: a textured polygon for the warp. A plane's disparity is affine in column and
//! row, so that the only error is the rounding to codes:
//!
//! ```text
//!   X = C + r(u, v) / d  and  n . (X - P) = 0  give  d = n . r(u, v) / (n . (P - C))
//! ```
//!
//! Seen from the image's centre of projection it equals the image; from elsewhere it looks "like a
//! large painting hanging on the wall". Sky is part of the texture.

use glam::DVec3;
use ldi_protocol::ldi::{DisparityCodes, LINK_DOWN, LINK_RIGHT, Ldi, LdiLayer, Segment};

/// Columns of a segment's block.
const BLOCK: u32 = 256;

/// Moves the first layer of `ldi`, and `sky` where it has only sky, to the plane through `point`
/// with `normal` (any length but zero; world, metres). None if the plane lies behind the centre of
/// projection in some pixel, or runs through it.
pub fn painted_onto(ldi: &Ldi, normal: DVec3, point: DVec3, sky: [u8; 3]) -> Option<Ldi> {
    let camera = &ldi.camera;
    let away = normal.dot(point - camera.cop);
    let disparity = |u: f64, v: f64| normal.dot(camera.ray(u, v)) / away;
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let corners = [(0.5, 0.5), (w - 0.5, 0.5), (0.5, h - 0.5), (w - 0.5, h - 0.5)].map(|(u, v)| disparity(u, v));
    let smallest = corners.into_iter().fold(f64::INFINITY, f64::min);
    let largest = corners.into_iter().fold(0.0, f64::max);
    if !corners.iter().all(|d| d.is_finite() && *d > 0.0) {
        return None;
    }
    const STEPS: u16 = u16::MAX - 1;
    let flat = largest - smallest <= 1e-12 * largest;
    let codes = match flat {
        true => DisparityCodes { smallest, step: smallest, largest_code: 1 },
        false => DisparityCodes { smallest, step: (largest - smallest) / f64::from(STEPS), largest_code: STEPS + 1 },
    };
    let mut layer = LdiLayer::default();
    let mut colours = vec![None; camera.width as usize];
    let mut above: Vec<Option<usize>> = vec![None; camera.width as usize];
    let mut segments = ldi.layers.first().map_or(&[][..], |l| &l.segments).iter().peekable();
    for row in 0..camera.height {
        colours.fill(None);
        for (column, colour) in colours.iter_mut().enumerate() {
            *colour = ldi.is_sky(column as i64, i64::from(row)).filter(|is| *is).map(|_| sky);
        }
        while let Some(s) = segments.next_if(|s| u32::from(s.row) == row) {
            let samples = s.first as usize..s.first as usize + usize::from(s.count);
            let layer = ldi.layers.first()?;
            for i in samples {
                colours[usize::from(s.column_base) + usize::from(layer.column[i])] = Some(layer.rgb[i]);
            }
        }
        for (column, colour) in (0u32..).zip(&colours) {
            let here = layer.len();
            let Some(rgb) = *colour else {
                above[column as usize] = None;
                continue;
            };
            let base = (column / BLOCK * BLOCK) as u16;
            match layer.segments.last_mut() {
                Some(l) if (u32::from(l.row), l.column_base) == (row, base) => l.count += 1,
                _ => layer.segments.push(Segment { row: row as u16, column_base: base, first: here as u32, count: 1 }),
            }
            if column > 0 && colours[column as usize - 1].is_some() {
                layer.links[here - 1] |= LINK_RIGHT;
            }
            if let Some(upper) = above[column as usize].replace(here) {
                layer.links[upper] |= LINK_DOWN;
            }
            layer.column.push((column % BLOCK) as u8);
            layer.disparity.push(codes.code(disparity(f64::from(column) + 0.5, f64::from(row) + 0.5)));
            layer.rgb.push(rgb);
            layer.links.push(0);
        }
    }
    let sky = vec![0; ldi.sky.len()];
    Some(Ldi { camera: *camera, codes, layers: vec![layer.with_half_ends()], sky, slivers: Vec::new() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::unpack_rgb;
    use crate::warp::{FarFrame, PreparedLdi, WarpOptions, warp};
    use ldi_protocol::{OutputCamera, Pose, ViewBasis, ldi::LdiCamera};

    /// 300 x 40 pixels with a hole, sky in one corner, and depths all over the place; red tells the
    /// column, green the row.
    fn image() -> Ldi {
        let (width, height) = (300, 40);
        let camera = LdiCamera {
            cop: DVec3::new(0.3, 1.6, 2.0),
            basis: ViewBasis::from_yaw_pitch(10.0, -3.0),
            pixels_per_unit: 150.0,
            left: -150,
            top: -20,
            width,
            height,
        };
        let codes = DisparityCodes { smallest: 0.05, step: 0.01, largest_code: 100 };
        let (mut layer, mut sky) = (LdiLayer::default(), vec![0u64; 5 * 40]);
        for row in 0..height {
            for column in 0..width {
                if column < 20 && row < 10 {
                    sky[5 * row as usize] |= 1 << column;
                } else if !(60..64).contains(&column) || row > 20 {
                    let (first, base) = (layer.len() as u32, (column / 256 * 256) as u16);
                    match layer.segments.last_mut() {
                        Some(l) if (u32::from(l.row), l.column_base) == (row, base) => l.count += 1,
                        _ => layer.segments.push(Segment { row: row as u16, column_base: base, first, count: 1 }),
                    }
                    layer.column.push((column % 256) as u8);
                    layer.disparity.push(1 + ((column * 7 + row * 13) % 100) as u16);
                    layer.rgb.push([(column / 2) as u8, row as u8, 0]);
                    layer.links.push(0);
                }
            }
        }
        Ldi { camera, codes, layers: vec![layer.with_half_ends()], sky, slivers: vec![] }
    }

    /// A pixel of any picture of the painted image shows the colour of the image where the line of
    /// sight meets the plane: computed in f64, without the warp.
    #[test]
    fn a_painted_plane_looks_as_analysis_says() {
        let ldi = image();
        assert_eq!(ldi.check(), Ok(()));
        let camera = OutputCamera { width: 200, height: 100, fov_deg: 50.0 };
        let mut seen = 0;
        // Parallel to the image, and slanted.
        for normal in [ldi.camera.basis.forward, DVec3::new(0.5, 0.1, -1.0)] {
            let point = DVec3::new(0.0, 1.0, -1.0);
            let painted = painted_onto(&ldi, normal, point, [1, 2, 255]).expect("before the camera");
            assert_eq!(painted.check(), Ok(()));
            assert_eq!(painted.samples(), ldi.samples() + 200, "the sky is painted, the hole is not");
            for (x, y, z, yaw) in [(0.3, 1.6, 2.0, 10.0), (1.4, 1.7, 1.5, 30.0), (-0.8, 1.4, 3.0, -5.0)] {
                let pose = Pose { position: DVec3::new(x, y, z), yaw_deg: yaw, pitch_deg: 0.0 };
                let mut far = FarFrame::new(camera.width, camera.height);
                warp(&PreparedLdi::new(&painted), &pose, &camera, &WarpOptions::default(), &mut far).expect("quads");
                let basis = pose.basis();
                for row in 0..camera.height {
                    for column in 0..camera.width {
                        let ray = camera.ray(&basis, f64::from(column) + 0.5, f64::from(row) + 0.5);
                        let t = normal.dot(point - pose.position) / normal.dot(ray);
                        let hit = ldi.camera.project(pose.position + ray * t).filter(|_| t > 0.0);
                        let Some((u, v, _)) = hit else { continue };
                        // Away from borders: colours between two samples are in question there.
                        let inside = (65.0..298.0).contains(&u) && (12.0..38.0).contains(&v);
                        if !inside {
                            continue;
                        }
                        let (colour, disparity) = far.get((row * camera.width + column) as usize).expect("painted");
                        assert!((f64::from(disparity) * t - 1.0).abs() < 1e-3, "{disparity} at depth {t}");
                        let [r, g, _] = unpack_rgb(colour);
                        let off = (f64::from(r) - (u - 0.5) / 2.0).abs().max((f64::from(g) - (v - 0.5)).abs());
                        assert!(off <= 1.01, "({r}, {g}) where ({u}, {v}) is");
                        seen += 1;
                    }
                }
            }
        }
        assert!(seen > 20_000, "{seen}");
    }

    #[test]
    fn planes_behind_or_through_the_camera_are_refused() {
        let ldi = image();
        let (cop, forward) = (ldi.camera.cop, ldi.camera.basis.forward);
        assert!(painted_onto(&ldi, forward, cop + forward, [0; 3]).is_some());
        assert!(painted_onto(&ldi, -forward, cop + forward, [0; 3]).is_some(), "either side of it");
        assert!(painted_onto(&ldi, forward, cop - forward, [0; 3]).is_none());
        assert!(painted_onto(&ldi, forward, cop, [0; 3]).is_none());
        assert!(painted_onto(&ldi, ldi.camera.basis.right, cop + forward, [0; 3]).is_none(), "edge-on");
        assert!(painted_onto(&ldi, DVec3::ZERO, cop + forward, [0; 3]).is_none());
    }
}
