//! Where reference images are taken: greedily, always where an eye sees the most that none of
//! those before sees well.
//!
//! In: the walk volume, and the scene's box for eyes that nobody planned for. Out: positions. What
//! is seen is counted in cubes by face: a cube of the scene and the direction its surface looks
//! to. A reference near a surface sees it well, one far off in part ([`FAR_VALUE`]). The gain of a
//! place only shrinks while others are chosen, so that a place whose old gain is beaten by
//! another's need not be counted anew (lazy greedy); the greedy choice covers at least 63% of what
//! the best choice of as many places could. Places all over the scene's box come after those of
//! the walk volume, for what they see in addition: they are taken coarsely.

use super::{probe::radical, reference::direction};
use crate::render::{Caster, CellSet, Ray};
use glam::{DVec3, IVec3};
use ldi_protocol::{Aabb, volume::WalkVolume};
use rayon::prelude::*;
use std::collections::{BinaryHeap, HashMap};

/// Most candidates.
const MAX_CANDIDATES: usize = 2500;
/// Most positions.
const MAX_POSITIONS: usize = 800;
/// Rays along a side of each of a candidate's six pictures. More find smaller gaps; time grows
/// with the square.
const PROBES: u32 = 16;
/// Edge of the cubes in which what is seen is counted, in parts of the median distance to what
/// candidates see.
const CUBES: f64 = 0.25;
/// Those in which outside candidates' sights are counted are this much wider: their references are
/// coarse.
const OUTSIDE_CUBES: f64 = 4.0;
/// Within so many median distances a surface is seen well.
const WELL: f64 = 2.0;
/// What a surface that is seen from afar counts.
const FAR_VALUE: f32 = 0.3;
/// Candidates outside of the walk volume, all over the scene's box.
const OUTSIDE_CANDIDATES: usize = 600;
/// Most positions among them.
const MAX_OUTSIDE: usize = 300;
/// A position that adds less than this part of everything is not taken.
const LEAST_GAIN: f64 = 2e-4;

/// Where references are taken, and what was found on the way.
#[derive(Debug, Clone)]
pub struct Places {
    /// Where to take references.
    pub positions: Vec<DVec3>,
    /// Where to take coarse references, for eyes outside of the walk volume.
    pub outside: Vec<DVec3>,
    /// Among how many they were chosen.
    pub candidates: usize,
    /// What they see over what all candidates see.
    pub coverage: f64,
    /// Area of what all candidates see, square metres, roughly.
    pub area_m2: f64,
    /// Of every part of it, how near the nearest candidate is, metres.
    nearest_m: Vec<f32>,
    /// Of a part, square metres.
    part_m2: f64,
    /// Rays cast.
    pub rays: u64,
}

impl Places {
    /// Samples that a tree needs, roughly, if no eye is to see one larger than `footprint_px`, nor
    /// any smaller than `pitch_m`. Filtered copies add a third.
    pub fn samples_at(&self, footprint_px: f64, focal_px: f64, pitch_m: f64) -> f64 {
        let pitch = |nearest: &f32| (footprint_px * f64::from(*nearest) / focal_px).max(pitch_m);
        self.nearest_m.iter().map(|d| self.part_m2 / pitch(d).powi(2)).sum::<f64>() * 4.0 / 3.0
    }
}

/// What a candidate sees: elements, and how much each counts.
type Seen = Vec<(u32, f32)>;

/// Middles of the volume's boxes, thinned to one per cube of a size that leaves few enough.
fn candidates(volume: &WalkVolume) -> Vec<DVec3> {
    let all: Vec<DVec3> = volume.boxes().map(|b| b.centre()).collect();
    if all.len() < 8 {
        // Flying: one large box.
        let sampler = volume.sampler();
        let point = |k: usize| [radical(k, 7), radical(k, 2), radical(k, 3), radical(k, 5)];
        return (1..=MAX_CANDIDATES / 2).filter_map(|k| sampler.point(point(k))).chain(all).collect();
    }
    let mut edge = 0.5;
    loop {
        let mut taken = HashMap::new();
        let kept: Vec<DVec3> =
            all.iter().copied().filter(|p| taken.insert((*p / edge).floor().as_ivec3(), ()).is_none()).collect();
        if kept.len() <= MAX_CANDIDATES {
            return kept;
        }
        edge *= 1.2;
    }
}

