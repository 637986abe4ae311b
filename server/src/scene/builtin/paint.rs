//! Procedural textures, 256 x 256, tiling: enough structure that a shift of half a texel shows.

use super::random::Random;
use crate::scene::SceneTexture;

/// What is painted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pattern {
    /// Rows of bricks with mortar.
    Brick,
    /// Boards with grain.
    Wood,
    /// Square tiles with joints.
    Tile,
    /// Fine noise.
    Plaster,
    /// Coarse noise and stains.
    Concrete,
    /// Brushed metal with bands.
    Metal,
    /// Woven squares.
    Cloth,
    /// Grass.
    Grass,
    /// Rounded stones with joints.
    Cobble,
    /// Leaves with holes between (alpha).
    Leaf,
}

const SIDE: u32 = 256;

/// Paints a pattern.
pub fn texture(pattern: Pattern, name: String) -> SceneTexture {
    let noise = Noise::new(pattern as u64 + 1);
    let mut rgba = Vec::with_capacity((SIDE * SIDE) as usize);
    for y in 0..SIDE {
        for x in 0..SIDE {
            rgba.push(texel(pattern, x, y, &noise));
        }
    }
    SceneTexture { name, width: SIDE, height: SIDE, rgba, file: Vec::new() }
}

fn texel(pattern: Pattern, x: u32, y: u32, noise: &Noise) -> [u8; 4] {
    let fine = noise.at(x, y, 4);
    let middle = noise.at(x, y, 16);
    let coarse = noise.at(x, y, 64);
    let mut alpha = 255;
    let rgb: [f64; 3] = match pattern {
        Pattern::Brick => {
            let row = y / 32;
            let bx = (x + if row.is_multiple_of(2) { 0 } else { 32 }) % SIDE;
            if y % 32 < 3 || bx % 64 < 3 {
                [0.72 + 0.1 * fine, 0.70 + 0.1 * fine, 0.66 + 0.1 * fine]
            } else {
                let tone = 0.75 + 0.25 * noise.at((bx / 64) * 64, row * 32, 1) - 0.25 * fine;
                [0.78 * tone, 0.38 * tone, 0.28 * tone]
            }
        }
        Pattern::Wood => {
            let board = y / 64;
            let grain = noise.at(x / 8, y, 2) * 0.5 + noise.at(x / 4, y, 8) * 0.3;
            let tone = if y % 64 < 2 { 0.45 } else { 0.72 + 0.2 * noise.at(board * 40, 7, 1) - 0.3 * grain };
            [0.86 * tone, 0.62 * tone, 0.40 * tone]
        }
        Pattern::Tile => {
            if x % 64 < 2 || y % 64 < 2 {
                [0.55; 3]
            } else {
                let tone = 0.86 + 0.12 * noise.at((x / 64) * 17, (y / 64) * 29, 1) - 0.06 * middle;
                [tone, 0.97 * tone, 0.92 * tone]
            }
        }
        Pattern::Plaster => [0.88 + 0.08 * fine - 0.05 * coarse; 3],
        Pattern::Concrete => [0.62 + 0.14 * fine - 0.16 * coarse - 0.08 * middle; 3],
        Pattern::Metal => {
            let tone = 0.72 + 0.10 * noise.at(x, y / 32, 2) - if y % 128 < 6 { 0.25 } else { 0.0 };
            [tone, tone, 1.03 * tone]
        }
        Pattern::Cloth => {
            let weave = if (x / 4 + y / 4).is_multiple_of(2) { 0.9 } else { 0.7 };
            [weave - 0.1 * coarse; 3]
        }
        Pattern::Grass => {
            let tone = 0.45 + 0.4 * fine + 0.15 * coarse;
            [0.62 * tone, 0.95 * tone, 0.40 * tone]
        }
        Pattern::Cobble => {
            let row = y / 32;
            let sx = (x + 16 * (row % 2)) % SIDE;
            let (u, v) = (f64::from(sx % 32) / 16.0 - 1.0, f64::from(y % 32) / 16.0 - 1.0);
            let edge = u.powi(4) + v.powi(4);
            let tone = 0.7 + 0.3 * noise.at((sx / 32) * 32, row * 32, 1) - 0.2 * fine;
            [tone * (0.72 - 0.3 * edge.min(1.3)); 3]
        }
        Pattern::Leaf => {
            // Four leaves per tile, each an ellipse with a midrib.
            let (u, v) = (f64::from(x % 128) / 64.0 - 1.0, f64::from(y % 128) / 64.0 - 1.0);
            let inside = u * u * 2.6 + v * v <= 0.9;
            alpha = if inside { 255 } else { 0 };
            let tone = if u.abs() < 0.05 { 0.9 } else { 0.55 + 0.3 * fine };
            [0.45 * tone, 0.85 * tone, 0.32 * tone]
        }
    };
    let byte = |v: f64| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    [byte(rgb[0]), byte(rgb[1]), byte(rgb[2]), alpha]
}

/// Tiling value noise.
struct Noise(Vec<f64>);

impl Noise {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed, 99);
        Self((0..SIDE * SIDE).map(|_| random.within(0.0, 1.0)).collect())
    }
    fn lattice(&self, x: u32, y: u32) -> f64 {
        self.0[((y % SIDE) * SIDE + x % SIDE) as usize]
    }
    /// Bilinear noise with a lattice of `cell` texels; in [0, 1].
    fn at(&self, x: u32, y: u32, cell: u32) -> f64 {
        let wrap = |i: u32| (i % (SIDE / cell)) * cell;
        let (i, j) = (x / cell, y / cell);
        let (fx, fy) = (f64::from(x % cell) / f64::from(cell), f64::from(y % cell) / f64::from(cell));
        let row = |j: u32| self.lattice(wrap(i), wrap(j)) * (1.0 - fx) + self.lattice(wrap(i + 1), wrap(j)) * fx;
        row(j) * (1.0 - fy) + row(j + 1) * fy
    }
}
