//! Ways to search for the best near box of a group, compared with the best there is.
//!
//! In: a [`Fit`]. A state says how far each face stands off, in steps of the smallest distance;
//! the moves are those of [`fit`](super::near_box::fit), and the budget allows a state or does
//! not. The box that plans use is found by descent; the others tell what is left to gain.
//!
//! Whatever is within a box that the budget allows, it allows too: the allowed states are
//! connected, and [`Search::Exhaustive`] visits them all.

use super::near_box::{Fit, MOVES, STEP};
use std::collections::{BTreeMap, BTreeSet};

/// A way to search.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Search {
    /// The move that saves the most, until none saves anything.
    Descent,
    /// The move that begins the sequence of so many moves that saves the most (Aliaga and Lastra
    /// 1999, section 3.3.2).
    LookAhead(u32),
    /// Descent from so many best states at once.
    Beam(u32),
    /// So many random moves, worse ones ever more rarely (Kirkpatrick, Gelatt and Vecchi 1983).
    Annealing(u32),
    /// Every state.
    Exhaustive,
}

/// What a search found.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Found {
    /// Cost of the best state, in samples to expect.
    pub cost: f64,
    /// States that it asked for, each counted once.
    pub states: usize,
    /// Whether it ended by itself, and not because it had asked for too many.
    pub complete: bool,
}

/// Steps of each face.
type State = [u8; 6];

struct Boxes<'a> {
    cost_of: &'a dyn Fn(&[f64; 6]) -> Option<f64>,
    step: f64,
    /// Steps beyond which nothing is left to see.
    farthest: State,
    known: BTreeMap<State, Option<f64>>,
    most: usize,
}

/// Searches for the best box of a group with steps of `step` times [`STEP`]'s factor; gives up
/// after asking for `most` states. None: the smallest box exceeds the budget.
pub(super) fn search(fit: &Fit, by: Search, steps: u32, most: usize) -> Option<Found> {
    let step = STEP.powi(steps as i32);
    let farthest = fit.farthest_steps().map(|times| times.max(1.0).log(step).ceil().min(100.0) as u8);
    run(&|s| fit.try_steps(s), by, step, farthest, most)
}

fn run(
    cost_of: &dyn Fn(&[f64; 6]) -> Option<f64>,
    by: Search,
    step: f64,
    farthest: State,
    most: usize,
) -> Option<Found> {
    let mut boxes = Boxes { cost_of, step, farthest, known: BTreeMap::new(), most };
    let first = ([0; 6], boxes.cost(&[0; 6])?);
    let best = match by {
        Search::Descent => boxes.look_ahead(first, 1),
        Search::LookAhead(moves) => boxes.look_ahead(first, moves),
        Search::Beam(width) => boxes.beam(first, width as usize),
        Search::Annealing(moves) => boxes.anneal(first, moves),
        Search::Exhaustive => boxes.exhaust(first),
    };
    Some(Found { cost: best, states: boxes.known.len(), complete: boxes.known.len() < most })
}

