//! Micro-quads, eight at a time.
//!
//! In: eight quads on the output, corners a (upper left in the LDI), b (right), e (below), f. Out:
//! their pixels, written as 64-bit maxima: disparity above colour, so that the nearest wins, in
//! whatever order and on however many threads.
//!
//! At the LDI's usual density a quad covers one to four pixel centres. A scan converter would spend
//! its time in set-up; instead every pixel centre of the quad's bounding box is tested, all eight
//! quads in step. Each quad is two triangles, (a, b, e) and (f, e, b); within each, the position in
//! the quad (s across, t down) is affine. Both borders of a triangle are inclusive with a
//! tolerance, so that neighbours leave no crack (a pixel painted twice takes the maximum). Colours
//! are bilinear in (s, t), in approximately linear light: the square of the sRGB code, whose error
//! is far smaller than that of averaging codes.

use super::{
    tiles::{Part, PieceGroup, Tile},
    transform::{LANE_NUMBERS, Scratch, TileTransform, Window, affine8, warp8},
};
use crate::simd::{LANES, Lanes};

/// Tolerance of the inside test, in quads: above the f32 rounding of a shared edge evaluated from
/// both sides. Larger: surfaces grow; smaller: cracks.
const SLACK: f32 = 1.0 / 512.0;
/// Slack of the bounding box, pixels.
const BOX_SLACK: f32 = 1.0 / 256.0;
/// Quads with more pixel centres than this on a side leave the group and are filled alone: they are
/// rare, and one of them would keep seven lanes waiting.
const GROUP_SIDE: f32 = 8.0;

/// The rows of the output that one thread owns.
pub struct Target<'a> {
    /// `rows` * `width` packed pixels, see [`super::FarFrame`].
    pub pixels: &'a mut [u64],
    /// Which rows these are.
    pub window: Window,
}

impl Target<'_> {
    /// Keeps the nearer of what is there and this.
    #[inline(always)]
    pub fn put(&mut self, at: usize, disparity_bits: u32, colour: u32) {
        self.keep_nearer(at, u64::from(disparity_bits) << 32 | u64::from(colour));
    }

    #[inline(always)]
    fn keep_nearer(&mut self, at: usize, value: u64) {
        if let Some(pixel) = self.pixels.get_mut(at) {
            *pixel = (*pixel).max(value);
        }
    }

    /// Keeps the nearer of the present and the given packed values, where a bit is set.
    #[inline(always)]
    pub fn put8(&mut self, mut bits: u32, at: [u32; LANES], values: [u64; LANES]) {
        let mut put = |lane: usize| self.keep_nearer(at[lane] as usize, values[lane]);
        // Most groups are whole: no loop over bits for them.
        if bits == (1 << LANES) - 1 {
            (0..LANES).for_each(put);
            return;
        }
        while bits != 0 {
            put(bits.trailing_zeros() as usize & (LANES - 1));
            bits &= bits - 1;
        }
    }

    /// Replaces what is there.
    #[inline(always)]
    pub fn set(&mut self, at: usize, disparity_bits: u32, colour: u32) {
        if let Some(pixel) = self.pixels.get_mut(at) {
            *pixel = u64::from(disparity_bits) << 32 | u64::from(colour);
        }
    }
}

/// One corner of eight quads.
#[derive(Clone, Copy)]
struct Corner<L: Lanes> {
    x: L::F,
    y: L::F,
    disparity: L::F,
    /// Squared sRGB codes.
    light: [L::F; 3],
}

/// Squares of a packed colour's codes.
#[inline(always)]
fn light<L: Lanes>(colour: L::I) -> [L::F; 3] {
    let byte = L::splat_int(255);
    let red = L::from_int(L::and(colour, byte));
    let green = L::from_int(L::and(L::shift_right::<8>(colour), byte));
    let blue = L::from_int(L::and(L::shift_right::<16>(colour), byte));
    [L::mul(red, red), L::mul(green, green), L::mul(blue, blue)]
}

