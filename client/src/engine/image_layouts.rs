//! Images laid out for the warp, kept from frame to frame.

use super::display_mode::DisplayMode;
use crate::{
    gpu::Packed,
    warp::{PreparedLdi, halved},
};
use ldi_protocol::{OutputCamera, Pose, ldi::Ldi};
use std::{sync::Arc, time::Instant};

/// Layouts that are kept besides those of the current frame: of the images that a walker goes back and forth between. Each is
/// about three times as large as the decoded image. As many as a view shows, some thirty tiles of a quarter of a million pixels.
const KEPT: usize = 32;

/// What is laid out.
#[derive(Debug, Clone)]
pub struct LayoutRequest {
    /// Position in the index's images.
    pub number: u32,
    /// At half the resolution.
    pub half: bool,
    /// What is there of it.
    pub ldi: Arc<Ldi>,
}

impl LayoutRequest {
    /// Whether both are the same layers of the same image at the same resolution.
    pub fn is(&self, other: &Self) -> bool {
        (self.number, self.half) == (other.number, other.half) && Arc::ptr_eq(&self.ldi, &other.ldi)
    }
}

/// An image, laid out.
#[derive(Debug)]
pub struct ImageLayout {
    /// What was laid out.
    pub of: LayoutRequest,
    /// The layout.
    pub laid_out: PreparedLdi,
    /// The same as a card reads it, until it is there.
    pub packed: Option<Packed>,
    since: Instant,
}

impl ImageLayout {
    /// Lays out an image; `pack`: for a card.
    pub fn new(of: LayoutRequest, pack: bool) -> Self {
        let laid_out = if of.half { PreparedLdi::new(&halved(&of.ldi)) } else { PreparedLdi::new(&of.ldi) };
        let packed = pack.then(|| Packed::new(&laid_out));
        Self { of, laid_out, packed, since: Instant::now() }
    }

    /// Lays out at full resolution what `frame_stats` shows of an image.
    fn frame_stats(of: LayoutRequest, frame_stats: Option<Ldi>) -> Self {
        let laid_out = PreparedLdi::new(frame_stats.as_ref().unwrap_or(&of.ldi));
        Self { of, laid_out, packed: None, since: Instant::now() }
    }
}

/// See the module. The newest is last, and what a frame laid out or found laid out by itself.
#[derive(Debug, Default)]
pub struct ImageLayouts(Vec<ImageLayout>);

impl ImageLayouts {
    /// The layout of an image, at the resolution that is wanted if there is that.
    pub fn get(&self, number: u32, half: bool) -> Option<&ImageLayout> {
        self.of(number).find(|l| l.of.half == half).or_else(|| self.of(number).next())
    }

    /// All layouts of an image.
    pub fn of(&self, number: u32) -> impl Iterator<Item = &ImageLayout> {
        self.0.iter().filter(move |l| l.of.number == number)
    }

    /// Forgets some.
    pub fn retain(&mut self, keep: impl FnMut(&ImageLayout) -> bool) {
        self.0.retain(keep);
    }

    /// Whether this is laid out.
    pub fn holds(&self, wanted: &LayoutRequest) -> bool {
        self.0.iter().any(|l| l.of.is(wanted))
    }

    /// Takes in a layout that was made elsewhere, unless there is one with more layers.
    pub fn insert(&mut self, layout: ImageLayout) {
        let same = |l: &ImageLayout| (l.of.number, l.of.half) == (layout.of.number, layout.of.half);
        if !self.0.iter().any(|l| same(l) && l.of.ldi.layers.len() > layout.of.ldi.layers.len()) {
            self.0.retain(|l| !same(l));
            self.0.push(layout);
        }
    }

    /// Lays out an image, or what `paint` makes of it, at full resolution, unless it is laid out already, with the same layers. Returns whether it was new.
    pub fn lay_out(&mut self, number: u32, ldi: &Arc<Ldi>, paint: impl FnOnce(&Ldi) -> Option<Ldi>) -> bool {
        let wanted = LayoutRequest { number, half: false, ldi: ldi.clone() };
        let held = self.0.iter().position(|l| l.of.is(&wanted));
        match held {
            Some(at) => {
                let layout = self.0.remove(at);
                self.0.push(layout);
            }
            None => self.insert(ImageLayout::frame_stats(wanted, paint(ldi))),
        }
        held.is_none()
    }

    /// Makes room for the images of a frame: of others some stay.
    pub fn forget_all_but(&mut self, in_use: impl Fn(u32) -> bool) {
        let mut spare = self.0.iter().filter(|l| !in_use(l.of.number)).count();
        self.0.retain(|l| {
            let keep = in_use(l.of.number) || spare <= KEPT;
            spare -= usize::from(!keep);
            keep
        });
    }

    /// Images in the colours of a view; none where it shows them as they are.
    pub fn recoloured(
        &self,
        numbers: impl Iterator<Item = u32>,
        pose: &Pose,
        camera: &OutputCamera,
        shows: DisplayMode,
    ) -> Option<Self> {
        let tint = |l: &ImageLayout| {
            let ldi = shows.tint(&l.of.ldi, pose, camera, l.since.elapsed().as_secs_f64())?;
            let of = LayoutRequest { half: false, ldi: ldi.clone(), ..l.of };
            Some(ImageLayout { of, laid_out: PreparedLdi::new(&ldi), packed: None, since: l.since })
        };
        let recoloured: Vec<ImageLayout> = numbers.filter_map(|n| self.get(n, false)).filter_map(tint).collect();
        (!recoloured.is_empty()).then_some(Self(recoloured))
    }
}
