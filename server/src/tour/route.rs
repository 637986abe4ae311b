//! Where a tour goes: from place to place, each new, with a long view, and not far to walk.
//!
//! In: the ground, a length and a seed. Out: stops with the ways between them.

use super::ground::{Ground, Spot};
use glam::DVec3;
use ldi_protocol::stroll::Random;
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
};

/// Spots that are reached from a stop: what is farther is for later stops. At half a metre, a disc
/// of 18 m radius.
const REACHED: usize = 4_000;
/// Spots that are reached from a place that a tour may start at.
const REACHED_FIRST: usize = 800;
/// Places where a tour may start.
const STARTS: usize = 32;
/// Places where it may go next.
const CANDIDATES: usize = 64;
/// Shortest way to the next stop, metres.
const LEAST_WAY_M: f64 = 3.0;
/// A place is as new as can be at this distance from the way so far, metres.
const NEW_M: f64 = 12.0;
/// What is higher or lower counts so many times the distance: another storey is new.
const STOREY: f64 = 3.0;
/// Longest view that counts, metres.
const VIEW_M: f64 = 40.0;
/// What is farther is not seen, metres.
const FAR_M: f64 = 400.0;
/// What a view of [`VIEW_M`] is worth, in metres of distance from the way so far.
const VIEW_WORTH: f64 = 8.0;
/// What it is worth that a place is out of sight of the stop before, metres.
const HIDDEN_WORTH: f64 = 3.0;
/// What a metre of way costs.
const WAY_COST: f64 = 0.2;
/// Directions in which views are measured, and the slopes in each.
const DIRECTIONS: u32 = 16;
/// See [`DIRECTIONS`].
const SLOPES: [f64; 3] = [-0.15, 0.0, 0.2];
/// Directions of which the farthest make a view.
const LOOKED: usize = 5;
/// Spots that one straight way may replace.
const LONGEST_SHORTCUT: usize = 40;

/// A place where a tour rests, and the way there.
#[derive(Debug, Clone, PartialEq)]
pub struct Stop {
    /// From the stop before to this one, both included.
    pub way: Vec<DVec3>,
    /// Direction of the longest view, degrees.
    pub look_deg: f64,
}

/// A route of at least this length, if one can walk so far; the first stop is the start. None if
/// nobody stands anywhere.
pub fn route(ground: &Ground<'_>, length_m: f64, seed: u64) -> Option<Vec<Stop>> {
    let mut random = Random::new(seed, 0);
    let mut here = start(ground, &mut random)?;
    let eye = ground.eye(here)?;
    let mut stops = vec![Stop { way: vec![eye], look_deg: view(ground, eye).1 }];
    let mut been = vec![eye];
    let mut walked_m = 0.0;
    while walked_m < length_m {
        let Some(next) = next(ground, here, &been, &mut random) else { break };
        let way = straightened(ground, &next.way);
        for pair in way.windows(2) {
            let length = pair[0].distance(pair[1]);
            walked_m += length;
            let steps = length.ceil().max(1.0) as u32;
            been.extend((1..=steps).map(|n| pair[0].lerp(pair[1], f64::from(n) / f64::from(steps))));
        }
        here = next.spot;
        stops.push(Stop { way, look_deg: next.look_deg });
    }
    Some(stops)
}

/// The place to begin at: of some places, the one from which one gets about most, and of those the
/// one with the longest view.
fn start(ground: &Ground<'_>, random: &mut Random) -> Option<Spot> {
    let sampler = ground.volume().sampler();
    let mut best: Option<(usize, f64, Spot)> = None;
    for _ in 0..STARTS {
        let place = sampler.point([random.uniform(), random.uniform(), random.uniform(), random.uniform()])?;
        let Some(spot) = ground.spot_at(place) else { continue };
        let Some(eye) = ground.eye(spot) else { continue };
        let reached = reach(ground, spot, REACHED_FIRST).len();
        let view = view(ground, eye).0;
        if best.is_none_or(|b| (reached, view) > (b.0, b.1)) {
            best = Some((reached, view, spot));
        }
    }
    best.map(|b| b.2)
}

struct Next {
    spot: Spot,
    way: Vec<DVec3>,
    look_deg: f64,
}

