//! Images laid out for the warp, kept from frame to frame.

use super::display_mode::DisplayMode;
use crate::{
    gpu::Packed,
    warp::{PreparedLdi, halved},
};
use ldi_protocol::{OutputCamera, Pose, ldi::Ldi};
use std::{sync::Arc, time::Instant};

/// Number of layouts kept in addition to those of the current frame, for images that the eye
/// returns to. About as many as a view shows. Larger: more memory, as a layout is several times as
/// large as the decoded image. Smaller: images are laid out again when the eye turns back.
const KEPT: usize = 32;

/// A request for a layout.
#[derive(Debug, Clone)]
pub struct LayoutRequest {
    /// Position in the index's images.
    pub number: u32,
    /// Whether the layout is at half the resolution.
    pub half: bool,
    /// The image, with the layers that have arrived.
    pub ldi: Arc<Ldi>,
}

impl LayoutRequest {
    /// Whether both name the same layers of the same image at the same resolution.
    pub fn is(&self, other: &Self) -> bool {
        (self.number, self.half) == (other.number, other.half) && Arc::ptr_eq(&self.ldi, &other.ldi)
    }
}

/// The layout of an image.
#[derive(Debug)]
pub struct ImageLayout {
    /// The request that it answers.
    pub of: LayoutRequest,
    /// The layout.
    pub laid_out: PreparedLdi,
    /// The layout in the GPU's format, until it is uploaded.
    pub packed: Option<Packed>,
    since: Instant,
}

impl ImageLayout {
    /// Lays out an image. `pack`: also in the GPU's format.
    pub fn new(of: LayoutRequest, pack: bool) -> Self {
        let laid_out = if of.half { PreparedLdi::new(&halved(&of.ldi)) } else { PreparedLdi::new(&of.ldi) };
        let packed = pack.then(|| Packed::new(&laid_out));
        Self { of, laid_out, packed, since: Instant::now() }
    }

    /// Lays out, at full resolution, an image or its flat texture.
    fn from_texture(of: LayoutRequest, texture: Option<Ldi>) -> Self {
        let laid_out = PreparedLdi::new(texture.as_ref().unwrap_or(&of.ldi));
        Self { of, laid_out, packed: None, since: Instant::now() }
    }
}

/// The layouts, least recently used first.
#[derive(Debug, Default)]
pub struct ImageLayouts(Vec<ImageLayout>);

impl ImageLayouts {
    /// The layout of an image, at the wanted resolution if there is one.
    pub fn get(&self, number: u32, half: bool) -> Option<&ImageLayout> {
        self.of(number).find(|l| l.of.half == half).or_else(|| self.of(number).next())
    }

    /// All layouts of an image.
    pub fn of(&self, number: u32) -> impl Iterator<Item = &ImageLayout> {
        self.0.iter().filter(move |l| l.of.number == number)
    }

    /// Keeps the layouts that satisfy a predicate.
    pub fn retain(&mut self, keep: impl FnMut(&ImageLayout) -> bool) {
        self.0.retain(keep);
    }

    /// Whether a request is already answered.
    pub fn holds(&self, wanted: &LayoutRequest) -> bool {
        self.0.iter().any(|l| l.of.is(wanted))
    }

    /// Adds a finished layout, unless there is one with more layers.
    pub fn insert(&mut self, layout: ImageLayout) {
        let same = |l: &ImageLayout| (l.of.number, l.of.half) == (layout.of.number, layout.of.half);
        if !self.0.iter().any(|l| same(l) && l.of.ldi.layers.len() > layout.of.ldi.layers.len()) {
            self.0.retain(|l| !same(l));
            self.0.push(layout);
        }
    }

    /// Lays out an image at full resolution, or the result of `paint`, unless the same layers are
    /// laid out already. Returns whether the layout is new.
    pub fn lay_out(&mut self, number: u32, ldi: &Arc<Ldi>, paint: impl FnOnce(&Ldi) -> Option<Ldi>) -> bool {
        let wanted = LayoutRequest { number, half: false, ldi: ldi.clone() };
        let held = self.0.iter().position(|l| l.of.is(&wanted));
        match held {
            Some(at) => {
                let layout = self.0.remove(at);
                self.0.push(layout);
            }
            None => self.insert(ImageLayout::from_texture(wanted, paint(ldi))),
        }
        held.is_none()
    }

    /// Drops layouts that are not in use, except the most recent [`KEPT`].
    pub fn forget_all_but(&mut self, in_use: impl Fn(u32) -> bool) {
        let mut spare = self.0.iter().filter(|l| !in_use(l.of.number)).count();
        self.0.retain(|l| {
            let keep = in_use(l.of.number) || spare <= KEPT;
            spare -= usize::from(!keep);
            keep
        });
    }

    /// Images recoloured for a display mode; None if the mode does not recolour images.
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
