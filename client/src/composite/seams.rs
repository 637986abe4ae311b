//! Seams: gaps of one pixel within one surface, where near geometry and an image of the surface
//! meet, or two images, or two parts of one.
//!
//! In: a frame merged by depth. Out: open pixels between both sides, with the pixel whose content
//! they take.
//!
//! A triangle covers a pixel if it covers its centre; an image's surface ends with its last sample.
//! A pixel centre between both may stay uncovered and show what lies behind the surface, often sky.
//! An open pixel with an image on one side, and an image or near geometry at about the same
//! disparity on the opposite one, takes the farther of the two. Gaps between triangles alone belong
//! to the scene. Thin gaps in foliage, through which sky is seen, are closed as well.

use crate::frame::{Frame, Source};
use rayon::prelude::*;

/// Largest difference in disparity between both sides of a seam, as a share of the larger. Larger:
/// unrelated surfaces are joined; smaller: steep surfaces keep their seams. A judgement.
const SAME_SURFACE: f32 = 0.1;

/// A seam pixel, and the neighbour whose colour, disparity and source it takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Seam {
    pub at: usize,
    pub of: usize,
}

/// The seams of rows with open pixels; `open` counts those of each row.
pub(super) fn find(frame: &Frame, open: &[u64]) -> Vec<Seam> {
    let width = frame.width as usize;
    let of_row = |row: usize| {
        let pixels = (row * width..(row + 1) * width).filter(|at| frame.source[*at] == Source::Unpainted);
        pixels.filter_map(|at| seam(frame, at))
    };
    let rows = open.par_iter().enumerate().filter(|(_, open)| **open > 0);
    rows.flat_map_iter(|(row, _)| of_row(row)).collect()
}

/// The seam at an open pixel, if it is one.
fn seam(frame: &Frame, at: usize) -> Option<Seam> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let (row, column) = (at / width, at % width);
    let across = (column > 0 && column + 1 < width).then(|| [at - 1, at + 1]);
    let down = (row > 0 && row + 1 < height).then(|| [at - width, at + width]);
    let of = [across, down].into_iter().flatten().find(|sides| joins(frame, sides))?;
    Some(Seam { at, of: if frame.disparity[of[0]] <= frame.disparity[of[1]] { of[0] } else { of[1] } })
}

/// Whether both sides show the same surface, at least one of them from an image.
fn joins(frame: &Frame, sides: &[usize; 2]) -> bool {
    let [a, b] = sides.map(|at| frame.disparity[at]);
    matches!(sides.map(|at| frame.source[at]), [Source::Far, Source::Far | Source::Near] | [Source::Near, Source::Far])
        && (a - b).abs() <= SAME_SURFACE * a.max(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of a frame: `n` and `N` near geometry 1 and 2 m away, `f` and `F` of images there, `t`
    /// of the tree at 1 m, `.` nothing.
    fn found(rows: &[&str]) -> Vec<(usize, usize)> {
        let mut frame = Frame::new(rows[0].len() as u32, rows.len() as u32);
        for (at, pixel) in rows.iter().flat_map(|r| r.bytes()).enumerate() {
            (frame.source[at], frame.disparity[at]) = match pixel {
                b'n' => (Source::Near, 1.0),
                b'N' => (Source::Near, 0.5),
                b'f' => (Source::Far, 0.95),
                b'F' => (Source::Far, 0.55),
                b't' => (Source::Tree, 1.0),
                _ => (Source::Unpainted, 0.0),
            };
        }
        let open: Vec<u64> = rows.iter().map(|r| r.bytes().filter(|p| *p == b'.').count() as u64).collect();
        find(&frame, &open).into_iter().map(|s| (s.at, s.of)).collect()
    }

    #[test]
    fn a_gap_in_a_surface_takes_the_farther_side() {
        assert_eq!(found(&["n.f"]), [(1, 2)], "the image is farther");
        assert_eq!(found(&["F.N"]), [(1, 2)], "the geometry is farther");
        assert_eq!(found(&["f.f"]), [(1, 0)], "both are images");
        assert_eq!(found(&["n", ".", "f"]), [(1, 2)], "down");
        // A border that runs down to the right, as a raster sees it.
        assert_eq!(found(&["n.fff", "nn.ff", "nnn.f"]), [(1, 2), (7, 8), (13, 14)]);
    }

    #[test]
    fn other_gaps_stay() {
        for row in ["n.n", "f.F", "n.F", "N.f", "n..f", "n.t", "n.", ".f", "..."] {
            assert_eq!(found(&[row]), [], "{row}");
        }
        // At the border of the picture only what lies along it counts.
        assert_eq!(found(&["nnn", ".ff", "fff"]), [(3, 6)]);
        assert_eq!(found(&["nnn", "nn.", "..."]), []);
    }

    /// What a seam takes is what was there before any was closed.
    #[test]
    fn seams_do_not_spread() {
        assert_eq!(found(&["nnnn", "n..f", "nfff"]), [(5, 9), (6, 10)]);
        assert_eq!(found(&["nnnn", "n..f", "nnnn"]), []);
    }
}
