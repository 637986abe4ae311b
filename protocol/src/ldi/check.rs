//! Whether an LDI keeps its promises.
//!
//! A decoder calls [`Ldi::check`] before it hands an image on, tests call it after every
//! construction; the warp may then index without looking. Cost: a visit per sample; memory: a few
//! bytes per column.

use super::{END_PARTS, LINK_DOWN, LINK_RIGHT, Ldi, LdiLayer, SIDES, Segment, Sliver, end_of, is_loose};
use glam::DVec3;

/// The first promise that an LDI breaks.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LdiFault {
    /// The camera is not finite, not orthonormal, not right-handed, or has no positive scale.
    #[error("LDI camera: {0}; rebuild the dataset")]
    Camera(&'static str),
    /// Sides outside `1..=MAX_SIDE`, more than `MAX_PIXELS` pixels, or a window beyond the i32
    /// range.
    #[error(
        "LDI of {width} x {height} pixels at ({left}, {top}): sides are 1 to 16384, pixels at most 2^26; lower the density"
    )]
    Size {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// Left border.
        left: i32,
        /// Upper border.
        top: i32,
    },
    /// Disparity codes without a positive, finite start or step, or without a code.
    #[error(
        "LDI disparity codes: smallest {smallest}, step {step}, {largest_code} codes: all must be positive and finite"
    )]
    Codes {
        /// Disparity of code 1.
        smallest: f64,
        /// Step.
        step: f64,
        /// Number of codes.
        largest_code: u16,
    },
    /// More than [`Ldi::MAX_LAYERS`] layers.
    #[error("LDI of {0} layers, at most 32 are allowed")]
    Layers(usize),
    /// The arrays of a layer differ in length, or from the sum of its segments.
    #[error("LDI layer {layer}: {what} has {found} entries, expected {expected}")]
    Length {
        /// Layer.
        layer: usize,
        /// Array.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length of the other arrays.
        expected: usize,
    },
    /// A segment is empty, too long, outside the image, out of order or not where the samples
    /// before it end.
    #[error("LDI layer {layer}, segment {segment}: {what}")]
    Segment {
        /// Layer.
        layer: usize,
        /// Segment.
        segment: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// A sample is misplaced, has no code, lies before one of a layer above, links to nothing,
    /// ends beyond the next pixel's centre or where it is linked, or has a slope where its surface
    /// does not go on.
    #[error("LDI layer {layer}, row {row}, column {column}: {what}")]
    Sample {
        /// Layer.
        layer: usize,
        /// Row.
        row: u32,
        /// Column.
        column: u32,
        /// What is wrong.
        what: &'static str,
    },
    /// A sliver lies outside of the image or its codes, or there are too many.
    #[error("LDI sliver {sliver}: {what}")]
    Sliver {
        /// Which.
        sliver: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// The sky's bits do not fit the image.
    #[error("LDI sky: {0}")]
    Sky(&'static str),
}

/// Largest deviation of a basis' inner products from those of an orthonormal one: well above what
/// f64 arithmetic leaves, well below what would move a sample by a thousandth of a pixel at 16,384
/// columns.
const BASIS_TOLERANCE: f64 = 1e-9;

impl Ldi {
    /// Checks every promise of the format: bounded sizes, finite camera and codes, segments in
    /// row-major order that tile the arrays, columns ascending, codes in range, in each pixel no
    /// deeper layer nearer than one before it, links that lead to samples, ends within a pixel and
    /// only where nothing is linked, slopes only beside ends, slivers on the image, sky words that
    /// fit.
    ///
    /// # Errors
    /// The first broken promise, with its place.
    pub fn check(&self) -> Result<(), LdiFault> {
        self.check_camera()?;
        let c = &self.codes;
        let positive = |x: f64| x.is_finite() && x > 0.0;
        if !positive(c.smallest) || !positive(c.step) || c.largest_code == 0 {
            return Err(LdiFault::Codes { smallest: c.smallest, step: c.step, largest_code: c.largest_code });
        }
        if self.layers.len() > Self::MAX_LAYERS {
            return Err(LdiFault::Layers(self.layers.len()));
        }
        for (k, layer) in self.layers.iter().enumerate() {
            self.check_segments(k, layer)?;
        }
        self.check_samples()?;
        self.check_slivers()?;
        self.check_sky()
    }

    fn check_slivers(&self) -> Result<(), LdiFault> {
        if self.slivers.len() > Sliver::MOST {
            return Err(LdiFault::Sliver { sliver: Sliver::MOST, what: "an image has at most 2^18" });
        }
        if self.layers.is_empty() && !self.slivers.is_empty() {
            return Err(LdiFault::Sliver { sliver: 0, what: "it comes with the deeper layers, and there is no first" });
        }
        let within = |x: i32, side: u32| {
            let end = (side as i32 + Sliver::MARGIN) * Sliver::PARTS;
            (-Sliver::MARGIN * Sliver::PARTS..=end).contains(&x)
        };
        for (sliver, s) in self.slivers.iter().enumerate() {
            for c in &s.corners {
                if !within(c.u, self.camera.width) || !within(c.v, self.camera.height) {
                    return Err(LdiFault::Sliver { sliver, what: "a corner lies too far outside of the image" });
                }
                if c.disparity == 0 || c.disparity > self.codes.largest_code {
                    return Err(LdiFault::Sliver { sliver, what: "disparity code out of range" });
                }
            }
        }
        Ok(())
    }

    fn check_camera(&self) -> Result<(), LdiFault> {
        let c = &self.camera;
        let (w, h) = (c.width, c.height);
        let fits = |start: i32, n: u32| i64::from(start) + i64::from(n) <= i64::from(i32::MAX);
        if w == 0
            || h == 0
            || w > Self::MAX_SIDE
            || h > Self::MAX_SIDE
            || u64::from(w) * u64::from(h) > Self::MAX_PIXELS
            || !fits(c.left, w)
            || !fits(c.top, h)
        {
            return Err(LdiFault::Size { width: w, height: h, left: c.left, top: c.top });
        }
        if !c.cop.is_finite() {
            return Err(LdiFault::Camera("the centre of projection is not finite"));
        }
        if !(c.pixels_per_unit.is_finite() && c.pixels_per_unit > 0.0) {
            return Err(LdiFault::Camera("samples per unit are not positive and finite"));
        }
        let b = &c.basis;
        let off = |a: DVec3, b: DVec3, want: f64| !((a.dot(b) - want).abs() <= BASIS_TOLERANCE);
        if off(b.right, b.right, 1.0)
            || off(b.up, b.up, 1.0)
            || off(b.forward, b.forward, 1.0)
            || off(b.right, b.up, 0.0)
            || off(b.up, b.forward, 0.0)
            || off(b.forward, b.right, 0.0)
            || off(b.right.cross(b.up), b.forward, -1.0)
        {
            return Err(LdiFault::Camera("the basis is not orthonormal and right-handed"));
        }
        Ok(())
    }

    fn check_segments(&self, k: usize, layer: &LdiLayer) -> Result<(), LdiFault> {
        let expected = layer.disparity.len();
        for (what, found) in [
            ("column", layer.column.len()),
            ("rgb", layer.rgb.len()),
            ("links", layer.links.len()),
            ("ends", layer.ends.len()),
            ("slopes", layer.slopes.len()),
        ] {
            if found != expected {
                return Err(LdiFault::Length { layer: k, what, found, expected });
            }
        }
        let (mut next, mut last) = (0_usize, None);
        for (i, s) in layer.segments.iter().enumerate() {
            let fault = |what| Err(LdiFault::Segment { layer: k, segment: i, what });
            if s.count == 0 || usize::from(s.count) > 256 {
                return fault("count is not 1 to 256");
            }
            if u32::from(s.row) >= self.camera.height || u32::from(s.column_base) >= self.camera.width {
                return fault("outside the image");
            }
            if s.column_base % 256 != 0 {
                return fault("column base is no multiple of 256");
            }
            if last.is_some_and(|l| l >= (s.row, s.column_base)) {
                return fault("not in row-major order");
            }
            if s.first as usize != next {
                return fault("does not begin where the one before ends");
            }
            last = Some((s.row, s.column_base));
            next += usize::from(s.count);
        }
        if next != expected {
            return Err(LdiFault::Length { layer: k, what: "the segments' sum", found: next, expected });
        }
        Ok(())
    }

    fn check_samples(&self) -> Result<(), LdiFault> {
        let width = self.camera.width as usize;
        let mut cursors: Vec<Rows> = self.layers.iter().map(|l| Rows::new(l, width)).collect();
        // Smallest code so far in each column of the current row.
        let mut nearest_allowed = vec![u16::MAX; width];
        for row in 0..self.camera.height {
            nearest_allowed.fill(u16::MAX);
            for (k, cursor) in cursors.iter_mut().enumerate() {
                let fault = |column: usize, what| LdiFault::Sample { layer: k, row, column: column as u32, what };
                let mut down_found = 0;
                let mut right_open: Option<usize> = None;
                let mut down_next = 0;
                for s in cursor.take_row(row) {
                    let Rows { layer, wanted_in_row, .. } = cursor;
                    let offsets = &layer.column[s.first as usize..s.first as usize + usize::from(s.count)];
                    let base = usize::from(s.column_base);
                    if let Some(k) = first_of(offsets.windows(2).map(|w| w[0] >= w[1])) {
                        return Err(fault(base + usize::from(offsets[k + 1]), "columns do not ascend"));
                    }
                    let last = base + usize::from(offsets[offsets.len() - 1]);
                    if last >= width {
                        return Err(fault(last, "outside the image"));
                    }
                    let mut first = s.first as usize;
                    for offsets in neighbours(offsets) {
                        let column = base + usize::from(offsets[0]);
                        let (samples, columns) = (first..first + offsets.len(), column..column + offsets.len());
                        first = samples.end;
                        let codes = &layer.disparity[samples.clone()];
                        if let Some(k) = first_of(codes.iter().map(|c| *c == 0 || *c > self.codes.largest_code)) {
                            return Err(fault(column + k, "disparity code out of range"));
                        }
                        let allowed = &mut nearest_allowed[columns.clone()];
                        if let Some(k) = first_of(codes.iter().zip(&*allowed).map(|(code, allowed)| code > allowed)) {
                            return Err(fault(column + k, "nearer than a layer before it"));
                        }
                        allowed.copy_from_slice(codes);
                        if right_open.is_some_and(|wanted| wanted != column) {
                            return Err(fault(column, "a link to the right leads to no sample"));
                        }
                        let links = &layer.links[samples.clone()];
                        if let Some(k) = first_of(links.iter().map(|l| l & !(LINK_RIGHT | LINK_DOWN) != 0)) {
                            return Err(fault(column + k, "unknown link bits"));
                        }
                        let mut left = right_open.is_some();
                        right_open = (links[links.len() - 1] & LINK_RIGHT != 0).then_some(columns.end);
                        // The row number marks the wanted columns, so that nothing need be cleared.
                        let wanted = &mut wanted_in_row[columns];
                        down_found += wanted.iter().map(|w| u32::from(*w == row)).sum::<u32>();
                        let ends = layer.ends[samples.clone()].iter().zip(&layer.slopes[samples]);
                        for (k, (&ends, &slopes)) in ends.enumerate() {
                            let (right, down) = (links[k] & LINK_RIGHT != 0, links[k] & LINK_DOWN != 0);
                            if ends != 0 || slopes != [0; 2] {
                                check_ends(ends, [left, right, wanted[k] == row, down], slopes)
                                    .map_err(|what| fault(column + k, what))?;
                            }
                            left = right;
                        }
                        for (wanted, links) in wanted.iter_mut().zip(links) {
                            let down = links & LINK_DOWN != 0;
                            *wanted = if down { row + 1 } else { *wanted };
                            down_next += u32::from(down);
                        }
                    }
                }
                if let Some(column) = right_open {
                    return Err(fault(column, "a link to the right leads to no sample"));
                }
                if down_found != cursor.wanted_count {
                    return Err(fault(0, "a link from the row above leads to no sample"));
                }
                cursor.wanted_count = down_next;
            }
        }
        match cursors.iter().position(|c| c.wanted_count != 0) {
            None => Ok(()),
            Some(layer) => Err(LdiFault::Sample {
                layer,
                row: self.camera.height,
                column: 0,
                what: "a link down leads below the image",
            }),
        }
    }

    fn check_sky(&self) -> Result<(), LdiFault> {
        let words = self.sky_words_per_row();
        if self.sky.len() != words * self.camera.height as usize {
            return Err(LdiFault::Sky("its words do not fit the image"));
        }
        let used = self.camera.width % 64;
        let padding = if used == 0 { 0 } else { !0_u64 << used };
        if self.sky.chunks_exact(words).any(|row| row[words - 1] & padding != 0) {
            return Err(LdiFault::Sky("bits are set beyond the last column"));
        }
        Ok(())
    }
}

/// Which is the first that holds. All are looked at before, without leaving early: many at once.
fn first_of(mut holds: impl Iterator<Item = bool> + Clone) -> Option<usize> {
    if holds.clone().fold(false, |any, holds| any | holds) { holds.position(|holds| holds) } else { None }
}

/// Cuts ascending columns into those that lie beside each other.
fn neighbours(columns: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = columns;
    std::iter::from_fn(move || {
        let (first, last) = (*rest.first()?, *rest.last()?);
        let n = match usize::from(last - first) + 1 {
            span if span == rest.len() => span,
            _ => 1 + rest.windows(2).take_while(|w| w[0] + 1 == w[1]).count(),
        };
        let neighbours;
        (neighbours, rest) = rest.split_at(n);
        Some(neighbours)
    })
}

/// Of one sample: no end beyond the next pixel's centre or where it is linked, no slope where the
/// surface does not go on.
fn check_ends(ends: u16, linked: [bool; SIDES.len()], slopes: [i8; 2]) -> Result<(), &'static str> {
    let sound = |side: usize| match end_of(ends, side) {
        0 => true,
        end => end <= END_PARTS && !linked[side],
    };
    if !(0..SIDES.len()).all(sound) {
        return Err("it ends too far off, or where it goes on");
    }
    if (0..2).any(|axis| slopes[axis] != 0 && !is_loose(ends, axis)) {
        return Err("a slope where it ends");
    }
    Ok(())
}

/// Walks a layer's segments row by row and remembers which columns the row above linked to.
struct Rows<'a> {
    layer: &'a LdiLayer,
    next_segment: usize,
    /// Per column, the row in which a link from above wants a sample.
    wanted_in_row: Vec<u32>,
    wanted_count: u32,
}

