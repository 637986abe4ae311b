//! Boxes and groups in halls of strewn cells.

use super::*;
use crate::placement::{
    CostBenefit,
    bands::Directions,
    cells::Cells,
    eye_tree::EyeTree,
    groups::group,
    model::{ImagePlan, PlacementPlan},
    plan::plan_box,
    search::{Search, search},
    test_scenes::{NOTHING_BETWEEN, Random, settings, strewn},
};
use ldi_protocol::{ViewBasis, camera::Frustum, index::BuildSettings, volume::WalkVolume};

fn hall() -> (Cells, Directions) {
    let (mut bounds, triangles) = strewn(1500, 33);
    // Floors and walls of a single triangle have no thickness.
    for (i, b) in bounds.iter_mut().enumerate().filter(|(i, _)| i % 4 == 0) {
        b.max[i / 4 % 3] = b.min[i / 4 % 3];
    }
    (Cells::new(bounds, triangles), Directions::new(60.0))
}

/// Nine cells of eyes, 2 m wide, on one floor.
fn members(ctx: &Context) -> Vec<Member> {
    let hull = |k: i32| {
        let at = DVec3::new(f64::from(k % 3 - 1), 0.0, f64::from(k / 3 - 1)) * 2.0;
        let mut hull = EyeHull::EMPTY;
        hull.add(&Aabb { min: at + DVec3::new(-1.0, 1.1, -1.0), max: at + DVec3::new(1.0, 2.0, 1.0) });
        hull
    };
    (0..9).map(|k| Member::new(ctx, hull(k), true)).collect()
}

fn within(r: [f64; 2], u: f64) -> f64 {
    r[0] + (r[1] - r[0]) * u
}

/// Both promises and coverage, by brute force over random eyes and directions.
#[test]
fn groups_keep_the_budget_and_show_all_that_they_replace() {
    let (cells, directions) = hall();
    let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
    let members = members(&ctx);
    let groups = group(&ctx, &members).map_err(|(m, e)| (m, e.needed)).expect("feasible");
    let mut of = vec![usize::MAX; members.len()];
    for (g, (list, _)) in groups.iter().enumerate() {
        for m in list {
            assert_eq!(std::mem::replace(&mut of[*m as usize], g), usize::MAX, "a member is in one group");
        }
    }
    let plans: Vec<PlacementPlan> = groups
        .iter()
        .map(|(list, near)| plan_box(&ctx, near, &list.iter().map(|m| &members[*m as usize]).collect::<Vec<_>>(), 0))
        .collect();
    for ((_, near), plan) in groups.iter().zip(&plans) {
        for cell in plan.culled.iter() {
            let b = &cells.bounds[cell as usize];
            let beyond = (0..6).any(|f| {
                let n = face_basis(f).forward;
                -b.support(-n) > near.cop.dot(n) + near.distance[f]
            });
            assert!(beyond, "a replaced cell reaches into the box");
        }
    }
    let mut random = Random::new(6);
    let (mut replaced, mut shown) = (0, 0);
    for _ in 0..4000 {
        let k = (random.bits() % 9) as usize;
        let (m, unit) = (&members[k], (random.bits() % directions.units() as u64) as usize);
        let (yaw, pitch) = directions.unit(unit);
        let d = ViewBasis::from_yaw_pitch(within(yaw, random.unit()), within(pitch, random.unit()));
        let eye = m.eyes.min + m.eyes.size() * DVec3::new(random.unit(), random.unit(), random.unit());
        let square = Frustum::new(eye, &d, ctx.half_tan, ctx.half_tan);
        let plan = m.units.binary_search(&(unit as u16)).ok().map(|_| &plans[of[k]]);
        let culled = plan.map(|p| &p.culled);
        let drawn: u64 = (0..1500u32)
            .filter(|c| !culled.is_some_and(|all| all.contains(*c)) && square.may_intersect(&cells.bounds[*c as usize]))
            .map(|c| u64::from(cells.triangles[c as usize]))
            .sum();
        assert!(drawn <= ctx.budget, "{drawn} triangles");
        let Some(plan) = plan else { continue };
        replaced += 1;
        let picture = Frustum::new(eye, &d, ctx.picture_tan.0, ctx.picture_tan.1);
        for c in plan.culled.iter().filter(|c| picture.may_intersect(&cells.bounds[*c as usize])) {
            let b = &cells.bounds[c as usize];
            let q = b.min + b.size() * DVec3::new(random.unit(), random.unit(), random.unit());
            if !picture.contains(q) {
                continue;
            }
            shown += 1;
            let held = plan.images.iter().any(|i| {
                let v = q - plan.cop;
                let z = v.dot(i.basis.forward);
                let (x, y) = (v.dot(i.basis.right) / z, v.dot(i.basis.up) / z);
                z >= i.plane_distance && x >= i.window[0] && x <= i.window[1] && y >= i.window[2] && y <= i.window[3]
            });
            assert!(held, "{q} is in the picture of {eye}, but in no image");
        }
    }
    assert!(replaced > 500 && shown > 5000, "{replaced} frames with images, {shown} points");
    assert!(groups.len() < 9, "some cells share a box: {} groups", groups.len());
}

