//! A BSP tree whose planes lie in gaps between objects (Shade et al. 1996, section 4).
//!
//! In: boxes with their triangle counts. Out: a binary tree over them that cuts few objects, halves
//! the triangles, and has nodes of compact shape.
//!
//! Objects are projected to each of several directions; an interval with fewer objects than on both
//! sides of it is a gap. The chosen gap cuts the fewest objects, halves the triangles best, and
//! lies across the longest extent. An object that is cut nevertheless goes as a whole to the side
//! of its middle: it is a cell of the dataset.

use glam::DVec3;
use ldi_protocol::Aabb;

/// Directions of planes: around the vertical axis, as in the paper for landscapes, and the vertical
/// one for buildings.
const DIRECTIONS: [DVec3; 5] = [
    DVec3::X,
    DVec3::Z,
    DVec3::Y,
    DVec3::new(std::f64::consts::FRAC_1_SQRT_2, 0.0, std::f64::consts::FRAC_1_SQRT_2),
    DVec3::new(std::f64::consts::FRAC_1_SQRT_2, 0.0, -std::f64::consts::FRAC_1_SQRT_2),
];
/// Cost of a gap that cuts objects, above the sum of all other terms.
const CUTS: f64 = 10.0;
/// Cost of cutting all objects, relative to the other terms.
const CUTS_ALL: f64 = 4.0;

/// An object to be partitioned.
#[derive(Debug, Clone, Copy)]
pub struct Object {
    /// Bounds, metres.
    pub bounds: Aabb,
    /// Number of triangles.
    pub triangles: u64,
}

/// A node of the tree.
#[derive(Debug, Clone)]
pub struct Node {
    /// Bounds of its objects, metres.
    pub bounds: Aabb,
    /// Number of triangles of its objects.
    pub triangles: u64,
    /// Objects or children.
    pub content: Content,
}

/// Content of a node.
#[derive(Debug, Clone)]
pub enum Content {
    /// Numbers of objects.
    Leaf(Vec<u32>),
    /// Numbers of nodes, larger than its own.
    Inner([u32; 2]),
}

/// The tree. Node 0 is the root; there are no nodes without objects.
#[derive(Debug, Clone, Default)]
pub struct Bsp {
    /// Parents before children.
    pub nodes: Vec<Node>,
    /// Number of objects cut by planes.
    pub cuts: usize,
}

/// A place to cut: objects whose middles lie before it along the direction are one half.
#[derive(Debug, Clone, Copy)]
struct Gap {
    direction: DVec3,
    at: f64,
    cut: usize,
    score: f64,
}

impl Bsp {
    /// Partitions objects until a leaf holds one, or at most `leaf_triangles`.
    pub fn new(objects: &[Object], leaf_triangles: u64) -> Self {
        let mut tree = Self::default();
        if !objects.is_empty() {
            tree.nodes.push(node_of(objects, (0..objects.len() as u32).collect()));
        }
        let mut next = 0;
        while let Some(node) = tree.nodes.get(next) {
            if let Content::Leaf(held) = &node.content
                && held.len() > 1
                && node.triangles > leaf_triangles
            {
                let (halves, cut) = halves(objects, held);
                let first = tree.nodes.len() as u32;
                tree.nodes[next].content = Content::Inner([first, first + 1]);
                tree.nodes.extend(halves.map(|half| node_of(objects, half)));
                tree.cuts += cut;
            }
            next += 1;
        }
        tree
    }

    /// Objects of a node and all below it.
    pub fn objects_of(&self, node: u32, visit: &mut impl FnMut(u32)) {
        // Not recursive: the index may make the tree as deep as it has cells.
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            match &self.nodes[node as usize].content {
                Content::Leaf(held) => held.iter().for_each(|o| visit(*o)),
                Content::Inner(children) => open.extend(children),
            }
        }
    }
}

fn node_of(objects: &[Object], held: Vec<u32>) -> Node {
    let of = || held.iter().map(|o| &objects[*o as usize]);
    let bounds = of().fold(Aabb::EMPTY, |b, o| b.union(o.bounds));
    Node { bounds, triangles: of().map(|o| o.triangles).sum(), content: Content::Leaf(held) }
}