/// Eight consecutive samples as corners.
#[inline(always)]
fn sample_corner<L: Lanes>(part: &Part, tile: &Tile, scratch: &Scratch, i: usize) -> Corner<L> {
    Corner {
        x: L::load(&scratch.x[i..]),
        y: L::load(&scratch.y[i..]),
        disparity: L::load(&scratch.disparity[i..]),
        light: light::<L>(L::load_int(&part.colour[tile.first + i..])),
    }
}

/// X, Y or W of eight corners.
#[inline(always)]
fn component<L: Lanes>(row: &[f32; 4], u: L::F, v: L::F, d: L::F) -> L::F {
    let across = L::add(L::splat(row[2]), L::mul(L::splat(row[0]), u));
    affine8::<L>(across, [L::splat(row[1]), v], [L::splat(row[3]), d])
}

/// Corner `c` of eight pieces, warped.
#[inline(always)]
fn piece_corner<L: Lanes>(group: &PieceGroup, transform: &TileTransform, c: usize) -> Corner<L> {
    let u = L::load(&group.u[c]);
    let v = L::load(&group.v[c]);
    let d = L::load(&group.disparity[c]);
    let [rx, ry, rw] = &transform.rows;
    let xyw = [component::<L>(rx, u, v, d), component::<L>(ry, u, v, d), component::<L>(rw, u, v, d)];
    let [x, y, inverse] = warp8::<L>(xyw);
    let ahead = L::gt(inverse, L::splat(0.0));
    let disparity = L::select(ahead, L::mul(d, inverse), L::splat(-1.0));
    Corner { x, y, disparity, light: light::<L>(L::load_int(&group.colour[c])) }
}

/// Draws all quad runs and border pieces of a transformed tile; reports the squared longest side of
/// one quad in eight.
#[inline(always)]
pub fn draw_tile<L: Lanes>(
    target: &mut Target<'_>,
    transform: &TileTransform,
    part: &Part,
    tile: &Tile,
    scratch: &Scratch,
    mut stretch: impl FnMut(f32),
) {
    let lane = L::from_int(L::load_int(&LANE_NUMBERS));
    for run in &part.runs[tile.runs.clone()] {
        let count = usize::from(run.count);
        for k in (0..count).step_by(LANES) {
            let (top, bottom) = (usize::from(run.top) + k, usize::from(run.bottom) + k);
            let quad = [
                sample_corner::<L>(part, tile, scratch, top),
                sample_corner::<L>(part, tile, scratch, top + 1),
                sample_corner::<L>(part, tile, scratch, bottom),
                sample_corner::<L>(part, tile, scratch, bottom + 1),
            ];
            let on = L::gt(L::splat((count - k) as f32), lane);
            draw8::<L>(target, &quad, on);
            stretch(longest_side2(scratch, top, bottom));
        }
    }
    for (i, group) in part.pieces.groups[tile.groups.clone()].iter().enumerate() {
        let quad = [
            piece_corner::<L>(group, transform, 0),
            piece_corner::<L>(group, transform, 1),
            piece_corner::<L>(group, transform, 2),
            piece_corner::<L>(group, transform, 3),
        ];
        let on = L::gt(L::splat((tile.pieces - i * LANES) as f32), lane);
        draw8::<L>(target, &quad, on);
    }
}

/// The longer of a quad's sides a-b and a-e, squared pixels; 0 behind the eye.
fn longest_side2(scratch: &Scratch, top: usize, bottom: usize) -> f32 {
    let to = |i: usize| {
        let (dx, dy) = (scratch.x[i] - scratch.x[top], scratch.y[i] - scratch.y[top]);
        if scratch.disparity[i].min(scratch.disparity[top]) > 0.0 { dx * dx + dy * dy } else { 0.0 }
    };
    to(top + 1).max(to(bottom))
}

/// Where a pixel centre lies in a quad, as affine functions of its offset from a corner.
#[derive(Clone, Copy)]
struct Half<L: Lanes> {
    x: L::F,
    y: L::F,
    s: [L::F; 2],
    t: [L::F; 2],
}

