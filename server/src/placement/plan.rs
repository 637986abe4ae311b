//! From a solution at a grid point to an image that can be made: centre of projection, density,
//! window.

use super::{
    bands::YAW_BIN_DEG,
    eye_tree::EyeTree,
    faces::{Region, face_basis},
    hull::EyeHull,
    model::{DirectionRange, ImagePlan, PlacementPlan},
    near_box::{Member, NearBox},
    point::{Context, Image, centre, depths, tangents},
};
use glam::DVec3;
use ldi_protocol::{Aabb, ViewBasis};

/// Directions are sampled at this step to find how far users' frusta reach, degrees; the margin
/// below covers what lies between.
const STEP_DEG: f64 = 2.5;
/// Margin of the window, as a share of its tangents and absolute: a direction between two samples
/// reaches at most (STEP / 2 = 0.022 rad) farther, times 1 + tangent squared.
const WINDOW_MARGIN: f64 = 0.025;

/// The plan for an image of the point with number `grid_point`.
pub(super) fn plan(ctx: &Context, image: &Image, grid_point: u32, grid_position: DVec3) -> PlacementPlan {
    let (middle, ahead) = depths(&image.users, &image.basis, grid_position);
    let plane_from_cop = image.plane_m - middle;
    // `assign` accepted users only while a scale kept the limit.
    let (scale, footprint_px) = ctx.footprint.scale(image.phi, plane_from_cop, ahead).unwrap_or((1.0, f64::INFINITY));
    let cop = centre(&image.users, &image.basis);
    let users = image.users.bounds();
    let units: Vec<u16> = image.units.iter().map(|u| u.0).collect();
    PlacementPlan {
        grid_point: Some(grid_point),
        cop,
        culled: image.culled.iter().copied().collect(),
        users,
        eyes: eyes_of(ctx, &[users], cop),
        lookouts: Vec::new(),
        gaze: ctx.gaze_in(&units),
        through: vec![],
        footprint_px,
        images: vec![ImagePlan {
            basis: image.basis,
            cop,
            plane_distance: plane_from_cop,
            beside: [f64::INFINITY; 4],
            pixels_per_unit: ctx.footprint.pixels_per_unit(scale),
            window: window(ctx, image, cop, plane_from_cop),
            users,
            directions: directions(ctx, &image.units),
            footprint_px,
        }],
    }
}

/// Faces reach over their borders by this many pixels, so that surfaces join across them.
const FACE_OVERLAP_PIXELS: f64 = 2.0;

/// Most places that images are made from. More: fewer holes, longer building
/// (docs/adr/0009-images-hold-what-eyes-see.md).
const MOST_EYES: usize = 256;

/// The plan for a near box that `members` use.
pub(super) fn plan_box(ctx: &Context, near: &NearBox, members: &[&Member], grid_point: u32) -> PlacementPlan {
    let users = members.iter().fold(Aabb::EMPTY, |b, m| b.union(m.eyes));
    let mut units: Vec<u16> = members.iter().flat_map(|m| m.units.iter().copied()).collect();
    units.sort_unstable();
    units.dedup();
    let gaze = ctx.gaze_in(&units);
    let units: Vec<(u16, [f64; 2])> = units.into_iter().map(|u| (u, ctx.directions.unit(usize::from(u)).0)).collect();
    let boxes: Vec<Aabb> = members.iter().map(|m| m.eyes).collect();
    let mut images = Vec::new();
    for (face, image) in near.images.iter().enumerate() {
        let Some(image) = image else { continue };
        let basis = face_basis(face);
        let facing: Vec<(u16, [f64; 2])> = units
            .iter()
            .filter(|(u, _)| {
                let (yaw, pitch) = ctx.directions.unit(usize::from(*u));
                let mid = |r: [f64; 2]| (r[0] + r[1]) * 0.5;
                ViewBasis::from_yaw_pitch(mid(yaw), mid(pitch)).forward.dot(basis.forward) > 0.0
            })
            .copied()
            .collect();
        let pixels_per_unit = ctx.footprint.pixels_per_unit(image.scale);
        let overlap = FACE_OVERLAP_PIXELS / pixels_per_unit;
        let [left, right, bottom, top] = image.window;
        images.push(ImagePlan {
            basis,
            cop: near.cop,
            plane_distance: near.distance[face],
            beside: Region::new(face, &near.distance).beside,
            pixels_per_unit,
            window: [left - overlap, right + overlap, bottom - overlap, top + overlap],
            users,
            directions: directions(ctx, &facing),
            footprint_px: image.footprint_px,
        });
    }
    PlacementPlan {
        grid_point: Some(grid_point),
        cop: near.cop,
        culled: near.culled.iter().collect(),
        users,
        eyes: eyes_of(ctx, &boxes, near.cop),
        lookouts: Vec::new(),
        gaze,
        through: vec![],
        footprint_px: images.iter().map(|i| i.footprint_px).fold(0.0, f64::max),
        images,
    }
}

