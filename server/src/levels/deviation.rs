//! How far two meshes lie apart: an upper bound of the Hausdorff distance, within a tolerance.
//!
//! The distance of a point from a mesh changes no faster than the point moves, and its distance
//! from one triangle is convex. So over a triangle it is at most that of its centroid plus the
//! distance to the farthest corner, and at most the largest of its corners' from any one triangle.
//! A triangle whose better bound is not close to what was found already is cut along the edges of
//! the triangle that lies nearest, so that each part lies over one, or halved across its longest
//! edge.

use glam::DVec3;
use ldi_protocol::Aabb;

/// A triangle.
pub(crate) type Corners = [DVec3; 3];

/// A bound may exceed the largest distance that was found by this share. Smaller: more triangles
/// are halved.
const TOLERANCE: f64 = 0.1;
/// Cuts of one triangle, one within the other, before its bound is taken as it is; a half counts
/// as two cuts.
const MOST_CUTS: u32 = 26;
/// Parts of one triangle that are looked at before bounds are taken as they are: what keeps hard
/// cases from taking long.
const MOST_PARTS: u32 = 4096;
/// Cuts leave at least this share of a triangle's size on either side.
const LEAST_SIDE: f64 = 1e-3;
/// Triangles in a leaf of the tree.
const LEAF: usize = 4;

/// A bound on how far any point of `triangles` lies from what is in the tree; infinite if that is
/// empty. `floor`: what is below it need not be told apart.
pub(super) fn one_way(triangles: &[Corners], tree: &SurfaceTree, floor: f64) -> f64 {
    if triangles.is_empty() {
        return 0.0;
    }
    if tree.triangles.is_empty() {
        return f64::INFINITY;
    }
    // The largest distance of any place that was looked at, and the bound.
    let (mut found, mut bound) = (0.0f64, 0.0f64);
    let mut open: Vec<(Corners, u32)> = Vec::new();
    for t in triangles {
        open.push((*t, 0));
        let mut parts = 0;
        while let Some((t, cuts)) = open.pop() {
            parts += 1;
            let centroid = (t[0] + t[1] + t[2]) / 3.0;
            let (distance, nearest) = tree.nearest(centroid);
            found = found.max(distance);
            let radius = t.iter().map(|c| c.distance(centroid)).fold(0.0, f64::max);
            let allowed = |found: f64| (found * (1.0 + TOLERANCE)).max(floor);
            let mut here = distance + radius;
            let same = &tree.triangles[nearest as usize];
            if here > allowed(found) {
                found = t.iter().map(|c| tree.nearest(*c).0).fold(found, f64::max);
                here = here.min(t.iter().map(|c| c.distance(closest_point(*c, same))).fold(0.0, f64::max));
            }
            if here <= allowed(found) || cuts >= MOST_CUTS || parts >= MOST_PARTS {
                bound = bound.max(here);
                continue;
            }
            match cut(&t, same, LEAST_SIDE * radius) {
                Some(parts) => open.extend(parts.map(|part| (part, cuts + 1))),
                None => open.extend(halves(&t).map(|half| (half, cuts + 2))),
            }
        }
    }
    bound
}

/// Two halves, cut across the longest edge.
fn halves(t: &Corners) -> [Corners; 2] {
    let edge = |k: usize| t[k].distance_squared(t[(k + 1) % 3]);
    let k = (0..3).max_by(|a, b| edge(*a).total_cmp(&edge(*b))).unwrap_or(0);
    let (a, b, c) = (t[k], t[(k + 1) % 3], t[(k + 2) % 3]);
    let middle = (a + b) * 0.5;
    [[a, middle, c], [middle, b, c]]
}

/// A triangle cut along the edge of another, in the direction of that one's normal, that leaves
/// most of it on both sides; None if one side would be at most `least` wide.
fn cut(t: &Corners, along: &Corners, least: f64) -> Option<[Corners; 3]> {
    let normal = (along[1] - along[0]).cross(along[2] - along[0]);
    let mut best: Option<(f64, [f64; 3])> = None;
    for k in 0..3 {
        let outward = (along[(k + 1) % 3] - along[k]).cross(normal).normalize_or_zero();
        let sides = t.map(|c| (c - along[k]).dot(outward));
        let both = sides.into_iter().fold(f64::NEG_INFINITY, f64::max).min(-sides.into_iter().fold(0.0, f64::min));
        if both > least && best.is_none_or(|(b, _)| both > b) {
            best = Some((both, sides));
        }
    }
    let (_, sides) = best?;
    // The corner that is alone on its side.
    let out = sides.map(|s| s > 0.0);
    let k = (0..3).find(|k| out[*k] != out[(k + 1) % 3] && out[*k] != out[(k + 2) % 3])?;
    let (i, j) = ((k + 1) % 3, (k + 2) % 3);
    let at = |to: usize| t[k] + (t[to] - t[k]) * (sides[k] / (sides[k] - sides[to]));
    let (p, q) = (at(i), at(j));
    Some([[t[k], p, q], [p, t[i], t[j]], [p, t[j], q]])
}

