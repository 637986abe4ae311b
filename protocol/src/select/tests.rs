//! The choice of cells and images on small datasets.

use super::*;
use crate::{
    OutputCamera, ViewBasis,
    index::{BuildSettings, CellEntry, CellLevel, GridPoint, ImageEntry, SceneInfo},
};

/// Ten cells of 100 triangles along -Z, one per metre from 2 m on; a grid point at the origin
/// and one behind it; a placement that replaces the last five when looking along -Z.
fn index(grid: &str, budget: u64) -> Index {
    let cell = |i: u32| CellEntry {
        bounds: Aabb::from_points([
            DVec3::new(-0.2, -0.2, -2.4 - f64::from(i)),
            DVec3::new(0.2, 0.2, -2.0 - f64::from(i)),
        ]),
        triangles: 100,
        chunk: 0,
        bundles: vec![],
        materials: vec![],
        texel_density: vec![],
        levels: Vec::new(),
    };
    let point = |z: f64, placement| GridPoint {
        position: DVec3::new(0.0, 0.0, z),
        level: 0,
        radius: 9.0,
        bands: vec![vec![
            AngularRange { yaw_start_deg: 10.0, placement: None },
            AngularRange { yaw_start_deg: 350.0, placement },
        ]],
    };
    Index {
        scene: SceneInfo {
            name: String::new(),
            triangles: 1000,
            unique_triangles: 1000,
            instances: 10,
            bounds: Aabb::EMPTY,
        },
        settings: BuildSettings {
            budget,
            optimize_budget: budget,
            camera: OutputCamera { width: 64, height: 36, fov_deg: 60.0 },
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 30.0,
            density: 1.0,
            colour: "high".into(),
            grid: grid.into(),
            eye_height_m: None,
        },
        chunks: vec![],
        cells: (0..10).map(cell).collect(),
        materials: vec![],
        textures: vec![],
        pitch_bands_deg: vec![-30.0, 30.0],
        volume: None,
        tree: None,
        rooms: None,
        plans: Vec::new(),
        points: vec![point(3.0, None), point(0.0, Some(0)), point(-0.9, None)],
        placements: vec![Placement {
            grid_point: Some(1),
            cop: DVec3::ZERO,
            culled: (5..10).collect(),
            footprint_px: 1.5,
            users: Aabb { min: DVec3::splat(-8.0), max: DVec3::splat(8.0) },
            images: 0..3,
            sky: Default::default(),
        }],
        images: [0.0, 90.0, 40.0].map(image).to_vec(),
    }
}

/// 20 degrees to either side of a yaw.
fn image(yaw_deg: f64) -> ImageEntry {
    ImageEntry {
        basis: ViewBasis::from_yaw_pitch(yaw_deg, 0.0),
        plane_distance: 6.9,
        window: [-0.36, 0.36, -0.36, 0.36],
        stretch_p99_px: f64::NAN,
        chunks: vec![0],
        samples_by_layer: vec![1],
    }
}

#[test]
fn images_in_view_come_with_the_line_of_sight_first() {
    let mut index = index("paper", 1000);
    assert_eq!(
        draw_list(&index, &pose(-0.5, 0.0), (0.577, 0.32)).images,
        [0, 2],
        "45 to 15 degrees left, half in view"
    );
    assert_eq!(draw_list(&index, &pose(-0.5, 0.0), (0.1, 0.1)).images, [0], "a narrow picture");
    // From six metres to the left the cone of the image ahead lies to the right of a gaze to
    // the left; the third one, hit at its corner and left at 70 degrees, crosses it.
    let aside = Pose { position: DVec3::new(-6.0, 0.0, -0.5), yaw_deg: 45.0, pitch_deg: 0.0 };
    index.settings.grid = CELLS.into();
    index.points[1].position = aside.position;
    index.points[1].bands[0] = vec![AngularRange { yaw_start_deg: 0.0, placement: Some(0) }];
    assert_eq!(draw_list(&index, &aside, (0.1, 0.1)).images, [2, 1]);
    index.images[2].chunks.clear();
    assert_eq!(draw_list(&index, &aside, (0.1, 0.1)).images, [1], "nothing in it");
}

fn pose(z: f64, yaw_deg: f64) -> Pose {
    Pose { position: DVec3::new(0.0, 0.0, z), yaw_deg, pitch_deg: 0.0 }
}

