//! A row of rooms along -Z, each with cells of known triangles, doors between them; placements at
//! the doors.

use super::*;
use crate::{
    Aabb, CellRuns, OutputCamera, ViewBasis,
    index::{AngularRange, BuildSettings, CellEntry, GridPoint, ImageEntry, Placement, SceneInfo},
    room_index::{BuiltImages, SideImages},
    rooms::{Cell, Portal, PortalKind, Rooms},
    select::{Show, draw_list, draw_list_showing, least_by_rooms},
};
use glam::DVec3;
use proptest::prelude::*;

const ROOMS: usize = 5;
/// Triangles of each cell; two cells per room, at its side walls.
const TRIANGLES: u32 = 100;

/// Room k spans z from -4k - 4 to -4k, x from -3 to 3. Cell 2k, 2k + 1: at its left and right wall.
fn index(budget: u64, served: &[usize]) -> Index {
    let z = |k: usize| -4.0 * k as f64;
    let cell = |i: usize| {
        let (k, x) = (i / 2, if i.is_multiple_of(2) { -2.0 } else { 2.0 });
        CellEntry {
            bounds: Aabb { min: DVec3::new(x - 0.5, 0.0, z(k) - 3.0), max: DVec3::new(x + 0.5, 2.0, z(k) - 1.0) },
            triangles: TRIANGLES,
            chunk: 0,
            bundles: vec![],
            materials: vec![],
            texel_density: vec![],
            levels: Vec::new(),
        }
    };
    let room = |k: usize| Cell {
        name: format!("room {k}"),
        boxes: vec![Aabb { min: DVec3::new(-3.0, 0.0, z(k + 1)), max: DVec3::new(3.0, 3.0, z(k)) }],
    };
    // Normals along -Z.
    let door = |k: usize| Portal {
        cells: [Some(k as u32), Some(k as u32 + 1)],
        kind: PortalKind::Door,
        corners: [(-1.0, 0.0), (-1.0, 2.0), (1.0, 2.0), (1.0, 0.0)].map(|(x, y)| DVec3::new(x, y, z(k + 1))).to_vec(),
    };
    let portals: Vec<Portal> = (0..ROOMS - 1).map(door).collect();
    assert!(portals.iter().all(|p| p.normal().distance(DVec3::NEG_Z) < 1e-9));
    let rooms = Rooms::new(0.1, (0..ROOMS).map(room).collect(), portals).expect("sound");
    let mut placements = Vec::new();
    let mut images = Vec::new();
    let mut ranges = vec![[0..0, 0..0]; ROOMS - 1];
    // For eyes of the room before the door and of the one before that, at least a metre from the
    // door.
    for &k in served {
        let first = placements.len() as u32;
        placements.push(Placement {
            grid_point: None,
            cop: DVec3::new(0.0, 1.5, z(k) - 2.0),
            culled: CellRuns::default(),
            footprint_px: 1.9,
            users: Aabb { min: DVec3::new(-3.0, 1.0, z(k + 1) + 1.0), max: DVec3::new(3.0, 2.0, z(k) + 4.0) },
            images: images.len() as u32..images.len() as u32 + 1,
            sky: Default::default(),
        });
        images.push(ImageEntry {
            basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
            plane_distance: 1.99,
            window: [-1.0, 1.0, -1.0, 1.0],
            stretch_p99_px: f64::NAN,
            chunks: vec![0],
            samples_by_layer: vec![1],
        });
        ranges[k][0] = first..first + 1;
    }
    let cells_of = (0..ROOMS as u32).map(|k| vec![2 * k, 2 * k + 1]).chain([vec![]]).collect();
    Index {
        scene: SceneInfo {
            name: String::new(),
            triangles: 2 * ROOMS as u64 * u64::from(TRIANGLES),
            unique_triangles: 0,
            instances: 1,
            bounds: Aabb::EMPTY,
        },
        settings: BuildSettings {
            budget,
            optimize_budget: budget,
            camera: OutputCamera { width: 64, height: 64, fov_deg: 90.0 },
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "high".into(),
            grid: "cells".into(),
            eye_height_m: None,
        },
        chunks: vec![],
        cells: (0..2 * ROOMS).map(cell).collect(),
        materials: vec![],
        textures: vec![],
        pitch_bands_deg: vec![],
        points: vec![],
        placements,
        images,
        volume: None,
        tree: None,
        plans: Vec::new(),
        rooms: Some(RoomIndex { rooms, near_m: 0.6, cells_of, placements: ranges, ..Default::default() }),
    }
}

