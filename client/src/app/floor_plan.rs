//! The floor plan of a storey: the walk volume from above, and a horizontal section of resident
//! near geometry.
//!
//! In: a scene, an eye height. Out: a picture, north (-Z) up. Drawn on its own thread.

use super::{server_connection::Scene, walker};
use crate::resident::{Resident, each_cluster};
use egui::{Color32, ColorImage};
use glam::{DVec2, DVec3, Vec3Swizzles as _};
use ldi_protocol::{index::Index, volume::WalkVolume};

/// Longest side, texels. Larger volumes have coarser texels.
const LONGEST_SIDE: f64 = 1400.0;
/// Size of the finest texel, metres: thin walls stay visible.
const FINEST_M: f64 = 0.03;
/// Largest difference in eye height within a storey, metres: less than half of a low storey.
pub const STOREY_M: f64 = 1.2;
/// Height of the section below the eye, metres: it meets walls, doors, windows and table tops, and
/// passes above seats.
const CUT_BELOW_EYE_M: f64 = 0.55;
/// Largest number of segments drawn.
const MOST_SEGMENTS: usize = 2_000_000;

const FLOOR: Color32 = Color32::from_rgb(214, 222, 230);
const OTHER_FLOOR: Color32 = Color32::from_rgb(92, 104, 116);
const NOTHING: Color32 = Color32::from_rgb(38, 42, 48);
const WALL: Color32 = Color32::from_rgb(40, 52, 66);

/// Draws the plan of a storey. The picture spans the volume's bounds.
pub fn draw(scene: &Scene, volume: &WalkVolume, storey_m: f64) -> ColorImage {
    let mut picture = floors(volume, storey_m);
    let b = volume.bounds();
    let scale = DVec2::new(picture.size[0] as f64, picture.size[1] as f64) / (b.size().xz().max(DVec2::splat(0.1)));
    for [from, to] in section(&scene.index, &*scene.cache, storey_m - CUT_BELOW_EYE_M) {
        line(&mut picture, (from - b.min.xz()) * scale, (to - b.min.xz()) * scale);
    }
    picture
}

/// Draws the volume: bright on the storey, dim elsewhere.
fn floors(volume: &WalkVolume, storey_m: f64) -> ColorImage {
    let b = volume.bounds();
    let size = b.size().max(DVec3::splat(0.1));
    let texel_m = FINEST_M.max(size.x.max(size.z) / LONGEST_SIDE);
    let count = |s: f64| (s / texel_m).ceil().max(1.0) as usize;
    let (width, height) = (count(size.x), count(size.z));
    let texel = |i: usize| {
        let x = b.min.x + ((i % width) as f64 + 0.5) / width as f64 * size.x;
        let z = b.min.z + ((i / width) as f64 + 0.5) / height as f64 * size.z;
        let off = |h: [f64; 2]| {
            // For flying, any height within the volume belongs to it.
            if (h[0]..=h[1]).contains(&storey_m) { 0.0 } else { (walker::nominal(h) - storey_m).abs() }
        };
        let nearest = volume.heights(x, z).map(off).min_by(f64::total_cmp);
        match nearest {
            Some(off) if off <= STOREY_M => FLOOR,
            Some(_) => OTHER_FLOOR,
            None => NOTHING,
        }
    };
    ColorImage::new([width, height], (0..width * height).map(texel).collect())
}

/// Section of resident geometry by the plane at height `y`: segments in x and z.
fn section(index: &Index, resident: &dyn Resident, y: f64) -> Vec<[DVec2; 2]> {
    let mut out = Vec::new();
    let crossing = |c: &ldi_protocol::index::CellEntry| c.bounds.min.y <= y && y <= c.bounds.max.y;
    for (number, _) in (0u32..).zip(&index.cells).filter(|(_, c)| crossing(c)) {
        each_cluster(index, resident, number, |cluster, world_from_mesh| {
            let world = |p: &glam::Vec3| world_from_mesh.transform_point3(cluster.origin + p.as_dvec3());
            let corners: Vec<DVec3> = cluster.positions.iter().map(world).collect();
            for t in &cluster.triangles {
                let [Some(a), Some(b), Some(c)] = t.map(|i| corners.get(usize::from(i)).copied()) else { continue };
                if out.len() < MOST_SEGMENTS
                    && let Some(segment) = cut([a, b, c], y)
                {
                    out.push(segment);
                }
            }
        });
        if out.len() >= MOST_SEGMENTS {
            return out;
        }
    }
    out
}