/// Points spread over the scene's box.
fn outside(bounds: &Aabb) -> Vec<DVec3> {
    let point = |k: usize| bounds.min + bounds.size() * DVec3::new(radical(k, 2), radical(k, 3), radical(k, 5));
    if bounds.is_empty() { Vec::new() } else { (1..=OUTSIDE_CANDIDATES).map(point).collect() }
}

/// Chooses positions for the eyes of a volume, and for eyes anywhere in the scene's `bounds`.
pub fn choose(caster: &Caster, volume: &WalkVolume, bounds: &Aabb) -> Places {
    let mut candidates = candidates(volume);
    let within = candidates.len();
    candidates.extend(outside(bounds));
    let probe = |eye: &DVec3| -> Vec<(DVec3, DVec3, f64)> {
        let rays: Vec<Ray> = (0..6)
            .flat_map(|face| (0..PROBES * PROBES).map(move |k| (face, k % PROBES, k / PROBES)))
            .map(|(f, c, r)| Ray::new(*eye, direction(f, f64::from(c) + 0.5, f64::from(r) + 0.5, PROBES)))
            .collect();
        let mut hits = vec![None; rays.len()];
        caster.trace_batch(&rays, &CellSet::all(), &mut hits);
        let seen = rays.iter().zip(&hits).filter_map(|(ray, hit)| {
            let s = caster.surface(hit.as_ref()?, ray);
            let towards = if s.geometric_normal.dot(ray.direction) > 0.0 { -1.0 } else { 1.0 };
            let (normal, away) = (s.geometric_normal * towards, s.position_world.distance(*eye));
            Some((s.position_world, normal, away))
        });
        seen.collect()
    };
    let views: Vec<Vec<(DVec3, DVec3, f64)>> = candidates.par_iter().map(probe).collect();
    let rays = candidates.len() as u64 * u64::from(6 * PROBES * PROBES);
    let mut distances: Vec<f64> = views[..within].iter().flatten().map(|v| v.2).collect();
    let middle = distances.len() / 2;
    let median =
        if distances.is_empty() { 1.0 } else { distances.select_nth_unstable_by(middle, f64::total_cmp).1.max(1e-3) };
    let edge = median * CUBES;
    let value = |distance: f64| if distance <= WELL * median { 1.0 } else { FAR_VALUE };
    let Elements { seen, most, mut nearest_m, of_first: of_volume } = elements(&views, within, edge, value);
    let everything: f64 = most[..of_volume].iter().map(|v| f64::from(*v)).sum();
    let mut have = vec![0.0f32; most.len()];
    let (chosen, covered) = greedy(&seen[..within], &mut have, everything, MAX_POSITIONS);
    // What coarse references are to add: from afar one ray hits one of many small cubes.
    let coarse = elements(&views, within, edge * OUTSIDE_CUBES, |_| 1.0);
    let all: f64 = coarse.most.iter().map(|v| f64::from(*v)).sum();
    let mut have = vec![0.0f32; coarse.most.len()];
    for (element, value) in chosen.iter().flat_map(|k| &coarse.seen[*k]) {
        have[*element as usize] = *value;
    }
    let (beyond, _) = greedy(&coarse.seen[within..], &mut have, all, MAX_OUTSIDE);
    nearest_m.truncate(of_volume);
    // A cube that a plane crosses holds about two thirds of its face's area.
    let part_m2 = edge * edge * 2.0 / 3.0;
    Places {
        positions: chosen.into_iter().map(|k| candidates[k]).collect(),
        outside: beyond.into_iter().map(|k| candidates[within + k]).collect(),
        candidates: within,
        coverage: if everything > 0.0 { covered / everything } else { 0.0 },
        area_m2: of_volume as f64 * part_m2,
        nearest_m,
        part_m2,
        rays,
    }
}

