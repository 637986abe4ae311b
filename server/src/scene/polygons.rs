//! Polygons of OBJ and PLY files as triangles.
//!
//! In: the positions of a polygon's corners, in order. Out: triangles of corner numbers, wound as
//! the polygon is. A polygon that a fan from its first corner covers exactly (every convex one)
//! becomes that fan. Any other one is projected along its Newell normal and cut by ear clipping
//! (the crate `earcut`): concave polygons, outlines joined to their holes by a seam, corners that
//! are listed again.

use earcut::Earcut;
use glam::{DVec2, DVec3};

/// Corners beyond which a polygon stays a fan: ear clipping takes quadratic time on polygons made
/// for it, and no modelling program writes polygons this long.
const MOST_CORNERS: usize = 16_384;
/// Part of a polygon's area by which a triangle of its fan may be wound backward: rounding.
const BACKWARD: f64 = 1.0e-6;
/// Part of the squared extent below which a polygon's area counts as none: rounding of f32 input.
const NO_AREA: f64 = 1.0e-12;

/// Cuts polygons; keeps its buffers between them.
#[derive(Default)]
pub(super) struct Polygons {
    earcut: Earcut<f64>,
    /// Numbers of the corners that differ from the one before.
    kept: Vec<u32>,
    flat: Vec<[f64; 2]>,
    ears: Vec<u32>,
    triangles: Vec<[u32; 3]>,
}

impl Polygons {
    /// Triangles of corner numbers; none where the polygon has no area. Corners that are not
    /// finite leave the fan as it is, for the caller to drop its triangles.
    pub(super) fn cut(&mut self, corners: &[DVec3]) -> &[[u32; 3]] {
        self.triangles.clear();
        let n = corners.len() as u32;
        if n == 3 {
            self.triangles.push([0, 1, 2]);
        } else if n > 3 {
            self.cut_many(corners);
        }
        &self.triangles
    }