/// Both halves, none of them empty, and the number of objects that the plane cuts.
fn halves(objects: &[Object], held: &[u32]) -> ([Vec<u32>; 2], usize) {
    let longest = DIRECTIONS.iter().map(|n| extent_of(objects, held, *n)).fold(0.0, f64::max);
    let gaps = DIRECTIONS.iter().filter_map(|n| best_gap(objects, held, *n, longest));
    let best = gaps.min_by(|a, b| a.score.total_cmp(&b.score));
    if let Some(gap) = best {
        let before = |o: &u32| gap.direction.dot(objects[*o as usize].bounds.centre()) < gap.at;
        return (<[_; 2]>::from(held.iter().copied().partition::<Vec<u32>, _>(before)), gap.cut);
    }
    // All objects overlap: they are split by the order of their middles.
    let mut sorted = held.to_vec();
    let size = objects[held[0] as usize].bounds.size();
    sorted.sort_by(|a, b| {
        let along = |o: &u32| objects[*o as usize].bounds.centre().dot(size);
        along(a).total_cmp(&along(b)).then(a.cmp(b))
    });
    let rest = sorted.split_off(sorted.len() / 2);
    let cut = sorted.len();
    ([sorted, rest], cut)
}

fn extent(object: &Object, direction: DVec3) -> [f64; 2] {
    [-object.bounds.support(-direction), object.bounds.support(direction)]
}

fn extent_of(objects: &[Object], held: &[u32], direction: DVec3) -> f64 {
    let grown = |[low, high]: [f64; 2], o: &u32| {
        let [from, to] = extent(&objects[*o as usize], direction);
        [low.min(from), high.max(to)]
    };
    let [low, high] = held.iter().fold([f64::INFINITY, f64::NEG_INFINITY], grown);
    high - low
}

