//! What a view needs, and what lies near: pure functions from the [`Index`] to ordered lists of chunk numbers.
//!
//! Server and client compute the same lists: the server to push, the client to pin, to ask for what is missing and to
//! keep what the server would push again.
//!
//! [`needed`]: the chunks of one view, in two classes. `now` leaves no gap: the first layers of the LDIs in view (they
//! fill the most pixels per byte, so they go first), then the drawn cells, near to far, each with the bundles it
//! refers to and the coarse levels of its textures. `fine` only sharpens: deeper layers, then finer texture levels in the
//! same near-to-far order.
//!
//! [`near_to_far`]: everything within a radius of the eye, whatever the direction (Aliaga and Lastra 1999, section 6: "all images
//! within a radius are loaded near to far"; here cells as well as images), until the cache is full. A chunk that only sharpens
//! counts as farther ([`FINE_FACTOR`], [`FINE_OFFSET_M`]), so that coarse data reaches farther than fine data.

use crate::index::Index;
use glam::DVec3;

/// A fine chunk at distance d is loaded together with the coarse ones at `FINE_FACTOR * d + FINE_OFFSET_M`. Larger: a
/// wider ring of coarse data before anything sharpens; 1 and 0: strictly by distance.
pub const FINE_FACTOR: f64 = 1.5;
/// See [`FINE_FACTOR`]; metres.
pub const FINE_OFFSET_M: f64 = 1.0;

/// The share of a client's cache that may be filled unasked. The rest holds what the views themselves need. The client
/// keeps this much around the eye from being evicted: were the server to push more, the two would work against each other.
pub const PREFETCH_SHARE: f64 = 0.75;

/// The chunks of one view; no number twice over both lists.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Needed {
    /// The base layer: the pinned levels of the LDI tree. It comes before everything and stays, whatever the view.
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
    fn take(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.order)
    }
}

/// What a view needs that draws `drawn_cells` (near to far), warps `images` and refines the LDI tree by the chunks `tree`.
pub fn needed(index: &Index, images: &[u32], drawn_cells: &[u32], tree: &[u32]) -> Needed {
    let mut set = OrderedSet::new(index.chunks.len());
    index.tree.iter().flat_map(|t| t.pinned_chunks()).for_each(|c| set.insert(c));
    let base = set.take();
    let layers = || images.iter().filter_map(|i| index.images.get(*i as usize)).map(|i| &i.chunks);
    let cells = || drawn_cells.iter().filter_map(|c| index.cells.get(*c as usize));
    layers().for_each(|c| c.iter().take(1).for_each(|c| set.insert(*c)));
    for cell in cells() {
        set.insert(cell.chunk);
        cell.bundles.iter().for_each(|b| set.insert(*b));
        texture_chunks(index, &cell.materials, 0).for_each(|t| set.insert(t));
    }
    let now = set.take();
    tree.iter().for_each(|c| set.insert(*c));
    layers().for_each(|c| c.iter().skip(1).for_each(|c| set.insert(*c)));
    for cell in cells() {
        texture_chunks(index, &cell.materials, 1).for_each(|t| set.insert(t));
    }
    Needed { base, now, fine: set.take() }
}

/// Chunks of the materials' textures: the coarsest range of levels (`skip` 0) or all finer ones (`skip` 1).
fn texture_chunks<'a>(index: &'a Index, materials: &'a [u32], skip: usize) -> impl Iterator<Item = u32> + 'a {
    materials
        .iter()
        .filter_map(|m| index.materials.get(*m as usize)?.texture)
        .filter_map(|t| index.textures.get(t as usize))
        .flat_map(move |t| t.chunks.iter().skip(skip).take(if skip == 0 { 1 } else { usize::MAX }))
        .map(|c| c.chunk)
}

/// How far [`near_to_far`] goes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Metres from the eye.
    pub radius_m: f64,
    /// Decoded bytes in all.
    pub decoded_bytes: u64,
}

/// Chunks around an eye, near to far, up to `reach`. The list ends before the first chunk that would exceed the bytes, so
/// that what is near never gives way to something smaller and farther.
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
            CELL => {
                let cell = &index.cells[number];
                set.insert(cell.chunk);
                cell.bundles.iter().for_each(|b| set.insert(*b));
                texture_chunks(index, &cell.materials, 0).for_each(|t| set.insert(t));
            }
            _ => texture_chunks(index, &index.cells[number].materials, 1).for_each(|t| set.insert(t)),
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
