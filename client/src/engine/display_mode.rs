//! False-colour displays of a frame, for finding the cause of visible errors.
//!
//! In: a merged frame, or an image before it is warped. Out: the same, recoloured by the mode.

use crate::{
    frame::{Frame, Source, pack_rgb, unpack_rgb},
    warp::debug_colours,
};
use ldi_protocol::{OutputCamera, Pose, ldi::Ldi};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::Arc;

/// What a picture displays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DisplayMode {
    /// The scene in its own colours.
    #[default]
    Scene,
    /// Only pixels drawn from geometry.
    Near,
    /// Only pixels drawn from images.
    Far,
    /// The source of each pixel.
    Sources,
    /// Pixels without known content.
    Holes,
    /// The image layer of each pixel.
    Layers,
    /// The footprint of each image sample.
    Footprints,
    /// The ends of surfaces in images.
    Ends,
    /// The time since an image was laid out.
    Age,
    /// The distance of each pixel.
    Depth,
}

impl DisplayMode {
    /// All modes, in the order of the key that cycles through them.
    pub const ALL: [Self; 10] = [
        Self::Scene,
        Self::Near,
        Self::Far,
        Self::Sources,
        Self::Holes,
        Self::Layers,
        Self::Footprints,
        Self::Ends,
        Self::Age,
        Self::Depth,
    ];

    /// The next mode, or the previous one.
    pub fn next(self, back: bool) -> Self {
        let at = Self::ALL.iter().position(|s| *s == self).unwrap_or(0);
        let n = Self::ALL.len();
        Self::ALL[if back { at + n - 1 } else { at + 1 } % n]
    }

    /// The meaning of the colours.
    pub const fn legend(self) -> &'static str {
        match self {
            Self::Scene => "the scene",
            Self::Near => "geometry alone",
            Self::Far => "images alone",
            Self::Sources => "sources: orange geometry, blue images, green the LDI tree, pink filled, red nothing",
            Self::Holes => "holes: pink filled, red nothing; the rest is dimmed",
            Self::Layers => "layers of images: grey 1, orange 2, green 3, blue 4, red deeper",
            Self::Footprints => "footprints: dark blue 0, white 1 pixel, red 2 pixels and more",
            Self::Ends => "ends of surfaces in images: red to the right, green below, yellow both",
            Self::Age => "age of images: white just laid out, dark blue a minute ago and more",
            Self::Depth => "depth: white near, black far, a tenth of the light for ten times the distance",
        }
    }

    /// Recolours an image before it is warped; None for modes that recolour the finished frame.
    /// `age_s`: seconds since the image was laid out.
    pub fn tint(self, ldi: &Arc<Ldi>, pose: &Pose, camera: &OutputCamera, age_s: f64) -> Option<Arc<Ldi>> {
        Some(Arc::new(match self {
            Self::Layers => debug_colours::coloured_by_layer(ldi),
            Self::Footprints => debug_colours::coloured_by_footprint(ldi, pose, camera),
            Self::Ends => debug_colours::coloured_by_links(ldi),
            Self::Age => debug_colours::coloured_by_age(ldi, age_s),
            _ => return None,
        }))
    }

    /// Recolours a finished frame.
    pub fn recolour(self, frame: &mut Frame) {
        let colour: fn(Source, u32, f32) -> [u8; 3] = match self {
            Self::Scene => return,
            Self::Near => |s, c, _| if s == Source::Near { unpack_rgb(c) } else { NOTHING },
            Self::Far => |s, c, _| if s == Source::Far { unpack_rgb(c) } else { NOTHING },
            Self::Sources => |s, c, _| recoloured(s, c),
            Self::Holes => |s, c, _| match s {
                Source::Filled | Source::Unpainted => SOURCE_COLOURS[s as usize],
                _ => unpack_rgb(c).map(|c| c / 3),
            },
            // Geometry and sky are dimmed, so that the recoloured pixels stand out.
            Self::Layers | Self::Footprints | Self::Ends | Self::Age => |s, c, _| match s {
                Source::Far => unpack_rgb(c),
                _ => unpack_rgb(c).map(|c| c / 3),
            },
            Self::Depth => |s, _, disparity| match s {
                Source::Sky | Source::Unpainted => NOTHING,
                // 0.1 m is white, 1 km black.
                _ => [(255.0 * (0.25 * (disparity.max(1e-9).log10() + 3.0)).clamp(0.0, 1.0)) as u8; 3],
            },
        };
        let sources = frame.source.par_iter().zip(&frame.disparity);
        frame.colour.par_iter_mut().zip(sources).for_each(|(c, (s, d))| *c = pack_rgb(colour(*s, *c, *d)));
    }
}

/// Colour of pixels that a mode leaves out.
const NOTHING: [u8; 3] = [24, 24, 28];

/// False colours of sources: sky, near, far, tree, filled, unpainted. Distinguishable by
/// colour-blind viewers (Okabe and Ito).
const SOURCE_COLOURS: [[u8; 3]; 6] =
    [[198, 214, 235], [230, 159, 0], [0, 114, 178], [0, 158, 115], [204, 121, 167], [213, 94, 0]];

/// The colour of a source, modulated by the picture's brightness so that shapes stay visible.
fn recoloured(source: Source, colour: u32) -> [u8; 3] {
    let [r, g, b] = unpack_rgb(colour).map(u32::from);
    let grey = (r * 299 + g * 587 + b * 114) / 1000;
    SOURCE_COLOURS[source as usize].map(|c| ((u32::from(c) * 2 + grey) / 3) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_goes_through_all_views_and_back() {
        let mut seen = vec![DisplayMode::Scene];
        for _ in 1..DisplayMode::ALL.len() {
            seen.push(seen[seen.len() - 1].next(false));
        }
        assert_eq!(seen, DisplayMode::ALL);
        assert_eq!(seen[seen.len() - 1].next(false), DisplayMode::Scene);
        assert!(DisplayMode::ALL.iter().all(|s| s.next(false).next(true) == *s));
    }

    #[test]
    fn views_show_their_part() {
        let mut frame = Frame::new(3, 1);
        frame.colour = [[10, 20, 30], [200, 100, 50], [90, 90, 90]].map(pack_rgb).to_vec();
        frame.source = vec![Source::Near, Source::Far, Source::Filled];
        frame.disparity = vec![10.0, 0.1, 0.001];
        let shown = |shows: DisplayMode| {
            let mut f = frame.clone();
            shows.recolour(&mut f);
            f.colour.iter().map(|c| unpack_rgb(*c)).collect::<Vec<_>>()
        };
        assert_eq!(shown(DisplayMode::Scene), [[10, 20, 30], [200, 100, 50], [90, 90, 90]]);
        assert_eq!(shown(DisplayMode::Near), [[10, 20, 30], NOTHING, NOTHING]);
        assert_eq!(shown(DisplayMode::Far), [NOTHING, [200, 100, 50], NOTHING]);
        assert_eq!(shown(DisplayMode::Holes), [[3, 6, 10], [66, 33, 16], SOURCE_COLOURS[Source::Filled as usize]]);
        assert_eq!(shown(DisplayMode::Layers), [[3, 6, 10], [200, 100, 50], [30; 3]]);
        assert_eq!(shown(DisplayMode::Depth), [[255; 3], [127; 3], [0; 3]]);
        let sources = shown(DisplayMode::Sources);
        assert!(sources[0][0] > sources[0][2] && sources[1][2] > sources[1][0], "orange and blue: {sources:?}");
    }
}