#[test]
fn windows_of_many_cells_hold_those_of_each_and_are_hardly_larger() {
    // Runs of 16 neighbours in a yard, as the octree's order gives them.
    let mut random = Random::new(9);
    let mut bounds = Vec::new();
    for _ in 0..400 {
        let middle = DVec3::new(random.unit() - 0.5, 0.04 * random.unit(), random.unit() - 0.5) * 400.0;
        bounds.extend((0..16).map(|_| {
            let min = middle + DVec3::new(random.unit(), random.unit(), random.unit()) * 3.0;
            Aabb { min, max: min + DVec3::splat(0.2 + random.unit()) }
        }));
    }
    let (cells, directions) = (Cells::new(bounds, vec![1; 6400]), Directions::new(60.0));
    let ctx = Context::new(&cells, &directions, &settings(9_000), 400.0, CostBenefit::default(), NOTHING_BETWEEN);
    let members = members(&ctx);
    let member = [&members[4]];
    let mut fit = Fit::new(&ctx, &member, 0.0);
    (0..6400).for_each(|c| fit.seen.insert(c));
    let distance = [8.0, 9.0, 5.0, 5.0, 8.0, 12.0];
    let near = fit.near(&distance);
    let windows = |few: usize| Surroundings::new(&fit.beyond(&near, few), &distance).windows(&distance, FACE_GAP_M);
    let (exact, joined) = (windows(usize::MAX), windows(0));
    let mut found = 0;
    let far = (0..6400).filter(|c| !near.has(*c)).count();
    let mut mask = fit.seen.clone();
    mask.remove(&near);
    cells.compacted(&mask, fit.cop, COMPACT, |_, _| found += 1);
    assert!(found * 2 < far, "{found} boxes for {far} cells");
    for (e, j) in exact.iter().zip(&joined) {
        assert_eq!(*e == Window::EMPTY, *j == Window::EMPTY);
        if *e == Window::EMPTY {
            continue;
        }
        for k in 0..2 {
            let (low, high) = (2 * k, 2 * k + 1);
            assert!(j.tangents[low] <= e.tangents[low] && j.tangents[high] >= e.tangents[high]);
            let grown = (j.tangents[high] - j.tangents[low]) / (e.tangents[high] - e.tangents[low]);
            assert!(grown < 1.1, "{grown} times as wide");
        }
        let ratio = j.covered / e.covered;
        assert!((0.7..1.4).contains(&ratio), "{ratio} times as much covered");
    }
}

#[test]
fn prepared_surroundings_show_what_each_cell_alone_does() {
    let (cells, directions) = hall();
    let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
    let members = members(&ctx);
    let member = [&members[4]];
    let fit = Fit::new(&ctx, &member, 0.0);
    let smallest = fit.smallest();
    let surroundings = Surroundings::new(&fit.beyond(&fit.near(&smallest), usize::MAX), &smallest);
    let mut random = Random::new(3);
    let mut shown = 0;
    for _ in 0..200 {
        let distance = smallest.map(|d| d * (1.0 + 3.0 * random.unit()));
        let of_each = fit.images(&distance, &fit.near(&distance));
        let prepared = fit.images_of(&distance, &surroundings.windows(&distance, FACE_GAP_M));
        for (a, b) in of_each.iter().zip(&prepared) {
            let parts = |i: &Option<FaceImage>| i.map(|i| (i.window, i.scale, i.footprint_px));
            assert_eq!(parts(a), parts(b));
            if let Some((a, b)) = a.zip(*b) {
                assert!((a.covered - b.covered).abs() <= 1e-9 * a.covered, "{} {}", a.covered, b.covered);
                shown += 1;
            }
        }
    }
    assert!(shown > 600, "{shown} images");
}

