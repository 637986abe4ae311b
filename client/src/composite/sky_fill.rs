//! Filling of openings with sky.
//!
//! In: a merged frame whose images are all present. Out: the same, with openings that border on sky
//! turned into sky.
//!
//! Builds find sky by rays of some eyes, so that another eye sees parts of a window that no ray has
//! tested. The LDI tree would show coarse samples there. Images contain the visible surfaces far
//! more finely, so that an opening (connected open pixels) is sky if a sufficient share of its
//! outline is.

use super::CompositeStats;
use crate::frame::{Frame, SKY, Source};

/// Share of an opening's outline that must be known sky. Larger: coarse tree samples stay in
/// windows; smaller: a hole in a surface in front of the sky is filled with sky.
const SKY_SHARE: f64 = 0.25;

/// Turns openings into sky. `stats`: counts of the merge, updated. All images must be present: an
/// opening may otherwise be missing data.
pub fn fill_sky(frame: &mut Frame, stats: &mut CompositeStats) {
    if stats.unpainted == 0 || stats.sky == 0 {
        return;
    }
    let (width, height) = (frame.width as usize, frame.height as usize);
    let mut done = vec![false; frame.source.len()];
    let (mut opening, mut grown) = (Vec::new(), 0);
    for start in 0..frame.source.len() {
        if frame.source[start] != Source::Unpainted || done[start] {
            continue;
        }
        opening.clear();
        opening.push(start);
        done[start] = true;
        let (mut sky, mut outline) = (0u32, 0u32);
        let mut next = 0;
        while let Some(&at) = opening.get(next) {
            next += 1;
            let (row, column) = (at / width, at % width);
            let sides = [
                (column > 0).then(|| at - 1),
                (column + 1 < width).then(|| at + 1),
                (row > 0).then(|| at - width),
                (row + 1 < height).then(|| at + width),
            ];
            for side in sides.into_iter().flatten() {
                match frame.source[side] {
                    Source::Unpainted if !done[side] => {
                        done[side] = true;
                        opening.push(side);
                    }
                    Source::Unpainted => {}
                    source => {
                        outline += 1;
                        sky += u32::from(source == Source::Sky);
                    }
                }
            }
        }
        if sky > 0 && f64::from(sky) >= SKY_SHARE * f64::from(outline) {
            grown += opening.len() as u64;
            for at in &opening {
                (frame.source[*at], frame.colour[*at]) = (Source::Sky, SKY);
            }
        }
    }
    stats.sky += grown;
    stats.unpainted -= grown;
    stats.hole_before_fill -= grown;
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEAR: u32 = 7;

    /// Rows of a frame: `#` near geometry, `~` sky, `.` nothing.
    fn frame(rows: &[&str]) -> Frame {
        let mut frame = Frame::new(rows[0].len() as u32, rows.len() as u32);
        for (at, pixel) in rows.iter().flat_map(|r| r.bytes()).enumerate() {
            (frame.source[at], frame.colour[at]) = match pixel {
                b'#' => (Source::Near, NEAR),
                b'~' => (Source::Sky, SKY),
                _ => (Source::Unpainted, 0),
            };
        }
        frame
    }

    fn grown(rows: &[&str]) -> (u64, String) {
        let mut frame = frame(rows);
        let (unpainted, sky) = (frame.count(Source::Unpainted) as u64, frame.count(Source::Sky) as u64);
        let before = CompositeStats { unpainted, hole_before_fill: unpainted, sky, ..CompositeStats::default() };
        let mut stats = before;
        fill_sky(&mut frame, &mut stats);
        let count = stats.sky - sky;
        let left = unpainted - count;
        assert_eq!(stats, CompositeStats { unpainted: left, hole_before_fill: left, sky: stats.sky, ..before });
        let pixel = |(source, colour): (&Source, &u32)| match (source, *colour) {
            (Source::Near, NEAR) => '#',
            (Source::Sky, SKY) => '~',
            (Source::Unpainted, 0) => '.',
            other => panic!("{other:?}"),
        };
        (count, frame.source.iter().zip(&frame.colour).map(pixel).collect())
    }

    #[test]
    fn an_opening_that_sky_reaches_into_is_sky() {
        // Of the outline's eight sides two are sky: a quarter.
        let window = ["#####", "#~..#", "#~..#", "#####"];
        assert_eq!(grown(&window), (4, "######~~~##~~~######".into()));
    }

    #[test]
    fn an_opening_that_hardly_borders_on_sky_or_only_by_a_corner_stays() {
        // One of ten sides.
        let slit = ["######", "#~...#", "##...#", "######"];
        assert_eq!(grown(&slit), (0, slit.concat()));
        let corner = ["####", "#~##", "##.#", "####"];
        assert_eq!(grown(&corner), (0, corner.concat()));
        let none = ["...", "...", "..."];
        assert_eq!(grown(&none), (0, none.concat()));
    }

    #[test]
    fn openings_are_judged_one_by_one() {
        let two = ["~.#.#", "~.#.#"];
        assert_eq!(grown(&two), (2, "~~#.#~~#.#".into()));
    }
}
