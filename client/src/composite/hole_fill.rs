//! Hole filling by extrapolation.
//!
//! In: a merged frame with unpainted pixels. Out: the same, with unpainted pixels coloured where a
//! surface is close enough, marked [`Source::Filled`]. Holes open where something near has moved
//! away from something farther, so the farther surface is extrapolated: of the first surfaces to
//! the left, right, above and below, the one with the smallest disparity is taken, of equals the
//! closest. A hole that meets sky on two sides or more is sky; a single side may be the border of a
//! surface.
//!
//! Alternatively, as in Rafferty and others (1998), holes show the previous frame.

use crate::frame::{Frame, SKY, Source};
use rayon::prelude::*;
use serde::Serialize;

/// Content of holes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Fill {
    /// Nothing.
    Off,
    /// The nearest farther surface.
    #[default]
    Surface,
    /// The previous frame.
    Last,
}

/// Longest distance to a surface, pixels. Larger: wide holes, which are missing data, get arbitrary
/// colours; smaller: gaps between samples stay.
const REACH_PX: usize = 48;
/// Number of sides, of four, on which a hole must meet sky to be sky. Smaller: holes at a surface's
/// border against the sky become sky. A judgement.
const SKY_SIDES: u32 = 2;

/// Fills holes with the previous frame, if it has as many pixels. Returns the number of filled
/// pixels.
pub fn from_last(frame: &mut Frame, last: &[u32]) -> u64 {
    let mut filled = 0;
    for ((source, colour), last) in frame.source.iter_mut().zip(&mut frame.colour).zip(last) {
        if *source == Source::Unpainted {
            (*source, *colour) = (Source::Filled, *last);
            filled += 1;
        }
    }
    filled
}

/// Fills holes. Returns the number of filled pixels.
pub fn fill(frame: &mut Frame) -> u64 {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let fill_row = |row: usize| {
        let sources = &frame.source[row * width..(row + 1) * width];
        let holes = sources.iter().enumerate().filter(|(_, s)| **s == Source::Unpainted);
        let filled = holes.filter_map(|(column, _)| {
            let (colour, disparity) = find(frame, row, column)?;
            Some((row * width + column, colour, disparity))
        });
        filled.collect::<Vec<_>>()
    };
    let filled: Vec<Vec<(usize, u32, f32)>> = (0..height).into_par_iter().map(fill_row).collect();
    let mut count = 0;
    for (at, colour, disparity) in filled.iter().flatten() {
        count += 1;
        frame.colour[*at] = *colour;
        frame.disparity[*at] = *disparity;
        frame.source[*at] = Source::Filled;
    }
    count
}

/// The colour and disparity for a hole.
fn find(frame: &Frame, row: usize, column: usize) -> Option<(u32, f32)> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let at = row * width + column;
    let mut best: Option<(f32, usize, usize)> = None;
    let mut sky = 0;
    let rooms = [column, width - 1 - column, row, height - 1 - row];
    for (steps, room) in [-1isize, 1, -(width as isize), width as isize].into_iter().zip(rooms) {
        for distance in 1..=room.min(REACH_PX) {
            let other = at.wrapping_add_signed(steps * distance as isize);
            match frame.source[other] {
                Source::Unpainted => continue,
                Source::Near | Source::Far | Source::Tree => {
                    let candidate = (frame.disparity[other], distance, other);
                    if best.is_none_or(|b| candidate < b) {
                        best = Some(candidate);
                    }
                }
                Source::Sky => sky += 1,
                Source::Filled => {}
            }
            break;
        }
    }
    if sky >= SKY_SIDES {
        return Some((SKY, 0.0));
    }
    best.map(|(_, _, other)| (frame.colour[other], frame.disparity[other]))
}