/// The best place to go to next.
fn next(ground: &Ground<'_>, here: Spot, been: &[DVec3], random: &mut Random) -> Option<Next> {
    let reached = reach(ground, here, REACHED);
    let eye = ground.eye(here)?;
    let mut far: Vec<(Spot, f64)> =
        reached.iter().map(|(spot, (way_m, _))| (*spot, *way_m)).filter(|(_, way_m)| *way_m >= LEAST_WAY_M).collect();
    if far.is_empty() {
        return None;
    }
    let step = far.len() as f64 / CANDIDATES.min(far.len()) as f64;
    let offset = random.uniform();
    far = (0..CANDIDATES.min(far.len())).map(|n| far[((n as f64 + offset) * step) as usize % far.len()]).collect();
    let rated = far.into_iter().filter_map(|(spot, way_m)| {
        let there = ground.eye(spot)?;
        let apart = |p: &DVec3| (there - *p).with_y((there.y - p.y) * STOREY).length();
        let new_m = been.iter().map(apart).fold(NEW_M, f64::min);
        let (view_m, look_deg) = view(ground, there);
        let to = there - eye;
        let is_hidden = ground.sight_m(eye, to.normalize_or_zero(), to.length() - 0.1).is_some();
        let worth = new_m + VIEW_WORTH * view_m / VIEW_M + if is_hidden { HIDDEN_WORTH } else { 0.0 };
        Some((worth - WAY_COST * way_m, spot, look_deg))
    });
    let (_, spot, look_deg) = rated.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
    let mut way = vec![ground.eye(spot)?];
    let mut at = spot;
    while let Some(before) = reached.get(&at).and_then(|(_, before)| *before) {
        way.push(ground.eye(before)?);
        at = before;
    }
    way.reverse();
    Some(Next { spot, way, look_deg })
}

/// The nearest spots that one gets to, with the length of the way and the spot before.
fn reach(ground: &Ground<'_>, from: Spot, most: usize) -> BTreeMap<Spot, (f64, Option<Spot>)> {
    // Micrometres, as whole numbers have an order.
    let whole = |m: f64| (m * 1e6) as u64;
    let mut reached = BTreeMap::new();
    let mut open = BinaryHeap::from([Reverse((0u64, from, None::<Spot>))]);
    while let Some(Reverse((way, spot, before))) = open.pop() {
        if reached.contains_key(&spot) {
            continue;
        }
        reached.insert(spot, (way as f64 * 1e-6, before));
        if reached.len() >= most {
            break;
        }
        for (next, length) in ground.neighbours(spot) {
            if !reached.contains_key(&next) {
                open.push(Reverse((way + whole(length), next, Some(spot))));
            }
        }
    }
    reached
}

/// How far one sees: the mean of the [`LOOKED`] farthest directions, metres; and the farthest one,
/// as a yaw in degrees. Where there is only sky nothing is seen.
fn view(ground: &Ground<'_>, eye: DVec3) -> (f64, f64) {
    let toward = |yaw_deg: f64| {
        let (sin, cos) = yaw_deg.to_radians().sin_cos();
        let at = |slope: f64| ground.sight_m(eye, DVec3::new(-sin, slope, -cos).normalize(), FAR_M);
        let counted = |slope: f64| at(slope).map_or(0.0, |m| m.min(VIEW_M));
        SLOPES.map(counted).iter().sum::<f64>() / SLOPES.len() as f64
    };
    let yaws = (0..DIRECTIONS).map(|n| 360.0 * f64::from(n) / f64::from(DIRECTIONS));
    let mut far: Vec<(f64, f64)> = yaws.map(|yaw_deg| (toward(yaw_deg), yaw_deg)).collect();
    far.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.total_cmp(&b.1)));
    (far.iter().take(LOOKED).map(|f| f.0).sum::<f64>() / LOOKED as f64, far[0].1)
}

/// The same way with straight pieces instead of the lattice's steps.
fn straightened(ground: &Ground<'_>, way: &[DVec3]) -> Vec<DVec3> {
    let mut out = vec![way[0]];
    let mut at = 0;
    while at + 1 < way.len() {
        let farthest = (at + LONGEST_SHORTCUT).min(way.len() - 1);
        // A step of the lattice is free by itself.
        let next = (at + 2..=farthest).rev().find(|n| ground.is_straight(way[at], way[*n])).unwrap_or(at + 1);
        out.push(way[next]);
        at = next;
    }
    out
}
