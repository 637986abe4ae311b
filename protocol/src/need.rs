//! What a view needs, and what lies near: pure functions from the [`Index`] to ordered lists of
//! chunk numbers.
//!
//! Server and client compute the same lists: the server to push, the client to pin, to ask for
//! what is missing and to keep what the server would push again.
//!
//! [`needed`]: the chunks of one view, in two classes. `now` leaves no gap: the first layers of
//! the LDIs in view (they fill the most pixels per byte, so they go first), then the drawn cells,
//! near to far, each with the bundles it refers to and the coarse levels of its textures. `fine`
//! only sharpens: deeper layers, then finer texture levels in the same near-to-far order, those
//! alone that can show from where the view looks ([`Sight`]).
//!
//! [`near_to_far`]: everything within a radius of the eye, whatever the direction (Aliaga and
//! Lastra 1999, section 6: "all images within a radius are loaded near to far"; here cells as well
//! as images), until the cache is full. A chunk that only sharpens, the next finer level of a cell
//! among them, counts as farther ([`FINE_FACTOR`], [`FINE_OFFSET_M`]), so that coarse data reaches
//! farther than fine data.

use crate::{
    OutputCamera, Pose,
    index::{CellEntry, CellMesh, ChunkKind, DrawnCell, EVERY_LEVEL, Index, TextureEntry},
    select::level_at,
};
use glam::DVec3;

/// A fine chunk at distance d is loaded together with the coarse ones at
/// `FINE_FACTOR * d + FINE_OFFSET_M`. Larger: a wider ring of coarse data before anything
/// sharpens; 1 and 0: strictly by distance.
pub const FINE_FACTOR: f64 = 1.5;
/// See [`FINE_FACTOR`]; metres.
pub const FINE_OFFSET_M: f64 = 1.0;

/// The share of a client's cache that may be filled unasked. The rest holds what the views
/// themselves need. The client keeps this much around the eye from being evicted: were the server
/// to push more, the two would work against each other.
pub const PREFETCH_SHARE: f64 = 0.75;

/// The chunks of one view; no number twice over both lists.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Needed {
    /// The base layer: the pinned levels of the LDI tree. It comes before everything and stays,
    /// whatever the view.
    pub base: Vec<u32>,
    /// Without these the view has gaps. In the order of sending.
    pub now: Vec<u32>,
    /// Without these the view is coarser. In the order of sending.
    pub fine: Vec<u32>,
}

impl Needed {
    /// All numbers in the order of sending.
    pub fn all(&self) -> impl Iterator<Item = u32> + Clone + '_ {
        self.base.iter().chain(&self.now).chain(&self.fine).copied()
    }
}

/// Share of a client's cache that the needs of one view may take, decoded. The rest is for what is
/// being decoded, and for the last view.
pub const VIEW_SHARE: f64 = 0.9;

impl Needed {
    /// The same without what a cache of `cap_bytes` cannot hold beside the rest: levels that only
    /// sharpen go first, the last ones first, then images, whose place the LDI tree takes, then
    /// the farthest cells. Without this a view would push out its own chunks and fetch them again
    /// in every frame.
    #[must_use]
    pub fn within(self, index: &Index, cap_bytes: u64) -> Self {
        let bytes = |c: &u32| index.chunks.get(*c as usize).map_or(0, |e| u64::from(e.decoded_bytes));
        let mut left = (cap_bytes as f64 * VIEW_SHARE) as u64;
        if self.all().map(|c| bytes(&c)).sum::<u64>() <= left {
            return self;
        }
        let is_image = |c: &u32| index.chunks.get(*c as usize).is_some_and(|e| e.kind == ChunkKind::Ldi);
        let mut take = |c: &u32| match left.checked_sub(bytes(c)) {
            Some(rest) => {
                left = rest;
                true
            }
            None => {
                // What comes later matters less: it does not slip through where this does not fit.
                left = 0;
                false
            }
        };
        let base: Vec<u32> = self.base.into_iter().filter(&mut take).collect();
        let mut kept: Vec<bool> = vec![false; self.now.len()];
        for images in [false, true] {
            for (c, kept) in self.now.iter().zip(&mut kept).filter(|(c, _)| is_image(c) == images) {
                *kept = take(c);
            }
        }
        let now = self.now.into_iter().zip(kept).filter(|(_, kept)| *kept).map(|(c, _)| c).collect();
        Self { base, now, fine: self.fine.into_iter().filter(take).collect() }
    }
}

