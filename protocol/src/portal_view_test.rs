//! Worlds of boxes with rectangular holes in their walls, judged by rays that step from box to
//! box: no code is shared with the culling.

use super::*;
use crate::camera::ViewBasis;
use crate::rooms::{Cell, Portal, PortalKind};
use crate::{Aabb, OutputCamera};
use proptest::prelude::*;

/// Boxes on a raster of unequal pitch. Some places have no cell: courtyards, which belong to the
/// outside.
struct World {
    borders: [Vec<f64>; 3],
    cell: Vec<CellId>,
    /// Rectangles (min, max of the two other axes) in the wall beyond each place along each axis.
    holes: Vec<[Vec<[f64; 4]>; 3]>,
    rooms: Rooms,
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
    fn below(&mut self, n: usize) -> usize {
        (self.unit() * n as f64) as usize
    }
}

impl World {
    fn new(seed: u64, margin_m: f64) -> Self {
        let mut r = Random(seed);
        let size = [2 + r.below(4), 1 + r.below(2), 2 + r.below(4)];
        let borders = size.map(|n| {
            let mut at = -3.0;
            let mut next = |_| {
                at += 2.0 + 4.0 * r.unit();
                at
            };
            (0..=n).map(&mut next).collect::<Vec<f64>>()
        });
        let places = size.iter().product::<usize>();
        let mut cells = Vec::new();
        let mut cell = vec![None; places];
        let place = |i: usize| [i % size[0], i / size[0] % size[1], i / size[0] / size[1]];
        let bounds = |at: [usize; 3]| Aabb {
            min: DVec3::from(std::array::from_fn::<f64, 3, _>(|a| borders[a][at[a]])),
            max: DVec3::from(std::array::from_fn::<f64, 3, _>(|a| borders[a][at[a] + 1])),
        };
        for (i, c) in cell.iter_mut().enumerate() {
            if i == 0 || r.unit() < 0.9 {
                *c = Some(cells.len() as u32);
                cells.push(Cell { name: format!("c{i}"), boxes: vec![bounds(place(i))] });
            }
        }
        let mut holes = vec![[Vec::new(), Vec::new(), Vec::new()]; places];
        let mut portals = Vec::new();
        for i in 0..places {
            let at = place(i);
            for a in 0..3 {
                let mut next = at;
                next[a] += 1;
                let other = (next[a] < size[a]).then(|| cell[next[0] + size[0] * (next[1] + size[1] * next[2])]);
                let (this, other) = (cell[i], other.unwrap_or(None));
                if this == other {
                    continue;
                }
                let b = bounds(at);
                let [u, v] = [(a + 1) % 3, (a + 2) % 3];
                for _ in 0..r.below(3) {
                    let mut span = |axis: usize| {
                        let (low, size) = (b.min[axis], b.size()[axis]);
                        let from = r.unit() * 0.8;
                        [low + size * from, low + size * (from + (1.0 - from) * (0.1 + 0.8 * r.unit()))]
                    };
                    let ([u0, u1], [v0, v1]) = (span(u), span(v));
                    holes[i][a].push([u0, u1, v0, v1]);
                    let corner = |pu: f64, pv: f64| {
                        let mut p = DVec3::ZERO;
                        (p[a], p[u], p[v]) = (b.max[a], pu, pv);
                        p
                    };
                    // u x v is the axis, so this order points along it: from this cell into the
                    // other.
                    let corners = vec![corner(u0, v0), corner(u1, v0), corner(u1, v1), corner(u0, v1)];
                    portals.push(Portal { cells: [this, other], kind: PortalKind::Given, corners });
                }
            }
        }
        let rooms = Rooms::new(margin_m, cells, portals).unwrap();
        Self { borders, cell, holes, rooms }
    }

    fn size(&self) -> [usize; 3] {
        self.borders.each_ref().map(|b| b.len() - 1)
    }

    /// Cells along a ray until a wall stops it.
    fn along(&self, eye: DVec3, direction: DVec3, seen: &mut std::collections::BTreeSet<CellId>) {
        let size = self.size();
        let mut at: [usize; 3] =
            std::array::from_fn(|a| self.borders[a].partition_point(|b| *b <= eye[a]).clamp(1, size[a]) - 1);
        let number = |at: [usize; 3]| at[0] + size[0] * (at[1] + size[1] * at[2]);
        loop {
            seen.insert(self.cell[number(at)]);
            let exit = |a: usize| {
                let b = self.borders[a][at[a] + usize::from(direction[a] > 0.0)];
                if direction[a] == 0.0 { f64::INFINITY } else { (b - eye[a]) / direction[a] }
            };
            let a = (0..3).min_by(|a, b| exit(*a).total_cmp(&exit(*b))).unwrap();
            let p = eye + direction * exit(a);
            let up = direction[a] > 0.0;
            let leaves = if up { at[a] + 1 == size[a] } else { at[a] == 0 };
            let mut next = at;
            if !leaves {
                next[a] = if up { at[a] + 1 } else { at[a] - 1 };
            }
            let beyond = if leaves { None } else { self.cell[number(next)] };
            // The wall belongs to the lower of the two places; the lower outer walls have no holes.
            let wall = if up { Some(at) } else { (!leaves).then_some(next) };
            let open = self.cell[number(at)] == beyond
                || wall.is_some_and(|w| {
                    let (u, v) = (p[(a + 1) % 3], p[(a + 2) % 3]);
                    self.holes[number(w)][a].iter().any(|h| (h[0]..=h[1]).contains(&u) && (h[2]..=h[3]).contains(&v))
                });
            if !open {
                return;
            }
            if leaves {
                seen.insert(None);
                return;
            }
            at = next;
        }
    }