fn pose(z: f64, yaw_deg: f64) -> Pose {
    Pose { position: DVec3::new(0.0, 1.5, z), yaw_deg, pitch_deg: 0.0 }
}

const SQUARE: (f64, f64) = (1.0, 1.0);

#[test]
fn within_the_budget_all_that_is_seen_is_geometry() {
    let index = index(1000, &[0, 1, 2, 3]);
    let list = draw_list(&index, &pose(-0.5, 0.0), SQUARE);
    // The first door leaves a cone of slope 1 / 3.5, which reaches room 1's cells 1.5 m aside; the
    // second one of 1 / 7.5, which does not reach room 2's.
    assert_eq!((list.cell_numbers().as_slice(), list.triangles), (&[0, 1, 2, 3][..], 400));
    assert!(list.portals.is_empty() && list.images.is_empty());
    assert_eq!(list.rooms, (0..5).map(Some).collect::<Vec<_>>());
    let back = draw_list(&index, &pose(-0.5, 180.0), SQUARE);
    assert_eq!((back.cells.len(), back.triangles), (0, 0), "a wall");
}

#[test]
fn beyond_the_budget_portals_show_what_is_left() {
    let list = draw_list(&index(399, &[0, 1, 2, 3]), &pose(-0.5, 0.0), SQUARE);
    assert_eq!((list.cell_numbers().as_slice(), list.dropped), (&[0, 1][..], 0));
    assert_eq!(list.rooms, [Some(0)]);
    let shown: Vec<_> = list.portals.iter().map(|p| (p.portal, p.side, p.placement)).collect();
    assert_eq!((shown, list.images), (vec![(0, 0, 0)], vec![0]));
    // Looking back, from the last room, there are no placements: everything is geometry, and the
    // farthest goes.
    let back = draw_list(&index(250, &[0, 1, 2, 3]), &pose(-19.0, 180.0), SQUARE);
    assert!(back.portals.is_empty());
    assert_eq!((back.triangles, back.dropped), (200, 2));
}

#[test]
fn nearer_than_its_eyes_an_image_gives_way_to_geometry() {
    // Half a metre before the first door room 1 must be geometry, for which its own door has an
    // image.
    let list = draw_list(&index(399, &[0, 1, 2, 3]), &pose(-3.5, 0.0), SQUARE);
    assert_eq!(list.cell_numbers(), [2, 3]);
    assert_eq!(list.portals.iter().map(|p| p.portal).collect::<Vec<_>>(), [1]);
    // Without one for it the next is looked for, and so on.
    let fewer = draw_list(&index(399, &[0, 2]), &pose(-3.5, 0.0), SQUARE);
    assert!(fewer.portals.is_empty(), "the eye is not among those of the third door");
    assert!(fewer.dropped > 0, "{fewer:?}");
}

/// The same with a grid point at the end of the first room, for eyes at least 3 m from the first
/// door, whose placement replaces everything but that room.
fn with_grid(budget: u64) -> Index {
    let mut index = index(budget, &[]);
    index.pitch_bands_deg = vec![-60.0, 60.0];
    index.points = vec![GridPoint {
        position: DVec3::new(0.0, 1.5, -0.5),
        level: 0,
        radius: 9.0,
        bands: vec![vec![AngularRange { yaw_start_deg: 0.0, placement: Some(0) }]],
    }];
    index.placements = vec![Placement {
        grid_point: Some(0),
        cop: DVec3::new(0.0, 1.5, -0.5),
        culled: (2..2 * ROOMS as u32).collect(),
        footprint_px: 1.5,
        users: Aabb { min: DVec3::new(-3.0, 1.0, -1.0), max: DVec3::new(3.0, 2.0, 0.0) },
        images: 0..1,
        sky: Default::default(),
    }];
    index.images = vec![ImageEntry {
        basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
        plane_distance: 3.0,
        window: [-1.0, 1.0, -1.0, 1.0],
        stretch_p99_px: f64::NAN,
        chunks: vec![0],
        samples_by_layer: vec![1],
    }];
    index
}