/// The places from which an image for eyes in some boxes is made.
fn eyes_of(ctx: &Context, boxes: &[Aabb], cop: DVec3) -> Vec<DVec3> {
    spread(&ctx.eyes.map_or(vec![], |tree| standing(tree, boxes)), cop, MOST_EYES)
}

/// The outermost places where eyes within some boxes may stand: the corners of what each box of
/// the walk volume shares with one of them. From there eyes see farthest around things.
fn standing(tree: &EyeTree, eyes: &[Aabb]) -> Vec<DVec3> {
    let mut out = Vec::new();
    for leaf in tree.leaves_touching(|b| eyes.iter().any(|e| e.intersects(b))) {
        for e in eyes.iter().filter(|e| e.intersects(&leaf)) {
            out.extend(Aabb { min: leaf.min.max(e.min), max: leaf.max.min(e.max) }.corners());
        }
    }
    out.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)).then(a.z.total_cmp(&b.z)));
    out.dedup();
    out
}

/// Up to `most` of `places`, each as far as can be from `centre` and from those before it: what
/// they see differs most.
pub(crate) fn spread(places: &[DVec3], centre: DVec3, most: usize) -> Vec<DVec3> {
    let mut apart: Vec<f64> = places.iter().map(|p| p.distance_squared(centre)).collect();
    let mut out = Vec::new();
    while out.len() < most.min(places.len()) {
        // Of equals the first.
        let farthest = (1..places.len()).fold(0, |best, i| if apart[i] > apart[best] { i } else { best });
        let eye = places[farthest];
        out.push(eye);
        apart.iter_mut().zip(places).for_each(|(a, p)| *a = a.min(p.distance_squared(eye)));
    }
    out
}

/// The units of an image as direction ranges; neighbouring yaw bins of a band are joined.
fn directions(ctx: &Context, units: &[(u16, [f64; 2])]) -> Vec<DirectionRange> {
    let mut out: Vec<DirectionRange> = Vec::new();
    for (unit, yaw) in units {
        let (_, pitch_deg) = ctx.directions.unit(*unit as usize);
        match out.last_mut() {
            Some(last) if last.pitch_deg == pitch_deg && yaw[0] - last.yaw_deg[1] < 0.5 * YAW_BIN_DEG => {
                last.yaw_deg[1] = yaw[1]
            }
            _ => out.push(DirectionRange { yaw_deg: *yaw, pitch_deg }),
        }
    }
    out
}

/// Tangent extents of the culled cells about `cop`, cut to what the users' frusta can reach beyond
/// the plane.
fn window(ctx: &Context, image: &Image, cop: DVec3, plane_m: f64) -> [f64; 4] {
    let mut out = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
    for cell in &image.culled {
        let t = tangents(&ctx.cells.bounds[*cell as usize], &image.basis, cop);
        out = [out[0].min(t[0]), out[1].max(t[1]), out[2].min(t[2]), out[3].max(t[3])];
    }
    let basis = &image.basis;
    for (at, side) in [(0, -basis.right), (1, basis.right), (2, -basis.up), (3, basis.up)] {
        let Some(slope) = steepest(ctx, basis, &image.units, side) else { continue };
        // A point seen at depth z has offset s <= e_s + slope (z - e_z), e the eye: s / z <=
        // slope + (e_s - slope e_z) / z.
        let apart = support_about(&image.users, side - basis.forward * slope, cop).max(0.0);
        let reach = slope + apart / plane_m;
        if at % 2 == 0 { out[at] = out[at].max(-reach) } else { out[at] = out[at].min(reach) }
    }
    // A user who sees nothing of the subset leaves an inverted window; keep a sliver.
    for k in [0, 2] {
        if out[k] > out[k + 1] {
            out[k + 1] = out[k];
        }
    }
    out
}

