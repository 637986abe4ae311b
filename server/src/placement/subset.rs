//! Which contiguous subset of the visible cells should an image replace? (Aliaga and Lastra 1999,
//! section 3.3.2; rows A7, A8.)
//!
//! In: the cells that may be replaced, with their borders as seen along the image's axis, and how
//! many triangles must go. Out: a 6-tuple of thresholds, one into each of six sorted border lists:
//! left, right, bottom, top (tangents), near, far (depth). All cells whose borders lie within the
//! six thresholds are members. Starting from everything, one of five borders is moved halfway in
//! (near, top, bottom, right, left; far never moves), the move being chosen by looking a few moves
//! ahead for the largest
//!
//! ```text
//!   CB = C (1 - g / G) + B (B1 (1 - max(Iw, Ih) / max(Sw, Sh)) + B2 d / A)
//! ```
//!
//! with g triangles still drawn of G visible, Iw x Ih the subset's extent on a screen of Sw x Sh,
//! d its nearest depth, A the longest axis of the model. Where the paper stops when no half move
//! keeps enough, we go on with quarter moves, eighths, down to single entries: that brings the
//! result near the optimization budget.

/// Constants of the cost-benefit function.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CostBenefit {
    /// Weight C of the triangles that go.
    pub cost: f64,
    /// Weight B of a small, distant image.
    pub benefit: f64,
    /// Share B1 of smallness in the benefit.
    pub small: f64,
    /// Share B2 of distance in the benefit.
    pub far: f64,
}

impl Default for CostBenefit {
    /// The paper's constants: distance before size, slightly before the number of triangles.
    fn default() -> Self {
        Self { cost: 0.4, benefit: 0.6, small: 0.1, far: 0.9 }
    }
}

/// A cell as seen along the image's axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Item {
    /// The cell.
    pub cell: u32,
    /// Its triangles.
    pub triangles: u64,
    /// Left, right, bottom, top as tangents; left < right, bottom < top.
    pub tangents: [f64; 4],
    /// Nearest depth along the axis, metres; positive.
    pub near: f64,
}

/// What the search needs to know besides the items.
#[derive(Debug, Clone, Copy)]
pub(super) struct Goal {
    /// Triangles visible in the range, replaceable or not.
    pub visible: u64,
    /// Triangles that the subset must hold at least.
    pub must_go: u64,
    /// Screen width and height, the larger of the two, as a tangent extent.
    pub screen: f64,
    /// Longest axis of the model, metres.
    pub longest_axis_m: f64,
    /// Constants.
    pub constants: CostBenefit,
    /// Moves to look ahead.
    pub look_ahead: u32,
}

/// The borders that move, in the order that ties prefer.
const MOVES: [usize; 5] = [4, 3, 2, 1, 0];

/// Thresholds: positions in the sorted lists of left, right, bottom, top and near borders. All
/// start at 0 and grow inward.
type Tuple = [u32; 5];

/// What a tuple selects.
#[derive(Debug, Clone, Copy)]
struct Value {
    triangles: u64,
    score: f64,
}

/// Items with the ranks of their borders in the five lists.
struct Search<'a> {
    items: &'a [Item],
    ranks: Vec<Tuple>,
    lengths: Tuple,
    goal: &'a Goal,
}

/// The members of the best subset found, as positions in `items`; None when all items together do
/// not suffice.
pub(super) fn best_subset(items: &[Item], goal: &Goal) -> Option<Vec<usize>> {
    let search = Search::new(items, goal);
    let mut tuple = [0; 5];
    if items.is_empty() || search.value(&tuple).triangles < goal.must_go {
        return None;
    }
    // Steps of 1/2, then 1/4 ... of what is left of a list.
    for shift in 1..=16 {
        while let Some((next, _)) = search.best_move(&tuple, shift, goal.look_ahead) {
            tuple = next;
        }
        if (0..5).all(|b| search.lengths[b] >> shift == 0) {
            break;
        }
    }
    Some((0..items.len()).filter(|i| search.member(*i, &tuple)).collect())
}

impl<'a> Search<'a> {
    fn new(items: &'a [Item], goal: &'a Goal) -> Self {
        let mut ranks = vec![[0; 5]; items.len()];
        let mut lengths = [0; 5];
        for border in 0..5 {
            // Keys grow inward: left, bottom and near borders as they are, right and top ones
            // negated.
            let key = |i: &Item| match border {
                4 => i.near,
                1 | 3 => -i.tangents[border],
                _ => i.tangents[border],
            };
            let mut sorted: Vec<f64> = items.iter().map(key).collect();
            sorted.sort_unstable_by(f64::total_cmp);
            // Cells that share a border are one entry.
            sorted.dedup();
            for (rank, item) in ranks.iter_mut().zip(items) {
                rank[border] = sorted.partition_point(|v| *v < key(item)) as u32;
            }
            lengths[border] = sorted.len() as u32;
        }
        Self { items, ranks, lengths, goal }
    }