/// Chunk numbers in order of insertion, each once.
struct OrderedSet {
    seen: Vec<bool>,
    order: Vec<u32>,
}

impl OrderedSet {
    fn new(chunks: usize) -> Self {
        Self { seen: vec![false; chunks], order: Vec::new() }
    }
    /// Numbers beyond the index are left out.
    fn insert(&mut self, chunk: u32) {
        if let Some(seen @ false) = self.seen.get_mut(chunk as usize) {
            *seen = true;
            self.order.push(chunk);
        }
    }
    fn insert_mesh(&mut self, mesh: &CellMesh<'_>) {
        self.insert(mesh.chunk);
        mesh.bundles.iter().for_each(|b| self.insert(*b));
    }
    fn take(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.order)
    }
}

/// From where and how finely a view looks: which levels of a texture it can show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    eye: DVec3,
    /// Unit vector into the scene.
    forward: DVec3,
    /// Cosine of the angle between it and the picture's corners.
    cos_corner: f64,
    /// Binary logarithm of the focal length, pixels, over that cosine.
    focal_log2: f64,
}

impl Sight {
    /// Of a picture with `supersample` samples per pixel along each side.
    pub fn new(pose: &Pose, camera: &OutputCamera, supersample: u32) -> Self {
        let cos_corner = (1.0 + camera.half_tan_x().powi(2) + camera.half_tan_y().powi(2)).sqrt().recip();
        let focal_px = camera.focal_px() * f64::from(supersample.max(1));
        let forward = pose.basis().forward;
        Self { eye: pose.position, forward, cos_corner, focal_log2: (focal_px / cos_corner).log2() }
    }

    /// The same with pixels `factor` times as fine, above 1: of what shows from a little nearer,
    /// too.
    #[must_use]
    pub fn finer(self, factor: f64) -> Self {
        Self { focal_log2: self.focal_log2 + factor.log2(), ..self }
    }

    /// The finest level that any pixel shows of a texture with this density in this cell.
    ///
    /// From one pixel to the next the eye's ray moves by `depth / focal` times the cosine of its
    /// angle off the axis on a surface, at least, whichever way that is turned. The longer of both
    /// pixels' steps over the texture, which decides the level ([`crate::texture::lod_of`]), is as
    /// long as their root mean square at least.
    fn finest_level(&self, cell: &CellEntry, density: i8) -> u8 {
        let (centre, half) = (cell.bounds.centre(), cell.bounds.size() * 0.5);
        let nearest = self.forward.dot(centre - self.eye) - self.forward.abs().dot(half);
        let depth = nearest.max(cell.bounds.distance(self.eye) * self.cos_corner);
        if density == EVERY_LEVEL || depth <= 0.0 {
            return 0;
        }
        // Saturating: below 0 it is the finest.
        (f64::from(density) / 4.0 + depth.log2() - self.focal_log2).floor() as u8
    }
}

/// What a view needs that draws `drawn_cells` (near to far), warps `images` and refines the LDI
/// tree by the chunks `tree`, seen from `sight`.
pub fn needed(index: &Index, images: &[u32], drawn_cells: &[DrawnCell], tree: &[u32], sight: &Sight) -> Needed {
    let mut set = OrderedSet::new(index.chunks.len());
    index.tree.iter().flat_map(|t| t.pinned_chunks()).for_each(|c| set.insert(c));
    let base = set.take();
    let layers = || images.iter().filter_map(|i| index.images.get(*i as usize)).map(|i| &i.chunks);
    let cells = || drawn_cells.iter().filter_map(|c| Some((index.cells.get(c.cell as usize)?, index.mesh_of(*c)?)));
    layers().for_each(|c| c.iter().take(1).for_each(|c| set.insert(*c)));
    for (cell, mesh) in cells() {
        set.insert_mesh(&mesh);
        coarse_levels(index, cell).for_each(|t| set.insert(t));
    }
    let now = set.take();
    tree.iter().for_each(|c| set.insert(*c));
    layers().for_each(|c| c.iter().skip(1).for_each(|c| set.insert(*c)));
    for (cell, _) in cells() {
        finer_levels(index, cell, Some(sight)).for_each(|t| set.insert(t));
    }
    Needed { base, now, fine: set.take() }
}