    fn cut_many(&mut self, corners: &[DVec3]) {
        let n = corners.len();
        self.kept.clear();
        let differs = |i: usize| corners[i] != corners[(i + n - 1) % n];
        self.kept.extend((0..n).filter(|&i| differs(i)).map(|i| i as u32));
        let kept = &self.kept;
        if kept.len() < 3 {
            return;
        }
        let fan = |triangles: &mut Vec<[u32; 3]>| {
            triangles.extend((2..kept.len()).map(|k| [kept[0], kept[k - 1], kept[k]]));
        };
        let first = corners[kept[0] as usize];
        let at = |i: u32| corners[i as usize] - first;
        let area_of = |k: usize| at(kept[k - 1]).cross(at(kept[k]));
        let normal: DVec3 = (2..kept.len()).map(area_of).sum();
        if !normal.is_finite() || kept.len() > MOST_CORNERS {
            fan(&mut self.triangles);
            return;
        }
        let extent = kept.iter().map(|&i| at(i).length_squared()).fold(0.0, f64::max);
        let Some(up) = normal.try_normalize().filter(|_| normal.length() > NO_AREA * extent) else { return };
        let least = -BACKWARD * normal.length();
        if (2..kept.len()).all(|k| area_of(k).dot(up) >= least) {
            fan(&mut self.triangles);
            return;
        }
        let across = up.any_orthonormal_vector();
        let along = up.cross(across);
        let plane = |i: u32| DVec2::new(at(i).dot(across), at(i).dot(along));
        self.flat.clear();
        self.flat.extend(kept.iter().map(|&i| plane(i).to_array()));
        self.earcut.earcut_slice(&self.flat, &[], &mut self.ears);
        let turn = |[a, b, c]: [u32; 3]| {
            let p = |k: u32| DVec2::from(self.flat[k as usize]);
            (p(b) - p(a)).perp_dot(p(c) - p(a))
        };
        for &[a, b, c] in self.ears.as_chunks::<3>().0 {
            let [b, c] = if turn([a, b, c]) < 0.0 { [c, b] } else { [b, c] };
            self.triangles.push([a, b, c].map(|k| kept[k as usize]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The polygon lifted into a slanted plane far from the origin.
    fn lifted(flat: &[[f64; 2]]) -> Vec<DVec3> {
        let up = DVec3::new(0.3, -0.5, 0.8).normalize();
        let across = up.any_orthonormal_vector();
        let lift = |[x, y]: [f64; 2]| DVec3::new(9e5, 20.0, -4e6) + across * x + up.cross(across) * y;
        flat.iter().copied().map(lift).collect()
    }

    /// Areas of the triangles, signed by the polygon's own direction.
    fn areas(corners: &[DVec3], triangles: &[[u32; 3]]) -> Vec<f64> {
        let up = DVec3::new(0.3, -0.5, 0.8).normalize();
        let at = |v: u32| corners[v as usize];
        triangles.iter().map(|&[a, b, c]| (at(b) - at(a)).cross(at(c) - at(a)).dot(up) / 2.0).collect()
    }

    fn covers(flat: &[[f64; 2]], area: f64) {
        for turned in 0..flat.len() {
            let mut flat = flat.to_vec();
            flat.rotate_left(turned);
            let corners = lifted(&flat);
            let mut polygons = Polygons::default();
            let areas = areas(&corners, polygons.cut(&corners));
            assert!(areas.iter().all(|a| *a > -1e-6), "from corner {turned}: {areas:?}");
            assert!((areas.iter().sum::<f64>() - area).abs() < 1e-6, "from corner {turned}: {areas:?}");
        }
    }

    const L: [[f64; 2]; 6] = [[-1., -1.], [1., -1.], [1., 1.], [0.6, 1.], [0.6, -0.6], [-1., -0.6]];

    #[test]
    fn concave_polygons_are_covered_once_from_every_corner() {
        covers(&L, 2.0 * 0.4 + 1.6 * 0.4);
        let star: Vec<[f64; 2]> = (0..16)
            .map(|k| {
                let (a, r) = (f64::from(k) * std::f64::consts::TAU / 16.0, if k % 2 == 0 { 1.0 } else { 0.3 });
                [r * a.cos(), r * a.sin()]
            })
            .collect();
        covers(&star, 16.0 * 0.5 * 0.3 * (std::f64::consts::TAU / 16.0).sin());
    }

    #[test]
    fn a_hole_joined_by_a_seam_stays_open() {
        let [outer, inner] = [1.0, 0.5].map(|s| [[-s, -s], [s, -s], [s, s], [-s, s]]);
        let frame =
            [outer[0], outer[1], outer[2], outer[3], outer[0], inner[0], inner[3], inner[2], inner[1], inner[0]];
        covers(&frame, 4.0 - 1.0);
    }

    #[test]
    fn corners_listed_again_change_nothing() {
        let mut closed = L.to_vec();
        closed.insert(3, L[2]);
        closed.push(L[0]);
        covers(&closed, 2.0 * 0.4 + 1.6 * 0.4);
    }

    #[test]
    fn convex_polygons_stay_fans_and_flat_ones_vanish() {
        let square = lifted(&[[0., 0.], [1., 0.], [1., 1.], [0., 1.]]);
        assert_eq!(Polygons::default().cut(&square), [[0, 1, 2], [0, 2, 3]]);
        let line = lifted(&[[0., 0.], [1., 0.], [2., 0.], [1., 0.]]);
        assert!(Polygons::default().cut(&line).is_empty());
        let point = [DVec3::ONE; 5];
        assert!(Polygons::default().cut(&point).is_empty());
        assert!(Polygons::default().cut(&square[..2]).is_empty());
    }

    #[test]
    fn corners_without_a_place_keep_the_fan() {
        let mut square = lifted(&[[0., 0.], [1., 0.], [1., 1.], [0., 1.]]);
        square[2] = DVec3::NAN;
        assert_eq!(Polygons::default().cut(&square).len(), 2);
    }
}