impl<L: Lanes> Half<L> {
    /// The triangle at `at` whose sides toward `across` and `down` have unit length in s and t.
    #[inline(always)]
    fn new(at: &Corner<L>, across: &Corner<L>, down: &Corner<L>) -> Self {
        let (ax, ay) = (L::sub(across.x, at.x), L::sub(across.y, at.y));
        let (dx, dy) = (L::sub(down.x, at.x), L::sub(down.y, at.y));
        let inverse = L::div(L::splat(1.0), L::sub(L::mul(ax, dy), L::mul(ay, dx)));
        let minus = L::sub(L::splat(0.0), inverse);
        Self {
            x: at.x,
            y: at.y,
            s: [L::mul(dy, inverse), L::mul(dx, minus)],
            t: [L::mul(ay, minus), L::mul(ax, inverse)],
        }
    }

    /// (s, t, inside) of a pixel centre.
    #[inline(always)]
    fn locate(&self, x: L::F, y: L::F) -> (L::F, L::F, L::I) {
        let (dx, dy) = (L::sub(x, self.x), L::sub(y, self.y));
        let s = L::add(L::mul(dx, self.s[0]), L::mul(dy, self.s[1]));
        let t = L::add(L::mul(dx, self.t[0]), L::mul(dy, self.t[1]));
        let slack = L::splat(-SLACK);
        let rest = L::sub(L::splat(1.0), L::add(s, t));
        let inside = L::and(L::and(L::ge(s, slack), L::ge(t, slack)), L::ge(rest, slack));
        (s, t, inside)
    }
}

#[inline(always)]
fn least<L: Lanes>(a: L::F, b: L::F, c: L::F, d: L::F) -> L::F {
    L::min(L::min(a, b), L::min(c, d))
}

#[inline(always)]
fn most<L: Lanes>(a: L::F, b: L::F, c: L::F, d: L::F) -> L::F {
    L::max(L::max(a, b), L::max(c, d))
}

/// `a` where w is 0, `b` where it is 1.
#[inline(always)]
fn mix<L: Lanes>(a: L::F, b: L::F, w: L::F) -> L::F {
    L::add(a, L::mul(L::sub(b, a), w))
}

/// The corners' values at (s, t).
#[inline(always)]
fn bilinear<L: Lanes>(corners: [L::F; 4], s: L::F, t: L::F) -> L::F {
    let [a, b, e, f] = corners;
    mix::<L>(mix::<L>(a, b, s), mix::<L>(e, f, s), t)
}

/// The sRGB code whose square is the corners' mean at (s, t), rounded.
#[inline(always)]
fn code<L: Lanes>(corners: [L::F; 4], s: L::F, t: L::F) -> L::I {
    let light = L::max(bilinear::<L>(corners, s, t), L::splat(0.0));
    L::to_int(L::add(L::sqrt(light), L::splat(0.5)))
}

#[inline(always)]
fn unit_interval<L: Lanes>(x: L::F) -> L::F {
    L::min(L::max(x, L::splat(0.0)), L::splat(1.0))
}

/// Paints the pixel centres of eight quads.
#[inline(always)]
fn draw8<L: Lanes>(target: &mut Target<'_>, quad: &[Corner<L>; 4], on: L::I) {
    let [a, b, e, f] = quad;
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let window = target.window;
    // First and last pixel whose centre may lie inside, clamped to the window.
    let low = L::splat(0.5 - BOX_SLACK);
    let high = L::splat(BOX_SLACK - 0.5);
    let (row0, row1) = (window.first_row as f32, (window.first_row + window.rows) as f32 - 1.0);
    let first_x = L::max(L::floor(L::add(least::<L>(a.x, b.x, e.x, f.x), low)), zero);
    let first_y = L::max(L::floor(L::add(least::<L>(a.y, b.y, e.y, f.y), low)), L::splat(row0));
    let last_x = L::min(L::floor(L::add(most::<L>(a.x, b.x, e.x, f.x), high)), L::splat(window.width as f32 - 1.0));
    let last_y = L::min(L::floor(L::add(most::<L>(a.y, b.y, e.y, f.y), high)), L::splat(row1));
    let columns = L::add(L::sub(last_x, first_x), one);
    let rows = L::add(L::sub(last_y, first_y), one);
    let ahead = L::gt(least::<L>(a.disparity, b.disparity, e.disparity, f.disparity), zero);
    let live = L::and(L::and(on, ahead), L::and(L::ge(columns, one), L::ge(rows, one)));
    let live_bits = L::mask_bits(live);
    if live_bits == 0 {
        return;
    }
    let halves = [Half::new(a, b, e), Half::new(f, e, b)];
    let group = L::splat(GROUP_SIDE);
    let small = L::and(live, L::and(L::ge(group, columns), L::ge(group, rows)));
    let mut row = zero;
    loop {
        let in_row = L::and(small, L::gt(rows, row));
        if L::mask_bits(in_row) == 0 {
            break;
        }
        let y = L::add(first_y, row);
        let mut column = zero;
        loop {
            let on = L::and(in_row, L::gt(columns, column));
            if L::mask_bits(on) == 0 {
                break;
            }
            paint8::<L>(target, quad, &halves, on, L::add(first_x, column), y);
            column = L::add(column, one);
        }
        row = L::add(row, one);
    }
    let large = live_bits & !L::mask_bits(small);
    if large != 0 {
        draw_large::<L>(target, quad, large, [first_x, first_y, columns, rows]);
    }
}

