//! Images laid out for the warp, kept from frame to frame.

use super::views::Shows;
use crate::warp::PreparedLdi;
use ldi_protocol::{OutputCamera, Pose, ldi::Ldi};
use std::{sync::Arc, time::Instant};

/// Layouts that are kept besides those of the current frame: of the images that a walker goes back and forth between. Each is
/// about three times as large as the decoded image.
const KEPT: usize = 4;

/// An image, laid out.
#[derive(Debug)]
pub struct Layout {
    /// Position in the index's images.
    pub number: u32,
    /// What was laid out.
    ldi: Arc<Ldi>,
    /// The layout.
    pub laid_out: PreparedLdi,
    since: Instant,
}

impl Layout {
    /// Lays out an image as `painted` shows it.
    pub fn new(number: u32, ldi: &Arc<Ldi>, painted: &Ldi) -> Self {
        Self { number, ldi: ldi.clone(), laid_out: PreparedLdi::new(painted), since: Instant::now() }
    }

    /// Whether it is that of an image with these layers.
    pub fn is_of(&self, number: u32, ldi: &Arc<Ldi>) -> bool {
        self.number == number && Arc::ptr_eq(&self.ldi, ldi)
    }

    /// What was laid out.
    pub fn ldi(&self) -> &Arc<Ldi> {
        &self.ldi
    }
}

/// See the module. Most recent last.
#[derive(Debug, Default)]
pub struct Layouts(Vec<Layout>);

impl Layouts {
    /// The layout of an image.
    pub fn get(&self, number: u32) -> Option<&Layout> {
        self.0.iter().find(|l| l.number == number)
    }

    /// Whether an image is laid out, with these layers.
    pub fn holds(&self, number: u32, ldi: &Arc<Ldi>) -> bool {
        self.get(number).is_some_and(|l| l.is_of(number, ldi))
    }

    /// Takes in a layout that was made elsewhere, unless there is one with more layers.
    pub fn put(&mut self, layout: Layout) {
        if !self.get(layout.number).is_some_and(|l| l.ldi.layers.len() > layout.ldi.layers.len()) {
            self.0.retain(|l| l.number != layout.number);
            self.0.push(layout);
        }
    }

    /// Lays out an image, or what `paint` makes of it, unless it is laid out already, with the same layers. Returns whether it was new.
    pub fn lay_out(&mut self, number: u32, ldi: &Arc<Ldi>, paint: impl FnOnce(&Ldi) -> Option<Ldi>) -> bool {
        let held = self.holds(number, ldi);
        let at = self.0.iter().position(|l| l.number == number);
        let before = at.map(|at| self.0.remove(at)).filter(|_| held);
        self.0.push(before.unwrap_or_else(|| Layout::new(number, ldi, paint(ldi).as_ref().unwrap_or(ldi))));
        !held
    }

    /// Makes room for the images of a frame: of others some stay.
    pub fn forget_all_but(&mut self, in_use: impl Fn(u32) -> bool) {
        let mut spare = self.0.iter().filter(|l| !in_use(l.number)).count();
        self.0.retain(|l| {
            let keep = in_use(l.number) || spare <= KEPT;
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
            let ldi = shows.tint(&l.ldi, pose, camera, l.since.elapsed().as_secs_f64())?;
            Some(Layout { number: l.number, laid_out: PreparedLdi::new(&ldi), ldi, since: l.since })
        };
        let tinted: Vec<Layout> = numbers.filter_map(|n| self.get(n)).filter_map(tint).collect();
        (!tinted.is_empty()).then_some(Self(tinted))
    }
}