impl<'a> Rows<'a> {
    fn new(layer: &'a LdiLayer, width: usize) -> Self {
        Self { layer, next_segment: 0, wanted_in_row: vec![u32::MAX; width], wanted_count: 0 }
    }

    fn take_row(&mut self, row: u32) -> &'a [Segment] {
        let rest = &self.layer.segments[self.next_segment..];
        let n = rest.iter().take_while(|s| u32::from(s.row) == row).count();
        self.next_segment += n;
        &rest[..n]
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DisparityCodes, LdiCamera, SliverCorner};
    use super::*;
    use crate::ViewBasis;

    /// Three columns, two rows. Layer 0 is full and linked throughout; layer 1 holds the middle
    /// column.
    fn sound() -> Ldi {
        let layer = |segments: Vec<Segment>, column: Vec<u8>, disparity: Vec<u16>, links: Vec<u8>| {
            let (rgb, ends) = (vec![[1, 2, 3]; column.len()], Vec::new());
            LdiLayer { segments, rgb, column, disparity, links, ends, slopes: Vec::new() }.with_half_ends()
        };
        let segment = |row, first, count| Segment { row, column_base: 0, first, count };
        Ldi {
            camera: LdiCamera {
                cop: DVec3::ZERO,
                basis: ViewBasis::from_yaw_pitch(30.0, 20.0),
                pixels_per_unit: 2.0,
                left: -1,
                top: -1,
                width: 3,
                height: 2,
            },
            codes: DisparityCodes { smallest: 0.1, step: 0.01, largest_code: 90 },
            layers: vec![
                layer(
                    vec![segment(0, 0, 3), segment(1, 3, 3)],
                    vec![0, 1, 2, 0, 1, 2],
                    vec![50; 6],
                    vec![3, 3, 2, 1, 1, 0],
                ),
                layer(vec![segment(0, 0, 1), segment(1, 1, 1)], vec![1, 1], vec![9, 50], vec![2, 0]),
            ],
            sky: vec![0, 0b111],
            slivers: vec![Sliver { corners: [SliverCorner { u: 16, v: 8, disparity: 90 }; 4], rgb: [1, 2, 3] }; 2],
        }
    }

    #[test]
    fn a_sound_image_passes() {
        assert_eq!(sound().check(), Ok(()));
    }

    /// Breaks one promise at a time; every break must be found.
    #[test]
    fn every_broken_promise_is_found() {
        let breaks: Vec<(&str, fn(&mut Ldi))> = vec![
            ("zero width", |l| l.camera.width = 0),
            ("huge", |l| (l.camera.width, l.camera.height) = (16_384, 16_384)),
            ("window overflow", |l| l.camera.left = i32::MAX),
            ("scale", |l| l.camera.pixels_per_unit = f64::NAN),
            ("cop", |l| l.camera.cop.x = f64::INFINITY),
            ("left-handed", |l| l.camera.basis.right *= -1.0),
            ("not unit", |l| l.camera.basis.up *= 1.001),
            ("no codes", |l| l.codes.largest_code = 0),
            ("negative step", |l| l.codes.step = -1.0),
            ("too many layers", |l| l.layers.resize(33, LdiLayer::default())),
            ("short rgb", |l| _ = l.layers[0].rgb.pop()),
            ("short segments", |l| _ = l.layers[0].segments.pop()),
            ("empty segment", |l| l.layers[0].segments[0].count = 0),
            ("row outside", |l| l.layers[1].segments[1].row = 2),
            ("rows unordered", |l| l.layers[0].segments[1].row = 0),
            ("base unaligned", |l| l.layers[1].segments[0].column_base = 1),
            ("gap in first", |l| l.layers[0].segments[1].first = 4),
            ("columns equal", |l| l.layers[0].column[1] = 0),
            ("column outside", |l| l.layers[0].column[2] = 3),
            ("code zero", |l| l.layers[0].disparity[0] = 0),
            ("code too large", |l| l.layers[0].disparity[0] = 91),
            ("deeper is nearer", |l| l.layers[1].disparity[0] = 51),
            ("unknown link", |l| l.layers[0].links[0] = 4),
            ("right into nothing", |l| l.layers[1].links[0] = LINK_RIGHT),
            ("right off the image", |l| l.layers[0].links[5] = LINK_RIGHT),
            ("down into nothing", |l| l.layers[1].column[1] = 2),
            ("down off the image", |l| l.layers[0].links[4] = LINK_DOWN),
            ("short ends", |l| _ = l.layers[0].ends.pop()),
            ("end too far", |l| l.layers[0].ends[5] = 5 << (3 * 4)),
            ("end to the left where it goes on", |l| l.layers[0].ends[4] |= 1),
            ("end to the right where it goes on", |l| l.layers[0].ends[0] |= 1 << 4),
            ("end above where it goes on", |l| l.layers[0].ends[4] |= 1 << 8),
            ("end below where it goes on", |l| l.layers[0].ends[0] |= 1 << 12),
            ("short slopes", |l| _ = l.layers[0].slopes.pop()),
            ("slope where it ends", |l| {
                l.layers[1].ends[0] &= !0xff;
                l.layers[1].slopes[0] = [-1, 0];
            }),
            ("sliver outside", |l| l.slivers[1].corners[2].u = (3 + Sliver::MARGIN) * Sliver::PARTS + 1),
            ("sliver above", |l| l.slivers[0].corners[3].v = -Sliver::MARGIN * Sliver::PARTS - 1),
            ("sliver without a code", |l| l.slivers[1].corners[0].disparity = 0),
            ("sliver beyond the codes", |l| l.slivers[1].corners[1].disparity = 91),
            ("slivers alone", |l| l.layers.clear()),
            ("too many slivers", |l| l.slivers = vec![l.slivers[0]; Sliver::MOST + 1]),
            ("short sky", |l| _ = l.sky.pop()),
            ("sky padding", |l| l.sky[0] = 8),
        ];
        for (name, spoil) in breaks {
            let mut ldi = sound();
            spoil(&mut ldi);
            assert!(ldi.check().is_err(), "not found: {name}");
        }
    }
}
