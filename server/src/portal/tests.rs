//! Small buildings of blocks, each with one difficulty, and what has to be found in them.

use super::*;
use crate::placement::test_scenes::{block, scene_of};
use crate::render::Caster;
use crate::scene::{self, Primitive, Scene};
use glam::DVec3;
use ldi_protocol::Aabb;
use ldi_protocol::OutputCamera;
use ldi_protocol::rooms::{CellId, Portal, PortalKind, Rooms};
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering::Relaxed},
};

/// Height of the rooms, metres.
const HIGH: f64 = 2.8;
/// Thickness of the walls, metres.
const THICK: f64 = 0.2;

/// Blocks, from (x0, y0, z0) to (x1, y1, z1).
#[derive(Default)]
struct Blocks(Vec<Primitive>);

impl Blocks {
    fn add(mut self, a: [f64; 3], b: [f64; 3]) -> Self {
        self.0.push(block(&Aabb { min: DVec3::from(a), max: DVec3::from(b) }));
        self
    }

    /// Floor and, above it, ceiling over a rectangle.
    fn floor(self, x: [f64; 2], z: [f64; 2], y: f64, ceiling: bool) -> Self {
        let s = self.add([x[0], y - 0.2, z[0]], [x[1], y, z[1]]);
        if ceiling { s.add([x[0], y + HIGH, z[0]], [x[1], y + HIGH + 0.2, z[1]]) } else { s }
    }

    /// A wall across x at `x`, along z, with doors of 1 x 2.1 m beginning at these z.
    fn wall_x(mut self, x: f64, z: [f64; 2], y: f64, doors: &[f64]) -> Self {
        let (a, b) = (x - 0.5 * THICK, x + 0.5 * THICK);
        let mut from = z[0];
        for d in doors {
            self = self.add([a, y, from], [b, y + HIGH, *d]);
            self = self.add([a, y + 2.1, *d], [b, y + HIGH, d + 1.0]);
            from = d + 1.0;
        }
        self.add([a, y, from], [b, y + HIGH, z[1]])
    }

    /// The same across z.
    fn wall_z(mut self, z: f64, x: [f64; 2], y: f64, doors: &[f64]) -> Self {
        let (a, b) = (z - 0.5 * THICK, z + 0.5 * THICK);
        let mut from = x[0];
        for d in doors {
            self = self.add([from, y, a], [*d, y + HIGH, b]);
            self = self.add([*d, y + 2.1, a], [d + 1.0, y + HIGH, b]);
            from = d + 1.0;
        }
        self.add([from, y, a], [x[1], y + HIGH, b])
    }

    /// Four closed outer walls.
    fn shell(self, x: [f64; 2], z: [f64; 2], y: f64) -> Self {
        self.wall_x(x[0], z, y, &[]).wall_x(x[1], z, y, &[]).wall_z(z[0], x, y, &[]).wall_z(z[1], x, y, &[])
    }

    fn scene(self) -> Scene {
        scene_of(&self.0)
    }

    fn found(self) -> (Caster, FoundRooms) {
        let caster = Caster::of_scene(Arc::new(self.scene()), false);
        let found = find_rooms(&caster, &caster.scene().bounds()).unwrap();
        (caster, found)
    }
}

/// Two rooms of 5 x 4 m along x, without what is between them.
fn pair(ceiling: bool) -> Blocks {
    Blocks::default().floor([0.0, 10.0], [0.0, 4.0], 0.0, ceiling).shell([0.0, 10.0], [0.0, 4.0], 0.0)
}

fn of_kind(r: &Rooms, kind: PortalKind) -> Vec<&Portal> {
    r.portals().iter().filter(|p| p.kind == kind).collect()
}

fn at(r: &Rooms, x: f64, y: f64, z: f64) -> CellId {
    r.cell_at(DVec3::new(x, y, z))
}

/// One door of 1 x 2.1 m at x = 5, z from 1.5, within so much.
fn assert_door(r: &Rooms, within_m: f64) {
    let doors = of_kind(r, PortalKind::Door);
    assert_eq!(doors.len(), 1, "{:?}", r.portals());
    let b = Aabb::from_points(doors[0].corners.iter().copied());
    let wanted = Aabb { min: DVec3::new(5.0, 0.0, 1.5), max: DVec3::new(5.0, 2.1, 2.5) };
    assert!((b.min.x - 5.0).abs() < 0.1 && (b.max.x - 5.0).abs() < 0.1, "{b:?}");
    for (found, wanted) in [(b.min, wanted.min), (b.max, wanted.max)] {
        assert!((found - wanted).with_x(0.0).abs().max_element() < within_m, "{b:?}");
    }
}

