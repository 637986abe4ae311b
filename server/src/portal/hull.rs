//! Convex hulls of points in a plane.

use glam::DVec2;

/// Share of the rectangle around a hull that it must fill to be taken for it.
const RECTANGLE_SHARE: f64 = 0.93;
/// Most corners: a hull with more becomes its rectangle.
const MOST_CORNERS: usize = 24;
/// Corners nearer than this to the line through their neighbours are left out, metres; the hull
/// grows by nothing and shrinks by this.
const STRAIGHT_M: f64 = 1.0e-4;

/// The convex hull, counter-clockwise (Andrew 1979).
pub(super) fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return Vec::new();
    }
    let half = |points: &mut dyn Iterator<Item = &DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for p in points {
            while let [.., a, b] = chain[..] {
                let ab = b - a;
                if ab.perp_dot(*p - a) > STRAIGHT_M * (*p - a).length() {
                    break;
                }
                chain.pop();
            }
            chain.push(*p);
        }
        chain.pop();
        chain
    };
    let mut out = half(&mut points.iter());
    out.extend(half(&mut points.iter().rev()));
    if out.len() < 3 { Vec::new() } else { out }
}

/// Area of a polygon, counter-clockwise positive.
pub(super) fn area(polygon: &[DVec2]) -> f64 {
    let n = polygon.len();
    (0..n).map(|i| (polygon[i] - polygon[0]).perp_dot(polygon[(i + 1) % n] - polygon[0])).sum::<f64>() * 0.5
}

/// The rectangle along the axes where a hull nearly fills it or has too many corners, else the
/// hull.
pub(super) fn rectangle_if_nearly(hull: Vec<DVec2>) -> Vec<DVec2> {
    let (Some(min), Some(max)) = (hull.iter().copied().reduce(DVec2::min), hull.iter().copied().reduce(DVec2::max))
    else {
        return hull;
    };
    let size = max - min;
    if size.min_element() < 1e-3 {
        return Vec::new();
    }
    if area(&hull) >= RECTANGLE_SHARE * size.x * size.y || hull.len() > MOST_CORNERS {
        vec![min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y)]
    } else {
        hull
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hull_holds_all_points_and_turns_left() {
        let points: Vec<DVec2> = (0..200)
            .map(|i| {
                let a = f64::from(i) * 2.399_963;
                DVec2::from_angle(a) * (f64::from(i * 37 % 200) / 200.0).sqrt()
            })
            .collect();
        let h = hull(points.clone());
        let n = h.len();
        assert!(n > 5);
        for i in 0..n {
            let edge = h[(i + 1) % n] - h[i];
            assert!(points.iter().all(|p| edge.perp_dot(*p - h[i]) > -1e-3));
            assert!(edge.perp_dot(h[(i + 2) % n] - h[i]) > 0.0);
        }
        assert!(area(&h) > 2.5);
    }

    #[test]
    fn a_rectangle_with_a_clipped_corner_becomes_whole_and_a_triangle_stays() {
        let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.9), (0.9, 2.0), (0.0, 2.0)].map(DVec2::from).to_vec();
        assert_eq!(rectangle_if_nearly(hull(corners)).len(), 4);
        assert_eq!(rectangle_if_nearly(hull([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(DVec2::from).to_vec())).len(), 3);
        assert!(hull(vec![DVec2::ZERO, DVec2::X, DVec2::X * 2.0]).is_empty());
    }
}