#[test]
fn the_paper_takes_the_closest_point_behind_and_cells_the_closest_of_all() {
    let eye = pose(-0.5, 0.0);
    assert_eq!(select(&index("paper", 1000), &eye), Selection { grid_point: Some(1), placement: Some(0) });
    assert_eq!(select(&index(CELLS, 1000), &eye), Selection { grid_point: Some(2), placement: None });
    assert_eq!(
        select(&index("paper", 1000), &pose(-0.5, 180.0)).grid_point,
        Some(2),
        "turned round, the other one is behind"
    );
}

#[test]
fn nobody_is_shown_images_that_were_made_for_others() {
    let mut index = index("paper", 340);
    let planned = |index: &Index, z: f64| {
        let eye = pose(z, 0.0);
        (draw_list(index, &eye, (0.577, 0.32)).images.len(), is_planned(index, &eye))
    };
    assert_eq!(planned(&index, -0.5), (2, true));
    index.placements[0].users = Aabb { min: DVec3::splat(-0.4), max: DVec3::splat(0.4) };
    assert_eq!(planned(&index, -0.5), (0, false), "beyond the users");
    let list = draw_list(&index, &pose(-0.5, 0.0), (0.577, 0.32));
    assert_eq!(
        (list.cell_numbers().as_slice(), list.triangles),
        (&[0, 1, 2][..], 300),
        "the nearest cells within the budget"
    );
    assert_eq!(planned(&index, -0.3), (2, true));
    // Nothing was made of it in time.
    index.placements[0].images = 0..0;
    assert_eq!(planned(&index, -0.3), (0, false));
    assert_eq!(draw_list(&index, &pose(-0.3, 0.0), (0.577, 0.32)).cell_numbers(), [0, 1, 2]);
}

#[test]
fn placements_change_between_the_directions_named_and_nowhere_else() {
    let index = index("paper", 1000);
    let yaws = yaws_of_placements(&index, &pose(-0.5, 0.0));
    let (before, after): (Vec<f64>, Vec<f64>) = yaws.chunks(2).map(|y| (y[0], y[1])).unzip();
    assert_eq!(yaws.len(), 4);
    let changes =
        |from: f64, to: f64| placement_of(&index, 1, &pose(0.0, from)) != placement_of(&index, 1, &pose(0.0, to));
    assert!(before.iter().zip(&after).all(|(b, a)| changes(*b, *a) && a - b < 0.01), "{yaws:?}");
    assert!(!changes(after[0], before[1]) && !changes(after[1], before[0]), "{yaws:?}");
    // Outside of the built range of pitch nothing is replaced.
    assert!(yaws_of_placements(&index, &Pose { pitch_deg: 40.0, ..pose(-0.5, 0.0) }).is_empty());
    assert!(yaws_of_placements(&Index { points: vec![], ..index }, &pose(-0.5, 0.0)).is_empty());
}

#[test]
fn what_the_placement_replaces_is_not_drawn() {
    let list = draw_list(&index("paper", 1000), &pose(-0.5, 0.0), (0.577, 0.32));
    assert_eq!((list.cell_numbers().as_slice(), list.triangles, list.dropped), (&[0, 1, 2, 3, 4][..], 500, 0));
    let beside = draw_list(&index("paper", 1000), &pose(-0.5, 20.0), (0.577, 0.32));
    assert_eq!(beside.selection.placement, None, "another angular range");
    assert_eq!(beside.cells.len(), 10);
}