/// No culling misses what rays see.
fn assert_nothing_missed(caster: &Caster, r: &Rooms) {
    let poses = random_poses(caster, r, 150, 5);
    assert!(poses.len() > 100, "{} poses", poses.len());
    // The whole scene is one cell of the octree, which is always drawn: cells of rooms are what is
    // judged here.
    let cells = [caster.scene().bounds()];
    let judged = AtomicU64::new(0);
    let told = || {
        judged.fetch_add(1, Relaxed);
    };
    let members = cells_of_rooms(caster, r, cells.len());
    let check =
        check_sight(caster, &cells, r, &members, &poses, &OutputCamera { width: 96, height: 64, fov_deg: 70.0 }, &told);
    assert_eq!(judged.into_inner(), check.poses);
    assert!(check.rays > 100_000, "{check:?}");
    assert_eq!(check.missed_rays, 0, "{check:?}");
}

#[test]
fn two_rooms_with_a_door() {
    let (caster, found) = pair(true).wall_x(5.0, [0.0, 4.0], 0.0, &[1.5]).found();
    let r = &found.rooms;
    assert_eq!(r.cells().len(), 2, "{:?}", found.statistics);
    assert_eq!(r.portals().len(), 1, "{:?}", r.portals());
    assert_door(r, 0.06);
    let (west, east) = (at(r, 2.0, 1.0, 2.0), at(r, 8.0, 1.0, 2.0));
    assert!(west.is_some() && east.is_some() && west != east);
    let into = if r.portals()[0].cells == [west, east] { DVec3::X } else { DVec3::NEG_X };
    assert!(r.portals()[0].normal().dot(into) > 0.999);
    assert_eq!(found.statistics.leaking_rays, 0);
    assert_nothing_missed(&caster, r);
}

#[test]
fn an_open_leaf_in_the_doorway_changes_little() {
    // The leaf stands open at a right angle, hinged at z = 2.5, and another one half open.
    let leaf = pair(true).wall_x(5.0, [0.0, 4.0], 0.0, &[1.5]).add([5.0, 0.01, 2.44], [5.95, 2.05, 2.48]);
    let (caster, found) = leaf.found();
    assert_eq!(found.rooms.cells().len(), 2, "{:?}", found.statistics);
    assert_door(&found.rooms, 0.12);
    assert_nothing_missed(&caster, &found.rooms);
}

#[test]
fn furniture_does_not_split_a_room() {
    // A table, a shelf of 1.8 m across most of the room, and a pillar.
    let (_, found) = Blocks::default()
        .floor([0.0, 8.0], [0.0, 6.0], 0.0, true)
        .shell([0.0, 8.0], [0.0, 6.0], 0.0)
        .add([1.0, 0.0, 1.0], [3.0, 0.75, 2.5])
        .add([4.0, 0.0, 1.0], [4.4, 1.8, 5.5])
        .add([6.0, 0.0, 2.8], [6.4, 2.8, 3.2])
        .found();
    assert_eq!(found.rooms.cells().len(), 1, "{:?}", found.statistics);
    assert!(found.rooms.portals().is_empty(), "{:?}", found.rooms.portals());
}

#[test]
fn a_closed_wall_is_no_portal() {
    let (_, found) = pair(true).wall_x(5.0, [0.0, 4.0], 0.0, &[]).found();
    assert_eq!((found.rooms.cells().len(), found.rooms.portals().len()), (2, 0), "{:?}", found.statistics);
}

#[test]
fn rooms_without_a_ceiling_are_open_to_the_sky() {
    let (caster, found) = pair(false).wall_x(5.0, [0.0, 4.0], 0.0, &[1.5]).found();
    let r = &found.rooms;
    assert_eq!(r.cells().len(), 2, "{:?}", found.statistics);
    assert_door(r, 0.06);
    let hatches = of_kind(r, PortalKind::Hatch);
    assert_eq!(hatches.len(), 2, "{:?}", r.portals());
    assert!(hatches.iter().all(|h| h.cells[1].is_none() && h.normal().y > 0.99 && h.area_m2() > 15.0));
    assert_nothing_missed(&caster, r);
}

