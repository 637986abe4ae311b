//! A row of cells along +X with shared textures and bundles, and two grid points with LDIs.

use super::*;
use crate::{
    Aabb, CellRuns, OutputCamera, ViewBasis,
    index::*,
    mesh::{Alpha, Material, Wrap},
};
use proptest::prelude::*;

const CELLS: usize = 4;

/// Chunks 0..4 cells, 4 bundle, 5 and 6 the levels of texture 0, 7 and 8 the layers of LDI 0, 9
/// the one layer of LDI 1.
fn row_of_cells() -> Index {
    let chunk = |i: usize, kind| ChunkEntry {
        hash: ChunkHash([i as u8; 32]),
        stored_bytes: 50,
        decoded_bytes: 100 + i as u32,
        kind,
    };
    let kinds = [
        ChunkKind::Cell,
        ChunkKind::Cell,
        ChunkKind::Cell,
        ChunkKind::Cell,
        ChunkKind::Bundle,
        ChunkKind::Texture,
        ChunkKind::Texture,
        ChunkKind::Ldi,
        ChunkKind::Ldi,
        ChunkKind::Ldi,
    ];
    let bounds = |i: usize| Aabb {
        min: DVec3::new(10.0 * i as f64, 0.0, 0.0),
        max: DVec3::new(10.0 * i as f64 + 1.0, 1.0, 1.0),
    };
    let camera = OutputCamera { width: 64, height: 48, fov_deg: 60.0 };
    let placement = |x: f64, images| Placement {
        grid_point: Some(0),
        cop: DVec3::ZERO,
        culled: CellRuns::default(),
        footprint_px: 1.0,
        users: Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x, 0.0, 0.0) },
        images,
        sky: Default::default(),
    };
    let image = |chunks| ImageEntry {
        basis: ViewBasis::from_yaw_pitch(0.0, 0.0),
        plane_distance: 1.0,
        window: [-1.0, 1.0, -1.0, 1.0],
        stretch_p99_px: f64::NAN,
        chunks,
        samples_by_layer: vec![],
    };
    let point = |x: f64| GridPoint { position: DVec3::new(x, 0.0, 0.0), level: 0, radius: 1.0, bands: vec![] };
    Index {
        scene: SceneInfo {
            name: "row".into(),
            triangles: 4,
            unique_triangles: 4,
            instances: 4,
            bounds: bounds(0).union(bounds(3)),
        },
        settings: BuildSettings {
            budget: 100,
            optimize_budget: 90,
            camera,
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "high".into(),
            grid: "paper".into(),
            eye_height_m: None,
        },
        chunks: kinds.iter().enumerate().map(|(i, k)| chunk(i, *k)).collect(),
        cells: (0..CELLS)
            .map(|i| CellEntry {
                bounds: bounds(i),
                triangles: 1,
                chunk: i as u32,
                bundles: if i >= 2 { vec![4] } else { vec![] },
                materials: vec![(i % 2) as u32],
                texel_density: vec![EVERY_LEVEL],
                levels: Vec::new(),
            })
            .collect(),
        materials: (0..2)
            .map(|i| Material {
                base_colour: [1.0; 4],
                texture: (i == 1).then_some(0),
                alpha: Alpha::Opaque,
                unlit: false,
                double_sided: false,
                wrap: [Wrap::Repeat; 2],
            })
            .collect(),
        textures: vec![TextureEntry {
            width: 4,
            height: 4,
            chunks: vec![
                TextureChunk { chunk: 5, first_level: 1, last_level: 2 },
                TextureChunk { chunk: 6, first_level: 0, last_level: 0 },
            ],
        }],
        pitch_bands_deg: vec![-90.0, 90.0],
        volume: None,
        tree: None,
        rooms: None,
        plans: Vec::new(),
        points: vec![point(5.0), point(25.0)],
        placements: vec![placement(5.0, 0..1), placement(25.0, 1..2)],
        images: vec![image(vec![7, 8]), image(vec![9])],
    }
}

#[test]
fn a_view_takes_the_first_layer_then_cells_near_to_far_then_what_sharpens() {
    let n = needed(&row_of_cells(), &[0], &DrawnCell::all_full([0, 1, 2, 3]), &[], &anywhere());
    assert_eq!(n.now, [7, 0, 1, 5, 2, 4, 3]);
    assert_eq!(n.fine, [8, 6]);
    // The order of the cells is the caller's, and what nobody refers to stays away.
    let n = needed(&row_of_cells(), &[], &DrawnCell::all_full([2, 0]), &[], &anywhere());
    assert_eq!(n.now, [2, 4, 0]);
    assert!(n.fine.is_empty());
}

