//! The LDI tree under the frame: section 3.5 of Chang and others (1999), where the stencil is what near geometry and images left open.
//!
//! In: a merged frame. Out: which pixels want a sample of the tree; and, once it is drawn, the frame with those samples.
//!
//! A pixel that is unpainted takes any. As long as data is missing a painted pixel may show what a missing surface hides, so that the tree's sample wins where it is clearly
//! nearer; and sky that was taken for granted is not.

use super::Directions;
use crate::{
    frame::{Frame, Source},
    tree::Wanted,
    warp::FarFrame,
};
use ldi_protocol::{OutputCamera, Pose, sky::SkyMap};

/// Whether painted pixels are to be believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Doubt {
    /// Everything is there: only holes want samples.
    None,
    /// Something is missing. Samples nearer than what is painted by so many metres win.
    Missing {
        /// Metres of depth, at least; and a tenth of the depth.
        margin_m: f32,
    },
}

/// How the tree lies under a frame.
pub struct Under<'a> {
    directions: Directions,
    sky: Option<&'a SkyMap>,
}

impl<'a> Under<'a> {
    /// `sky`: where the nearest reference saw sky.
    pub fn new(pose: &Pose, camera: &OutputCamera, sky: Option<&'a SkyMap>) -> Self {
        Self { directions: Directions::new(pose, camera, |w| w.to_array()), sky }
    }

    /// Whether a gap at a pixel is sky.
    pub fn is_sky(&self, row: usize, column: usize) -> bool {
        let direction = || glam::DVec3::from_array(self.directions.of(row, column));
        self.sky.is_some_and(|s| s.holds(direction()))
    }
}

/// The pixels that want a sample.
pub fn wanted_under(frame: &Frame, doubt: Doubt) -> Wanted {
    let wants = |s: &Source| *s == Source::Unpainted || doubt != Doubt::None;
    // Behind what is painted nothing shows. Of sky that is doubted the disparity is 0.
    Wanted::new(frame.width, frame.height, frame.source.iter().map(wants).collect(), &frame.disparity)
}

/// Lays the tree's picture under the frame; what is left unpainted where `under` knows of sky becomes sky. Returns the number of pixels that the tree gave.
pub fn lay_under(frame: &mut Frame, tree: &FarFrame, doubt: Doubt, under: &Under<'_>) -> u64 {
    let mut given = 0;
    let width = frame.width as usize;
    for at in 0..frame.len() {
        let source = frame.source[at];
        let takes = |sample: f32| match (source, doubt) {
            (Source::Unpainted, _) => true,
            (_, Doubt::None) => false,
            (Source::Sky, _) => true,
            (_, Doubt::Missing { margin_m }) => {
                let (painted, sample) = (1.0 / frame.disparity[at].max(1e-9), 1.0 / sample);
                sample + margin_m.max(0.1 * painted) < painted
            }
        };
        match tree.get(at) {
            Some((colour, disparity)) if takes(disparity) => {
                (frame.colour[at], frame.disparity[at], frame.source[at]) = (colour, disparity, Source::Tree);
                given += 1;
            }
            _ if source == Source::Unpainted && under.is_sky(at / width, at % width) => {
                frame.source[at] = Source::Sky;
            }
            _ => {}
        }
    }
    given
}