#[test]
fn double_walls_have_one_door_and_their_cavity_is_no_room() {
    // Two sheets 0.3 m apart without jambs: the cavity is open toward the doorway. Its mouths may
    // become gaps.
    let mut b = pair(true);
    for x in [4.85, 5.15] {
        b = b
            .add([x - 0.01, 0.0, 0.0], [x + 0.01, HIGH, 1.5])
            .add([x - 0.01, 0.0, 2.5], [x + 0.01, HIGH, 4.0])
            .add([x - 0.01, 2.1, 1.5], [x + 0.01, HIGH, 2.5]);
    }
    let (caster, found) = b.found();
    let r = &found.rooms;
    assert_eq!(r.cells().len(), 2, "{:?}", found.statistics);
    let doors = of_kind(r, PortalKind::Door);
    assert_eq!(doors.len(), 1, "{:?}", r.portals());
    assert!((doors[0].area_m2() - 2.1).abs() < 0.1, "{:?}", doors[0]);
    assert_nothing_missed(&caster, r);
}

#[test]
fn a_gap_above_a_wall_is_found_by_rays() {
    // The wall ends 0.4 m below the ceiling.
    let b = Blocks::default()
        .floor([0.0, 10.0], [0.0, 4.0], 0.0, true)
        .shell([0.0, 10.0], [0.0, 4.0], 0.0)
        .add([4.9, 0.0, 0.0], [5.1, 2.4, 4.0]);
    let (caster, found) = b.found();
    let r = &found.rooms;
    assert_eq!(r.cells().len(), 2, "{:?}", found.statistics);
    let gaps = of_kind(r, PortalKind::Gap);
    assert!(!gaps.is_empty() && r.portals().len() == gaps.len(), "{:?}", r.portals());
    assert_nothing_missed(&caster, r);
}

#[test]
fn stairs_join_storeys_through_a_hatch() {
    // A straight flight of 16 steps along x in the upper floor's opening, z 0.1 to 1.1.
    let mut b = around_a_stairwell([2.0, 6.5], 1.1);
    for k in 0..15 {
        let x = 2.0 + 0.3 * f64::from(k);
        let y = 3.0 * f64::from(k + 1) / 16.0;
        b = b.add([x, y - 0.1, 0.1], [x + 0.32, y, 1.1]);
    }
    let (caster, found) = b.found();
    let r = &found.rooms;
    assert_eq!(found.statistics.storeys_m.len(), 2, "{:?}", found.statistics);
    assert_eq!(r.cells().len(), 2, "{:?} {:?}", found.statistics, r.portals());
    let (low, high) = (at(r, 4.0, 1.0, 3.0), at(r, 4.0, 4.5, 3.0));
    assert!(low.is_some() && high.is_some() && low != high);
    let hatches = of_kind(r, PortalKind::Hatch);
    assert!(hatches.iter().any(|h| h.cells == [low, high] && h.area_m2() > 3.0), "{:?}", r.portals());
    assert_nothing_missed(&caster, r);
}

/// Two storeys of 8 x 5 m; the upper floor, at 3 m, is open over these x and z from 0 to this,
/// metres.
fn around_a_stairwell([x0, x1]: [f64; 2], z1: f64) -> Blocks {
    Blocks::default()
        .floor([0.0, 8.0], [0.0, 5.0], 0.0, false)
        .shell([0.0, 8.0], [0.0, 5.0], 0.0)
        .add([0.0, HIGH, z1], [8.0, 3.0, 5.0])
        .add([0.0, HIGH, 0.0], [x0, 3.0, z1])
        .add([x1, HIGH, 0.0], [8.0, 3.0, z1])
        // The outer wall between the storeys' walls, where no floor closes it.
        .add([x0, HIGH, -0.1], [x1, 3.0, 0.1])
        .floor([0.0, 8.0], [0.0, 5.0], 3.0 + HIGH + 0.2, false)
        .shell([0.0, 8.0], [0.0, 5.0], 3.0)
}

/// The storeys are two cells with a hatch between them, and nothing is missed.
fn assert_joined_by_a_hatch(stairs: Blocks) {
    let (caster, found) = stairs.found();
    let r = &found.rooms;
    assert_eq!(found.statistics.storeys_m.len(), 2, "{:?}", found.statistics);
    let (low, high) = (at(r, 7.0, 1.0, 4.0), at(r, 7.0, 4.5, 4.0));
    assert!(low.is_some() && high.is_some() && low != high, "{:?} {:?}", found.statistics, r.portals());
    let hatches = of_kind(r, PortalKind::Hatch);
    assert!(hatches.iter().any(|h| h.cells == [low, high]), "{:?}", r.portals());
    assert_nothing_missed(&caster, r);
}