#[test]
fn groups_of_cells_change_nothing_but_the_time() {
    let mut index = index("paper", 20_000);
    let mut state = 9u64;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / f64::from(1u32 << 24)
    };
    // Rows of neighbours, some without thickness; neither whole groups nor whole blocks.
    let first = index.cells[0].clone();
    index.cells = (0..1003)
        .map(|i| {
            let at = DVec3::new(f64::from(i % 32), unit(), f64::from(i / 32)) * 1.5 - DVec3::new(24.0, 1.0, 24.0);
            let size = DVec3::new(unit(), if i % 5 == 0 { 0.0 } else { unit() }, unit());
            CellEntry { bounds: Aabb { min: at, max: at + size * 2.0 }, ..first.clone() }
        })
        .collect();
    let groups = CellGroups::of(&index.cells);
    let (mut seen, mut dropped) = (0, 0);
    for _ in 0..500 {
        let position = DVec3::new(unit() - 0.5, unit() * 0.2, unit() - 0.5) * 40.0;
        let pose = Pose { position, yaw_deg: unit() * 360.0, pitch_deg: (unit() - 0.5) * 60.0 };
        let plain = draw_list(&index, &pose, (0.5, 0.3));
        assert_eq!(plain, draw_list_of(&index, &groups, &pose, (0.5, 0.3), Show::default()), "{pose:?}");
        seen += plain.cells.len();
        dropped += plain.dropped;
    }
    assert!(seen > 20_000 && seen < 400_000 && dropped > 100, "{seen} cells seen, {dropped} dropped");
    for cell in &mut index.cells {
        cell.triangles = 20 + (unit() * unit() * 900.0) as u32;
    }
    for _ in 0..300 {
        let position = DVec3::new(unit() - 0.5, unit() * 0.2, unit() - 0.5) * 40.0;
        let pose = Pose { position, yaw_deg: unit() * 360.0, pitch_deg: (unit() - 0.5) * 60.0 };
        let [few, more] = [1.0, 1.3].map(|share| cells_before_tree(&index, &groups, &pose, (0.5, 0.3), share));
        assert!(few.iter().all(|c| more.contains(c)), "{few:?} within {more:?}");
    }
}

/// Far cells are drawn at the coarsest level that deviates by half a pixel at most, and count as
/// such; where all is geometry in full they are not.
#[test]
fn cells_are_as_coarse_as_their_distance_allows() {
    let mut index = index("paper", 1000);
    // Half a pixel of 64 over 60 degrees: 1 : 160 with the picture's corners.
    let per_metre = index.settings.deviation_per_metre();
    let at_corner = index.settings.camera.displacement_px(per_metre * 7.0, 7.0);
    assert!((at_corner - 0.5).abs() < 1e-12 && (1.0 / per_metre - 159.5).abs() < 1.0, "{}", 1.0 / per_metre);
    let level = |distance_m: f64, triangles| CellLevel {
        deviation_m: distance_m * per_metre,
        triangles,
        chunk: 0,
        instances: 0..1,
        bundles: vec![],
    };
    for cell in &mut index.cells {
        cell.levels = vec![level(2.9, 40), level(2.95, 30), level(5.0, 10)];
    }
    // Bounds begin at 1.5, 2.5, 3.5 m and so on before the eye.
    let list = draw_list(&index, &pose(-0.5, 20.0), (0.577, 0.32));
    let levels: Vec<u8> = list.cells.iter().map(|c| c.level).collect();
    assert_eq!((levels, list.triangles), (vec![0, 0, 2, 2, 3, 3, 3, 3, 3, 3], 200 + 60 + 60));
    assert!(list.cells.iter().all(|c| level_at(&index, c.cell, pose(-0.5, 0.0).position) == c.level));
    let show = |far| draw_list_showing(&index, &pose(-0.5, 20.0), (0.577, 0.32), Show { far, ..Show::default() });
    assert_eq!((show(FarBy::Levels).triangles, show(FarBy::Geometry).triangles), (320, 1000));
    // The budget goes farther.
    index.settings.budget = 320;
    assert_eq!(draw_list(&index, &pose(-0.5, 20.0), (0.577, 0.32)).dropped, 0);
    index.settings.max_deviation_px = 0.0;
    assert_eq!(draw_list(&index, &pose(-0.5, 20.0), (0.577, 0.32)).cell_numbers(), [0, 1]);
}

#[test]
fn beyond_the_budget_the_farthest_cells_go() {
    let list = draw_list(&index("paper", 250), &pose(-0.5, 0.0), (0.577, 0.32));
    assert_eq!((list.cell_numbers().as_slice(), list.triangles, list.dropped), (&[0, 1][..], 200, 3));
    assert_eq!(list.complete_m, 0.0, "images show some of it");
    // Cell 2 is the nearest that goes.
    let beside = draw_list(&index("paper", 250), &pose(-0.5, 20.0), (0.577, 0.32));
    assert_eq!((beside.dropped, beside.selection.placement), (8, None));
    assert!((beside.complete_m - 3.5).abs() < 0.1, "{} m", beside.complete_m);
    let whole = draw_list(&index("paper", 1000), &pose(-0.5, 20.0), (0.577, 0.32));
    assert_eq!((whole.dropped, whole.complete_m), (0, f64::INFINITY));
}