/// The cell's near face is 10 m ahead, a pixel there 0.18 m wide.
#[test]
fn levels_finer_than_a_pixel_shows_are_left_out() {
    let mut index = row_of_cells();
    let along_x = Pose { position: DVec3::new(0.0, 0.5, 0.5), yaw_deg: -90.0, pitch_deg: 0.0 };
    let camera = OutputCamera { width: 64, height: 48, fov_deg: 60.0 };
    let fine = |index: &Index, pose: &Pose, supersample| {
        needed(index, &[], &DrawnCell::all_full([1]), &[], &Sight::new(pose, &camera, supersample)).fine
    };
    // Level 0 is the last to be needed where a pixel is less than two texels wide; steps from
    // pixel to pixel may be 0.81 times as long at the corners.
    let (few, many) = (0.9 * 2.0 / 0.18, 1.1 * 2.0 / (0.18 * 0.81));
    for (texels_per_m, expected) in [(few, &[6u32][..]), (many, &[])] {
        index.cells[1].texel_density = vec![(4.0 * f64::log2(texels_per_m)).round() as i8];
        assert_eq!(fine(&index, &along_x, 1), expected, "{texels_per_m} texels per metre");
        let inside = Pose { position: DVec3::new(10.5, 0.5, 0.5), ..along_x };
        assert_eq!(fine(&index, &inside, 1), [6], "what is at hand shows all");
    }
    assert_eq!(fine(&index, &along_x, 2), [6], "with four samples per pixel");
    index.cells[1].texel_density = vec![EVERY_LEVEL];
    assert_eq!(fine(&index, &along_x, 1), [6]);
}

#[test]
fn numbers_beyond_the_index_are_left_out() {
    let n = needed(&row_of_cells(), &[99], &DrawnCell::all_full([77, 1]), &[], &anywhere());
    assert_eq!(n.now, [1, 5]);
    assert_eq!(n.fine, [6]);
}

#[test]
fn around_the_eye_near_comes_before_far_and_coarse_before_fine() {
    let index = row_of_cells();
    let everything = Reach { radius_m: 1e9, decoded_bytes: u64::MAX };
    let list = near_to_far(&index, DVec3::new(0.5, 0.5, 0.5), everything);
    // Distances: cell 0 at 0; users of placement 0 at 4.6; cell 1 at 9.5, sharper at 15.2; cell 2
    // at 19.5; of placement 1 at 24.5; cell 3 at 29.5.
    assert_eq!(list, [0, 7, 8, 1, 5, 6, 2, 4, 9, 3]);
    let near = near_to_far(&index, DVec3::new(0.5, 0.5, 0.5), Reach { radius_m: 5.0, ..everything });
    assert_eq!(near, [0, 7]);
}

fn anywhere() -> Sight {
    Sight::new(
        &Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 },
        &OutputCamera { width: 64, height: 48, fov_deg: 60.0 },
        1,
    )
}

proptest! {
    #[test]
    fn a_smaller_reach_gives_a_prefix(x in -50.0f64..80.0, bytes in 0u64..1500, radius in 0.0f64..60.0) {
        let index = row_of_cells();
        let eye = DVec3::new(x, 0.0, 0.0);
        let all = near_to_far(&index, eye, Reach { radius_m: radius, decoded_bytes: u64::MAX });
        let some = near_to_far(&index, eye, Reach { radius_m: radius, decoded_bytes: bytes });
        prop_assert!(all.starts_with(&some));
        let size = |l: &[u32]| l.iter().map(|c| u64::from(index.chunks[*c as usize].decoded_bytes)).sum::<u64>();
        prop_assert!(size(&some) <= bytes);
        if some.len() < all.len() {
            prop_assert!(size(&all[..some.len() + 1]) > bytes);
        }
        let mut unique = all.clone();
        unique.sort_unstable();
        unique.dedup();
        prop_assert_eq!(unique.len(), all.len());
    }
}

#[test]
fn what_a_cache_cannot_hold_is_left_out_least_important_first() {
    let index = row_of_cells();
    let whole = needed(&index, &[0], &DrawnCell::all_full([0, 1, 2, 3]), &[], &anywhere());
    let bytes = |n: &Needed| n.all().map(|c| u64::from(index.chunks[c as usize].decoded_bytes)).sum::<u64>();
    assert_eq!(whole.clone().within(&index, u64::MAX), whole);
    let mut last = whole.clone();
    for cap in (0..2000).rev().step_by(20) {
        let some = whole.clone().within(&index, cap);
        assert!(bytes(&some) as f64 <= cap as f64 * VIEW_SHARE, "{cap}: {some:?}");
        assert!(some.all().all(|c| last.all().any(|l| l == c)), "less fits into less: {some:?} of {last:?}");
        // Nothing that only sharpens while something is missing, and no image while a cell is.
        assert!(some.fine.is_empty() || some.now == whole.now);
        let images = some.now.iter().any(|c| index.chunks[*c as usize].kind == ChunkKind::Ldi);
        let of_cells = |n: &Needed| n.now.iter().filter(|c| index.chunks[**c as usize].kind != ChunkKind::Ldi).count();
        assert!(!images || of_cells(&some) == of_cells(&whole));
        last = some;
    }
    assert_eq!(last.all().count(), 0);
}
