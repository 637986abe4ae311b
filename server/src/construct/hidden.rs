//! Which samples eyes see past the cells that stay.
//!
//! Rays of the survey lie 32 pixels apart, and images are made around what they met, with a margin. Behind a wall that stays that is
//! more than anyone sees, and what lies close behind it is drawn through it in places, as disparities are rounded. So each sample that was made is asked for: an eye looks
//! straight at it, and where a cell that stays is before it for all eyes that see something around, it goes.
//!
//! In: a caster, what eyes see of a face, samples. Out: the samples that stay.

use super::{
    caster::{Met, SubsetCaster},
    central::BATCH,
    merge::Known,
    sample::UNSEEN,
    sight::{BLOCK, Face, blocks_of},
    slivers::Candidate,
    sums::Sums,
    view::{ConstructionCamera, Rig},
};
use crate::{
    placement::{Gaze, scattered},
    render::Ray,
};
use glam::DVec3;
use rayon::prelude::*;

/// So many eyes look at the samples of [`ROWS`] rows of a block, others at the next rows. By judgement: a hundred and more look at what is around a sample, as a gap of a few centimetres is seen through from few places.
const LOOKS: usize = 16;
/// More: rays of one eye go together, which is faster; fewer: more eyes.
const ROWS: usize = 4;
/// Eyes stand where one of the survey's does, or on the way to one of so many of its neighbours; by judgement. More: farther ones, with walls between.
const NEIGHBOURS: usize = 8;
/// The first of these, a share of all; by judgement. The survey's eyes are the outermost.
const OUTERMOST: f64 = 0.33;
/// Samples stay that lie this many pixels from one that is seen: eyes between those tried see a little more, and surfaces are joined to what they go on to.
pub(super) const AROUND: usize = 8;
/// A cell that stays hides a sample if it is nearer by this share of the distance: disparities are f32, and where two cells join the one that stays must not hide the other's border.
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

    /// Forgets the samples that no eye sees and that are not beside one which an eye sees: of the central image, and of each rank behind it. Returns the number of rays.
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

    /// Which of some samples stay, at most one per pixel, in ascending order, each with its disparity; and the number of rays. Where samples lie side by side looking at every other one does (`thinned`); a
    /// deeper rank may have a single pixel at a place.
    fn stay<C: SubsetCaster>(&self, caster: &C, rig: &Rig, samples: &[(u32, f32)], thinned: bool) -> (Vec<bool>, u64) {
        let width = rig.window.width as usize;
        let place = |pixel: u32| (pixel as usize % width, pixel as usize / width);
        let mut of_block: Vec<Vec<(u32, DVec3)>> = vec![Vec::new(); self.blocks.len()];
        for (pixel, disparity) in samples {
            let (column, row) = place(*pixel);
            if !thinned || (column + row) % 2 == 0 {
                let (u, v) = rig.window.centre(*pixel as usize);
                let at = rig.cop + rig.lens.ray(u, v) / f64::from(*disparity);
                of_block[row / BLOCK * self.columns + column / BLOCK].push((*pixel, at));
            }
        }
        let look = |(mut hidden, eyes): (Vec<(u32, DVec3)>, &Vec<u16>)| {
            let (mut seen, mut count) = (Vec::new(), 0);
            for round in 0..LOOKS {
                if hidden.is_empty() || eyes.is_empty() {
                    break;
                }
                let ray = |(pixel, at): &(u32, DVec3)| {
                    let (column, row) = place(*pixel);
                    let eye = self.eye(eyes, (row / ROWS * self.columns + column / BLOCK) * LOOKS + round);
                    Ray { origin: eye, direction: *at - eye, t_min: 1e-6, t_max: 1.0 - NEARER }
                };
                let rays: Vec<Ray> = hidden.iter().map(ray).collect();
                let mut met = vec![Met::Nothing; rays.len()];
                caster.meet(&rays, &mut met);
                count += rays.len() as u64;
                let mut met = met.iter();
                hidden.retain(|(pixel, _)| {
                    let stays = met.next() == Some(&Met::Stays);
                    if !stays {
                        seen.push(*pixel);
                    }
                    stays
                });
            }
            (seen, count)
        };
        let found: Vec<(Vec<u32>, u64)> = of_block.into_par_iter().zip(&self.blocks).map(look).collect();
        let mut seen = vec![false; rig.window.pixels()];
        found.iter().flat_map(|f| &f.0).for_each(|p| seen[*p as usize] = true);
        let (seen, height) = (Sums::new(&seen, width), rig.window.height as usize);
        let around = |at: usize, end: usize| at.saturating_sub(AROUND)..(at + AROUND + 1).min(end);
        let stays = |(pixel, _): &(u32, f32)| {
            let (column, row) = place(*pixel);
            seen.count(around(column, width), around(row, height)) > 0
        };
        (samples.iter().map(stays).collect(), found.iter().map(|f| f.1).sum())
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
        let mut met = vec![Met::Nothing; rays.len()];
        caster.meet(&rays, &mut met);
        met
    };
    let met: Vec<Met> = candidates.par_chunks(BATCH).flat_map_iter(hidden).collect();
    let mut met = met.iter();
    let rays = candidates.len() as u64;
    candidates.retain(|_| met.next() != Some(&Met::Stays));
    rays
}