#[test]
fn stairs_with_a_half_landing_join_storeys() {
    // Up along -x beside the outer wall, a landing at half the height, and up along x beside the
    // first flight.
    let mut b = around_a_stairwell([1.0, 5.0], 2.4).add([1.0, 1.4, 0.1], [2.0, 1.5, 2.3]);
    for k in 0..8 {
        let (x, y) = (4.4 - 0.3 * f64::from(k), 1.5 * f64::from(k + 1) / 8.0);
        b = b.add([x - 0.32, y - 0.1, 0.1], [x, y, 1.1]);
        let (x, y) = (2.0 + 0.3 * f64::from(k), 1.5 + y);
        b = b.add([x, y - 0.1, 1.3], [x + 0.32, y, 2.3]);
    }
    assert_joined_by_a_hatch(b);
}

#[test]
fn winding_stairs_join_storeys() {
    // Three quarters of a turn around a pole.
    let mut b = around_a_stairwell([1.0, 5.0], 2.4).add([2.9, 0.0, 1.15], [3.0, 4.0, 1.25]);
    for k in 0..16 {
        let (sine, cosine) = (1.5 * std::f64::consts::PI * f64::from(k) / 15.0).sin_cos();
        let [x, z] = [2.95 + 0.6 * cosine, 1.2 + 0.6 * sine];
        let y = 3.0 * f64::from(k + 1) / 16.0;
        b = b.add([x - 0.3, y - 0.08, z - 0.3], [x + 0.3, y, z + 0.3]);
    }
    assert_joined_by_a_hatch(b);
}

#[test]
fn an_open_gallery_is_seen_from_the_hall_below() {
    // A hall of 10 x 8 m and 6 m height; along one side a gallery 3 m up, 3 m deep, with a railing
    // of posts.
    let mut b = Blocks::default()
        .floor([0.0, 10.0], [0.0, 8.0], 0.0, false)
        .shell([0.0, 10.0], [0.0, 8.0], 0.0)
        .add([0.0, HIGH, 5.0], [10.0, 3.0, 8.0])
        .shell([0.0, 10.0], [0.0, 8.0], 3.0)
        .floor([0.0, 10.0], [0.0, 8.0], 3.0 + HIGH + 0.2, false)
        .add([-0.1, HIGH, -0.1], [0.1, 3.0, 5.0])
        .add([9.9, HIGH, -0.1], [10.1, 3.0, 5.0])
        .add([0.0, HIGH, -0.1], [10.0, 3.0, 0.1])
        .add([0.0, 3.95, 5.0], [10.0, 4.0, 5.05]);
    for k in 0..40 {
        let x = 0.1 + 0.25 * f64::from(k);
        b = b.add([x, 3.0, 5.0], [x + 0.03, 3.95, 5.03]);
    }
    let (caster, found) = b.found();
    let r = &found.rooms;
    let (hall, below, gallery) = (at(r, 5.0, 1.0, 2.5), at(r, 5.0, 1.0, 6.5), at(r, 5.0, 4.5, 6.5));
    assert!(hall.is_some() && below.is_some() && gallery.is_some(), "{:?} {:?}", found.statistics, r.portals());
    assert_nothing_missed(&caster, r);
}

#[test]
fn under_a_table_upstairs_it_is_upstairs() {
    let storey = |b: Blocks, y: f64| b.floor([0.0, 8.0], [0.0, 5.0], y, false).shell([0.0, 8.0], [0.0, 5.0], y);
    let (caster, found) = storey(storey(Blocks::default(), 0.0), 3.0)
        .floor([0.0, 8.0], [0.0, 5.0], 3.0 + HIGH + 0.2, false)
        // A table, and a board along the wall.
        .add([3.0, 3.85, 2.0], [5.0, 3.9, 3.0])
        .add([0.1, 3.85, 4.2], [7.9, 3.9, 4.9])
        .found();
    let r = &found.rooms;
    let (low, high) = (at(r, 4.0, 1.0, 1.0), at(r, 4.0, 4.5, 1.0));
    assert!(low.is_some() && high.is_some() && low != high, "{:?}", found.statistics);
    assert_eq!([at(r, 4.0, 3.4, 2.5), at(r, 1.0, 3.4, 4.6)], [high; 2]);
    assert!(r.portals().is_empty(), "{:?}", r.portals());
    assert_eq!(found.statistics.leaking_rays, 0);
    assert_nothing_missed(&caster, r);
}

#[test]
fn one_big_hall_is_one_cell() {
    let mut b = Blocks::default().floor([0.0, 30.0], [0.0, 20.0], 0.0, true).shell([0.0, 30.0], [0.0, 20.0], 0.0);
    for i in 0..5 {
        for k in 0..3 {
            let (x, z) = (5.0 + 5.0 * f64::from(i), 5.0 + 5.0 * f64::from(k));
            b = b.add([x - 0.25, 0.0, z - 0.25], [x + 0.25, HIGH, z + 0.25]);
        }
    }
    let (_, found) = b.found();
    assert_eq!((found.rooms.cells().len(), found.rooms.portals().len()), (1, 0), "{:?}", found.statistics);
}

