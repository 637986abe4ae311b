//! `town`: an old town on a plain among wooded hills, with a market, a church and a castle. The
//! walk goes down an avenue on a hill, from where one sees all of it; the streets can be walked,
//! too.
//!
//! Houses, lamps, stalls and trees are instances; what makes them heavy (roof tiles, shutters,
//! railings, leaves) is modelled, not painted.

mod houses;
mod land;
mod market;

use super::Builtin;
use super::draw::Draft;
use super::paint::Pattern;
use super::random::Random;
use glam::{DAffine3, DQuat, DVec3};

/// Distance between the centres of neighbouring blocks, metres.
const PITCH: f64 = 52.0;
/// Edge of a block of houses, metres; the rest of the pitch is a street.
const BLOCK: f64 = 40.0;
/// Height of a kerb, metres.
const KERB: f64 = 0.12;

/// Materials that several parts of the town share.
struct Paints {
    stone: u32,
    slate: u32,
    wood: u32,
    iron: u32,
    glass: u32,
    cobble: u32,
    grass: u32,
}

/// Builds the town: the target sets its size, the detail its tessellation.
pub fn build(detail: u32, target: u64, seed: u64) -> Builtin {
    let mut draft = Draft::default();
    let mut random = Random::new(seed, 6);
    let paints = Paints {
        stone: draft.paint(Pattern::Concrete, [0.95, 0.9, 0.8]),
        slate: draft.paint(Pattern::Tile, [0.3, 0.33, 0.38]),
        wood: draft.paint(Pattern::Wood, [0.55, 0.42, 0.32]),
        iron: draft.paint(Pattern::Metal, [0.12, 0.14, 0.15]),
        glass: draft.paint(Pattern::Plaster, [0.07, 0.1, 0.13]),
        cobble: draft.paint(Pattern::Cobble, [0.8, 0.76, 0.7]),
        grass: draft.paint(Pattern::Grass, [0.8, 0.6, 0.6]),
    };
    // An odd number, so that a block lies in the middle: the market.
    let half = ((target as f64 / 24e6).sqrt() * 3.5).floor().clamp(1.0, 6.0) as i32;
    let edge = PITCH * (f64::from(half) + 0.5) + 12.0;
    land::build(&mut draft, &mut random, &paints, detail, edge);
    let houses: Vec<u32> = (0..12).map(|_| houses::house(&mut draft, &mut random, &paints, detail)).collect();
    let furniture = market::furniture(&mut draft, &paints, detail);
    let trees: Vec<u32> = (0..3).map(|_| land::tree(&mut draft, &mut random, detail)).collect();
    let pavement = houses::pavement(&mut draft, &paints);
    for i in -half..=half {
        for k in -half..=half {
            let centre = DVec3::new(f64::from(i), 0.0, f64::from(k)) * PITCH;
            if (i, k) == (0, 0) {
                market::build(&mut draft, &mut random, &paints, &furniture, &trees, detail);
                continue;
            }
            draft.place(pavement, centre, 0.0, 1.0);
            block(&mut draft, &mut random, &houses, centre);
            for _ in 0..3 {
                let at = DVec3::new(random.within(-6.0, 6.0), KERB, random.within(-6.0, 6.0));
                let scale = random.within(0.7, 1.1);
                draft.place(trees[random.below(3)], centre + at, random.within(0.0, 360.0), scale);
            }
            market::street(&mut draft, &mut random, &furniture, &trees, centre);
        }
    }
    let waypoints = land::avenue(&mut draft, &paints, &furniture, &trees, detail, edge);
    Builtin { scene: draft.scene, waypoints }
}

/// Twelve houses around a court: four on two sides, two between them on the other two.
fn block(draft: &mut Draft, random: &mut Random, houses: &[u32], centre: DVec3) {
    let front = BLOCK * 0.5;
    for (turn, places) in [
        (0.0, &[-15.0, -5.0, 5.0, 15.0][..]),
        (180.0, &[-15.0, -5.0, 5.0, 15.0]),
        (90.0, &[-5.0, 5.0]),
        (270.0, &[-5.0, 5.0]),
    ] {
        for along in places {
            let yaw = DQuat::from_rotation_y(f64::to_radians(turn));
            let at = centre + yaw * DVec3::new(*along, 0.0, front) + DVec3::Y * KERB;
            let height = random.within(0.94, 1.06);
            let map = DAffine3::from_scale_rotation_translation(DVec3::new(1.0, height, 1.0), yaw, at);
            draft.place_by(houses[random.below(houses.len())], map);
        }
    }
}