/// Images are made for pictures of the planned shape: what a larger one shows beside that is drawn,
/// as far as the budget goes.
#[test]
fn larger_pictures_than_planned_draw_what_their_images_may_lack() {
    let mut index = index("paper", 1200);
    // Above the planned picture, across its upper border, and in it.
    for (low, high) in [(4.0, 4.4), (2.0, 2.9), (0.5, 0.9)] {
        let bounds = Aabb { min: DVec3::new(-0.2, low, -7.4), max: DVec3::new(0.2, high, -7.0) };
        index.cells.push(CellEntry { bounds, ..index.cells[0].clone() });
    }
    index.placements[0].culled = (5..13).collect();
    let eye = pose(-0.5, 0.0);
    let drawn = |index: &Index, tan_y: f64| {
        let list = draw_list(index, &eye, (0.577, tan_y));
        assert_eq!((list.selection.placement, list.dropped), (Some(0), 0));
        assert!(list.cells.windows(2).all(|w| index.cells[w[0].cell as usize].bounds.distance(eye.position)
            <= index.cells[w[1].cell as usize].bounds.distance(eye.position)));
        let mut cells = list.cell_numbers();
        cells.sort_unstable();
        // Guesses of what a view may need look at as much.
        let groups = CellGroups::of(&index.cells);
        let all = groups.some(index.cells.len(), |_| true);
        let images = vec![false; index.images.len()];
        let (guessed, _) = draws_among(index, &groups, (&all, &images), &eye, (0.577, tan_y), FarBy::Offered);
        assert!(cells.iter().all(|c| guessed.iter().any(|g| g.cell == *c)));
        (cells, list.triangles)
    };
    let near = vec![0, 1, 2, 3, 4];
    assert_eq!(drawn(&index, 0.32), (near.clone(), 500), "as planned");
    assert_eq!(drawn(&index, 0.33), (near.clone(), 500), "hardly larger");
    assert_eq!(drawn(&index, 0.8), ([near.clone(), vec![10, 11]].concat(), 700));
    index.settings.budget = 600;
    assert_eq!(drawn(&index, 0.8), ([near.clone(), vec![11]].concat(), 600), "the nearest of them");
    index.settings.budget = 500;
    assert_eq!(drawn(&index, 0.8), (near, 500), "never instead of others");
}

#[test]
fn wide_cells_in_the_background_stay_within_the_budget() {
    let mut index = index("paper", 550);
    // A hill behind all others.
    let hill = Aabb { min: DVec3::new(-50.0, -10.0, -200.0), max: DVec3::new(50.0, 40.0, -150.0) };
    index.cells.push(CellEntry { bounds: hill, triangles: 50, ..index.cells[0].clone() });
    let list = draw_list(&index, &pose(-0.5, 20.0), (0.577, 0.32));
    assert_eq!((list.cell_numbers().as_slice(), list.triangles, list.dropped), (&[0, 1, 2, 3, 10][..], 450, 6));
    assert!((list.complete_m - 5.5).abs() < 0.1, "{} m", list.complete_m);
}

#[test]
fn the_nearest_cells_end_where_the_budget_does() {
    let of = |budget| {
        let index = index("paper", budget);
        nearest_cells(&index.cells, &index.settings, &pose(-0.5, 0.0), (0.577, 0.32))
    };
    assert_eq!(of(250), Nearest { cells: vec![0, 1], triangles: 200, dropped: 8 });
    assert_eq!(of(1000), Nearest { cells: (0..10).collect(), triangles: 1000, dropped: 0 });
    assert_eq!(of(99), Nearest { cells: vec![], triangles: 0, dropped: 10 });
}

#[test]
fn a_larger_share_of_the_budget_goes_on_farther() {
    let index = index("paper", 260);
    let of = |share| cells_before_tree(&index, &CellGroups::of(&index.cells), &pose(-0.5, 0.0), (0.577, 0.32), share);
    assert_eq!(of(1.0), draw_list(&index, &pose(-0.5, 0.0), (0.577, 0.32)).cells);
    assert_eq!([1.0, 1.3].map(of), [DrawnCell::all_full(0..2), DrawnCell::all_full(0..3)]);
}

#[test]
fn bands_end_where_the_build_ends() {
    let borders = [-30.0, 0.0, 30.0];
    assert_eq!([-30.0, -0.1, 0.0, 30.0].map(|p| band_of(&borders, p)), [Some(0), Some(0), Some(1), Some(1)]);
    assert_eq!([-30.1, 30.1].map(|p| band_of(&borders, p)), [None, None]);
    assert_eq!(band_of(&[], 0.0), None);
}