#[test]
fn a_corridor_with_a_bend_is_one_cell() {
    // 1.6 m wide: 10 m along x, then 8 m along z.
    let (_, found) = Blocks::default()
        .floor([0.0, 10.0], [0.0, 10.0], 0.0, true)
        .shell([0.0, 10.0], [0.0, 10.0], 0.0)
        .add([0.0, 0.0, 1.7], [8.3, HIGH, 10.0])
        .found();
    assert_eq!((found.rooms.cells().len(), found.rooms.portals().len()), (1, 0), "{:?}", found.statistics);
}

#[test]
fn a_window_leads_outside() {
    // In the wall z = 4, from x = 1.5, sill at 0.9 m.
    let (caster, found) = Blocks::default()
        .floor([0.0, 5.0], [0.0, 4.0], 0.0, true)
        .wall_x(0.0, [0.0, 4.0], 0.0, &[])
        .wall_x(5.0, [0.0, 4.0], 0.0, &[])
        .wall_z(0.0, [0.0, 5.0], 0.0, &[])
        .wall_z(4.0, [0.0, 5.0], 0.0, &[1.5])
        .add([1.5, 0.0, 3.9], [2.5, 0.9, 4.1])
        .found();
    let r = &found.rooms;
    assert_eq!(r.cells().len(), 1, "{:?}", found.statistics);
    let windows = of_kind(r, PortalKind::Window);
    assert_eq!((windows.len(), r.portals().len()), (1, 1), "{:?}", r.portals());
    assert!((windows[0].area_m2() - 1.2).abs() < 0.12, "{}", windows[0].area_m2());
    assert_eq!(windows[0].beyond(Some(0)), Some(None));
    assert_nothing_missed(&caster, r);
}

#[test]
fn open_terrain_has_no_rooms_and_says_so() {
    let (_, found) =
        Blocks::default().floor([-20.0, 20.0], [-20.0, 20.0], 0.0, false).add([3.0, 0.0, 3.0], [5.0, 4.0, 5.0]).found();
    assert!(found.rooms.cells().is_empty());
    assert!(found.statistics.no_cells.as_deref().is_some_and(|w| w.contains("outside")), "{:?}", found.statistics);
}

#[test]
fn an_empty_scene_has_no_rooms_and_says_so() {
    let caster = Caster::of_scene(Arc::new(Scene::default()), false);
    let found = find_rooms(&caster, &caster.scene().bounds()).unwrap();
    assert!(found.rooms.cells().is_empty());
    assert_eq!(found.statistics.no_cells.as_deref(), Some("the scene is empty"));
}

#[test]
fn annotated_rooms_of_the_house_see_all_that_rays_see() {
    let scene = Arc::new(scene::load("builtin:house?triangles=20000").unwrap());
    let rooms = annotated_rooms(&scene).unwrap().unwrap();
    assert_eq!((rooms.cells().len(), rooms.portals().len()), (19, 52));
    for p in rooms.portals() {
        let ahead = rooms.cell_at(p.centre() + p.normal() * 0.3);
        assert_eq!(ahead, p.cells[1]);
        assert_eq!(rooms.cell_at(p.centre() - p.normal() * 0.3), p.cells[0]);
    }
    let caster = Caster::of_scene(scene, false);
    assert_nothing_missed(&caster, &rooms);
}

/// The figures of docs/benchmarks/rooms.md. The bounds say that the search works, not how well.
#[test]
fn the_house_is_found_as_it_is_annotated() {
    let scene = Arc::new(scene::load("builtin:house?triangles=20000").unwrap());
    let annotated = annotated_rooms(&scene).unwrap().unwrap();
    let caster = Caster::of_scene(scene, false);
    let found = find_rooms(&caster, &caster.scene().bounds()).unwrap();
    let c = compare(&annotated, &found.rooms);
    println!("{c:?}\n{:?}", found.statistics);
    assert_eq!((c.cells_found.len(), c.cells_missed.len(), c.cells_invented.len()), (19, 0, 0), "{c:?}");
    assert_eq!((c.portals_found.len(), c.portals_missed.len()), (52, 0), "{c:?}");
    assert!(c.portals_invented.is_empty(), "{c:?}");
    // A comparison can fail: of other rooms nothing matches.
    let none = compare(&annotated, &Rooms::default());
    assert_eq!((none.cells_found.len(), none.portals_missed.len()), (0, 52));
}