    fn eye(&self, r: &mut Random) -> DVec3 {
        DVec3::from(std::array::from_fn::<f64, 3, _>(|a| {
            let b = &self.borders[a];
            b[0] + (b[b.len() - 1] - b[0]) * (0.001 + 0.998 * r.unit())
        }))
    }
}

fn view(world: &World, eye: DVec3, basis: &ViewBasis, camera: &OutputCamera) -> PortalView {
    portal_view(&world.rooms, &Frustum::new(eye, basis, camera.half_tan_x(), camera.half_tan_y()))
}

/// Cells that the rays of `step`-th pixels see.
fn truth(
    w: &World,
    eye: DVec3,
    basis: &ViewBasis,
    camera: &OutputCamera,
    step: usize,
) -> std::collections::BTreeSet<CellId> {
    let mut seen = std::collections::BTreeSet::new();
    for v in (0..camera.height).step_by(step) {
        for u in (0..camera.width).step_by(step) {
            w.along(eye, camera.ray(basis, f64::from(u) + 0.5, f64::from(v) + 0.5), &mut seen);
        }
    }
    seen
}

const CAMERA: OutputCamera = OutputCamera { width: 320, height: 200, fov_deg: 75.0 };

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn no_cell_that_a_ray_reaches_is_missed(seed in any::<u64>(), margin in 0.0f64..0.2) {
        let world = World::new(seed, margin);
        let mut r = Random(seed ^ 0xabcd);
        for _ in 0..5 {
            let eye = world.eye(&mut r);
            let basis = ViewBasis::from_yaw_pitch(360.0 * r.unit(), 120.0 * r.unit() - 60.0);
            let found = view(&world, eye, &basis, &CAMERA);
            for cell in truth(&world, eye, &basis, &CAMERA, 5) {
                prop_assert!(found.sees(cell), "{} is missed from {eye}", world.rooms.name(cell));
            }
        }
    }

    #[test]
    fn every_ray_lies_in_a_cone_of_the_cell_it_reaches(seed in any::<u64>()) {
        let world = World::new(seed, 0.0);
        let mut r = Random(seed ^ 0x1234);
        let eye = world.eye(&mut r);
        let basis = ViewBasis::from_yaw_pitch(360.0 * r.unit(), 0.0);
        let found = view(&world, eye, &basis, &CAMERA);
        for _ in 0..400 {
            let d = CAMERA.ray(&basis, 320.0 * r.unit(), 200.0 * r.unit());
            let mut seen = std::collections::BTreeSet::new();
            world.along(eye, d, &mut seen);
            for cell in seen {
                let cones = &found.cells.iter().find(|c| c.cell == cell).expect("seen").cones;
                prop_assert!(cones.iter().any(|c| c.contains(eye + d)), "{}", world.rooms.name(cell));
            }
        }
    }
}

/// How many cells are reported that no ray of 320 x 200 reaches. Printed; the bound only says that
/// the cones do cull.
#[test]
fn overestimates_little() {
    let (mut reported, mut reached, mut all, mut clipped) = (0, 0, 0, 0);
    for seed in 0..60 {
        let world = World::new(seed, 0.0);
        let mut r = Random(seed + 7);
        let eye = world.eye(&mut r);
        let basis = ViewBasis::from_yaw_pitch(360.0 * r.unit(), 60.0 * r.unit() - 30.0);
        let found = view(&world, eye, &basis, &CAMERA);
        let seen = truth(&world, eye, &basis, &CAMERA, 1);
        assert!(seen.iter().all(|c| found.sees(*c)));
        reported += found.cells.len();
        reached += seen.len();
        all += world.rooms.cells().len() + 1;
        clipped += found.clipped;
    }
    println!("{reported} cells reported, {reached} reached by rays, of {all}; {clipped} portals clipped in 60 views");
    assert!(reported * 10 < reached * 13, "{reported} reported, {reached} reached");
}