/// Support of the users relative to `cop`.
fn support_about(users: &EyeHull, n: DVec3, cop: DVec3) -> f64 {
    users.support(n) - cop.dot(n)
}

/// The largest ratio of a ray's component along `side` to that along the image's axis over all
/// rays of all users' pictures; None when some ray runs along the plane or away from it.
pub(super) fn steepest(ctx: &Context, basis: &ViewBasis, units: &[(u16, [f64; 2])], side: DVec3) -> Option<f64> {
    let mut steepest = f64::NEG_INFINITY;
    let (t, u) = ctx.picture_tan;
    for (unit, yaw) in units {
        let (_, pitch) = ctx.directions.unit(*unit as usize);
        let steps = |r: [f64; 2]| {
            let n = ((r[1] - r[0]) / STEP_DEG).ceil().max(1.0) as usize;
            (0..=n).map(move |i| r[0] + (r[1] - r[0]) * i as f64 / n as f64)
        };
        for y in steps(*yaw) {
            for p in steps(pitch) {
                let d = ViewBasis::from_yaw_pitch(y, p);
                for (a, b) in [(-t, -u), (t, -u), (-t, u), (t, u)] {
                    let ray = d.forward + d.right * a + d.up * b;
                    let along = ray.dot(basis.forward);
                    if along < 0.05 {
                        return None;
                    }
                    steepest = steepest.max(ray.dot(side) / along);
                }
            }
        }
    }
    Some(steepest + WINDOW_MARGIN * (1.0 + steepest * steepest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_protocol::volume::WalkVolume;

    #[test]
    fn eyes_stand_where_their_view_cell_is_and_apart() {
        let runs: Vec<Vec<[u16; 2]>> = (0..400).map(|_| vec![[0, 9]]).collect();
        let cut = Aabb { min: DVec3::ZERO, max: DVec3::new(10.0, 0.0, 10.0) };
        let volume = WalkVolume::new(DVec3::ZERO, 0.5, 0.1, [20, 20], &runs, &cut).unwrap();
        let tree = EyeTree::new(&volume);
        let eyes = Aabb { min: DVec3::new(2.1, 0.0, 2.1), max: DVec3::new(5.9, 0.9, 3.4) };
        let few = standing(&tree, &[eyes]);
        // Boxes of half a metre begin at 2.0 to 5.5 and 2.0 to 3.0.
        assert_eq!(few.len(), 9 * 4 * 2, "corners are shared");
        assert!(few.iter().all(|p| eyes.contains(*p) && volume.contains(*p)));
        assert!(eyes.corners().iter().all(|c| few.contains(c)));
        let halves = [0.0, 1.0].map(|at| Aabb { min: eyes.min.with_x(2.1 + at), max: eyes.max.with_x(4.1 + at) });
        assert_eq!(standing(&tree, &halves).len(), (6 + 6 - 2) * 4 * 2, "and once where boxes overlap");
        let places = standing(&tree, &[*volume.bounds()]);
        assert_eq!(places.len(), 21 * 21 * 2);
        let some = spread(&places, eyes.centre(), MOST_EYES);
        assert_eq!(some.len(), MOST_EYES);
        let apart = |all: &[DVec3]| {
            let pairs = all.iter().enumerate().flat_map(|(i, a)| all[..i].iter().map(|b| a.distance(*b)));
            pairs.fold(f64::INFINITY, f64::min)
        };
        // The corners come first; the first of these places in order lie half a metre apart, these
        // farther.
        assert!(apart(&some[..4]) > 4.0 && apart(&some[..64]) > 1.0, "{} {}", apart(&some[..4]), apart(&some[..64]));
        assert_eq!(spread(&places[..3], eyes.centre(), MOST_EYES).len(), 3);
        assert!(spread(&[], DVec3::ZERO, MOST_EYES).is_empty());
    }
}
