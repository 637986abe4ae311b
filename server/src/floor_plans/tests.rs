//! The stage on houses of boxes, whose sections are known.

use super::*;
use crate::placement::test_scenes::{block, scene_of};
use crate::render::Caster;
use crate::walk_volume::{WalkOptions, walk_volume};
use glam::DVec3;
use ldi_protocol::floor_plan::{CLOSED, OPEN, SOLID, WALL};
use std::sync::Arc;

type Block = ([f64; 3], [f64; 3]);

fn plans_of(blocks: &[Block], eye_height_m: Option<f64>) -> Vec<FloorPlan> {
    let scene = scene_of(&blocks.iter().map(|b| block(&box_of(b))).collect::<Vec<_>>());
    let clusters = Clusters::build(&scene);
    let octree = Octree::build(&scene, &clusters, 1000);
    let scene = Arc::new(scene);
    let caster = Caster::new(scene.clone(), &clusters, &octree);
    let options = WalkOptions { eye_height_m, ..WalkOptions::default() };
    let volume = walk_volume(&caster, &clusters, &octree, &options).expect("a volume").0;
    floor_plans(&scene, &clusters, &octree, &volume, eye_height_m)
}

fn box_of((min, max): &Block) -> Aabb {
    Aabb { min: (*min).into(), max: (*max).into() }
}

/// A house of 8 x 6 m in two rooms with a door of 0.9 m between them, a way out, a table, a column
/// and a closed shaft.
const HOUSE: [Block; 15] = [
    ([-0.3, -0.2, -0.3], [8.3, 0.0, 6.3]),
    ([-0.3, 2.8, -0.3], [8.3, 3.0, 6.3]),
    ([-0.3, 0.0, -0.3], [8.3, 2.8, 0.0]),
    ([-0.3, 0.0, 6.0], [8.3, 2.8, 6.3]),
    ([-0.3, 0.0, 0.0], [0.0, 2.8, 6.0]),
    ([8.0, 0.0, 0.0], [8.3, 2.8, 6.0]),
    // The wall between the rooms, and the lintel over its door.
    ([4.0, 0.0, 0.0], [4.1, 2.8, 2.5]),
    ([4.0, 0.0, 3.4], [4.1, 2.8, 6.0]),
    ([4.0, 2.1, 2.5], [4.1, 2.8, 3.4]),
    // A table, a column.
    ([1.0, 0.0, 1.0], [2.0, 0.8, 2.0]),
    ([2.0, 0.0, 4.0], [2.4, 2.8, 4.4]),
    // Two walls of a shaft in a corner, which is full but for a gap at the height of the section.
    ([5.0, 0.0, 3.4], [8.0, 2.8, 3.5]),
    ([5.0, 0.0, 3.5], [5.1, 2.8, 6.0]),
    ([5.1, 0.0, 3.5], [8.0, 1.0, 6.0]),
    ([5.1, 1.4, 3.5], [8.0, 2.8, 6.0]),
];

/// Cells farther than a cell's diagonal from every face of a box are compared with the boxes.
#[test]
fn the_section_of_a_house_is_that_of_its_boxes() {
    let plans = plans_of(&HOUSE, Some(1.6));
    assert_eq!(plans.len(), 1);
    let plan = &plans[0];
    assert_eq!(plan.check(), Ok(()));
    assert!(plan.floor_m.abs() < 0.06 && !plan.relief, "{} m", plan.floor_m);
    let y = plan.floor_m + SECTION_M;
    let cut: Vec<Aabb> = HOUSE.iter().map(box_of).filter(|b| b.min.y < y && y < b.max.y).collect();
    let margin = 1.5 * plan.pitch_m;
    let (mut walls, mut floors) = (0, 0);
    for (n, value) in plan.cells.iter().enumerate() {
        let (i, k) = (n as u32 % plan.size[0], n as u32 / plan.size[0]);
        let at = |n: u32, axis: usize| plan.corner[axis] + (f64::from(n) + 0.5) * plan.pitch_m;
        let p = DVec3::new(at(i, 0), y, at(k, 1));
        let inside = |by: f64| cut.iter().any(|b| b.inflated(by).contains(p));
        if inside(-margin) {
            assert!(matches!(*value, WALL | SOLID), "{value} in a wall at {p}");
            walls += 1;
        } else if !inside(margin) {
            assert!(!matches!(*value, WALL | SOLID), "{value} at {p}, where nothing is cut");
            floors += usize::from(*value >= FLOOR);
        }
    }
    let m2 = |cells: usize| cells as f64 * plan.pitch_m * plan.pitch_m;
    assert!(m2(walls) > 6.0 && m2(floors) > 33.0, "{} m2 of walls, {} m2 of floor", m2(walls), m2(floors));
    assert_eq!(plan.value_at(6.8, 5.0), CLOSED, "the shaft");
    assert!(plan.value_at(4.05, 3.0) >= FLOOR, "the open door");
    assert_eq!(plan.value_at(plan.corner[0] + 0.1, plan.corner[1] + 0.1), OPEN);
    // In the door one looks into the rooms, not at the jambs.
    let yaw_deg = plan.open_yaw_deg([4.05, 3.0]);
    assert!((yaw_deg.abs() - 90.0).abs() < 50.0, "{yaw_deg}");
}