#[test]
fn two_doors_in_line_narrow_the_view_and_out_of_line_close_it() {
    // Three rooms along x, doors in the walls x = 4 and x = 8.
    let room = |n: usize| Cell {
        name: format!("r{n}"),
        boxes: vec![Aabb {
            min: DVec3::new(4.0 * n as f64, 0.0, 0.0),
            max: DVec3::new(4.0 * n as f64 + 4.0, 3.0, 10.0),
        }],
    };
    let door = |a: u32, x: f64, z: f64| {
        let at = |y: f64, z: f64| DVec3::new(x, y, z);
        let corners = vec![at(0.0, z), at(2.0, z), at(2.0, z + 1.0), at(0.0, z + 1.0)];
        Portal { cells: [Some(a), Some(a + 1)], kind: PortalKind::Door, corners }
    };
    let sees = |z: f64| {
        let rooms = Rooms::new(0.05, (0..3).map(room).collect(), vec![door(0, 4.0, 4.0), door(1, 8.0, z)]).unwrap();
        let eye = DVec3::new(1.0, 1.5, 4.5);
        let f = Frustum::new(eye, &ViewBasis::from_yaw_pitch(-90.0, 0.0), 1.0, 1.0);
        let found = portal_view(&rooms, &f);
        assert!(found.sees(Some(0)) && found.sees(Some(1)));
        (found.sees(Some(2)), found)
    };
    let (straight, found) = sees(4.0);
    assert!(straight);
    let cone = &found.cells.iter().find(|c| c.cell == Some(2)).unwrap().cones[0];
    assert!(cone.contains(DVec3::new(8.0, 1.0, 4.5)) && !cone.contains(DVec3::new(8.0, 1.0, 3.9)));
    // Through the first door, at x = 8, z reaches from 4.5 - 7/6 to 4.5 + 7/6.
    assert!(sees(4.5 + 7.0 / 6.0 - 0.01).0);
    assert!(!sees(4.5 + 7.0 / 6.0 + 0.01).0);
    assert!(!sees(8.0).0);
}

#[test]
fn an_eye_in_a_doorway_sees_both_rooms_whichever_way_it_looks() {
    let world = World::new(3, 0.1);
    for p in world.rooms.portals() {
        for yaw in [0.0, 90.0, 180.0, 270.0] {
            let found = view(&world, p.centre() + 0.05, &ViewBasis::from_yaw_pitch(yaw, 0.0), &CAMERA);
            assert!(p.cells.iter().all(|c| found.sees(*c)));
        }
    }
}

/// Points of the polygon lie in the clipped one exactly if they lie in the cone, and no polygon of
/// which something is left is rejected by its ball.
#[test]
fn clipping_keeps_what_lies_in_the_cone_and_the_ball_rejects_nothing_of_it() {
    let mut r = Random(11);
    let (mut kept, mut cut, mut rejected) = (0, 0, 0);
    for _ in 0..12_000 {
        let mut point = |scale: f64| (DVec3::new(r.unit(), r.unit(), r.unit()) - 0.5) * scale;
        let (eye, toward) = (point(1.0), point(10.0));
        let (u, v) = (point(2.0), point(2.0));
        let window = [toward - u - v, toward + u - v, toward + u + v, toward - u + v];
        let Some(cone) = Cone::over(eye, &window) else { continue };
        let (middle, a, b) = (point(14.0), point(4.0), point(4.0));
        let corners = vec![middle - a - b, middle + a - b, middle + a + b, middle - a + b];
        let left = cone.clip(&corners);
        let portal = Portal { cells: [Some(0), None], kind: PortalKind::Door, corners };
        let face = crate::rooms::Face::of(&portal);
        let reaches = cone.may_reach(face.centre, face.radius_m);
        assert!(reaches || left.is_empty(), "{cone:?} {portal:?}");
        rejected += u32::from(!reaches);
        // Positive inside all sides of the clipped polygon.
        let n = a.cross(b).normalize_or_zero();
        let within = |p: DVec3| {
            (0..left.len())
                .map(|i| {
                    let (c, d) = (left[i], left[(i + 1) % left.len()]);
                    n.cross((d - c).normalize_or_zero()).dot(p - c)
                })
                .fold(if left.is_empty() { -1.0 } else { f64::INFINITY }, f64::min)
        };
        for _ in 0..20 {
            let p = middle + a * (2.0 * r.unit() - 1.0) + b * (2.0 * r.unit() - 1.0);
            let depth = cone.normals.iter().map(|n| n.dot(p - eye)).fold(f64::INFINITY, f64::min);
            // On the border rounding decides; slivers have no normals to speak of.
            if depth.abs() < 1e-3 || a.cross(b).length() < 0.1 {
                continue;
            }
            assert_eq!(depth > 0.0, within(p) > 0.0, "{p}: {depth}, {}", within(p));
            if depth > 0.0 { kept += 1 } else { cut += 1 }
        }
    }
    assert!(kept > 1000 && cut > 10_000 && rejected > 500, "{kept} {cut} {rejected}");
}