/// Paints one pixel per lane where the quad covers its centre.
#[inline(always)]
fn paint8<L: Lanes>(
    target: &mut Target<'_>,
    quad: &[Corner<L>; 4],
    halves: &[Half<L>; 2],
    on: L::I,
    column: L::F,
    row: L::F,
) {
    let centre = L::splat(0.5);
    let (x, y) = (L::add(column, centre), L::add(row, centre));
    let (s1, t1, inside1) = halves[0].locate(x, y);
    let (s2, t2, inside2) = halves[1].locate(x, y);
    let covered = L::and(on, L::or(inside1, inside2));
    let bits = L::mask_bits(covered);
    if bits == 0 {
        return;
    }
    let one = L::splat(1.0);
    let s = unit_interval::<L>(L::select(inside1, s1, L::sub(one, s2)));
    let t = unit_interval::<L>(L::select(inside1, t1, L::sub(one, t2)));
    let [a, b, e, f] = quad;
    let red = code::<L>([a.light[0], b.light[0], e.light[0], f.light[0]], s, t);
    let green = code::<L>([a.light[1], b.light[1], e.light[1], f.light[1]], s, t);
    let blue = code::<L>([a.light[2], b.light[2], e.light[2], f.light[2]], s, t);
    let colour = L::or(red, L::or(L::shift_left::<8>(green), L::shift_left::<16>(blue)));
    let disparity = bilinear::<L>([a.disparity, b.disparity, e.disparity, f.disparity], s, t);
    let from_row = L::to_int(L::sub(row, L::splat(target.window.first_row as f32)));
    let at = L::add_int(L::mul_int(from_row, L::splat_int(target.window.width)), L::to_int(column));
    target.put8(bits, L::array_int(at), L::joined(colour, L::bits(disparity)));
}

/// Fills the quads of the given lanes, eight pixels of a row at a time.
#[inline(always)]
fn draw_large<L: Lanes>(target: &mut Target<'_>, quad: &[Corner<L>; 4], lanes: u32, boxes: [L::F; 4]) {
    let boxes = boxes.map(L::array);
    let parts = quad.map(|c| (L::array(c.x), L::array(c.y), L::array(c.disparity), c.light.map(L::array)));
    let lane_numbers = L::from_int(L::load_int(&LANE_NUMBERS));
    for lane in (0..LANES).filter(|lane| lanes >> lane & 1 == 1) {
        let one = parts.map(|(x, y, d, light)| Corner::<L> {
            x: L::splat(x[lane]),
            y: L::splat(y[lane]),
            disparity: L::splat(d[lane]),
            light: light.map(|l| L::splat(l[lane])),
        });
        let halves = [Half::new(&one[0], &one[1], &one[2]), Half::new(&one[3], &one[2], &one[1])];
        let [x, y, columns, rows] = boxes.map(|b| b[lane] as usize);
        for row in y..y + rows {
            for column in (0..columns).step_by(LANES) {
                let on = L::gt(L::splat((columns - column) as f32), lane_numbers);
                let at = L::add(L::splat((x + column) as f32), lane_numbers);
                paint8::<L>(target, &one, &halves, on, at, L::splat(row as f32));
            }
        }
    }
}
