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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::pack_rgb;
    use glam::DVec3;

    const CAMERA: OutputCamera = OutputCamera { width: 8, height: 4, fov_deg: 60.0 };
    const BESIDE: u32 = pack_rgb([10, 20, 30]);
    const SAMPLE: u32 = pack_rgb([200, 100, 50]);

    /// A frame of near geometry 2 m away with holes in its third column, and a tree that shows something at `depth_m` everywhere.
    fn laid(depth_m: f32, doubt: Doubt) -> Frame {
        let mut frame = Frame::new(8, 4);
        for at in (0..32).filter(|at| at % 8 != 2) {
            (frame.colour[at], frame.disparity[at], frame.source[at]) = (BESIDE, 0.5, Source::Near);
        }
        let mut tree = FarFrame::new(8, 4);
        tree.clear();
        tree.packed.fill(FarFrame::pack(1.0 / depth_m, SAMPLE));
        let pose = Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
        lay_under(&mut frame, &tree, doubt, &Under::new(&pose, &CAMERA, None));
        frame
    }

    #[test]
    fn where_nothing_is_missing_only_holes_take_samples() {
        for depth_m in [0.5, 2.0, 50.0] {
            let frame = laid(depth_m, Doubt::None);
            assert_eq!((frame.colour[10], frame.source[10]), (SAMPLE, Source::Tree), "at {depth_m} m");
            assert_eq!((frame.colour[11], frame.source[11]), (BESIDE, Source::Near), "what is painted stays");
        }
    }

    #[test]
    fn while_data_is_missing_the_tree_wins_where_it_is_clearly_nearer() {
        let doubt = Doubt::Missing { margin_m: 0.3 };
        for (depth_m, source) in [(1.0, Source::Tree), (1.8, Source::Near), (2.2, Source::Near), (9.0, Source::Near)] {
            let frame = laid(depth_m, doubt);
            assert_eq!(frame.source[11], source, "at {depth_m} m");
            assert_eq!((frame.colour[10], frame.source[10]), (SAMPLE, Source::Tree), "holes take any");
        }
    }
}
