//! A drawing of a cut in steps: waves of nodes into the z-buffer, then bands of rows into blended
//! colours.

use super::{
    pixel_mask::{BLOCK, PixelMask},
    splat::SplatBuffers,
    splat_projection::{Drawn, Splat, SplatProjection},
    view::TreeView,
};
use crate::warp::FarFrame;
use ldi_protocol::tree::Cut;
use rayon::prelude::*;

/// Samples drawn before hidden parts of the rest are rejected. Fewer: more is rejected; but each
/// test reads all pixels.
const WAVE_SAMPLES: u64 = 150_000;
/// Samples behind the nearest ones by more than this share of the disparity are hidden. Exceeds any
/// merge threshold in view.
const HIDDEN_MARGIN: f32 = 0.1;

/// A cut, and the progress of drawing it. Keeps buffers between cuts.
#[derive(Debug, Default)]
pub struct Pass {
    /// What is drawn.
    pub cut: Cut,
    /// True for passes that fill gaps which finer ones left.
    fills_gaps: bool,
    /// The first node not drawn into the z-buffer yet.
    next_node: usize,
    /// The first row without blended colours.
    next_row: usize,
    /// Splats of each node of the cut.
    splats: Vec<Vec<Splat>>,
}

impl Pass {
    /// Starts a cut. The caller clears the picture.
    pub fn begin(&mut self, cut: Cut, fills_gaps: bool) {
        self.splats.iter_mut().for_each(Vec::clear);
        self.splats.resize_with(cut.nodes.len().max(self.splats.len()), Vec::new);
        (self.cut, self.fills_gaps, self.next_node, self.next_row) = (cut, fills_gaps, 0, 0);
    }

    /// Continues near to far, until about `max_samples` more are visited, or rows are blended in
    /// proportion. Returns whether the drawing is finished.
    pub fn advance(
        &mut self,
        view: &TreeView<'_>,
        max_samples: u64,
        wanted: &mut PixelMask,
        out: &mut FarFrame,
        painting: &mut SplatBuffers,
        stats: &mut super::TreeStats,
    ) -> bool {
        let eye = SplatProjection::new(view.pose, view.camera);
        let nodes = &self.cut.nodes;
        let mut looked_at = 0;
        while self.next_node < nodes.len() {
            if looked_at >= max_samples {
                return false;
            }
            let most = WAVE_SAMPLES.min(max_samples - looked_at);
            let mut samples = 0;
            let wave = nodes[self.next_node..].iter().take_while(|n| {
                let before = samples;
                samples += u64::from(view.tree.nodes[n.node as usize].samples);
                before < most
            });
            let of_wave = self.next_node..self.next_node + wave.count();
            let seen = &*wanted;
            let within = self.fills_gaps;
            let draw = |(list, n): (&mut Vec<Splat>, &ldi_protocol::tree::CutNode)| {
                list.clear();
                let node = &view.tree.nodes[n.node as usize];
                let brood = view.resident.brood(n.home.0);
                match brood.as_ref().and_then(|b| b.nodes.get(usize::from(n.home.1))) {
                    Some(s) if eye.sees(&view.tree.bounds_of(node).inflated(view.tree.pitch_of(node.level)), seen) => {
                        let drawn = Drawn { filtered: n.filtered, within };
                        eye.splats(view.tree, node, drawn, &s.samples, seen, list);
                        s.samples.len() as u64
                    }
                    _ => 0,
                }
            };
            let lists = self.splats[of_wave.clone()].par_iter_mut().zip(&nodes[of_wave.clone()]);
            let of_this_wave: u64 = lists.map(draw).sum();
            stats.samples += of_this_wave;
            // A rejected node costs a little as well.
            looked_at += of_this_wave + of_wave.len() as u64;
            painting.cover(&self.splats[of_wave.clone()], view.camera, wanted, out);
            self.next_node = of_wave.end;
            if self.next_node < nodes.len() {
                wanted.raise_floors(out, HIDDEN_MARGIN);
            }
        }
        let height = view.camera.height as usize;
        if self.next_row == 0 {
            stats.splats += self.splats[..nodes.len()].iter().map(|l| l.len() as u64).sum::<u64>();
        }
        let left = max_samples.saturating_sub(looked_at) as f64 / self.cut.samples.max(1) as f64;
        let share = (left * height as f64).min(height as f64) as usize;
        let end = (self.next_row + share.max(BLOCK)).min(height);
        let lists = &self.splats[..nodes.len()];
        painting.mix(lists, view.camera, self.next_row..end, wanted, out);
        self.next_row = end;
        end == height
    }
}
