//! Which samples eyes see past the cells that stay.
//!
//! Rays of the survey lie 32 pixels apart, and images are made around what they met, with a
//! margin. Behind a wall that stays that is more than anyone sees, and what lies close behind it
//! is drawn through it in places, as disparities are rounded. So each sample that was made is
//! asked for: an eye looks straight at it, and where a cell that stays is before it for all eyes
//! that see something around, it goes.
//!
//! In: a caster, what eyes see of a face, samples. Out: the samples that stay.

use super::{
    caster::SubsetCaster,
    central::BATCH,
    merge::Known,
    sample::UNSEEN,
    sight::{BLOCK, Face, blocks_of},
    slivers::Candidate,
    view::{ConstructionCamera, Rig},
};
use crate::{
    placement::{Gaze, scattered},
    render::Ray,
};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// So many eyes look at the samples of [`ROWS`] rows of a block, others at the next rows. By
/// judgement: a hundred and more look at what is around a sample, as a gap of a few centimetres is
/// seen through from few places.
const LOOKS: usize = 16;
/// More: rays of one eye go together, which is faster; fewer: more eyes.
const ROWS: usize = 4;
/// Eyes stand where one of the survey's does, or on the way to one of so many of its neighbours;
/// by judgement. More: farther ones, with walls between.
const NEIGHBOURS: usize = 8;
/// The first of these, a share of all; by judgement. The survey's eyes are the outermost.
const OUTERMOST: f64 = 0.33;
/// Samples stay that lie this many pixels from one that is seen: eyes between those tried see a
/// little more, and surfaces are joined to what they go on to.
pub(super) const AROUND: usize = 8;
/// Samples of at most one in so many columns and rows are looked at first, then of more and more:
/// only those around which there are samples that no seen one is close to. What stays is the same
/// without.
const APART: [usize; 4] = [8, 4, 2, 1];
/// The eyes of a sample, asked together: few at first, as most samples that any eye sees the first
/// ones see.
const ROUNDS: [Range<usize>; 3] = [0..2, 2..6, 6..LOOKS];
/// A cell that stays hides a sample if it is nearer by this share of the distance: disparities are
/// f32, and where two cells join the one that stays must not hide the other's border.
const NEARER: f64 = 1e-5;

/// Eyes that see something replaced, by blocks of the window.
pub(super) struct Watchers {
    eyes: Vec<DVec3>,
    /// Numbers of each eye's [`NEIGHBOURS`].
    beside: Vec<Vec<u16>>,
    /// Numbers of eyes.
    blocks: Vec<Vec<u16>>,
    columns: usize,
}

impl Watchers {
    /// Those of a rig's window.
    pub fn of(face: &Face, rig: &Rig) -> Self {
        let basis = &rig.lens.basis;
        let world = |o: &DVec3| rig.cop + basis.right * o.x + basis.up * o.y + basis.forward * o.z;
        let eyes: Vec<DVec3> = face.eyes().map(|(offset, _)| world(offset)).collect();
        let beside = |eye: &DVec3| {
            let mut all: Vec<u16> = (0..eyes.len() as u16).filter(|e| eyes[usize::from(*e)] != *eye).collect();
            all.sort_by(|a, b| {
                let apart = |e: u16| eyes[usize::from(e)].distance_squared(*eye);
                apart(*a).total_cmp(&apart(*b)).then(a.cmp(b))
            });
            all.truncate(NEIGHBOURS);
            all
        };
        let beside = eyes.iter().map(beside).collect();
        let (width, height) = (rig.window.width as usize, rig.window.height as usize);
        let columns = width.div_ceil(BLOCK);
        let mut blocks: Vec<Vec<u16>> = vec![Vec::new(); columns * height.div_ceil(BLOCK)];
        for (number, (_, glimpses)) in face.eyes().enumerate() {
            for glimpse in glimpses {
                let (across, down) = blocks_of(&rig.window, BLOCK, glimpse);
                for block in down.flat_map(|row| across.clone().map(move |column| row * columns + column)) {
                    if blocks[block].last() != Some(&(number as u16)) {
                        blocks[block].push(number as u16);
                    }
                }
            }
        }
        Self { eyes, beside, blocks, columns }
    }