impl Boxes<'_> {
    /// None: not allowed, or enough was asked.
    fn cost(&mut self, state: &State) -> Option<f64> {
        if let Some(known) = self.known.get(state) {
            return *known;
        }
        if self.known.len() >= self.most {
            return None;
        }
        let cost = (self.cost_of)(&state.map(|s| self.step.powi(i32::from(s))));
        self.known.insert(*state, cost);
        cost
    }

    /// States that one move leads to.
    fn next(&self, state: &State) -> Vec<State> {
        let moved = |faces: &u8| std::array::from_fn(|f| (state[f] + (faces >> f & 1)).min(self.farthest[f]));
        MOVES.iter().map(moved).filter(|to| to != state).collect()
    }

    /// The best cost within so many moves of a state, and the first of these moves.
    fn best_within(&mut self, state: &State, moves: u32) -> Option<(f64, State)> {
        let mut best: Option<(f64, State)> = None;
        for to in self.next(state) {
            let Some(here) = self.cost(&to) else { continue };
            let further = if moves > 1 { self.best_within(&to, moves - 1) } else { None };
            let cost = further.map_or(here, |f| f.0.min(here));
            if best.is_none_or(|b| cost < b.0) {
                best = Some((cost, to));
            }
        }
        best
    }

    fn look_ahead(&mut self, (mut state, mut cost): (State, f64), moves: u32) -> f64 {
        while let Some((reached, to)) = self.best_within(&state, moves) {
            if reached >= cost {
                break;
            }
            // With look-ahead a move may cost something that a later one saves.
            (state, cost) = (to, self.cost(&to).unwrap_or(cost));
        }
        self.best_known(cost)
    }

    fn beam(&mut self, first: (State, f64), width: usize) -> f64 {
        let (mut front, mut best) = (vec![first], first.1);
        // Costs may stay the same for some moves before they fall.
        let mut idle = 0;
        while !front.is_empty() && idle < 4 {
            let nexts: BTreeSet<State> = front.iter().flat_map(|(s, _)| self.next(s)).collect();
            front = nexts.into_iter().filter_map(|s| Some((s, self.cost(&s)?))).collect();
            front.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            front.truncate(width);
            let reached = front.first().map_or(f64::INFINITY, |f| f.1);
            idle = if reached < best { 0 } else { idle + 1 };
            best = best.min(reached);
        }
        best
    }

    fn anneal(&mut self, (mut state, mut cost): (State, f64), moves: u32) -> f64 {
        let (mut best, first) = (cost, cost);
        let mut random = 0x9e37_79b9_7f4a_7c15u64;
        let mut unit = move || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 11) as f64 / (1u64 << 53) as f64
        };
        for k in 0..moves {
            // From a tenth of the first cost down to a ten-thousandth, geometrically.
            let temperature = first * 0.1 * 1e-3f64.powf(f64::from(k) / f64::from(moves));
            let faces = MOVES[((unit() * MOVES.len() as f64) as usize).min(MOVES.len() - 1)];
            let out = unit() < 0.6;
            let to: State = std::array::from_fn(|f| match (faces >> f & 1, out) {
                (0, _) => state[f],
                (_, true) => (state[f] + 1).min(self.farthest[f]),
                (_, false) => state[f].saturating_sub(1),
            });
            let Some(there) = self.cost(&to) else { continue };
            if there <= cost || unit() < ((cost - there) / temperature).exp() {
                (state, cost) = (to, there);
                best = best.min(cost);
            }
        }
        best
    }

    fn exhaust(&mut self, first: (State, f64)) -> f64 {
        let (mut open, mut best) = (vec![first.0], first.1);
        while let Some(state) = open.pop() {
            for face in 0..6 {
                let mut to = state;
                to[face] += 1;
                if to[face] > self.farthest[face] || self.known.contains_key(&to) {
                    continue;
                }
                if let Some(cost) = self.cost(&to) {
                    best = best.min(cost);
                    open.push(to);
                }
            }
        }
        best
    }

    fn best_known(&self, cost: f64) -> f64 {
        self.known.values().flatten().copied().fold(cost, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Allowed while the product of all distances is below a bound, as triangles in a box are;
    /// cheaper the larger, with a bump on the way.
    fn cost(steps: &[f64; 6]) -> Option<f64> {
        let volume: f64 = steps.iter().product();
        let far = |w: [f64; 6]| steps.iter().zip(w).map(|(s, w)| w / s).sum::<f64>();
        // Only once the first two have gone out twice does it pay.
        let bump = if steps[0] > 2.2 && steps[1] > 2.2 { 0.0 } else { 2.0 + 0.5 * (steps[0] + steps[1]) };
        (volume <= 30.0).then(|| far([4.0, 4.0, 3.0, 2.0, 1.0, 1.0]) + bump)
    }

    #[test]
    fn every_way_keeps_the_budget_and_trying_all_is_the_best_there_is() {
        let step: f64 = 1.5625;
        let mut best = f64::INFINITY;
        let mut allowed = 0;
        for code in 0..9usize.pow(6) {
            let state: [f64; 6] = std::array::from_fn(|f| step.powi((code / 9usize.pow(f as u32) % 9) as i32));
            if let Some(c) = cost(&state) {
                best = best.min(c);
                allowed += 1;
            }
        }
        let by = |by| run(&|s| cost(s), by, step, [8; 6], 100_000).expect("the smallest is allowed");
        let all = by(Search::Exhaustive);
        assert_eq!(all.cost, best);
        // And the states just beyond the budget.
        assert!(all.complete && all.states > allowed && allowed > 500, "{all:?}, {allowed}");
        let (descent, wide) = (by(Search::Descent), by(Search::Beam(64)));
        assert!(descent.cost > best * 1.05, "the bump stops it: {descent:?}, {best}");
        assert!(wide.cost < descent.cost && wide.states > descent.states);
        for found in [descent, wide, by(Search::LookAhead(3)), by(Search::Annealing(2000))] {
            assert!(found.cost >= best && found.states < all.states, "{found:?}");
        }
        assert!(by(Search::LookAhead(3)).cost < descent.cost);
        assert_eq!(run(&|_| None, Search::Descent, step, [8; 6], 10), None);
        let given_up = run(&|s| cost(s), Search::Exhaustive, step, [8; 6], 50).expect("the smallest is allowed");
        assert!(!given_up.complete && given_up.states == 50);
    }
}