/// Intersection of a triangle with the plane at height `y`.
fn cut(t: [DVec3; 3], y: f64) -> Option<[DVec2; 2]> {
    let mut ends = [(0, 1), (1, 2), (2, 0)].into_iter().filter_map(|(i, j)| {
        let (a, b) = (t[i], t[j]);
        // A corner on the plane counts as above it, so that every section has two ends.
        ((a.y < y) != (b.y < y)).then(|| a.lerp(b, (y - a.y) / (b.y - a.y)).xz())
    });
    Some([ends.next()?, ends.next()?])
}

/// Darkens the texels along a line, clipped to the picture.
fn line(picture: &mut ColorImage, from: DVec2, to: DVec2) {
    let [width, height] = picture.size;
    let room = DVec2::new(width as f64, height as f64);
    if from.max(to).cmplt(DVec2::ZERO).any() || from.min(to).cmpgt(room).any() || !(from + to).is_finite() {
        return;
    }
    let steps = ((to - from).abs().max_element().ceil().max(1.0) as usize).min(4 * (width + height));
    for i in 0..=steps {
        let p = from.lerp(to, i as f64 / steps as f64);
        if p.cmpge(DVec2::ZERO).all() && p.cmplt(room).all() {
            picture.pixels[p.y as usize * width + p.x as usize] = WALL;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        app::collision::tests::{plate, wall},
        test_support::{dataset, plain_material, quad_cluster},
    };
    use ldi_protocol::{Aabb, OutputCamera};

    /// Two storeys of 4 x 4 m with eyes at 1.6 and 4.6 m, the upper one above the left half only.
    fn house() -> WalkVolume {
        let runs: Vec<Vec<[u16; 2]>> =
            (0..64).map(|c| if c % 8 < 4 { vec![[11, 20], [41, 50]] } else { vec![[11, 20]] }).collect();
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(4.0, 0.0, 4.0) };
        WalkVolume::new(DVec3::ZERO, 0.5, 0.1, [8, 8], &runs, &cut).unwrap()
    }

    #[test]
    fn the_other_storey_is_dim() {
        let v = house();
        let (low, high) = (floors(&v, 1.6), floors(&v, 4.6));
        let right = low.size[0] - 1;
        assert_eq!((low.pixels[0], low.pixels[right]), (FLOOR, FLOOR));
        assert_eq!((high.pixels[0], high.pixels[right]), (FLOOR, OTHER_FLOOR));
    }

    #[test]
    fn walls_are_cut_and_floors_are_not() {
        let quads = [
            plate([0.0, 0.0], [4.0, 4.0], 0.0),
            wall([1.0, 0.5], [3.0, 2.5], 0.0, 2.5),
            wall([0.0, 3.0], [4.0, 3.0], 0.0, 0.4),
        ];
        let camera = OutputCamera { width: 64, height: 36, fov_deg: 60.0 };
        let clusters = quads.iter().map(|q| quad_cluster(0, *q)).collect();
        let (index, memory) = dataset(camera, vec![plain_material()], clusters);
        let segments = section(&index, &memory, 1.05);
        let length: f64 = segments.iter().map(|[a, b]| a.distance(*b)).sum();
        assert!((length - 8f64.sqrt()).abs() < 1e-9, "{segments:?}");
        let mut picture = floors(&house(), 1.6);
        let scale = picture.size[0] as f64 / 4.0;
        segments.iter().for_each(|[a, b]| line(&mut picture, *a * scale, *b * scale));
        let at = |x: f64, z: f64| picture.pixels[(z * scale) as usize * picture.size[0] + (x * scale) as usize];
        assert_eq!([at(2.0, 1.5), at(2.0, 2.5), at(2.0, 3.0)], [WALL, FLOOR, FLOOR]);
        // Lines beyond the picture are clipped.
        line(&mut picture, DVec2::new(-1e9, 5.0), DVec2::new(1e9, 5.0));
    }
}
