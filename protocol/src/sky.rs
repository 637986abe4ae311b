//! Directions in which eyes see nothing at all.
//!
//! An LDI holds sky as one bit per pixel ([`Ldi::sky`](crate::ldi::Ldi::sky)), but only within its
//! window. A [`SkyMap`] says for all directions whether some eye of a placement sees sky there:
//! squares of a cube of directions about the world's axes. Sky lies at infinity, so one map serves
//! all eyes.

use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Squares of directions. Square (face f, row r, column c) has the number (f [`SkyMap::SIDE`] + r)
/// [`SkyMap::SIDE`] + c; faces are -x, +x, -y, +y, -z, +z, columns and rows follow the other two
/// axes in the order x, y, z, in equal steps of the tangent.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SkyMap {
    /// First square and number of squares of each run; ascending, apart from each other.
    runs: Vec<[u32; 2]>,
}

impl SkyMap {
    /// Squares along each side of a face: 8 pixels in the middle of a face for pictures of 1280
    /// pixels and 60 degrees.
    pub const SIDE: u32 = 256;
    /// Squares of all faces.
    pub const SQUARES: u32 = 6 * Self::SIDE * Self::SIDE;

    /// The map of some squares; `squares` has [`SkyMap::SQUARES`] entries.
    pub fn of(squares: &[bool]) -> Self {
        let mut runs: Vec<[u32; 2]> = Vec::new();
        for (square, _) in (0u32..).zip(squares).filter(|(_, sky)| **sky) {
            match runs.last_mut() {
                Some([first, length]) if *first + *length == square => *length += 1,
                _ => runs.push([square, 1]),
            }
        }
        Self { runs }
    }

    /// The map of runs of squares. None: they are empty, not ascending, not apart, or not within
    /// the cube.
    pub fn of_runs(runs: Vec<[u32; 2]>) -> Option<Self> {
        let mut next = 0;
        for [first, length] in &runs {
            let end = first.checked_add(*length)?;
            if *first < next || *length == 0 || end > Self::SQUARES {
                return None;
            }
            next = end + 1;
        }
        Some(Self { runs })
    }

    /// Its runs: first square and number of squares.
    pub fn runs(&self) -> &[[u32; 2]] {
        &self.runs
    }

    /// Whether it holds no direction.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Whether eyes see sky in a direction (world axes, any length but 0).
    pub fn holds(&self, direction: DVec3) -> bool {
        let square = Self::square(direction);
        let after = self.runs.partition_point(|[first, _]| *first <= square);
        self.runs[..after].last().is_some_and(|[first, length]| square < first + length)
    }

    /// The square of a direction (world axes, any length but 0).
    pub fn square(direction: DVec3) -> u32 {
        let axis = direction.abs().max_position();
        let [a, b] = [[1, 2], [0, 2], [0, 1]][axis];
        let along = direction[axis].abs();
        let place = |v: f64| (((v / along + 1.0) * 0.5 * f64::from(Self::SIDE)) as u32).min(Self::SIDE - 1);
        let face = 2 * axis as u32 + u32::from(direction[axis] > 0.0);
        (face * Self::SIDE + place(direction[b])) * Self::SIDE + place(direction[a])
    }

    /// The direction through the middle of a square (world axes), with component 1 along its
    /// face's axis.
    pub fn middle(square: u32) -> DVec3 {
        let (face, row, column) =
            (square / Self::SIDE / Self::SIDE, square / Self::SIDE % Self::SIDE, square % Self::SIDE);
        let place = |k: u32| (f64::from(k) + 0.5) * 2.0 / f64::from(Self::SIDE) - 1.0;
        let axis = (face / 2) as usize;
        let [a, b] = [[1, 2], [0, 2], [0, 1]][axis];
        let mut d = DVec3::ZERO;
        d[axis] = if face % 2 == 1 { 1.0 } else { -1.0 };
        (d[a], d[b]) = (place(column), place(row));
        d
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_holds_the_directions_of_its_squares_and_no_others() {
        let sky = |square: u32| square % 97 < 31 || square / SkyMap::SIDE % 19 == 3;
        let squares: Vec<bool> = (0..SkyMap::SQUARES).map(sky).collect();
        let map = SkyMap::of(&squares);
        for square in 0..SkyMap::SQUARES {
            let d = SkyMap::middle(square) * f64::from(square % 7 + 1);
            assert_eq!(SkyMap::square(d), square);
            assert_eq!(map.holds(d), sky(square), "{square}");
        }
        assert_eq!(SkyMap::of_runs(map.runs().to_vec()), Some(map));
        assert!(!SkyMap::default().holds(DVec3::X) && SkyMap::default().is_empty());
        // Corners and edges of the cube belong to some square.
        for d in [DVec3::ONE, -DVec3::ONE, DVec3::new(1.0, -1.0, 0.0), DVec3::new(0.0, 1.0, 1.0)] {
            assert!(SkyMap::square(d) < SkyMap::SQUARES);
        }
    }

    #[test]
    fn runs_that_are_none_are_refused() {
        let refused: [&[[u32; 2]]; 5] =
            [&[[5, 0]], &[[5, 2], [7, 1]], &[[5, 2], [4, 1]], &[[SkyMap::SQUARES - 1, 2]], &[[u32::MAX, 2]]];
        for runs in refused {
            assert_eq!(SkyMap::of_runs(runs.to_vec()), None, "{runs:?}");
        }
    }
}
