//! Stamps: every sample paints a fixed set of pixels, with its own colour and disparity.
//!
//! In: a transformed tile. Out: pixels, as 64-bit maxima like the quads'. The cheap reconstructions of image-based
//! rendering since McMillan: one pixel, 2 x 2, 3 x 3, the five-pixel cross, and the axis-aligned square as large as
//! the sample's footprint. Even-sized stamps centre on the sample to half a pixel.

use super::{
    Stamp,
    lanes::{LANES, Lanes},
    prepared::{Part, TILE_COLUMNS, TILE_ROWS, Tile},
    quads::Target,
    transform::{LANE_NUMBERS, Scratch},
};

/// Largest side of a footprint stamp, pixels. The image guarantee keeps footprints at about 2, or 4 supersampled; beyond
/// 8 a stamp would smear one sample over what other samples know better.
pub const LARGEST_FOOTPRINT_STAMP: f32 = 8.0;

/// Stamps all samples of a tile that are its own.
#[inline(always)]
pub fn stamp_tile<L: Lanes>(target: &mut Target<'_>, part: &Part, tile: &Tile, scratch: &Scratch, stamp: Stamp) {
    for row in 0..TILE_ROWS {
        let from = usize::from(tile.row_start[row]);
        let mut to = usize::from(tile.row_start[row + 1]);
        if to > from && usize::from(part.column[tile.first + to - 1]) == TILE_COLUMNS {
            to -= 1;
        }
        for i in (from..to).step_by(LANES) {
            let colours = &part.colour[tile.first + i..tile.first + to.min(i + LANES)];
            match stamp {
                Stamp::OnePixel => offsets8::<L>(target, scratch, colours, i, (0.0, &ONE_PIXEL)),
                Stamp::TwoByTwo => offsets8::<L>(target, scratch, colours, i, (0.5, &TWO_BY_TWO)),
                Stamp::ThreeByThree => offsets8::<L>(target, scratch, colours, i, (0.0, &THREE_BY_THREE)),
                Stamp::Cross => offsets8::<L>(target, scratch, colours, i, (0.0, &CROSS)),
                Stamp::Footprint | Stamp::Quads => {
                    for (at, colour) in colours.iter().enumerate() {
                        footprint(target, *colour, scratch, i + at);
                    }
                }
            }
        }
    }
}

/// Pixels of a stamp relative to the one that contains the sample's position less the stamp's shift.
type Offsets = [(i8, i8)];
const ONE_PIXEL: [(i8, i8); 1] = [(0, 0)];
const TWO_BY_TWO: [(i8, i8); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];
const CROSS: [(i8, i8); 5] = [(0, -1), (-1, 0), (0, 0), (1, 0), (0, 1)];
const THREE_BY_THREE: [(i8, i8); 9] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (0, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];

/// The same stamp at eight samples, of which the first `count` count.
#[inline(always)]
fn offsets8<L: Lanes>(
    target: &mut Target<'_>,
    scratch: &Scratch,
    colours: &[u32],
    i: usize,
    (shift, offsets): (f32, &Offsets),
) {
    let count = colours.len();
    let window = target.window;
    let shift = L::splat(shift);
    let column = L::floor(L::sub(L::load(&scratch.x[i..]), shift));
    let row = L::floor(L::sub(L::load(&scratch.y[i..]), shift));
    let row = L::sub(row, L::splat(window.first_row as f32));
    let disparity = L::load(&scratch.disparity[i..]);
    let lane = L::from_int(L::load_int(&LANE_NUMBERS));
    let ahead = L::and(L::gt(disparity, L::splat(0.0)), L::gt(L::splat(count as f32), lane));
    if L::mask_bits(ahead) == 0 {
        return;
    }
    let disparities = L::array_int(L::bits(disparity));
    let (zero, width, rows) = (L::splat(0.0), L::splat(window.width as f32), L::splat(window.rows as f32));
    for (dx, dy) in offsets {
        let column = L::add(column, L::splat(f32::from(*dx)));
        let row = L::add(row, L::splat(f32::from(*dy)));
        let inside_x = L::and(L::ge(column, zero), L::gt(width, column));
        let inside_y = L::and(L::ge(row, zero), L::gt(rows, row));
        let mut bits = L::mask_bits(L::and(ahead, L::and(inside_x, inside_y)));
        let from_row = L::mul_int(L::to_int(row), L::splat_int(window.width));
        let at = L::array_int(L::add_int(from_row, L::to_int(column)));
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize & (LANES - 1);
            target.put(at[lane] as usize, disparities[lane], colours[lane.min(count - 1)]);
            bits &= bits - 1;
        }
    }
}

/// The square of the footprint's size whose centre is nearest to the sample.
#[inline(always)]
fn footprint(target: &mut Target<'_>, colour: u32, scratch: &Scratch, at: usize) {
    let (x, y, disparity) = (scratch.x[at], scratch.y[at], scratch.disparity[at]);
    let margin = LARGEST_FOOTPRINT_STAMP;
    let window = target.window;
    let last_row = (window.first_row + window.rows) as f32 + margin;
    // Also false for NaN. The margin admits stamps that reach in from outside.
    let near = disparity > 0.0
        && x > -margin
        && y > window.first_row as f32 - margin
        && x < window.width as f32 + margin
        && y < last_row;
    if !near {
        return;
    }
    let side = scratch.footprint2[at].sqrt().ceil().clamp(1.0, LARGEST_FOOTPRINT_STAMP);
    let offset = 0.5 * (side - 1.0);
    let (column, row) = ((x - offset).floor() as i32, (y - offset).floor() as i32 - window.first_row as i32);
    let columns = column.max(0)..(column + side as i32).min(window.width as i32);
    for row in row.max(0)..(row + side as i32).min(window.rows as i32) {
        for column in columns.clone() {
            target.put(row as usize * window.width as usize + column as usize, disparity.to_bits(), colour);
        }
    }
}
