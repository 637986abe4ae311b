//! Cuts a face into tiles around what eyes see of it.
//!
//! In: the face's window, what eyes see in it. Out: rectangles that hold it all, few and with
//! little between, each with its share of the face: the shares fill the face without gaps, so that
//! for every direction it is known which image would hold what is there.

use super::{
    sight::{Glimpse, blocks_of},
    sums::Sums,
    view::Window,
};
use std::ops::Range;

/// Edge of the squares that cuts run between, pixels. Smaller: tighter tiles, more time. By
/// judgement.
const SQUARE: usize = 128;
/// A tile is cut where that leaves out more than this share of it. Each cut costs an image; what
/// nobody looks at costs memory only. By judgement.
const WORTH_CUTTING: f64 = 0.5;
/// Tiles reach over their borders by this many pixels, so that surfaces join across them.
const OVERLAP: i64 = 2;

/// A part of a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Tile {
    /// Its share of the face.
    pub share: Window,
    /// What eyes see of its share lies in here.
    pub window: Window,
}

/// The tiles of a face, of at most so many pixels without what they overlap; none if nothing is
/// seen.
pub(super) fn tiles<'a>(face: &Window, seen: impl Iterator<Item = &'a Glimpse>, most_pixels: usize) -> Vec<Tile> {
    let (columns, rows) = ((face.width as usize).div_ceil(SQUARE), (face.height as usize).div_ceil(SQUARE));
    let mut needed = vec![false; columns * rows];
    for glimpse in seen {
        let (across, down) = blocks_of(face, SQUARE, glimpse);
        down.for_each(|row| needed[row * columns..][across.clone()].fill(true));
    }
    let window = |columns: &Range<usize>, rows: &Range<usize>| {
        let span = |first: i32, size: u32, r: &Range<usize>| {
            let from = ((r.start * SQUARE) as i64 - OVERLAP).max(0);
            let to = ((r.end * SQUARE) as i64 + OVERLAP).min(i64::from(size));
            (first + from as i32, (to - from) as u32)
        };
        let ((left, width), (top, height)) = (span(face.left, face.width, columns), span(face.top, face.height, rows));
        Window { left, top, width, height }
    };
    let mut out = Vec::new();
    let most_squares = most_pixels / (SQUARE * SQUARE);
    cover(&Sums::new(&needed, columns), 0..columns, 0..rows, most_squares, &mut |share, tight| {
        out.push(Tile { share: window(&share.0, &share.1), window: window(&tight.0, &tight.1) });
    });
    out
}

/// Columns and rows of squares.
type Block = (Range<usize>, Range<usize>);

/// Covers the needed squares of a block; `found` takes shares of the block and what of them is
/// needed, `most_squares` at most.
fn cover(
    needed: &Sums,
    columns: Range<usize>,
    rows: Range<usize>,
    most_squares: usize,
    found: &mut dyn FnMut(Block, Block),
) {
    let Some(tight) = needed.tight(columns.clone(), rows.clone()) else { return };
    let (across, down) = tight.clone();
    let area = |(columns, rows): &Block| columns.len() * rows.len();
    let all = area(&tight);
    let large = all > 1 && all > most_squares;
    // The cut that leaves out the most squares; of equals one through the longer side, and of
    // these the most even one. Beside each cut lie needed squares, as the block is tight.
    let left_of = |c: usize| [(columns.start..c, rows.clone()), (c..columns.end, rows.clone())];
    let above = |r: usize| [(columns.clone(), rows.start..r), (columns.clone(), r..rows.end)];
    let cuts = (across.start + 1..across.end).map(left_of).chain((down.start + 1..down.end).map(above));
    let best = cuts
        .map(|parts| {
            let [a, b] = parts.clone().map(|(c, r)| needed.tight(c, r).map_or(0, |t| area(&t)));
            let through_rows = parts[0].0 == parts[1].0;
            ((a + b, through_rows != (down.len() > across.len()), a.abs_diff(b)), parts)
        })
        .min_by_key(|cut| cut.0);
    match best {
        Some(((kept, ..), parts)) if large || ((all - kept) as f64) > WORTH_CUTTING * all as f64 => {
            parts.into_iter().for_each(|(c, r)| cover(needed, c, r, most_squares, found));
        }
        _ => found((columns, rows), tight),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST_PIXELS: usize = 250_000;

    #[test]
    fn tiles_hold_what_is_seen_and_share_out_the_face() {
        let face = Window { left: -3000, top: 500, width: 6001, height: 4100 };
        // Two doors far apart, and a long low window.
        let mut seen = Vec::new();
        for (u, v, w, h) in
            [(-2900.0, 600.0, 300.0, 900.0), (2000.0, 3000.0, 700.0, 1200.0), (-500.0, 1000.0, 3400.0, 200.0)]
        {
            for k in 0..400 {
                let (x, y) = (f64::from(k % 20) / 19.0, f64::from(k / 20) / 19.0);
                seen.push(Glimpse {
                    at: [u + w * x, v + h * y, 0.1],
                    half: [10.0; 2],
                    ray: [0.0; 2],
                    ray_half: [0.0; 2],
                });
            }
        }
        let all = tiles(&face, seen.iter(), MOST_PIXELS);
        // With the squares that they reach into the three take some 3 million pixels, twelve
        // tiles' worth; halves are seldom full.
        assert!((12..=20).contains(&all.len()), "{} {all:?}", all.len());
        let inside =
            |w: &Window, u: f64, v: f64| w.index(u as i64 - i64::from(w.left), v as i64 - i64::from(w.top)).is_some();
        let pixels: usize = all.iter().map(|t| t.window.pixels()).sum();
        assert!(pixels < face.pixels() / 4, "{pixels}");
        for g in &seen {
            assert!(all.iter().any(|t| inside(&t.window, g.at[0], g.at[1])));
        }
        for t in &all {
            assert!(inside(&t.share, f64::from(t.window.left) + 1.0, f64::from(t.window.top) + 1.0));
            assert!(t.window.pixels() < MOST_PIXELS + MOST_PIXELS / 4);
        }
        for k in 0..10_000u32 {
            let (u, v) =
                (f64::from(face.left) + f64::from(k % 100) * 60.0, f64::from(face.top) + f64::from(k / 100) * 41.0);
            assert!(all.iter().any(|t| inside(&t.share, u, v)), "{u} {v}");
        }
        assert!(tiles(&face, std::iter::empty(), MOST_PIXELS).is_empty());
        // A long strip is cut, too.
        let (strip, along) = (Window { width: 100_000, height: 200, ..face }, [50_000.0, 100.0]);
        let seen = Glimpse { at: [47_000.0, 600.0, 0.1], half: along, ray: [0.0; 2], ray_half: [0.0; 2] };
        let strips = tiles(&strip, std::iter::once(&seen), MOST_PIXELS);
        assert!(strips.len() >= 50 && strips.iter().all(|t| t.window.pixels() < MOST_PIXELS + MOST_PIXELS / 4));
        // Seen all over: cut because it is large.
        let everywhere = Glimpse { at: [0.0, 2500.0, 0.1], half: [9000.0; 2], ray: [0.0; 2], ray_half: [0.0; 2] };
        let whole = tiles(&face, std::iter::once(&everywhere), MOST_PIXELS);
        assert!(whole.len() >= face.pixels() / MOST_PIXELS, "{}", whole.len());
        assert!(whole.iter().all(|t| t.window.width < 3 * t.window.height && t.window.height < 3 * t.window.width));
    }
}