    /// Forgets the samples that no eye sees and that are not beside one which an eye sees: of the
    /// central image, and of each rank behind it. Returns the number of rays.
    pub fn forget_hidden<C: SubsetCaster>(&self, caster: &C, rig: &Rig, known: &mut Known) -> u64 {
        let solid = known.central.iter().enumerate().filter(|(_, s)| s.disparity > 0.0);
        let mut ranks = vec![solid.map(|(p, s)| (p as u32, s.disparity)).collect::<Vec<_>>()];
        let ranked = known.ranks();
        for ((pixel, sample), rank) in known.deeper.iter().zip(&ranked) {
            if ranks.len() <= *rank {
                ranks.push(Vec::new());
            }
            ranks[*rank].push((*pixel, sample.disparity));
        }
        let (stay, rays): (Vec<Vec<bool>>, Vec<u64>) =
            ranks.iter().enumerate().map(|(rank, r)| self.stay(caster, rig, r, rank == 0)).unzip();
        let mut next = vec![0; ranks.len()];
        let mut stays = |rank: usize| {
            next[rank] += 1;
            stay[rank][next[rank] - 1]
        };
        known.central.iter_mut().filter(|s| s.disparity > 0.0 && !stays(0)).for_each(|s| s.disparity = UNSEEN);
        let mut ranked = ranked.into_iter();
        known.retain_deeper(|_| ranked.next().is_some_and(&mut stays));
        rays.iter().sum()
    }

    /// A place at or beside one of some of the survey's eyes.
    fn eye(&self, some: &[u16], number: usize) -> DVec3 {
        let [which, way] = scattered(number);
        let first = usize::from(some[((which * some.len() as f64) as usize).min(some.len() - 1)]);
        let beside = &self.beside[first];
        let Some(second) = beside.get(number % NEIGHBOURS.min(beside.len().max(1))) else { return self.eyes[first] };
        self.eyes[first].lerp(self.eyes[usize::from(*second)], ((way - OUTERMOST) / (1.0 - OUTERMOST)).max(0.0))
    }

    /// Which of some samples stay, at most one per pixel, in ascending order, each with its
    /// disparity; and the number of rays. Where samples lie side by side looking at every other
    /// one does (`thinned`); a deeper rank may have a single pixel at a place.
    ///
    /// A few samples are looked at first, then those between: most of these lie around one that is
    /// seen, and what is around them does, too.
    fn stay<C: SubsetCaster>(&self, caster: &C, rig: &Rig, samples: &[(u32, f32)], thinned: bool) -> (Vec<bool>, u64) {
        let width = rig.window.width as usize;
        let place = |pixel: u32| (pixel as usize % width, pixel as usize / width);
        let is_asked = |(pixel, _): &&(u32, f32)| {
            let (column, row) = place(*pixel);
            !thinned || (column + row) % 2 == 0
        };
        let mut asked: Vec<(u32, f32)> = samples.iter().filter(is_asked).copied().collect();
        let mut stays = Around::new(width, rig.window.height as usize);
        let mut rays = 0;
        for apart in APART {
            let mut taken = vec![false; width.div_ceil(apart) * (rig.window.height as usize).div_ceil(apart)];
            let mut now = Vec::new();
            asked.retain(|sample| {
                let (column, row) = place(sample.0);
                if stays.holds_all_around(column, row) {
                    return false;
                }
                let cell = &mut taken[row / apart * width.div_ceil(apart) + column / apart];
                let later = std::mem::replace(cell, true);
                if !later {
                    now.push(*sample);
                }
                later
            });
            // Of one eye, then along its rays: neighbours on them are neighbours in its picture.
            let part = |pixel: u32| {
                let (column, row) = place(pixel);
                row / ROWS * self.columns + column / BLOCK
            };
            now.sort_by(|a, b| part(a.0).cmp(&part(b.0)).then(a.1.total_cmp(&b.1)).then(a.0.cmp(&b.0)));
            for rounds in ROUNDS {
                let look = |samples: &[(u32, f32)]| {
                    let (column, row) = place(samples[0].0);
                    let eyes = &self.blocks[row / BLOCK * self.columns + column / BLOCK];
                    let number = part(samples[0].0) * LOOKS;
                    self.seen(caster, rig, samples, eyes, rounds.clone().map(|round| number + round))
                };
                let parts: Vec<&[(u32, f32)]> = now.chunk_by(|a, b| part(a.0) == part(b.0)).collect();
                let found: Vec<(Vec<bool>, u64)> = parts.into_par_iter().map(look).collect();
                rays += found.iter().map(|f| f.1).sum::<u64>();
                let mut seen = found.iter().flat_map(|f| &f.0);
                now.retain(|(pixel, _)| {
                    let seen = seen.next().is_some_and(|s| *s);
                    if seen {
                        let (column, row) = place(*pixel);
                        stays.add(column, row);
                    }
                    !seen
                });
                now.retain(|(pixel, _)| {
                    let (column, row) = place(*pixel);
                    !stays.holds_all_around(column, row)
                });
            }
        }
        let stay = |(pixel, _): &(u32, f32)| {
            let (column, row) = place(*pixel);
            stays.holds(column, row)
        };
        (samples.iter().map(stay).collect(), rays)
    }

