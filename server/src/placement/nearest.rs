//! View cells: every eye belongs to its closest grid point (DESIGN, "Two ways to cover the eyes",
//! the second).
//!
//! In: the walk volume as a tree of boxes, the grid points. Out: per point a convex region that
//! holds every eye whose closest point it is. Directions do not matter, every eye has a closest
//! point, and so the certificate needs three dimensions only: a point is ruled out for a box of
//! eyes when some other point is closer for all of them. That is exact to test: |E - b|^2 - |E -
//! a|^2 is linear in E, so its largest value over a box is at a corner.
//!
//! Compared with the paper's grid, users surround their point instead of filling a wedge up to 2 r
//! ahead of it, so images may stand nearer to the point or points farther apart; and no points are
//! needed inside walls, below floors and above ceilings.

use super::{
    eye_tree::{EyeTree, longest_axis},
    hull::EyeHull,
};
use glam::DVec3;
use ldi_protocol::Aabb;
use rayon::prelude::*;

/// Boxes are halved until one point is left or their half size falls below this share of the
/// distance to the closest point. Larger: regions overlap more than they need to.
const FINEST_BOX: f64 = 1.0 / 24.0;
/// Size of the blocks worked on in parallel, metres.
const BLOCK_M: f64 = 8.0;

/// Region and largest distance of the eyes of each point, and the number of boxes in the
/// certificate.
pub(super) fn nearest(tree: &EyeTree, points: &[DVec3]) -> (Vec<(EyeHull, f64)>, u64) {
    let parts: Vec<(Vec<(u32, Aabb)>, u64)> = tree
        .blocks(BLOCK_M)
        .par_iter()
        .map(|n| {
            let mut work = Work { tree, points, found: Vec::new(), boxes: 0 };
            let all: Vec<u32> = (0..points.len() as u32).collect();
            work.visit(tree.nodes[*n as usize].bounds, Some(*n), &all);
            (work.found, work.boxes)
        })
        .collect();
    let mut out = vec![(EyeHull::EMPTY, 0.0f64); points.len()];
    let mut boxes = 0;
    for (found, n) in parts {
        boxes += n;
        for (point, b) in found {
            let (hull, far) = &mut out[point as usize];
            hull.add(&b);
            *far = far.max(b.max_distance(points[point as usize]));
        }
    }
    (out, boxes)
}

struct Work<'a> {
    tree: &'a EyeTree,
    points: &'a [DVec3],
    found: Vec<(u32, Aabb)>,
    boxes: u64,
}

impl Work<'_> {
    fn visit(&mut self, eyes: Aabb, node: Option<u32>, candidates: &[u32]) {
        self.boxes += 1;
        let at = |i: u32| self.points[i as usize];
        let bound = candidates.iter().map(|i| eyes.max_distance(at(*i))).fold(f64::INFINITY, f64::min);
        let close: Vec<u32> = candidates.iter().copied().filter(|i| eyes.distance(at(*i)) <= bound + 1e-9).collect();
        let left: Vec<u32> =
            close.iter().copied().filter(|a| !close.iter().any(|b| closer_everywhere(&eyes, at(*b), at(*a)))).collect();
        let small = eyes.size().max_element() * 0.5 <= bound * FINEST_BOX;
        if left.len() == 1 || small {
            self.found.extend(left.iter().map(|i| (*i, eyes)));
            return;
        }
        if let Some(children) = node.and_then(|n| self.tree.nodes[n as usize].children) {
            for n in children {
                self.visit(self.tree.nodes[n as usize].bounds, Some(n), &left);
            }
            return;
        }
        let axis = longest_axis(eyes.size());
        let (mut low, mut high) = (eyes, eyes);
        low.max[axis] = eyes.centre()[axis];
        high.min[axis] = low.max[axis];
        self.visit(low, None, &left);
        self.visit(high, None, &left);
    }
}

/// Whether `b` is closer than `a` to every point of the box, by more than rounding.
fn closer_everywhere(eyes: &Aabb, b: DVec3, a: DVec3) -> bool {
    // |E - b|^2 - |E - a|^2 = 2 E . (a - b) + |b|^2 - |a|^2, about the box's middle for accuracy.
    let c = eyes.centre();
    let (b, a) = (b - c, a - c);
    let n = (a - b) * 2.0;
    let largest = n.abs().dot(eyes.size() * 0.5) + b.length_squared() - a.length_squared();
    largest < -1e-9 * (1.0 + a.length_squared())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::Random;
    use ldi_protocol::volume::WalkVolume;

    #[test]
    fn every_eye_lies_in_the_region_of_its_closest_point() {
        let mut random = Random::new(5);
        let points: Vec<DVec3> =
            (0..40).map(|_| DVec3::new(random.unit() * 10.0, random.unit() * 3.0, random.unit() * 10.0)).collect();
        let runs: Vec<Vec<[u16; 2]>> =
            (0..100u16).map(|c| if c % 7 == 0 { vec![] } else { vec![[8, 17 + c % 3]] }).collect();
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(10.0, 0.0, 10.0) };
        let volume = WalkVolume::new(DVec3::ZERO, 1.0, 0.1, [10, 10], &runs, &cut).unwrap();
        let (regions, _) = nearest(&EyeTree::new(&volume), &points);
        let sampler = volume.sampler();
        for _ in 0..20_000 {
            let eye = sampler.point(std::array::from_fn(|_| random.unit())).unwrap();
            let closest =
                (0..points.len()).min_by(|a, b| points[*a].distance(eye).total_cmp(&points[*b].distance(eye))).unwrap();
            let (hull, far) = &regions[closest];
            assert!(hull.contains(&Aabb { min: eye, max: eye }, 1e-9) && eye.distance(points[closest]) <= *far);
        }
    }

    #[test]
    fn a_point_that_is_never_closest_has_no_eyes() {
        let volume = WalkVolume::of_box(&Aabb { min: DVec3::ZERO, max: DVec3::ONE }).unwrap();
        let (regions, _) = nearest(&EyeTree::new(&volume), &[DVec3::splat(0.5), DVec3::splat(4.0)]);
        assert!(!regions[0].0.is_empty() && regions[1].0.is_empty());
        assert!(regions[0].0.contains(&Aabb { min: DVec3::ZERO, max: DVec3::ONE }, 1e-9));
    }
}