/// The point of a triangle that is closest to `p` (Ericson, Real-Time Collision Detection, 5.1.5).
fn closest_point(p: DVec3, [a, b, c]: &Corners) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum > 0.0 { a + ab * (vb / sum) + ac * (vc / sum) } else { *a }
}

/// Triangles in a tree of boxes.
pub(crate) struct SurfaceTree {
    triangles: Vec<Corners>,
    /// Which of the triangles given each of them is.
    numbers: Vec<u32>,
    nodes: Vec<Node>,
}

struct Node {
    bounds: Aabb,
    /// A leaf's triangles, or the two nodes below.
    of: Children,
}

enum Children {
    Leaf(std::ops::Range<u32>),
    Nodes([u32; 2]),
}

impl SurfaceTree {
    pub fn new(triangles: &[Corners]) -> Self {
        let mut tree = Self { triangles: Vec::new(), numbers: Vec::new(), nodes: Vec::new() };
        let mut numbered: Vec<(Corners, u32)> = triangles.iter().copied().zip(0..).collect();
        if !triangles.is_empty() {
            tree.add(&mut numbered, 0);
        }
        (tree.triangles, tree.numbers) = numbered.into_iter().unzip();
        tree
    }

    /// Adds the node of the triangles from `start` on, and those below; its number.
    fn add(&mut self, of: &mut [(Corners, u32)], start: usize) -> u32 {
        let end = start + of.len();
        let bounds = Aabb::from_points(of.iter().flat_map(|t| t.0));
        let number = self.nodes.len() as u32;
        self.nodes.push(Node { bounds, of: Children::Leaf(start as u32..end as u32) });
        if end - start > LEAF {
            let middle = |(t, _): &(Corners, u32)| t[0] + t[1] + t[2];
            let spread = Aabb::from_points(of.iter().map(middle)).size();
            let axis = spread.max_position();
            let half = (end - start) / 2;
            of.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
            let (left, right) = of.split_at_mut(half);
            let below = [self.add(left, start), self.add(right, start + half)];
            self.nodes[number as usize].of = Children::Nodes(below);
        }
        number
    }

    /// Distance to the nearest triangle; infinite without any.
    pub fn distance(&self, p: DVec3) -> f64 {
        if self.triangles.is_empty() { f64::INFINITY } else { self.nearest(p).0 }
    }

    /// The nearest triangle, by its place among those given, and the weights of its corners at the
    /// point of it that is nearest; None without any, or if that triangle has no area.
    pub fn surface_at(&self, p: DVec3) -> Option<(u32, [f64; 3])> {
        if self.triangles.is_empty() {
            return None;
        }
        let (_, nearest) = self.nearest(p);
        let t = &self.triangles[nearest as usize];
        let [a, b, c] = *t;
        let at = closest_point(p, t);
        let normal = (b - a).cross(c - a);
        let share = |p: DVec3, q: DVec3| (p - at).cross(q - at).dot(normal) / normal.length_squared();
        let weights = [share(b, c), share(c, a), share(a, b)];
        weights.iter().all(|w| w.is_finite()).then(|| (self.numbers[nearest as usize], weights))
    }