#[test]
fn where_rooms_are_too_much_the_grid_takes_over_for_its_eyes_alone() {
    // 400 triangles are seen from the first room, with no image at its door.
    let list = draw_list(&with_grid(399), &pose(-0.5, 0.0), SQUARE);
    assert_eq!((list.selection.grid_point, list.selection.placement), (Some(0), Some(0)));
    assert_eq!((list.cell_numbers().as_slice(), list.images.as_slice(), list.dropped), (&[0, 1][..], &[0][..], 0));
    assert!(list.rooms.is_empty() && list.portals.is_empty());
    // Within the budget it is the rooms'.
    let list = draw_list(&with_grid(400), &pose(-0.5, 0.0), SQUARE);
    assert_eq!((list.selection.grid_point, list.cells.len(), list.images.len()), (None, 4, 0));
    // Another eye, which sees the second room only: the farthest cells go, as without a grid.
    let other = pose(-1.5, 0.0);
    let list = draw_list(&with_grid(199), &other, SQUARE);
    assert!(list.selection.grid_point.is_none() && list.dropped > 0, "{list:?}");
    assert_eq!(list, draw_list(&index(199, &[]), &other, SQUARE));
    // Nor does the grid help where it exceeds the budget itself.
    let list = draw_list(&with_grid(150), &pose(-0.5, 0.0), SQUARE);
    assert!(list.selection.grid_point.is_none() && list.dropped > 0, "{list:?}");
}

/// The same with five reference images before the second door, at 1.6 m from its middle, every 20
/// degrees from left to right, and one layered image.
fn with_references(budget: u64) -> Index {
    let mut index = index(budget, &[]);
    for k in 0..6 {
        let angle = (f64::from(k.min(4)) * 20.0 - 40.0_f64).to_radians();
        // The sixth is the layered one, where the central one is.
        let angle = if k == 5 { 0.0 } else { angle };
        index.placements.push(Placement {
            grid_point: None,
            cop: DVec3::new(1.6 * angle.sin(), 1.5, -8.0 + 1.6 * angle.cos()),
            culled: CellRuns::default(),
            footprint_px: 4.0,
            users: Aabb { min: DVec3::new(-3.0, 1.0, -8.0), max: DVec3::new(3.0, 2.0, 0.0) },
            images: k..k + 1,
            sky: Default::default(),
        });
        index.images.push(ImageEntry {
            basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
            plane_distance: 1.6 * angle.cos() * 0.999,
            window: [-20.0, 20.0, -20.0, 20.0],
            stretch_p99_px: f64::NAN,
            chunks: vec![0],
            samples_by_layer: vec![1],
        });
    }
    if let Some(rooms) = &mut index.rooms {
        rooms.built = BuiltImages::Paper;
        rooms.sides = vec![Default::default(); ROOMS - 1];
        rooms.sides[1][0] = SideImages { references: 0..5, central: 2, layered: Some(5) };
        assert_eq!(rooms.check(index.cells.len(), &index.placements), Ok(()));
    }
    index
}

#[test]
fn each_kind_of_image_is_the_one_that_was_asked_for() {
    let index = with_references(1000);
    let shown = |images, x: f64, everywhere| {
        let pose = Pose { position: DVec3::new(x, 1.5, -5.0), yaw_deg: 0.0, pitch_deg: 0.0 };
        let list = draw_list_showing(
            &index,
            &pose,
            SQUARE,
            Show { portals: ShowPortals { images, everywhere }, ..Show::default() },
        );
        let portals: Vec<_> = list.portals.iter().map(|p| (p.portal, p.placement, p.second)).collect();
        (portals, list.images, list.cells)
    };
    // Three metres before the door; 1 m aside is 18 degrees, 0.6 m is 11, 0.4 m is 8.
    for (images, x, placement, second) in [
        (PortalImages::Texture, 1.0, 2, None),
        (PortalImages::Textures, 1.0, 3, None),
        (PortalImages::Textures, -1.0, 1, None),
        (PortalImages::Reference, 0.6, 3, None),
        (PortalImages::Reference, 0.4, 2, None),
        (PortalImages::TwoReferences, 0.4, 2, Some(3)),
        (PortalImages::TwoReferences, -0.6, 1, Some(2)),
        (PortalImages::Layered, 0.4, 5, None),
        (PortalImages::Offered, 0.4, 5, None),
    ] {
        let (portals, of_view, cells) = shown(images, x, true);
        assert_eq!(portals, [(1, placement, second)], "{images:?} at {x}");
        assert_eq!(of_view, [Some(placement), second].into_iter().flatten().collect::<Vec<_>>());
        assert!(cells.iter().all(|c| [2, 3].contains(&c.cell)), "the room of the eye alone: {cells:?}");
    }
    // What fits is geometry unless images are wanted everywhere; and what was not built is not
    // shown.
    assert!(shown(PortalImages::Layered, 0.4, false).0.is_empty());
    assert!(shown(PortalImages::Zones, 0.4, true).0.is_empty());
}