/// The textures of a cell's materials, and their densities in it.
fn textures<'a>(index: &'a Index, cell: &'a CellEntry) -> impl Iterator<Item = (&'a TextureEntry, i8)> {
    cell.materials.iter().enumerate().filter_map(|(n, m)| {
        let texture = index.textures.get(index.materials.get(*m as usize)?.texture? as usize)?;
        Some((texture, cell.texel_density.get(n).copied().unwrap_or(EVERY_LEVEL)))
    })
}

/// The coarsest levels of a cell's textures.
fn coarse_levels<'a>(index: &'a Index, cell: &'a CellEntry) -> impl Iterator<Item = u32> {
    textures(index, cell).filter_map(|(t, _)| t.chunks.first()).map(|c| c.chunk)
}

/// All finer ones, or those that can be seen.
fn finer_levels<'a>(index: &'a Index, cell: &'a CellEntry, sight: Option<&'a Sight>) -> impl Iterator<Item = u32> {
    textures(index, cell).flat_map(move |(t, density)| {
        let finest = sight.map_or(0, |s| s.finest_level(cell, density));
        t.chunks.iter().skip(1).filter(move |c| c.last_level >= finest).map(|c| c.chunk)
    })
}

/// How far [`near_to_far`] goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Metres from the eye.
    pub radius_m: f64,
    /// Decoded bytes in all.
    pub decoded_bytes: u64,
}

/// Chunks around an eye, near to far, up to `reach`. The list ends before the first chunk that
/// would exceed the bytes, so that what is near never gives way to something smaller and farther.
pub fn near_to_far(index: &Index, eye: DVec3, reach: Reach) -> Vec<u32> {
    let fine = |d: f64| FINE_FACTOR * d + FINE_OFFSET_M;
    // Distance, then a rank and a number that make the order total and the same on every machine.
    let mut items: Vec<(f64, u8, u32)> = Vec::new();
    let mut put = |distance_m: f64, rank: u8, number: usize| {
        if distance_m <= reach.radius_m {
            items.push((distance_m, rank, number as u32));
        }
    };
    const LAYER: u8 = 0;
    const CELL: u8 = 1;
    const DEEPER: u8 = 2;
    const SHARPER: u8 = 3;
    const FINER: u8 = 4;
    for p in &index.placements {
        let d = p.users.distance(eye);
        for i in p.images.clone().map(|i| i as usize) {
            put(d, LAYER, i);
            if index.images.get(i).is_some_and(|i| i.chunks.len() > 1) {
                put(fine(d), DEEPER, i);
            }
        }
    }
    for (i, c) in index.cells.iter().enumerate() {
        let d = c.bounds.distance(eye);
        put(d, CELL, i);
        put(fine(d), SHARPER, i);
        if level_at(index, i as u32, eye) > 0 {
            put(fine(d), FINER, i);
        }
    }
    items.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));

    let mut set = OrderedSet::new(index.chunks.len());
    let mut bytes = 0u64;
    let mut counted = 0;
    for (_, rank, number) in items {
        let number = number as usize;
        match rank {
            LAYER => index.images[number].chunks.iter().take(1).for_each(|c| set.insert(*c)),
            DEEPER => index.images[number].chunks.iter().skip(1).for_each(|c| set.insert(*c)),
            CELL | FINER => {
                let level = level_at(index, number as u32, eye) - u8::from(rank == FINER);
                let cell = &index.cells[number];
                cell.mesh(level).iter().for_each(|m| set.insert_mesh(m));
                coarse_levels(index, cell).for_each(|t| set.insert(t));
            }
            _ => finer_levels(index, &index.cells[number], None).for_each(|t| set.insert(t)),
        }
        while let Some(chunk) = set.order.get(counted) {
            bytes += u64::from(index.chunks[*chunk as usize].decoded_bytes);
            if bytes > reach.decoded_bytes {
                set.order.truncate(counted);
                return set.order;
            }
            counted += 1;
        }
    }
    set.order
}

#[cfg(test)]
#[path = "need_test.rs"]
mod tests;