    #[inline]
    fn member(&self, item: usize, tuple: &Tuple) -> bool {
        let r = &self.ranks[item];
        (r[0] >= tuple[0]) & (r[1] >= tuple[1]) & (r[2] >= tuple[2]) & (r[3] >= tuple[3]) & (r[4] >= tuple[4])
    }

    /// Triangles and cost-benefit of a tuple.
    fn value(&self, tuple: &Tuple) -> Value {
        let mut triangles = 0;
        let mut window = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let mut near = f64::INFINITY;
        for (i, item) in self.items.iter().enumerate() {
            if self.member(i, tuple) {
                triangles += item.triangles;
                let [l, r, b, t] = item.tangents;
                window = [window[0].min(l), window[1].max(r), window[2].min(b), window[3].max(t)];
                near = near.min(item.near);
            }
        }
        let Goal { visible, screen, longest_axis_m, constants: c, .. } = self.goal;
        let left = visible.saturating_sub(triangles) as f64 / (*visible).max(1) as f64;
        let extent = (window[1] - window[0]).max(window[3] - window[2]).clamp(0.0, *screen) / screen;
        let distance = (near / longest_axis_m).min(1.0);
        let score = c.cost * (1.0 - left) + c.benefit * (c.small * (1.0 - extent) + c.far * distance);
        Value { triangles, score }
    }

    /// The move that leads to the best cost-benefit within `ahead` further moves, and that value.
    fn best_move(&self, tuple: &Tuple, shift: u32, ahead: u32) -> Option<(Tuple, f64)> {
        let mut best: Option<(Tuple, f64)> = None;
        for border in MOVES {
            let left = self.lengths[border] - 1 - tuple[border];
            let step = left >> shift;
            if step == 0 && !(left > 0 && self.lengths[border] >> shift == 0) {
                continue;
            }
            let mut next = *tuple;
            next[border] += step.max(1);
            let value = self.value(&next);
            if value.triangles < self.goal.must_go {
                continue;
            }
            let further = if ahead > 0 { self.best_move(&next, shift, ahead - 1).map(|m| m.1) } else { None };
            let score = further.map_or(value.score, |f| f.max(value.score));
            if best.is_none_or(|b| score > b.1) {
                best = Some((next, score));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn goal(visible: u64, must_go: u64) -> Goal {
        Goal { visible, must_go, screen: 1.15, longest_axis_m: 50.0, constants: CostBenefit::default(), look_ahead: 1 }
    }

    prop_compose! {
        fn items()(raw in prop::collection::vec((0u64..500, -1.0f64..1.0, -1.0f64..1.0, 0.0f64..0.3, 1.0f64..50.0), 1..60)) -> Vec<Item> {
            raw.into_iter().enumerate().map(|(i, (triangles, x, y, s, near))| {
                Item { cell: i as u32, triangles, tangents: [x, x + s, y, y + s], near }
            }).collect()
        }
    }

    proptest! {
        #[test]
        fn the_subset_holds_enough_and_is_exactly_what_its_borders_enclose(items in items(), share in 0.0f64..1.0) {
            let visible: u64 = items.iter().map(|i| i.triangles).sum();
            let must_go = (visible as f64 * share) as u64;
            let picked = best_subset(&items, &goal(visible, must_go)).unwrap();
            let sum: u64 = picked.iter().map(|i| items[*i].triangles).sum();
            prop_assert!(sum >= must_go);
            // Contiguous: no outsider lies within the box of the members.
            let m: Vec<&Item> = picked.iter().map(|i| &items[*i]).collect();
            if m.is_empty() { return Ok(()); }
            let low = |b: usize| m.iter().map(|i| i.tangents[b]).fold(f64::INFINITY, f64::min);
            let high = |b: usize| m.iter().map(|i| i.tangents[b]).fold(f64::NEG_INFINITY, f64::max);
            let near = m.iter().map(|i| i.near).fold(f64::INFINITY, f64::min);
            let (l, r, b, t) = (low(0), high(1), low(2), high(3));
            for (k, i) in items.iter().enumerate() {
                let within = i.tangents[0] >= l && i.tangents[1] <= r && i.tangents[2] >= b && i.tangents[3] <= t && i.near >= near;
                prop_assert_eq!(within, picked.contains(&k));
            }
        }
    }

    #[test]
    fn too_little_geometry_is_refused() {
        let item = Item { cell: 0, triangles: 10, tangents: [0.0, 0.1, 0.0, 0.1], near: 5.0 };
        assert!(best_subset(&[item], &goal(100, 11)).is_none());
        assert_eq!(best_subset(&[item], &goal(100, 10)), Some(vec![0]));
    }

    #[test]
    fn of_equal_groups_the_farther_one_goes() {
        let at = |cell, near| Item { cell, triangles: 100, tangents: [-0.1, 0.1, -0.1, 0.1], near };
        let items = [at(0, 5.0), at(1, 30.0), at(2, 31.0), at(3, 6.0)];
        assert_eq!(best_subset(&items, &goal(400, 200)), Some(vec![1, 2]));
    }
}