#[test]
fn the_centre_of_projection_is_where_an_eye_can_be() {
    let (cells, directions) = hall();
    let mut ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
    // Two storeys, 1 to 2 m and 4 to 5 m: the middle of their eyes is in the slab.
    let runs: Vec<Vec<[u16; 2]>> = (0..64).map(|_| vec![[10, 20], [40, 50]]).collect();
    let cut = Aabb { min: DVec3::new(-2.0, 0.0, -2.0), max: DVec3::new(2.0, 0.0, 2.0) };
    let volume = WalkVolume::new(DVec3::new(-2.0, 0.0, -2.0), 0.5, 0.1, [8, 8], &runs, &cut).expect("a volume");
    let tree = EyeTree::new(&volume);
    let mut hull = EyeHull::EMPTY;
    volume.boxes().for_each(|b| hull.add(&b));
    let member = Member::new(&ctx, hull, true);
    let fitted = |ctx: &Context| fit(ctx, &[&member]).map_err(|e| e.needed).expect("feasible");
    let slab = fitted(&ctx).cop;
    assert!(slab.y > 2.5 && slab.y < 3.5 && !volume.contains(slab));
    ctx.eyes = Some(&tree);
    assert!(volume.contains(fitted(&ctx).cop), "{}", fitted(&ctx).cop);
}

#[test]
fn boxes_grow_to_the_optimization_budget() {
    let (cells, directions) = hall();
    let largest = |optimize_budget: u64| {
        let settings = BuildSettings { optimize_budget, ..settings(9_000) };
        let ctx = Context::new(&cells, &directions, &settings, 60.0, CostBenefit::default(), NOTHING_BETWEEN);
        let members = members(&ctx);
        let near = fit(&ctx, &[&members[4]]).map_err(|e| e.needed).expect("feasible");
        fill(&ctx, &[&members[4]], &near).max_triangles
    };
    let all = [6_000, 7_500, 9_000].map(|popt| (popt, largest(popt)));
    assert!(all.iter().all(|(popt, n)| n <= popt && *n > popt / 2), "{all:?}");
    assert!(all.windows(2).all(|w| w[0].1 < w[1].1), "{all:?}");
}

#[test]
fn a_filled_box_keeps_popt_and_costs_less() {
    let (cells, directions) = hall();
    let settings = BuildSettings { optimize_budget: 8_000, ..settings(9_000) };
    let ctx = Context::new(&cells, &directions, &settings, 60.0, CostBenefit::default(), NOTHING_BETWEEN);
    let mut saved = 0.0;
    for member in &members(&ctx) {
        let near = fit(&ctx, &[member]).map_err(|e| e.needed).expect("feasible");
        let filled = fill(&ctx, &[member], &near);
        assert!((0..6).all(|f| filled.distance[f] >= near.distance[f]) && filled.cost <= near.cost);
        assert!(filled.max_triangles >= near.max_triangles && filled.max_triangles <= 8_000);
        let alone = [member];
        let of = Fit::new(&ctx, &alone, 0.0);
        assert!(of.counts(&of.near(&filled.distance), 8_000).is_ok());
        saved += 1.0 - filled.cost / near.cost;
    }
    assert!(saved > 0.0);
}

