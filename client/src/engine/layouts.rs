//! Images laid out for the warp, kept from frame to frame.

use super::views::Shows;
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
pub struct Wanted {
    /// Position in the index's images.
    pub number: u32,
    /// At half the resolution.
    pub half: bool,
    /// What is there of it.
    pub ldi: Arc<Ldi>,
}

impl Wanted {
    /// Whether both are the same layers of the same image at the same resolution.
    pub fn is(&self, other: &Self) -> bool {
        (self.number, self.half) == (other.number, other.half) && Arc::ptr_eq(&self.ldi, &other.ldi)
    }
}

/// An image, laid out.
#[derive(Debug)]
pub struct Layout {
    /// What was laid out.
    pub of: Wanted,
    /// The layout.
    pub laid_out: PreparedLdi,
    /// The same as a card reads it, until it is there.
    pub packed: Option<Packed>,
    since: Instant,
}

impl Layout {
    /// Lays out an image; `pack`: for a card.
    pub fn new(of: Wanted, pack: bool) -> Self {
        let laid_out = if of.half { PreparedLdi::new(&halved(&of.ldi)) } else { PreparedLdi::new(&of.ldi) };
        let packed = pack.then(|| Packed::new(&laid_out));
        Self { of, laid_out, packed, since: Instant::now() }
    }

    /// Lays out at full resolution what `painted` shows of an image.
    fn painted(of: Wanted, painted: Option<Ldi>) -> Self {
        let laid_out = PreparedLdi::new(painted.as_ref().unwrap_or(&of.ldi));
        Self { of, laid_out, packed: None, since: Instant::now() }
    }
}

/// See the module. The newest is last, and what a frame laid out or found laid out by itself.
#[derive(Debug, Default)]
pub struct Layouts(Vec<Layout>);

impl Layouts {
    /// The layout of an image, at the resolution that is wanted if there is that.
    pub fn get(&self, number: u32, half: bool) -> Option<&Layout> {
        self.of(number).find(|l| l.of.half == half).or_else(|| self.of(number).next())
    }

    /// All layouts of an image.
    pub fn of(&self, number: u32) -> impl Iterator<Item = &Layout> {
        self.0.iter().filter(move |l| l.of.number == number)
    }

    /// Forgets some.
    pub fn retain(&mut self, keep: impl FnMut(&Layout) -> bool) {
        self.0.retain(keep);
    }

    /// Whether this is laid out.
    pub fn holds(&self, wanted: &Wanted) -> bool {
        self.0.iter().any(|l| l.of.is(wanted))
    }

    /// Takes in a layout that was made elsewhere, unless there is one with more layers.
    pub fn put(&mut self, layout: Layout) {
        let same = |l: &Layout| (l.of.number, l.of.half) == (layout.of.number, layout.of.half);
        if !self.0.iter().any(|l| same(l) && l.of.ldi.layers.len() > layout.of.ldi.layers.len()) {
            self.0.retain(|l| !same(l));
            self.0.push(layout);
        }
    }

    /// Lays out an image, or what `paint` makes of it, at full resolution, unless it is laid out already, with the same layers. Returns whether it was new.
    pub fn lay_out(&mut self, number: u32, ldi: &Arc<Ldi>, paint: impl FnOnce(&Ldi) -> Option<Ldi>) -> bool {
        let wanted = Wanted { number, half: false, ldi: ldi.clone() };
        let held = self.0.iter().position(|l| l.of.is(&wanted));
        match held {
            Some(at) => {
                let layout = self.0.remove(at);
                self.0.push(layout);
            }
            None => self.put(Layout::painted(wanted, paint(ldi))),
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
    pub fn tinted(
        &self,
        numbers: impl Iterator<Item = u32>,
        pose: &Pose,
        camera: &OutputCamera,
        shows: Shows,
    ) -> Option<Self> {
        let tint = |l: &Layout| {
            let ldi = shows.tint(&l.of.ldi, pose, camera, l.since.elapsed().as_secs_f64())?;
            let of = Wanted { half: false, ldi: ldi.clone(), ..l.of };
            Some(Layout { of, laid_out: PreparedLdi::new(&ldi), packed: None, since: l.since })
        };
        let tinted: Vec<Layout> = numbers.filter_map(|n| self.get(n, false)).filter_map(tint).collect();
        (!tinted.is_empty()).then_some(Self(tinted))
    }
}
