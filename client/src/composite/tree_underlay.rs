//! The LDI tree underlay: section 3.5 of Chang and others (1999), where the stencil is the set of
//! pixels that near geometry and images leave open.
//!
//! In: a merged frame. Out: the pixels that need a sample of the tree; and, once it is drawn, the
//! frame with these samples.
//!
//! An unpainted pixel takes any sample. While data is missing, a painted pixel may show what a
//! missing surface hides, so that a clearly nearer sample of the tree wins, and sky is not trusted.
//! Pixels that neither shows are then sky: the tree contains every surface that the references saw,
//! and has closed its gaps.

use crate::{
    frame::{Frame, Source},
    tree::PixelMask,
    warp::FarFrame,
};

/// Share of the depth by which a sample must be nearer than a painted pixel to hide it. Smaller:
/// rough samples of foliage hide leaves that are drawn exactly. Larger: rooms show through missing
/// walls.
const NEARER: f32 = 0.02;

/// Whether painted pixels can be trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ImageGaps {
    /// Everything is present: only holes need samples.
    None,
    /// Data is missing: samples that are nearer than painted pixels by a margin win.
    Missing {
        /// The margin, metres of depth; at least [`NEARER`] times the depth.
        margin_m: f32,
        /// Distance within which everything is painted, metres: nearer samples are left out.
        complete_m: f32,
    },
}

/// The pixels that need a sample.
pub fn pixels_for_tree(frame: &Frame, doubt: ImageGaps) -> PixelMask {
    let wants = |s: &Source| *s == Source::Unpainted || doubt != ImageGaps::None;
    // Samples behind painted pixels are hidden. Untrusted sky has disparity 0.
    let wanted = PixelMask::new(frame.width, frame.height, frame.source.iter().map(wants).collect(), &frame.disparity);
    match doubt {
        ImageGaps::Missing { complete_m, .. } => wanted.beyond(complete_m),
        ImageGaps::None => wanted,
    }
}

/// Adds the tree's picture to the frame. Pixels that neither shows become sky while data is
/// missing, otherwise stay holes. Returns the number of pixels taken from the tree.
pub fn underlay_tree(frame: &mut Frame, tree: &FarFrame, doubt: ImageGaps) -> u64 {
    let mut given = 0;
    for at in 0..frame.len() {
        let source = frame.source[at];
        if doubt == ImageGaps::None && source != Source::Unpainted {
            continue;
        }
        let takes = |sample: f32| match doubt {
            ImageGaps::Missing { margin_m, .. } if !matches!(source, Source::Unpainted | Source::Sky) => {
                let (painted, sample) = (1.0 / frame.disparity[at].max(1e-9), 1.0 / sample);
                sample + margin_m.max(NEARER * painted) < painted
            }
            _ => true,
        };
        if let Some((colour, disparity)) = tree.get(at).filter(|(_, disparity)| takes(*disparity)) {
            (frame.colour[at], frame.disparity[at], frame.source[at]) = (colour, disparity, Source::Tree);
            given += 1;
        }
    }
    if doubt != ImageGaps::None {
        frame.paint_rest_as_sky();
    }
    given
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::pack_rgb;

    const BESIDE: u32 = pack_rgb([10, 20, 30]);
    const SAMPLE: u32 = pack_rgb([200, 100, 50]);

    /// A frame of near geometry 2 m away with holes in its third column.
    fn beside_a_hole() -> Frame {
        let mut frame = Frame::new(8, 4);
        for at in (0..32).filter(|at| at % 8 != 2) {
            (frame.colour[at], frame.disparity[at], frame.source[at]) = (BESIDE, 0.5, Source::Near);
        }
        frame
    }

    /// Laid over a tree that shows something at `depth_m` everywhere.
    fn laid(depth_m: f32, doubt: ImageGaps) -> Frame {
        let mut frame = beside_a_hole();
        let mut tree = FarFrame::new(8, 4);
        tree.clear();
        tree.packed.fill(FarFrame::pack(1.0 / depth_m, SAMPLE));
        underlay_tree(&mut frame, &tree, doubt);
        frame
    }

    #[test]
    fn where_nothing_is_missing_only_holes_take_samples() {
        for depth_m in [0.5, 2.0, 50.0] {
            let frame = laid(depth_m, ImageGaps::None);
            assert_eq!((frame.colour[10], frame.source[10]), (SAMPLE, Source::Tree), "at {depth_m} m");
            assert_eq!((frame.colour[11], frame.source[11]), (BESIDE, Source::Near), "what is painted stays");
        }
    }

    /// Of a hole that the tree leaves open: with everything there it is a gap in what is painted;
    /// else what is painted says nothing of it, and the tree knows of no surface.
    #[test]
    fn what_the_tree_leaves_open_is_sky_where_it_alone_knows() {
        for (doubt, source) in
            [(ImageGaps::None, Source::Unpainted), (ImageGaps::Missing { margin_m: 0.3, complete_m: 0.0 }, Source::Sky)]
        {
            let mut frame = beside_a_hole();
            let mut tree = FarFrame::new(8, 4);
            tree.clear();
            assert_eq!(underlay_tree(&mut frame, &tree, doubt), 0);
            assert_eq!((frame.source[10], frame.source[11]), (source, Source::Near));
        }
    }

    #[test]
    fn while_data_is_missing_the_tree_wins_where_it_is_clearly_nearer() {
        let doubt = ImageGaps::Missing { margin_m: 0.3, complete_m: 0.0 };
        for (depth_m, source) in [(1.0, Source::Tree), (1.8, Source::Near), (2.2, Source::Near), (9.0, Source::Near)] {
            let frame = laid(depth_m, doubt);
            assert_eq!(frame.source[11], source, "at {depth_m} m");
            assert_eq!((frame.colour[10], frame.source[10]), (SAMPLE, Source::Tree), "holes take any");
        }
    }
}
