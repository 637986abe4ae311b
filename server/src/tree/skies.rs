//! Which references' skies are kept, and by which of them the eyes in every run of the walk volume go.
//!
//! Behind a wall or a floor another sky is seen. As few places are kept as tell every reference where it sees sky, if it goes by the nearest that it sees: greedily, always the one
//! whose own sky differs most from what it would be told, until none differs by much. Rooms without a window share one empty sky for as far as they see each other; outside,
//! skies come to lie where they change. An eye in a run then goes by that one of the nearest places that is right in most directions: seeing a place is not enough, as a window shows rooms that
//! have another sky.

use crate::render::{Caster, CellSet, Ray};
use glam::DVec3;
use ldi_protocol::{
    sky::SkyMap,
    tree::{Skies, SkyPlace},
    volume::WalkVolume,
};
use rayon::prelude::*;

/// At most so many are kept: more than references are taken, so that runs bound them; a place is told in 16 bits.
const MOST: usize = 1024;
/// At most so many runs of squares in all, but for the first sky; a byte or less each when they are stored, before anything is drawn.
const MOST_RUNS: usize = 65_536;
/// A reference whose sky is told with fewer wrong squares has no need of its own: a thousandth of all directions.
const FEW: u32 = SkyMap::SQUARES / 1000;
/// The nearest so many places are tried for each run of the volume. By judgement; fewer: none of them may be on the eye's side of walls and floors; more: outlines of places far off, which 128 directions do not tell from near ones.
const TRIED: usize = 12;
/// In so many directions, one bit of a number each. More tell places better apart; rays of all runs take seconds.
const DIRECTIONS: u32 = u128::BITS;
/// A volume of more runs has no table: eyes go by the nearest place. 250 m by 250 m in columns of half a metre.
const MOST_TOLD: usize = 1 << 18;
/// A volume of fewer runs is one of boxes to fly in, in which one place cannot speak for all: references are spread in it likewise from so few on.
const LEAST_TOLD: usize = 8;

/// The skies of a tree from what its references saw.
pub fn choose(caster: &Caster, skies: &[SkyPlace], volume: &WalkVolume) -> Skies {
    let sees = |a: DVec3, b: DVec3| !caster.occluded(&Ray { t_max: 1.0, ..Ray::new(a, b - a) }, &CellSet::all());
    let places = keep(skies, &sees);
    let tells = (LEAST_TOLD..=MOST_TOLD).contains(&volume.runs()) && !places.is_empty();
    let is_sky = |eye: DVec3, towards: DVec3| !caster.occluded(&Ray::new(eye, towards), &CellSet::all());
    let of_run = if tells { by_run(&places, volume, &is_sky) } else { Vec::new() };
    Skies { places, of_run }
}

/// What a reference is told by those kept so far: distances, numbers.
struct Told {
    nearest: (f64, usize),
    seen: Option<(f64, usize)>,
    /// Squares that are told wrong.
    wrong: u32,
}

impl Told {
    fn by(&self) -> usize {
        self.seen.unwrap_or(self.nearest).1
    }
}

/// Those to keep, the most wanted first.
fn keep(skies: &[SkyPlace], sees: &(dyn Fn(DVec3, DVec3) -> bool + Sync)) -> Vec<SkyPlace> {
    // The first of equals, on every machine.
    let most = |of: &dyn Fn(usize) -> u32, k: &usize| (of(*k), std::cmp::Reverse(*k));
    let none = SkyMap::default();
    let Some(first) = (0..skies.len()).max_by_key(|k| most(&|k| skies[k].sky.differs_by(&none), k)) else {
        return Vec::new();
    };
    let told =
        |s: &SkyPlace| Told { nearest: (f64::INFINITY, first), seen: None, wrong: s.sky.differs_by(&skies[first].sky) };
    let mut told: Vec<Told> = skies.iter().map(told).collect();
    let (mut kept, mut runs) = (vec![first], 0);
    let mut newest = Some(first);
    while let Some(new) = newest {
        told.par_iter_mut().zip(skies).for_each(|(t, s)| {
            let distance = s.position.distance_squared(skies[new].position);
            let before = t.by();
            if distance < t.nearest.0 {
                t.nearest = (distance, new);
            }
            if t.seen.is_none_or(|(d, _)| distance < d) && sees(s.position, skies[new].position) {
                t.seen = Some((distance, new));
            }
            if t.by() != before {
                t.wrong = s.sky.differs_by(&skies[t.by()].sky);
            }
        });
        let fits = |k: &usize| told[*k].wrong > FEW && runs + skies[*k].sky.runs().len() <= MOST_RUNS;
        newest = (0..skies.len()).filter(fits).max_by_key(|k| most(&|k| told[k].wrong, k));
        newest = newest.filter(|_| kept.len() < MOST);
        if let Some(k) = newest {
            runs += skies[k].sky.runs().len();
            kept.push(k);
        }
    }
    kept.into_iter().map(|k| skies[k].clone()).collect()
}