#[test]
fn storeys_have_a_plan_each_and_flying_has_none() {
    // Two storeys of 8 x 8 m and a stair of eleven steps beside them.
    let mut blocks = vec![
        ([0.0, -0.2, 0.0], [8.0, 0.0, 8.0]),
        ([0.0, 2.8, 0.0], [8.0, 3.0, 6.0]),
        ([0.0, 6.0, 0.0], [8.0, 6.2, 8.0]),
    ];
    blocks.extend((1..12).map(|n| {
        let (x, y) = (f64::from(n) * 0.5, f64::from(n) * 0.25);
        ([x, 0.0, 6.0], [x + 0.5, y, 8.0])
    }));
    blocks.push(([6.0, 0.0, 6.0], [8.0, 3.0, 8.0]));
    let plans = plans_of(&blocks, Some(1.6));
    let floors: Vec<f64> = plans.iter().map(|p| (p.floor_m * 10.0).round() / 10.0).collect();
    assert_eq!(floors, [0.0, 3.0]);
    assert!(plans.iter().all(|p| p.size == plans[0].size && p.corner == plans[0].corner));
    // The stair belongs to the lower storey, and is higher than its floor.
    let stair = plans[0].floor_at(3.25, 7.0).expect("a step");
    assert!((1.0..2.2).contains(&stair), "{stair}");
    assert!(plans[1].value_at(2.0, 3.0) >= FLOOR && plans[1].value_at(1.0, 7.0) < FLOOR);
    assert_eq!(plans_of(&blocks, None), []);
}

/// A hillside: steps of 0.2 m, none of which holds most of the ground.
#[test]
fn open_ground_is_one_relief() {
    let blocks: Vec<Block> = (0..40)
        .map(|n| {
            let x = f64::from(n);
            ([x, -1.0, 0.0], [x + 1.0, x * 0.2, 20.0])
        })
        .chain([([20.0, 0.0, 9.0], [21.0, 9.0, 10.0])])
        .collect();
    let plans = plans_of(&blocks, Some(1.6));
    assert_eq!(plans.len(), 1);
    let plan = &plans[0];
    assert!(plan.relief);
    // Two terraces beside each other are no storeys either.
    let terraces = [([0.0, -1.0, 0.0], [20.0, 0.0, 20.0]), ([20.0, -1.0, 0.0], [40.0, 3.0, 20.0])];
    let step = ([16.0, 0.0, 0.0], [20.0, 0.4, 2.0]);
    let steps = (1..10).map(|n| ([16.0 + f64::from(n) * 0.4, 0.0, 0.0], [20.0, 0.3 * f64::from(n + 1), 2.0]));
    let plans = plans_of(&terraces.into_iter().chain([step]).chain(steps).collect::<Vec<_>>(), Some(1.6));
    assert!(plans.len() == 1 && plans[0].relief, "{} plans", plans.len());
    let height = |x: f64| plan.floor_at(x, 5.0).expect("ground");
    assert!((height(30.5) - height(10.5) - 4.0).abs() < 0.3, "{} {}", height(10.5), height(30.5));
    assert!(matches!(plan.value_at(20.0, 9.5), WALL | SOLID), "the tower's face");
}