    /// Which of some samples one of some eyes sees, one eye after the other; and the number of
    /// rays.
    fn seen<C: SubsetCaster>(
        &self,
        caster: &C,
        rig: &Rig,
        samples: &[(u32, f32)],
        eyes: &[u16],
        numbers: impl Iterator<Item = usize>,
    ) -> (Vec<bool>, u64) {
        let (mut seen, mut count) = (vec![false; samples.len()], 0);
        let at = |(pixel, disparity): &(u32, f32)| {
            let (u, v) = rig.window.centre(*pixel as usize);
            rig.cop + rig.lens.ray(u, v) / f64::from(*disparity)
        };
        let mut left: Vec<(usize, DVec3)> = samples.iter().map(at).enumerate().collect();
        for number in numbers {
            if left.is_empty() || eyes.is_empty() {
                break;
            }
            let eye = self.eye(eyes, number);
            let ray = |at: &DVec3| Ray { origin: eye, direction: *at - eye, t_min: 1e-6, t_max: 1.0 - NEARER };
            let rays: Vec<Ray> = left.iter().map(|(_, at)| ray(at)).collect();
            let mut hidden = vec![false; rays.len()];
            caster.hide(&rays, &mut hidden);
            count += rays.len() as u64;
            let mut hidden = hidden.into_iter();
            left.retain(|(sample, _)| {
                let hidden = hidden.next() == Some(true);
                seen[*sample] |= !hidden;
                hidden
            });
        }
        (seen, count)
    }
}

/// The pixels around some, at most [`AROUND`] away along both axes: a bit for each.
struct Around {
    words: Vec<u64>,
    /// Words of a row.
    stride: usize,
    width: usize,
    height: usize,
}

impl Around {
    fn new(width: usize, height: usize) -> Self {
        // One more, so that a row's bits may be read as two words everywhere.
        let stride = width / 64 + 2;
        Self { words: vec![0; stride * height], stride, width, height }
    }

    /// For each row around a pixel its first word, and the bits in it and the next one.
    fn rows(&self, column: usize, row: usize) -> impl Iterator<Item = (usize, [u64; 2])> + use<> {
        let first = column.saturating_sub(AROUND);
        let count = (column + AROUND + 1).min(self.width) - first;
        let bits = u128::from((1u64 << count) - 1) << (first % 64);
        let stride = self.stride;
        (row.saturating_sub(AROUND)..(row + AROUND + 1).min(self.height))
            .map(move |r| (r * stride + first / 64, [bits as u64, (bits >> 64) as u64]))
    }

    /// Adds what is around a pixel.
    fn add(&mut self, column: usize, row: usize) {
        for (at, [a, b]) in self.rows(column, row) {
            self.words[at] |= a;
            self.words[at + 1] |= b;
        }
    }

    /// Whether adding what is around a pixel would change nothing.
    fn holds_all_around(&self, column: usize, row: usize) -> bool {
        self.rows(column, row).all(|(at, [a, b])| self.words[at] & a == a && self.words[at + 1] & b == b)
    }

    fn holds(&self, column: usize, row: usize) -> bool {
        self.words[row * self.stride + column / 64] >> (column % 64) & 1 == 1
    }
}

/// Drops what construction cameras see only through cells that stay. Returns the number of rays.
pub(super) fn drop_hidden<C: SubsetCaster>(
    caster: &C,
    rig: &Rig,
    cameras: &[ConstructionCamera],
    candidates: &mut Vec<Candidate>,
) -> u64 {
    let hidden = |batch: &[Candidate]| {
        let ray = |c: &Candidate| {
            let camera = &cameras[c.camera as usize];
            let (u, v) = camera.centre(c.pixel as usize);
            Gaze::ray(camera.position, rig.lens.ray(u, v))
        };
        let rays: Vec<Ray> = batch.iter().map(ray).collect();
        let mut hidden = vec![false; rays.len()];
        caster.hide(&rays, &mut hidden);
        hidden
    };
    let hidden: Vec<bool> = candidates.par_chunks(BATCH).flat_map_iter(hidden).collect();
    let mut hidden = hidden.into_iter();
    let rays = candidates.len() as u64;
    candidates.retain(|_| hidden.next() != Some(true));
    rays
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_around_is_within_reach_and_in_the_window() {
        let (width, height) = (131, 40);
        let mut around = Around::new(width, height);
        let places = [(0, 0), (62, 20), (63, 3), (64, 39), (130, 39), (127, 12)];
        for (column, row) in places {
            assert!(!around.holds_all_around(column, row));
            around.add(column, row);
            assert!(around.holds_all_around(column, row));
        }
        let near = |a: (usize, usize), b: (usize, usize)| a.0.abs_diff(b.0).max(a.1.abs_diff(b.1)) <= AROUND;
        let pixels = || (0..height).flat_map(|row| (0..width).map(move |column| (column, row)));
        let wanted = |at: (usize, usize)| places.iter().any(|p| near(*p, at));
        for at in pixels() {
            assert_eq!(around.holds(at.0, at.1), wanted(at), "{at:?}");
            let all = pixels().filter(|b| near(at, *b)).all(wanted);
            assert_eq!(around.holds_all_around(at.0, at.1), all, "{at:?}");
        }
    }
}