#[test]
fn eyes_that_are_near_or_askew_see_geometry_instead_of_references() {
    let index = with_references(1000);
    let rooms = index.rooms.as_ref().expect("it has some");
    let shows =
        |x: f64, z: f64| !rooms.shown(&index.placements, PortalImages::Layered, 1, 0, DVec3::new(x, 1.5, z)).is_empty();
    assert!(shows(0.0, -7.0) && !shows(0.0, -7.5), "0.6 m");
    assert!(shows(-2.5, -6.0) && !shows(-2.9, -7.2), "30 degrees off the plane");
    assert!(!shows(0.0, -9.0), "beyond it");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    /// On every line of sight, up to the portal whose image takes over, all cells of the rooms are
    /// drawn: those that it meets.
    #[test]
    fn a_line_of_sight_meets_drawn_cells_or_an_image(
        at in prop::array::uniform3(0.0f64..1.0),
        yaw in 0.0f64..360.0,
        served in prop::collection::btree_set(0usize..ROOMS - 1, 0..ROOMS),
        budget in 200u64..1100,
        picture in prop::array::uniform2(-1.0f64..=1.0),
    ) {
        let served: Vec<usize> = served.into_iter().collect();
        let index = index(budget, &served);
        let position = DVec3::new(at[0] * 5.6 - 2.8, 1.0 + at[1], -at[2] * 19.8 - 0.1);
        let pose = Pose { position, yaw_deg: yaw, pitch_deg: 0.0 };
        let list = draw_list(&index, &pose, SQUARE);
        prop_assert!(list.triangles <= budget);
        // What has to be geometry fits, or cells are left out.
        prop_assert_eq!(least_by_rooms(&index, &pose, SQUARE).is_some_and(|t| t > budget), list.dropped > 0);
        let drawn: u64 = list.cells.iter().map(|c| u64::from(index.cells[c.cell as usize].triangles)).sum();
        prop_assert_eq!(drawn, list.triangles);
        if list.dropped > 0 {
            return Ok(());
        }
        let b = pose.basis();
        let ray = b.forward + b.right * picture[0] + b.up * picture[1];
        // By hand: from wall to wall.
        let mut room = ((-position.z / 4.0).floor() as usize).min(ROOMS - 1);
        let mut from = 0.0;
        loop {
            let wall = if ray.z < 0.0 { -4.0 * (room + 1) as f64 } else { -4.0 * room as f64 };
            let to = if ray.z.abs() < 1e-9 { 100.0 } else { (wall - position.z) / ray.z };
            for cell in [2 * room, 2 * room + 1] {
                let b = &index.cells[cell].bounds;
                // Sampled: the slab test is what the renderer's own tests use.
                let hit = (0..=400).map(|k| position + ray * (from + (to - from) * f64::from(k) / 400.0));
                if hit.into_iter().any(|p| b.contains(p)) {
                    prop_assert!(list.cell_numbers().contains(&(cell as u32)), "cell {cell} of {list:?}");
                }
            }
            let through = position + ray * to;
            let door = if ray.z < 0.0 { room } else { room.wrapping_sub(1) };
            if through.x.abs() > 1.0 || !(0.0..=2.0).contains(&through.y) || door >= ROOMS - 1 || ray.z.abs() < 1e-9 {
                break;
            }
            if let Some(shown) = list.portals.iter().find(|p| p.portal as usize == door) {
                prop_assert_eq!(shown.side, usize::from(ray.z > 0.0));
                prop_assert!(index.placements[shown.placement as usize].users.contains(position));
                prop_assert!(shown.cones.iter().any(|c| c.contains(through)));
                break;
            }
            room = if ray.z < 0.0 { room + 1 } else { room - 1 };
            from = to;
        }
    }
}

#[test]
fn rooms_of_the_grid_are_served_by_it_where_it_was_made() {
    let mut index = with_grid(1000);
    let (first, second) = (pose(-0.5, 0.0), pose(-5.0, 0.0));
    let by = |index: &Index, pose: &Pose| draw_list(index, pose, SQUARE).selection.placement;
    assert_eq!([first, second].map(|p| by(&index, &p)), [None; 2], "all of it fits the budget");
    index.rooms.as_mut().unwrap().by_grid = vec![true; ROOMS + 1];
    assert_eq!(by(&index, &first), Some(0));
    assert_eq!(draw_list(&index, &first, SQUARE).cell_numbers(), [0, 1]);
    assert_eq!(by(&index, &second), None, "not among the placement's eyes");
    let zones = ShowPortals { images: PortalImages::Zones, ..ShowPortals::default() };
    let asked = draw_list_showing(&index, &first, SQUARE, Show { portals: zones, ..Show::default() });
    assert_eq!(asked.selection.placement, None, "who asks for portals gets them");
    index.rooms.as_mut().unwrap().by_grid[0] = false;
    assert_eq!(by(&index, &first), None);
}