/// No move from the box of a plan saves anything within the budget, though not every move was
/// looked at from every box; and all boxes together are no dearer than those of a descent that
/// looks at all.
#[test]
fn no_move_from_the_box_of_a_plan_saves_anything() {
    let (cells, directions) = hall();
    let ctx = Context::new(&cells, &directions, &settings(9_000), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
    let (mut cost, mut cost_of_descents, mut allowed) = (0.0, 0.0, 0);
    for member in &members(&ctx) {
        let near = fit(&ctx, &[member]).map_err(|e| e.needed).expect("feasible");
        let members = [member];
        let fit = Fit::new(&ctx, &members, 0.0);
        let smallest = fit.smallest();
        for moved in MOVES {
            let step = |f: usize| if moved >> f & 1 == 1 { STEP } else { 1.0 };
            let there = fit.try_steps(&std::array::from_fn(|f| near.distance[f] / smallest[f] * step(f)));
            assert!(there.is_none_or(|c| c >= near.cost), "{moved:b}: {there:?} {}", near.cost);
            allowed += usize::from(there.is_some());
        }
        let found = search(&fit, Search::Descent, 1, 100_000).expect("feasible");
        assert!(found.complete && found.states > 9);
        cost += near.cost;
        cost_of_descents += found.cost;
    }
    assert!(cost <= cost_of_descents * 1.01 && allowed > 0, "{cost} {cost_of_descents}, {allowed} moves are allowed");
}

#[test]
fn a_budget_that_nothing_meets_is_refused_with_the_need() {
    let (cells, directions) = hall();
    let ctx = Context::new(&cells, &directions, &settings(40), 60.0, CostBenefit::default(), NOTHING_BETWEEN);
    let members = members(&ctx);
    assert!(feasible(&ctx, &members[4], 0.0, ctx.budget).is_err());
    let Err((_, too_near)) = group(&ctx, &members) else { panic!("no box can serve") };
    assert!(too_near.needed > 40);
}

#[test]
fn faces_look_outward_and_their_regions_fill_what_is_outside_of_the_box() {
    let distance = [2.0, 3.0, 1.0, 4.0, 5.0, 2.5];
    let mut random = Random::new(17);
    let mut outside = [0; 6];
    for _ in 0..20_000 {
        let p = DVec3::from_array(std::array::from_fn(|_| (random.unit() - 0.5) * 40.0));
        let half = DVec3::from_array(std::array::from_fn(|_| random.unit()));
        let mut owners = 0;
        for (face, (axis, side)) in FACES.into_iter().enumerate() {
            let b = face_basis(face);
            assert!((b.right.cross(b.up) + b.forward).length() < 1e-12, "right-handed, as cameras are");
            let region = Region::new(face, &distance);
            let local = DVec3::new(p.dot(b.right), p.dot(b.up), p.dot(b.forward));
            assert_eq!(region.local(p, p).min, local);
            // Farthest along of those that it is beyond.
            let along = |f: usize| if FACES[f].1 == 0 { -p[FACES[f].0] } else { p[FACES[f].0] };
            let beyond = (0..6).filter(|f| along(*f) > distance[*f]);
            let owner = beyond.max_by(|a, b| along(*a).total_cmp(&along(*b)));
            let plan = ImagePlan { plane_distance: distance[face], beside: region.beside, ..plan_of_face(face) };
            assert_eq!(plan.owns(local), owner == Some(face), "{p}, axis {axis}, side {side}");
            if owner == Some(face) {
                owners += 1;
                outside[face] += 1;
                let t = region.tangents_of(&region.local(p - half, p + half)).expect("its middle is in there");
                let (x, y) = (local.x / local.z, local.y / local.z);
                assert!(x >= t[0] && x <= t[1] && y >= t[2] && y <= t[3], "{t:?} without {x} {y}");
            }
        }
        let inside = (0..3).all(|a| p[a] >= -distance[2 * a] && p[a] <= distance[2 * a + 1]);
        assert_eq!(owners, usize::from(!inside));
    }
    assert!(outside.iter().all(|n| *n > 1000), "{outside:?}");
    // What is far to the side is the side's.
    let far = Aabb { min: DVec3::new(50.0, 5.0, -1.0), max: DVec3::new(60.0, 6.0, 1.0) };
    let ceiling = Region::new(3, &distance);
    assert_eq!(ceiling.tangents_of(&ceiling.local(far.min, far.max)), None);
}

fn plan_of_face(face: usize) -> ImagePlan {
    ImagePlan {
        basis: face_basis(face),
        cop: DVec3::ZERO,
        plane_distance: 1.0,
        beside: [f64::INFINITY; 4],
        pixels_per_unit: 1.0,
        window: [-1.0, 1.0, -1.0, 1.0],
        users: Aabb::EMPTY,
        directions: vec![],
        footprint_px: 1.0,
    }
}