/// For the middle of every run that one of the nearest places which is right in most directions; of equals the nearest.
fn by_run(places: &[SkyPlace], volume: &WalkVolume, is_sky: &(dyn Fn(DVec3, DVec3) -> bool + Sync)) -> Vec<u16> {
    let boxes: Vec<_> = volume.boxes().collect();
    let bits = |is_sky: &dyn Fn(DVec3) -> bool| {
        (0..DIRECTIONS).map(direction).zip(0u32..).map(|(d, bit)| u128::from(is_sky(d)) << bit).sum::<u128>()
    };
    let seen: Vec<u128> = places.iter().map(|p| bits(&|d| p.sky.holds(d))).collect();
    let told = |eye: DVec3| {
        let mut near: Vec<(f64, u16)> =
            (0u16..).zip(places).map(|(k, p)| (p.position.distance_squared(eye), k)).collect();
        let tried = TRIED.min(near.len());
        if tried < near.len() {
            near.select_nth_unstable_by(tried, |a, b| a.0.total_cmp(&b.0));
            near.truncate(tried);
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let own = bits(&|d| is_sky(eye, d));
        let wrong = |(_, k): &&(f64, u16)| (seen[usize::from(*k)] ^ own).count_ones();
        // The first of equals.
        near.iter().min_by_key(wrong).map_or(0, |(_, k)| *k)
    };
    boxes.par_iter().map(|b| told(b.centre())).collect()
}

/// Evenly over the sphere, along a spiral.
fn direction(k: u32) -> DVec3 {
    let y = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(DIRECTIONS);
    let (sin, cos) = (f64::from(k) * std::f64::consts::PI * (3.0 - 5f64.sqrt())).sin_cos();
    let r = (1.0 - y * y).sqrt();
    DVec3::new(r * cos, y, r * sin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::Aabb;

    /// Two storeys of 40 x 1 m: rooms below, a terrace above. A wall parts the terrace at x = 20.
    fn house() -> WalkVolume {
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(40.0, 0.0, 1.0) };
        WalkVolume::new(DVec3::ZERO, 1.0, 0.1, [40, 1], &vec![vec![[0, 10], [30, 40]]; 40], &cut).expect("a volume")
    }

    fn sees(a: DVec3, b: DVec3) -> bool {
        (a.y > 2.0) == (b.y > 2.0) && (a.y < 2.0 || (a.x < 20.0) == (b.x < 20.0))
    }

    /// Below nothing, above the squares of its side.
    fn place(x: f64, y: f64) -> SkyPlace {
        let runs = match (y > 2.0, x < 20.0) {
            (false, _) => vec![],
            (true, true) => vec![[0, 50_000]],
            (true, false) => vec![[20_000, 50_000]],
        };
        SkyPlace { position: DVec3::new(x, y, 0.5), sky: SkyMap::of_runs(runs).expect("runs") }
    }

    #[test]
    fn three_skies_tell_a_house_of_three_kinds_of_places() {
        let volume = house();
        let all: Vec<SkyPlace> = (0..40).flat_map(|i| [0.5, 3.5].map(|y| place(f64::from(i) + 0.5, y))).collect();
        let places = keep(&all, &sees);
        assert_eq!(places.len(), 3, "{:?}", places.iter().map(|k| k.position).collect::<Vec<_>>());
        let is_sky = |eye: DVec3, towards| place(eye.x, eye.y).sky.holds(towards);
        let of_run = by_run(&places, &volume, &is_sky);
        let skies = Skies { places, of_run };
        for s in &all {
            assert_eq!(skies.at(s.position, Some(&volume)), Some(&s.sky), "{}", s.position);
        }
        // Without the table some eyes are told what the floor hides.
        let nearest = Skies { of_run: Vec::new(), ..skies };
        assert!(all.iter().any(|s| nearest.at(s.position, Some(&volume)) != Some(&s.sky)));
    }

    #[test]
    fn equal_skies_are_kept_once_and_none_of_none() {
        let rooms: Vec<SkyPlace> = (0..40).map(|i| place(f64::from(i) + 0.5, 0.5)).collect();
        assert_eq!(keep(&rooms, &sees).len(), 1);
        assert!(keep(&[], &sees).is_empty());
    }

    /// Skies that all differ and are of very many runs: as many as there is room for.
    #[test]
    fn their_runs_are_bounded() {
        let torn = |k: u32| SkyMap::of_runs((0..9_000).map(|i| [i * 40 + k, 20]).collect()).expect("runs");
        let all: Vec<SkyPlace> = (0..19).map(|k| SkyPlace { sky: torn(k), ..place(f64::from(k) + 0.5, 3.5) }).collect();
        assert_eq!(keep(&all, &sees).len(), 1 + MOST_RUNS / 9_000);
    }
}