/// The best gap across a direction with objects on both sides.
fn best_gap(objects: &[Object], held: &[u32], direction: DVec3, longest: f64) -> Option<Gap> {
    let extents: Vec<[f64; 2]> = held.iter().map(|o| extent(&objects[*o as usize], direction)).collect();
    let sorted = |end: usize| {
        let mut places: Vec<f64> = extents.iter().map(|e| e[end]).collect();
        places.sort_unstable_by(f64::total_cmp);
        places
    };
    let (lows, highs) = (sorted(0), sorted(1));
    let mut middles: Vec<(f64, u64)> =
        held.iter().map(|o| &objects[*o as usize]).map(|o| (direction.dot(o.bounds.centre()), o.triangles)).collect();
    middles.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let all: u64 = middles.iter().map(|m| m.1).sum();
    let short = 1.0 - (highs[highs.len() - 1] - lows[0]) / longest.max(f64::MIN_POSITIVE);
    let (mut before, mut triangles) = (0, 0);
    let mut best: Option<Gap> = None;
    let mut begun = 0;
    for (ended, high) in (1..).zip(&highs) {
        // An object that begins where another ends does not overlap it.
        while lows.get(begun).is_some_and(|low| low < high) {
            begun += 1;
        }
        let Some(low) = lows.get(begun) else { break };
        if highs.get(ended).is_some_and(|next| next <= low && next > high) {
            // Another object ends before the next one begins: the following interval has fewer.
            continue;
        }
        let at = 0.5 * (high + low);
        while middles.get(before).is_some_and(|m| m.0 < at) {
            triangles += middles[before].1;
            before += 1;
        }
        if before == 0 || before == middles.len() {
            continue;
        }
        let cut = begun - ended;
        let uneven = (2.0 * triangles as f64 - all as f64).abs() / (all as f64).max(1.0);
        let cuts = if cut > 0 { CUTS + CUTS_ALL * cut as f64 / held.len() as f64 } else { 0.0 };
        let score = cuts + uneven + short;
        if best.is_none_or(|b| score < b.score) {
            best = Some(Gap { direction, at, cut, score });
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn object(min: [f64; 3], size: [f64; 3], triangles: u64) -> Object {
        let (min, size) = (DVec3::from(min), DVec3::from(size));
        Object { bounds: Aabb { min, max: min + size }, triangles }
    }

    fn leaves(tree: &Bsp) -> Vec<Vec<u32>> {
        let leaf = |n: &Node| if let Content::Leaf(held) = &n.content { Some(held.clone()) } else { None };
        tree.nodes.iter().filter_map(leaf).collect()
    }

    /// A row of trees on level ground that is cut into squares: no plane cuts a tree, halves are
    /// even.
    #[test]
    fn an_even_row_is_halved_again_and_again_and_nothing_is_cut() {
        let objects: Vec<Object> =
            (0..64).map(|i| object([3.0 * f64::from(i), 0.0, 0.0], [2.0, 5.0, 2.0], 100)).collect();
        let tree = Bsp::new(&objects, 100);
        assert_eq!((leaves(&tree).len(), tree.nodes.len(), tree.cuts), (64, 127, 0));
        let Content::Inner(children) = tree.nodes[0].content else { panic!("the root is no leaf") };
        assert_eq!(children.map(|c| tree.nodes[c as usize].triangles), [3200, 3200]);
        assert!(Bsp::new(&objects, 6400).nodes.len() == 1 && Bsp::new(&[], 1).nodes.is_empty());
    }

    /// Across the short side the halves would be even, across the long one they are nearly: long
    /// nodes are halved first.
    #[test]
    fn a_long_node_is_cut_across() {
        let mut objects = Vec::new();
        for i in 0..10 {
            for k in 0..2 {
                objects.push(object([4.0 * f64::from(i), 0.0, 4.0 * f64::from(k)], [3.0, 3.0, 3.0], 10));
            }
        }
        let tree = Bsp::new(&objects, 100);
        let Content::Inner(children) = tree.nodes[0].content else { panic!("the root is no leaf") };
        let boxes = children.map(|c| tree.nodes[c as usize].bounds);
        assert!(boxes[0].max.x < boxes[1].min.x || boxes[1].max.x < boxes[0].min.x, "{boxes:?}");
    }

    fn apart(objects: &[Object], a: &[u32], b: &[u32], n: DVec3) -> bool {
        let range = |held: &[u32]| {
            let all = held.iter().map(|o| extent(&objects[*o as usize], n));
            all.fold([f64::INFINITY, f64::NEG_INFINITY], |r, e| [r[0].min(e[0]), r[1].max(e[1])])
        };
        let (a, b) = (range(a), range(b));
        a[1] <= b[0] || b[1] <= a[0]
    }

    proptest! {
        /// All objects are in one leaf each, boxes hold what is below them, and where any plane of
        /// a direction cuts nothing, the one that was taken cuts nothing.
        #[test]
        fn nothing_is_lost_and_nothing_cut_where_a_gap_is(
            places in prop::collection::vec((prop::array::uniform3(0u32..40), prop::array::uniform3(1u32..9), 1u64..50), 1..40)
        ) {
            let objects: Vec<Object> =
                places.iter().map(|(min, size, n)| object(min.map(f64::from), size.map(f64::from), *n)).collect();
            let tree = Bsp::new(&objects, 1);
            let mut held: Vec<u32> = leaves(&tree).concat();
            held.sort_unstable();
            prop_assert_eq!(held, (0..objects.len() as u32).collect::<Vec<_>>());
            let of = |node: u32| {
                let mut all = Vec::new();
                tree.objects_of(node, &mut |o| all.push(o));
                all
            };
            for (number, node) in tree.nodes.iter().enumerate() {
                let own = of(number as u32);
                prop_assert!(own.iter().all(|o| node.bounds.union(objects[*o as usize].bounds) == node.bounds));
                prop_assert_eq!(own.iter().map(|o| objects[*o as usize].triangles).sum::<u64>(), node.triangles);
                let Content::Inner([a, b]) = node.content else { continue };
                let (a, b) = (of(a), of(b));
                prop_assert!(!a.is_empty() && !b.is_empty() && a.len() + b.len() == own.len());
                // Brute force: every end of an object as a plane.
                let is_gap = |n: DVec3| own.iter().any(|o| {
                    let at = extent(&objects[*o as usize], n)[1];
                    let side = |o: &u32| extent(&objects[*o as usize], n);
                    own.iter().all(|o| side(o)[1] <= at || side(o)[0] >= at) && own.iter().any(|o| side(o)[0] >= at)
                });
                if DIRECTIONS.iter().any(|n| is_gap(*n)) {
                    prop_assert!(DIRECTIONS.iter().any(|n| apart(&objects, &a, &b, *n)), "node {}", number);
                }
            }
        }
    }
}