    /// Distance to the nearest triangle, and its number; the tree is not empty.
    fn nearest(&self, p: DVec3) -> (f64, u32) {
        let (mut best, mut nearest) = (f64::INFINITY, 0);
        let mut open = [(0.0, 0u32); 64];
        let mut count = 1;
        open[0] = (self.nodes[0].bounds.distance(p), 0);
        while count > 0 {
            count -= 1;
            let (distance, node) = open[count];
            if distance >= best {
                continue;
            }
            match &self.nodes[node as usize].of {
                Children::Leaf(range) => {
                    for t in range.clone() {
                        let d = p.distance(closest_point(p, &self.triangles[t as usize]));
                        if d < best {
                            (best, nearest) = (d, t);
                        }
                    }
                }
                Children::Nodes(below) => {
                    let [a, b] = below.map(|n| (self.nodes[n as usize].bounds.distance(p), n));
                    let (near, far) = if a.0 <= b.0 { (a, b) } else { (b, a) };
                    for next in [far, near] {
                        if next.0 < best && count < open.len() {
                            open[count] = next;
                            count += 1;
                        }
                    }
                }
            }
        }
        (best, nearest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::Random;

    fn soup(random: &mut Random, count: usize, size: f64) -> Vec<Corners> {
        let mut point = || DVec3::new(random.unit(), random.unit(), random.unit());
        (0..count)
            .map(|_| {
                let at = point() * 4.0;
                [at, at + point() * size, at + point() * size]
            })
            .collect()
    }

    #[test]
    fn the_nearest_triangle_is_that_of_all() {
        let mut random = Random::new(3);
        let triangles = soup(&mut random, 300, 1.0);
        let tree = SurfaceTree::new(&triangles);
        for _ in 0..2000 {
            let p = DVec3::new(random.unit(), random.unit(), random.unit()) * 8.0 - 2.0;
            let best = triangles.iter().map(|t| p.distance(closest_point(p, t))).fold(f64::INFINITY, f64::min);
            assert_eq!(tree.nearest(p).0, best);
        }
    }

    /// Points of a triangle by their weights: none is nearer than the closest one.
    #[test]
    fn the_closest_point_is_closer_than_any_other() {
        let mut random = Random::new(5);
        for t in soup(&mut random, 400, 2.0) {
            let p = DVec3::new(random.unit(), random.unit(), random.unit()) * 6.0 - 1.0;
            let closest = p.distance(closest_point(p, &t));
            let mut best = f64::INFINITY;
            for i in 0..=40 {
                for k in 0..=40 - i {
                    let (u, v) = (f64::from(i) / 40.0, f64::from(k) / 40.0);
                    best = best.min(p.distance(t[0] * (1.0 - u - v) + t[1] * u + t[2] * v));
                }
            }
            assert!(closest <= best + 1e-12 && closest > best - 0.1, "{closest} {best}");
        }
    }

    /// No point of one mesh lies farther from the other than the bound, and the bound is not far
    /// from the farthest.
    #[test]
    fn the_bound_holds_and_is_close() {
        let mut random = Random::new(8);
        for round in 0..20 {
            let size = [0.1, 1.0, 3.0][round % 3];
            let (a, b) = (soup(&mut random, 40, size), soup(&mut random, 60, size));
            let tree = SurfaceTree::new(&b);
            let bound = one_way(&a, &tree, 0.0);
            let mut farthest = 0.0f64;
            for t in &a {
                for _ in 0..600 {
                    let (mut u, mut v) = (random.unit(), random.unit());
                    if u + v > 1.0 {
                        (u, v) = (1.0 - u, 1.0 - v);
                    }
                    farthest = farthest.max(tree.nearest(t[0] * (1.0 - u - v) + t[1] * u + t[2] * v).0);
                }
            }
            assert!(bound >= farthest, "{bound} {farthest}");
            assert!(bound <= farthest * 1.2, "{bound} {farthest}");
        }
        assert_eq!(one_way(&[], &SurfaceTree::new(&soup(&mut random, 2, 1.0)), 0.0), 0.0);
        assert_eq!(one_way(&soup(&mut random, 2, 1.0), &SurfaceTree::new(&[]), 0.0), f64::INFINITY);
    }

    /// A flat square and the same in other triangles: at no distance, however they are cut.
    #[test]
    fn other_triangles_of_the_same_surface_are_no_deviation() {
        let corner = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let two = [
            [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0)],
            [corner(0.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)],
        ];
        let middle = corner(0.3, 0.4);
        let fan = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, y)| corner(x, y));
        let four: Vec<Corners> = (0..4).map(|k| [fan[k], fan[(k + 1) % 4], middle]).collect();
        assert!(one_way(&two, &SurfaceTree::new(&four), 1e-3) <= 1e-3);
        assert!(one_way(&four, &SurfaceTree::new(&two), 1e-3) <= 1e-3);
    }
}