/// What candidates see, in cubes.
struct Elements {
    /// Per candidate.
    seen: Vec<Seen>,
    /// Per element: the largest value that it has for a candidate.
    most: Vec<f32>,
    /// Per element: how near the nearest candidate is, metres.
    nearest_m: Vec<f32>,
    /// Elements that the first candidates see; they come first.
    of_first: usize,
}

/// The faces of cubes of this `edge`, metres, that hold what candidates see (place, normal towards
/// them, distance in metres). `first`: candidates whose elements are counted apart. `value`: what
/// an element counts at a distance.
fn elements(views: &[Vec<(DVec3, DVec3, f64)>], first: usize, edge: f64, value: impl Fn(f64) -> f32) -> Elements {
    let mut numbers: HashMap<(IVec3, usize), u32> = HashMap::new();
    let mut nearest_m: Vec<f32> = Vec::new();
    let mut of_first = 0;
    let of_view = |(candidate, view): (usize, &Vec<(DVec3, DVec3, f64)>)| {
        let mut best: HashMap<u32, f32> = HashMap::new();
        for (at, normal, distance) in view {
            let axis = normal.abs().max_position();
            let face = 2 * axis + usize::from(normal[axis] > 0.0);
            let next = numbers.len() as u32;
            let element = *numbers.entry(((at / edge).floor().as_ivec3(), face)).or_insert(next);
            if element as usize == nearest_m.len() {
                nearest_m.push(f32::INFINITY);
            }
            let nearest = &mut nearest_m[element as usize];
            *nearest = nearest.min(*distance as f32);
            let b = best.entry(element).or_insert(0.0);
            *b = b.max(value(*distance));
        }
        if candidate < first {
            of_first = nearest_m.len();
        }
        let mut list: Seen = best.into_iter().collect();
        list.sort_unstable_by_key(|e| e.0);
        list
    };
    let seen: Vec<Seen> = views.iter().enumerate().map(of_view).collect();
    let mut most = vec![0.0f32; nearest_m.len()];
    for (element, value) in seen.iter().flatten() {
        most[*element as usize] = most[*element as usize].max(*value);
    }
    Elements { seen, most, nearest_m, of_first }
}

/// Lazy greedy choice of at most so many candidates: in order, and the value that they add to what
/// is covered already.
fn greedy(seen: &[Seen], have: &mut [f32], everything: f64, at_most: usize) -> (Vec<usize>, f64) {
    let gain_of = |k: usize, have: &[f32]| -> f64 {
        seen[k].iter().map(|(e, v)| f64::from((v - have[*e as usize]).max(0.0))).sum()
    };
    // Gains in whole millionths, so that they have an order; of equal gains the first candidate.
    let key = |gain: f64, k: usize| ((gain * 1e6) as u64, usize::MAX - k);
    let mut heap: BinaryHeap<(u64, usize)> = (0..seen.len()).map(|k| key(gain_of(k, have), k)).collect();
    let (mut chosen, mut covered) = (Vec::new(), 0.0);
    while let Some((_, k)) = heap.pop() {
        let k = usize::MAX - k;
        let gain = gain_of(k, have);
        let now = key(gain, k);
        if heap.peek().is_some_and(|next| *next > now) {
            heap.push(now);
            continue;
        }
        if gain <= everything * LEAST_GAIN || chosen.len() == at_most {
            break;
        }
        covered += gain;
        chosen.push(k);
        for (e, v) in &seen[k] {
            have[*e as usize] = have[*e as usize].max(*v);
        }
    }
    (chosen, covered)
}
